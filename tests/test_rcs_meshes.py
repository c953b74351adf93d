"""Cross sections of meshes of several bodies: all directions, and exact shadows."""

from __future__ import annotations

import math
import warnings
from typing import Any

import numpy as np
import pytest
import shapely

import polywigner as pw
from oracles.meshes import BOX, block, drone, joined, moved, prism, section_root, torus, towards
from oracles.scan_lines import visible_lengths
from polywigner.errors import ArgumentError, PolywignerWarning
from polywigner.geometry import hidden_parts
from polywigner.scattering.facets import facets_of, visible_along

pytestmark = pytest.mark.filterwarnings("ignore::polywigner.errors.PolywignerWarning")

# Error due to rounding and to omitted narrow parts, relative to the size of the body.
ROUNDING = 1e-9


def rotated(body: pw.Polyhedron, seed: int) -> tuple[pw.Polyhedron, np.ndarray]:
    turn, _ = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))
    turn *= np.linalg.det(turn)
    return pw.Polyhedron(body.vertices @ turn.T, body.faces), turn


@pytest.mark.parametrize(
    ("sides", "polar", "azimuth"),
    [(12, 60, 90), (12, 80, 270), (12, 90, 130), (8, 80, 90), (16, 100, 110)],
)
@pytest.mark.parametrize("bounces", [2, 3])
def test_beams_are_followed_between_all_parts_of_a_drone(
    sides: int, polar: float, azimuth: float, bounces: int
) -> None:
    with warnings.catch_warnings(record=True) as result:
        warnings.simplefilter("always")
        sigma = pw.rcs(drone(sides), towards(polar, azimuth), 0.03, bounces=bounces)
    assert sigma > 0
    assert not any("cannot be computed" in str(warning.message) for warning in result)


def test_parts_that_meet_in_a_vertex_or_beside_a_sliver_shade_each_other() -> None:
    cubes = [BOX, moved(BOX, *np.ptp(BOX.vertices, axis=0))]
    vertices, index = np.unique(joined(cubes).vertices, axis=0, return_inverse=True)
    assert len(vertices) == 15
    pair = pw.Polyhedron(vertices, index.ravel()[joined(cubes).triangles])
    ring = [(0, 0), (2, 0), (2, 1), (1, 1), (1, 2), (0, 2)]
    corner = prism(ring, 0.0, 1.0)
    # A triangle without area on the concave edge, from (1, 1, 0) to (1, 1, 1).
    inserted = [*corner.vertices, (1, 1, 0.5)]
    faces = [face if set(face) != {2, 3, 8, 9} else (2, 3, 12, 9, 8) for face in corner.faces]
    sliver = pw.Polyhedron(inserted, [*faces, (3, 9, 12)])
    k = towards(50, 40), towards(70, 80), towards(60, 130), towards(40, 230)
    for body, parts in ((pair, cubes), (sliver, corner)):
        assert facets_of(body).casts_shadows
        assert pw.rcs(body, k, 0.1) == pytest.approx(pw.rcs(parts, k, 0.1), rel=ROUNDING, abs=0.0)


def test_orientation_of_a_small_polygon_does_not_depend_on_its_distance() -> None:
    side = 1e-9
    corners = 1 + np.random.default_rng(3).random((50, 2))
    squares = np.array(
        [shapely.box(x, y, x + side, y + side, ccw=k % 2 == 0) for k, (x, y) in enumerate(corners)]
    )
    owner, begin, end = hidden_parts.edges_around(squares)
    begin, end = begin - corners[owner], end - corners[owner]
    areas = np.bincount(owner, begin[:, 0] * end[:, 1] - begin[:, 1] * end[:, 0])
    assert (areas > 0).all()


