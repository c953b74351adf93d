"""Projections of R, W and A: brute integration, neighbours on shared axes, exact arithmetic."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
import shapely

import polywigner as pw
from projected import ARRAY, KINDS, LIT, SHAPES, TILES, bounds_of, box_of, shapes, tile

# Composite quadratures of thousands of nodes that do not know where the kinks are.
PANELS = 2e-6
# The same with a jump in one panel of 600.
JUMPS = 4e-3
# Gauss-Legendre between the kinks.
SMOOTH = 1e-11
ROUNDING = 1e-13


def _panels(low: float, high: float, count: int = 600, order: int = 4) -> Any:
    """Nodes and weights of a composite Gauss-Legendre rule."""
    node, weight = np.polynomial.legendre.leggauss(order)
    edges = np.linspace(low, high, count + 1)
    half = (edges[1] - edges[0]) / 2
    points = (edges[:-1, None] + half * (1 + node)).ravel()
    return points, np.tile(half * weight, count)


# --- closed forms


def test_tiles_of_a_rectangle_are_products_of_the_one_dimensional_functions() -> None:
    a, b = 1.5, 0.8
    source = pw.shapes.rectangle(a, b)
    x, xi = np.linspace(-1, 1, 9) * 0.71, np.linspace(-2, 2, 9) * 0.73
    nu = np.linspace(-3, 3, 8)
    overlap = np.maximum(0, 2 * a - 4 * abs(x))  # of the lag slice of the interval a
    lag = np.maximum(0, b - abs(xi))
    inside = abs(x) < a / 2

    found = tile(source, "autocorrelation", "x_xi_y", x, xi)
    assert np.abs(found - overlap[:, None] * lag).max() < ROUNDING
    both = (abs(x[:, None] + xi / 2) < a / 2) & (abs(x[:, None] - xi / 2) < a / 2)
    found = tile(source, "autocorrelation", "x_xi_x", x, xi)
    assert np.abs(found - b**2 * both).max() < ROUNDING
    found = tile(source, "wigner", "x_nu_x", x, nu)
    wave = overlap[:, None] * np.sinc(overlap[:, None] * nu)
    assert np.abs(found - b * wave).max() < ROUNDING
    found = tile(source, "wigner", "x_nu_y", x, nu)
    assert np.abs(found - inside[:, None] * (b * np.sinc(b * nu)) ** 2).max() < ROUNDING
    # along y: int dxi_y u(xi_y/2) u(-xi_y/2) = 2 b
    found = tile(source, "ambiguity", "upsilon_x_xi_x", nu, xi)
    width = np.maximum(0, a - abs(xi))
    assert np.abs(found - 2 * b * width * np.sinc(width * nu[:, None])).max() < ROUNDING
    found = tile(source, "ambiguity", "upsilon_x_xi_y", nu, xi)
    rows = abs(xi) < b
    expected = rows * (a * np.sinc(a * nu[:, None] / 2)) ** 2
    assert np.abs(found - expected).max() < ROUNDING


# --- brute integration of the four-dimensional functions


def _fejer(width: float, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies and weights that sum a band-limited function, to some 1/count.

    What has support of ``width`` in the conjugate coordinate is summed exactly by equal steps
    below 1/width; the triangular weights make the sum converge.
    """
    k = np.arange(-count, count + 1)
    step = 0.49 / width
    return k * step, step * (1 - np.abs(k) / (count + 1))


BRUTE = 1e-2  # of the tile's peak
BRUTE_TWICE = 0.15  # |u|^2, 0 or 1, smeared by two sums over few frequencies


def _rule(source: pw.Aperture, kind: str, name: str, twice: bool) -> tuple[Any, Any]:
    """Nodes and weights that integrate a function over one of its coordinates.

    ``twice``: over another frequency as well, which leaves less memory for this one.
    """
    low, high = _extents(source).get(name, (0.0, 0.0))
    if low < high:
        count = 1000 if kind == "autocorrelation" else 120
        step = (high - low) / count
        return low + step * (np.arange(count) + 0.5), np.full(count, step)
    reach = 2 * np.abs(bounds_of(source)).max() + 2 * max(box_of(source))
    return _fejer(reach, 120 if twice else 900)


