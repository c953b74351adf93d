"""Projections of R, W and A: numerical integration, products, exact arithmetic and labels."""

import numpy as np
import pytest
import shapely

import polywigner as pw
from oracles import exact
from oracles.references import awkward
from polywigner.errors import ArgumentError, GeometryError
from projected import ARRAY, KINDS, LIT, SHAPES, SQUARE, TILES, bounds_of, box_of, shapes, tile

ROUNDING = 1e-13


def _fejer(width, count):
    """Return frequencies and weights that sum a band-limited function with an error of 1/count.

    Steps below 1/width are exact for a support of ``width`` in the conjugate coordinate; the
    triangular weights ensure convergence.
    """
    k = np.arange(-count, count + 1)
    step = 0.49 / width
    return k * step, step * (1 - np.abs(k) / (count + 1))


BRUTE = 1e-2  # relative to the peak of the tile
BRUTE_TWICE = 0.15  # two sums over few frequencies smooth the step of |u|^2


def _rule(source, kind, name, twice):
    """Return nodes and weights of an integral over one coordinate.

    With ``twice``, there are fewer nodes, because the integral is over another frequency as well.
    """
    low, high = _extents(source).get(name, (0.0, 0.0))
    if low < high:
        count = 1000 if kind == "autocorrelation" else 120
        step = (high - low) / count
        return low + step * (np.arange(count) + 0.5), np.full(count, step)
    reach = 2 * np.abs(bounds_of(source)).max() + 2 * max(box_of(source))
    return _fejer(reach, 120 if twice else 900)


def _extents(source):
    """Return the extents of positions and lags."""
    west, south, east, north = bounds_of(source)
    width, height = box_of(source)
    lags = {"xi_x": (-width, width), "xi_y": (-height, height)}
    return {"x": (west, east), "y": (south, north), **lags}


def _brute(source, kind, kept):
    """Integrate the function numerically over the two other coordinates."""
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
@pytest.mark.parametrize("shape", ["weighted", "lit"])
@pytest.mark.parametrize(("kind", "name"), [(k, n) for k in KINDS for n in TILES[k]])
def test_each_tile_is_its_function_integrated_over_the_other_coordinates(kind, name, shape):
    source = {"weighted": ARRAY, "lit": LIT}[shape]
    dims = pw.projections(source, kind, tiles=[name], samples=2)[name].dims
    kept = {dim: POINTS[dim] for dim in dims}
    value = tile(source, kind, name, *kept.values())[0, 0]
    samples = 15 if shape == "lit" else 65
    peak = np.abs(pw.projections(source, kind, tiles=[name], samples=samples)[name].values).max()
    assert abs(value) > 0.01 * peak  # the point must not be close to a zero
    both = kind != "autocorrelation" and not any(d.startswith(("nu", "upsilon")) for d in dims)
    tolerance = BRUTE_TWICE if both else BRUTE
    assert abs(value - _brute(source, kind, kept)) < tolerance * peak


def test_projections_of_tapered_sources_are_their_marginals():
    """Tiles that share an axis agree after summation over the other coordinate."""
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
        wide = dict.fromkeys(["nu_x", "nu_y"], np.linspace(-24, 24, 385))
        power = pw.projections(source, tiles=["nu_x_nu_y"], coordinates=wide)["nu_x_nu_y"]
        total = power.values.sum() * (48 / 384) ** 2
        # The spectra of the jumps at the ends of y decrease as 1/nu^2, so 3 % are beyond 24 cycles.
        assert total == pytest.approx(pw.lag_marginal(source, (0, 0)).real, rel=0.04)
        kind = pw.projections(source, "ambiguity", tiles=["xi_x_xi_y"], samples=9)["xi_x_xi_y"]
        lags = np.stack(np.meshgrid(kind.xi_x.values, kind.xi_y.values, indexing="ij"), axis=-1)
        expected = pw.autocorrelation(source, np.zeros(2), lags)
        assert np.abs(kind.values - expected).max() <= kind.attrs["error"]


