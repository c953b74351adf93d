"""Values stay as they were, whatever computes them: layouts, precisions, engines.

`oracles.golden` has made them, by the NumPy engine in double precision and point by point.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache
from typing import Any

import numpy as np
import pytest

from oracles import golden

Values = Any

# Of the largest value that a function could have, all waves and elements in phase: a few roundings
# of its terms; in single precision of phases of some turns, too.
TOLERANCE = {"double": 1e-14, "single": 5e-6}
# Compiled sums over a thousand edges add their roundings one after the other; NumPy adds in pairs.
LONG_SUMS = {
    ("1000-gon", "fourier"): 1e-13,
    # W is a closed form now: the golden values are means over tilts, good to 3e-13 of the area
    ("partly coherent", "wigner"): 1e-12,
    ("curved, partly coherent", "wigner"): 1e-12,
}
# Of the largest irradiance: the rule of places may change where its estimate of the error does.
RAYS = 1e-6
# Of the largest derivative: terms cancel that are some turns as large.
SLOPES = 1e-11
# Of the largest value of a tile: closed forms of its own, with edges to and fro.
TILES = 1e-12
FREQUENCIES = 256  # the same ones again: enough for lists of slices to be compiled
SAMPLES = 1 << 13  # from which on they are sorted by cell

FROZEN = golden.read()

LONG = ("coast", "1000-gon")  # seconds of NumPy
# Dr.Jit arrays are for coherent sources; float32 has no points of these to more digits than asked.
TRACED = [name for name in golden.SOURCES if "partly" not in name]
LOST_IN_SINGLE = ("sliver", "far away")
COMPILED = ("square", "lattice")  # as long as all others by NumPy


@cache
def frozen(name: str, what: str) -> Values:
    return FROZEN[name][what]


def at(name: str) -> dict[str, Values]:
    return {key.removeprefix("at "): v for key, v in FROZEN[name].items() if key.startswith("at ")}


def layouts(name: str, function: str) -> Iterator[tuple[str, Values, Values, Values]]:
    """(layout, places, frequencies, values) that broadcast to one shape."""
    own, place = at(name), golden.place_of(function)
    yield "hard pairs", own[place], own["nu"], frozen(name, function)
    if "marginal" in function:
        return
    values = frozen(name, f"{function}, grid")
    times = FREQUENCIES // len(own["grid"])
    nu, some = np.tile(own["grid"], (times, 1)), np.tile(values, (1, times))
    places = own[f"places {place}"][: len(values)]
    if function == "fourier":
        yield "scattered", None, nu, some[0]
    else:
        yield "outer product", places[:, None], nu, some
        yield "frequencies as rows", places, nu[:, None], some.T
        yield "one place", places[2], nu, some[2]
        pairs = np.repeat(places, len(nu), axis=0), np.tile(nu, (len(places), 1))
        yield "scattered", *pairs, some.ravel()
    if nu.shape[-1] > 1:
        side = int(len(own["grid"]) ** 0.5)
        grid = np.tile(own["grid"].reshape(side, side, -1), (2, 2, 1))
        shape = grid.shape[:-1]
        own_values = np.tile(values[min(2, len(values) - 1)].reshape(side, side), (2, 2))
        yield "grid", None if function == "fourier" else places[2], grid, own_values.reshape(shape)


def marked(names: Any, quick: Any) -> list[Any]:
    """Names, of which all but the quick ones are slow."""
    return [n if n in quick else pytest.param(n, marks=pytest.mark.slow) for n in names]


CASES = [
    pytest.param(
        name,
        engine,
        precision,
        marks=[
            *([pytest.mark.llvm] if engine != "numpy" else []),
            *([pytest.mark.slow] if is_slow else []),
        ],
    )
    for name in golden.SOURCES
    for engine in ("numpy", "llvm", "auto")
    for precision in TOLERANCE
    for is_slow in [
        name in LONG if engine == "numpy" else name not in COMPILED or precision != "double"
    ]
]


@pytest.mark.parametrize(("name", "engine", "precision"), CASES)
def test_values_are_as_they_were_in_every_layout(name: str, engine: str, precision: str) -> None:
    how = {"engine": engine, "precision": precision}
    for function in golden.functions_of(name):
        for layout, place, nu, expected in layouts(name, function):
            found = golden.evaluate(name, function, place, nu, **how)
            assert found.shape == expected.shape
            error = np.abs(found - expected).max() / golden.scale_of(name, function)
            assert error <= allowed(name, function, precision), (function, layout)


def allowed(name: str, function: str, precision: str) -> float:
    return max(TOLERANCE[precision], LONG_SUMS.get((name, function), 0.0))


@pytest.mark.llvm
@pytest.mark.parametrize("precision", list(TOLERANCE))
@pytest.mark.parametrize("name", marked(TRACED, ["square"]))
def test_arrays_of_the_engine_have_the_same_values(name: str, precision: str) -> None:
    """Few, which are recorded, and many, which are sorted by cell."""
    import drjit.llvm.ad as backend

    if precision == "single" and name in LOST_IN_SINGLE:
        pytest.skip("float32 has no such points")
    numbers = backend.Float64 if precision == "double" else backend.Float
    kinds = {1: numbers, 2: backend.Array2f64, 3: backend.Array3f64}
    if precision == "single":
        kinds |= {2: backend.Array2f, 3: backend.Array3f}

    def points(values: Values) -> Any:
        columns = [numbers(np.ascontiguousarray(column)) for column in values.T]
        return kinds[len(columns)](*columns)

    for function in golden.functions_of(name):
        for layout, place, nu, expected in layouts(name, function):
            if layout not in ("hard pairs", "scattered"):
                continue
            times = SAMPLES // len(nu) + 1 if layout == "scattered" else 1
            many = [None if p is None else points(np.tile(p, (times, 1))) for p in (place, nu)]
            found = golden.evaluate(name, function, *many)
            parts = (found.real, found.imag) if np.iscomplexobj(expected) else (found,)
            values = np.array([np.array(part) for part in parts], np.float64)
            expected = np.stack([expected.real, expected.imag][: len(parts)])
            error = np.abs(values - np.tile(expected, times)).max()
            within = allowed(name, function, precision)
            assert error <= within * golden.scale_of(name, function), (function, layout)


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=[pytest.mark.slow] if name in LONG else [])
        for name in golden.SOURCES
        if "automean" in FROZEN[name]
    ],
)
def test_samples_of_the_automean_are_as_they_were(name: str) -> None:
    found, expected = golden.drawn(name), frozen(name, "automean")
    assert np.abs(found - expected).max(axis=0) == pytest.approx(
        0.0, abs=TOLERANCE["double"] * np.abs(expected).max()
    )


@pytest.mark.parametrize(
    "engine", ["numpy", pytest.param("llvm", marks=[pytest.mark.llvm, pytest.mark.slow])]
)
@pytest.mark.parametrize("precision", list(TOLERANCE))
@pytest.mark.parametrize("name", golden.MOMENTS)
def test_moments_of_lag_slices_are_as_they_were(name: str, precision: str, engine: str) -> None:
    found = golden.moments(name, at(name), engine, precision == "double")
    error = np.abs(found - frozen(name, "moments")) / golden.bounds_on_moments(name, at(name))
    assert error.max() <= TOLERANCE[precision]


@pytest.mark.parametrize("name", golden.LIT)
def test_irradiances_by_rays_are_as_they_were(name: str) -> None:
    expected = frozen(name, "irradiance")
    assert np.abs(golden.irradiances(name) - expected).max() <= RAYS * expected.max()


@pytest.mark.parametrize("kind", golden.KINDS)
@pytest.mark.parametrize("name", golden.PROJECTED)
def test_projections_are_as_they_were(name: str, kind: str) -> None:
    for tile, found in golden.tiles(name, kind).items():
        expected = frozen(name, f"tile of {tile}")
        assert np.abs(found - expected).max() <= TILES * np.abs(expected).max(), tile


@pytest.mark.llvm
@pytest.mark.parametrize("function", golden.FUNCTIONS[:3])
@pytest.mark.parametrize("name", marked(golden.DIFFERENTIATED, ["chevron"]))
def test_derivatives_are_as_they_were(name: str, function: str) -> None:
    for key, found in golden.slopes(name, function, at(name)).items():
        expected = frozen(name, f"slope of {key}")
        assert np.abs(found - expected).max() <= SLOPES * np.abs(expected).max(), key
