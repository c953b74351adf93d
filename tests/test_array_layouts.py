"""Positions and weights of arrays, and the lobes of their array factors."""

import itertools
import sys
from fractions import Fraction

import numpy as np
import pytest

import polywigner as pw
from polywigner import arrays
from polywigner.errors import MissingExtraError

WAVELENGTH = 3.893e-3  # 77 GHz
PITCH = 0.6 * WAVELENGTH

# Rounding error of sums of up to 1024 terms of modulus 1, with phases up to 1e3 cycles.
ROUNDING = 1e-12


def array_factor(positions, weights, nu):
    """Return the array factor sum_k w_k exp(-2 pi i nu.x_k)."""
    return np.exp(-2j * np.pi * (nu @ np.asarray(positions).T)) @ np.asarray(weights)


def directions(count, seed):
    s = np.random.default_rng(seed).normal(size=(count, 3))
    s[:, 2] = np.abs(s[:, 2])
    return s / np.linalg.norm(s, axis=1, keepdims=True)


@pytest.mark.parametrize(("nx", "ny"), [(1, 1), (2, 1), (3, 4)])
def test_a_grid_is_centred_and_its_coordinates_are_rounded_once(nx, ny):
    x_pitch, y_pitch = 1.9e-3, 0.1
    grid = arrays.grid_positions(nx, ny, x_pitch, y_pitch)
    assert grid.shape == (nx * ny, 2)
    for (i, j), place in zip(itertools.product(range(nx), range(ny)), grid, strict=True):
        assert place[0] == float((i - Fraction(nx - 1, 2)) * Fraction(x_pitch))
        assert place[1] == float((j - Fraction(ny - 1, 2)) * Fraction(y_pitch))
    np.testing.assert_array_equal(np.sort(grid, axis=0), np.sort(-grid, axis=0))
    assert not np.signbit(grid[grid == 0]).any()


def test_inner_elements_of_a_triangular_lattice_have_six_neighbours_at_one_pitch():
    places = arrays.triangular_positions(7, 6, PITCH)
    assert len(places) == 42
    distance = np.linalg.norm(places[:, None] - places, axis=-1)
    near = (distance < 1.001 * PITCH).sum(axis=1) - 1
    inner = (np.abs(places) < np.ptp(places, axis=0) / 2 - 0.8 * PITCH).all(axis=1)
    assert inner.sum() >= 18
    assert (near[inner] == 6).all()
    assert distance[distance > 0].min() == pytest.approx(PITCH, rel=1e-12)


def test_rings_are_regular_polygons():
    places = arrays.ring_positions([0.0, 1e-3, 2e-3], [1, 6, 12])
    radius = np.hypot(*places.T)
    np.testing.assert_allclose(radius, np.repeat([0, 1e-3, 2e-3], [1, 6, 12]), rtol=1e-14)
    np.testing.assert_allclose(places[1:7].sum(axis=0), 0, atol=1e-17)
    np.testing.assert_allclose(places[1], [1e-3, 0], atol=1e-18)
    assert places[2, 1] > 0  # counter-clockwise
    steps = np.linalg.norm(np.diff(places[7:], axis=0), axis=1)
    np.testing.assert_allclose(steps, 4e-3 * np.sin(np.pi / 12), rtol=1e-12)


@pytest.mark.parametrize("s", directions(2, seed=1))
def test_a_steered_array_peaks_towards_the_direction_and_at_its_grating_lobes(s):
    places = arrays.grid_positions(12, 16, PITCH)
    weights = arrays.steering_weights(places, s, WAVELENGTH)
    np.testing.assert_allclose(np.abs(weights), 1, rtol=1e-15)
    peak = s[:2] / WAVELENGTH
    lobes = peak + np.array([[0, 0], [1, 0], [0, -1], [2, 3]]) / PITCH
    factor = np.abs(array_factor(places, weights, lobes))
    np.testing.assert_allclose(factor, len(places), rtol=ROUNDING)
    element = pw.shapes.rectangle(1.2e-3, 1.0e-3)
    array = pw.phased_array(element, places, weights)
    expected = len(places) * np.abs(pw.fourier(element, lobes))
    np.testing.assert_allclose(
        np.abs(pw.fourier(array, lobes)), expected, atol=ROUNDING * len(places) * element.area
    )


