"""Point, spot, projector and directional lights at receivers, against closed forms."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

import polywigner as pw
from mitsuba_scenes import (
    BLACK,
    HANDED,
    SQUARE,
    WAVELENGTH,
    camera,
    emitter,
    facing,
    receiver,
    rectangle,
    scene_of,
    spectrum,
)
from polywigner.errors import SceneError

pytestmark = [pytest.mark.drjit, pytest.mark.usefixtures("few_rays")]
pm = pytest.importorskip("polywigner.mitsuba")
import mitsuba as mi  # noqa: E402 (after the package, which chooses the LLVM library)

ONE = spectrum(1.0)
# Relative error of Mitsuba's images and light positions, which are in single precision.
SINGLE = 1e-5


def area(source: Any, place: Any, obliquity: str = "rayleigh-sommerfeld-1") -> float:
    """Return lambda^2 D/(4 pi r^2) from the exact field: received power per radiant intensity."""
    field = complex(pw.amplitude(source, np.asarray(place, float), WAVELENGTH, obliquity))
    return WAVELENGTH**2 * abs(field) ** 2 / pw.radiated_power(source, WAVELENGTH, obliquity)


def directivity(source: Any, theta: float, phi: float) -> float:
    pattern = pw.radiation_pattern(source, WAVELENGTH, [theta], [phi])
    return float(10 ** (pattern["directivity"].values.ravel()[0] / 10))


def point(place: Any) -> dict[str, Any]:
    return {"type": "point", "position": [float(c) for c in place], "intensity": ONE}


def towards(place: Any, target: Any, kind: str = "spot", **options: Any) -> dict[str, Any]:
    pose = mi.ScalarTransform4f().look_at(
        [float(c) for c in place], [float(c) for c in target], [0.1, 1.0, 0.0]
    )
    return {"type": kind, "to_world": pose, **options}


def along(theta: float, phi: float) -> np.ndarray:
    return np.array(
        [math.sin(theta) * math.cos(phi), math.sin(theta) * math.sin(phi), math.cos(theta)]
    )


def both_readings(scene: Any) -> tuple[float, float]:
    """Return the received power and the image of the sensor."""
    image = pm.render(scene, spp=16)
    return float(pm.received_power(scene, spp=16)), float(image.sum())


@pytest.mark.parametrize("estimator", ["exact", "wigner"])
@pytest.mark.usefixtures("few_batches")
def test_a_point_light_far_away_obeys_friis(plain: None, estimator: str) -> None:
    theta, phi, distance = 0.25, 0.7, 30.0
    scene = scene_of(
        rx=receiver(HANDED, estimator=estimator), lamp=point(distance * along(theta, phi))
    )
    expected = directivity(HANDED, theta, phi) * (WAVELENGTH / (4 * math.pi * distance)) ** 2
    result = both_readings(scene)
    # The tolerance is large, because the outline is some millimetres off the origin.
    assert result == pytest.approx([4 * math.pi * expected] * 2, rel=2e-3)
    (part,) = pm.received_power(scene, spp=16).contributions
    assert part.name == "other lights" and part.scattered == 0.0
    (path,) = part.paths
    assert (
        path.light == "lamp" and path.mirrors == () and path.length == pytest.approx(30, abs=0.01)
    )
    assert path.arrives_from == pytest.approx(along(theta, phi)[:2], abs=1e-3)
    assert path.coupling == pytest.approx(expected, rel=2e-3)
    assert path.transmission == pytest.approx(1.0, rel=SINGLE)


@pytest.mark.parametrize("place", [(0.0, 0.0, 0.02), (0.004, -0.01, 0.015)])
def test_a_point_light_close_by_sees_the_exact_near_field(plain: None, place: Any) -> None:
    scene = scene_of(rx=receiver(), lamp=point(place))
    assert both_readings(scene) == pytest.approx([area(SQUARE, place)] * 2, rel=SINGLE)


def test_a_plane_wave_is_received_by_the_effective_area(plain: None) -> None:
    theta, phi = 0.3, -0.4
    light = {"type": "directional", "direction": (-along(theta, phi)).tolist(), "irradiance": ONE}
    expected = directivity(HANDED, theta, phi) * WAVELENGTH**2 / (4 * math.pi)
    scene = scene_of(rx=receiver(HANDED), sun=light)
    assert both_readings(scene) == pytest.approx([expected] * 2, rel=SINGLE)


@pytest.mark.parametrize(("off", "share"), [(5.0, 1.0), (18.0, 0.2), (25.0, 0.0)])
def test_a_spot_falls_off_towards_its_rim(plain: None, off: float, share: float) -> None:
    """The intensity is full within 10 degrees, and decreases linearly to zero at 20 degrees."""
    target = [0.0, 2 * math.sin(math.radians(off)), 2 - 2 * math.cos(math.radians(off))]
    spot = towards((0, 0, 2), target, intensity=ONE, cutoff_angle=20.0, beam_width=10.0)
    scene = scene_of(rx=receiver(), spot=spot)
    expected = share * area(SQUARE, (0, 0, 2))
    assert both_readings(scene) == pytest.approx([expected] * 2, rel=1e-3, abs=1e-12)


def test_a_projector_is_received_as_its_light_on_a_floor_says(plain: None) -> None:
    """A white floor in place of the receiver has the radiance E/pi."""
    picture = mi.Bitmap(np.ones((4, 4, 1), np.float32))
    texture = {"type": "bitmap", "bitmap": picture, "raw": True}
    projector = towards((0, 0, 2), (0, 0, 0), "projector", fov=30.0, irradiance=texture)
    floor = {"type": "rectangle", "bsdf": {"type": "diffuse", "reflectance": 1.0}}
    seen = camera((0, 0, 1), (0, 0, 0), 1, 0.01)
    image = pm.render(scene_of(camera=seen, floor=floor, light=projector), "direct", spp=64)
    irradiance = math.pi * float(image[0, 0].mean())
    result = both_readings(scene_of(rx=receiver(), light=projector))
    assert result == pytest.approx([irradiance * 4 * area(SQUARE, (0, 0, 2))] * 2, rel=1e-3)


def wall(z: float, x: float = 0.0, bsdf: Any = BLACK) -> dict[str, Any]:
    return rectangle((x, 0, z), (1, 0, 0), 0, bsdf=bsdf)


@pytest.mark.usefixtures("few_batches")
def test_walls_and_veils_take_their_share_of_a_light(plain: None, many_rays: None) -> None:
    lamp, sun = point((0, 0, 50)), {"type": "directional", "direction": [0, 0, -1]}
    free = {
        light["type"]: float(pm.received_power(scene_of(rx=receiver(), light=light), spp=16))
        for light in (lamp, sun)
    }
    for light, part, share in (
        (lamp, wall(0.02), 0.0),
        (sun, wall(1e-3, 1.0), 0.5),
        (lamp, wall(1.0, bsdf={"type": "mask", "opacity": 0.25, "b": BLACK}), 0.75),
        (sun, wall(-0.1), 1.0),
    ):
        result = both_readings(scene_of(rx=receiver(), light=light, part=part))
        assert result == pytest.approx([share * free[light["type"]]] * 2, rel=0.01, abs=1e-14)


@pytest.mark.usefixtures("few_batches")
def test_lights_behind_a_receiver_and_hidden_ones_bring_nothing(plain: None) -> None:
    hiding = {"integrator": {"type": "path", "hide_emitters": True}}
    sun = {"type": "directional", "direction": [0, 0, 1]}
    for light, more in ((point((0, 0, -1)), {}), (sun, {}), (point((0, 0, 2)), hiding)):
        assert both_readings(scene_of(rx=receiver(), light=light, **more)) == (0.0, 0.0)


@pytest.mark.usefixtures("few_batches")
def test_a_mirror_shows_the_image_of_a_light(plain: None) -> None:
    half = {"type": "twosided", "b": {"type": "conductor", "material": "none"}}
    half["b"]["specular_reflectance"] = 0.5
    mirror = rectangle((1, 0, 0), (0, 1, 0), -90, 4.0, half)
    place = np.array([0.3, 0.1, 2.0])
    image = np.array([1.7, 0.1, 2.0])

    def paths_of(light: Any) -> dict[Any, Any]:
        scene = scene_of(rx=receiver(), light=light, mirror=mirror)
        (part,) = pm.received_power(scene, spp=16).contributions
        return {path.mirrors: path for path in part.paths}

    paths = paths_of(point(place))
    assert paths[()].power == pytest.approx(area(SQUARE, place), rel=SINGLE)
    assert paths["mirror",].power == pytest.approx(0.5 * area(SQUARE, image), rel=SINGLE)
    assert paths["mirror",].length == pytest.approx(float(np.linalg.norm(image)), rel=1e-6)
    # The sun emits a plane wave, whose reflection arrives from the other side.
    sun = {"type": "directional", "direction": (-along(0.3, math.pi)).tolist(), "irradiance": ONE}
    effective = directivity(SQUARE, 0.3, 0.0) * WAVELENGTH**2 / (4 * math.pi)
    assert paths_of(sun)["mirror",].power == pytest.approx(0.5 * effective, rel=1e-4)


def test_diffuse_light_of_a_lamp_is_found_by_samples(plain: None) -> None:
    """A small plate in both far fields has the radiance rho I cos/(pi d^2)."""
    half, rho = 0.02, 0.5
    plate = rectangle((0, 0, 3), (1, 0, 0), 180, half, {"type": "diffuse", "reflectance": rho})
    # The light is behind the receiver, so there is no direct path.
    lamp = point((1.0, 0.0, -0.5))
    result = pm.received_power(scene_of(rx=receiver(), lamp=lamp, plate=plate), spp=512, seed=2)
    squared = 1.0 + 3.5**2
    radiance = rho / math.pi * (3.5 / math.sqrt(squared)) / squared
    expected = radiance * (2 * half) ** 2 * area(SQUARE, (0, 0, 3))
    assert result.direct == 0.0
    assert abs(result.scattered - expected) < 5 * result.standard_error + 0.01 * expected


def test_lamps_and_sources_add(plain: None) -> None:
    pose = facing(2.0)
    tx = emitter(pose=pose)
    lamp = point((0.2, 0, 2.5))
    result = pm.received_power(scene_of(rx=receiver(), tx=tx, lamp=lamp), spp=16)
    b = complex(pw.coupling(SQUARE, SQUARE, pose, WAVELENGTH))
    parts = {part.name: part for part in result.contributions}
    assert parts["tx"].direct == pytest.approx(abs(b) ** 2, rel=SINGLE)
    assert parts["other lights"].direct == pytest.approx(area(SQUARE, (0.2, 0, 2.5)), rel=SINGLE)
    record = result.to_dict()["emitters"][-1]["paths"][0]
    assert record["light"] == "lamp" and record["length_m"] == pytest.approx(math.hypot(0.2, 2.5))


def test_a_map_has_the_light_in_the_pixel_of_its_direction(plain: None) -> None:
    place = 2.0 * along(0.5, -0.7)
    scene = scene_of(rx=receiver(film=(8, 8)), lamp=point(place))
    image = pm.render(scene, spp=1)[..., 0]
    row, column = divmod(int(image.argmax()), 8)
    cosines = math.sin(0.5) * np.array([math.cos(0.7), -math.sin(0.7)])
    assert [column, row] == ((cosines + 1) * 4).astype(int).tolist()
    assert image.sum() == pytest.approx(area(SQUARE, place), rel=SINGLE)


@pytest.mark.usefixtures("few_batches")
def test_a_polarised_receiver_takes_half_of_a_lamp() -> None:
    mi.set_variant("scalar_spectral_polarized")
    lamp = point((0, 0, 2.0))
    plain, own = (
        float(pm.received_power(scene_of(rx=receiver(**how), lamp=lamp), spp=16))
        for how in ({"polarisation": "unpolarised"}, {"polarisation": "30 deg"})
    )
    assert plain == pytest.approx(area(SQUARE, (0, 0, 2.0)), rel=SINGLE)
    assert own == pytest.approx(plain / 2, rel=SINGLE)


def test_a_light_that_no_receiver_can_take_is_refused(plain: None) -> None:
    light = {"type": "rectangle", "id": "beam", "emitter": {"type": "directionalarea"}}
    scene = scene_of(rx=receiver(), beam=light)
    for read in (pm.render, pm.received_power):
        with pytest.raises(SceneError, match="single direction"):
            read(scene, spp=16)
    scene = scene_of(rx=receiver(obliquity="paper", estimator="wigner"), lamp=point((0, 0, 1)))
    with pytest.raises(SceneError, match="obliquity 'paper'"):
        pm.received_power(scene, spp=16)


def test_other_renderers_warn_of_lights_that_they_miss(plain: None) -> None:
    scene = scene_of(rx=receiver(), lamp=point((0, 0, 1)), integrator={"type": "path"})
    with pytest.warns(RuntimeWarning, match="from 'lamp' to a receiver; use"), pm.receiving(scene):
        assert not np.array(mi.render(scene, spp=4)).any()