def _extents(source: pw.Aperture | pw.Array) -> dict[str, tuple[float, float]]:
    """Where positions and lags matter."""
    west, south, east, north = bounds_of(source)
    width, height = box_of(source)
    lags = {"xi_x": (-width, width), "xi_y": (-height, height)}
    return {"x": (west, east), "y": (south, north), **lags}


def _brute(source: pw.Aperture, kind: str, kept: dict[str, float]) -> complex:
    """The function, integrated numerically over the two coordinates that are not kept."""
    names = COORDINATES[kind]
    twice = not any(name.startswith(("nu", "upsilon")) for name in kept)
    rules = [
        ([kept[name]], [1.0]) if name in kept else _rule(source, kind, name, twice)
        for name in names
    ]
    grid = np.meshgrid(*(nodes for nodes, _ in rules), indexing="ij")
    values = getattr(pw, kind)(source, np.stack(grid[:2], axis=-1), np.stack(grid[2:], axis=-1))
    return complex(np.einsum("abcd,a,b,c,d", values, *(weights for _, weights in rules)))


COORDINATES = {
    "autocorrelation": ["x", "y", "xi_x", "xi_y"],
    "wigner": ["x", "y", "nu_x", "nu_y"],
    "ambiguity": ["upsilon_x", "upsilon_y", "xi_x", "xi_y"],
}
POINTS = {"x": 0.07, "y": 0.11, "nu_x": 0.31, "nu_y": -0.27}
POINTS |= {"xi_x": 0.23, "xi_y": 0.19, "upsilon_x": 0.33, "upsilon_y": -0.29}


@pytest.mark.slow
@pytest.mark.parametrize("shape", ["chevrons", "triangle", "weighted", "lit"])
@pytest.mark.parametrize(("kind", "name"), [(k, n) for k in KINDS for n in TILES[k]])
def test_each_tile_is_its_function_integrated_over_the_other_coordinates(
    kind: str, name: str, shape: str
) -> None:
    source = {**SHAPES, "weighted": ARRAY, "lit": LIT}[shape]
    dims = pw.projections(source, kind, tiles=[name], samples=2)[name].dims
    kept = {dim: POINTS[dim] for dim in dims}
    value = tile(source, kind, name, *kept.values())[0, 0]
    samples = 15 if shape == "lit" else 65
    peak = np.abs(pw.projections(source, kind, tiles=[name], samples=samples)[name].values).max()
    assert abs(value) > 0.01 * peak  # else a point of no interest
    both = kind != "autocorrelation" and not any(d.startswith(("nu", "upsilon")) for d in dims)
    tolerance = BRUTE_TWICE if both else BRUTE
    assert abs(value - _brute(source, kind, kept)) < tolerance * peak


# --- quadrature over sections


def _row(source: pw.Aperture, y: float) -> list[tuple[float, float]]:
    """The section at height y, by shapely."""
    west, _, east, _ = source.bounds
    line = shapely.LineString([(west - 1, y), (east + 1, y)])
    pieces = shapely.get_parts(shapely.intersection(source.polygons, line))
    return [(p.bounds[0], p.bounds[2]) for p in pieces if p.bounds[0] < p.bounds[2]]


def _kinks(first: shapely.Geometry, second: shapely.Geometry) -> np.ndarray:
    """Heights between which the sections of two shapes move linearly and change no order."""
    outlines = [shapely.boundary(shape) for shape in (first, second)]
    crossings = shapely.get_coordinates(shapely.node(shapely.union_all(outlines)))
    return np.unique(crossings[:, 1])


def _over_heights(kinks: np.ndarray, function: Callable[[float], np.ndarray]) -> np.ndarray:
    node, weight = np.polynomial.legendre.leggauss(16)
    total: Any = 0.0
    for low, high in pairwise(kinks):
        half = (high - low) / 2
        if half > 1e-12:
            for n, w in zip(node, weight, strict=True):
                total = total + half * w * function(low + half * (1 + n))
    return np.asarray(total)


