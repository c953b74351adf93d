"""Walls close to an end of a long path, and surfaces that contain an end."""

from __future__ import annotations

import gc
from typing import Any

import numpy as np
import pytest

import mitsuba_scenes
import polywigner as pw
from mitsuba_scenes import (
    BLACK,
    METAL,
    SQUARE,
    WAVELENGTH,
    camera,
    emitter,
    lit,
    receiver,
    scene_of,
)  # fmt: skip

pytestmark = [pytest.mark.drjit, pytest.mark.usefixtures("few_rays")]
pm = pytest.importorskip("polywigner.mitsuba")
import mitsuba as mi  # noqa: E402 (after the package, which chooses the LLVM library)

WHITE = {"type": "twosided", "b": {"type": "diffuse", "reflectance": 0.5}}
# Relative error of the poses of a scene, which are in single precision.
SINGLE = 2e-6
AHEAD = np.array([0.6, 0.2, 0.77]) / np.linalg.norm([0.6, 0.2, 0.77])


def looking(position: Any, direction: Any) -> np.ndarray:
    return mitsuba_scenes.looking(position, direction, (0.1, 1.0, 0.0))


def plate(pose: np.ndarray, half: float, ahead: float = 0.0, bsdf: Any = BLACK) -> dict[str, Any]:
    """Return a square in the plane of a pose, or at a distance in front of it."""
    moved = pose.copy()
    moved[:3, 3] += ahead * pose[:3, 2]
    to_world = mi.ScalarTransform4f(moved.tolist()) @ mi.ScalarTransform4f().scale(half)
    return {"type": "rectangle", "to_world": to_world, "bsdf": bsdf}


def link(one: np.ndarray, other: np.ndarray, **parts: Any) -> Any:
    return scene_of(tx=emitter(pose=one), rx=receiver(pose=other), **parts)


@pytest.fixture
def compiled() -> None:
    mi.set_variant("llvm_ad_mono")


def test_a_wall_close_to_either_end_blocks_a_link(
    plain: None,
) -> None:
    one = looking((50, -20, 10), AHEAD)
    other = looking(np.add((50, -20, 10), 100.0 * AHEAD), -AHEAD)
    free = link(one, other)
    expected = abs(complex(pw.coupling(SQUARE, SQUARE, np.linalg.inv(one) @ other, WAVELENGTH)))
    assert pm.received_power(free, spp=16).direct == pytest.approx(expected**2, rel=1e-4)
    for end in (one, other):
        walled = link(one, other, wall=plate(end, 0.2, 1e-3))
        result = pm.received_power(walled, spp=16)
        assert float(result) == 0.0
        assert any("obstacles block it" in note for note in result.notes)
        assert np.abs(pm.channel(walled).h.values).max() == 0.0


def test_a_wall_half_before_either_end_takes_half_of_the_power(
    plain: None, many_rays: None
) -> None:
    """Both ends give the same result by reciprocity."""
    one, other = looking((3, 2, 1), AHEAD), looking(np.add((3, 2, 1), 100.0 * AHEAD), -AHEAD)
    free = pm.received_power(link(one, other), spp=16).direct
    for end in (one, other):
        beside = end.copy()
        beside[:3, 3] += 0.2 * end[:3, 0]
        half = pm.received_power(link(one, other, wall=plate(beside, 0.2, 0.02)), spp=16).direct
        assert half / free == pytest.approx(0.5, abs=0.01)


@pytest.mark.parametrize(("half", "length"), [(0.05, 100.0), (60.0, 1.0)])
def test_a_plate_in_the_plane_of_an_end_blocks_nothing(
    plain: None, half: float, length: float
) -> None:
    """Ends are on walls with rounded corners, also on two walls that Mitsuba merges."""
    rng = np.random.default_rng(3)
    for _ in range(2):
        start, towards = rng.normal(size=(2, 3)) * [[20.0], [1.0]]
        towards /= np.linalg.norm(towards)
        one, other = looking(start, towards), looking(start + length * towards, -towards)
        free = pm.received_power(link(one, other), spp=16).direct
        on_walls = link(one, other, a=plate(one, half), b=plate(other, half))
        assert pm.received_power(on_walls, spp=16).direct == pytest.approx(free, rel=SINGLE)


def test_a_wall_close_to_an_end_blocks_the_path_by_a_mirror(plain: None) -> None:
    floor = plate(looking((50, 0, 0), (0, 0, 1)), 100.0, bsdf=METAL)
    slant = np.array([50.0, 0.0, -20.0]) / np.hypot(50.0, 20.0)
    one, other = looking((0, 0, 20), slant), looking((100, 0, 20), slant * [-1, 1, 1])
    free = pm.received_power(link(one, other, floor=floor), spp=16)
    assert ("floor",) in {path.mirrors for path in free.contributions[0].paths}
    for end in (one, other):
        walled = pm.received_power(link(one, other, floor=floor, wall=plate(end, 0.3, 0.05)), 16)
        assert ("floor",) not in {path.mirrors for path in walled.contributions[0].paths}
    close = plate(looking((50, 0, 5e-3), (0, 0, 1)), 2.0)  # above the point of reflection
    walled = pm.received_power(link(one, other, floor=floor, wall=close), 16)
    assert ("floor",) not in {path.mirrors for path in walled.contributions[0].paths}


