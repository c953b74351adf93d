"""Lists by cells of what matters at a place give what cutting every edge by every piece gives.

Which way is taken depends on the number of edges and samples; here cells are forced upon all, and
are compared with exact clipping, or with the other ways forced.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from typing import Any

import numpy as np
import pytest
import shapely

import polywigner as pw
from oracles.references import ENGINES, FEW, awkward, awkward_names, numpy_and_few
from polywigner.execution import NumpyOperations
from polywigner.kernels import tables_of, wigner
from polywigner.kernels.functions.edge_terms import EvenTerms
from polywigner.plans import forced

# Relative to the area: what the package promises; times diameter perimeter/area where that is more,
# since ulps of the diameter move every piece of the boundary.
TOLERANCE = {"double": 1e-12, "single": 5e-6}
BY_BOUNDARY = {"double": 4e-16, "single": 6e-7}
# fewer arrays of the engine are computed as they come
_ENOUGH_TO_SORT = 10_000

engines = pytest.mark.parametrize("engine", ENGINES)
precisions = pytest.mark.parametrize("precision", list(TOLERANCE))


def by_cells(always: bool) -> AbstractContextManager[None]:
    return forced("pairs" if always else "edges")


@pytest.fixture
def cells_only() -> Iterator[None]:
    with by_cells(True):
        yield


def polar(radii: np.ndarray) -> np.ndarray:
    angle = 2 * np.pi * np.arange(len(radii)) / len(radii)
    return np.asarray(radii)[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])


def random_outline(count: int, roughness: float) -> pw.Aperture:
    """A smooth random outline, its vertices moved in and out besides."""
    rng = np.random.default_rng(count)
    angle = 2 * np.pi * np.arange(count) / count
    waves = sum(rng.normal() / k * np.cos(k * angle + 6 * rng.random()) for k in range(1, 9))
    return pw.Aperture(polar(np.exp(0.4 * waves + roughness * rng.random(count))))


def comb(teeth: int, angle: float = 0.0) -> pw.Aperture:
    """Teeth of one width, as far apart as wide: many edges coincide at many places."""
    left = np.arange(0.0, 2 * teeth, 2)
    gap = [[[x, 1.0], [x, 3.0], [x + 1, 3.0], [x + 1, 1.0]] for x in left]
    ring = np.vstack([[[2.0 * teeth - 1, 0.0], [0.0, 0.0]], *gap])
    ring = np.delete(ring, [2, len(ring) - 1], axis=0)  # on the sides of the back
    c, s = np.cos(angle), np.sin(angle)
    return pw.Aperture(ring / teeth @ np.array([[c, s], [-s, c]]))


def square_spiral(turns: int) -> pw.Aperture:
    """A strip as wide as its gap, wound up: long edges side by side."""
    length = np.repeat(np.arange(1, 2 * turns + 1), 2)
    step = np.tile([[1, 0], [0, 1], [-1, 0], [0, -1]], (turns, 1)) * 2 * length[:, None]
    middle = shapely.LineString(np.vstack([[0, 0], step.cumsum(axis=0)]))
    return pw.Aperture(middle.buffer(0.5, cap_style="flat", join_style="mitre"))


def stairs(steps: int) -> pw.Aperture:
    """Turns to the left and to the right in turn, all within one strip."""
    up = np.repeat(np.arange(steps + 1.0), 2)
    ring = np.column_stack([up[1:], up[:-1]])
    return pw.Aperture(np.vstack([ring, [steps - 1.0, steps + 1.5]]) / steps)


def with_touching_holes(count: int) -> pw.Aperture:
    """A row of square holes, corner to corner."""
    corners = np.array([[0, 0], [0.5, -0.5], [1, 0], [0.5, 0.5]])
    holes = shapely.union_all([shapely.Polygon(corners + np.array([k, 0])) for k in range(count)])
    return pw.Aperture(shapely.box(-1, -1, count + 1, 1).difference(holes))


def gear(teeth: int) -> pw.Aperture:
    return pw.Aperture(polar(np.where(np.arange(4 * teeth) % 4 < 2, 1.0, 0.6)))


# So many vertices that cells are divided a few times; more of them only take longer.
OUTLINES: dict[str, Callable[[], pw.Aperture]] = {
    "regular polygon": lambda: pw.shapes.regular_polygon(48, 1.0),
    "star": lambda: pw.shapes.star(20, 1.0, 0.8),
    "spiky star": lambda: pw.shapes.star(20, 1.0, 0.4),
    "random": lambda: random_outline(48, 0.0),
    "random and rough": lambda: random_outline(40, 0.2),
    "jagged": lambda: pw.Aperture(polar(0.5 + 0.5 * np.random.default_rng(1).random(56))),
    "holed ring": lambda: pw.shapes.ring(1.0, 0.6, 24),
    "ring with a small hole": lambda: pw.shapes.ring(1.0, 0.02, 24),
    "comb": lambda: comb(12),
    "turned comb": lambda: comb(12, 0.3),
    "touching hexagons": lambda: pw.shapes.hexagonal_segments(1.0),
    "square spiral": lambda: square_spiral(4),
    "stairs": lambda: stairs(24),
    "touching holes": lambda: with_touching_holes(8),
    "gear": lambda: gear(12),
}
# On compiled engines: coincident sides, holes, and none of these.
COMPILED = ("random and rough", "holed ring", "turned comb", "touching hexagons")


def places(source: pw.Aperture, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Positions and frequencies: a third anywhere, others where vertices meet, jittered by ulps."""
    rng = np.random.default_rng(count)
    low, high = np.reshape(source.bounds, (2, 2))
    x = rng.uniform(low, high, (count, 2))
    corners = np.concatenate(source.rings)
    pairs = corners[rng.integers(len(corners), size=(count // 3, 2))].mean(axis=1)
    x[: len(pairs)] = pairs * (1 + 2**-52 * rng.integers(-2, 3, pairs.shape))
    exact = corners[rng.integers(len(corners), size=(count // 3, 2))].mean(axis=1)
    x[len(pairs) : len(pairs) + len(exact)] = exact
    x[-1] = (low + high) / 2
    nu = rng.uniform(-1, 1, (count, 2)) * 10 ** rng.uniform(-2, 1.5, (count, 1)) / source.diameter
    return x, nu


@pytest.mark.usefixtures("cells_only")
@pytest.mark.parametrize(("name", "engine"), numpy_and_few(awkward_names(), FEW))
@precisions
def test_no_value_jumps_where_edges_are_looked_up(name: str, engine: str, precision: str) -> None:
    case, how = awkward(name), {"engine": engine, "precision": precision}
    allowed = TOLERANCE[precision] * case.area
    got = pw.wigner(case.aperture, case.x, case.x_nu, **how)
    assert np.abs(got - case.wigner).max() < allowed
    if engine == "numpy" or precision == "double":  # seconds of compilation on LLVM
        got = pw.ambiguity(case.aperture, case.upsilon, case.xi, **how)
        assert np.abs(got - case.ambiguity).max() < allowed


@pytest.mark.parametrize(
    ("name", "engine"), numpy_and_few(OUTLINES, COMPILED[:2], pytest.mark.slow, COMPILED[2:])
)
def test_cells_change_no_transform(name: str, engine: str) -> None:
    source = OUTLINES[name]()
    boundary = source.diameter * shapely.length(source.polygons) / source.area
    x, nu = places(source, 120)
    corners = np.concatenate(source.rings)
    lag = 2 * (x - corners.mean(axis=0))
    lag[:40] = corners[np.arange(40) % len(corners)] - corners[np.arange(40) * 7 % len(corners)]
    calls: list[tuple[Any, ...]] = [(pw.wigner, x, nu), (pw.ambiguity, nu, lag)]
    if engine == "numpy":
        calls += [(pw.position_marginal, x), (pw.lag_marginal, lag)]
    for transform, *points in calls:
        with by_cells(False):
            expected = transform(source, *points, engine="numpy")
        with by_cells(True):
            for precision, tolerance in TOLERANCE.items():
                got = transform(source, *points, engine=engine, precision=precision)
                allowed = max(tolerance, BY_BOUNDARY[precision] * boundary)
                assert np.abs(got - expected).max() < allowed * source.area


@pytest.mark.slow
def test_hundreds_of_vertices_are_as_accurate_as_few() -> None:
    source = pw.shapes.disc(1.0, 512)  # that of the next test: its tables take a second or two
    x, nu = places(source, 30)
    with by_cells(False):
        expected = pw.wigner(source, x, nu, engine="numpy")
    with by_cells(True):
        got = pw.wigner(source, x, nu, engine="numpy")
    assert np.abs(got - expected).max() < TOLERANCE["double"] * source.area


@pytest.mark.usefixtures("cells_only")
def test_a_regular_polygon_of_many_vertices_has_the_lag_slices_of_a_disc() -> None:
    radius = 1.0
    source = pw.shapes.disc(radius, 256)
    x = np.column_stack([np.linspace(0, 0.999, 64), np.zeros(64)]) * radius
    # two discs of radius 2 r at a distance of 4 |x|
    half = np.arccos(np.minimum(x[:, 0] / radius, 1))
    lens = 4 * radius**2 * (2 * half - np.sin(2 * half))
    got = pw.position_marginal(source, x, engine="numpy")
    assert np.abs(got - lens).max() < 4e-4 * source.area  # the polygon's deviation, 1/n^2


@pytest.mark.usefixtures("cells_only")
def test_a_side_that_ends_at_the_rim_of_a_cell_does_not_cut_beyond_its_end() -> None:
    """By symmetry, vertices of a gear lie on the rim of a track up to a rounding in float32."""
    angle = np.arange(200) * (2 * np.pi / 200)
    radius = np.where(np.arange(200) % 4 < 2, 1.0, 0.5)
    gear = pw.Aperture(radius[:, None] * np.column_stack([np.cos(angle), np.sin(angle)]))
    x = np.random.default_rng(5).uniform(-0.9, 0.9, (300, 2))
    outline = gear.polygons
    doubled = shapely.transform(outline, lambda p: 2 * p)
    slices = [
        shapely.intersection(
            shapely.transform(doubled, lambda p, at=at: p - 2 * at),
            shapely.transform(doubled, lambda p, at=at: 2 * at - p),
        ).area
        for at in x
    ]
    got = pw.position_marginal(gear, x, engine="numpy")
    assert np.abs(got - slices).max() < TOLERANCE["double"] * gear.area


@pytest.mark.slow
@engines
def test_fields_count_as_in_pieces(engine: str) -> None:
    disc = pw.shapes.disc(1.0, 48)
    tile = pw.Aperture(shapely.box(-0.5, -0.5, 0.75, 0.5))
    touching = pw.Aperture(shapely.box(0.75, -0.5, 1.5, 0.5))
    tilted = disc.with_illumination(pw.Illumination([1.0, 0.5j], [[0.3, 0.1], [-0.4, 0.2]]))
    weights = np.array([1.0, 0.5 - 0.8j, 0.5 - 0.8j])
    sources = {
        "real": pw.Array([disc, tile, touching], weights.real),
        "two fields": pw.Array([tilted, tile], weights[:2]),
    }
    x, nu = places(disc, 150)
    for name, source in sources.items():
        for transform, points in ((pw.wigner, (x, nu)), (pw.ambiguity, (nu, 2 * x))):
            with by_cells(False):
                expected = transform(source, *points, engine="numpy")
            with by_cells(True):
                got = transform(source, *points, engine=engine)
            assert np.abs(got - expected).max() < 10 * TOLERANCE["double"] * disc.area, name


@pytest.mark.usefixtures("cells_only")
@engines
def test_outside_is_zero_and_what_is_not_a_number_stays_so(engine: str) -> None:
    source = pw.shapes.regular_polygon(40, 1.0)
    x = np.array([[2.0, 0.0], [1e30, -1e30], [np.nan, 0.0], [0.1, np.inf], [0.1, 0.2]])
    for precision in TOLERANCE:
        got = pw.wigner(source, x, [0.3, 0.4], engine=engine, precision=precision)
        assert (got[:2] == 0).all()
        assert np.isnan(got[2:4]).all()
        assert got[4] != 0


@pytest.mark.usefixtures("cells_only")
@engines
def test_any_shape_and_order_of_samples_is_kept(engine: str) -> None:
    source = pw.shapes.star(20, 1.0, 0.6)
    x, nu = places(source, 60)
    whole = pw.wigner(source, x[:, None], nu[:7], engine=engine)
    assert whole.shape == (60, 7)
    one_by_one = pw.wigner(source, np.repeat(x, 7, axis=0), np.tile(nu[:7], (60, 1)), engine=engine)
    assert np.abs(whole.ravel() - one_by_one).max() < TOLERANCE["double"] * source.area
    single = pw.wigner(source, x[5], nu[3], engine=engine)
    assert abs(single - whole[5, 3]) < TOLERANCE["double"] * source.area


@pytest.mark.llvm
@pytest.mark.usefixtures("cells_only")
@pytest.mark.parametrize("mode", ["forward", "backward"])
@pytest.mark.parametrize("which", [0, 1], ids=["x", "nu"])
def test_derivatives_pass_through_the_cells(which: int, mode: str) -> None:
    import drjit
    import drjit.llvm.ad as backend

    source, step = pw.shapes.star(20, 1.0, 0.7), 1e-6
    points = [p[80:119] for p in places(source, 120)]  # where nothing coincides
    points[1] = np.clip(points[1], -2, 2)
    arrays = [backend.Array2f64(np.array(p.T)) for p in points]
    drjit.enable_grad(arrays[which])
    value = pw.wigner(source, *arrays)
    shifts = step * np.eye(2)
    around = [
        [pw.wigner(source, *(p + s * (k == which) for k, p in enumerate(points))) for s in pair]
        for pair in ((shift, -shift) for shift in shifts)
    ]
    expected = np.array([(up - down) / (2 * step) for up, down in around])
    if mode == "backward":
        drjit.backward(value)
        assert np.abs(np.array(drjit.grad(arrays[which])) - expected).max() < 1e-6
    else:
        drjit.set_grad(arrays[which], 1.0)
        forward = np.array(drjit.forward_to(value))
        assert np.abs(forward - expected.sum(axis=0)).max() < 1e-6


def test_scalar_kernels_look_up_the_same_cells() -> None:
    from polywigner.execution import ScalarOperations

    source = pw.shapes.star(24, 1.0, 0.7)
    tables = tables_of(source, True)
    inner = [places(source, 30)[k].T[c] * 0.4 for k in (0, 1) for c in (0, 1)]
    with by_cells(False):
        expected = wigner(NumpyOperations(True), tables, *inner)
    with by_cells(True):
        got = [wigner(ScalarOperations(), tables, *sample) for sample in zip(*inner, strict=True)]
    assert np.abs(np.array(got) - expected).max() < TOLERANCE["double"]


@pytest.mark.slow
@pytest.mark.llvm
def test_a_rendered_ring_of_64_edges_is_the_same_by_cells() -> None:
    from mitsuba_scenes import MONO, floor_scene, light, use

    mi = use(MONO.values[0])
    ring = pw.shapes.ring(0.01, 0.006, 32)
    images = []
    for always in (True, False):
        with by_cells(always):
            scene = floor_scene({"ring": light(ring)}, columns=6)
            images.append(np.array(mi.render(scene, spp=64, seed=3))[..., 0])
    assert images[1].max() > 0
    assert np.abs(images[0] - images[1]).max() < 1e-4 * np.abs(images[1]).max()


@pytest.mark.llvm
@pytest.mark.parametrize("precision", list(TOLERANCE))
def test_arrays_of_the_engine_come_back_in_their_own_order(
    precision: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """They are taken in that of the cells, a chunk at a time."""
    import drjit.llvm as backend

    from polywigner.execution import on_drjit_data

    monkeypatch.setattr(on_drjit_data, "_CHUNK", 7000)
    source = pw.shapes.regular_polygon(40, 1.0)
    rng = np.random.default_rng(5)
    x, nu = rng.uniform(-1, 1, (15_001, 2)), rng.uniform(-5, 5, (15_001, 2))
    kind = backend.Array2f if precision == "single" else backend.Array2f64
    found = pw.wigner(source, *(kind(*(np.array(c) for c in p.T)) for p in (x, nu)))
    some = slice(None, None, 100)
    expected = pw.wigner(source, x[some], nu[some], engine="numpy")
    error = np.abs(found.numpy()[some] - expected).max() / source.area
    assert error < TOLERANCE[precision]


@pytest.mark.llvm
def test_one_frequency_goes_with_all_sorted_positions() -> None:
    import drjit.llvm as backend

    source = pw.shapes.regular_polygon(40, 1.0)
    x = np.random.default_rng(6).uniform(-1, 1, (_ENOUGH_TO_SORT, 2))
    found = pw.wigner(source, backend.Array2f64(*(np.array(c) for c in x.T)), (0.3, 1.1))
    expected = pw.wigner(source, x, (0.3, 1.1), engine="numpy")
    assert np.abs(found.numpy() - expected).max() < TOLERANCE["double"] * source.area


@pytest.mark.llvm
@pytest.mark.parametrize("one", ["place", "frequency"])
def test_one_place_or_frequency_counts_for_all_of_an_engines_arrays(one: str) -> None:
    """Arrays of the engine are brought into the order of their cells, if they have one."""
    import drjit.llvm as backend

    source = pw.shapes.regular_polygon(64, 1.0)
    x, nu = places(source, _ENOUGH_TO_SORT)
    x, nu = (x[:1], nu) if one == "place" else (x, nu[:1])
    expected = pw.wigner(source, x, nu, engine="llvm")
    found = pw.wigner(source, backend.Array2f64(*x.T.copy()), backend.Array2f64(*nu.T.copy()))
    assert np.abs(np.array(found) - expected).max() < TOLERANCE["double"] * source.area
    pair = pw.ambiguity(source, backend.Array2f64(*nu.T.copy()), backend.Array2f64(*x.T.copy()))
    found = np.array(pair.real) + 1j * np.array(pair.imag)
    expected = pw.ambiguity(source, nu, x, engine="llvm")
    assert np.abs(found - expected).max() < TOLERANCE["double"] * source.area


@engines
@pytest.mark.parametrize("cut", ["code", "rows", "pairs"])
def test_what_is_not_finite_is_so_in_the_result_even_where_no_slice_is(
    engine: str, cut: str
) -> None:
    source = pw.shapes.regular_polygon(9, 1.0)
    x, nu = np.array([[0.1, 0.2], [5.0, 5.0]] * 3), np.full((6, 2), 0.5)
    nu[:2, 0], nu[2:4, 1] = np.inf, np.nan
    expected = np.arange(6) < 4
    with forced(cut):
        for values in (
            pw.wigner(source, x, nu, engine=engine),
            pw.ambiguity(source, nu, x, engine=engine),
        ):
            np.testing.assert_array_equal(np.isnan(values), expected)


@pytest.mark.parametrize("double", [True, False])
def test_edges_across_the_frequency_make_no_subnormal_numbers(double: bool) -> None:
    """Lanes that wait in a loop see such edges, of no length, and would hold up all others."""
    zero, nu_x = _typed(double)(0.0), _typed(double)(0.3)
    along, ratio = EvenTerms(NumpyOperations(double), (nu_x, zero)).along(zero, zero)
    assert ratio == 0
    assert along * along >= np.finfo(along.dtype).tiny


def _typed(double: bool) -> type:
    return np.float64 if double else np.float32


@engines
def test_without_a_frequency_shift_sums_of_many_edges_round_no_worse(engine: str) -> None:
    """A(0, xi) of many edges: what rounding loses of a sum of small terms is summed up as well."""
    source = pw.shapes.regular_polygon(256, 1.0)
    xi = 0.3 * np.random.default_rng(1).normal(size=(2000, 2))
    expected = pw.lag_marginal(source, xi)
    found = pw.ambiguity(source, [0.0, 0.0], xi, engine=engine, precision="single")
    # a fifth of what is promised for W; without the compensation 2e-6
    assert np.abs(found - expected).max() < 1e-6 * source.area
