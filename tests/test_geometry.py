"""Apertures from equivalent representations, and errors of invalid outlines."""

import copy
import math
import pickle
import re

import numpy as np
import pytest
import shapely
from hypothesis import given, reject
from hypothesis import strategies as st

from oracles import exact
from outlines import CHEVRON, apertures, cells, poses, relaxed, rotated, square_at, tours
from polywigner.errors import ArgumentError, GeometryError
from polywigner.geometry import Aperture, shapes
from polywigner.geometry.rings import shoelace

# Welding moves rounded vertices by at most 64 ulp of the largest coordinate.
WELD = 64 * 2.0**-52


def _reach(aperture):
    """Return the largest change of the area if the outline moves by the welding tolerance."""
    return WELD * float(np.abs(aperture.bounds).max()) * aperture.polygons.length


@relaxed
@given(tours(), poses())
def test_area_is_that_of_the_vertices_in_rational_arithmetic(ring, pose):
    try:
        aperture = Aperture(pose(ring))
    except GeometryError:
        reject()  # after rounding, the ring touches itself
    expected = exact.area(exact.oriented([(pose(ring), [])]))
    straightening = 1e-14  # vertices within 2^-48 area/diameter of a line are removed
    assert aperture.area == pytest.approx(expected, rel=straightening)


def test_sums_of_signed_areas_are_exact():
    line, triangle = np.array([(0, 0), (1, 3), (2, 6)]) / 8, np.array([(0, 0), (1, 0), (0, 1)]) / 8
    assert shoelace([]) == 0 == shoelace([line])
    assert shoelace([triangle, triangle[::-1], triangle]) == 1 / 128


@relaxed
@given(apertures())
def test_exteriors_run_counter_clockwise_then_holes_clockwise(aperture):
    outer = len(aperture.polygons.geoms)
    signs = [shapely.LinearRing(ring).is_ccw for ring in aperture.rings]
    assert signs == [True] * outer + [False] * (len(signs) - outer)
    for ring in aperture.rings:
        assert ring.dtype == np.float64
        assert not ring.flags.writeable
        assert not np.array_equal(ring[0], ring[-1])
    assert aperture.polygons.is_valid


@relaxed
@given(tours(), st.integers(0, 15), st.booleans(), st.booleans())
def test_start_direction_closing_and_repeats_do_not_matter(ring, start, backwards, closed):
    other = np.roll(ring, start, axis=0)
    other = other[::-1] if backwards else other
    other = np.repeat(other, 2, axis=0)
    other = np.vstack([other, other[:1]]) if closed else other
    assert Aperture(other) == Aperture(ring)
    assert hash(Aperture(other)) == hash(Aperture(ring))


def test_vertices_that_come_to_lie_on_a_line_once_others_are_dropped_are_dropped_too():
    ring = [
        [0.03299999999999993, -0.018999999999999788], [0.03399999999999986, -0.017999999999999714],
        [0.03499999999999979, -0.01699999999999964], [0.03499999999999972, -0.015999999999999643],
        [0.03499999999999964, -0.014999999999999642], [0.03199999999999986, -0.01799999999999986],
        [0.03099999999999993, -0.01899999999999993], [0.03, -0.02], [0.032, -0.019999999999999858],
    ]  # fmt: skip
    aperture = Aperture(ring)
    assert Aperture(aperture.polygons) == aperture
    assert len(aperture.rings[0]) <= 6  # the sixth vertex is off the line due to rounding


@relaxed
@given(apertures())
def test_copies_pickles_and_apertures_of_its_polygons_are_equal_and_frozen(aperture):
    copies = copy.copy(aperture), copy.deepcopy(aperture), pickle.loads(pickle.dumps(aperture))
    for twin in (*copies, Aperture(aperture.polygons)):
        assert twin == aperture and hash(twin) == hash(aperture)
        assert not twin.rings[0].flags.writeable


def test_an_aperture_cannot_be_changed_not_even_through_its_input():
    ring = CHEVRON.copy()
    aperture = Aperture(ring)
    ring[0] = 7.0
    assert aperture == Aperture(CHEVRON)
    with pytest.raises(AttributeError, match="build a new one"):
        aperture.area = 2.0
    with pytest.raises(AttributeError, match="build a new one"):
        del aperture.area
    with pytest.raises(ValueError, match="read-only"):
        aperture.rings[0][0, 0] = 1.0
    for array in (aperture.centre, *aperture.convex_cover):
        assert not array.flags.writeable


@relaxed
@given(apertures())
def test_diameter_centre_and_bounds_are_those_of_the_vertices(aperture):
    points = np.concatenate(aperture.rings)
    gaps = points[:, None] - points[None, :]
    assert aperture.diameter == pytest.approx(np.hypot(gaps[..., 0], gaps[..., 1]).max(), rel=1e-15)
    low, high = points.min(axis=0), points.max(axis=0)
    assert aperture.bounds == (*low, *high)
    ulp = 2.0**-52 * np.abs(points).max()
    assert np.allclose(aperture.centre, (low + high) / 2, rtol=0, atol=ulp)