def test_both_sides_of_a_thin_plate_far_from_the_origin_are_told_apart(plain: None) -> None:
    """A sheet of 5 mm, 90 m from the origin, has one image instead of two."""
    to_world = mi.ScalarTransform4f().translate([90, 0, 0]).scale([3.0, 3.0, 2.5e-3])
    sheet = {"type": "cube", "to_world": to_world, "bsdf": METAL}
    one, other = looking((89.5, 0, 1), (0.5, 0, -1)), looking((90.5, 0, 1), (-0.5, 0, -1))
    result = pm.received_power(link(one, other, sheet=sheet), spp=16, reflections=1)
    assert len([path for path in result.contributions[0].paths if path.mirrors]) == 1


def over_a_floor(distance: float, estimator: str, **parts: Any) -> tuple[Any, Any, Any]:
    """Return a floor that a distant source illuminates, and the poses of both ends."""
    one = looking([30, -distance, 20], [0, 1, 0.1])
    middle = [30, 0, 20 + 0.1 * distance]
    other = looking(np.add(middle, (1, -2, 0)), [-1, 2, 0])
    floor = plate(looking(middle, [0.3, -1, 0]), 4.0, bsdf=WHITE)
    made = {name: make(one, other) for name, make in parts.items() if callable(make)}
    rest = {name: part for name, part in parts.items() if not callable(part)}
    scene = scene_of(
        tx=emitter(pose=one, estimator=estimator),
        rx=receiver(pose=other, estimator=estimator),
        floor=floor,
        **made,
        **rest,
    )
    return scene, one, other


@pytest.mark.slow
@pytest.mark.llvm
@pytest.mark.parametrize("estimator", ["exact", "wigner"])
@pytest.mark.usefixtures("few_batches")
def test_a_wall_close_to_either_end_blocks_scattered_light(compiled: None, estimator: str) -> None:
    free, *_ = over_a_floor(100.0, estimator)
    expected = pm.received_power(free, spp=4096, seed=1).scattered
    assert expected > 0.0
    for wall in (
        lambda one, other: plate(one, 0.3, 0.08),
        lambda one, other: plate(other, 0.3, 2e-3),
    ):
        scene, *_ = over_a_floor(100.0, estimator, wall=wall)
        assert pm.received_power(scene, spp=256, seed=1).scattered == 0.0
    assert float(np.abs(pm.scatterers(scene, 100).power.values).sum()) == 0.0
    on_a_wall, *_ = over_a_floor(100.0, estimator, wall=lambda one, other: plate(one, 20.0))
    result = pm.received_power(on_a_wall, spp=4096, seed=1).scattered
    assert result == pytest.approx(expected, rel=1e-4)


@pytest.mark.slow
@pytest.mark.llvm
@pytest.mark.parametrize("integrator", ["volpath", "prb"])
@pytest.mark.usefixtures("few_batches")
def test_a_wall_close_to_a_source_blocks_the_samples_of_each_integrator(
    compiled: None, integrator: str
) -> None:
    method = {"integrator": {"type": integrator}}
    free, *_ = over_a_floor(100.0, "exact", **method)
    scene, *_ = over_a_floor(100.0, "exact", wall=lambda one, _: plate(one, 0.3, 0.08), **method)
    assert pm.received_power(free, spp=256, seed=1).scattered > 0.0
    assert pm.received_power(scene, spp=256, seed=1).scattered == 0.0


@pytest.mark.llvm
def test_a_wall_close_to_a_source_darkens_the_image_of_a_camera(compiled: None) -> None:
    seen = camera((31, -3, 30), (30, 0, 30), 4, up=(0, 0, 1))
    images = []
    for ahead in (-0.08, 0.08):
        scene = None
        gc.collect()  # the next scene has the same kernels
        scene, *_ = over_a_floor(
            100.0, "exact", camera=seen, wall=lambda one, _, ahead=ahead: plate(one, 0.3, ahead)
        )
        sensor = [s.class_name() for s in scene.sensors()].index("PerspectiveCamera")
        images.append(pm.render(scene, spp=64, sensor=sensor))
    assert np.abs(images[0]).max() > 0.0 and not images[1].any()


@pytest.mark.llvm
def test_a_wall_close_to_a_source_blocks_light_that_diffracts(compiled: None) -> None:
    """Behind a wide plate at 2 mm on a path of 100 m, edge waves dominate."""
    pose = np.eye(4)
    floor = plate(looking((0, 0, 100.0), (0, 0, -1)), 1.0, bsdf=WHITE)
    seen = camera((0, 0, 99), (0, 0, 100), 1, 1.0)
    source = emitter(estimator="exact", diffraction=True)
    scene = scene_of(tx=source, floor=floor, camera=seen, wall=plate(pose, 0.3, 2e-3))
    (free,) = 0.5 / np.pi * lit(SQUARE, np.array([[0.0, 0.0, 100.0]]), np.array([0.0, 0.0, -1.0]))
    assert pm.render(scene, "direct", spp=16).max() < 1e-3 * free
