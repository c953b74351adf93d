"""All kinds of sources against all laws, on all engines: one table, in `laws`."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import laws
import polywigner as pw
from oracles import golden
from oracles.references import numpy_and_few

# Of a bound on the function, all waves and elements in phase: some roundings of sums of few terms;
# in single precision of phases of some turns as well.
TOLERANCE = {"double": 2e-14, "single": 3e-6}
# Vertices and phases at 7000 sizes from the origin are rounded; tables of weights interpolate.
LARGER = {
    "product, far away": 5e-13,
    "lattice of any weights": 2e-13,
    "row of any weights": 2e-13,
    "long row of any weights": 2e-13,
}
COHERENT = [name for name in laws.SOURCES if "partly" not in name]
# On compiled engines, where a kernel takes half a second: each a kernel or a list of its own.
COMPILED = [
    "chevron",
    "30-gon",
    "holes",
    "nearly parallel",
    "overlapping",
    "fields of their own",
    "product, turned and moved",
    "tapered, steered lattice",
    "small lattice of any weights",
    "row of any weights",
    "scattered far away",
    "slits of any weights",
    "small distant parts",
]
SINGLE = ["chevron", "30-gon", "overlapping", "tapered, steered lattice", "slits"]


def allowed(name: str, function: str, precision: str) -> float:
    error = max(TOLERANCE[precision], LARGER.get(name, 0.0))
    return error * laws.scale_of(name, function)


def arguments(function: str, place: Any, nu: Any) -> tuple[Any, ...]:
    return {
        "wigner": (place, nu),
        "ambiguity": (nu, place),
        "fourier": (nu,),
        "position_marginal": (place,),
        "lag_marginal": (place,),
    }[function]


def place_of(function: str, at: laws.Points) -> Any:
    return at.xi if golden.place_of(function) == "xi" else at.x


@pytest.mark.parametrize(
    ("name", "precision", "engine"),
    numpy_and_few(
        [(name, precision) for name in COHERENT for precision in TOLERANCE],
        [(name, "double") for name in COMPILED] + [(name, "single") for name in SINGLE],
    ),
)
def test_transforms_are_those_of_exact_slices(name: str, precision: str, engine: str) -> None:
    """Where edges of the copies coincide or nearly do, and elsewhere; at all sizes of nu."""
    at, source = laws.hard_points(name), laws.source_of(name)
    for function in golden.FUNCTIONS:
        if function == "fourier" and isinstance(source, pw.Wavefront):
            continue  # quadrature in test_curved_waves
        expected = laws.exact_values(name, function)
        points = (p[: len(expected)] for p in arguments(function, place_of(function, at), at.nu))
        found = getattr(pw, function)(source, *points, precision=precision, engine=engine)
        assert found.shape == expected.shape
        assert np.abs(found - expected).max() <= allowed(name, function, precision), function
