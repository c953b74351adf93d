"""Text such as ``"94 GHz"``, ``"10 mm"`` or ``"30 deg"`` to SI floats.

Used where people write text: the command line, scene files and aperture files. Functions of the
Python API take SI floats.
"""

from __future__ import annotations

import math
import re

from polywigner.errors import QuantityError

__all__ = [
    "SPEED_OF_LIGHT",
    "parse_angle",
    "parse_frequency",
    "parse_length",
    "parse_point",
    "parse_power",
    "wavelength_of",
]

SPEED_OF_LIGHT = 299_792_458.0
"""Speed of light in vacuum, m/s (exact, SI)."""

_LENGTHS = {
    "km": 1e3, "m": 1.0, "dm": 1e-1, "cm": 1e-2, "mm": 1e-3, "um": 1e-6, "µm": 1e-6, "μm": 1e-6,
    "nm": 1e-9, "in": 0.0254, "inch": 0.0254, "mil": 2.54e-5, "ft": 0.3048,
}  # fmt: skip
_FREQUENCIES = {"hz": 1.0, "khz": 1e3, "mhz": 1e6, "ghz": 1e9, "thz": 1e12}
_ANGLES = {"deg": math.pi / 180, "°": math.pi / 180, "rad": 1.0, "mrad": 1e-3}
_POWERS = {"w": 1.0, "mw": 1e-3, "uw": 1e-6, "µw": 1e-6, "kw": 1e3}

_QUANTITY = re.compile(r"\s*([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)\s*([^\d\s.+-]*)\s*")


def _parse(text: str | float, units: dict[str, float], kind: str, example: str) -> float:
    if isinstance(text, (int, float)) and not isinstance(text, bool):
        value = float(text)
    else:
        match = _QUANTITY.fullmatch(str(text))
        if match is None:
            raise QuantityError(f'expected a {kind} such as "{example}", got {text!r}')
        number, unit = match.groups()
        factor = 1.0 if not unit else units.get(unit, units.get(unit.lower()))
        if factor is None:
            known = ", ".join(units)
            raise QuantityError(
                f'expected a {kind} such as "{example}", got {text!r}; use one of the units {known}'
            )
        value = float(number) * factor
    if not math.isfinite(value):
        raise QuantityError(f'expected a finite {kind} such as "{example}", got {text!r}')
    return value


def _positive(value: float, text: str | float, kind: str, example: str) -> float:
    if not value > 0:
        raise QuantityError(f'expected a {kind} above zero such as "{example}", got {text!r}')
    return value


def parse_length(text: str | float) -> float:
    """A length in metres, above zero; a bare number is in metres."""
    example = "10 mm"
    return _positive(_parse(text, _LENGTHS, "length", example), text, "length", example)


def parse_point(text: str) -> tuple[float, float]:
    """Two coordinates in metres, of either sign, such as ``"0 mm, -2 mm"``."""
    parts = text.split(",")
    if len(parts) != 2:
        raise QuantityError(f'expected two lengths such as "0 mm, -2 mm", got {text!r}')
    first, second = (_parse(part, _LENGTHS, "length", "-2 mm") for part in parts)
    return first, second


def parse_frequency(text: str | float) -> float:
    """A frequency in hertz, above zero; a bare number is in hertz."""
    example = "94 GHz"
    return _positive(_parse(text, _FREQUENCIES, "frequency", example), text, "frequency", example)


def parse_angle(text: str | float) -> float:
    """An angle in radians; a bare number is in radians."""
    return _parse(text, _ANGLES, "angle", "30 deg")


def parse_power(text: str | float) -> float:
    """A power in watts, above zero; a bare number is in watts."""
    example = "10 mW"
    # "mW" and "MW" differ by nine orders of magnitude: megawatts are not offered.
    return _positive(_parse(text, _POWERS, "power", example), text, "power", example)


def wavelength_of(frequency: float) -> float:
    """Vacuum wavelength in metres of a frequency in hertz."""
    return SPEED_OF_LIGHT / frequency
