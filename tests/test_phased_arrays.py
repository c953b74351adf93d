"""Phased arrays: lattices and array factors against the same elements summed pair by pair."""

from __future__ import annotations

import math
import sys
import tracemalloc
from typing import Any

import numpy as np
import pytest

import polywigner as pw
from oracles.pair_sums import ambiguity_of_copies, wigner_of_copies
from oracles.references import ENGINES, numpy_and_few
from polywigner.errors import ArgumentError, IlluminationError
from polywigner.execution.operations import NumpyOperations
from polywigner.illumination.lattices import Profile, lattice_of, separated
from polywigner.kernels.arrays.element_pairs import is_scattered
from polywigner.kernels.arrays.factors import ProfileFactor, _Series
from polywigner.kernels.arrays.lattice_arrays import is_on_lattice
from polywigner.kernels.arrays.repeated import HeldTable
from polywigner.kernels.arrays.weight_tables import factor_table

# Relative to (sum |w|)^2 area, which bounds the sum over pairs in absolute values.
TOLERANCE = {"double": 1e-13, "single": 2e-6}

engines = pytest.mark.parametrize("engine", ENGINES)

SQUARE = pw.Aperture([[0, 0], [1, 0], [1, 1], [0, 1]])
ELL = pw.Aperture([[0, 0], [2, 0], [2, 1], [1, 1], [1, 2], [0, 2]])
WAVES = pw.Illumination([0.5, 0.5j], [[0.5, 0.25], [-0.5, 0.75]])


def _phases(turns: float, count: int) -> np.ndarray:
    return np.exp(2j * np.pi * turns * np.arange(count))


def _taper(count: int) -> np.ndarray:
    return np.hanning(count + 2)[1:-1]


def _random(count: int) -> np.ndarray:
    rng = np.random.default_rng(count)
    return rng.normal(size=count) + 1j * rng.normal(size=count)


grid = pw.arrays.grid_positions
ARRAYS = {
    "uniform": pw.phased_array(SQUARE, grid(4, 3, 1.5, 1.25)),
    "touching, steered": pw.phased_array(SQUARE, grid(3, 3, 1.0), np.repeat(_phases(0.2, 3), 3)),
    "half pitch": pw.phased_array(SQUARE, grid(3, 2, 2.0) + np.array([100.0, -30.0])),
    "tapered and steered": pw.phased_array(
        SQUARE,
        grid(5, 2, 1.2, 2.5),
        np.outer(_taper(5) * _phases(0.13, 5), [1.0, 1.2]).ravel(),
    ),
    "quadratic phase": pw.phased_array(
        SQUARE, grid(5, 2, 1.2, 2.5), np.outer(_phases(0.03, 5) ** np.arange(5), [1, 2j]).ravel()
    ),
    "alternating": pw.phased_array(
        SQUARE, grid(4, 2, 1.2), np.outer([1, -1, 1, -1], [1, 1]).ravel()
    ),
    "any weights": pw.phased_array(SQUARE, grid(3, 2, 1.2), _random(6)),
    "overlapping": pw.phased_array(ELL, grid(3, 2, 1.5, 1.2), np.repeat(_taper(3), 2)),
    "triangular": pw.phased_array(SQUARE, pw.arrays.triangular_positions(3, 3, 1.3), _random(9)),
    "own waves": pw.phased_array(
        SQUARE.with_illumination(WAVES), grid(3, 2, 1.25, 1.5), np.repeat(_taper(3), 2)
    ),
    "own waves, any weights": pw.phased_array(
        ELL.with_illumination(WAVES), grid(2, 2, 2.5, 3.0), _random(4)
    ),
    # walking every half pitch under an element would never end
    "far smaller than an element": pw.phased_array(SQUARE, grid(3, 2, 1e-6), _random(6)),
    "an oblique row": pw.phased_array(SQUARE, np.outer(np.arange(5), [1.1, 0.3])),
}

SCATTERED = {
    "scattered": pw.phased_array(SQUARE, np.random.default_rng(1).uniform(0, 4, (10, 2))),
    "scattered far off, any weights": pw.phased_array(
        ELL, np.random.default_rng(2).uniform(0, 6, (7, 2)) + np.array([50.0, -20.0]), _random(7)
    ),
    "scattered, own waves": pw.phased_array(
        SQUARE.with_illumination(WAVES * pw.Illumination([1], [[3.0, 4.0]])),
        np.random.default_rng(3).uniform(0, 4, (8, 2)),
        _random(8),
    ),
}
ALL = {**ARRAYS, **SCATTERED}
# Of all kinds of weights and places, for compiled engines.
FEW = (
    "touching, steered",
    "any weights",
    "own waves, any weights",
    "scattered far off, any weights",
)


