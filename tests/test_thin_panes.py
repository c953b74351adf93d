"""Thin panes of glass: 2R/(1 + R) for each polarisation, and energy balance."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from mitsuba_scenes import (
    SQUARE,
    WAVELENGTH,
    coupled,
    emitter,
    looking,
    receiver,
    rectangle,
    scene_of,
)
from polywigner.errors import SceneError

pytestmark = [pytest.mark.drjit, pytest.mark.usefixtures("few_rays", "few_batches")]
pm = pytest.importorskip("polywigner.mitsuba")
import mitsuba as mi  # noqa: E402 (after the package, which chooses the LLVM library)

# Rays of an aperture have angles of incidence that differ by some milliradians.
RAYS = 2e-4


def summed_pane(index: float, angle: float) -> tuple[list[float], list[float]]:
    """Sum internal reflections; return reflectance and transmittance for both polarisations."""
    cosine = math.cos(angle)
    root = np.sqrt(index**2 - math.sin(angle) ** 2 + 0j)
    faces = [
        abs((cosine - root) / (cosine + root)) ** 2,
        abs((index**2 * cosine - root) / (index**2 * cosine + root)) ** 2,
    ]
    reflected, passed = [], []
    for face in faces:
        orders = face ** np.arange(1000.0)
        passed.append(float(np.sum((1 - face) ** 2 * orders[::2])))
        reflected.append(float(face + np.sum((1 - face) ** 2 * orders[1::2])))
    return reflected, passed


def powers(index: float, angle: float, polarisation: str, is_across: bool, **pane: Any) -> Any:
    """Return powers with a pane in z = 0, for ends at 1 m on the same side or on opposite sides."""
    s, c = math.sin(angle), math.cos(angle)
    other = looking((s, 0, -c), (-s, 0, c)) if is_across else looking((s, 0, c), (-s, 0, -c))
    own = {"polarisation": polarisation} if mi.is_polarized else {}
    bsdf = pane or {"type": "thindielectric", "int_ior": index, "ext_ior": 1.0}
    return scene_of(
        tx=emitter(pose=looking((-s, 0, c), (s, 0, -c)), **own),
        rx=receiver(pose=other, **own),
        pane=rectangle((0, 0, 0), (1, 0, 0), 0, 10.0, bsdf),
    )


def free() -> float:
    """Return the received power over 2 m without a pane."""
    ends = looking((0, 0, 0), (1, 0, 0)), looking((2, 0, 0), (-1, 0, 0))
    return abs(coupled(SQUARE, ends[0], SQUARE, ends[1], WAVELENGTH)) ** 2


def of_channel(scene: Any, polarisation: str, mirrors: str) -> float:
    result = pm.channel(scene, polarisation=polarisation)
    here = result["mirrors"].values == mirrors
    return float((np.abs(result["amplitude"].values[0, 0, 0, here]) ** 2).sum()) / free()


def of_power(scene: Any, mirrors: tuple[str, ...], **how: Any) -> float:
    (part,) = pm.received_power(scene, spp=16, **how).contributions
    return math.fsum(path.power for path in part.paths if path.mirrors == mirrors) / free()


TINTED = {"specular_transmittance": 0.5, "specular_reflectance": 0.25}


@pytest.mark.parametrize(
    ("index", "angle", "tint", "opacity"),
    [
        (1.5, 1.3, {}, None),
        (0.6, 0.9, {}, None),
        pytest.param(4.0, 0.7, {}, 0.3, marks=[pytest.mark.llvm, pytest.mark.slow]),
        (1.5, 1.0, TINTED, None),
    ],
    ids=["glass", "thinner", "masked", "tinted"],
)
def test_a_pane_reflects_and_transmits_each_polarisation_by_itself(
    index: float, angle: float, tint: dict[str, float], opacity: float | None
) -> None:
    """A mask leaves a fraction of the glass, and tinted glass absorbs."""
    mi.set_variant("scalar_rgb" if opacity is None else "llvm_ad_mono")
    pane: dict[str, Any] = {"type": "thindielectric", "int_ior": index, "ext_ior": 1.0, **tint}
    if opacity is not None:
        pane = {"type": "mask", "opacity": opacity, "b": pane}
    share = 1.0 if opacity is None else opacity
    reflected, passed = (np.array(values) for values in summed_pane(index, angle))
    if tint:
        reflected, passed = 0.25 * reflected, 0.5 * passed
    reflected, passed = share * reflected, 1 - share + share * passed
    back, through = (powers(index, angle, "y", is_across, **pane) for is_across in (False, True))
    for number, polarisation in enumerate("xy"):
        result = of_channel(back, polarisation, "pane"), of_channel(through, polarisation, "")
        assert result == pytest.approx((reflected[number], passed[number]), abs=RAYS)
    how: dict[str, Any] = {"coherent": True, "polarisation": "y"}
    assert of_power(back, ("pane",), **how) == pytest.approx(reflected[1], abs=RAYS)
    assert of_power(back, ("pane",)) == pytest.approx(np.mean(reflected), abs=RAYS)
    assert of_power(through, ()) == pytest.approx(np.mean(passed), abs=RAYS)


def test_polarised_power_by_a_pane_is_that_of_its_channel() -> None:
    mi.set_variant("scalar_spectral_polarized")
    for is_across, mirrors in ((False, "pane"), (True, "")):
        scene = powers(2.0, 0.9, "y", is_across)
        expected = of_channel(scene, "y", mirrors)
        chain = (mirrors,) if mirrors else ()
        assert of_power(scene, chain) == pytest.approx(expected, abs=RAYS)
    assert expected == pytest.approx(summed_pane(2.0, 0.9)[1][1], abs=RAYS)


def test_two_panes_that_are_turned_pass_the_product_of_their_field_matrices() -> None:
    """The planes of incidence are perpendicular, so each polarisation is s once and p once."""
    mi.set_variant("scalar_rgb")
    one, other = looking((0, 0, 0), (1, 0, 0)), looking((2, 0, 0), (-1, 0, 0))
    glass = {"type": "thindielectric", "int_ior": 3.0, "ext_ior": 1.0}
    turn = mi.ScalarTransform4f
    upright = turn().rotate([0, 1, 0], 90)
    panes = {
        "a": turn().translate([0.7, 0, 0]).rotate([0, 0, 1], 40) @ upright,
        "b": turn().translate([1.3, 0, 0]).rotate([0, 1, 0], 60) @ upright,
    }
    _, first = summed_pane(3.0, math.radians(40))
    _, second = summed_pane(3.0, math.radians(60))
    # Pane a is rotated about z, so that E along z is s; pane b is rotated about y.
    expected = {"y": first[0] * second[1], "x": first[1] * second[0]}
    scene = scene_of(
        tx=emitter(pose=one),
        rx=receiver(pose=other),
        **{
            name: {"type": "rectangle", "to_world": pose.scale([0.3, 0.3, 1]), "bsdf": glass}
            for name, pose in panes.items()
        },
    )
    for polarisation, power in expected.items():
        assert of_channel(scene, polarisation, "") == pytest.approx(power, abs=3 * RAYS)


def test_a_polarising_filter_between_waves_is_refused() -> None:
    mi.set_variant("scalar_rgb")
    scene = powers(1.0, 0.5, "x", True, type="polarizer")
    with pytest.raises(SceneError, match="polarising filter 'pane'"):
        pm.channel(scene)
    assert of_power(scene, ()) == pytest.approx(0.5, abs=RAYS)