def lit_lengths(body: Any, k: np.ndarray, angle: float, height: float) -> np.ndarray:
    """Return the visible lengths (n,) of triangles on a scan line, like visible_lengths."""
    facets = facets_of(body)
    first = np.cross(k, (0.3, 0.5, 0.8))
    first /= np.linalg.norm(first)
    second = np.cross(k, first)
    along = np.cos(angle) * first + np.sin(angle) * second
    across = np.cos(angle) * second - np.sin(angle) * first
    seen, lengths = visible_along(facets, k), np.zeros(len(facets.corner))
    for j in np.flatnonzero(seen.signs):
        part = seen.parts[j] or shapely.Polygon([(0, 0), (1, 0), (0, 1)])
        places = []
        for ring in shapely.get_rings(shapely.get_parts(part)):
            u = shapely.get_coordinates(ring)
            points = facets.corner[j] + u[:, :1] * facets.first[j] + u[:, 1:] * facets.second[j]
            x, y = points @ along, points @ across - height
            rows = np.flatnonzero((y[1:] > 0) != (y[:-1] > 0))
            share = y[rows] / (y[rows] - y[rows + 1])
            places += (x[rows] + share * (x[rows + 1] - x[rows])).tolist()
        ends = np.sort(places)
        lengths[j] = (ends[1::2] - ends[::2]).sum()
    return lengths


@pytest.mark.parametrize(
    "body",
    [
        drone(12),
        rotated(drone(8), 1)[0],
        joined([moved(block(1, 1, 1), x, y, 0) for x in (0, 1, 2) for y in (0, 1)]),
        joined(
            [block(4, 4, 0.1), moved(block(1, 1, 1), 0.5, 0, 0.1), moved(block(2, 1, 1), 0, 1, 1)]
        ),
        torus(12, 8),
    ],
    ids=["drone", "turned drone", "touching boxes", "stacked boxes", "torus"],
)
def test_visible_parts_are_those_of_scan_lines(body: Any) -> None:
    facets, rng = facets_of(body), np.random.default_rng(2)
    planes = np.column_stack([facets.normal, (facets.normal * facets.corner).sum(axis=1)])
    plane = np.unique(planes.round(6) + 0.0, axis=0, return_inverse=True)[1].ravel()
    for s in (towards(60, 90), towards(90, 130), towards(37, 211), towards(1e-6, 20)):
        facing = facets.normal @ -s < 0
        for angle in rng.uniform(0, math.pi, 4):
            height = rng.uniform(-0.2, 0.2) * facets.size
            result = np.bincount(plane, lit_lengths(body, -s, angle, height))
            expected = np.zeros(len(plane))
            expected[facing] = visible_lengths(facets.corners[facing], -s, angle, height)
            expected = np.bincount(plane, expected)
            np.testing.assert_allclose(result, expected, rtol=0, atol=ROUNDING * facets.size)


@pytest.mark.parametrize("azimuth", [17.3, 40.0, 71.0, 135.0])
def test_walls_stay_lit_as_the_receiver_rises_to_their_plane(azimuth: float) -> None:
    # Limit of the error: a wall seen edge-on radiates along itself.
    body, t = [pw.shapes.square(8.0), BOX], towards(40, 30)
    angles = np.degrees(10.0 ** -np.arange(6.0, 12.0))
    result = [math.sqrt(pw.rcs(body, towards(a, azimuth), 0.13, t)) for a in angles]
    edge_on = math.sqrt(pw.rcs(body, (0, 0, 1), 0.13, t))
    np.testing.assert_allclose(result, edge_on, atol=2e-5 * section_root(8.0, 0.13), rtol=0)