def _points(array: pw.Array, count: int, seed: int) -> tuple[np.ndarray, ...]:
    """x, xi and nu; half of x and xi where edges or corners of copies coincide."""
    rng = np.random.default_rng(seed)
    element, positions = array.repeated
    corners = np.concatenate(element.rings)

    def corner() -> np.ndarray:
        own = corners[rng.integers(len(corners), size=count)]
        return own + positions[rng.integers(len(positions), size=count)]

    low, high = np.reshape(array.support.bounds, (2, 2))
    x, xi = rng.uniform(low, high, (count, 2)), rng.uniform(low - high, high - low, (count, 2))
    half = count // 2
    x[:half], xi[:half] = ((corner() + corner()) / 2)[:half], (corner() - corner())[:half]
    size = 10 ** rng.uniform(-6, 1, (count, 1))
    return x, xi, rng.normal(size=(count, 2)) * size


@pytest.mark.parametrize(
    ("name", "precision", "engine"),
    numpy_and_few(
        [(name, "double") for name in ALL] + [(name, "single") for name in FEW],
        [("any weights", "double"), (FEW[3], "double"), ("tapered and steered", "single")],
        slow=[("touching, steered", "double"), ("own waves, any weights", "double")],
    ),
)
def test_functions_of_an_array_are_sums_over_pairs_of_elements(
    name: str, precision: str, engine: str
) -> None:
    array = ALL[name]
    assert is_on_lattice(array) == (name in ARRAYS)
    assert is_on_lattice(array) or is_scattered(array)
    one_by_one = pw.Array(array.elements, array.weights)
    x, xi, nu = _points(array, 60, 1)
    scale = float(np.abs(array.weights).sum()) ** 2 * array.repeated[0].area
    if name in ("half pitch", "scattered far off, any weights"):
        scale *= 10  # the vertices of moved copies are rounded
    how = {"precision": precision, "engine": engine}
    for transform, points in (
        (pw.wigner, (x, nu)),
        (pw.ambiguity, (nu, xi)),
        (pw.position_marginal, (x,)),
        (pw.lag_marginal, (xi,)),
        (pw.autocorrelation, (x[30:], xi[30:])),
    ):
        expected = transform(one_by_one, *points, engine="numpy")
        error = np.abs(transform(array, *points, **how) - expected).max()
        assert error < TOLERANCE[precision] * scale, transform.__name__


@pytest.mark.parametrize(
    ("shape", "precision", "engine"),
    numpy_and_few(
        [((7, 5), "double"), ((7, 5), "single"), ((70, 1), "double")],
        [((70, 1), "double")],
    ),
)
def test_tables_of_weights_agree_with_the_sum_over_pairs(
    shape: tuple[int, int], precision: str, engine: str
) -> None:
    count = shape[0] * shape[1]
    weights = _random(count)
    if shape[1] > 1:
        assert separated(weights.reshape(shape)) is None
    array = pw.phased_array(SQUARE, grid(*shape, 1.3), weights)
    x, xi, nu = _points(array, 60, 8)
    nu[:20] = np.round(nu[:20] * 4) / 4 / 1.3  # where sums repeat themselves
    allowed = (1e-12 if precision == "double" else 2e-6) * float((np.abs(weights) ** 2).sum())
    how: dict[str, Any] = {"precision": precision, "engine": engine}
    found = pw.wigner(array, x, nu, **how)
    assert np.abs(found - wigner_of_copies(array, x, nu)).max() < allowed
    expected = ambiguity_of_copies(array, nu, xi)
    assert np.abs(expected).max() > 1.0
    assert np.abs(pw.ambiguity(array, nu, xi, **how) - expected).max() < allowed


@pytest.mark.parametrize("count", [200, 300])  # of which one sums terms, the other has a table
def test_rows_of_any_weights_agree_with_the_sum_over_pairs(count: int) -> None:
    row = pw.phased_array(SQUARE, grid(count, 1, 1.3), _random(count))
    x, _, nu = _points(row, 60, 8)
    energy = float((np.abs(row.weights) ** 2).sum())
    found = pw.wigner(row, x, nu, engine="numpy")
    assert np.abs(found - wigner_of_copies(row, x, nu)).max() < 1e-12 * energy


