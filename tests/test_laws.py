"""All kinds of sources against all laws, on all engines: one table, in `laws`."""

from typing import Any

import numpy as np
import pytest
import shapely

import laws
import polywigner as pw
from identities import assert_array_identities, assert_wigner_identities
from oracles import kinds
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
    "nearly parallel",
    "overlapping",
    "product, turned and moved",
    "tapered, steered lattice",
    "row of any weights",
    "slits of any weights",
]
# Exact slices of all their pairs take seconds; shorter ones of their kinds are here.
MANY_PAIRS = ["long row of any weights", "tapered lattice"]
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
            if name not in MANY_PAIRS
        ],
        [(name, "double") for name in COMPILED] + [(name, "single") for name in SINGLE],
        slow=[(name, "double") for name in SLOW_COMPILED],
    ),
)
def test_transforms_are_those_of_exact_slices(name, precision, engine):
    """Where edges of the copies coincide or nearly do, and elsewhere; at all sizes of nu."""
    at, source = laws.hard_points(name), laws.source_of(name)
    for function in kinds.FUNCTIONS:
        if function == "fourier" and isinstance(source, pw.Wavefront):
            continue  # quadrature in test_curved_waves
        expected = laws.exact_values(name, function)
        points = (p[: len(expected)] for p in arguments(function, place_of(function, at), at.nu))
        found = getattr(pw, function)(source, *points, precision=precision, engine=engine)
        assert found.shape == expected.shape
        assert np.abs(found - expected).max() <= allowed(name, function, precision), function


# Of the sums and moves of `identities`, one of each kind that takes a second at most; parts
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
    "tapered, steered lattice",
    "row of slits, any weights",
]


@pytest.mark.parametrize(
    ("name", "precision"),
    [
        *((name, "double") for name in IDENTITIES),
        pytest.param("product, turned and moved", "double", marks=pytest.mark.slow),
        ("overlapping", "single"),
    ],
)
def test_marginals_energy_symmetries_and_moves_are_those_of_phase_space(name, precision):
    source = laws.source_of(name)
    holds = assert_array_identities if isinstance(source, pw.Array) else assert_wigner_identities
    holds(source, engine="numpy", points=24, precision=precision)


@pytest.mark.parametrize(("name", "engine"), numpy_and_few(laws.SOURCES, COMPILED[3:6]))
def test_the_autocorrelation_is_the_product_of_the_fields(name, engine):
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


def allowed_turns(at):
    """What rounding of places loses of phases, in turns."""
    return float(np.abs(at.x).max() * np.abs(at.nu).max() * np.finfo(float).eps)


def layouts(places, listed, sides):
    """Numbers of places and of frequencies that broadcast together; a grid follows a list."""
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


