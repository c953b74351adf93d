"""Laws of all transforms for all kinds of sources on all engines; ``laws`` has the table."""

from typing import Any

import numpy as np
import pytest
import shapely

import laws
import polywigner as pw
from oracles import kinds
from oracles.references import numpy_and_few

# Rounding errors relative to a bound of the function. In single precision, phases are rounded as
# well.
TOLERANCE = {"double": 2e-14, "single": 3e-6}
# Larger errors, due to the rounding of positions at 7000 diameters from the origin or to the
# interpolation of weight tables.
LARGER = {
    "product, far away": 5e-13,
    "lattice of any weights": 2e-13,
    "row of any weights": 2e-13,
    "long row of any weights": 2e-13,
}
COHERENT = [name for name in laws.SOURCES if "partly" not in name]
# Sources for compiled engines, a few only because compiling a kernel takes half a second.
COMPILED = [
    "chevron",
    "30-gon",
    "nearly parallel",
    "overlapping",
    "product, turned and moved",
    "tapered, steered lattice",
    "row of any weights",
    "slits of any weights",
]
SLOW_COMPILED = ["fields of their own", "small lattice of any weights", "scattered far away"]
SINGLE = ["chevron", "overlapping", "tapered, steered lattice", "slits"]


def allowed(name, function, precision):
    error = max(TOLERANCE[precision], LARGER.get(name, 0.0))
    return error * laws.scale_of(name, function)


def arguments(function, place, nu):
    return {
        "wigner": (place, nu),
        "ambiguity": (nu, place),
        "fourier": (nu,),
        "position_marginal": (place,),
        "lag_marginal": (place,),
    }[function]


def place_of(function, at):
    return at.xi if kinds.place_of(function) == "xi" else at.x


@pytest.mark.parametrize(
    ("name", "precision", "engine"),
    numpy_and_few(
        [
            (name, precision)
            for name in COHERENT
            for precision in (TOLERANCE if name in (*COMPILED, *SINGLE) else ("double",))
        ],
        [(name, "double") for name in COMPILED] + [(name, "single") for name in SINGLE],
        slow=[(name, "double") for name in SLOW_COMPILED],
    ),
)
def test_transforms_are_those_of_exact_slices(name, precision, engine):
    """Frequencies of all sizes, at coincident and nearly coincident edges and elsewhere."""
    at, source = laws.hard_points(name), laws.source_of(name)
    for function in kinds.FUNCTIONS:
        if function == "fourier" and isinstance(source, pw.Wavefront):
            continue  # quadrature in test_curved_waves
        expected = laws.exact_values(name, function)
        points = (p[: len(expected)] for p in arguments(function, place_of(function, at), at.nu))
        result = getattr(pw, function)(source, *points, precision=precision, engine=engine)
        assert result.shape == expected.shape
        assert np.abs(result - expected).max() <= allowed(name, function, precision), function


@pytest.mark.slow
@pytest.mark.parametrize("function", kinds.FUNCTIONS)
def test_the_stored_values_are_those_of_exact_slices(function):
    for name in (*SINGLE, "three waves", "lattice of products", "curved", "product, far away"):
        stored = laws.exact_values(name, function)
        error = np.abs(laws.computed_values(name, function) - stored).max()
        assert error <= 1e-15 * laws.scale_of(name, function)


# Sources for sums over positions, without parts that are 60 diameters apart. The waves differ by up
# to 4 cycles.
INTEGRALS = [
    *("chevron", "two squares", "collection", "scattered", "three waves", "tapered slits"),
    *("row of slits", "overlapping", "leaning", "tapered, steered lattice"),
    *("row of slits, any weights", "curved", "partly coherent"),
]
# Error of sums over 10^4 points of a function with kinks, relative to the area times the integral
# of |u|^2, and number of points.
LATTICE, POINTS = 5e-4, 10946


def lattice(name):
    """Return the points of a rank-1 lattice around the source, and the area of each point."""
    corners = np.concatenate([laws.corners_of(outline) for outline, _ in laws.elements_of(name)])
    low, size = corners.min(axis=0), np.ptp(corners, axis=0)
    k = np.arange(POINTS)
    unit = np.column_stack([k + 0.5, (6765 * k) % POINTS + 0.5])[:, : len(low)] / POINTS
    return low, size, unit, float(np.prod(size)) / POINTS