@relaxed
@given(cells(), poses())
def test_touching_tiles_merge_into_one_outline_of_the_same_area(tiles, pose):
    """Shared edges and T-junctions of rotated tiles coincide up to rounding."""
    placed = [pose(tile) for tile in tiles]
    aperture = Aperture(placed)
    total = sum(exact.area(exact.oriented([(tile, [])])) for tile in placed)
    assert abs(aperture.area - total) <= _reach(aperture)
    side = math.dist(placed[0][0], placed[0][1])
    inner = shapely.union_all([shapely.Polygon(tile).buffer(-1e-6 * side) for tile in placed])
    assert aperture.polygons.buffer(1e-9 * side).contains(inner)


@relaxed
@given(st.floats(0.05, 0.95), st.floats(0, 6.3), st.sampled_from([0.0, 1e3]))
def test_a_rotated_brick_wall_has_no_inner_edges(bond, angle, shift):
    """In a half-bond, each corner is a T-junction on the side of another brick."""
    bricks = [square_at(i + bond * (j % 2), j) for i in range(4) for j in range(4)]
    wall = Aperture([rotated(brick, angle) + shift for brick in bricks])
    assert len(wall.rings) == 1
    assert len(wall.rings[0]) == 16  # four corners, and three steps of two vertices on each side
    assert wall.area == pytest.approx(16, rel=1e-14 * (1 + shift))


@pytest.mark.parametrize("crack", [-4e-16, -1.2e-16, 0.0, 1.2e-16, 4e-16])
@pytest.mark.parametrize("angle", [0.0, 0.3])
def test_cracks_and_overlaps_of_some_ulp_close(crack, angle):
    """A crack would double the edges along it."""
    halves = [square_at(0, 0), square_at(1 + crack, 0)]
    whole = Aperture([rotated(half, angle) for half in halves])
    assert len(whole.rings) == 1 and len(whole.rings[0]) == 4
    assert whole.area == pytest.approx(2, rel=1e-15)


def test_parts_may_touch_in_points_lie_in_holes_and_be_near():
    frame = shapely.box(0, 0, 9, 9) - shapely.box(1, 1, 8, 8)
    for outline, rings, area in (
        ([square_at(0, 0), square_at(1, 1)], 2, 2),
        (shapely.MultiPolygon([frame, shapely.box(2, 2, 3, 3)]), 3, 33),
        ([square_at(0, 0), square_at(1 + 1e-12, 0)], 2, 2),  # a gap larger than rounding
    ):
        assert (len(Aperture(outline).rings), Aperture(outline).area) == (rings, area)
        assert Aperture(outline) != Aperture(CHEVRON)
    assert Aperture(CHEVRON) != Aperture(CHEVRON + np.array([1e-15, 0]))
    assert Aperture(frame) != Aperture(shapely.box(0, 0, 9, 9))


@pytest.mark.parametrize("angle", np.linspace(0, 6.2, 7))
def test_a_hole_may_touch_the_outer_edge_in_a_point_at_any_angle(angle):
    outer, hole = square_at(0, 0, 4.0), np.array([[2, 0], [3, 2], [1, 2]])
    aperture = Aperture(shapely.Polygon(rotated(outer, angle), [rotated(hole, angle)]))
    assert aperture.area == pytest.approx(14, rel=1e-14)
    assert len(aperture.rings) == 2


def test_subnormal_coordinates_count_as_zero():
    """A rotation by a subnormal angle gives subnormal coordinates."""
    assert Aperture(rotated(square_at(0, 0), 5e-324)) == Aperture(square_at(0, 0))


@pytest.mark.parametrize("aspect", [1e-3, 1e-12])
@pytest.mark.parametrize("size", [1e-6, 1e3])
def test_slivers_are_apertures(aspect, size):
    corners = rotated(np.array([[0, 0], [1, 0], [1, aspect], [0, aspect]]), 0.7) * size
    aperture = Aperture(corners)
    assert aperture.area == exact.area(exact.oriented([(corners, [])]))
    assert len(aperture.rings[0]) == 4


@pytest.mark.parametrize("size", [1e-30, 1.0, 1e30])
def test_validation_does_not_depend_on_the_unit(size):
    assert len(Aperture(CHEVRON * size).rings[0]) == 6
    bow_tie = np.array([[0, 0], [2, 1], [2, 0], [0, 1]]) * size
    for bad in (bow_tie, np.array([[0, 0], [0.1, 0.3], [0.2, 0.6]]) * size):
        with pytest.raises(GeometryError):
            Aperture(bad)
    overlapping = [square_at(0, 0) * size, square_at(1 - 1e-9, 0) * size]
    with pytest.raises(GeometryError, match="do not overlap"):
        Aperture(overlapping)