# One of each kernel that sums over points in a way of its own: edges as code, by lists of pairs, in
# one frame or several; weights, fields, products, lattices and tables; slits; curved and partly
# coherent light.
LAYOUTS = [
    *("chevron", "30-gon", "holes", "nearly parallel", "distant parts", "collection"),
    *("overlapping", "fields of their own", "lattice", "steered", "scattered"),
    *("lattice of any weights", "row of any weights"),
    *("tapered lattice", "lattice of products", "three waves", "small parts with waves"),
    *("product, turned and moved", "slits", "tapered slits", "row of slits, any weights"),
    *("curved", "curved lattice", "partly coherent", "partly coherent slits"),
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
    """What is no number stays in its row and column; nothing is found far away."""
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
            found = getattr(pw, function)(source, *points, **how)
            wanted = each[0, numbers[1]] if function == "fourier" else each[numbers]
            np.testing.assert_array_equal(np.isnan(found), np.isnan(wanted), err_msg=layout)
            error = np.nan_to_num(np.abs(found - wanted)).max()
            assert error <= allowed(name, function, precision), (function, layout)
        if function != "fourier":
            bad = ~np.isfinite(every).all(axis=1)
            assert np.isnan(each[2]).all() and np.isnan(each[:, bad]).all()
            assert not each[3, ~bad].any() and not np.isnan(each[:2, ~bad]).any()


# Central differences over two steps, extrapolated: their error, of the largest derivative.
STEP, SLOPES = 2.0**-16, 1e-8


def engine_points(values, double=True):
    """Points (n, d) as an array of the engine."""
    import drjit.llvm.ad as backend

    if values.shape[1] == 1:
        return (backend.Float64 if double else backend.Float)(values[:, 0].tolist())
    return (backend.Array2f64 if double else backend.Array2f)(*values.T.tolist())


def read(array):
    """The components of an array of the engine, a row each."""
    parts = [array.real, array.imag] if "Complex" in type(array).__name__ else array
    return np.atleast_2d(np.array(parts))


def moved(source, step, change):
    """The source with its vertices (or ends), weights and amplitudes changed."""
    if isinstance(source, pw.Array):
        sizes = np.cumsum([sum(map(len, e.rings)) for e in source.elements])
        parts = np.split(change["vertices"], sizes[:-1])
        elements = [
            moved(e, step, {"vertices": p}) for e, p in zip(source.elements, parts, strict=True)
        ]
        return pw.Array(elements, source.weights + step * change["weights"])
    if isinstance(source, pw.Slits):
        return pw.Slits(source.intervals + step * change["intervals"])
    sizes = np.cumsum([len(ring) for ring in source.rings])
    rings = np.split(np.concatenate(source.rings) + step * change["vertices"], sizes[:-1])
    plain = pw.Aperture([shapely.Polygon(rings[0], rings[1:])])
    if source.illumination is None:
        return plain
    amplitudes = source.illumination.amplitudes + step * change.get("amplitudes", 0.0)
    return plain.with_illumination(pw.Illumination(amplitudes, source.illumination.frequencies))


def own_parameters(source):
    """The numbers that a source of the plane or the line may be differentiated in."""
    if isinstance(source, pw.Slits):
        return {"intervals": source.intervals}
    if isinstance(source, pw.Array):
        rings = [ring for element in source.elements for ring in element.rings]
        return {"vertices": np.concatenate(rings), "weights": source.weights}
    found = {"vertices": np.concatenate(source.rings)}
    field = source.illumination
    return found if field is None else found | {"amplitudes": field.amplitudes}


def total_of(value, seed):
    """A weighted sum over samples of real and imaginary parts."""
    if (hasattr(value, "imag") and not isinstance(value, np.ndarray)) or np.iscomplexobj(value):
        value = value.real + 0.7 * value.imag
    return (value * seed).sum() if isinstance(value, np.ndarray) else value * type(value)(seed)


CHANGING = ["chevron", "holes", "collection", "slits"]
IN_POINTS = ["30-gon", "leaning", "product, turned and moved", "steered", "curved", "tapered slits"]


@pytest.mark.llvm
@pytest.mark.parametrize(
    ("name", "function", "changes"),
    [
        *((name, "wigner", True) for name in CHANGING),
        ("chevron", "ambiguity", True),
        ("slits", "ambiguity", True),
        ("three waves", "fourier", True),
        *(
            pytest.param(name, function, True, marks=pytest.mark.slow)
            for name in CHANGING[1:]
            for function in ("ambiguity", "fourier")
            if (name, function) != ("slits", "ambiguity")
        ),
        pytest.param("three waves", "wigner", True, marks=pytest.mark.slow),
        *((name, "wigner", False) for name in IN_POINTS),
        *(
            pytest.param(name, function, False, marks=pytest.mark.slow)
            for name in IN_POINTS
            for function in ("ambiguity", "fourier")
            if (name, function) != ("curved", "fourier")
        ),
    ],
)
def test_slopes_are_those_of_differences(name, function, changes):
    """In places, lags and frequencies; and in vertices or ends, weights and amplitudes."""
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
        is_complex = key in ("weights", "amplitudes")
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
    assert abs(sum(terms) - expected) <= SLOPES * np.abs(terms).sum()


@pytest.mark.llvm
@pytest.mark.parametrize(
    ("name", "precision"),
    [
        *((name, "double") for name in ("cosine", "curved", "tapered slits")),
        ("chevron", "single"),
        *(
            pytest.param(name, "double", marks=pytest.mark.slow)
            for name in ("overlapping", "lattice", "partly coherent", "product")
        ),
    ],
)
def test_arrays_of_the_engine_give_arrays_of_the_engine_with_the_same_values(name, precision):
    """Vectors and tensors; few samples, which are recorded, and many, which may be sorted."""
    import drjit.llvm as backend

    source, at, double = laws.source_of(name), laws.hard_points(name), precision == "double"
    tensor = backend.TensorXf64 if double else backend.TensorXf
    for function in kinds.FUNCTIONS[:3] if "partly" not in name else ("wigner",):
        points = arguments(function, place_of(function, at), at.nu)
        points = [p.astype(np.float64 if double else np.float32) for p in points]
        expected = getattr(pw, function)(source, *points, engine="numpy")
        parts = [expected.real, expected.imag][: 1 + np.iscomplexobj(expected)]
        error = 2 * allowed(name, function, precision)
        found = getattr(pw, function)(source, *map(tensor, points)).numpy()
        assert np.abs(found.reshape(len(expected), -1).T - parts).max() <= error
        for times in (1, 1000):
            many = [engine_points(np.tile(p, (times, 1)), double) for p in points]
            found = getattr(pw, function)(source, *many)
            found = [found.real, found.imag] if len(parts) > 1 else [found]
            for one, part in zip(found, parts, strict=True):
                assert np.abs(np.array(one) - np.tile(part, times)).max() <= error