@shapes
def test_the_x_nu_x_tile_is_the_sum_of_the_wigner_functions_of_the_rows(
    source: pw.Aperture,
) -> None:
    nu = np.array([0.0, 0.4, -2.3])
    for x in (source.centre[0], source.bounds[0] + 0.37 * box_of(source)[0]):
        mirrored = shapely.transform(
            source.polygons, lambda v, x=x: np.stack([2 * x - v[:, 0], v[:, 1]], axis=-1)
        )

        def of_row(y: float, x: float = x) -> np.ndarray:
            row = _row(source, y)
            return pw.wigner(pw.Slits(row), [x], nu[:, None]) if row else np.zeros(len(nu))

        expected = _over_heights(_kinks(source.polygons, mirrored), of_row)
        found = tile(source, "wigner", "x_nu_x", x, nu)[0]
        assert np.abs(found - expected).max() < SMOOTH * np.prod(box_of(source))


@pytest.mark.slow
@shapes
def test_the_y_xi_x_tile_is_the_sum_of_the_correlations_of_opposite_rows(
    source: pw.Aperture,
) -> None:
    xi, y = np.array([0.0, 0.21, -0.65]), source.bounds[1] + 0.43 * box_of(source)[1]

    def of_rows(height: float) -> np.ndarray:
        above, below = _row(source, height), _row(source, 2 * y - height)
        return 2 * np.array(
            [
                sum(max(0.0, min(b, d + t) - max(a, c + t)) for a, b in above for c, d in below)
                for t in xi
            ]
        )

    kinks = np.unique([*_kinks(source.polygons, source.polygons)])
    kinks = np.unique([*kinks, *(2 * y - kinks)])
    dense = np.unique(np.concatenate([np.linspace(a, b, 41) for a, b in pairwise(kinks)]))
    expected = _over_heights(dense, of_rows)  # overlaps of ends come and go between the kinks
    found = tile(source, "autocorrelation", "y_xi_x", y, xi)[0]
    assert np.abs(found - expected).max() < 1e-5 * np.prod(box_of(source))


@shapes
def test_the_x_nu_y_tile_is_the_power_spectrum_of_the_column(source: pw.Aperture) -> None:
    nu = np.array([0.0, 0.7, -5.1])
    turned = pw.Aperture(shapely.transform(source.polygons, lambda v: v[:, ::-1]))
    for x in source.bounds[0] + np.array([0.13, 0.41, 0.77]) * box_of(source)[0]:
        column = _row(turned, x)
        expected = abs(pw.fourier(pw.Slits(column), nu[:, None])) ** 2 if column else 0 * nu
        found = tile(source, "wigner", "x_nu_y", x, nu)[0]
        assert np.abs(found - expected).max() < SMOOTH * box_of(source)[1] ** 2


@shapes
def test_the_upsilon_x_xi_x_tile_is_the_sum_of_cross_ambiguities_of_opposite_rows(
    source: pw.Aperture,
) -> None:
    upsilon, xi = np.array([0.0, 0.6, -1.9]), 0.17
    flipped = shapely.transform(source.polygons, lambda v: v * (1, -1) + (xi / 2, 0))
    shifted = shapely.transform(source.polygons, lambda v: v - (xi / 2, 0))

    def of_rows(y: float) -> np.ndarray:
        overlaps = [
            (max(a - xi / 2, c + xi / 2), min(b - xi / 2, d + xi / 2))
            for a, b in _row(source, y)
            for c, d in _row(source, -y)
        ]
        waves = [
            2 * (high - low) * np.sinc(upsilon * (high - low)) * np.exp(-1j * np.pi * upsilon * s)
            for low, high in overlaps
            if low < high
            for s in [low + high]
        ]
        return np.sum(waves, axis=0) if waves else np.zeros(len(upsilon), complex)

    expected = _over_heights(_kinks(shifted, flipped), of_rows)
    found = tile(source, "ambiguity", "upsilon_x_xi_x", upsilon, xi)[:, 0]
    assert np.abs(found - expected).max() < SMOOTH * np.prod(box_of(source))


