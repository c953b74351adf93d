"""Positions and lags at which edges of the two copies coincide, nearly coincide, or touch.

28 shapes with 500 positions and 300 lags each, jittered by ulps, against exact clipping (see
``oracles/generate.py``): whichever way rounding decides, no value may jump.
"""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest

import polywigner as pw
from oracles import exact
from oracles.references import FEW, Reference, awkward, awkward_names, numpy_and_few

# Relative to the area: what the package promises.
TOLERANCE = {"double": 1e-12, "single": 5e-6}
# Values computed now against values read from the file.
ORACLE_TOLERANCE = 1e-16
LIVE_POSITIONS, LIVE_LAGS = 6, 4

shapes = pytest.mark.parametrize("name", awkward_names())


engines = pytest.mark.parametrize(
    ("name", "precision", "engine"),
    numpy_and_few(product(awkward_names(), TOLERANCE), product(FEW, TOLERANCE)),
)


def _worst(reference: Reference, got: np.ndarray, expected: np.ndarray) -> tuple[float, int]:
    error = np.abs(got - expected) / reference.area
    assert np.isfinite(error).all()
    return float(error.max()), int(error.argmax())


@engines
def test_wigner_does_not_jump_where_edges_coincide(name: str, engine: str, precision: str) -> None:
    case = awkward(name)
    x, nu = case.x, case.x_nu
    got = pw.wigner(case.aperture, x, nu, precision=precision, engine=engine)
    error, worst = _worst(case, got, case.wigner)
    assert error < TOLERANCE[precision], (x[worst].tolist(), nu[worst].tolist())


@engines
def test_ambiguity_does_not_jump_where_edges_coincide(
    name: str, engine: str, precision: str
) -> None:
    case = awkward(name)
    upsilon, xi = case.upsilon, case.xi
    got = pw.ambiguity(case.aperture, upsilon, xi, precision=precision, engine=engine)
    error, worst = _worst(case, got, case.ambiguity)
    assert error < TOLERANCE[precision], (upsilon[worst].tolist(), xi[worst].tolist())


@shapes
def test_marginals_are_exact_areas_where_edges_coincide(name: str) -> None:
    case, rng = awkward(name), np.random.default_rng(1)
    x = case.x[rng.integers(len(case.x), size=LIVE_POSITIONS)]
    xi = case.xi[rng.integers(len(case.xi), size=LIVE_LAGS)]
    areas = [float(exact.lag_region(case.rings, p).area) for p in x]
    got = pw.position_marginal(case.aperture, x, engine="numpy")
    assert _worst(case, got, np.array(areas))[0] < TOLERANCE["double"]
    areas = [float(exact.position_region(case.rings, p).area) for p in xi]
    got = pw.lag_marginal(case.aperture, xi, engine="numpy")
    assert _worst(case, got, np.array(areas))[0] < TOLERANCE["double"]


@shapes
def test_the_stored_values_are_what_exact_clipping_gives(name: str) -> None:
    case, rng = awkward(name), np.random.default_rng(2)
    for k in rng.integers(len(case.x), size=LIVE_POSITIONS):
        value = exact.wigner(case.rings, case.x[k], case.x_nu[k])
        assert value == pytest.approx(case.wigner[k], abs=ORACLE_TOLERANCE * case.area)
    for k in rng.integers(len(case.xi), size=LIVE_LAGS):
        value = exact.ambiguity(case.rings, case.upsilon[k], case.xi[k])
        assert value == pytest.approx(case.ambiguity[k], abs=ORACLE_TOLERANCE * case.area)


def test_there_are_at_least_17_shapes_with_500_special_positions_each() -> None:
    assert len(awkward_names()) >= 17
    assert all(len(awkward(name).x) >= 500 for name in awkward_names())
