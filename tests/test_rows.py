"""Edges taken as rows of a table give what edges compiled as constants give, coincident or not.

Which way is taken depends on the number of edges and samples; here both are forced upon all.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest

import polywigner as pw
from oracles.references import FEW, awkward, awkward_names, numpy_and_few
from polywigner.plans import forced, loops_over_edges

# Relative to the area: what the package promises.
TOLERANCE = {"double": 1e-12, "single": 5e-6}

precisions = pytest.mark.parametrize("precision", list(TOLERANCE))


@pytest.fixture
def rows_only() -> Iterator[None]:
    with forced("rows"):
        yield


@pytest.mark.usefixtures("rows_only")
@pytest.mark.parametrize(("name", "engine"), numpy_and_few(awkward_names(), FEW))
@precisions
def test_no_value_jumps_where_edges_are_rows(name: str, engine: str, precision: str) -> None:
    case, how = awkward(name), {"engine": engine, "precision": precision}
    allowed = TOLERANCE[precision] * case.area
    got = pw.wigner(case.aperture, case.x, case.x_nu, **how)
    assert np.abs(got - case.wigner).max() < allowed
    if engine == "numpy":  # one more kernel each: half a minute of compilation on LLVM
        got = pw.ambiguity(case.aperture, case.upsilon, case.xi, **how)
        assert np.abs(got - case.ambiguity).max() < allowed
        still = np.zeros(2)
        got = pw.position_marginal(case.aperture, case.x, **how)
        assert np.abs(got - pw.wigner(case.aperture, case.x, still, **how)).max() < allowed
        got = pw.lag_marginal(case.aperture, case.xi, **how)
        assert np.abs(got - pw.ambiguity(case.aperture, still, case.xi, **how)).max() < allowed


@pytest.mark.slow
@pytest.mark.llvm
@pytest.mark.usefixtures("rows_only")
def test_an_outline_of_many_edges_compiles_in_rows() -> None:
    ring = pw.shapes.ring(1.0, 0.6)
    assert loops_over_edges(sum(map(len, ring.rings)) * sum(map(len, ring.convex_cover)))
    rng = np.random.default_rng(1)
    x, nu = rng.uniform(-1, 1, (500, 2)), rng.uniform(-3, 3, (500, 2))
    for precision, tolerance in TOLERANCE.items():
        got = pw.wigner(ring, x, nu, engine="llvm", precision=precision)
        assert np.abs(got - pw.wigner(ring, x, nu, engine="numpy")).max() < tolerance * ring.area


def test_few_samples_in_single_precision_are_accurate_where_both_copies_nearly_coincide() -> None:
    """At the centre of a regular polygon its neighbours cut each edge at small angles."""
    polygon = pw.shapes.regular_polygon(97, 1.0)
    corners = polygon.rings[0]
    x = np.vstack([np.zeros(2), (np.roll(corners, -1, axis=0) - corners)[:40] / 100])
    exact = pw.position_marginal(polygon, x, engine="numpy")
    got = pw.position_marginal(polygon, x, engine="numpy", precision="single")
    assert np.abs(got - exact).max() < TOLERANCE["single"] * polygon.area
