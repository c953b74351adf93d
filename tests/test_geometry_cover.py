"""The convex cover and the triangulation tile the aperture exactly, with its own vertices."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
import shapely
from hypothesis import given
from hypothesis import strategies as st

from oracles.exact import rational
from oracles.shapes import awkward_shapes
from outlines import CHEVRON, apertures, inside_rings, poses, relaxed, rotated, sample, square_at
from polywigner.geometry import Aperture, shapes, triangulate

# A piece's half-planes may miss this fraction of the aperture's area (rounding-level dents).
DENT = 2.0**-48


def _area(ring: np.ndarray) -> Fraction:
    points = [(rational(x), rational(y)) for x, y in ring]
    ahead = points[1:] + points[:1]
    return sum(x * v - u * y for (x, y), (u, v) in zip(points, ahead, strict=True)) / 2


def _deepest_dent(piece: np.ndarray) -> float:
    """How far any vertex lies right of any edge's line, in rational arithmetic."""
    points = [(rational(x), rational(y)) for x, y in piece]
    deepest = 0.0
    for (ax, ay), (bx, by) in zip(points, points[1:] + points[:1], strict=True):
        length = float((bx - ax) ** 2 + (by - ay) ** 2) ** 0.5
        lowest = min((bx - ax) * (y - ay) - (by - ay) * (x - ax) for x, y in points)
        deepest = max(deepest, -float(lowest) / length)
    return deepest


@relaxed
@given(apertures())
def test_pieces_add_up_to_the_area_exactly(aperture):
    assert sum(map(_area, aperture.convex_cover)) == sum(map(_area, aperture.rings))


@relaxed
@given(apertures())
def test_every_point_lies_in_one_piece_or_in_none(aperture):
    points = sample(aperture, 60)
    counts = sum(inside_rings((piece,), points).astype(int) for piece in aperture.convex_cover)
    assert np.array_equal(counts, inside_rings(aperture.rings, points).astype(int))


@relaxed
@given(apertures())
def test_pieces_are_convex_and_use_the_vertices_as_they_are(aperture):
    own = {vertex.tobytes() for ring in aperture.rings for vertex in ring}
    for piece in aperture.convex_cover:
        assert _area(piece) > 0
        assert _deepest_dent(piece) <= DENT * aperture.area / aperture.diameter * 1.001
        assert all(vertex.tobytes() in own for vertex in piece)
        assert not piece.flags.writeable


@relaxed
@given(apertures())
def test_triangles_tile_the_aperture_counter_clockwise(aperture):
    vertices, triangles = triangulate(aperture)
    areas = [_area(vertices[triangle]) for triangle in triangles]
    assert min(areas) > 0
    assert sum(areas) == sum(map(_area, aperture.rings))
    own = {vertex.tobytes() for ring in aperture.rings for vertex in ring}
    assert {vertex.tobytes() for vertex in vertices} <= own
    assert triangles.min() >= 0 and triangles.max() < len(vertices)


PLUS = [square_at(0, 0), square_at(1, 0), square_at(-1, 0), square_at(0, 1), square_at(0, -1)]
FEWEST = {
    "disc": (shapes.disc(1.0), 1),
    "chevron": (Aperture(CHEVRON), 2),
    "two chevrons": (Aperture([CHEVRON, CHEVRON + np.array([0, 1.7])]), 4),
    "square annulus": (Aperture(shapely.box(0, 0, 3, 3) - shapely.box(1, 1, 2, 2)), 4),
    "plus": (Aperture(PLUS), 3),
    "U": (shapes.u_shape(3, 3, 1), 3),
    "V": (shapes.vee(1, 1, 0.2), 2),
    "bow-tie": (shapes.bow_tie(2, 1), 2),
    "annulus of 64-gons": (shapes.ring(1, 0.5), 64),
}


@pytest.mark.parametrize(("aperture", "count"), FEWEST.values(), ids=FEWEST)
def test_named_shapes_have_the_fewest_possible_pieces(aperture, count):
    assert len(aperture.convex_cover) == count


@relaxed
@given(st.floats(0, 6.3), poses())
def test_rounding_does_not_add_pieces(angle, pose):
    """One more than there are dents is always enough, and rounding makes no dents that count."""
    assert len(Aperture(pose(rotated(CHEVRON, angle))).convex_cover) == 2
    assert len(Aperture([pose(rotated(tile, angle)) for tile in PLUS]).convex_cover) <= 5


@pytest.mark.parametrize("polygons", awkward_shapes().values(), ids=awkward_shapes())
def test_awkward_shapes_are_tiled(polygons):
    aperture = Aperture([shapely.Polygon(outer, holes) for outer, holes in polygons])
    assert sum(map(_area, aperture.convex_cover)) == sum(map(_area, aperture.rings))


def test_a_convex_part_is_its_own_piece():
    disc = shapes.disc(1.0, 1000)
    assert np.array_equal(disc.convex_cover[0], disc.rings[0])
