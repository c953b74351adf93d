"""``frequency=`` in place of a wavelength."""

import inspect
from typing import Any

import numpy as np
import pytest

import polywigner as pw
from polywigner.errors import ArgumentError, PolywignerWarning

SQUARE = pw.shapes.square(10e-3)
FREQUENCY = 94e9
WAVELENGTH = pw.SPEED_OF_LIGHT / FREQUENCY
NORMAL, POINT = (0.0, 0.0, 1.0), (0.0, 1e-3, 0.1)

CALLS: dict[str, tuple[Any, tuple[Any, ...], tuple[Any, ...]]] = {
    "radiance": (pw.radiance, (SQUARE, (0, 0), NORMAL), ()),
    "radiant_intensity": (pw.radiant_intensity, (SQUARE, NORMAL), ()),
    "flux_vector": (pw.flux_vector, (SQUARE, (0, 0)), ()),
    "power": (pw.power, (SQUARE,), ()),
    "radiated_power": (pw.radiated_power, (SQUARE,), ()),
    "amplitude": (pw.amplitude, (SQUARE, POINT), ()),
    "irradiance": (pw.irradiance, (SQUARE, POINT), ()),
    "field": (pw.field, (SQUARE, POINT), ("x",)),
    "steering_weights": (pw.arrays.steering_weights, ([(0, 0), (1e-3, 0)], NORMAL), ()),
    "focusing_weights": (pw.arrays.focusing_weights, ([(0, 0), (1e-3, 0)], POINT), ()),
}


@pytest.mark.parametrize("name", CALLS)
def test_a_frequency_gives_what_its_wavelength_gives(name):
    function, before, after = CALLS[name]
    expected = function(*before, WAVELENGTH, *after)
    np.testing.assert_array_equal(function(*before, *after, frequency=FREQUENCY), expected)
    assert "frequency" in inspect.signature(function).parameters


def test_arguments_after_the_wavelength_keep_their_order():
    with_frequency = pw.radiation_pattern(SQUARE, [0.0, 0.1], 0.3, frequency=FREQUENCY)
    expected = pw.radiation_pattern(SQUARE, WAVELENGTH, [0.0, 0.1], 0.3)
    np.testing.assert_array_equal(with_frequency["field"].values, expected["field"].values)


@pytest.mark.parametrize(
    "made",
    [
        lambda: pw.power(SQUARE, WAVELENGTH, frequency=FREQUENCY),
        lambda: pw.radiation_pattern(SQUARE, WAVELENGTH, 0.0, 0.0, frequency=FREQUENCY),
        lambda: pw.power(SQUARE, frequency=94),
        lambda: pw.power(SQUARE, frequency="94 GHz"),
        lambda: pw.power(SQUARE, frequency=float("nan")),
    ],
)
def test_both_and_what_is_no_frequency_are_refused(made):
    with pytest.raises(ArgumentError, match="frequency"):
        made()


def test_a_wavelength_like_a_frequency_is_asked_about():
    with pytest.warns(PolywignerWarning, match=r"a frequency in Hz; pass it as frequency=9.4e\+10"):
        pw.power(SQUARE, FREQUENCY)
