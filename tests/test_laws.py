"""All kinds of sources against all laws, on all engines: one table, in `laws`."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import laws
import polywigner as pw
from oracles import golden
from oracles.references import numpy_and_few
from polywigner.testing import assert_array_identities, assert_wigner_identities

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


# Of the sums and moves of `polywigner.testing`, one of each kind that takes a second at most; parts
# 60 sizes apart are too far for its sums over positions.
IDENTITIES = [
    "chevron",
    "two squares",
    "collection",
    "scattered",
    "three waves",
    "tapered slits",
    "row of slits",
    "overlapping",
    "leaning",
    "product, turned and moved",
    "tapered, steered lattice",
    "row of slits, any weights",
]
SLOW_IDENTITIES = [
    name
    for name in COHERENT
    if name not in (*IDENTITIES, "curved", "curved lattice", "distant parts")
]


@pytest.mark.parametrize(
    ("name", "precision"),
    [
        *((name, "double") for name in IDENTITIES),
        ("overlapping", "single"),
        *(pytest.param(name, "double", marks=pytest.mark.slow) for name in SLOW_IDENTITIES),
    ],
)
def test_marginals_energy_symmetries_and_moves_are_those_of_phase_space(
    name: str, precision: Any
) -> None:
    source = laws.source_of(name)
    holds = assert_array_identities if isinstance(source, pw.Array) else assert_wigner_identities
    holds(source, engine="numpy", points=24, precision=precision)


@pytest.mark.parametrize(("name", "engine"), numpy_and_few(laws.SOURCES, COMPILED[4:8]))
def test_the_autocorrelation_is_the_product_of_the_fields(name: str, engine: str) -> None:
    """u(x + xi/2) u*(x - xi/2), times the degree of coherence."""
    source, at = laws.source_of(name), laws.hard_points(name)
    rng = np.random.default_rng(8)
    # around places where corners meet, as near as slivers need it
    places = [np.repeat(p, 30, axis=0) for p in (at.x, at.xi)]
    reach = laws.size_of(name) * 10.0 ** rng.uniform(-7, 0, (len(places[0]), 1))
    x, xi = (p + reach * rng.normal(size=p.shape) for p in places)
    field = laws.field_of(name, x + xi / 2) * laws.field_of(name, x - xi / 2).conj()
    expected = field * laws.degree_of_coherence(name, xi)
    found = pw.autocorrelation(source, x, xi, engine=engine)
    strength = max(sum(abs(c) for c, _ in waves) for _, waves in laws.elements_of(name)) ** 2
    assert (expected != 0).any() and (expected == 0).any()
    assert np.abs(found - expected).max() <= max(1e-13, 10 * allowed_turns(at)) * 10 * strength


def allowed_turns(at: laws.Points) -> float:
    """What rounding of places loses of phases, in turns."""
    return float(np.abs(at.x).max() * np.abs(at.nu).max() * np.finfo(float).eps)


def layouts(place: Any, nu: Any, grid: Any) -> dict[str, tuple[Any, Any]]:
    """Places (m, d) and frequencies (n, d), a grid of them as well, that broadcast together."""
    flat = grid.reshape(-1, grid.shape[-1])
    pairs = np.repeat(place, len(nu), axis=0), np.tile(nu, (len(place), 1))
    return {
        "every place with every frequency": (place[:, None], nu),
        "frequencies as rows": (place, nu[:, None]),
        "one place": (place[1], nu),
        "one frequency": (pairs[0], nu[1]),
        "pairs in two dimensions": tuple(p.reshape(len(place), len(nu), -1) for p in pairs),
        "a grid of frequencies": (place[1], grid),
        "places with a grid": (place[:3, None, None], grid),
        "a list that is a grid": (place[1], flat),
    }


@pytest.mark.parametrize(
    ("name", "precision", "engine"),
    numpy_and_few(
        [(name, "double") for name in laws.SOURCES] + [(name, "single") for name in SINGLE],
        [(name, "double") for name in ("chevron", "30-gon", "overlapping", "slits")]
        + [("tapered, steered lattice", "double"), ("three waves", "single")],
        slow=[
            (name, "double")
            for name in ("holes", "scattered", "collection", "lattice", "row of any weights")
        ],
    ),
)
def test_the_layout_of_points_changes_no_value(name: str, precision: str, engine: str) -> None:
    """What is no number stays in its row and column; nothing is found far away."""
    source, at = laws.source_of(name), laws.hard_points(name)
    how: Any = {"precision": precision, "engine": engine}
    size, d = laws.size_of(name), at.x.shape[1]
    axes = [np.linspace(-9, 9, 17), np.concatenate([-np.geomspace(1e-9, 8, 8), [0], [0.3, 5, 9]])]
    grid = np.stack(np.meshgrid(*axes[:d], indexing="ij"), axis=-1) / size
    nu = np.random.default_rng(3).normal(size=(260 + d, d)) * 4 / size
    nu[:2], nu[7], nu[9] = 0.0, np.inf, np.nan
    for function in golden.FUNCTIONS[:3]:
        if function == "fourier" and "partly" in name:
            continue
        place = place_of(function, at)[:5].copy()
        place[2], place[3] = np.nan, place[3] + 1e3 * size * len(laws.elements_of(name))
        for layout, points in layouts(place, nu, grid).items():
            if function == "fourier":
                points = (points[0], points[1]) if "place" not in layout else points
            asked = arguments(function, *points)
            found = getattr(pw, function)(source, *asked, **how)
            flat = [p.reshape(-1, d) for p in np.broadcast_arrays(*asked)]
            each = getattr(pw, function)(source, *flat, engine="numpy").reshape(found.shape)
            np.testing.assert_array_equal(np.isnan(found), np.isnan(each), err_msg=layout)
            error = np.nan_to_num(np.abs(found - each)).max()
            assert error <= allowed(name, function, precision), (function, layout)
            if function != "fourier" and layout == "every place with every frequency":
                bad = np.isnan(nu).any(axis=1) | np.isinf(nu).any(axis=1)
                assert np.isnan(found[2]).all() and np.isnan(found[:, bad]).all()
                assert not found[3, ~bad].any() and not np.isnan(found[3, ~bad]).any()
