"""Silhouettes of concave, touching, crossing and surrounding bodies, and sequential shadows.

References are Kirchhoff's integral over visible surfaces for one body, and sequential Kirchhoff
integrals for two bodies (oracles.shadow_quadrature).
"""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

import polywigner as pw
from oracles.meshes import prism
from oracles.shadow_quadrature import (
    expected_ratio,
    point_radiator,
    sequential_field,
)
from polywigner.geometry.contours import net_contours
from polywigner.geometry.silhouettes import hits, obstacles_of
from polywigner.propagation.equivalent_points import RadiatingPoint
from polywigner.propagation.shadows import diffracted

# Error of edge waves at the default tolerance.
EXACT = 1e-8


def pose(angle: float = 0.0, axis: int = 0, shift: Any = (0.0, 0.0, 0.0)) -> np.ndarray:
    one, other = [k for k in range(3) if k != axis]
    result = np.eye(4)
    result[[one, other], [one, other]] = math.cos(angle)
    result[one, other], result[other, one] = -math.sin(angle), math.sin(angle)
    result[:3, 3] = shift
    return result


def turned(body: pw.Polyhedron, place: np.ndarray) -> pw.Polyhedron:
    return pw.Polyhedron(body.vertices @ place[:3, :3].T + place[:3, 3], body.faces)


def box(x: Any, y: Any, z: Any) -> pw.Polyhedron:
    return prism([(x[0], y[0]), (x[1], y[0]), (x[1], y[1]), (x[0], y[1])], *z)


def plate(width: float, height: float, place: np.ndarray) -> Any:
    return pw.shapes.rectangle(width, height).placed(place)


def ratio(source: Any, points: Any, bodies: Any) -> np.ndarray:
    """Return the field divided by the free field, for a wavelength of 1."""
    obstacles, place = obstacles_of(bodies, 1.0), np.array(source, float)
    seen = obstacles.silhouettes([place])
    point = RadiatingPoint(place, 0j, 1j)
    change, free, _ = diffracted(obstacles, [point], seen, np.array(points, float), "numpy")
    return 1.0 + change / free


def outside(bodies: Any, count: int, seed: int) -> np.ndarray:
    points = np.random.default_rng(seed).uniform((-4, -4, 0.5), (4, 4, 9), (2 * count, 3))
    return points[~obstacles_of(bodies, 1.0).inside(points)][:count]


L_OUTLINE = [(-3, -3), (3, -3), (3, -1), (0, -1), (0, 3), (-3, 3)]
TROUGH = prism(
    [(-2, 0), (2, 0), (2, 1.5), (1.8, 1.5), (1.8, 0.2), (-1.8, 0.2), (-1.8, 1.5), (-2, 1.5)], -1, 1
)
BODIES: dict[str, list[Any]] = {
    "L prism": [prism(L_OUTLINE, 2, 3)],
    "L sheet": [prism(L_OUTLINE, 2, 2 + 1e-4)],
    "thin sheet": [box((-2, 2), (-1, 1), (2, 2.1))],
    "trough towards the source": [turned(TROUGH, pose(-math.pi / 2, 0, (0, 0, 3)))],
    "trough from its side": [turned(TROUGH, pose(-0.4, 1, (0, 0, 3)))],
    "boxes side by side": [box((-2, 0), (-1, 1), (2, 3)), box((0, 1.5), (-1, 1), (2, 3))],
    "boxes that make a step": [box((-2, 0), (-1, 1), (2, 3)), box((0, 1.5), (-1.5, 0.7), (2, 4))],
}
SOURCES = [
    (0.3, 0.2, -5.0),
    (3.0, -2.0, -30.0),
    (0.3, 0.2, -3e3),
    (2e4, 1e4, -1e5),
    (1e5, 3e5, -1e6),
]


@pytest.mark.parametrize("source", SOURCES, ids=lambda s: f"{abs(s[2]):g}")
@pytest.mark.parametrize("name", BODIES)
def test_one_body_takes_away_kirchhoff_s_integral_over_what_the_source_sees(
    name: str, source: Any
) -> None:
    points = outside(BODIES[name], 3, 1)
    error = np.abs(
        ratio(source, points, BODIES[name]) - expected_ratio(source, points, BODIES[name])
    )
    # For distant sources, coordinates are rounded to 1e-16 of the distance.
    assert error.max() < max(EXACT, -3e-12 * source[2])


def test_silhouettes_do_not_depend_on_the_distance_of_the_source_beyond_its_direction() -> None:
    body, points = [prism(L_OUTLINE, 2, 3)], outside([prism(L_OUTLINE, 2, 3)], 6, 3)
    direction = np.array([0.3, 0.2, -1.0]) / math.sqrt(1.13)
    fields = [ratio(1e6 * scale * direction, points, body) for scale in (1.0, 10.0, 100.0)]
    assert np.abs(fields[1] - fields[2]).max() < 1e-5  # the wave front is less curved
    assert np.abs(fields[0] - fields[1]).max() < 1e-4