def test_rows_of_terms_beyond_what_single_precision_counts_are_read_where_they_are() -> None:
    """A row of 8192 sites has 2^24 packets of four terms, beyond which float32 has no odd number.

    So many take a gigabyte; here is what would be read of them.
    """
    rows, packets = np.float32([0.0, 9000.0, 16_400.0]), 1025
    assert rows[-1] * packets > 1 << 24
    read: list[Any] = []

    class OfALongTable(NumpyOperations):
        def gather(self, table: Any, row: Any) -> Any:
            read.append(row)
            return np.zeros((4, *np.shape(row)), np.float32)

    series = _Series(packets, (HeldTable(np.zeros((1, 4))), None, None, None))
    turns = np.float32([0.1, 0.2, 0.3])
    series.value(OfALongTable(double=False), rows, 16_400.0, np.float32(5.0), turns)
    expected = rows.astype(int) * packets + np.arange(packets)[::-1, None]
    np.testing.assert_array_equal(read, expected)


@pytest.mark.slow
@pytest.mark.llvm
@pytest.mark.parametrize("transform", [pw.wigner, pw.ambiguity])
def test_long_sums_over_a_row_are_a_loop_of_the_kernel(transform: Any) -> None:
    """Unrolled, thousands of terms would take a minute to compile; derivatives still unroll."""
    import drjit as dr
    import drjit.llvm.ad as backend

    row = pw.phased_array(SQUARE, grid(240, 1, 1.3), _random(240))  # longer ones have tables
    x, xi, nu = _points(row, 60, 8)
    points = (x, nu) if transform is pw.wigner else (nu, xi)
    expected = transform(row, *points, engine="numpy")
    found = transform(row, *points, engine="llvm")
    assert np.abs(found - expected).max() < 1e-12 * np.abs(expected).max()
    if transform is pw.wigner:
        place, frequency = (backend.Array2f64(*p.T.copy()) for p in points)
        dr.enable_grad(frequency)
        dr.backward(dr.sum(pw.wigner(row, place, frequency)))
        step = np.array([1e-7, 0.0])
        ahead, behind = (pw.wigner(row, x, nu + s, engine="numpy") for s in (step, -step))
        slope = (ahead - behind) / 2e-7
        error = np.abs(np.array(dr.grad(frequency)[0]) - slope).max()
        assert error < 1e-6 * np.abs(slope).max()  # of the difference quotient


def test_sums_of_a_thousand_weights_are_made_without_a_loop_over_their_pairs() -> None:
    """A loop took 1.2 s for 1000 elements, a table made at once takes 0.1 s."""
    a = _random(1000)
    factor = ProfileFactor(Profile(tuple(a.tolist()), 0.0, 1.0))
    calls: list[str] = []
    sys.setprofile(lambda frame, event, argument: calls.append(event))
    try:
        means, differences = factor.means, factor.differences
    finally:
        sys.setprofile(None)
    assert means is not None and differences is not None
    assert len(calls) < 5000
    h, turns = np.arange(990, 1010), 0.15
    expected = []
    for total in h:
        i = np.arange(max(0, total - 999), min(total, 999) + 1)
        waves = np.exp(-2j * np.pi * turns * (2 * i - total))
        expected.append((a[i] * a[total - i].conj() * waves).sum())
    at = h.astype(float), np.full(20, 2 * turns)
    found = factor.at(NumpyOperations(double=True), True, *at).real
    assert np.abs(found - np.array(expected)).max() < 1e-12 * float((np.abs(a) ** 2).sum())


@pytest.mark.parametrize("shape", [(2, 300), (300, 2)])
def test_making_a_table_of_weights_takes_memory_for_the_table_alone(shape: tuple[int, int]) -> None:
    """Waves of all midpoints of a long row at once would take thirty times as much."""
    weights = _random(600).reshape(shape)
    factor_table(_random(6).reshape(2, 3), by_mean=True, double=True)  # what is made once
    tracemalloc.start()
    try:
        table = factor_table(weights, by_mean=True, double=True)
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert table is not None
    assert peak < 3 * table.parts[0].values.nbytes