@relaxed
@given(st.floats(-3, 3), st.floats(-3, 3), st.floats(0.5, 5), st.floats(0, 6.3))
def test_a_self_crossing_ring_names_the_crossing_point(x, y, size, angle):
    crossing = np.array([x, y])
    ring = rotated(np.array([[-1, -1], [1, 1], [1, -1], [-1, 1]]) * size, angle) + crossing
    with pytest.raises(GeometryError, match="crosses itself") as raised:
        Aperture(ring)
    named = [float(v) for v in re.search(r"at \((\S+), (\S+)\)", str(raised.value)).groups()]
    assert np.allclose(named, crossing, rtol=0, atol=1e-13 * (size + np.abs(crossing).max()))
    assert "from_ring" in str(raised.value)


SQUARE = square_at(0, 0)
BAD_INPUT = {
    "nothing": ([], "shape"),
    "None": (None, "NoneType"),
    "a text": ("0 0, 1 0, 1 1", "str"),
    "three columns": (np.zeros((4, 3)), "without z"),
    "ragged rows": ([[0, 0], [1, 0], [1]], "real numbers of shape"),
    "numerals": ([["0", "0"], ["1", "0"], ["1", "1"]], "real numbers of shape"),
    "complex numbers": ([[0, 0], [1j, 0], [1, 1]], "real numbers"),
    "masked vertices": (
        np.ma.masked_equal([[0.0, 0.0], [1.0, 0.0], [1.0, 7.0]], 7.0),
        "masked elements",
    ),
    "missing values": ([[0, None], [1, 0], [1, 1]], "real numbers of shape.*got list"),
    "NaN": ([[0, 0], [1, 0], [np.nan, 1]], r"\[nan, 1\.0\] in row 2.*finite"),
    "infinity": ([[0, 0], [np.inf, 0], [0, 1]], "row 1.*finite"),
    "a repeated vertex": ([[1, 1]] * 5, "at least 3 different vertices.*got 1"),
    "a straight line": ([[0, 0], [0.1, 0.3], [0.2, 0.6], [0.7, 2.1]], "enclose an area"),
    "there and back": ([[0, 0], [2, 1], [4, 2], [2, 1]], "enclose an area"),
    "a touching ring": (
        [[0, 0], [4, 0], [4, 4], [2, 0], [0, 4]],
        r"touches itself at \(2, 0\).*from_ring",
    ),
    "a spike": ([[0, 0], [2, 0], [2, 2], [2, 5], [2, 2], [0, 2]], "crosses itself"),
    "too large": ([[0, 0], [1e200, 0], [0, 1e200]], r"below 1e\+100"),
    "too small": ([[0, 0], [1e-200, 0], [0, 1e-200]], "enclose an area"),
    "overlapping rings": ([SQUARE, SQUARE + 0.5], r"overlap between parts 0 and 1 around \(0\.75"),
    "nested rings": ([SQUARE * 4, SQUARE + 1], r"part 1 inside part 0.*Polygon\(outer"),
    "slivers on each other": ([SQUARE * [1, 1e-14], SQUARE * [1, 1e-14]], "inside part"),
    "a bad second ring": ([SQUARE, [[5, 5], [6, 6]]], "ring 1"),
    "an empty polygon": (shapely.Polygon(), "empty"),
    "a polygon in space": (shapely.Polygon([(0, 0, 1), (1, 0, 1), (1, 1, 1)]), "z = 0"),
    "a hole outside": (shapely.Polygon(SQUARE, [SQUARE + 5]), "holes inside"),
    "a hole across": (shapely.Polygon(SQUARE, [SQUARE + 0.5]), "holes inside"),
    "a hole that dwarfs it": (shapely.Polygon(SQUARE, [square_at(0, 0, 1e19)]), "holes inside"),
    "crossing holes": (
        shapely.Polygon(SQUARE * 9, [square_at(1, 1, 3), square_at(3, 3, 3)]),
        "holes inside",
    ),
    "a crossing hole": (
        shapely.Polygon(SQUARE * 9, [[(1, 1), (3, 3), (3, 1), (1, 3)]]),
        "hole 1 of the polygon that crosses itself at",
    ),
}


@pytest.mark.parametrize(("vertices", "message"), BAD_INPUT.values(), ids=BAD_INPUT)
def test_bad_input_raises_one_error_that_says_what_was_expected(vertices, message):
    with pytest.raises(GeometryError, match=message) as raised:
        Aperture(vertices)
    assert "expected" in str(raised.value)
    assert "got" in str(raised.value)