def test_set_operations_return_polygons_and_lose_none() -> None:
    square = shapely.box(0, 0, 1, 1)
    line, point = shapely.LineString([(0, 0), (1, 1)]), shapely.Point(0, 0)
    nested = shapely.GeometryCollection([square, shapely.GeometryCollection([line, square])])
    mixed = np.array([nested, line, point, square, None], dtype=object)
    kinds = shapely.get_type_id(hidden_parts.polygonal(mixed))
    assert kinds.tolist() == [6, 3, 3, 3, -1]
    assert shapely.area(hidden_parts.polygonal(mixed))[:4].tolist() == [2, 0, 0, 1]
    # Squares with a common edge share only a line.
    beside = np.array([shapely.box(1, 0, 2, 1)])
    shared = hidden_parts.intersections(np.array([square]), beside)
    assert shapely.area(shared)[0] == 0 and shapely.get_type_id(shared)[0] == 3
    # A narrow wall in front of a floor, which GEOS loses without a grid.
    wall = shapely.Polygon(
        [
            (-1.654657507375762e-09, -2.0000000000813922),
            (0.9999999983453426, -2.000000001026911),
            (0.9999999978725832, -2.0000000008641265),
        ]
    )
    floor = shapely.Polygon(
        [
            (-4.000000001654657, -1.9999999962993167),
            (-4.000000003545694, -3.999999996299318),
            (3.9999999964543056, -4.000000003863466),
            (1.9999999983453436, -2.0000000019724298),
        ]
    )
    left = hidden_parts.differences(np.array([wall]), np.array([floor]))
    assert shapely.area(left)[0] == pytest.approx(wall.area, rel=1e-3, abs=0.0)


def test_unions_that_geos_cannot_compute_together_are_computed_alone(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    union_all = shapely.union_all

    def failing(*arguments: Any, axis: int | None = None, **options: Any) -> Any:
        if axis is not None:
            raise shapely.errors.GEOSException("side location conflict")
        return union_all(*arguments, **options)

    monkeypatch.setattr(shapely, "union_all", failing)
    squares = np.array([shapely.box(x, 0, x + 2, 1) for x in (0, 1, 5)])
    unions = hidden_parts.unions(squares, np.array([0, 0, 1]), 7.0)
    assert shapely.area(unions).tolist() == [3.0, 2.0]


def test_an_outline_that_rounding_has_bent_keeps_its_area() -> None:
    # At an edge through vertices of other faces, GEOS turns the larger part into a hole.
    points = [
        (0.1412615945555405, -0.0210390559333204),
        (0.0857365998516411, -0.0314579465933362),
        (0.0837240274996775, -0.0296813532875301),
        (0.1013855239502549, -0.0270285490092746),
        (0.1042449314196076, -0.0279849830399976),
        (0.1181261800955824, -0.0253802603749936),
        (0.122753262987574, -0.024512019486659),
        (0.1226695867950339, -0.0238316255135056),
    ]
    bent = shapely.Polygon(points)
    assert not bent.is_valid
    (mended,) = hidden_parts.mended(np.array([bent]))
    x, y = np.array(points).T
    area = abs(np.sum(x * np.roll(y, -1) - y * np.roll(x, -1))) / 2
    assert mended.is_valid and mended.area == pytest.approx(area, rel=1e-9, abs=0.0)


def test_directions_beyond_the_limits_are_nan_and_leave_the_others(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(hidden_parts, "_MOST_PAIRS", 1000)
    # From above, each of 50 plates hides all plates below it.
    body = joined([moved(block(1, 1, 0.001), 0, 0, 0.01 * k) for k in range(50)])
    with pytest.warns(PolywignerWarning, match="1 of 2 directions cannot be computed"):
        result = pw.rcs(body, [(0.0, 0.0, 1.0), (1.0, 0.0, 0.0)], 0.03)
    assert np.isnan(result[0]) and result[1] > 0
    with pytest.raises(ArgumentError, match="overlap"):
        pw.rcs(body, (0.0, 0.0, 1.0), 0.03)
    with pytest.warns(PolywignerWarning, match="cannot be computed"):
        pattern = pw.rcs_pattern(body, 0.03, 0.0, np.array([0.0, math.pi / 2]))
    np.testing.assert_array_equal(np.isnan(pattern["rcs"].values), [[False, True]])
    assert pattern.attrs["largest_rcs"] == pattern["rcs"].values[0, 0]