@pytest.mark.parametrize(("precision", "engine"), numpy_and_few(TOLERANCE, ["single"]))
def test_tables_of_weights_hold_for_waves_of_the_highest_rate(precision: str, engine: str) -> None:
    weights = 1e-9 * _random(81)
    weights[[0, -1]] = 1.0, 1j  # opposite corners alone
    assert separated(weights.reshape(9, 9)) is None
    array = pw.phased_array(SQUARE, grid(9, 9, 1.3), weights)
    rng = np.random.default_rng(0)
    x = SQUARE.centre + rng.uniform(-0.4, 0.4, (400, 2))
    nu = rng.uniform(-2, 2, (400, 2))
    got = pw.wigner(array, x, nu, precision=precision, engine=engine)
    expected = wigner_of_copies(array, x, nu)
    assert np.abs(expected).max() > 0.5
    # of what this one pair of sites contributes at most, 2 times 4 times the element's area: the
    # interpolation along two directions; rounding of its phase, 2 pi 16 steps times 2^-25
    share = 8 * (1e-12 if precision == "double" else 1.5e-7 + 2 * np.pi * 16 * 2.0**-25)
    assert np.abs(got - expected).max() < share


@pytest.mark.parametrize(("name", "engine"), numpy_and_few(ALL, FEW))
def test_pattern_of_an_array_is_element_pattern_times_array_factor(name: str, engine: str) -> None:
    array = ALL[name]
    element, positions = array.repeated
    nu = np.random.default_rng(2).normal(size=(80, 2)) * 3
    factor = pw.array_factor(positions, array.weights, nu, engine=engine)
    scale = np.abs(array.weights).sum()
    by_hand = np.exp(-2j * np.pi * (nu @ positions.T)) @ array.weights
    far = "half" in name or "far" in name  # from the origin: by hand, phases lose digits
    assert np.abs(factor - by_hand).max() < (1e-11 if far else 1e-13) * scale
    whole = pw.fourier(array, nu, engine=engine)
    product = pw.fourier(element, nu, engine=engine) * factor
    assert np.abs(np.abs(whole) ** 2 - np.abs(product) ** 2).max() < 1e-13 * scale**2
    one_by_one = pw.fourier(pw.Array(array.elements, array.weights), nu, engine=engine)
    assert np.abs(whole - one_by_one).max() < 1e-11 * scale


@engines
def test_array_factors_on_a_line_in_space_and_of_complex_frequencies(engine: str) -> None:
    rng = np.random.default_rng(3)
    for places in (np.arange(5.0) * 0.7, rng.normal(size=(6, 3)), grid(6, 4, 0.5)):
        weights = _random(len(places))
        columns = places.reshape(len(places), -1)
        nu = rng.normal(size=(40, columns.shape[1]))
        for frequencies in (nu, nu * (1 - 0.2j)):
            expected = np.exp(-2j * np.pi * (frequencies @ columns.T)) @ weights
            got = pw.array_factor(places, weights, frequencies, engine=engine)
            assert np.abs(got - expected).max() < 1e-13 * max(1, np.abs(expected).max()) * 6
    single = pw.array_factor(grid(6, 4, 0.5), None, nu * 100, precision="single", engine=engine)
    assert single.dtype == np.complex64
    double = pw.array_factor(grid(6, 4, 0.5), None, nu * 100, engine=engine)
    assert np.abs(single - double).max() < 1e-6 * 24


def test_placed_copies_share_a_transform() -> None:
    array = ARRAYS["tapered and steered"]
    pose = np.eye(4)
    pose[:3, :3] = [[0, 0, 1], [0, 1, 0], [-1, 0, 0]]
    pose[:3, 3] = [3, -2, 1]
    nu = np.random.default_rng(4).normal(size=(50, 3))
    expected = pw.fourier(array, nu @ pose[:3, :3]) * np.exp(-2j * np.pi * (nu @ pose[:3, 3]))
    assert np.abs(pw.fourier(array.placed(pose), nu) - expected).max() < 1e-12


def test_phased_arrays_of_slits() -> None:
    slit = pw.Slits([0.0, 0.75]).with_illumination(pw.Illumination([1, 0.5], [[0.0], [0.5]]))
    array = pw.phased_array(slit, np.arange(4.0), _random(4))
    one_by_one = pw.Array(array.elements, array.weights)
    x, nu = np.random.default_rng(5).uniform(-1, 4, (2, 50, 1))
    assert np.abs(pw.wigner(array, x, nu) - pw.wigner(one_by_one, x, nu)).max() < 1e-13 * 20
    assert np.abs(pw.fourier(array, nu) - pw.fourier(one_by_one, nu)).max() < 1e-13 * 20