@pytest.mark.parametrize("name", ["x", "y"])
def test_tiles_of_a_product_are_products_of_the_functions_of_slits(name):
    """For u(x, y) = f(x) g(y), integrals over the functions of g are again functions of g."""
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
        result = tile(source, kind, kept, np.ravel(first), np.ravel(second))
        assert np.abs(result - expected).max() < ROUNDING * 20, kept

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


# Larger error, because coordinates of a thousand diameters lose three digits.
FAR = 1e-11


def _mirrored_overlap(source, x):
    """Return the intersection of {2 (a_x - x), y} with its mirror image in xi_x = 0, exactly."""
    at = exact.rational(x)
    copy = [[(2 * (a - at), b) for a, b in ring] for ring in exact._exact_rings(source.rings)]
    return exact._region(copy, [[(-a, b) for a, b in ring[::-1]] for ring in copy])


def _flipped_overlap(source, xi):
    half = exact.rational(xi) / 2
    rings = exact._exact_rings(source.rings)
    return exact._region(
        [[(a - half, b) for a, b in ring] for ring in rings],
        [[(a + half, -b) for a, b in ring[::-1]] for ring in rings],
    )


def _lifted_overlap(source, x, xi):
    twice, half = 2 * exact.rational(x), exact.rational(xi) / 2
    rings = exact._exact_rings(source.rings)
    return exact._region(
        [[(a, b - half) for a, b in ring] for ring in rings],
        [[(twice - a, b + half) for a, b in ring[::-1]] for ring in rings],
    )


def _assert_rounding_is_as_stated(source):
    width, height = box_of(source)
    x = source.bounds[0] + np.array([0.31, 0.5, 0.5 + 1e-13]) * width
    nu = np.array([0.0, 0.3, 7.7, 1e3]) / source.diameter
    axes = {"x": x, "nu_x": nu, "xi_y": np.array([0.0, 0.1, 1e-14]) * height}
    axes |= {"upsilon_x": nu, "xi_x": np.array([0.0, 0.2, 1e-14]) * width}

    def check(source, kind, name, expected):
        result = pw.projections(source, kind, tiles=[name], coordinates=_only(axes, kind))[name]
        assert np.abs(result.values - expected).max() < result.attrs["error"]

    check(source, "wigner", "x_nu_x", [_waves(_mirrored_overlap(source, at), nu).real for at in x])
    lifted = [[2 * float(_lifted_overlap(source, at, xi).area) for xi in axes["xi_y"]] for at in x]
    check(source, "autocorrelation", "x_xi_y", lifted)
    # A depends on opposite points, so the other tiles of this source are empty.
    centred = pw.Aperture(shapely.transform(source.polygons, lambda v: v - source.centre))
    flipped = [2 * _waves(_flipped_overlap(centred, xi), nu) for xi in axes["xi_x"]]
    check(centred, "ambiguity", "upsilon_x_xi_x", np.transpose(flipped))

    columns = [_column(source, at) for at in x]
    power = [[abs(_interval_wave(column, n)) ** 2 for n in nu] for column in columns]
    result = pw.projections(source, tiles=["x_nu_y"], coordinates={"x": x, "nu_y": nu})["x_nu_y"]
    assert np.abs(result.values - power).max() < result.attrs["error"]
    shadow = [float(sum(high - low for low, high in column)) ** 2 for column in columns]
    result = pw.projections(
        source, "autocorrelation", tiles=["x_xi_x"], coordinates={"x": x, "xi_x": [0.0]}
    )["x_xi_x"]
    assert np.abs(result.values[:, 0] - shadow).max() < result.attrs["error"]


def _column(source, x):
    """Return the section at x in rational numbers, relative to its centre."""
    at, heights = exact.rational(x), []
    for ring in exact._exact_rings(source.rings):
        for (ax, ay), (bx, by) in zip(ring, ring[1:] + ring[:1], strict=True):
            if min(ax, bx) <= at < max(ax, bx):
                heights.append(ay + (by - ay) * (at - ax) / (bx - ax))
    heights.sort()
    middle = (heights[0] + heights[-1]) / 2 if heights else 0
    return [(a - middle, b - middle) for a, b in zip(heights[::2], heights[1::2], strict=True)]


