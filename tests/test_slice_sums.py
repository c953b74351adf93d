"""Slices cut by winding numbers: W, A and areas where edges coincide, against exact clipping.

Random outlines with positions and lags at which copies of them coincide or touch, with ulps of
jitter (``oracles.degenerate``, ``oracles.positions``); values in rational arithmetic
(``oracles.exact``).
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache
from itertools import islice
from typing import Any

import numpy as np
import pytest

import polywigner as pw
from oracles import exact
from oracles.degenerate import outlines
from oracles.positions import Outline, frequencies, lags, outline, positions
from oracles.references import awkward, awkward_names
from polywigner.execution import ScalarOperations
from polywigner.kernels import tables_of
from polywigner.kernels.cut.clipping import MIRRORED
from polywigner.kernels.cut.pair_grid import outline_of, pair_grid
from polywigner.kernels.functions.plane import WIGNER
from polywigner.plans import forced
from test_compilation import compiled

# Of the area: half an ulp by which vertices and offsets are moved, times the perimeter, and some
# ulps of sums that are up to four times the area.
TOLERANCE = {True: 2e-14, False: 5e-6}
# Other code of polywigner errs as well.
BOTH = 2.0
# Vertices and offsets are moved by half a step of 2^-52 or 2^-23 of twice the diameter at most.
STEP = {True: 2.0**-51, False: 2.0**-22}

FEW, DRAWS = 40, 12
MANY, MANY_DRAWS = 1000, 100
# Numbers of cells across: one for each sign of T_x and T_y, some, and as many as there can be.
CELLS = (2, 8, 64)

ENGINES = ["numpy", pytest.param("llvm", marks=pytest.mark.llvm)]
engines = pytest.mark.parametrize("engine", ENGINES)
precisions = pytest.mark.parametrize("double", [True, False], ids=["double", "single"])


def computed(
    function: Any, source: Any, *points: np.ndarray, double: bool = True, engine: str = "numpy"
) -> np.ndarray:
    """A function at points (n, 2), of edges that are looked up in lists of pairs."""
    precision: Any = "double" if double else "single"
    with forced("pairs"):
        found: np.ndarray = function(source, *points, precision=precision, engine=engine)
    return found


def tolerance(source: Any, double: bool) -> float:
    """The error allowed, in m^2: more than that of the area only of thin outlines."""
    rings = source.rings
    edges = np.concatenate([np.roll(ring, -1, axis=0) - ring for ring in rings])
    sides = np.ptp(np.concatenate(rings), axis=0)
    # a needle is stretched before it is rounded
    size = np.sqrt(source.area) if len(rings) == 1 else float(np.hypot(*sides))
    moved = STEP[double] * size * float(np.hypot(*edges.T).sum())
    return max(TOLERANCE[double] * source.area, min(moved, 1e3 * TOLERANCE[double] * source.area))


def draws(
    seed: int, count: int
) -> Iterator[tuple[pw.Aperture, list[np.ndarray], Outline, np.random.Generator]]:
    rng = np.random.default_rng(seed)
    for source, rings in islice(outlines(rng), count):
        yield source, rings, outline(rings), rng


Case = tuple[pw.Aperture, tuple[np.ndarray, ...], np.ndarray]


@lru_cache
def cases(function: str, seed: int, count: int = FEW, each: int = DRAWS) -> list[Case]:
    """Outlines, degenerate points, and exact values of a function there."""
    found = []
    for source, rings, shape, rng in draws(seed, count):
        place = (positions if function in ("W", "lag slice") else lags)(rng, shape, each)
        nu = frequencies(rng, shape, each)
        points, values = (place,), None
        if function == "W":
            points = place, nu
            values = [exact.wigner(rings, p, f) for p, f in zip(place, nu, strict=True)]
        elif function == "A":
            points = nu, place
            values = [exact.ambiguity(rings, f, p) for p, f in zip(place, nu, strict=True)]
        else:
            region = exact.lag_region if function == "lag slice" else exact.position_region
            values = [float(region(rings, p).area) for p in place]
        found.append((source, points, np.array(values)))
    return found


KERNELS = {
    "W": pw.wigner,
    "A": pw.ambiguity,
    "lag slice": pw.position_marginal,
    "position slice": pw.lag_marginal,
}


@precisions
@engines
@pytest.mark.parametrize("function", KERNELS)
def test_values_are_exact_where_edges_coincide(function: str, engine: str, double: bool) -> None:
    for source, points, expected in cases(function, 1):
        found = computed(KERNELS[function], source, *points, double=double, engine=engine)
        assert np.abs(found - expected).max() <= tolerance(source, double)


@pytest.mark.slow
@engines
def test_w_is_exact_at_thousands_of_degenerate_positions(engine: str) -> None:
    for source, points, expected in cases("W", 2, FEW, MANY_DRAWS):
        for double in (True, False):
            found = computed(pw.wigner, source, *points, double=double, engine=engine)
            assert np.abs(found - expected).max() <= tolerance(source, double)


@pytest.mark.slow
@engines
def test_w_at_a_hundred_thousand_degenerate_positions_is_that_of_convex_pieces(engine: str) -> None:
    """Another cut, which takes its decisions line by line."""
    for source, _, shape, rng in draws(3, MANY):
        x, nu = positions(rng, shape, MANY_DRAWS), frequencies(rng, shape, MANY_DRAWS)
        with forced("edges"):
            expected = pw.wigner(source, x, nu, engine="numpy")
        for double in (True, False):
            found = computed(pw.wigner, source, x, nu, double=double, engine=engine)
            assert np.abs(found - expected).max() <= BOTH * tolerance(source, double)


@pytest.mark.parametrize("name", awkward_names())
def test_all_functions_are_exact_on_awkward_shapes(name: str) -> None:
    case = awkward(name)
    for double in (True, False):
        allowed = TOLERANCE[double] * case.area
        found = computed(pw.wigner, case.aperture, case.x, case.x_nu, double=double)
        assert np.abs(found - case.wigner).max() <= allowed
        found = computed(pw.ambiguity, case.aperture, case.upsilon, case.xi, double=double)
        assert np.abs(found - case.ambiguity).max() <= allowed


def test_any_lists_give_the_same_sums() -> None:
    """Those of few cells, where nearly all pairs are looked at, and those of many."""
    scalar = ScalarOperations()
    for source, _, shape, rng in draws(5, FEW):
        x, nu = positions(rng, shape, 3), frequencies(rng, shape, 3)
        tables = tables_of(source, True)
        outline = outline_of(tables, 0, True)
        found = []
        for across in CELLS:
            pairs = {(MIRRORED, 0, 0): pair_grid(outline, outline, across).held(scalar.held)}
            for p, f in zip(x.tolist(), nu.tolist(), strict=True):
                inner = WIGNER.enter(scalar, tables.frame, *p, *f)
                assert WIGNER.slices is not None
                sums = WIGNER.slices.by_pairs(scalar, tables, pairs, *inner)
                found += WIGNER.leave(scalar, tables.frame, inner, sums)
        expected = computed(pw.wigner, source, x, nu)
        assert np.abs(np.reshape(found, (len(CELLS), -1)) - expected).max() <= tolerance(
            source, True
        )


@pytest.mark.parametrize("waves", [1, 2, 5])
def test_sums_of_waves_are_those_of_convex_pieces(waves: int) -> None:
    for source, _, shape, rng in draws(6, FEW // 2):
        amplitudes = np.array([1.0, 1.0j]) @ rng.normal(size=(2, waves))
        field = pw.Illumination(amplitudes, rng.normal(size=(waves, 2)) * 5 / shape.diameter)
        lit, points = source.with_illumination(field), (positions, frequencies)
        x, nu = (draw(rng, shape, 20) for draw in points)
        allowed = BOTH * tolerance(source, True) * float(np.abs(amplitudes).sum()) ** 2
        with forced("edges"):
            expected = pw.wigner(lit, x, nu, engine="numpy")
        assert np.abs(computed(pw.wigner, lit, x, nu) - expected).max() <= allowed
        xi = lags(rng, shape, 20)
        with forced("edges"):
            expected = pw.ambiguity(lit, nu, xi, engine="numpy")
        assert np.abs(computed(pw.ambiguity, lit, nu, xi) - expected).max() <= allowed


@engines
def test_what_is_no_number_is_none_in_the_result(engine: str) -> None:
    source, bad = pw.shapes.chevron(1.0, 1.1, 0.4), [np.nan, np.inf, -np.inf]
    x, nu = np.zeros((8, 2)), np.ones((8, 2))
    nu[:3, 0], x[3:6, 1] = bad, bad
    for function, points in (
        (pw.wigner, (x, nu)),
        (pw.ambiguity, (nu, x)),
        (pw.position_marginal, (x,)),
        (pw.lag_marginal, (x,)),
    ):
        found = np.isnan(computed(function, source, *points, engine=engine))
        assert found.tolist() == [len(points) == 2] * 3 + [True] * 3 + [False] * 2


@pytest.mark.llvm
def test_a_new_outline_compiles_nothing(llvm: Any) -> None:
    functions = pw.wigner, pw.ambiguity

    def call(count: int, seed: int) -> None:
        for source, _, shape, rng in draws(seed, count):
            x, nu = positions(rng, shape, 50), frequencies(rng, shape, 50)
            for function in functions:
                computed(function, source, x, nu, engine="llvm")

    call(20, 7)
    with compiled() as found:
        call(60, 8)
    assert found == []
