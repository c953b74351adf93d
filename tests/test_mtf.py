"""Modulation transfer functions of lenses: closed forms, and the OTF."""

import numpy as np
import pytest

import polywigner as pw
from polywigner.errors import ArgumentError

SQUARE = pw.shapes.square(10e-3)
ROUNDING = 1e-12


def test_a_square_pupil_has_the_triangle_of_its_overlap():
    """1 - lambda f nu/D along its sides, 0 from 200 cycles/mm on."""
    nu = np.array([0.0, 50.0, 120.0, 200.0, 350.0])
    frequency = np.stack([nu, 0 * nu], axis=-1)
    found = pw.mtf(SQUARE, frequency, 0.5e-6, 0.1)
    assert found == pytest.approx(np.maximum(0, 1 - nu / 200), abs=ROUNDING)


def test_defocus_is_that_of_the_otf():
    frequency = np.random.default_rng(2).uniform(-150, 150, (20, 2))
    expected = np.abs(pw.otf(SQUARE, frequency * 1e3 * 0.5e-6 * 0.1, 0.7))
    assert pw.mtf(SQUARE, frequency, 0.5e-6, 0.1, 0.7) == pytest.approx(expected, abs=ROUNDING)


def test_white_light_is_the_modulus_of_the_mean_otf():
    """The aberration in metres is one: in waves, it is larger at shorter wavelengths."""
    frequency, lengths, weights = np.array([60.0, 20.0]), np.array([0.4e-6, 0.7e-6]), [1.0, 3.0]
    mean = (0.4e-6 + 3 * 0.7e-6) / 4
    parts = [
        w / 4 * pw.otf(SQUARE, frequency * 1e3 * length * 0.1, 0.6 * mean / length)
        for w, length in zip(weights, lengths, strict=True)
    ]
    found = pw.mtf(SQUARE, frequency, lengths, 0.1, 0.6, weights=weights)
    assert found == pytest.approx(abs(sum(parts)), abs=ROUNDING)


@pytest.mark.parametrize(
    ("how", "words"),
    [
        ({"wavelength": [[1e-6]]}, "wavelength"),
        ({"wavelength": -1e-6}, "wavelength"),
        ({"focal_length": 0.0}, "focal_length"),
        ({"weights": "a"}, "weights"),
        ({"weights": [1.0, 2.0]}, "weights"),
        ({"weights": [-1.0]}, "weights"),
        ({"frequency": (1.0, 2.0, 3.0)}, "frequency"),
        ({"defocus": float("nan")}, "defocus"),
    ],
)
def test_bad_arguments_are_refused(how, words):
    given = {"frequency": (1.0, 0.0), "wavelength": 0.5e-6, "focal_length": 0.1, **how}
    with pytest.raises(ArgumentError, match=words):
        pw.mtf(SQUARE, **given)


def test_weights_of_any_size_are_shares():
    found = pw.mtf(SQUARE, (50.0, 0.0), [0.5e-6] * 2, 0.1, weights=[1e308] * 2)
    assert found == pytest.approx(0.75, abs=ROUNDING)