@pytest.mark.parametrize("name", INTEGRALS)
def test_w_and_a_integrate_to_products_of_spectra_and_are_bounded_by_the_energy(name):
    """The integral of W exp(-2 pi i upsilon.x) over x is F(nu + upsilon/2) F*(nu - upsilon/2)."""
    source, (low, size, unit, cell) = laws.source_of(name), lattice(name)
    d = len(low)
    nu = laws.elements_of(name)[0][1][0][1] + np.full(d, 0.4) / size.max()
    upsilon, zero = np.full(d, 0.3) / size.max(), np.zeros(d)
    x, xi = low + unit * size, (2 * unit - 1) * size
    w, a = pw.wigner(source, x, nu), pw.ambiguity(source, upsilon, xi)
    energy = pw.ambiguity(source, zero, zero)
    assert energy == pytest.approx(pw.lag_marginal(source, zero), abs=1e-13 * abs(energy))
    assert abs(energy.imag) < 1e-14 * energy.real and np.isrealobj(w)
    scale = laws.scale_of(name, "ambiguity")
    assert np.abs(w).max() <= 2**d * energy.real + 1e-12 * scale
    assert np.abs(a).max() <= energy.real + 1e-12 * scale
    mirrored = pw.ambiguity(source, -upsilon, -xi)
    assert np.abs(mirrored - a.conj()).max() < 1e-12 * scale
    if "partly" in name:  # partially coherent light has no amplitude spectrum
        return
    expected = pw.fourier(source, nu + upsilon / 2) * pw.fourier(source, nu - upsilon / 2).conj()
    by_position = cell * w @ np.exp(-2j * np.pi * x @ upsilon)
    by_lag = 2**d * cell * a @ np.exp(-2j * np.pi * xi @ nu)
    allowed = LATTICE * scale * float(np.prod(size))
    assert abs(by_position - expected) < allowed and abs(by_lag - expected) < 2**d * allowed


@pytest.mark.parametrize("name", ["holes", "three waves", "product", "curved", "tapered slits"])
def test_moving_turning_and_scaling_a_source_only_change_coordinates(name):
    source, at = laws.source_of(name), laws.hard_points(name)
    d, scale, angle = at.x.shape[1], 3.0, 0.7 if at.x.shape[1] == 2 else 0.0
    shift = np.array([0.37, -0.19])[:d] * laws.size_of(name)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])[:d, :d]
    there = source if d == 1 else source.turned(angle).scaled(scale)
    scale = 1.0 if d == 1 else scale
    there = there.moved(shift)
    nu, phase = at.nu @ turn.T / scale, np.exp(-2j * np.pi * at.nu @ turn.T / scale @ shift)
    # The limit is larger, because positions where corners of the copies coincide are rounded again.
    allowed = 1e-11 * scale**d * laws.scale_of(name, "wigner")
    w = pw.wigner(there, scale * at.x @ turn.T + shift, nu)
    assert np.abs(w - scale**d * pw.wigner(source, at.x, at.nu)).max() < allowed
    a = pw.ambiguity(there, nu, scale * at.xi @ turn.T)
    assert np.abs(a - scale**d * phase * pw.ambiguity(source, at.nu, at.xi)).max() < allowed


@pytest.mark.parametrize("name", ["chevron", "far away", "three waves", "curved", "slits"])
@pytest.mark.parametrize("defocus", [0.0, 0.75])
def test_transfer_functions_have_the_properties_of_images_of_points(name, defocus):
    """1 at zero lag, Hermitian, and zero beyond the pupil. In focus, the lag marginal over int
    |u|^2. The conjugate field has the conjugate OTF at the opposite defocus.
    """
    source, xi = laws.source_of(name), laws.hard_points(name).xi
    d = xi.shape[1]
    otf = pw.otf(source, xi, defocus)
    assert pw.otf(source, np.zeros(d), defocus) == pytest.approx(1.0, abs=1e-12)
    assert np.abs(pw.otf(source, -xi, defocus) - otf.conj()).max() < 1e-12
    assert pw.otf(source, np.full(d, 1.001 * source.diameter), defocus) == 0
    energy = pw.lag_marginal(source, np.zeros(d)).real
    outline, waves = laws.elements_of(name)[0]
    strength = sum(abs(c) for c, _ in waves) ** 2
    bound = strength / energy * pw.lag_marginal(outline, xi)
    assert (np.abs(otf) <= bound + 1e-11).all()
    if not defocus:
        assert np.abs(otf - pw.lag_marginal(source, xi) / energy).max() < 1e-12
    if source is not laws.flat(source):
        return
    field = pw.Illumination([np.conj(c) for c, _ in waves], [-k for _, k in waves])
    opposite = pw.otf(outline.with_illumination(field), xi, -defocus)
    assert np.abs(opposite - otf.conj()).max() < 1e-11


