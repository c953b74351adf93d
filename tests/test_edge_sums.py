"""Fields behind obstacles from few nodes of a source, against sums over all points."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest

import polywigner as pw
from oracles.meshes import at, ball, box, moved
from polywigner.propagation import edge_sums
from polywigner.propagation.edge_sums import EdgeSum

SQUARE = pw.shapes.square(3.1)
RS1, RS2 = "rayleigh-sommerfeld-1", "rayleigh-sommerfeld-2"


def grid(count: int, half: float, z: float) -> np.ndarray:
    x, y = np.meshgrid(*[np.linspace(-half, half, count)] * 2)
    return np.stack([x.ravel(), y.ravel(), np.full(x.size, z)], axis=1)


def plate(width: float, height: float, *centre: float) -> pw.PlacedAperture:
    return pw.shapes.rectangle(width, height).placed(at(*centre))


PLATE = plate(13.0, 9.0, 3.0, 0.0, 47.0)
FLOOR = plate(300.0, 300.0, 0.0, 0.0, 94.0)
PATCHES = pw.Array([pw.shapes.square(0.6).moved((1.8 * k, 0.0)) for k in range(-3, 4)])
BEHIND, WIDE = grid(4, 30.0, 94.0), grid(5, 60.0, 188.0)


@cache
def large_ball() -> pw.Polyhedron:
    return moved(ball(9.4, 48), 3.0, 0.0, 47.0)


# A function returns bodies that are built by tests that use them only.
CASES: dict[str, tuple[Any, Any, np.ndarray]] = {
    "plates": (SQUARE, [PLATE, plate(9.0, 6.0, -10.0, -9.0, 38.0)], BEHIND),
    "patch above a floor": (
        SQUARE,
        [FLOOR, box((-9.0, -6.0, 63.0), (6.0, 6.0, 93.9)), moved(ball(6.0, 16), 16.0, 9.0, 63.0)],
        BEHIND,
    ),
    "ball of 80 faces": (SQUARE, moved(ball(9.4, 5), 3.0, 0.0, 47.0), BEHIND),
    "ball of 9,000 faces": (SQUARE, large_ball, BEHIND),
    "wide source": (pw.shapes.rectangle(12.0, 8.0), plate(13.0, 9.0, 3.0, 0.0, 94.0), WIDE),
    "array": (PATCHES, PLATE, BEHIND),
    "curved wave": (SQUARE.curved(16.0, 1.0), PLATE, BEHIND),
    "edge close to the source": (SQUARE, plate(13.0, 9.0, 6.0, 0.0, 6.0), BEHIND),
    "shadow boundary": (
        SQUARE,
        plate(20.0, 20.0, 0.0, 0.0, 47.0),
        np.stack([np.full(41, 20.0), np.linspace(-25.0, 25.0, 41), np.full(41, 94.0)], axis=1),
    ),
    "near": (SQUARE, PLATE, grid(7, 9.0, 47.5)),
    "far": (SQUARE, PLATE, grid(7, 3000.0, 9400.0)),
}


def field_and_sum(
    case: str, monkeypatch: pytest.MonkeyPatch, least: float = 0.0, **options: Any
) -> tuple[np.ndarray, EdgeSum | None]:
    """Return the field by nodes for more than ``least`` pairs of points, and the sum."""
    source, bodies, points = CASES[case]
    bodies = bodies() if callable(bodies) else bodies
    sums, of = [], EdgeSum.of
    monkeypatch.setattr(edge_sums, "_LEAST_PAIRS", least)
    with monkeypatch.context() as patch:
        patch.setattr(EdgeSum, "of", lambda *args: sums.append(of(*args)) or sums[-1])
        field = pw.amplitude(source, points, 1.0, obstacles=bodies, **options)
    return field, sums[0]


def largest_field(case: str) -> float:
    source, _, points = CASES[case]
    return float(np.abs(pw.amplitude(source, points, 1.0)).max())


@pytest.mark.parametrize("case", CASES)
def test_field_from_nodes_is_the_sum_over_all_points(
    case: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    method = RS2 if case.startswith("ball") else RS1
    options: Any = {"tolerance": 1e-4, "method": method, "engine": "numpy"}
    few, nodes = field_and_sum(case, monkeypatch, **options)
    every, none = field_and_sum(case, monkeypatch, np.inf, **options)
    assert nodes is not None and none is None
    assert len(nodes.nodes.far.positions) < len(nodes.points) / 2
    assert 0.0 < np.abs(few - every).max() < 1e-4 * largest_field(case)


def test_bodies_in_a_row_block_all_points_of_a_source(monkeypatch: pytest.MonkeyPatch) -> None:
    fields, bodies = [], [plate(6.0, 6.0, 0.0, 0.0, 30.0), plate(40.0, 40.0, 0.0, 0.0, 47.0)]
    monkeypatch.setattr(edge_sums, "_POINT_COST", np.inf)  # Nodes are always faster.
    for least in (0.0, np.inf):
        monkeypatch.setattr(edge_sums, "_LEAST_PAIRS", least)
        fields.append(pw.amplitude(SQUARE, BEHIND, 1.0, obstacles=bodies, engine="numpy"))
    assert fields[0] == pytest.approx(fields[1], rel=1e-12)


@pytest.mark.parametrize(
    ("case", "engine", "tolerances"),
    [
        ("plates", "numpy", (1e-3, 1e-4, 1e-6)),
        pytest.param("near", "llvm", (1e-5,), marks=pytest.mark.llvm),
    ],
)
def test_smaller_tolerances_take_more_nodes(
    case: str, engine: Any, tolerances: tuple[float, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    every, _ = field_and_sum(case, monkeypatch, np.inf, tolerance=1e-8)
    counts = []
    for tolerance in tolerances:
        few, nodes = field_and_sum(case, monkeypatch, tolerance=tolerance, engine=engine)
        assert nodes is not None
        counts.append(len(nodes.nodes.near.positions))
        assert np.abs(few - every).max() < tolerance * largest_field(case)
    assert counts == sorted(set(counts))


def test_points_of_a_wide_source_cost_as_much_as_its_nodes(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    _, nodes = field_and_sum("wide source", monkeypatch, tolerance=1e-4)
    assert nodes is not None
    assert 3 * len(nodes.nodes.near.positions) < len(nodes.points)


def test_points_behind_a_node_and_a_corner(monkeypatch: pytest.MonkeyPatch) -> None:
    _, nodes = field_and_sum("plates", monkeypatch, tolerance=1e-4)
    assert nodes is not None
    corner = nodes.edges[0, 0]
    lines = nodes.origins + (94.0 / corner[2]) * (corner - nodes.origins)
    monkeypatch.setitem(CASES, "lines", (SQUARE, CASES["plates"][1], lines))
    few, _ = field_and_sum("lines", monkeypatch, tolerance=1e-4)
    every, _ = field_and_sum("lines", monkeypatch, np.inf, tolerance=1e-4)
    assert np.abs(few - every).max() < 1e-4 * largest_field("lines")


def test_estimated_error_is_larger_than_the_error(monkeypatch: pytest.MonkeyPatch) -> None:
    source, bodies, points = CASES["plates"]
    monkeypatch.setattr(edge_sums, "_LEAST_PAIRS", 0)
    options: Any = {"obstacles": bodies, "tolerance": 1e-4}
    few, error = pw.amplitude_with_error(source, points, 1.0, **options)
    every, _ = field_and_sum("plates", monkeypatch, np.inf, tolerance=1e-6)
    assert (np.abs(few - every) < error).all()
    assert error.max() < 2e-4 * largest_field("plates")


def test_long_edges_cost_less_for_all_points(monkeypatch: pytest.MonkeyPatch) -> None:
    wall = plate(9000.0, 9.0, 4490.0, 0.0, 47.0)
    monkeypatch.setitem(CASES, "wall", (SQUARE, wall, BEHIND))
    assert field_and_sum("wall", monkeypatch, tolerance=1e-4)[1] is None
