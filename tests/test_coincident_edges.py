"""Positions and lags at which edges of the two copies coincide, nearly coincide, or touch.

Values must be continuous for any rounding. References are exact clipping of 28 shapes and of
random outlines (``oracles/generate.py``, ``oracles.degenerate``).
"""

from collections.abc import Callable
from functools import lru_cache
from itertools import islice, product
from typing import Any

import numpy as np
import pytest
import shapely

import polywigner as pw
from oracles import exact
from oracles.degenerate import outlines
from oracles.positions import frequencies, lags, outline, positions
from oracles.references import ENGINES, FEW, awkward, awkward_names, numpy_and_few

# Accuracy that the documentation states, relative to the area.
TOLERANCE = {"double": 1e-12, "single": 5e-6}
# Errors due to the rounding of vertices and offsets, times the perimeter, and to the rounding of
# sums of up to four areas.
BY_PAIRS = {"double": 2e-14, "single": 5e-6}
# Vertices and offsets move by at most half a step of 2^-52 or 2^-23 of twice the diameter.
GRID_STEP = {"double": 2.0**-51, "single": 2.0**-22}
FEW_OUTLINES, DRAWS = 9, 6

engines = pytest.mark.parametrize("engine", ENGINES)
FUNCTIONS: dict[str, Callable[..., Any]] = {
    "W": pw.wigner,
    "A": pw.ambiguity,
    "lag slice": pw.position_marginal,
    "position slice": pw.lag_marginal,
}


@pytest.mark.parametrize(
    ("name", "precision", "engine"),
    numpy_and_few(
        [(name, precision) for name in awkward_names() for precision in TOLERANCE],
        [(name, precision) for name in FEW for precision in TOLERANCE],
    ),
)
def test_no_value_jumps_where_edges_coincide(name, precision, engine):
    case, how = awkward(name), {"precision": precision, "engine": engine}
    by_wigner = pw.wigner(case.aperture, case.x, case.x_nu, **how) - case.wigner
    by_ambiguity = pw.ambiguity(case.aperture, case.upsilon, case.xi, **how) - case.ambiguity
    allowed = (BY_PAIRS if engine == "numpy" else TOLERANCE)[precision]
    for error, points in (
        (by_wigner, (case.x, case.x_nu)),
        (by_ambiguity, (case.xi, case.upsilon)),
    ):
        worst = int(np.abs(error).argmax())
        assert np.isfinite(error).all()
        assert np.abs(error[worst]) <= allowed * case.area, [p[worst].tolist() for p in points]


# Number of samples above which few edges are compiled as code.
AS_CODE = 1 << 18


@engines
def test_a_hole_that_single_precision_reduces_to_a_point_has_no_effect(engine):
    ring = pw.shapes.regular_polygon(6, 1.0).rings[0]
    source = pw.Aperture(shapely.Polygon(ring, [1e-9 * ring]))
    xi, upsilon = np.random.default_rng(0).uniform(-1.5, 1.5, (40, 2)), np.zeros((40, 2))
    result = pw.ambiguity(source, upsilon, xi, precision="single", engine=engine)
    expected = pw.ambiguity(pw.Aperture(ring), upsilon, xi, engine="numpy")
    assert np.abs(result - expected).max() < TOLERANCE["single"] * source.area


@pytest.mark.llvm
@pytest.mark.parametrize(
    ("name", "precision"),
    [
        *((name, "double") for name in FEW[:2]),
        *((name, "single") for name in FEW[1:2]),
        *(pytest.param(name, "double", marks=pytest.mark.slow) for name in FEW[2:]),
    ],
)
def test_no_value_jumps_where_edges_are_code(name, precision):
    case = awkward(name)
    rows = np.arange(AS_CODE) % len(case.x)
    plan = pw.explain(case.aperture, case.x[rows], case.x_nu[rows])
    assert (plan.strategy == "edges as code") == (sum(map(len, case.aperture.rings)) <= 16)
    allowed = TOLERANCE[precision] * case.area
    result = pw.wigner(case.aperture, case.x[rows], case.x_nu[rows], precision=precision)
    assert np.abs(result - case.wigner[rows]).max() <= allowed
    rows = np.arange(AS_CODE) % len(case.xi)
    result = pw.ambiguity(case.aperture, case.upsilon[rows], case.xi[rows], precision=precision)
    assert np.abs(result - case.ambiguity[rows]).max() <= allowed