def test_w_of_a_large_array_is_that_of_its_rows_times_that_of_its_columns() -> None:
    # squares are products of intervals: everything separates, also into slits
    rng = np.random.default_rng(7)
    slit = pw.Slits([-0.5, 0.5])
    taper = _taper(32) * _phases(0.21, 32)
    weights = np.outer(taper, taper).ravel()
    array = pw.phased_array(pw.shapes.square(1.0), grid(32, 32, 1.4), weights)
    row = pw.phased_array(slit, grid(32, 1, 1.4)[:, 0], taper)
    x, nu = rng.uniform(-5, 5, (40, 2)), 0.15 + rng.uniform(-0.02, 0.02, (40, 2))
    separate = pw.wigner(row, x[:, :1], nu[:, :1]) * pw.wigner(row, x[:, 1:], nu[:, 1:])
    scale = float((np.abs(taper) ** 2).sum() ** 2)
    assert np.abs(separate).max() > 1e-2 * scale
    for engine in ("numpy", "auto"):
        assert np.abs(pw.wigner(array, x, nu, engine=engine) - separate).max() < 1e-13 * scale
        single = pw.wigner(array, x, nu, engine=engine, precision="single")
        assert np.abs(single - separate).max() < 2e-6 * scale


def test_directivity_of_a_uniform_array() -> None:
    """32 x 32 isotropic elements half a wavelength apart, in a half space: about pi 32^2."""
    places = grid(32, 32, 0.5)
    cosine, share = np.polynomial.legendre.leggauss(160)
    cosine, share = (cosine + 1) / 2, share / 2
    azimuth = 2 * np.pi * np.arange(320) / 320
    sine = np.sqrt(1 - cosine**2)
    nu = np.stack([np.outer(sine, np.cos(azimuth)), np.outer(sine, np.sin(azimuth))], axis=-1)
    power = (np.abs(pw.array_factor(places, None, nu)) ** 2).mean(axis=1) @ share * 2 * np.pi
    directivity = 4 * np.pi * 1024**2 / power
    # exactly: pairs of isotropic sources exchange sinc(2 distance/wavelength)
    distance = np.linalg.norm(places[:, None] - places, axis=-1)
    exact = 2 * 1024**2 / np.sinc(2 * distance).sum()
    assert directivity == pytest.approx(exact, rel=1e-9)
    assert directivity == pytest.approx(np.pi * 32 * 32, rel=0.03)


def test_beam_points_where_it_is_steered_and_grating_lobes_where_theory_has_them() -> None:
    wavelength, pitch = 1.0, 0.8
    places = grid(16, 16, pitch)
    beam = np.array([math.sin(math.radians(20)), 0.0, math.cos(math.radians(20))])
    array = pw.phased_array(
        pw.shapes.square(0.3), places, pw.arrays.steering_weights(places, beam, wavelength)
    )
    axis = np.linspace(-1, 1, 4001)
    cut = np.abs(pw.fourier(array, np.stack([axis, 0 * axis], axis=-1))) ** 2
    assert axis[np.argmax(cut)] == pytest.approx(beam[0], abs=2e-3)
    lobe = axis < -0.5
    assert axis[lobe][np.argmax(cut[lobe])] == pytest.approx(beam[0] - 1 / pitch, abs=5e-3)


def test_many_copies_in_a_plain_array_are_recognised() -> None:
    field = pw.Illumination([0.5, 0.5j], [[0.5, 0.25], [-0.5, 0.75]])
    for element in (SQUARE, SQUARE.with_illumination(field)):
        array = pw.phased_array(element, grid(6, 5, 1.3), _random(30))
        plain = pw.Array(list(array.elements), array.weights)
        assert plain.repeated is None and plain.phased is not None
        x, xi, nu = _points(array, 40, 9)
        scale = float(np.abs(array.weights).sum()) ** 2
        assert np.abs(pw.wigner(plain, x, nu) - pw.wigner(array, x, nu)).max() < 1e-13 * scale
        a = pw.ambiguity(plain, nu, xi)
        assert np.abs(a - pw.ambiguity(array, nu, xi)).max() < 1e-13 * scale
    other = [*array.elements[:-1], ELL]
    assert pw.Array(other, array.weights).phased is None
    bent = pw.Aperture(array.elements[-1].rings[0] + [[0, 0], [0, 1e-9], [0, 0], [0, 0]])
    assert pw.Array([*array.elements[:-1], bent], array.weights).phased is None