def test_edges_seen_from_within_a_convex_cone_are_those_of_the_mesh() -> None:
    """The silhouette of a convex body, by clipping and pairing, equals that of the mesh."""
    rng = np.random.default_rng(7)
    for _ in range(20):
        body = turned(box((-1, 1), (-0.7, 0.7), (-0.5, 0.5)), pose(rng.uniform(0, 6), 1, (0, 0, 4)))
        obstacles = obstacles_of([body], 1.0)
        source = rng.uniform(-3, 3, 3)
        if obstacles.inside(source[None])[0]:
            continue
        expected = obstacles.silhouette(source)
        result = net_contours(obstacles.surface([0], source), source)
        order = [np.lexsort(s.edges.reshape(-1, 6).round(9).T) for s in (expected, result)]
        assert np.abs(expected.edges[order[0]] - result.edges[order[1]]).max() < 1e-12


@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e3])
def test_corner_lines_of_plates_are_those_of_a_screen(scale: float) -> None:
    """On lines through the source and the corners, the derivatives of two edges diverge."""
    source = pw.PointSource((0.0, 0.0, -10.0 * scale))
    points = scale * np.array([(2, 2, 10), (2, 0.3, 10), (-2, 2, 10), (0.2, -2, 10)])
    outline = pw.shapes.square(2.0 * scale)
    expected = pw.amplitude(pw.Screen(outline, source), points, 1.0, "kirchhoff")
    result = pw.amplitude(source, points, 1.0, obstacles=outline.placed(pose()), engine="numpy")
    assert np.abs(result / expected - 1.0).max() < EXACT * max(scale, 1.0)


def test_apparent_crossing_of_two_edges_has_the_field_beside_it() -> None:
    bodies = [plate(2, 6, pose(shift=(0, 0, 4))), plate(9, 3, pose(shift=(0, 0, 8)))]
    # From (0, 0, -1), the edge x = 1 of the first plate crosses the edge y = 1.5 of the second
    # plate.
    source, crossing = np.array([0.0, 0.0, -1.0]), np.array([1.8, 1.5, 8.0])
    point = source + 1.7 * (crossing - source)
    beside = point + 1e-6 * np.array([[0, 0, 0], [1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0]])
    fields = ratio(source, beside, bodies)
    assert np.abs(fields[1:] - fields[0]).max() < 1e-5


def test_surface_behind_the_source_changes_the_field_by_its_diffracted_part() -> None:
    behind, source = plate(2, 2, pose(shift=(0, 0, -8))), (0.0, 0.0, -5.0)
    points = [(0.0, 0.0, 10.0), (0.5, 0.2, 3.0)]
    result = ratio(source, points, [behind])
    assert np.abs(result - expected_ratio(source, points, [behind])).max() < EXACT
    assert np.abs(result - 1.0).max() < 0.03


def test_housing_around_a_source_leaves_its_opening() -> None:
    """The housing is five sides of a cube; the reference is Kirchhoff's surface integral."""
    source = np.array([0.1, 0.0, 0.2])
    sides = [plate(4, 4, pose(shift=(0, 0, -2)))]
    sides += [plate(4, 4, pose(math.pi / 2, 1, (x, 0, 0))) for x in (-2.0, 2.0)]
    sides += [plate(4, 4, pose(math.pi / 2, 0, (0, y, 0))) for y in (-2.0, 2.0)]
    points = np.random.default_rng(2).uniform((-5, -5, -5), (5, 5, 7), (10, 3))
    points = points[np.abs(points).max(axis=1) > 2.1]
    result = ratio(source, points, sides)
    assert np.abs(result - expected_ratio(source, points, sides)).max() < EXACT


def test_plates_seen_edge_on_have_no_silhouette() -> None:
    edge_on = obstacles_of([plate(1, 1, pose()), plate(2, 1, pose(shift=(0.2, 0, 0)))], 1.0)
    assert len(edge_on.silhouette(np.array([5.0, 0.0, 0.0])).edges) == 0


def crosses(bodies: list[Any], points: np.ndarray) -> np.ndarray:
    """Return which steps between points cross a surface."""
    obstacles = obstacles_of(bodies, 1.0)
    corners = np.concatenate([body.vertices[body.triangles] for body in obstacles.bodies])
    return np.array(
        [
            any((share <= 1.0).any() for _, share, _ in hits(corners - here, (there - here)[None]))
            for here, there in pairwise(points)
        ]
    )


