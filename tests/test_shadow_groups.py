"""Shadows of bodies in contact, and of separate bodies.

References are Kirchhoff's integrals over the visible surfaces of the same solid, as one body or as
bodies without common volume (oracles.shadow_quadrature). The wavelength is 1.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

import polywigner as pw
from oracles.meshes import box, hollow, prism
from oracles.shadow_quadrature import expected_ratio
from polywigner.geometry.silhouettes import obstacles_of
from polywigner.propagation.shadows import blocked_edges

# Error of edge waves at the default tolerance.
EXACT = 2e-8


def one_mesh(*bodies: pw.Polyhedron) -> pw.Polyhedron:
    """Return all surfaces in one mesh."""
    first = np.cumsum([0, *(len(body.vertices) for body in bodies)])
    faces = [[k + n for k in f] for body, n in zip(bodies, first, strict=False) for f in body.faces]
    return pw.Polyhedron(np.concatenate([body.vertices for body in bodies]), faces)


def plate(width: float, height: float, shift: Any = (0, 0, 0), upright: bool = False) -> Any:
    pose = np.eye(4)
    if upright:
        pose[:3, :3] = [[0, 0, 1], [1, 0, 0], [0, 1, 0]]
    pose[:3, 3] = shift
    return pw.shapes.rectangle(width, height).placed(pose)


def ratio(source: Any, points: Any, bodies: Any) -> np.ndarray:
    lamp, points = pw.PointSource(source), np.array(points, float)
    behind = pw.amplitude(lamp, points, 1.0, obstacles=bodies, engine="numpy")
    return behind / pw.amplitude(lamp, points, 1.0)


def level(values: np.ndarray) -> np.ndarray:
    return 20 * np.log10(np.abs(values))


# Source, points, and the solid as bodies whose surfaces the quadrature can distinguish.
SOLIDS: dict[str, tuple[Any, Any, list[Any]]] = {
    "plus": (
        (0.3, -0.2, -7.0),
        [(-0.55, 0.32, 3.72), (1.6, -1.2, 5.0), (-2.4, 0.3, -2.0)],
        [prism([(-1, -3), (1, -3), (1, -1), (3, -1), (3, 1), (1, 1),
                (1, 3), (-1, 3), (-1, 1), (-3, 1), (-3, -1), (-1, -1)], 0, 1.5)],
    ),
    "T": (
        (6.0, 5.0, -4.0),
        [(-3.432, -0.769, 0.064), (3.385, -5.719, 0.576), (-1.2, 2.1, 0.7)],
        [prism([(-3, -0.3), (3, -0.3), (3, 0), (0.2, 0), (0.2, 3), (-0.2, 3), (-0.2, 0), (-3, 0)],
               -2, 2)],
    ),
    "L": (
        (-3.0, 8.0, -3.0),
        [(-4.739, -6.626, 2.111), (-1.724, -1.796, 0.553), (1.5, 2.0, 0.5)],
        [prism([(-3, -0.3), (3, -0.3), (3, 0), (-2.7, 0), (-2.7, 3), (-3, 3)], -2, 2)],
    ),
    "tower": (
        (0.1, 0.2, 15.0),
        [(0.24, -0.45, -2.56), (-3.0, 1.0, -1.5), (1.8, 0.9, 2.2)],
        [box((-2, -1.5, 0), (2, 1.5, 1)), box((-0.5, -0.7, 1), (1, 0.6, 3))],
    ),
}  # fmt: skip
_BAR, _WALL = box((-3, -1, 0), (3, 1, 1.5)), box((-3, -0.3, -2), (3, 0, 2))
_BASE = box((-2, -1.5, 0), (2, 1.5, 1))
DRAWN: dict[tuple[str, str], list[Any]] = {
    ("plus", "crossing"): [_BAR, box((-1, -3, 0), (1, 3, 1.5))],
    ("plus", "crossing in one mesh"): [one_mesh(_BAR, box((-1, -3, 0), (1, 3, 1.5)))],
    ("plus", "butted"): [_BAR, box((-1, -3, 0), (1, -1, 1.5)), box((-1, 1, 0), (1, 3, 1.5))],
    ("T", "crossing"): [_WALL, box((-0.2, -0.3, -2), (0.2, 3, 2))],
    ("T", "butted"): [_WALL, box((-0.2, 0, -2), (0.2, 3, 2))],
    ("T", "in one mesh"): [one_mesh(_WALL, box((-0.2, 0, -2), (0.2, 3, 2)))],
    ("L", "crossing"): [_WALL, box((-3, -0.3, -2), (-2.7, 3, 2))],
    ("L", "butted"): [_WALL, box((-3, 0, -2), (-2.7, 3, 2))],
    ("tower", "touching"): [_BASE, box((-0.5, -0.7, 1), (1, 0.6, 3))],
    ("tower", "crossing"): [_BASE, box((-0.5, -0.7, 0.5), (1, 0.6, 3))],
    ("tower", "in one mesh"): [one_mesh(_BASE, box((-0.5, -0.7, 1), (1, 0.6, 3)))],
}


@cache
def of_solid(name: str) -> np.ndarray:
    return expected_ratio(*SOLIDS[name])


@pytest.mark.parametrize(("name", "drawn"), DRAWN)
def test_a_solid_throws_one_shadow_however_it_is_drawn(name: str, drawn: str) -> None:
    source, points, _ = SOLIDS[name]
    error = np.abs(ratio(source, points, DRAWN[name, drawn]) - of_solid(name))
    assert error.max() < EXACT


@pytest.mark.parametrize("seed", [0, 2, 6, 13])
def test_tilted_boxes_that_cross_take_away_kirchhoff_s_integral_over_both(seed: int) -> None:
    rng, bodies = np.random.default_rng(seed), []
    for _ in range(2):
        turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
        turn[:, 0] *= np.linalg.det(turn)
        half = rng.uniform(0.3, 1.5, 3)
        body = box(-half, half)
        place = rng.uniform((-0.7, -0.7, 2.3), (0.7, 0.7, 3.7))
        bodies.append(pw.Polyhedron(body.vertices @ turn.T + place, body.faces))
    assert len(obstacles_of(bodies, 1.0).contacts) == 1
    source = np.array([*rng.uniform(-2, 2, 2), -rng.choice([3.0, 10.0, 100.0])])
    points = rng.uniform((-4, -4, -1), (4, 4, 8), (8, 3))
    points = points[~obstacles_of(bodies, 1.0).inside(points)][:3]
    expected = expected_ratio(source, points, bodies)
    assert np.abs(ratio(source, points, bodies) - expected).max() < EXACT
    assert np.abs(ratio(source, points, one_mesh(*bodies)) - expected).max() < EXACT


GAPS = (3.0, 0.0, -8.0), [(0.0, 0.0, 3.0), (-1.0, 0.0, 4.0), (-2.0, 0.5, 6.0)]


def halves(gap: float) -> list[Any]:
    return [box((-6, -6, 0), (0, 6, 1)), box((gap, -6, 0), (6, 6, 1))]


@pytest.mark.parametrize("gap", [0.0, 1e-7, 1e-5, 1e-3])
def test_a_gap_far_below_the_wavelength_is_closed(gap: float) -> None:
    wall = expected_ratio(*GAPS, [box((-6, -6, 0), (6, 6, 1))])
    assert np.abs(ratio(*GAPS, halves(gap)) - wall).max() < EXACT + 0.5 * gap


def test_a_gap_of_a_tenth_of_a_wavelength_is_open() -> None:
    bodies = [box((-2, -1, 0), (0, 1, 1)), box((0.1, -1, 0), (2, 1, 1))]
    source, points = (0.3, -0.2, -7.0), [(-0.55, 0.32, 3.72), (0.0, 0.0, 5.0), (2.0, 1.0, 4.0)]
    expected = expected_ratio(source, points, bodies)
    closed = ratio(source, points, [box((-2, -1, 0), (2, 1, 1))])
    assert np.abs(ratio(source, points, bodies) - expected).max() < EXACT
    assert np.abs(closed - expected).max() > 0.05


def test_bodies_apart_in_one_mesh_block_one_another() -> None:
    """A sum over all visible surfaces has +3.3 dB at the first point, the wall -30.6 dB."""
    source, points = (0.0, 0.0, -5.0), [(0, 0, 12), (1, 1, 10), (3, -2, 8)]
    small, wall = box((-1, -1, 0), (1, 1, 0.2)), box((-15, -15, 6), (15, 15, 6.2))
    together = ratio(source, points, one_mesh(small, wall))
    assert np.abs(together - ratio(source, points, [small, wall])).max() < 1e-12
    alone = expected_ratio(source, points, [wall])
    assert np.abs(level(together) - level(alone)).max() < 0.5


@pytest.mark.parametrize("floor", ["plate", "slab"])
def test_a_floor_does_not_make_one_body_of_what_stands_on_it(floor: str) -> None:
    """A sum over all visible surfaces would give 0.25 of the free field behind the wall."""
    source, points = (-12.0, 1.0, 14.0), [(9, 0.5, 1), (10, 2, 2), (9, -3, 0.5), (14, 0, 3)]
    ground = {"plate": plate(60, 60), "slab": box((-30, -30, -1), (30, 30, 0))}[floor]
    bodies = [box((-2, -2, 0), (2, 2, 4)), box((6, -10, 0), (6.5, 10, 9))]
    apart = ratio(source, points, bodies)
    assert np.abs(ratio(source, points, [*bodies, ground]) - apart).max() < 0.06


def test_joints_of_a_wall_do_not_let_pass_what_a_plate_before_it_bends() -> None:
    source, points = (0.0, 0.0, -5.0), [(0, 0, 12), (1, 1, 10), (3, -2, 8)]
    small, x = plate(2, 2), np.linspace(-15, 15, 6)
    parts = [box((a + 1e-4, -15, 6), (b, 15, 6.2)) for a, b in pairwise(x)]
    wall = ratio(source, points, [small, box((-15, -15, 6), (15, 15, 6.2))])
    assert np.abs(level(ratio(source, points, [small, *parts])) - level(wall)).max() < 0.5


_BOX = box((-1, -1, -1), (1, 1, 1))
_ROOM = hollow(box((-3, -3, -3), (3, 3, 3)), box((-2, -2, -2), (2, 2, 2)).vertices)


# Bodies and the number of pairs in contact, by name.
CONTACTS: dict[str, tuple[list[Any], int]] = {
    "common face": ([_BOX, box((1, -1, -1), (3, 1, 1))], 1),
    "narrow gap": ([_BOX, box((1.04, -1, -1), (3, 1, 1))], 1),
    "gap": ([_BOX, box((1.06, -1, -1), (3, 1, 1))], 0),
    "common corner": ([_BOX, box((1, 1, 1), (2, 2, 2))], 1),
    "crossing": ([_BOX, box((-0.5, -4, -0.5), (0.5, 4, 0.5))], 1),
    "contained": ([_BOX, box((-3, -3, -3), (3, 3, 3))], 1),
    # The two surfaces of the room without the box.
    "in a room": ([_ROOM, _BOX], 1),
    "on a plate": ([_BOX, plate(8, 8, (0, 0, 1))], 0),
    "plate through a box": ([_BOX, plate(8, 8, (0, 0, 0.3))], 1),
    "plate against a box": ([_BOX, plate(2, 2, (2, 0, 0))], 1),
    "plates side by side": ([plate(2, 2), plate(2, 2, (2.01, 0, 0))], 1),
    "plates with a common edge": ([plate(2, 2), plate(2, 2, (1, 0, 1), upright=True)], 1),
    "plate on a plate": ([plate(2, 2), plate(1, 2, (0.3, 0, 1), upright=True)], 0),
    "plates crossing": ([plate(2, 2), plate(1, 2, (0.3, 0, 0.5), upright=True)], 1),
}


@pytest.mark.parametrize("name", CONTACTS)
def test_bodies_in_contact_are_those_that_touch_or_cross(name: str) -> None:
    bodies, expected = CONTACTS[name]
    assert len(obstacles_of(bodies, 1.0).contacts) == expected


def test_what_is_in_a_cavity_is_not_in_the_body() -> None:
    points = np.array([(0.0, 0.1, 0.2), (2.5, 0.1, 0.2), (3.5, 0.0, 0.0), (0.9, 0.1, -2.4)])
    assert obstacles_of(_ROOM, 1.0).inside(points).tolist() == [False, True, False, True]


def test_surfaces_behind_edges_do_not_depend_on_the_order_of_edges() -> None:
    # The shadow of the post covers a corner of the first house. The front of the second house
    # continues the front of the first.
    post = box((2.4, -4, 8.9), (2.6, 4, 9.0))
    houses = [box((0, -4, z), (5, 0, z + 9)) for z in (10, 19.02)]
    source = np.array([2.5, 3.0, 0.0])
    bodies = obstacles_of([post, *houses], 1.0)
    seen = bodies.silhouette(source)
    names = ("edges", "numbers", "bodies", "behind", "planes")
    turned = replace(seen, **{name: getattr(seen, name)[::-1] for name in names})
    first, second = (blocked_edges(bodies, [some], source) for some in (seen, turned))
    groups = list(zip(first.groups[0], second.groups[0][::-1], strict=True))
    assert max(k for k, _ in groups) >= 1
    for one, other in groups:
        assert (one >= 0) == (other >= 0)
        if one >= 0:
            a, b = first.blockers[one], second.blockers[other]
            np.testing.assert_array_equal(a.triangles, b.triangles)
