"""Default polarisation in tables, channels, range profiles and renders."""

from __future__ import annotations

import importlib.util
import math
from typing import Any

import numpy as np
import pytest

from mitsuba_scenes import (
    MIRROR,
    SQUARE,
    WAVELENGTH,
    camera,
    coupled,
    looking,
    rectangle,
    shifted,
    spectrum,
    use,
)
from polywigner.errors import SceneError

pytestmark = [pytest.mark.drjit, pytest.mark.usefixtures("few_rays", "few_batches")]
pm = pytest.importorskip("polywigner.mitsuba")

POLARISED, PLAIN_POLARISED = "llvm_ad_mono_polarized", "scalar_spectral_polarized"
# Relative error of powers, 1e-6 dB, which is a few times the error of single precision.
MICRO_DECIBEL = 2.3e-7
HALF = {"type": "diffuse", "reflectance": spectrum(0.5)}


def poses(roll: float, lean: float, distance: float = 0.5) -> tuple[np.ndarray, np.ndarray]:
    """Return two poses in numbers that single precision represents exactly."""
    made = []
    for place, ahead, own in (((0, 0, 0), 1, 0.0), ((0.125, -0.25, distance), -1, roll)):
        turn, (c, s) = np.eye(4), (math.cos(own), math.sin(own))
        turn[:2, :2] = [[c, -s], [s, c]]
        pose = looking(place, (0.3 * lean, -0.2 * lean, ahead), (0, 1, 0)) @ turn
        made.append(pose.astype(np.float32).astype(float))
    return made[0], made[1]


def linked(
    ends: tuple[Any, Any], sent: Any = None, taken: Any = None, others: Any = None, **how: Any
) -> Any:
    one, other = ends
    return pm.load_scene(
        {
            "type": "scene",
            "tx": pm.aperture(SQUARE, WAVELENGTH, one, power=1.0, polarisation=sent, **how),
            "rx": pm.receiver(SQUARE, WAVELENGTH, other, polarisation=taken, **how),
            **(others or {}),
        }
    )


def routes(scene: Any) -> list[float]:
    """Return the relative power of a link by each function that reports it."""
    return [
        pm.received_power(scene, spp=16).direct,
        pm.received_power(scene, spp=16, coherent=True).direct,
        abs(pm.channel(scene).h.item()) ** 2,
    ]


@pytest.mark.parametrize(("roll", "lean"), [(0.7, 0.0), (0.4, 1.0)])
def test_in_unpolarised_variants_all_routes_are_the_scalar_link(roll: float, lean: float) -> None:
    """The link is Friis' formula without polarisation mismatch, for any rotation about the axes."""
    use("scalar_rgb")
    one, other = poses(roll, lean)
    expected = abs(coupled(SQUARE, one, SQUARE, other)) ** 2
    assert routes(linked((one, other))) == pytest.approx([expected] * 3, rel=MICRO_DECIBEL)


def test_in_polarised_variants_all_routes_count_the_y_axes_of_both_ends() -> None:
    """Ends in parallel planes have the mismatch cos^2 of the roll (Malus)."""
    use(PLAIN_POLARISED)
    for roll, sent, taken, share in [
        (0.3, None, "x", math.sin(0.3) ** 2),
        (0.0, "45 deg", None, 0.5),
    ]:
        one, other = poses(roll, 0.0)
        scalar = abs(coupled(SQUARE, one, SQUARE, other)) ** 2
        result = routes(linked((one, other), sent, taken))
        assert result == pytest.approx([share * scalar] * 3, rel=3 * MICRO_DECIBEL)


def test_the_default_is_the_link_of_huygens_sources_along_y() -> None:
    """Kirchhoff's condition is compared with `coupling` of vector fields."""
    use(PLAIN_POLARISED)
    one, other = poses(0.5, 1.0, 2.0)
    expected = coupled(SQUARE, one, SQUARE, other, polarisation="y", method="huygens")
    result = routes(linked((one, other), obliquity="kirchhoff"))
    assert result == pytest.approx([abs(expected) ** 2] * 3, rel=1e-3)  # near fields differ
    assert max(result) / min(result) - 1 < MICRO_DECIBEL


def test_exchange_of_an_end_with_and_an_end_without_a_polarisation_changes_nothing() -> None:
    use(PLAIN_POLARISED)
    one, other = poses(0.5, 1.0)
    there, back = routes(linked((one, other), "left")), routes(linked((other, one), None, "left"))
    assert there == pytest.approx(back, rel=MICRO_DECIBEL)


def test_a_source_without_a_polarisation_is_seen_polarised_along_its_y_axis() -> None:
    use(PLAIN_POLARISED)
    seen = camera((0, 0, 1), (0, 0, 0), 2, 1e-3)
    black = {"type": "diffuse", "reflectance": spectrum(0.0)}
    for given, first in ((None, -1.0), ("unpolarised", 0.0), ("x", 1.0)):
        sent = pm.aperture(SQUARE, WAVELENGTH, bsdf=black, polarisation=given)
        entry = {"type": "scene", "integrator": {"type": "path"}, "camera": seen, "s": sent}
        s = pm.stokes_of(pm.render(pm.load_scene(entry), "stokes", spp=4)).mean(axis=(1, 2))
        assert s[1:] / s[0] == pytest.approx([first, 0.0, 0.0], abs=1e-3)