@pytest.mark.parametrize("seed", range(6))
def test_field_is_continuous_in_free_space_around_bodies_behind_each_other(seed: int) -> None:
    rng = np.random.default_rng(seed)
    source = np.array([*rng.uniform(-2, 2, 2), -rng.choice([5.0, 20.0, 300.0])])
    bodies: list[Any] = []
    for k in range(3):
        place = np.eye(4)
        place[:3, :3] = np.linalg.qr(rng.normal(size=(3, 3)))[0]
        place[:3, 0] *= np.linalg.det(place[:3, :3])
        place[:3, 3] = [*rng.uniform(-1.5, 1.5, 2), 1.5 + 2.5 * k]
        sizes = rng.uniform(0.5, 2.5, 3)
        if rng.random() < 0.4:
            block = box(*(np.outer(sizes, [-0.5, 0.5])))
            bodies.append(turned(block, place))
        else:
            bodies.append(plate(*sizes[:2] * 1.5, place))
    obstacles = obstacles_of(bodies, 1.0)
    share = np.linspace(0.0, 1.0, 4001)[:, None]
    points = (1 - share) * rng.uniform((-4, -4, 0.2), (4, 4, 10)) + share * rng.uniform(
        (-4, -4, 0.2), (4, 4, 10)
    )
    steps = np.abs(np.diff(ratio(source, points, bodies)))
    beside = np.maximum(np.append(steps[1:], 0.0), np.append(0.0, steps[:-1]))
    (jumps,) = np.nonzero(steps > 3 * beside + 3e-4)
    inside = obstacles.inside(points)
    jumps = [
        k
        for k in jumps
        if not inside[k : k + 2].any() and not crosses(bodies, points[k : k + 2]).any()
    ]
    assert jumps == []


def test_wall_behind_a_plate_is_as_dark_as_the_wall_alone_and_has_the_plate_s_fringes() -> None:
    """Kirchhoff's wall alone has -36.3 dB here; complete shadow boundaries would add 2.9 dB."""
    wall, source = plate(40, 40, pose(shift=(0, 0, 6))), (0.0, 0.0, -5.0)
    small = plate(2, 2, pose(shift=(0, 0, 2)))
    behind = [(0.0, 0.0, 8.0), (1.0, 2.0, 8.0), (-3.0, 0.5, 6.5)]
    alone, both = (ratio(source, behind, bodies) for bodies in ([wall], [small, wall]))
    assert np.abs(both - alone).max() < 1e-3
    assert 20 * np.log10(np.abs(both)).max() < -35
    x = np.linspace(-5, 5, 21)
    on_wall = np.stack([x, 0.3 + 0 * x, 6.0 + 0 * x], axis=1)
    alone, both, rim = (ratio(source, on_wall, b) for b in ([small], [small, wall], [wall]))
    assert (np.abs(both - alone) < np.abs(rim - 1.0) + 1e-3).all()
    assert np.abs(alone - 1.0).max() > 0.5


@pytest.mark.slow
def test_plate_behind_a_plate_is_near_sequential_kirchhoff() -> None:
    rng = np.random.default_rng(4)
    scenes: list[Any] = [
        (
            (0.3, 0.2, -5.0),
            plate(3, 2, pose(0.3, 0, (1.2, 0.2, 1.5))),
            plate(4, 4, pose(0.5, 1, (-0.3, 0, 5))),
            0.12,
        ),
        (
            (0.5, 0.0, -8.0),
            plate(2.5, 2, pose(shift=(0.4, 0.1, 2))),
            plate(5, 4, pose(shift=(0, 0, 3))),
            0.06,
        ),
    ]
    for source, first, second, largest in scenes:
        points = rng.uniform((-4, -4, 6), (4, 4, 10), (8, 3))
        radiator = point_radiator(source)
        expected = sequential_field([first, second], radiator, points) / radiator.field(points)
        result = ratio(source, points, [first, second])
        assert np.sqrt(np.mean(np.abs(result - expected) ** 2)) < largest


@pytest.mark.parametrize("width", [40.0, 400.0, 4000.0])
def test_plates_that_look_wider_than_a_half_space_throw_their_shadow(width):
    plate = pw.Aperture([[-width, -width], [width, -width], [width, 4.0], [-width, 4.0]])
    to_world = np.array([[0.0, 0, 1, 8], [1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 0, 1]])
    point = np.array([[16.0, 0.0, 2.0]])
    field = pw.amplitude(
        pw.PointSource((0.0, 0.0, 0.0)), point, 1.0, obstacles=plate.placed(to_world)
    )
    # The straight edge at z = 4 alone; its far ends change the field by less than 2 %.
    assert 20 * np.log10(np.abs(field[0]) * np.linalg.norm(point)) == pytest.approx(-20.4, abs=0.2)
