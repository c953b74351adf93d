"""A slice cut once for many frequencies gives what cutting it for each of them gives."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import polywigner as pw
from oracles.references import ENGINES, awkward, numpy_and_few

# Of areas of about 1. The same terms with edges cut in float64; frequencies and positions are
# rounded to single precision before or after the cut, some 30 ulp of a phase of a few turns.
ROUNDING = {"double": 1e-14, "single": 5e-6}

# Of the area, against 60 digits: what the package promises.
ACCURACY = 1e-12
AWKWARD = ["square annulus", "nearly parallel edges, rotated", "two touching squares, rotated"]

SQUARE = pw.shapes.square(1.0)
SOURCES: dict[str, Callable[[], Any]] = {
    "chevron": lambda: pw.shapes.chevron(2.0, 1.1, 0.6),
    "needle": lambda: pw.Aperture([[0, 0], [10, 10], [9.99, 10.01], [-0.01, 0.01]]),
    "two waves": lambda: pw.shapes.chevron(2.0, 1.1, 0.6).with_illumination(
        pw.Illumination([1.0, 0.5j], [[0.3, 0.1], [-0.2, 0.4]])
    ),
    "weights": lambda: pw.Array([SQUARE, pw.Aperture([[2, 0], [3, 0], [2, 1]])], [1, 0.5j]),
    "mixed fields": lambda: pw.Array(
        [SQUARE.with_illumination(pw.Illumination([1.0], [[0.7, 0.2]])), pw.shapes.triangle(1, 1)],
        [1, -0.5],
    ),
}  # fmt: skip

engines = pytest.mark.parametrize("engine", ENGINES)
transforms = pytest.mark.parametrize("transform", [pw.wigner, pw.ambiguity])


def _points(transform: Any, positions: Any, frequencies: Any) -> tuple[Any, Any]:
    return (positions, frequencies) if transform is pw.wigner else (frequencies, positions)


EVERY = [(name, "double", f) for name in SOURCES for f in (pw.wigner, pw.ambiguity)]
EVERY += [("chevron", "single", pw.wigner), ("chevron", "single", pw.ambiguity)]
COMPILED = [EVERY[0], EVERY[4], EVERY[7], EVERY[8], EVERY[-1]]


@pytest.mark.parametrize(
    ("name", "precision", "transform", "engine"),
    numpy_and_few(EVERY, COMPILED, slow=[case for case in EVERY if case not in COMPILED]),
)
def test_every_place_with_every_frequency_has_the_values_of_single_points(
    name: str, precision: str, transform: Callable[..., Any], engine: str
) -> None:
    rng = np.random.default_rng(3)
    source, how = SOURCES[name](), {"engine": engine, "precision": precision}
    positions = rng.normal(size=(4, 1, 2)) * 0.3
    positions[0] = 0.0  # where copies coincide
    frequencies = rng.normal(size=(301, 2)) * 3  # no multiple of what lanes take together
    frequencies[:2] = [[0.0, 0.0], [1e-200, 0.0]]
    points = _points(transform, positions, frequencies)
    found = transform(source, *points, **how)
    each = transform(source, *(p.reshape(-1, 2) for p in np.broadcast_arrays(*points)), **how)
    np.testing.assert_allclose(found.ravel(), each, rtol=0, atol=ROUNDING[precision])
    turned = transform(
        source, *(p.swapaxes(0, -2) if p.ndim == 3 else p[:, None] for p in points), **how
    )
    np.testing.assert_allclose(turned.T, found, rtol=0, atol=ROUNDING[precision])


MANY_EDGES: dict[str, Callable[[], Any]] = {
    "regular": lambda: pw.shapes.regular_polygon(90, 0.5),
    "hole": lambda: pw.shapes.ring(0.6, 0.3, n=24),
    "weights": lambda: pw.Array(
        [pw.shapes.regular_polygon(30, 0.4), pw.shapes.regular_polygon(30, 0.3).moved((0.5, 0.1))],
        [1, -0.5],
    ),
}


@pytest.mark.slow
@engines
@transforms
@pytest.mark.parametrize(
    ("name", "precision"), [(name, "double") for name in MANY_EDGES] + [("weights", "single")]
)
def test_pairs_on_outlines_of_many_edges_have_the_values_of_single_points(
    name: str, precision: str, transform: Callable[..., Any], engine: str
) -> None:
    rng = np.random.default_rng(3)
    source, how = MANY_EDGES[name](), {"engine": engine, "precision": precision}
    positions = rng.normal(size=(12, 1, 2)) * 0.2
    positions[0] = 0.0
    frequencies = rng.normal(size=(300, 2)) * 4
    frequencies[:3] = [[0.0, 0.0], [1e-200, 0.0], [1e-7, 1e-7]]
    points = _points(transform, positions, frequencies)
    found = transform(source, *points, **how)
    each = transform(source, *(p.reshape(-1, 2) for p in np.broadcast_arrays(*points)), **how)
    np.testing.assert_allclose(found.ravel(), each, rtol=0, atol=ROUNDING[precision])


@engines
@pytest.mark.parametrize("name", AWKWARD)
def test_no_value_jumps_where_edges_coincide(name: str, engine: str) -> None:
    case, some = awkward(name), slice(0, 260)
    found = pw.wigner(case.aperture, case.x[some, None], case.x_nu[some], engine=engine)
    assert np.abs(np.diag(found) - case.wigner[some]).max() < ACCURACY * case.area
    found = pw.ambiguity(case.aperture, case.upsilon[some], case.xi[some, None], engine=engine)
    assert np.abs(np.diag(found) - case.ambiguity[some]).max() < ACCURACY * case.area


@engines
@transforms
def test_what_is_not_finite_stays_in_its_row_and_column(
    transform: Callable[..., Any], engine: str
) -> None:
    rng = np.random.default_rng(3)
    positions, frequencies = rng.normal(size=(4, 1, 2)) * 0.1, rng.normal(size=(300, 2))
    positions[1], positions[2], frequencies[7] = np.nan, 1e3, np.inf
    source = SOURCES["chevron"]()
    found = transform(source, *_points(transform, positions, frequencies), engine=engine)
    expected = np.zeros((4, 300), bool)
    expected[1], expected[:, 7] = True, True
    np.testing.assert_array_equal(np.isnan(found), expected)
    np.testing.assert_array_equal(found[2, np.arange(300) != 7], 0.0)  # nothing is left there


@pytest.mark.llvm
@pytest.mark.parametrize("columns", [260, 261])
@pytest.mark.parametrize("precision", ["double", "single"])
def test_slices_of_many_edges_serve_any_number_of_frequencies(
    llvm: Any, precision: Any, columns: int
) -> None:
    """Four of them a lane, or one; for places inside, outside, and nowhere."""
    source, rng = pw.shapes.ring(1.0, 0.6, n=24), np.random.default_rng(7)
    x, nu = rng.uniform(-1.1, 1.1, (70, 2)), rng.uniform(-4, 4, (columns, 2))
    x[3], nu[5] = np.nan, 0.0
    how: dict[str, Any] = {"precision": precision, "engine": "llvm"}
    found = pw.wigner(source, x[:, None], nu, **how)
    flat = (np.broadcast_to(p, (70, columns, 2)).reshape(-1, 2) for p in (x[:, None], nu))
    each = pw.wigner(source, *flat, **how).reshape(found.shape)
    allowed = 1e-13 if precision == "double" else 5e-6
    np.testing.assert_allclose(found, each, rtol=0, atol=allowed * source.area)
