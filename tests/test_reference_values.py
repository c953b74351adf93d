"""Reference values: two independent methods agree on them to 6.5e-16 of the area."""

from __future__ import annotations

import math
from collections import defaultdict
from functools import lru_cache
from typing import Any

import numpy as np
import pytest

import polywigner as pw
from oracles import exact
from oracles.references import ENGINES, aperture, read_json

# Relative to the area: what the package promises.
TOLERANCE = {"double": 1e-12, "single": 5e-6}
# The oracles against values that were found independently of them.
ORACLE_TOLERANCE = 2e-15

engines = pytest.mark.parametrize("engine", ENGINES)
precisions = pytest.mark.parametrize("precision", list(TOLERANCE))


def _complex(pair: list[str]) -> complex:
    return complex(float(pair[0]), float(pair[1]))


def _polygons(shape: dict[str, Any]) -> list[tuple[np.ndarray, list[np.ndarray]]]:
    """The three ways in which the files write a shape."""
    if "polygons" in shape:
        return [(np.array(p["outer"]), list(map(np.array, p["holes"]))) for p in shape["polygons"]]
    if np.ndim(shape["vertices"]) == 3:
        return [(np.array(ring), []) for ring in shape["vertices"]]
    return [(np.array(shape["vertices"])[:, :2], [])]


@lru_cache(maxsize=8)
def _grouped(name: str, kind: str | None = None) -> list[tuple[Any, list[dict[str, Any]]]]:
    """(polygons, cases) of each shape in a file."""
    data, groups = read_json(name), defaultdict(list)
    for case in data["cases"]:
        if kind is None or case["kind"] == kind:
            groups[case["shape"]].append(case)
    return [(_polygons(data["shapes"][shape]), cases) for shape, cases in groups.items()]


def _column(cases: list[dict[str, Any]], key: str) -> np.ndarray:
    return np.array([case[key] for case in cases])


def _values(cases: list[dict[str, Any]], key: str = "value") -> np.ndarray:
    return np.array([_complex(case[key]) for case in cases])


def _frequencies(cases: list[dict[str, Any]]) -> np.ndarray:
    """The file writes exp(+i q.r); ours is exp(-2 pi i nu.x)."""
    return np.array([[_complex(c) for c in case["q"][:2]] for case in cases]) / (-2 * math.pi)


@engines
@precisions
def test_the_wigner_function_has_its_reference_values(engine: str, precision: str) -> None:
    for polygons, cases in _grouped("wigner", "W"):
        source = aperture(polygons)
        x, nu = _column(cases, "x"), _column(cases, "nu")
        value = pw.wigner(source, x, nu, precision=precision, engine=engine)
        error = np.abs(value - _values(cases).real).max() / source.area
        assert error < TOLERANCE[precision]


@engines
@precisions
def test_the_ambiguity_function_has_its_reference_values(engine: str, precision: str) -> None:
    for polygons, cases in _grouped("wigner", "A"):
        source = aperture(polygons)
        upsilon, xi = _column(cases, "upsilon"), _column(cases, "xi")
        value = pw.ambiguity(source, upsilon, xi, precision=precision, engine=engine)
        assert np.abs(value - _values(cases)).max() / source.area < TOLERANCE[precision]


@engines
@precisions
def test_the_lag_marginal_is_the_otf_of_the_pupil(engine: str, precision: str) -> None:
    for polygons, cases in _grouped("otf"):
        source = aperture(polygons)
        xi, otf = _column(cases, "xi"), _column(cases, "otf").astype(float)
        by_marginal = pw.lag_marginal(source, xi, precision=precision, engine=engine)
        assert np.abs(by_marginal / source.area - otf).max() < TOLERANCE[precision]
        keywords = {"precision": precision, "engine": engine}
        by_ambiguity = pw.ambiguity(source, np.zeros(2), xi, **keywords)
        assert np.abs(by_ambiguity / source.area - otf).max() < TOLERANCE[precision]


@engines
@precisions
def test_fourier_transforms_have_their_reference_values_complex_nu_included(
    engine: str, precision: str
) -> None:
    for polygons, cases in _grouped("fourier_polygons"):
        source = aperture(polygons)
        nu = _frequencies(cases)
        value = pw.fourier(source, nu, precision=precision, engine=engine)
        assert np.abs(value - _values(cases, "F")).max() / source.area < TOLERANCE[precision]
        real = (nu.imag == 0).all(axis=1)  # a real array takes its own way through the kernel
        value = pw.fourier(source, nu[real].real, precision=precision, engine=engine)
        assert np.abs(value - _values(cases, "F")[real]).max() / source.area < TOLERANCE[precision]


def test_the_oracle_has_the_reference_values() -> None:
    """They come from two methods, of which the other one integrates over scanlines."""
    for kind, x, nu, transform in (
        ("W", "x", "nu", exact.wigner),
        ("A", "upsilon", "xi", exact.ambiguity),
    ):
        for polygons, cases in _grouped("wigner", kind):
            rings = exact.oriented(polygons)
            value = [transform(rings, case[x], case[nu]) for case in cases]
            expected = _values(cases) if kind == "A" else _values(cases).real
            assert np.abs(np.array(value) - expected).max() < ORACLE_TOLERANCE
    for polygons, cases in _grouped("fourier_polygons"):
        rings = exact.oriented(polygons)
        value = np.array([exact.fourier(rings, nu) for nu in _frequencies(cases)])
        assert np.abs(value - _values(cases, "F")).max() < ORACLE_TOLERANCE * exact.area(rings)
