"""Curved waves in scenes: the radiance of emitters, what a floor gets of them, and receivers."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import polywigner as pw
from mitsuba_scenes import (
    MILLIMETRE,
    MONO,
    RADIANCE_ERROR,
    WAVELENGTH,
    draws,
    emitter_of,
    evaluated,
    light,
    use,
)
from polywigner.errors import SceneError

pytestmark = pytest.mark.drjit

HORN = (
    pw.shapes.rectangle(12e-3, 8e-3)
    .with_illumination(pw.te_mode(12e-3, 8e-3))
    .curved((0.03, 0.05), WAVELENGTH, (1e-3, 0.0))
    .moved((2e-3, 1e-3))
)
MIDDLE = np.array([2e-3, 1e-3])
# Of the largest irradiance: the noise of 256 samples, and pixels of 6 mm.
FLOOR = 0.06
# Of what a white floor sends back: four thousand samples.
RECEIVED = 0.05


@pytest.mark.parametrize("variant", ["scalar_rgb", MONO])
def test_the_radiance_of_a_curved_wave_is_its_wigner_function_times_the_cosine(
    variant: str,
) -> None:
    mi = use(variant)
    x, direction = draws(10, 0.005)
    seen = evaluated(mi, emitter_of(light(HORN)), x / MILLIMETRE, direction)
    expected = pw.radiance(HORN, x + MIDDLE, direction, WAVELENGTH) * direction[:, 2]
    scale = 4 * HORN.area / WAVELENGTH**2
    assert np.abs(seen - expected[:, None]).max() < RADIANCE_ERROR * scale


@pytest.mark.slow
def test_a_floor_receives_the_power_density_of_a_horn_times_its_cosine(llvm: object) -> None:
    mi = use("llvm_ad_mono")
    import polywigner.mitsuba as scenes

    height, half, pixels = 0.1, 0.05, 16
    t = mi.ScalarTransform4f
    look = t().look_at([0, 0, height / 2], [0, 0, height], [0, 1, 0])
    film = {"type": "hdrfilm", "width": pixels, "height": pixels, "rfilter": {"type": "box"}}
    scene = mi.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "direct"},
            "light": scenes.aperture(HORN, WAVELENGTH),
            "sensor": {
                "type": "orthographic",
                "near_clip": 1e-4,
                "to_world": look.scale([half, half, 1]),
                "film": film,
            },
            "floor": {
                "type": "rectangle",
                "to_world": t().translate([0, 0, height]).rotate([1, 0, 0], 180).scale(0.2),
                "bsdf": {"type": "diffuse", "reflectance": 1.0},
            },
        }
    )
    image = np.pi * np.array(mi.render(scene, spp=1024, seed=1))[..., 0]
    places = half * ((2 * np.arange(pixels) + 1) / pixels - 1)
    x, y = np.meshgrid(-places, -places)
    points = np.stack([x, y, np.full_like(x, height)], axis=-1)
    cosine = height / np.linalg.norm(points - np.append(MIDDLE, 0.0), axis=-1)
    expected = pw.irradiance(HORN, points, WAVELENGTH) * cosine
    assert np.abs(image - expected).max() < FLOOR * expected.max()
    assert image.sum() == pytest.approx(expected.sum(), rel=0.02)


@pytest.mark.slow
def test_a_receiver_with_a_curved_wave_weighs_as_its_wigner_function(llvm: object) -> None:
    """By reciprocity: a white floor far below sends back what falls on it of the horn."""
    mi = use("llvm_ad_mono")
    import polywigner.mitsuba as scenes

    t = mi.ScalarTransform4f
    found = {}
    for name, source in (("curved", HORN), ("flat", HORN.source)):
        scene = mi.load_dict(
            {
                "type": "scene",
                "integrator": {"type": "path", "max_depth": 3},
                "light": scenes.aperture(source, WAVELENGTH, estimator="wigner", visible=False),
                "horn": scenes.receiver(source, WAVELENGTH, estimator="wigner"),
                "floor": {
                    "type": "rectangle",
                    "to_world": t().translate([0, 0, 0.15]).rotate([1, 0, 0], 180).scale(3.0),
                    "bsdf": {"type": "diffuse", "reflectance": 1.0},
                },
            }
        )
        found[name] = float(np.array(mi.render(scene, spp=1 << 16, seed=3)).mean())
        # (1/pi) int I_t I_r cos^2 lambda^2/N over the floor, both to leading order
        places = np.linspace(-0.5, 0.5, 41)
        x, y = np.meshgrid(places, places)
        points = np.stack([x, y, np.full_like(x, 0.15)], axis=-1)
        fall = pw.irradiance(source, points, WAVELENGTH, "rayleigh-sommerfeld-1")
        fall *= 0.15 / np.linalg.norm(points - np.append(MIDDLE, 0.0), axis=-1)
        step = (places[1] - places[0]) ** 2
        radiated = pw.radiated_power(source, WAVELENGTH)
        expected = WAVELENGTH**2 / (np.pi * radiated) * (fall * fall).sum() * step
        assert found[name] == pytest.approx(expected, rel=RECEIVED)
    assert found["curved"] < found["flat"]


def test_obliquities_that_take_slopes_are_refused_in_one_sentence() -> None:
    use("scalar_rgb")
    import polywigner.mitsuba as scenes

    entries: list[Any] = [scenes.aperture, scenes.receiver]
    for entry in entries:
        with pytest.raises(SceneError, match="for a curved wave"):
            entry(HORN, WAVELENGTH, estimator="wigner", obliquity="kirchhoff")


@pytest.mark.slow
def test_the_direct_power_of_horns_is_their_coupling_by_a_mirror_too(llvm: object) -> None:
    mi = use("llvm_ad_mono")
    import polywigner.mitsuba as scenes

    away = np.diag([-1.0, 1.0, -1.0, 1.0])
    away[:3, 3] = 0.03, -0.02, 0.2
    wave = {"estimator": "wigner"}
    lights = {
        "type": "scene",
        "tx": scenes.aperture(HORN, WAVELENGTH, power=1.0, **wave),
        "rx": scenes.receiver(HORN.source, WAVELENGTH, away, **wave),
    }
    found = scenes.received_power(mi.load_dict(lights), spp=4)
    expected = abs(pw.coupling(HORN, HORN.source, away, WAVELENGTH)) ** 2
    assert found.direct == pytest.approx(expected, rel=1e-5)
    # both face a mirror, which shows the horn mirrored in x and behind it
    beside = np.eye(4)
    beside[:3, 3] = 0.05, 0.0, 0.0
    lights["rx"] = scenes.receiver(HORN, WAVELENGTH, beside, **wave)
    t = mi.ScalarTransform4f
    mirror = t().translate([0, 0, 0.2]).rotate([1, 0, 0], 180).scale(1.0)
    perfect = {"type": "conductor", "material": "none"}
    lights["mirror"] = {"type": "rectangle", "to_world": mirror, "bsdf": perfect}
    found = scenes.received_power(mi.load_dict(lights), spp=4)
    image = np.diag([-1.0, 1.0, -1.0, 1.0])  # of the receiver, its x turned over
    image[:3, 3] = 0.05, 0.0, 0.4
    flipped = pw.shapes.rectangle(12e-3, 8e-3).with_illumination(pw.te_mode(12e-3, 8e-3))
    flipped = flipped.curved((0.03, 0.05), WAVELENGTH, (-1e-3, 0.0)).moved((-2e-3, 1e-3))
    expected = abs(pw.coupling(HORN, flipped, image, WAVELENGTH)) ** 2
    assert found.direct == pytest.approx(expected, rel=1e-3)