def _interval_wave(column, nu):
    return sum(
        float(b - a) * np.sinc(nu * float(b - a)) * np.exp(-1j * np.pi * nu * float(a + b))
        for a, b in column
    )


def _waves(region, nu):
    return np.array([complex(exact.transform(region, (n, 0.0))) for n in nu])


def _only(axes, kind):
    names = {name for tile in TILES[kind] for name in axes if name in tile}
    keep = {
        "wigner": {"x", "nu_x"},
        "ambiguity": {"upsilon_x", "xi_x"},
        "autocorrelation": {"x", "xi_y"},
    }
    return {name: axes[name] for name in names & keep[kind]}


AWKWARD = [
    *("plus, rotated", "holes aligned with edges", "hexagonal segments without gap", "star"),
    *("needle 1e-6", "nearly parallel edges", "nearly collinear corners"),
    "corners collinear to 1e-9",
]


@pytest.mark.parametrize("name", AWKWARD)
def test_rounding_errors_of_awkward_shapes_are_below_those_stated(name):
    _assert_rounding_is_as_stated(awkward(name).aperture)


@shapes
@pytest.mark.parametrize("kind", KINDS)
def test_exchanging_x_and_y_exchanges_the_tiles(kind, source):
    turned = pw.Aperture(shapely.transform(source.polygons, lambda v: v[:, ::-1]))
    exchange = str.maketrans("xy", "yx")

    def swap(name):
        return "".join("xi" if p == "xi" else p.translate(exchange) for p in _split(name))

    first, second = (pw.projections(s, kind, samples=12) for s in (source, turned))
    for name in TILES[kind]:
        values, dims = first[name].values, [swap(d) for d in first[name].dims]
        result = next(a for n in second.data_vars if set((a := second[n]).dims) == set(dims))
        other = result.values if list(result.dims) == dims else result.values.T
        assert np.abs(values - other).max() <= 2 * first[name].attrs["error"]


def _split(name):
    """Split a coordinate name: "xi_x" -> "xi", "_", "x"."""
    head, _, tail = name.partition("_")
    return [head, "_", tail] if tail else [head]


@pytest.mark.parametrize("kind", KINDS)
def test_fields_off_phase_show_in_every_tile(kind):
    """R, W and A are independent of a common phase, but not of phases between elements."""
    ring = SHAPES["triangle"].rings[0] - SHAPES["triangle"].centre
    pieces = [pw.Aperture(ring + sign * np.array([0.2, 0.5])) for sign in (1, -1)]
    plain, turned, opposed = (
        pw.projections(pw.Array(pieces, weights), kind, samples=33)
        for weights in ([1, 1], [1j, 1j], [1, 1j])
    )
    for name in TILES[kind]:
        peak = np.abs(plain[name].values).max()
        assert np.abs(plain[name].values - turned[name].values).max() < ROUNDING * peak
        if (kind, name) != ("wigner", "x_y"):  # |u|^2 of separate pieces
            assert np.abs(plain[name].values - opposed[name].values).max() > 0.02 * peak


def test_a_shift_moves_the_tiles_and_turns_those_of_the_ambiguity_function():
    source, shift = SHAPES["triangle"], np.array([1000.0, -2000.0])
    moved = pw.Aperture(source.rings[0] + shift)
    x, nu = np.linspace(-0.5, 0.5, 7), np.linspace(-4, 4, 5)
    for name in ("x_nu_x", "x_nu_y"):
        result = tile(moved, "wigner", name, x + shift[0], nu)
        assert np.abs(result - tile(source, "wigner", name, x, nu)).max() < FAR
    lags = np.array([1e-9, 0.3, 0.5])
    result = tile(moved, "autocorrelation", "x_xi_y", x + shift[0], lags)
    assert np.abs(result - tile(source, "autocorrelation", "x_xi_y", x, lags)).max() < FAR
    # A depends on opposite points, and only a shift along x preserves opposite rows.
    aside = pw.Aperture(source.rings[0] + [1000.0, 0.0])
    turn = np.exp(-2j * np.pi * nu * 1000.0)[:, None]
    for name in ("upsilon_x_xi_x", "upsilon_x_xi_y"):
        expected = turn * tile(source, "ambiguity", name, nu, lags)
        assert np.abs(tile(aside, "ambiguity", name, nu, lags) - expected).max() < FAR