@pytest.mark.parametrize(("name", "engine"), numpy_and_few(laws.SOURCES, COMPILED[3:6]))
def test_the_autocorrelation_is_the_product_of_the_fields(name, engine):
    """The product is u(x + xi/2) u*(x - xi/2), times the degree of coherence."""
    source, at = laws.source_of(name), laws.hard_points(name)
    rng = np.random.default_rng(8)
    # Points close to coincident corners, up to the distance that slivers require.
    places = [np.repeat(p, 30, axis=0) for p in (at.x, at.xi)]
    reach = laws.size_of(name) * 10.0 ** rng.uniform(-7, 0, (len(places[0]), 1))
    x, xi = (p + reach * rng.normal(size=p.shape) for p in places)
    field = laws.field_of(name, x + xi / 2) * laws.field_of(name, x - xi / 2).conj()
    expected = field * laws.degree_of_coherence(name, xi)
    result = pw.autocorrelation(source, x, xi, engine=engine)
    strength = max(sum(abs(c) for c, _ in waves) for _, waves in laws.elements_of(name)) ** 2
    assert (expected != 0).any() and (expected == 0).any()
    assert np.abs(result - expected).max() <= max(1e-13, 10 * allowed_turns(at)) * 10 * strength


def allowed_turns(at):
    """Return the phase error in cycles due to rounding of positions."""
    return float(np.abs(at.x).max() * np.abs(at.nu).max() * np.finfo(float).eps)


def layouts(places, listed, sides):
    """Return pairs of broadcast shapes; a grid follows a list."""
    place, nu = np.arange(places), np.arange(listed)
    grid = listed + np.arange(np.prod(sides)).reshape(sides)
    return {
        "every place with every frequency": (place[:, None], nu),
        "frequencies as rows": (place, nu[:, None]),
        "one place": (place[1], nu),
        "one frequency": (np.repeat(place, 300), nu[3]),
        "a grid of frequencies": (place[1], grid),
        "places with a grid": (place[:2].reshape(-1, *(1 for _ in sides)), grid),
        "pairs in two dimensions": (np.repeat(place[:, None], 9, 1), np.repeat(nu[None, :9], 4, 0)),
    }


# One source for each kernel with a loop over points. The kernels differ in edges as code or lists
# of pairs, frames, weights, products, lattices, tables, slits, and curved and partially coherent
# light.
LAYOUTS = [
    *("chevron", "30-gon", "holes", "nearly parallel", "distant parts", "collection"),
    *("overlapping", "lattice"),
    *("lattice of any weights", "row of any weights"),
    *("tapered lattice", "lattice of products", "three waves", "small parts with waves"),
    *("product, turned and moved", "slits", "tapered slits", "row of slits, any weights"),
    *("curved", "partly coherent", "partly coherent slits"),
]