def tolerance(source, precision):
    """Return the error allowed in m^2, which is larger for thin outlines."""
    rings = source.rings
    edges = np.concatenate([np.roll(ring, -1, axis=0) - ring for ring in rings])
    sides = np.ptp(np.concatenate(rings), axis=0)
    # Rounding happens before the stretch of a needle.
    size = np.sqrt(source.area) if len(rings) == 1 else float(np.hypot(*sides))
    rounded = GRID_STEP[precision] * size * float(np.hypot(*edges.T).sum())
    least = BY_PAIRS[precision] * source.area
    return max(least, min(rounded, 1e3 * least))


@lru_cache
def cases(function, seed, count, each):
    """Return outlines, degenerate points, and exact values of a function."""
    rng, result = np.random.default_rng(seed), []
    for source, rings in islice(outlines(rng), count):
        shape = outline(rings)
        place = (positions if function in ("W", "lag slice") else lags)(rng, shape, each)
        nu = frequencies(rng, shape, each)
        points: tuple[np.ndarray, ...] = (place,)
        if function == "W":
            points = place, nu
            values = [exact.wigner(rings, p, f) for p, f in zip(place, nu, strict=True)]
        elif function == "A":
            points = nu, place
            values = [exact.ambiguity(rings, f, p) for p, f in zip(place, nu, strict=True)]
        else:
            region = exact.lag_region if function == "lag slice" else exact.position_region
            values = [float(region(rings, p).area) for p in place]
        result.append((source, points, np.array(values)))
    return result


@pytest.mark.parametrize("precision", TOLERANCE)
@engines
@pytest.mark.parametrize("function", FUNCTIONS)
def test_random_outlines_have_exact_values(function, engine, precision):
    for source, points, expected in cases(function, 1, FEW_OUTLINES, DRAWS):
        result = FUNCTIONS[function](source, *points, precision=precision, engine=engine)
        assert np.abs(result - expected).max() <= tolerance(source, precision)


def comb(teeth, angle):
    """Return a comb whose teeth and gaps have equal widths, so that many edges coincide."""
    gap = [[[x, 1.0], [x, 3.0], [x + 1, 3.0], [x + 1, 1.0]] for x in np.arange(0.0, 2 * teeth, 2)]
    ring = np.vstack([[[2.0 * teeth - 1, 0.0], [0.0, 0.0]], *gap])
    ring = np.delete(ring, [2, len(ring) - 1], axis=0)  # on the sides of the back
    c, s = np.cos(angle), np.sin(angle)
    return pw.Aperture(ring / teeth @ np.array([[c, s], [-s, c]]))


def with_touching_holes(count):
    """Return an outline with a row of square holes that touch at corners."""
    corners = np.array([[0, 0], [0.5, -0.5], [1, 0], [0.5, 0.5]])
    holes = shapely.union_all([shapely.Polygon(corners + np.array([k, 0])) for k in range(count)])
    return pw.Aperture(shapely.box(-1, -1, count + 1, 1).difference(holes))


# Outlines with enough vertices that cells of pairs are divided several times.
OUTLINES: dict[str, Callable[[], pw.Aperture]] = {
    "regular polygon": lambda: pw.shapes.regular_polygon(48, 1.0),
    "star": lambda: pw.shapes.star(12, 1.0, 0.4),
    "ring with a small hole": lambda: pw.shapes.ring(1.0, 0.02, 24),
    "turned comb": lambda: comb(12, 0.3),
    "touching hexagons": lambda: pw.shapes.hexagonal_segments(1.0),
    "touching holes": lambda: with_touching_holes(8),
}
# Number of points of each outline.
COUNT = 60
# Area below which a part of a slice is ignored.
NO_SLIVER = 1e-12
# Errors relative to the area, or to the product of diameter and perimeter.
BY_BOUNDARY = {"double": 4e-16, "single": 6e-7}


def transform_of(region, nu):
    """Return F of the parts of a slice that are not slivers."""
    parts = [part for part in getattr(region, "geoms", [region]) if part.area > NO_SLIVER]
    return sum(complex(pw.fourier(pw.Aperture(part), nu)) for part in parts)