@pytest.mark.slow
@pytest.mark.llvm
def test_a_diffuse_floor_returns_half_to_the_default_and_ranges_and_scatterers_agree() -> None:
    """A diffuse surface depolarises: one mode receives half of the power."""
    if importlib.util.find_spec("mitransient") is None:  # its import sets a default variant
        pytest.skip("mitransient is not installed")
    use(POLARISED)
    side = shifted(0.25)
    wall = {"floor": rectangle((0, 0, 2), (1, 0, 0), 180, bsdf=HALF)}
    scenes = {
        kind: linked((np.eye(4), side), None, kind, wall, estimator="exact")
        for kind in (None, "unpolarised")
    }
    power = {kind: pm.received_power(s, spp=4096).scattered for kind, s in scenes.items()}
    assert power[None] == pytest.approx(power["unpolarised"] / 2, rel=1e-4)
    profile = pm.range_profile(scenes[None], [0.0, 1.0, 3.0], spp=4096)
    cloud = pm.scatterers(scenes[None], 20000, rays=20000)
    assert float(profile["scattered"]) == pytest.approx(power[None], rel=1e-3)
    assert float(cloud["power"].sum()) == pytest.approx(power[None], rel=0.02)
    for each in (profile, cloud):
        assert each.attrs["polarisation"] == "y (default): tx, rx"


@pytest.mark.llvm
def test_a_polarised_receiver_gets_half_of_what_a_diffuse_floor_scatters() -> None:
    use(POLARISED)
    wall = {"floor": rectangle((0, 0, 2), (1, 0, 0), 180, bsdf=HALF)}
    powers = []
    for kind in (None, "unpolarised"):
        scene = linked((np.eye(4), shifted(0.25)), None, kind, wall, estimator="exact")
        powers.append(float(pm.scatterers(scene, 50, rays=64)["power"].sum()))
    assert powers[0] == pytest.approx(powers[1] / 2, rel=1e-4)


def test_results_state_the_polarisations_that_count() -> None:
    use(PLAIN_POLARISED)
    scene = linked(poses(0.0, 0.0), None, "left")
    result = pm.received_power(scene, spp=16)
    assert result.polarisation == "y (default): tx; left: rx"
    assert pm.channel(scene).attrs["polarisation"] == result.polarisation
    assert pm.channel(scene, polarisation="45 deg").attrs["polarisation"] == (
        "45 deg: tx; left: rx"
    )
    use("scalar_rgb")
    plain = linked(poses(0.0, 0.0))
    assert "ignored" in pm.received_power(plain, spp=16).polarisation
    assert "y at both ends of reflected paths" in pm.channel(plain).attrs["polarisation"]


@pytest.mark.llvm
def test_a_requested_default_holds_for_direct_and_scattered_power_and_ends_with_the_call() -> None:
    """Rough metal preserves polarisation: crossed ends receive little power."""
    use(POLARISED)
    value = spectrum(3000.0)
    metal = {"type": "roughconductor", "alpha": 0.3, "eta": value, "k": value}
    wall = {"floor": rectangle((0, 0, 1), (1, 0, 0), 180, bsdf=metal)}
    side = shifted(0.25)
    scene = linked((np.eye(4), side), None, "y", wall, estimator="exact")
    before = pm.received_power(scene, spp=1024).scattered
    crossed = pm.received_power(scene, spp=1024, coherent=True, polarisation="x").scattered
    assert abs(crossed) < 0.02 * before
    assert pm.received_power(scene, spp=1024).scattered == pytest.approx(before, rel=1e-6)


def test_unpolarised_ends_have_no_amplitude() -> None:
    use(PLAIN_POLARISED)
    scene = linked(poses(0.0, 0.0), "unpolarised")
    with pytest.raises(SceneError, match="'tx' is unpolarised"):
        pm.channel(scene)
    assert pm.received_power(scene, spp=16).direct > 0


def test_rolled_ends_over_a_floor_are_pointed_out() -> None:
    """Only the reflected path depends on the y axes if no polarisation is specified."""
    use("scalar_rgb")
    floor = {"floor": rectangle((0, -1, 0.25), (1, 0, 0), -90, bsdf=MIRROR)}
    for roll, is_noted in ((0.0, False), (0.7, True)):
        scene = linked(poses(roll, 0.0), others=floor)
        notes = pm.channel(scene, reflections=1).attrs["notes"]
        assert any("specify a polarisation" in note for note in notes) == is_noted
    given = pm.channel(scene, reflections=1, polarisation="y").attrs["notes"]
    assert not any("specify a polarisation" in note for note in given)