# --- neighbours agree on the axis that they share


def _curves(source: pw.Aperture, kind: str, axis: str, at: np.ndarray) -> list[np.ndarray]:
    """The function of ``axis`` that is left of every tile with a bounded other axis."""
    extents = _extents(source)
    curves = []
    for name in TILES[kind]:
        dims = pw.projections(source, kind, tiles=[name], samples=2)[name].dims
        other = [d for d in dims if d != axis]
        if axis in dims and other[0] in extents:
            nodes, weights = _panels(*extents[other[0]])
            first, second = (at, nodes) if dims[0] == axis else (nodes, at)
            values = tile(source, kind, name, first, second)
            curves.append(values @ weights if dims[0] == axis else weights @ values)
    return curves


def _jumps(source: pw.Aperture) -> bool:
    """Whether an edge is vertical or horizontal: there sections change at once."""
    edges = np.concatenate([np.roll(ring, -1, axis=0) - ring for ring in source.rings])
    return bool((np.abs(edges) < 1e-12).any())


# Axes that tiles with another, bounded axis share, and how many such tiles there are.
SHARED = {
    "autocorrelation": {"x": 3, "y": 3, "xi_x": 3, "xi_y": 3},
    "wigner": {"nu_x": 2, "nu_y": 2},
    "ambiguity": {"upsilon_x": 2, "upsilon_y": 2},
}


@pytest.mark.slow
@shapes
@pytest.mark.parametrize("kind", KINDS)
def test_neighbours_have_the_same_marginal_on_the_axis_they_share(
    kind: str, source: pw.Aperture
) -> None:
    for axis, count in SHARED[kind].items():
        spectral = axis.startswith(("nu", "upsilon"))
        # off the lattice of the vertices, where tiles jump
        at = np.array([0.0, 0.37, -1.3]) if spectral else np.array([0.0137, 0.2871, -0.3313])
        curves = _curves(source, kind, axis, at)
        assert len(curves) == count
        scale = np.prod(box_of(source)) * max(box_of(source))
        for curve in curves[1:]:
            assert np.abs(curve - curves[0]).max() < (JUMPS if _jumps(source) else PANELS) * scale


@shapes
def test_every_autocorrelation_tile_holds_the_squared_area(source: pw.Aperture) -> None:
    extents = _extents(source)
    for name in TILES["autocorrelation"]:
        found = pw.projections(source, "autocorrelation", tiles=[name], samples=2)
        (first, a), (second, b) = (_panels(*extents[d], 80, 3) for d in found[name].dims)
        total = a @ tile(source, "autocorrelation", name, first, second) @ b
        # x_xi_x and y_xi_y jump, the others are continuous
        tolerance = 1e-2 if name in ("x_xi_x", "y_xi_y") else 1e-4
        assert total == pytest.approx(source.area**2, rel=tolerance)


def test_values_along_an_axis_are_as_few_as_samples_may_be() -> None:
    square = pw.shapes.square(1.0)
    with pytest.raises(
        pw.errors.ArgumentError, match="expected up to 4096 values of x, got 100000"
    ):
        pw.projections(square, tiles=["x_y"], coordinates={"x": np.arange(100_000)})


