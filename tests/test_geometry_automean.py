"""The automean contains the centres of non-empty lag slices; slices agree with exact arithmetic."""

import numpy as np
import pytest
import shapely
from hypothesis import given
from hypothesis import strategies as st

from oracles import degenerate, exact
from oracles.exact import rational
from outlines import CHEVRON, apertures, cells, inside_rings, poses, relaxed, sample, square_at
from polywigner.errors import ArgumentError
from polywigner.geometry import Aperture, automean, lag_slice, position_slice, shapes, triangulate

# Tolerance of outlines, which are rounded to 2^-44 of the size or of the distance from the origin.
GRID = 2.0**-43

# Tolerance of slices that Shapely clips in double precision.
CLIPPING = 1e-13


def _size(aperture):
    return max(float(np.abs(aperture.bounds).max()), aperture.diameter)


@pytest.mark.slow
@relaxed
@given(apertures())
def test_points_are_in_the_automean_where_their_lag_slice_is_not_empty(aperture):
    mean = automean(aperture)
    near = 1e3 * GRID * _size(aperture)
    for x in sample(Aperture(aperture.polygons.convex_hull), 4, seed=1):
        if mean.polygons.boundary.distance(shapely.Point(x)) > near:
            lags = exact.lag_region(aperture.rings, x).area
            assert mean.polygons.contains(shapely.Point(x)) == (lags > 0)


@pytest.mark.parametrize("seed", [2523, 2540, 6860])  # thin pieces with many nearly straight sides
def test_an_aperture_lies_in_its_automean(seed):
    aperture, _ = next(degenerate.outlines(np.random.default_rng(seed)))
    outside = shapely.difference(aperture.polygons, automean(aperture).polygons).area
    assert outside <= GRID * _size(aperture) * aperture.polygons.length


@relaxed
@given(st.integers(3, 40), st.floats(0.1, 10), poses())
def test_a_convex_aperture_is_its_own_automean(sides, radius, pose):
    aperture = Aperture(pose(shapes.regular_polygon(sides, radius).rings[0]))
    assert automean(aperture) == aperture


@relaxed
@given(cells(), poses())
def test_the_automean_of_tiles_has_no_cracks_and_no_slivers(tiles, pose):
    """Midpoints of unit cells form cells of half the pitch, so areas are multiples of 1/4."""
    aperture = Aperture([pose(tile) for tile in tiles])
    side = np.hypot(*np.subtract(*pose(tiles[0])[:2]))
    mean = automean(aperture)
    tolerance = 100 * GRID * _size(aperture) / side
    for ring in mean.rings:
        quarters = 4 * shapely.Polygon(ring).area / side**2
        assert round(quarters) >= 1
        assert quarters == pytest.approx(round(quarters), abs=max(1e-11, 400 * tolerance))
    assert sum(map(len, mean.rings)) <= 16 * len(tiles) + 4


def test_the_chevron_spans_an_automean_of_known_area():
    """For parallelograms P and Q, the hexagon (P + Q)/2 adds a rhombus in the notch."""
    mean = automean(Aperture(CHEVRON))
    rhombus = shapely.Polygon([(1, 0), (1.5, 0.25), (1, 0.5), (0.5, 0.25)])
    expected = shapely.Polygon(CHEVRON).union(rhombus)
    assert mean.polygons.symmetric_difference(expected).area < 1e-14
    assert mean.area == pytest.approx(1.45, rel=1e-14)


def test_the_automean_of_an_annulus_is_the_disc_that_it_encloses():
    apart = automean(Aperture([square_at(0, 0), square_at(6, 4)]))
    assert apart == Aperture([square_at(0, 0), square_at(3, 2), square_at(6, 4)])
    annulus, disc = shapes.ring(1.0, 0.5), shapes.disc(1.0)
    assert automean(annulus).polygons.symmetric_difference(disc.polygons).area < 1e-13
    assert len(automean(annulus).rings) == 1