@pytest.mark.parametrize(
    ("name", "engine"),
    numpy_and_few(OUTLINES, ["ring with a small hole"], slow=["turned comb", "touching hexagons"]),
)
def test_outlines_of_many_edges_transform_their_slices(name, engine):
    source, rng = OUTLINES[name](), np.random.default_rng(120)
    boundary = source.diameter * shapely.length(source.polygons)
    corners = np.concatenate(source.rings)
    pairs = corners[rng.integers(len(corners), size=(2, COUNT))]
    x, lag = pairs.mean(axis=0), pairs[0] - pairs[1]
    some, others = slice(0, COUNT // 3), slice(COUNT // 3, 2 * COUNT // 3)
    x[some] = rng.uniform(*np.reshape(source.bounds, (2, 2)), (COUNT // 3, 2))
    x[others] *= 1 + 2**-52 * rng.integers(-2, 3, (COUNT // 3, 2))
    nu = rng.uniform(-1, 1, x.shape) * 10 ** rng.uniform(-2, 1.5, (len(x), 1)) / source.diameter
    # The expected values are transforms F of slices that GEOS computes.
    expected_w = [transform_of(pw.lag_slice(source, p), f).real for p, f in zip(x, nu, strict=True)]
    expected_a = [
        transform_of(pw.position_slice(source, p), f) for p, f in zip(lag, nu, strict=True)
    ]
    for precision, relative in TOLERANCE.items():
        allowed = max(relative * source.area, BY_BOUNDARY[precision] * boundary)
        result = pw.wigner(source, x, nu, engine=engine, precision=precision)
        assert np.abs(result - expected_w).max() < allowed
        result = pw.ambiguity(source, nu, lag, engine=engine, precision=precision)
        assert np.abs(result - expected_a).max() < allowed


@engines
def test_without_a_frequency_shift_sums_of_many_edges_round_no_worse(engine):
    """A(0, xi) of many edges needs compensated summation."""
    source = pw.shapes.regular_polygon(256, 1.0)
    xi = 0.3 * np.random.default_rng(1).normal(size=(500, 2))
    result = pw.ambiguity(source, [0.0, 0.0], xi, engine=engine, precision="single")
    # The limit is a fifth of the limit for W. Without compensation, the error would be 2e-6.
    assert np.abs(result - pw.lag_marginal(source, xi)).max() < 1e-6 * source.area


# Errors for many edges, because each end of an edge has an error of some ulps.
POLYGON = {"double": 2e-14, "single": 5e-6}
# Errors of rings by inner radius. The rounding of vertices is multiplied by diameter times
# perimeter over area, which is 40 for the radius 0.9 and 400 for 0.99.
RING = {0.9: 6e-14, 0.99: 3e-13}


def polygon(n, shear=0.0):
    angle = 2 * np.pi * np.arange(n) / n + 0.1
    return np.column_stack([np.cos(angle) + shear * np.sin(angle), np.sin(angle)])


def worst_error(rings, xi, samples, **how):
    """Return the largest error of W and R at the origin and of A at a lag, relative to the area."""
    source = pw.Aperture(shapely.Polygon(rings[0], rings[1:]))
    nu = np.array([[0.0, 0.0], [0.3, 0.2], [1.3, -0.7]])
    oriented = [ring[:: (-1) ** k] for k, ring in enumerate(rings)]
    lag, mean = exact.lag_region(oriented, (0.0, 0.0)), exact.position_region(oriented, xi)
    rows = np.arange(samples) % len(nu)
    nowhere, there = np.zeros((samples, 2)), np.broadcast_to(xi, (samples, 2))
    wigner = np.array([complex(exact.transform(lag, k)).real for k in nu])[rows]
    ambiguity = np.array([complex(exact.transform(mean, k)) for k in nu])[rows]
    errors = [
        pw.wigner(source, nowhere, nu[rows], **how) - wigner,
        pw.position_marginal(source, nowhere, **how) - float(lag.area),
        pw.ambiguity(source, nu[rows], there, **how) - ambiguity,
    ]
    return max(float(np.abs(error).max()) for error in errors) / source.area


@engines
@pytest.mark.parametrize(
    ("n", "shear", "along_an_edge", "samples", "precision"),
    [
        (40, 0.0, False, 3, "single"),
        (40, 3.0, False, 3, "double"),
        (40, 0.0, False, 264, "double"),
        (40, 0.0, True, 3, "double"),
    ],
)
def test_polygons_keep_their_digits_where_all_edges_coincide(
    n, shear, along_an_edge, samples, precision, engine
):
    ring = polygon(n, shear)
    xi = ring[1] - ring[0] if along_an_edge else np.zeros(2)
    error = worst_error([ring], xi, samples, engine=engine, precision=precision)
    assert error < POLYGON[precision]


@pytest.mark.parametrize(
    ("n", "ratio", "engine"), numpy_and_few(product((6, 20), RING), [(12, 0.99)], slow=[(20, 0.99)])
)
def test_rings_keep_their_digits_at_their_centre(n, ratio, engine):
    rings = [polygon(n), ratio * polygon(n)]
    assert worst_error(rings, np.zeros(2), 3, engine=engine) < RING[ratio]