def test_integers_objects_and_flat_shapely_heights_are_numbers():
    from fractions import Fraction

    assert Aperture([(0, 0), (Fraction(1, 2), 0), (0, 1)]) == Aperture([[0, 0], [0.5, 0], [0, 1]])
    assert Aperture(np.array([[0, 0], [2, 0], [0, 2]], dtype=np.uint8)).area == 2
    assert Aperture(shapely.Polygon([(0, 0, 0), (1, 0, 0), (0, 1, 0)])).area == 0.5


def test_the_representation_tells_size_and_place():
    ring = Aperture(shapely.box(0, 0, 3, 3) - shapely.box(1, 1, 2, 2))
    assert repr(ring) == "Aperture(8 vertices, 1 hole, area 8, bounds (0, 0, 3, 3))"
    assert "2 parts" in repr(shapes.bow_tie(2, 1))


_lattice = st.lists(st.tuples(st.integers(0, 4), st.integers(0, 4)), min_size=3, max_size=9)
_anywhere = st.lists(st.tuples(st.floats(0, 4), st.floats(0, 4)), min_size=3, max_size=9)


def _turns(ring, point):
    """Return the winding number as the sum of the angles of the edges."""
    x, y = (ring - point).T
    angle = np.arctan2(
        x * np.roll(y, -1) - np.roll(x, -1) * y, x * np.roll(x, -1) + y * np.roll(y, -1)
    )
    return round(float(angle.sum()) / (2 * math.pi))


def _off_edges(ring, count):
    points = np.random.default_rng(3).random((count, 2)) * np.ptp(ring, axis=0) + ring.min(axis=0)
    edges = np.stack([ring, np.roll(ring, -1, axis=0)], axis=1)
    outline = shapely.MultiLineString(list(edges[np.any(edges[:, 0] != edges[:, 1], axis=1)]))
    with np.errstate(all="ignore"):  # GEOS divides by edge lengths that underflow
        gaps = shapely.distance(outline, shapely.points(points))
    return points[gaps > 1e-6 * np.ptp(ring)]


def _aperture(ring, rule):
    """Return the aperture, or None if the rule gives an empty region."""
    try:
        return Aperture.from_ring(ring, winding=rule)
    except GeometryError as error:
        assert any(word in str(error) for word in ("enclose", "encloses", "different"))
        return None


@relaxed
@given(_lattice | _anywhere, poses())
def test_what_is_kept_is_where_the_winding_number_is_not_zero_or_odd(vertices, pose):
    ring = pose(np.array(vertices, dtype=float))
    for rule, keeps in (("nonzero", lambda n: n != 0), ("evenodd", lambda n: n % 2 == 1)):
        aperture = _aperture(ring, rule)
        for point in _off_edges(ring, 12) if np.ptp(ring) > 0 else ():
            inside = aperture is not None and aperture.polygons.contains(shapely.Point(point))
            assert inside == keeps(_turns(ring, point))


def test_a_bow_tie_becomes_two_triangles_that_touch():
    for rule in ("nonzero", "evenodd"):
        halves = Aperture.from_ring([[-1, -1], [1, 1], [1, -1], [-1, 1]], winding=rule)
        assert halves == Aperture([[[-1, -1], [0, 0], [-1, 1]], [[1, 1], [0, 0], [1, -1]]])


def test_a_pentagram_has_a_full_or_an_empty_heart():
    angle = 2 * np.pi * np.arange(5) * 2 / 5
    ring = np.column_stack([np.cos(angle), np.sin(angle)])
    full, empty = (Aperture.from_ring(ring, winding=rule) for rule in ("nonzero", "evenodd"))
    # The inner pentagon has this circumradius, and the tips are triangles on its sides.
    inner = math.cos(2 * math.pi / 5) / math.cos(math.pi / 5)
    heart = 2.5 * inner**2 * math.sin(2 * math.pi / 5)
    assert full.area == pytest.approx(5 * inner * math.sin(math.pi / 5), rel=1e-13)
    assert empty.area == pytest.approx(full.area - heart, rel=1e-13)
    assert len(full.rings) == 1 and len(full.rings[0]) == 10
    assert len(empty.polygons.geoms) == 5


def test_corners_of_the_ring_keep_their_floats():
    ring = rotated(np.array([[-1, -1], [1, 1], [1, -1], [-1, 1.3]]), 0.3)
    split = {vertex.tobytes() for part in Aperture.from_ring(ring).rings for vertex in part}
    assert {vertex.tobytes() for vertex in ring} <= split


def test_an_unknown_rule_is_named():
    with pytest.raises(ArgumentError, match=r"nonzero.*evenodd.*'positive'"):
        Aperture.from_ring(CHEVRON, winding="positive")
    with pytest.raises(GeometryError, match="expected"):
        Aperture.from_ring([[0, 0], [1, 1], [2, 2]])
