"""A ring that crosses itself encloses what its winding number says."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest
import shapely
from hypothesis import given
from hypothesis import strategies as st

from outlines import CHEVRON, poses, relaxed, rotated, square_at
from polywigner.errors import ArgumentError, GeometryError
from polywigner.geometry import Aperture
from polywigner.geometry.parts import winding_numbers

# Faces are noded on a grid of 2^-44 of the size or of the distance from the origin.
GRID = 2.0**-43

_lattice = st.lists(st.tuples(st.integers(0, 4), st.integers(0, 4)), min_size=3, max_size=9)
_anywhere = st.lists(st.tuples(st.floats(0, 4), st.floats(0, 4)), min_size=3, max_size=9)


def _turns(ring: np.ndarray, point: np.ndarray) -> int:
    """Winding number as the sum of the angles under which the point sees the edges."""
    x, y = (ring - point).T
    angle = np.arctan2(
        x * np.roll(y, -1) - np.roll(x, -1) * y, x * np.roll(x, -1) + y * np.roll(y, -1)
    )
    return round(float(angle.sum()) / (2 * math.pi))


def _off_edges(ring: np.ndarray, count: int) -> np.ndarray:
    points = np.random.default_rng(3).random((count, 2)) * np.ptp(ring, axis=0) + ring.min(axis=0)
    edges = np.stack([ring, np.roll(ring, -1, axis=0)], axis=1)
    outline = shapely.MultiLineString(list(edges[np.any(edges[:, 0] != edges[:, 1], axis=1)]))
    with np.errstate(all="ignore"):  # GEOS divides by the length of edges that underflow
        gaps = shapely.distance(outline, shapely.points(points))
    return points[gaps > 1e-6 * np.ptp(ring)]


def _aperture(ring: np.ndarray, rule: str) -> Aperture | None:
    """None where the ring encloses nothing by this rule."""
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


@relaxed
@given(_lattice, poses())
def test_even_odd_is_the_symmetric_difference_of_the_triangles_of_a_fan(vertices, pose):
    ring = pose(np.array(vertices, dtype=float))
    region = shapely.Polygon()
    for b, c in pairwise(ring[1:]):
        region = region.symmetric_difference(shapely.Polygon([ring[0], b, c]))
    aperture = _aperture(ring, "evenodd")
    size = max(np.abs(ring).max(), np.ptp(ring))
    found = 0.0 if aperture is None else aperture.area
    assert found == pytest.approx(region.area, abs=100 * GRID * size * np.ptp(ring) * len(ring))


@relaxed
@given(_lattice, poses())
def test_winding_numbers_are_those_of_the_angles(vertices, pose):
    ring = pose(np.array(vertices, dtype=float))
    points = _off_edges(ring, 10) if np.ptp(ring) > 0 else ring[:0]
    assert winding_numbers(ring, points).tolist() == [_turns(ring, point) for point in points]


def test_a_bow_tie_becomes_two_triangles_that_touch():
    for rule in ("nonzero", "evenodd"):
        halves = Aperture.from_ring([[-1, -1], [1, 1], [1, -1], [-1, 1]], winding=rule)
        assert halves == Aperture([[[-1, -1], [0, 0], [-1, 1]], [[1, 1], [0, 0], [1, -1]]])


def test_a_pentagram_has_a_full_or_an_empty_heart():
    angle = 2 * np.pi * np.arange(5) * 2 / 5
    ring = np.column_stack([np.cos(angle), np.sin(angle)])
    full, empty = (Aperture.from_ring(ring, winding=rule) for rule in ("nonzero", "evenodd"))
    # Circumradius of the inner pentagon, and the tips as triangles on its sides.
    inner = math.cos(2 * math.pi / 5) / math.cos(math.pi / 5)
    heart = 2.5 * inner**2 * math.sin(2 * math.pi / 5)
    assert full.area == pytest.approx(5 * inner * math.sin(math.pi / 5), rel=1e-13)
    assert empty.area == pytest.approx(full.area - heart, rel=1e-13)
    assert len(full.rings) == 1 and len(full.rings[0]) == 10
    assert len(empty.polygons.geoms) == 5


@pytest.mark.parametrize("turns", [2, 3])
@pytest.mark.parametrize("drift", [0.0, 1e-16])
def test_a_ring_run_through_several_times_counts_its_turns(turns, drift):
    once = rotated(square_at(0, 0), 0.3)
    ring = np.concatenate([once + k * drift for k in range(turns)])
    assert Aperture.from_ring(ring).area == pytest.approx(1, rel=1e-13)
    if turns % 2:
        assert Aperture.from_ring(ring, winding="evenodd").area == pytest.approx(1, rel=1e-13)
    else:
        with pytest.raises(GeometryError, match="evenodd"):
            Aperture.from_ring(ring, winding="evenodd")


def test_an_inner_loop_is_full_or_a_hole():
    """A limacon winds twice around its inner loop."""
    angle = 2 * np.pi * np.arange(400) / 400
    radius = 0.5 + np.cos(angle)
    ring = np.column_stack([radius * np.cos(angle), radius * np.sin(angle)])
    full, holed = (Aperture.from_ring(ring, winding=rule) for rule in ("nonzero", "evenodd"))
    assert len(full.rings) == 1
    assert len(holed.rings) == 2
    wedges = radius * np.roll(radius, -1) * np.sin(np.pi / 200) / 2
    loop = full.area - holed.area
    assert full.area + loop == pytest.approx(wedges.sum(), rel=1e-12)  # the loop counts twice


def test_opposite_loops_are_both_kept():
    """Net area zero, as in a bow-tie of equal halves, is not no area."""
    eight = [[0, 0], [1, 0], [1, 1], [0, 1], [0, 0], [-1, 0], [-1, -1], [0, -1]]
    assert Aperture.from_ring(eight).area == 2
    mirrored = [[0, 0], [1, 0], [1, 1], [0, 1], [0, 0], [0, -1], [-1, -1], [-1, 0]]
    assert Aperture.from_ring(mirrored).area == 2


def test_a_simple_ring_passes_unchanged():
    for rule in ("nonzero", "evenodd"):
        assert Aperture.from_ring(CHEVRON[::-1], winding=rule) == Aperture(CHEVRON)


def test_corners_of_the_ring_keep_their_floats():
    ring = rotated(np.array([[-1, -1], [1, 1], [1, -1], [-1, 1.3]]), 0.3)
    split = {vertex.tobytes() for part in Aperture.from_ring(ring).rings for vertex in part}
    assert {vertex.tobytes() for vertex in ring} <= split


def test_an_unknown_rule_is_named():
    with pytest.raises(ArgumentError, match=r"nonzero.*evenodd.*'positive'"):
        Aperture.from_ring(CHEVRON, winding="positive")


@pytest.mark.parametrize("ring", [[], [[0, 0], [1, 1], [2, 2]], [[0, 0], [1, np.nan], [2, 2]]])
def test_bad_rings_raise_as_everywhere(ring):
    with pytest.raises(GeometryError, match="expected"):
        Aperture.from_ring(ring)