@pytest.mark.slow
@relaxed
@given(apertures(), poses())
def test_slices_have_the_area_of_exact_clipping(aperture, pose):
    rng = np.random.default_rng(0)
    for x in sample(aperture, 3):
        result = lag_slice(aperture, x)
        expected = float(exact.lag_region(aperture.rings, x).area)
        rounding = 2.0**-50 * _size(aperture) * aperture.polygons.length
        assert result.area == pytest.approx(expected, abs=CLIPPING * aperture.area + 16 * rounding)
    xi = (rng.random(2) - 0.5) * aperture.diameter
    expected = float(exact.position_region(aperture.rings, xi).area)
    slack = CLIPPING * aperture.area + 16 * 2.0**-50 * _size(aperture) * aperture.polygons.length
    assert position_slice(aperture, xi).area == pytest.approx(expected, abs=slack)


@relaxed
@given(st.floats(-1.2, 1.2), st.floats(-0.8, 0.8))
def test_slices_of_a_rectangle_are_the_rectangles_of_the_closed_form(x, y):
    a, b = 2.0, 1.0
    rectangle = shapes.rectangle(a, b)
    sides = np.array([2 * a - 4 * abs(x), 2 * b - 4 * abs(y)])
    lags = lag_slice(rectangle, (x, y))
    assert lags.area == pytest.approx(sides.prod() if sides.min() > 0 else 0.0, abs=1e-14)
    overlap = np.array([a - abs(x), b - abs(y)])
    positions = position_slice(rectangle, (x, y))
    assert positions.area == pytest.approx(overlap.prod() if overlap.min() > 0 else 0.0, abs=1e-14)


@relaxed
@given(apertures())
def test_slices_are_symmetric_about_their_origin(aperture):
    """A change of the sign of xi exchanges the copies, so lag and position slices are even."""
    x = aperture.convex_cover[0].mean(axis=0)
    lags = lag_slice(aperture, x)
    flipped = shapely.transform(lags, np.negative)
    slack = CLIPPING * aperture.area + 2.0**-44 * _size(aperture) * aperture.polygons.length
    assert lags.symmetric_difference(flipped).area <= slack
    xi = np.array([0.1, -0.2]) * aperture.diameter
    there, back = position_slice(aperture, xi), position_slice(aperture, -xi)
    assert there.symmetric_difference(back).area <= slack


def test_slices_that_only_touch_are_empty():
    square = shapes.square(1.0)
    for empty in (lag_slice(square, (0.5, 0)), position_slice(square, (1, 1))):
        assert empty.is_empty and empty.area == 0
        assert empty.geom_type in ("Polygon", "MultiPolygon")


@pytest.mark.parametrize("point", [1.0, (1, 2, 3), ("a", "b"), (np.nan, 0)])
def test_a_point_has_two_finite_components(point):
    for cut in (lag_slice, position_slice):
        with pytest.raises(ArgumentError, match="2 finite numbers"):
            cut(shapes.square(1.0), point)


# Largest fraction of the area that a half-plane of a piece may exclude.
DENT = 2.0**-48


def _area(ring):
    points = [(rational(x), rational(y)) for x, y in ring]
    ahead = points[1:] + points[:1]
    return sum(x * v - u * y for (x, y), (u, v) in zip(points, ahead, strict=True)) / 2


def _deepest_dent(piece):
    """Return the largest distance of a vertex to the right of an edge, in rational arithmetic."""
    points = [(rational(x), rational(y)) for x, y in piece]
    deepest = 0.0
    for (ax, ay), (bx, by) in zip(points, points[1:] + points[:1], strict=True):
        length = float((bx - ax) ** 2 + (by - ay) ** 2) ** 0.5
        lowest = min((bx - ax) * (y - ay) - (by - ay) * (x - ax) for x, y in points)
        deepest = max(deepest, -float(lowest) / length)
    return deepest


@relaxed
@given(apertures())
def test_convex_pieces_tile_the_aperture_exactly_with_its_vertices(aperture):
    pieces, points = aperture.convex_cover, sample(aperture, 60)
    assert sum(map(_area, pieces)) == sum(map(_area, aperture.rings))
    counts = sum(inside_rings((piece,), points).astype(int) for piece in pieces)
    assert np.array_equal(counts, inside_rings(aperture.rings, points).astype(int))
    own = {vertex.tobytes() for ring in aperture.rings for vertex in ring}
    for piece in pieces:
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
