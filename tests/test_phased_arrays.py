"""Array factors, beams and grating lobes, and recognition of equal elements."""

import numpy as np
import pytest

import polywigner as pw
from oracles.references import ENGINES
from polywigner.source.normal_form import normal_form

engines = pytest.mark.parametrize("engine", ENGINES)

SQUARE = pw.Aperture([[0, 0], [1, 0], [1, 1], [0, 1]])
ELL = pw.Aperture([[0, 0], [2, 0], [2, 1], [1, 1], [1, 2], [0, 2]])


def _phases(turns, count):
    return np.exp(2j * np.pi * turns * np.arange(count))


def _taper(count):
    return np.hanning(count + 2)[1:-1]


def _random(count):
    rng = np.random.default_rng(count)
    return rng.normal(size=count) + 1j * rng.normal(size=count)


grid = pw.arrays.grid_positions
STEERED = pw.phased_array(
    SQUARE, grid(5, 2, 1.2, 2.5), np.outer(_taper(5) * _phases(0.13, 5), [1.0, 1.2]).ravel()
)


def _points(array, count, seed):
    """Return x, xi and nu; at half of the points, edges or corners of the copies coincide."""
    rng = np.random.default_rng(seed)
    element, positions = array.repeated
    corners = np.concatenate(element.rings)

    def corner():
        own = corners[rng.integers(len(corners), size=count)]
        return own + positions[rng.integers(len(positions), size=count)]

    low, high = np.reshape(array.support.bounds, (2, 2))
    x, xi = rng.uniform(low, high, (count, 2)), rng.uniform(low - high, high - low, (count, 2))
    half = count // 2
    x[:half], xi[:half] = ((corner() + corner()) / 2)[:half], (corner() - corner())[:half]
    size = 10 ** rng.uniform(-6, 1, (count, 1))
    return x, xi, rng.normal(size=(count, 2)) * size


@engines
def test_array_factors_on_a_line_in_the_plane_and_in_space(engine):
    rng = np.random.default_rng(3)
    for places in (np.arange(5.0) * 0.7, rng.normal(size=(6, 3)), grid(6, 4, 0.5)):
        weights = _random(len(places))
        columns = places.reshape(len(places), -1)
        nu = rng.normal(size=(40, columns.shape[1]))
        expected = np.exp(-2j * np.pi * (nu @ columns.T)) @ weights
        got = pw.array_factor(places, weights, nu, engine=engine)
        assert np.abs(got - expected).max() < 6e-13 * max(1, np.abs(expected).max())
    single = pw.array_factor(grid(6, 4, 0.5), None, nu * 100, precision="single", engine=engine)
    assert single.dtype == np.complex64
    double = pw.array_factor(grid(6, 4, 0.5), None, nu * 100, engine=engine)
    assert np.abs(single - double).max() < 1e-6 * 24


def test_placed_copies_have_the_transform_of_the_placed_array():
    array = STEERED
    pose = np.eye(4)
    pose[:3, :3] = [[0, 0, 1], [0, 1, 0], [-1, 0, 0]]
    pose[:3, 3] = [3, -2, 1]
    nu = np.random.default_rng(4).normal(size=(50, 3))
    expected = pw.fourier(array, nu @ pose[:3, :3]) * np.exp(-2j * np.pi * (nu @ pose[:3, 3]))
    placed = pw.Array([element.placed(pose) for element in array.elements], array.weights)
    assert np.abs(pw.fourier(placed, nu) - expected).max() < 1e-12


def test_many_copies_in_a_plain_array_are_recognised():
    field = pw.Illumination([0.5, 0.5j], [[0.5, 0.25], [-0.5, 0.75]])
    for element in (SQUARE, SQUARE.with_illumination(field)):
        array = pw.phased_array(element, grid(6, 5, 1.3), _random(30))
        factors = np.ones(30) if element is SQUARE else _random(31)[:30]
        copies = [
            copy if element is SQUARE else copy.with_illumination(factor * copy.illumination)
            for copy, factor in zip(array.elements, factors, strict=True)
        ]
        plain = pw.Array(copies, array.weights / factors)
        assert plain.repeated is None and normal_form(plain).copies is not None
        x, xi, nu = _points(array, 40, 9)
        scale = float(np.abs(array.weights).sum()) ** 2
        assert np.abs(pw.wigner(plain, x, nu) - pw.wigner(array, x, nu)).max() < 1e-13 * scale
        a = pw.ambiguity(plain, nu, xi)
        assert np.abs(a - pw.ambiguity(array, nu, xi)).max() < 1e-13 * scale
    other = [*array.elements[:-1], ELL]
    assert normal_form(pw.Array(other, array.weights)).copies is None
    bent = pw.Aperture(array.elements[-1].rings[0] + [[0, 0], [0, 1e-9], [0, 0], [0, 0]])
    assert normal_form(pw.Array([*array.elements[:-1], bent], array.weights)).copies is None