def test_waves_of_a_focused_array_arrive_in_phase():
    places = arrays.grid_positions(16, 16, PITCH)
    focus = np.array([5e-3, -8e-3, 60e-3])
    weights = arrays.focusing_weights(places, focus, WAVELENGTH)

    def field(point):
        distance = np.sqrt(((point[:2] - places) ** 2).sum(-1) + point[2] ** 2)
        return complex((weights * np.exp(2j * np.pi * distance / WAVELENGTH) / distance).sum())

    distance = np.sqrt(((focus[:2] - places) ** 2).sum(-1) + focus[2] ** 2)
    at_focus = field(focus)
    assert abs(at_focus) == pytest.approx((1 / distance).sum(), rel=ROUNDING)
    phase = 2 * np.pi * np.linalg.norm(focus) / WAVELENGTH  # phase of a wave from the origin
    assert at_focus == pytest.approx(abs(at_focus) * np.exp(1j * phase), rel=1e-10)
    aside = [field(focus + step) for step in directions(50, seed=2) * [10e-3, 10e-3, 0]]
    assert np.abs(aside).max() < abs(at_focus)


def sidelobes(weights):
    """Return the levels in dB of all sidelobes, up to halfway to the grating lobe."""
    row = np.arange(len(weights)) - (len(weights) - 1) / 2
    pattern = np.abs(array_factor(row[:, None], weights, np.linspace(0, 0.5, 20001)[:, None]))
    level = 20 * np.log10(pattern / pattern[0] + 1e-30)
    inner = level[1:-1]
    return inner[(inner > level[:-2]) & (inner > level[2:])]


@pytest.mark.parametrize(("count", "sll"), [(16, 20.0), (17, 30.0), (64, 60.0)])
def test_all_sidelobes_of_a_chebyshev_array_are_equal(count, sll):
    levels = sidelobes(arrays.window_weights(count, "chebyshev", sll=sll))
    assert len(levels) >= count // 2 - 4
    np.testing.assert_allclose(levels, -sll, atol=1e-3)


@pytest.mark.parametrize(("sll", "nbar"), [(25.0, 4), (30.0, 4), (40.0, 7)])
def test_sidelobes_of_a_taylor_array_stay_below_what_was_asked_for(sll, nbar):
    levels = sidelobes(arrays.window_weights(64, "taylor", sll=sll, nbar=nbar))
    assert -sll - 1 < levels.max() < -sll + 0.2


def test_a_hamming_array_has_its_known_sidelobes_and_a_uniform_one_those_of_a_sinc():
    assert sidelobes(arrays.window_weights(200, "hamming")).max() == pytest.approx(-42.7, abs=0.5)
    assert sidelobes(arrays.window_weights(200, "uniform")).max() == pytest.approx(-13.26, abs=0.01)


def test_the_taper_of_a_grid_is_separable_and_in_the_order_of_its_positions():
    nx, ny = 12, 5
    weights = arrays.window_weights((nx, ny), ("taylor", "chebyshev"), sll=25, nbar=3)
    along_x = arrays.window_weights(nx, "taylor", sll=25, nbar=3)
    along_y = arrays.window_weights(ny, "chebyshev", sll=25)
    places = arrays.grid_positions(nx, ny, 1.0, 2.0)
    for (x, y), weight in zip(places, weights, strict=True):
        i, j = int(x + (nx - 1) / 2), int(y / 2 + (ny - 1) / 2)
        assert weight == pytest.approx(along_x[i] * along_y[j], rel=1e-15)
    assert weights.max() == 1
    assert (arrays.window_weights((3, 1), "hamming") == arrays.window_weights(3, "hamming")).all()


def test_without_scipy_windows_name_the_extra_that_brings_it(monkeypatch):
    monkeypatch.setitem(sys.modules, "scipy.signal.windows", None)
    with pytest.raises(MissingExtraError, match=r'pip install "polywigner\[arrays\]"'):
        arrays.window_weights(8, "taylor")
    assert len(arrays.window_weights(8, "hamming")) == 8


def test_thinned_elements_keep_the_order_of_the_full_layout():
    full = arrays.grid_positions(8, 6, 1e-3)
    kept = arrays.thinned(full, 0.4, seed=3)
    assert (kept == arrays.thinned(full, 0.4, seed=3)).all()
    assert not np.array_equal(kept, arrays.thinned(full, 0.4, seed=4))
    np.testing.assert_array_equal(arrays.thinned(full, 1.0, seed=0), full)
    order = [full.tolist().index(position) for position in kept.tolist()]
    assert order == sorted(order)