@pytest.mark.parametrize(
    ("name", "precision", "engine"),
    numpy_and_few(
        [(name, "double") for name in LAYOUTS] + [(name, "single") for name in SINGLE],
        [(name, "double") for name in ("chevron", "30-gon", "overlapping", "slits")]
        + [("tapered, steered lattice", "double"), ("three waves", "single")],
        slow=[
            (name, "double")
            for name in ("holes", "scattered", "collection", "lattice", "row of any weights")
        ],
    ),
)
def test_the_layout_of_points_changes_no_value(name, precision, engine):
    """NaN stays in its row and column, and values at large distances are zero."""
    source, at = laws.source_of(name), laws.hard_points(name)
    how: Any = {"precision": precision, "engine": engine}
    size, d = laws.size_of(name), at.x.shape[1]
    axes = [np.linspace(-9, 9, 17), np.concatenate([-np.geomspace(1e-9, 8, 8), [0], [0.3, 5, 9]])]
    grid = np.stack(np.meshgrid(*axes[:d], indexing="ij"), axis=-1) / size
    nu = np.random.default_rng(3).normal(size=(260 + d, d)) * 4 / size
    nu[:2], nu[7], nu[9] = 0.0, np.inf, np.nan
    every = np.concatenate([nu, grid.reshape(-1, d)])
    for function in kinds.FUNCTIONS[:3]:
        if function == "fourier" and "partly" in name:
            continue
        place = np.resize(place_of(function, at), (4, d))
        place[2], place[3] = np.nan, place[3] + 1e3 * size * len(laws.elements_of(name))
        pairs = np.repeat(place, len(every), axis=0), np.tile(every, (len(place), 1))
        each = getattr(pw, function)(source, *arguments(function, *pairs), engine="numpy")
        each = each.reshape(len(place), len(every))
        for layout, numbers in layouts(len(place), len(nu), grid.shape[:-1]).items():
            points = arguments(function, place[numbers[0]], every[numbers[1]])
            result = getattr(pw, function)(source, *points, **how)
            wanted = each[0, numbers[1]] if function == "fourier" else each[numbers]
            np.testing.assert_array_equal(np.isnan(result), np.isnan(wanted), err_msg=layout)
            error = np.nan_to_num(np.abs(result - wanted)).max()
            assert error <= allowed(name, function, precision), (function, layout)
        if function != "fourier":
            bad = ~np.isfinite(every).all(axis=1)
            assert np.isnan(each[2]).all() and np.isnan(each[:, bad]).all()
            assert not each[3, ~bad].any() and not np.isnan(each[:2, ~bad]).any()


# Relative error of extrapolated central differences.
STEP, GRADIENTS = 2.0**-16, 1e-8


def engine_points(values, double=True):
    """Return points (n, d) as an array of the engine."""
    import drjit.llvm.ad as backend

    if values.shape[1] == 1:
        return (backend.Float64 if double else backend.Float)(values[:, 0].tolist())
    return (backend.Array2f64 if double else backend.Array2f)(*values.T.tolist())


def read(array):
    """Return the components of an array of the engine, one per row."""
    parts = [array.real, array.imag] if "Complex" in type(array).__name__ else array
    return np.atleast_2d(np.array(parts))


def moved(source, step, change):
    """Return the source with changed vertices and weights."""
    if isinstance(source, pw.Array):
        sizes = np.cumsum([sum(map(len, e.rings)) for e in source.elements])
        parts = np.split(change["vertices"], sizes[:-1])
        elements = [
            moved(e, step, {"vertices": p}) for e, p in zip(source.elements, parts, strict=True)
        ]
        return pw.Array(elements, source.weights + step * change["weights"])
    sizes = np.cumsum([len(ring) for ring in source.rings])
    rings = np.split(np.concatenate(source.rings) + step * change["vertices"], sizes[:-1])
    plain = pw.Aperture([shapely.Polygon(rings[0], rings[1:])])
    if source.illumination is None:
        return plain
    return plain.with_illumination(source.illumination)


def own_parameters(source):
    """Return the differentiable parameters of a source."""
    if isinstance(source, pw.Array):
        rings = [ring for element in source.elements for ring in element.rings]
        return {"vertices": np.concatenate(rings), "weights": source.weights}
    return {"vertices": np.concatenate(source.rings)}


def total_of(value, seed):
    """Return a weighted sum of real and imaginary parts over samples."""
    if (hasattr(value, "imag") and not isinstance(value, np.ndarray)) or np.iscomplexobj(value):
        value = value.real + 0.7 * value.imag
    return (value * seed).sum() if isinstance(value, np.ndarray) else value * type(value)(seed)


CHANGING = ["chevron", "holes", "collection"]
IN_POINTS = ["leaning", "product, turned and moved", "curved", "slits", "partly coherent slits"]
SLOW_IN_POINTS = ["30-gon", "steered", "tapered slits", "curved, partly coherent"]


