"""What has no slice is not cut in NumPy, and nothing else changes by that."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import polywigner as pw
from polywigner.kernels.cut.clipping import BEHIND, MIRRORED
from polywigner.kernels.cut.slice_sums import may_meet
from polywigner.kernels.functions.plane import tables_of

FEW = 200  # so many samples at a time are all cut
# In units of the area: the same terms, those that are 0 left out.
ROUNDING = 1e-14

SQUARE = pw.shapes.square(1.0)
SOURCES: dict[str, Any] = {
    "chevron": pw.shapes.chevron(2.0, 1.1, 0.6),
    "ring": pw.shapes.ring(1.0, 0.6, 12),
    "octagon": pw.shapes.regular_polygon(8, 1.0),
    "far away": pw.Aperture(SQUARE.rings[0] + np.array([6500.0, -4000.0])),
    "needle": pw.Aperture([[0, 0], [10, 10], [9.99, 10.01], [-0.01, 0.01]]),
    "array": pw.Array([SQUARE, pw.Aperture([[2, 0], [3, 0], [2, 1]])], [1, -0.5j]),
    "two waves": SQUARE.with_illumination(pw.Illumination([1, 0.5j], [[0.3, 0.1], [-0.2, 0.4]])),
}


def _points(source: Any) -> tuple[np.ndarray, np.ndarray]:
    """Positions in and around the bounds, and lags up to more than the longest."""
    xmin, ymin, xmax, ymax = (source if hasattr(source, "bounds") else source.support).bounds
    rng = np.random.default_rng(5)
    low, size = np.array([xmin, ymin]), np.array([xmax - xmin, ymax - ymin])
    return low + size * rng.uniform(-0.3, 1.3, (3000, 2)), size * rng.uniform(-1.3, 1.3, (3000, 2))


def _by_parts(compute: Callable[[np.ndarray], np.ndarray], points: np.ndarray) -> np.ndarray:
    return np.concatenate([compute(points[k : k + FEW]) for k in range(0, len(points), FEW)])


@pytest.mark.parametrize("name", SOURCES)
@pytest.mark.parametrize("of", ["W", "A", "position marginal", "lag marginal"])
def test_many_samples_have_the_values_of_few_at_a_time(name: str, of: str) -> None:
    source = SOURCES[name]
    x, xi = _points(source)
    how: dict[str, Any] = {"engine": "numpy"}
    nu = np.array([0.7, -0.4]) / np.ptp(x, axis=0)
    computed: dict[str, tuple[np.ndarray, Callable[[np.ndarray], np.ndarray]]] = {
        "W": (x, lambda p: pw.wigner(source, p, nu, **how)),
        "A": (xi, lambda p: pw.ambiguity(source, nu, p, **how)),
        "position marginal": (x, lambda p: pw.position_marginal(source, p, **how)),
        "lag marginal": (xi, lambda p: pw.lag_marginal(source, p, **how)),
    }
    points, compute = computed[of]
    values = compute(points)
    area = source.area if hasattr(source, "area") else source.support.area
    assert np.abs(values - _by_parts(compute, points)).max() < ROUNDING * area
    assert (values == 0).any() and (values != 0).any()


@pytest.mark.parametrize("name", ["chevron", "octagon"])
def test_bounds_hold_all_that_has_a_slice_and_leave_out_much(name: str) -> None:
    source = SOURCES[name]
    x, xi = _points(source)
    tables = tables_of(source, True)
    inside = may_meet(tables, MIRRORED, *(2.0 * c for c in tables.frame.position(None, *x.T)))
    overlap = may_meet(tables, BEHIND, *tables.frame.vector(None, *xi.T))
    assert inside[_by_parts(lambda p: pw.position_marginal(source, p), x) > 0].all()
    assert overlap[_by_parts(lambda p: pw.lag_marginal(source, p), xi) > 0].all()
    assert inside.mean() < 0.6 and overlap.mean() < 0.6


def test_what_is_not_finite_is_so_in_the_result_wherever_it_stands() -> None:
    x, _ = _points(SOURCES["chevron"])
    nu = np.full(x.shape, 0.5)
    x[10, 0], nu[:20, 1] = np.nan, np.inf
    values = pw.wigner(SOURCES["chevron"], x, nu, engine="numpy")
    np.testing.assert_array_equal(np.isnan(values), np.arange(len(x)) < 20)
