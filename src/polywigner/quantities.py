"""Conversion of strings such as ``"94 GHz"``, ``"10 mm"`` or ``"30 deg"`` to floats in SI units.

The command line, scene files and aperture files use such strings. Functions of the Python API take
floats in SI units. Units are case-sensitive: "mW" and "MW", or "mm" and "Mm", differ by nine orders
of magnitude. Only units of frequency may have any case ("ghz"), except "mHz".
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from fractions import Fraction
from typing import NamedTuple

from polywigner.errors import QuantityError, value_text

SPEED_OF_LIGHT = 299_792_458.0
"""Speed of light in vacuum, m/s (exact, SI)."""

# Sizes of units are exact fractions, because 3.1 * 0.001 is not the float nearest to 0.0031.
_LENGTHS = {
    "km": Fraction(1000), "m": Fraction(1), "dm": Fraction(1, 10), "cm": Fraction(1, 100),
    "mm": Fraction(1, 1000), "um": Fraction(1, 10**6), "µm": Fraction(1, 10**6),
    "μm": Fraction(1, 10**6), "nm": Fraction(1, 10**9), "in": Fraction(254, 10**4),
    "inch": Fraction(254, 10**4), "mil": Fraction(254, 10**7), "ft": Fraction(3048, 10**4),
}  # fmt: skip
_FREQUENCIES = {
    "Hz": Fraction(1), "kHz": Fraction(10**3), "MHz": Fraction(10**6), "GHz": Fraction(10**9),
    "THz": Fraction(10**12),
}  # fmt: skip
_SPELLING = {unit.lower(): unit for unit in _FREQUENCIES}
_DEGREE = Fraction(math.pi) / 180
_ANGLES = {"deg": _DEGREE, "°": _DEGREE, "rad": Fraction(1), "mrad": Fraction(1, 1000)}
_DECIBELS = {"dB": Fraction(1)}
_TEMPERATURES = {"K": Fraction(1), "mK": Fraction(1, 1000)}
_POWERS = {
    "W": Fraction(1), "mW": Fraction(1, 10**3), "uW": Fraction(1, 10**6),
    "µW": Fraction(1, 10**6), "μW": Fraction(1, 10**6), "kW": Fraction(10**3),
    "MW": Fraction(10**6),
}  # fmt: skip

_DURATIONS = {
    "s": Fraction(1), "ms": Fraction(1, 10**3), "us": Fraction(1, 10**6), "µs": Fraction(1, 10**6),
    "μs": Fraction(1, 10**6), "ns": Fraction(1, 10**9),
}  # fmt: skip

_POWER_LEVELS = {"dBm": 1e-3, "dBW": 1.0}

# The exponent has at most three digits, because Fraction("1e999999999") would exhaust the memory.
_QUANTITY = re.compile(
    r"\s*([+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]{1,3})?)\s*([^0-9\s.,;+-]*)\s*"
)


def _parse(
    text: str | float,
    units: Mapping[str, Fraction],
    kind: str,
    example: str,
    positive: bool = False,
) -> float:
    """Convert a string such as "10 mm" to SI units; numbers are already in SI units.

    Raises QuantityError for other values. If ``positive`` is true, zero and negative values are
    errors, too. ``units``: size of each unit in SI units. ``kind`` and ``example`` describe the
    quantity in error messages.
    """
    article = "an" if kind[0] in "aeio" else "a"
    expected = f'expected {article} {kind} such as "{example}", got {value_text(text)}'
    match = _QUANTITY.fullmatch(str(text))
    if match is None or isinstance(text, bool):
        raise QuantityError(f"{expected}; write a finite number, a space and a unit")
    number, unit = match.groups()
    if unit and unit not in units:
        more = list(_POWER_LEVELS) if units is _POWERS else []
        raise QuantityError(f"{expected}; use one of the units {', '.join([*units, *more])}")
    try:
        value = float(Fraction(number) * (units[unit] if unit else 1))
    except OverflowError:
        raise QuantityError(f"{expected}; the quantity must be finite") from None
    if positive and not value > 0:
        raise QuantityError(f"{expected}; the quantity must be above zero")
    return value


def parse_length(text: str | float) -> float:
    """Parse a length above zero to metres; a plain number is in metres.

    Raises QuantityError for other values.
    """
    return _parse(text, _LENGTHS, "length", "10 mm", positive=True)


def parse_coordinate(text: str | float) -> float:
    """Parse a length of either sign to metres; a plain number is in metres.

    Raises QuantityError for other values.
    """
    return _parse(text, _LENGTHS, "length", "-2 mm")


def parse_point(text: str) -> tuple[float, float]:
    """Parse two coordinates of either sign, such as ``"0 mm, -2 mm"``, to metres.

    Plain numbers are in metres. Raises QuantityError for other text.
    """
    parts = text.split(",", 2)
    if len(parts) != 2:
        raise QuantityError(
            f'expected two lengths such as "0 mm, -2 mm", got {value_text(text)}; separate '
            "them with one comma"
        )
    first, second = map(parse_coordinate, parts)
    return first, second


def parse_unit(text: str | float) -> float:
    """Parse the unit of a file, such as "mm" or "0.1 mm", to metres.

    A plain number is in metres. Raises QuantityError for other values.
    """
    if isinstance(text, str) and text.strip() in _LENGTHS:
        return float(_LENGTHS[text.strip()])
    return _parse(text, _LENGTHS, "unit of length", 'mm" or "0.1 mm', positive=True)


def parse_frequency(text: str | float) -> float:
    """Parse a frequency above zero to hertz; a plain number is in hertz.

    Raises QuantityError for other values, and for "mHz".
    """
    if isinstance(text, str):
        if text.rstrip().endswith("mHz"):
            raise QuantityError(
                f'expected a frequency such as "94 GHz", got {value_text(text)}, in which '
                '"mHz" means millihertz; write "MHz" for megahertz'
            )
        text = re.sub("[a-zA-Z]{2,}", lambda unit: _SPELLING.get(unit[0].lower(), unit[0]), text)
    return _parse(text, _FREQUENCIES, "frequency", "94 GHz", positive=True)


def parse_duration(text: str | float) -> float:
    """Parse a time above zero to seconds; a plain number is in seconds.

    Raises QuantityError for other values.
    """
    return _parse(text, _DURATIONS, "time", "60 us", positive=True)


def parse_angle(text: str | float) -> float:
    """Parse an angle to radians; a plain number is in radians.

    Raises QuantityError for other values.
    """
    return _parse(text, _ANGLES, "angle", "30 deg")


def parse_decibels(text: str | float) -> float:
    """Parse a level to decibels; a plain number is in decibels.

    Raises QuantityError for other values.
    """
    return _parse(text, _DECIBELS, "level", "25 dB")


def parse_noise_figure(text: str | float) -> float:
    """Parse a noise figure of at least zero to decibels; a plain number is in decibels.

    Raises QuantityError for other values.
    """
    level = _parse(text, _DECIBELS, "noise figure", "3 dB")
    if level < 0:
        raise QuantityError(f"expected a noise figure of 0 dB or more, got {value_text(text)}")
    return level


def parse_temperature(text: str | float) -> float:
    """Parse a temperature above zero to kelvins; a plain number is in kelvins.

    Raises QuantityError for other values.
    """
    return _parse(text, _TEMPERATURES, "temperature", "290 K", positive=True)


NOISE_PARSERS = {
    "bandwidth": parse_frequency,
    "temperature": parse_temperature,
    "noise_figure": parse_noise_figure,
}
"""Functions that parse the noise parameters of receivers, by the name of the parameter."""


def parse_noise(
    bandwidth: str | float | None,
    temperature: str | float | None,
    noise_figure: str | float | None,
) -> dict[str, float | None]:
    """Parse bandwidth, temperature and noise figure to Hz, K and dB; None remains None.

    Returns a dictionary with the keys of :data:`NOISE_PARSERS`.
    """
    values = zip(NOISE_PARSERS.items(), (bandwidth, temperature, noise_figure), strict=True)
    return {name: None if value is None else parse(value) for (name, parse), value in values}


def parse_power(text: str | float) -> float:
    """Parse a power above zero, or a level in dBm or dBW, to watts; a plain number is in watts.

    Raises QuantityError for other values.
    """
    for unit, reference in _POWER_LEVELS.items():
        if isinstance(text, str) and text.rstrip().endswith(unit):
            level = _parse(text, {unit: Fraction(1)}, "power", "10 dBm")
            return reference * float(10 ** (level / 10))
    return _parse(text, _POWERS, "power", "10 mW", positive=True)


def wavelength_of(frequency: float) -> float:
    """Return the vacuum wavelength in metres for a frequency above zero in hertz."""
    return SPEED_OF_LIGHT / frequency


def parse_wavelength(frequency: str | float | None, wavelength: str | float | None) -> float | None:
    """Return the wavelength in metres for a frequency or a wavelength; None if both are None.

    Raises QuantityError if both are specified, and for invalid quantities.
    """
    if frequency is not None and wavelength is not None:
        raise QuantityError(
            "expected either a frequency or a wavelength, got both; omit one of them"
        )
    if frequency is not None:
        return wavelength_of(parse_frequency(frequency))
    return None if wavelength is None else parse_length(wavelength)


class LengthUnit(NamedTuple):
    """A unit of length for printed numbers: its name and its size in metres."""

    name: str
    metres: float


_UNITS = (LengthUnit("nm", 1e-9), LengthUnit("µm", 1e-6), LengthUnit("mm", 1e-3))


def length_unit(length: float) -> LengthUnit:
    """Return the unit for a length in m: nm, µm or mm if the value is below 1000, otherwise m."""
    for unit in _UNITS:
        if length < 1000 * unit.metres:
            return unit
    return LengthUnit("m", 1.0)


def length_text(*lengths: float) -> str:
    """Return lengths in m as text such as ``20 x 12 mm``; the largest length selects the unit."""
    unit = length_unit(max(lengths))
    return f"{' x '.join(f'{length / unit.metres:.4g}' for length in lengths)} {unit.name}"
