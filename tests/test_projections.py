"""Projections of R, W and A: brute integration, neighbours on shared axes, exact arithmetic."""

import numpy as np
import pytest
import shapely

import polywigner as pw
from projected import ARRAY, KINDS, LIT, SHAPES, TILES, bounds_of, box_of, tile

ROUNDING = 1e-13


# --- closed forms


# --- brute integration of the four-dimensional functions


def _fejer(width, count):
    """Frequencies and weights that sum a band-limited function, to some 1/count.

    What has support of ``width`` in the conjugate coordinate is summed exactly by equal steps
    below 1/width; the triangular weights make the sum converge.
    """
    k = np.arange(-count, count + 1)
    step = 0.49 / width
    return k * step, step * (1 - np.abs(k) / (count + 1))


BRUTE = 1e-2  # of the tile's peak
BRUTE_TWICE = 0.15  # |u|^2, 0 or 1, smeared by two sums over few frequencies


def _rule(source, kind, name, twice):
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


def _extents(source):
    """Where positions and lags matter."""
    west, south, east, north = bounds_of(source)
    width, height = box_of(source)
    lags = {"xi_x": (-width, width), "xi_y": (-height, height)}
    return {"x": (west, east), "y": (south, north), **lags}


def _brute(source, kind, kept):
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
def test_each_tile_is_its_function_integrated_over_the_other_coordinates(kind, name, shape):
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


# --- neighbours agree on the axis that they share


def test_values_along_an_axis_are_as_few_as_samples_may_be():
    square = pw.shapes.square(1.0)
    with pytest.raises(
        pw.errors.ArgumentError, match="expected up to 4096 values of x, got 100000"
    ):
        pw.projections(square, tiles=["x_y"], coordinates={"x": np.arange(100_000)})


def test_projections_of_tapered_sources_are_their_marginals():
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
def test_tiles_of_a_product_are_products_of_the_functions_of_slits(name):
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

    def check(kind, kept, first, second, expected):
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