@pytest.mark.llvm
@pytest.mark.parametrize(
    ("name", "function", "changes"),
    [
        *((name, "wigner", True) for name in CHANGING),
        ("chevron", "ambiguity", True),
        ("three waves", "fourier", True),
        *(
            pytest.param(name, function, True, marks=pytest.mark.slow)
            for name in CHANGING[1:]
            for function in ("ambiguity", "fourier")
        ),
        pytest.param("three waves", "wigner", True, marks=pytest.mark.slow),
        *((name, "wigner", False) for name in IN_POINTS),
        *(pytest.param(name, "wigner", False, marks=pytest.mark.slow) for name in SLOW_IN_POINTS),
        *(
            pytest.param(name, function, False, marks=pytest.mark.slow)
            for name in [*IN_POINTS[:4], *SLOW_IN_POINTS[:3]]
            for function in ("ambiguity", "fourier")
            if (name, function) != ("curved", "fourier")
        ),
    ],
)
def test_gradients_are_those_of_differences(name, function, changes):
    """The derivatives are in positions, lags, frequencies, vertices and weights."""
    import drjit as dr
    import drjit.llvm.ad as backend

    source, at = laws.source_of(name), laws.hard_points(name)
    rng, count = np.random.default_rng(4), len(at.x) // 3 - 1
    nu = at.nu[1 : count + 1] if changes else at.nu[-count - 1 : -1]
    place = place_of(function, at)[1 : count + 1]
    points = arguments(function, place, nu)
    seed = np.linspace(1.0, 2.0, count)
    parameters = own_parameters(source) if changes else {}
    change = {
        key: rng.normal(size=v.shape) + (1j * rng.normal(size=v.shape) if v.ndim == 1 else 0.0)
        for key, v in parameters.items()
    }
    moves = [rng.normal(size=p.shape) for p in points]
    moves = [m / (1.0 + np.abs(p).max()) for m, p in zip(moves, points[::-1], strict=True)]

    def value(step):
        here = moved(source, step, change) if changes else source
        there = [p + step * m for p, m in zip(points, moves, strict=True)]
        return float(total_of(getattr(pw, function)(here, *there, engine="numpy"), seed))

    wide, narrow = (value(h) - value(-h) for h in (STEP, STEP / 2))
    expected = (8 * narrow - wide) / (6 * STEP)
    traced = [engine_points(p) for p in points]
    own: dict[str, Any] = {}
    for key, numbers in parameters.items():
        is_complex = key == "weights"
        own[key] = (
            backend.Complex2f64(numbers.real.tolist(), numbers.imag.tolist())
            if is_complex
            else backend.Array2f64(*numbers.T.tolist())
        )
    dr.enable_grad(traced, *own.values())
    changing = pw.differentiable(source, **own) if changes else source
    dr.backward(dr.sum(total_of(getattr(pw, function)(changing, *traced), seed)))
    directions = [m.T for m in moves] + [
        d.T if d.ndim == 2 else np.array([d.real, d.imag]) for d in change.values()
    ]
    terms = [
        (read(dr.grad(array)) * direction).sum()
        for array, direction in zip([*traced, *own.values()], directions, strict=True)
    ]
    assert all(terms)
    assert abs(sum(terms) - expected) <= GRADIENTS * np.abs(terms).sum()


@pytest.mark.llvm
@pytest.mark.parametrize(
    ("name", "precision"),
    [
        *((name, "double") for name in ("cosine", "curved", "tapered slits", "partly coherent")),
        ("chevron", "single"),
        *(
            pytest.param(name, "double", marks=pytest.mark.slow)
            for name in ("overlapping", "lattice", "product")
        ),
    ],
)
def test_arrays_of_the_engine_give_arrays_of_the_engine_with_the_same_values(name, precision):
    """The arrays are vectors and tensors, with few recorded samples or many sorted samples."""
    import drjit.llvm as backend

    source, at, double = laws.source_of(name), laws.hard_points(name), precision == "double"
    tensor = backend.TensorXf64 if double else backend.TensorXf
    functions = {"partly coherent": ["wigner"], "curved": ["wigner", "ambiguity"]}
    for function in functions.get(name, kinds.FUNCTIONS[:3]):
        points = arguments(function, place_of(function, at), at.nu)
        points = [p.astype(np.float64 if double else np.float32) for p in points]
        expected = getattr(pw, function)(source, *points, engine="numpy")
        parts = [expected.real, expected.imag][: 1 + np.iscomplexobj(expected)]
        error = 2 * allowed(name, function, precision)
        result = getattr(pw, function)(source, *map(tensor, points)).numpy()
        assert np.abs(result.reshape(len(expected), -1).T - parts).max() <= error
        for times in (1, 1000):
            many = [engine_points(np.tile(p, (times, 1)), double) for p in points]
            result = getattr(pw, function)(source, *many)
            result = [result.real, result.imag] if len(parts) > 1 else [result]
            for one, part in zip(result, parts, strict=True):
                assert np.abs(np.array(one) - np.tile(part, times)).max() <= error