def test_lattices_are_recognised() -> None:
    rng = np.random.default_rng(6)
    places = rng.permutation(grid(7, 5, 0.3e-3, 0.7e-3) + np.array([1.0, -2.0]))
    found = lattice_of(places, np.ones(35, complex))
    assert found is not None and sorted(found.weights.shape) == [5, 7]
    assert (found.weights == 1).all()
    turned = grid(6, 6, 1.0) @ np.array([[0.8, 0.6], [-0.6, 0.8]])
    assert lattice_of(turned, np.ones(36, complex)) is not None
    thinned = places[rng.random(35) < 0.6]
    found = lattice_of(thinned, np.ones(len(thinned), complex))
    assert found is not None and found.weights.sum() == len(thinned)
    assert lattice_of(rng.uniform(0, 1, (20, 2)), np.ones(20, complex)) is None
    nearly = grid(4, 4, 1.0)
    nearly[5] += [1e-9, 0.0]
    assert lattice_of(nearly, np.ones(16, complex)) is None
    lonely = np.concatenate([[[-4.5, -4.5]], grid(4, 4, 1.0)])  # no neighbour of the first is near
    assert lattice_of(lonely, np.ones(17, complex)) is not None
    twice = np.concatenate([grid(2, 2, 1.0), grid(2, 2, 1.0)])
    found = lattice_of(twice, np.ones(8, complex))
    assert found is not None and (found.weights == 2).all()
    assert lattice_of(np.zeros((3, 2)), np.ones(3, complex)) is None


@pytest.mark.parametrize("count", [46, 64, 120])
def test_large_lattices_are_recognised_in_any_order_and_half_empty(count: int) -> None:
    rng = np.random.default_rng(count)
    square = grid(count, count, 2.1e-3, 1.9e-3)
    triangular = grid(count, count, 1.0) @ np.array([[1.0, 0.0], [0.5, np.sqrt(0.75)]])
    for places in (square, triangular):
        assert lattice_of(places, np.ones(len(places), complex)).weights.shape == (count, count)
        half = rng.permutation(places[rng.random(len(places)) < 0.5])
        found = lattice_of(half, np.ones(len(half), complex))
        assert found.weights.sum() == len(half)


def test_profiles_are_recognised() -> None:
    column, row = _taper(6) * _phases(0.31, 6) * 2j, _phases(-0.4, 5)
    first, second = separated(np.outer(column, row))
    assert np.isreal(first.amplitudes).all() and not first.is_uniform
    assert first.turns % 1 == pytest.approx(0.31, abs=1e-12)
    assert second.is_uniform
    for profile, values in ((first, column), (second, row)):
        rebuilt = (
            profile.factor * np.array(profile.amplitudes) * _phases(profile.turns, len(values))
        )
        ratio = rebuilt / values
        assert np.abs(ratio - ratio[0]).max() < 1e-13 * abs(ratio[0])
    assert separated(_random(12).reshape(4, 3)) is None


@pytest.mark.parametrize(
    ("call", "error", "message"),
    [
        (lambda: pw.phased_array(None, [[0, 0]]), ArgumentError, "to repeat, got NoneType"),
        (lambda: pw.phased_array(SQUARE, [0, 1]), ArgumentError, r"\(n, 2\)"),
        (lambda: pw.phased_array(SQUARE, [[0, np.inf]]), ArgumentError, "finite positions"),
        (lambda: pw.phased_array(SQUARE, "abc"), ArgumentError, r"\(n, 2\)"),
        (lambda: pw.phased_array(SQUARE, [[0, 0]], [1, 2]), IlluminationError, "1 elements"),
        (lambda: pw.phased_array(SQUARE, [[0, 0]], [0]), IlluminationError, "zeros only"),
        (lambda: pw.array_factor([[0, 0, 0, 0]], None, [0]), ArgumentError, "positions"),
        (lambda: pw.array_factor([[0, 0]], None, [0.0]), ArgumentError, "nu of shape"),
    ],
)
def test_bad_arrays_are_refused(call: Any, error: type[Exception], message: str) -> None:
    with pytest.raises(error, match=message):
        call()
