"""Strings of quantities are parsed to one float, or raise an error if they are ambiguous."""

import math
from decimal import Decimal

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from polywigner.errors import PolywignerError, QuantityError
from polywigner.quantities import (
    SPEED_OF_LIGHT,
    parse_angle,
    parse_coordinate,
    parse_decibels,
    parse_frequency,
    parse_length,
    parse_point,
    parse_power,
    parse_unit,
    wavelength_of,
)

GOOD = [
    (parse_length, "10 mm", 0.01),
    (parse_coordinate, "-2.5 mm", -0.0025),
    (parse_length, "10mm", 0.01),
    (parse_length, "  10\u00a0mm ", 0.01),
    (parse_length, "5 μm", 5e-6),
    (parse_length, "1 mil", 2.54e-5),
    (parse_length, 0.003, 0.003),
    (parse_length, np.float32(0.5), 0.5),
    (parse_frequency, "94ghz", 94e9),
    (parse_frequency, "0.094 THZ", 94e9),
    (parse_angle, "180 deg", math.pi),
    (parse_angle, "-90°", -math.pi / 2),
    (parse_power, "10 mW", 0.01),
    (parse_power, "10 MW", 1e7),
    (parse_power, "10 dBm", 0.01),
    (parse_power, "0 dBW", 1.0),
    (parse_decibels, "-3.5dB", -3.5),
    (parse_unit, "0.1 mm", 1e-4),
    (parse_unit, 0.001, 0.001),
    (parse_point, "0 mm, -2 mm", (0.0, -0.002)),
]


@pytest.mark.parametrize(("parse", "text", "value"), GOOD)
def test_a_text_is_the_float_nearest_to_what_it_says(parse, text, value):
    assert parse(text) == value


@given(st.decimals(Decimal("1e-6"), 10**6, allow_nan=False, places=9))
def test_units_add_no_rounding_error(number):
    assert parse_length(f"{number} mm") == float(f"{number}e-3")
    assert parse_length(f"{number} nm") == float(f"{number}e-9")
    assert parse_frequency(f"{number} GHz") == float(f"{number}e9")


BAD = [
    (parse_length, "5 Mm"),  # megametres, not millimetres
    (parse_length, "5 NM"),  # nautical miles, not nanometres
    (parse_length, "10,5 mm"),
    (parse_length, "1 000 mm"),
    (parse_length, ""),
    (parse_length, "10 GHz"),
    (parse_length, "0 mm"),
    (parse_length, "nan"),
    (parse_length, float("nan")),
    (parse_length, "1e999 m"),
    (parse_length, True),
    (parse_length, None),
    (parse_frequency, "5 mHz"),  # millihertz or megahertz
    (parse_frequency, -94e9),
    (parse_power, "10 Mw"),
    (parse_unit, "furlong"),
    (parse_point, "1 mm, 2 mm, 3 mm"),
]


@pytest.mark.parametrize(("parse", "text"), BAD, ids=range(len(BAD)))
def test_what_is_not_clearly_a_quantity_raises_one_short_error(parse, text):
    with pytest.raises(QuantityError, match=r"expected .*, got ") as raised:
        parse(text)
    assert isinstance(raised.value, PolywignerError)
    assert len(str(raised.value)) < 400


def test_an_unknown_unit_lists_the_known_ones():
    with pytest.raises(QuantityError, match="Hz, kHz, MHz, GHz, THz"):
        parse_frequency("94 gigahertz")


def test_frequency_times_wavelength_is_the_speed_of_light():
    assert wavelength_of(94e9) * 94e9 == pytest.approx(SPEED_OF_LIGHT, rel=1e-15)