def test_projections_of_tapered_sources_are_their_marginals() -> None:
    """Summed over the other coordinate, tiles that share an axis agree; and with the field."""
    horn = pw.shapes.rectangle(1.0, 0.7).with_illumination(
        pw.te_mode(1.0, 0.7) * pw.Illumination([1], [(1.5, 0.5)])
    )
    array = pw.phased_array(horn, [(0, 0), (1.3, 0.2)], [1, 0.5j])
    for source in (horn, array):
        tiles = pw.projections(source, tiles=["x_y", "nu_x_nu_y"], samples=41)
        x, y = np.meshgrid(tiles["x_y"].x.values, tiles["x_y"].y.values, indexing="ij")
        places = np.stack([x, y], axis=-1)
        u = sum(
            w * e.illumination(places) * shapely.contains_xy(e.polygons, x, y)
            for w, e in (
                zip(source.weights, source.elements, strict=True)
                if isinstance(source, pw.Array)
                else [(1, source)]
            )
        )
        error = tiles["x_y"].attrs["error"]
        assert 0 < error < 1e-10
        assert np.abs(tiles["x_y"].values - np.abs(u) ** 2).max() <= error
        wide = {"nu_x": (-24, 24), "nu_y": (-24, 24)}
        power = pw.projections(source, tiles=["nu_x_nu_y"], extent=wide, samples=385)["nu_x_nu_y"]
        total = power.values.sum() * (48 / 384) ** 2
        # spectra of jumps at the ends of y fall off as 1/nu^2: 3 % lie beyond 24 cycles
        assert total == pytest.approx(pw.lag_marginal(source, (0, 0)).real, rel=0.04)
        kind = pw.projections(source, "ambiguity", tiles=["xi_x_xi_y"], samples=9)["xi_x_xi_y"]
        lags = np.stack(np.meshgrid(kind.xi_x.values, kind.xi_y.values, indexing="ij"), axis=-1)
        expected = pw.autocorrelation(source, np.zeros(2), lags)
        assert np.abs(kind.values - expected).max() <= kind.attrs["error"]


@pytest.mark.parametrize("name", ["x", "y"])
def test_tiles_of_a_product_are_products_of_the_functions_of_slits(name: str) -> None:
    """u(x, y) = f(x) g(y) on a rectangle; integrals of the functions of g are others of these."""
    waves = [
        ([1.0, 0.4j, -0.3 + 0.2j], [0.0, 0.71, -1.27]),
        ([0.8, 0.5 - 0.4j, 0.2], [1.3, -0.45, 7.0]),
    ]
    ends = [(-0.7, 0.8), (-0.45, 0.35)]
    f, g = (
        pw.Slits([end]).with_illumination(pw.Illumination(*wave))
        for end, wave in zip(ends, waves, strict=True)
    )
    rectangle = pw.Aperture(shapely.box(-0.7, -0.45, 0.8, 0.35))
    along = [
        pw.Illumination(amplitudes, np.outer(frequencies, axis))
        for (amplitudes, frequencies), axis in zip(waves, np.eye(2), strict=True)
    ]
    source = rectangle.with_illumination(along[0] * along[1])
    (own, other), across = ((f, g), "y") if name == "x" else ((g, f), "x")
    at, lag = np.linspace(-0.6, 0.65, 8)[:, None, None], np.linspace(-0.7, 0.67, 9)[:, None]
    nu, zero = np.linspace(-4, 5, 7)[:, None], np.zeros(1)

    def check(kind: str, kept: str, first: Any, second: Any, expected: Any) -> None:
        found = tile(source, kind, kept, np.ravel(first), np.ravel(second))
        assert np.abs(found - expected).max() < ROUNDING * 20, kept

    intensity = pw.lag_marginal(other, zero).real
    check("wigner", f"{name}_nu_{name}", at, nu, pw.wigner(own, at, nu) * intensity)
    here = pw.autocorrelation(own, at, zero).real
    check("wigner", f"{name}_nu_{across}", at, nu, here * np.abs(pw.fourier(other, nu)) ** 2)
    whole = np.abs(pw.fourier(other, zero)) ** 2
    lags = pw.autocorrelation(own, at, lag) * whole
    check("autocorrelation", f"{name}_xi_{name}", at, lag, lags)
    mirrored = pw.wigner(own, at, zero) * pw.ambiguity(other, zero, lag)
    check("autocorrelation", f"{name}_xi_{across}", at, lag, mirrored)
    upsilon = nu[:, None]
    opposite = pw.ambiguity(own, upsilon, lag) * pw.wigner(other, zero, zero)
    check("ambiguity", f"upsilon_{name}_xi_{name}", nu, lag, opposite)
    spectra = pw.fourier(own, upsilon / 2) * pw.fourier(own, -upsilon / 2).conj()
    crossed = spectra * pw.autocorrelation(other, zero, lag)
    check("ambiguity", f"upsilon_{name}_xi_{across}", nu, lag, crossed)