@pytest.mark.parametrize("kind", KINDS)
def test_tiles_carry_their_coordinates_units_and_errors(kind):
    source = SHAPES["holed"]
    result = pw.projections(source, kind, samples=9)
    assert list(result.data_vars) == TILES[kind]
    for name in TILES[kind]:
        one = result[name]
        assert "_".join(one.dims) == name and one.values.shape == (9, 9)
        assert "closed form (P" in one.attrs["method"]
        assert one.attrs["error"] >= 0.0 and one.attrs["units"] in ("1", "m2", "m4")
        for axis in one.dims:
            assert result[axis].values.shape == (9,)
            assert result[axis].attrs["units"] == ("1/m" if axis[0] in "nu" else "m")
        left_out = one.attrs["long_name"].split("over ")[1].split(", ")
        assert not set(left_out) & set(one.dims) and len({*left_out, *one.dims}) == 4


def test_the_functions_of_slits_are_their_own_projection():
    source = pw.shapes.slit_pair((0.2, 0.5), (-0.6, 0.4))
    x, nu = np.array([-0.6, 0.0, 0.4]), np.array([0.0, 1.3])
    result = pw.projections(source, "wigner", coordinates={"x": x, "nu": nu})["x_nu"]
    assert (result.values == pw.wigner(source, x[:, None, None], nu[:, None])).all()
    assert result.dims == ("x", "nu") and result.attrs["units"] == "m"
    result = pw.projections(source, "autocorrelation", coordinates={"x": x, "xi": nu})["x_xi"]
    assert (result.values == pw.autocorrelation(source, x[:, None, None], nu[:, None])).all()
    result = pw.projections(source, "ambiguity", coordinates={"upsilon": x, "xi": nu})
    expected = pw.ambiguity(source, x[:, None, None], nu[:, None])
    assert (result["upsilon_xi"].values == expected).all()


def test_coordinates_replace_the_samples_of_an_axis():
    result = pw.projections(SHAPES["square"], samples=5, coordinates={"y": [0.1]})
    assert result["y_nu_y"].values.shape == (1, 5)
    assert result["x"].values[[0, -1]] == pytest.approx([-9 / 16, 9 / 16])
    assert result["nu_x"].values[[0, 2, -1]] == pytest.approx([-8, 0, 8])
    only = pw.projections(SHAPES["square"], tiles=["x_nu_y"], samples=3)
    assert list(only.data_vars) == ["x_nu_y"] and set(only.coords) == {"x", "nu_y"}


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"kind": "husimi"}, 'expected kind to be one of "autocorrelation"'),
        ({"samples": 1}, "samples to be a whole number from 2 to 4096, got 1"),
        ({"coordinates": {"xi_x": (0, 1)}}, 'one of "x", "y", "nu_x", "nu_y", got'),
        ({"coordinates": {"x": [0, np.nan]}}, "finite numbers"),
        ({"coordinates": [0.0, 1.0]}, "coordinates to be a mapping"),
        ({"tiles": ["x_z"]}, 'each of the tiles to be one of "x_y"'),
        ({"coordinates": {"x": np.arange(5000)}}, "at most 4096 values of x, got 5000"),
    ],
)
def test_unusable_arguments_are_refused(arguments, message):
    with pytest.raises(ArgumentError, match=message):
        pw.projections(SQUARE, **arguments)


LEANING = np.array([[1, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]])


def test_sources_without_a_phase_space_are_refused():
    with pytest.raises(ArgumentError, match="expected a source for wigner"):
        pw.projections(SQUARE.placed(np.eye(4)))
    with pytest.raises(GeometryError, match="in the plane z = 0"):
        pw.projections(pw.Array([SQUARE, SQUARE.placed(LEANING)]))
