"""Phased arrays: lattices and array factors against the same elements summed pair by pair."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

import polywigner as pw
from oracles.references import ENGINES
from polywigner.errors import ArgumentError, IlluminationError

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
