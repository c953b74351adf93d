"""Nodes of a source: their fields in free space, their number, and shadows."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import polywigner as pw
from mitsuba_scenes import use
from polywigner.geometry.silhouettes import Obstacles, obstacles_of
from polywigner.mitsuba.plugins import diffraction
from polywigner.mitsuba.plugins.shadow_tables import edge_tables
from polywigner.mitsuba.scenes import surfaces
from polywigner.propagation import source_nodes
from polywigner.propagation.equivalent_points import RadiatingPoint, radiating_points
from polywigner.propagation.shadows import diffracted
from polywigner.propagation.source_nodes import all_points, nodes_for
from test_shadows_in_scenes import BLACK, FLOOR, WAVELENGTH, box, mi, on_floor, scene, transform

RS1 = "rayleigh-sommerfeld-1"


def edges_at(z: float) -> np.ndarray:
    return np.array([[[-10.0, 3.0, z], [10.0, 3.0, z]]])


def points_of(side: float) -> list[RadiatingPoint]:
    return radiating_points(pw.shapes.rectangle(side, 0.6 * side), 1.0, RS1, 3e-4)


def square_at(side: float, z: float) -> Any:
    pose = np.eye(4)
    pose[2, 3] = z
    return pw.shapes.square(side).placed(pose)


def test_waves_of_nodes_are_the_wave_of_the_source() -> None:
    points = points_of(3.0)
    nodes = nodes_for(points, edges_at(80.0))
    assert 1 < len(nodes.positions) < len(points)
    assert nodes.fractions.sum(axis=0) == pytest.approx(np.ones(len(points)), abs=1e-12)
    waves, _ = nodes.waves_at(np.array([[1.0, 2.0, 30.0]]))
    place = np.array([[1.0, 2.0, 30.0]])
    expected = sum(point.wave(place.T) for point in points)
    distance = np.linalg.norm(place - nodes.centre)
    assert np.abs(waves[:, -1]) / distance == pytest.approx(np.abs(expected), rel=1e-12)


def test_nearer_edges_need_more_nodes() -> None:
    counts = [
        len(nodes_for(points_of(3.0), edges_at(z)).positions) for z in (1e4, 200.0, 30.0, 3.0)
    ]
    assert counts[0] == 1
    assert counts == sorted(counts)
    assert counts[-1] > counts[1]
    point = [RadiatingPoint(np.zeros(3), 0j, 1 + 0j)]
    assert len(nodes_for(point, edges_at(1.0)).positions) == 1


def test_peak_is_that_of_the_far_field() -> None:
    nodes = all_points(radiating_points(pw.shapes.square(3.0), 1.0, "rayleigh-sommerfeld-2", 3e-4))
    assert nodes.peak == pytest.approx(9.0, rel=1e-3)


@pytest.mark.parametrize("is_above", [False, True])
def test_points_share_a_silhouette_that_moves_with_none_of_them(is_above: bool) -> None:
    def plate(side: float, x: float, z: float) -> Any:
        pose = np.eye(4)
        pose[:3, 3] = x, 0.0, z
        return pw.shapes.square(side).placed(pose)

    # The shadow of the first plate crosses an edge of the second plate, or lies inside the second
    # plate.
    bodies = obstacles_of(
        [plate(2.0, 0.0, 40.0), plate(30.0, 16.0 if is_above else 0.0, 80.0)], 1.0
    )
    seen = [bodies.silhouette(np.array([x, x, 0.0])) for x in (0.0, -1.5, 1.5)]
    assert all(silhouette.is_like(seen[0]) for silhouette in seen) == (not is_above)


def test_pieces_of_an_edge_are_joined_and_nodes_have_edges_in_common() -> None:
    # The floor is wide, so that its edges need six pyramids.
    bodies = obstacles_of([square_at(25.0, 47.0), square_at(630.0, 94.0)], 1.0)
    nodes = nodes_for(points_of(3.0), bodies.silhouette(np.zeros(3)).edges)
    seen = [bodies.silhouette(position) for position in nodes.positions]
    assert max(len(silhouette.edges) for silhouette in seen) > 8
    tables = edge_tables(bodies, nodes, seen, 1e-5)
    assert len(tables.edges) == 8
    assert (tables.edges[:, 10:12] == [0, len(nodes.positions)]).all()


def test_edges_without_length_in_single_precision_are_dropped() -> None:
    """The waves of such edges would be NaN in compiled kernels."""
    bodies = obstacles_of([square_at(250.0, 470.0)], 1.0)
    nodes = nodes_for(points_of(3.0), bodies.silhouette(np.zeros(3)).edges)
    seen = [bodies.silhouette(position) for position in nodes.positions]
    full = seen[4]
    corner = full.edges[:1, :1] * [[[1.0], [1.0 + 1e-10]]]
    columns = {
        name: np.concatenate([getattr(full, name), getattr(full, name)[:1]])
        for name in ("numbers", "bodies", "behind", "planes")
    }
    seen[4] = replace(full, edges=np.concatenate([full.edges, corner]), **columns)
    ends = edge_tables(bodies, nodes, seen, 1e-5).ends.astype(np.float32)
    assert (ends[:, :3] != ends[:, 3:6]).any(axis=1).all()


@pytest.mark.drjit
@pytest.mark.llvm
def test_picture_from_few_nodes_is_the_picture_from_all_points(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    import polywigner.mitsuba as pm

    use("llvm_ad_mono")
    plate = transform().translate([-0.08, 0.07, 0.15]).scale(0.01)
    bodies = {
        "box": box(),
        "plate": {"type": "rectangle", "to_world": plate, "bsdf": BLACK},
    }
    few = pm.render(scene(12, bodies), "direct", spp=1, seed=3)
    monkeypatch.setattr(source_nodes, "_LIMITS", {})
    every = pm.render(scene(12, bodies), "direct", spp=1, seed=3)
    assert 0.0 < np.abs(few - every).max() < 1e-3 * on_floor(12, 1).max()


def shadows_of(made: Any) -> Any:
    """Return the shadows of the only source of a scene."""
    diffraction.cast_shadows(made)
    (emitter,) = surfaces.wigner_emitters(made)
    return emitter.estimator._shadows


def intensities(shadows: Any, points: np.ndarray) -> np.ndarray:
    """Return |U|^2 at points in metres in the frame of the source."""
    columns = [mi.Float(np.ascontiguousarray(column)) for column in points.T.astype(np.float32)]
    return np.array(shadows.intensity(mi.Point3f(*columns)))


def error_on_floor(
    side: float, bodies: dict[str, Any], low: float = -0.098, high: float = 0.099
) -> float:
    """Return the largest error of |U|^2, relative to its peak without bodies in this range of x."""
    source = pw.shapes.square(side)
    made = scene(2, bodies, source=source)
    x, y = np.meshgrid(np.linspace(low, high, 30), np.linspace(-0.098, 0.099, 30))
    points = np.stack([x, y, np.full_like(x, FLOOR)], axis=-1).reshape(-1, 3)
    result = intensities(shadows_of(made), points)
    obstacles = Obstacles(
        [
            surfaces.in_frame(body, np.eye(4), 1.0 / WAVELENGTH)
            for body in surfaces.bodies_of(surfaces.meshes_in(made, WAVELENGTH))
        ]
    )
    radiating = radiating_points(source, WAVELENGTH, RS1, 3e-4)
    seen = [obstacles.silhouette(point.position) for point in radiating]
    at = points / WAVELENGTH * (1.0 - 1e-6)
    change, free, _ = diffracted(obstacles, radiating, seen, at, "numpy", tolerance=1e-4)
    expected = np.abs(free + change) ** 2
    return float(np.abs(result - expected).max() / (np.abs(free) ** 2).max())


@pytest.mark.drjit
@pytest.mark.llvm
def test_waves_of_a_small_source_have_their_obliquity_along_edges() -> None:
    use("llvm_ad_mono")
    plate = transform().translate([0.0, 0.0, 0.15]).scale(0.04)
    bodies = {"plate": {"type": "rectangle", "to_world": plate, "bsdf": BLACK}}
    assert error_on_floor(0.5e-3, bodies) < 8e-4


def cubes(**poses: Any) -> dict[str, Any]:
    return {name: {"type": "cube", "to_world": pose, "bsdf": BLACK} for name, pose in poses.items()}


@pytest.mark.drjit
@pytest.mark.llvm
def test_shadow_lines_on_a_wall_move_with_the_nodes() -> None:
    use("llvm_ad_mono")
    wall = transform().translate([0.0, 0.0, 0.2]).scale([0.04, 0.04, 0.005])
    post = transform().translate([0.02, 0.003, 0.17]).scale([0.004, 0.008, 0.025])
    assert error_on_floor(4e-3, cubes(wall=wall, post=post)) < 2e-3


@pytest.mark.drjit
@pytest.mark.llvm
def test_block_hides_points_in_front_of_one_of_its_faces_from_an_edge() -> None:
    use("llvm_ad_mono")
    # The bar is in front of two faces of the block, and its midpoint is behind the plane of one
    # face.
    bar = transform().translate([0.01, 0.0, 0.166]).scale([0.014, 0.004, 0.001])
    block = transform().translate([0.0, 0.0, 0.2124]).rotate([0, 1, 0], 45).scale(0.03)
    assert error_on_floor(1e-3, cubes(bar=bar, block=block), -0.14, -0.12) < 2e-4


@pytest.mark.slow
@pytest.mark.drjit
@pytest.mark.llvm
def test_nodes_of_a_source_see_different_silhouettes_of_a_ball() -> None:
    use("llvm_ad_mono")
    bodies = {"ball": {"type": "sphere", "center": [0, 0.01, 0.15], "radius": 0.02, "bsdf": BLACK}}
    assert error_on_floor(4e-3, bodies) < 3e-3


@pytest.mark.slow
@pytest.mark.drjit
@pytest.mark.llvm
def test_points_on_far_walls_are_not_behind_them_in_single_precision() -> None:
    import polywigner.mitsuba as pm

    use("llvm_ad_mono")
    example = Path(__file__).parents[1] / "examples/street_77ghz/scene.xml"
    shadows = shadows_of(pm.load_scene(example, diffraction=True))
    # A kerb at grazing incidence, and a wall behind a pillar, in metres in the source's frame.
    points = np.array([[2.351512, -0.665311, 10.125941], [4.702853, 0.622157, 11.324124]])
    # Expected |U|^2 in double precision, from all points of the source with separate silhouettes.
    expected = np.array([8.471e-8, 4.777e-8])
    assert intensities(shadows, points) == pytest.approx(expected, rel=1e-2)
