"""Values as the page shows them: levels in dB, real parts, phases, with scales and labels."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from polywigner.explorer.state import UNITS, Part, Unit
from polywigner.explorer.views import Picture
from polywigner.figures.levels import level_db

Scale = Literal["level", "signed", "phase", "unit", "difference"]

FLOOR_DB = -40.0
"""Lowest level of pictures in dB."""
_MOST_DB = 3.0  # of differences, as in the figures of planes

_TITLES = {
    "F": "F(ν)", "W": "W(x, ν)", "OTF": "OTF(ξ)", "rays": "Wigner rays",
    "exact": "Kirchhoff, exact", "difference": "rays minus exact",
}  # fmt: skip


_LENGTHS = {"m²": 2, "W/m²": -2}  # powers of length that units of pictures have
_RAISED = str.maketrans("0123456789-", "⁰¹²³⁴⁵⁶⁷⁸⁹⁻")


def in_unit(quantity: str, unit: Unit) -> tuple[float, str]:
    """Factor and name of a unit such as "m²" or "W/m²" in the page's unit of length."""
    return float(UNITS[unit]) ** _LENGTHS.get(quantity, 0), quantity.replace("m²", f"{unit}²")


def power_of_ten(value: float) -> int:
    """The exponent, a multiple of 3, that is taken out of values up to this one, or 0."""
    size = abs(value)
    if size == 0 or 1e-2 <= size < 1e4:
        return 0
    return 3 * math.floor(math.log10(size) / 3)


def written(exponent: int) -> str:
    """A power of ten as text: 10⁻⁶."""
    return "10" + str(exponent).translate(_RAISED)


def _number(value: float) -> str:
    """Three digits or, of thousands, four; and the power of ten if there is one."""
    if 1e3 <= abs(value) < 1e5:
        return f"{float(f'{value:.4g}'):.0f}"
    exponent = power_of_ten(value)
    if exponent == 0:
        return f"{value:.3g}"
    return f"{value / 10.0**exponent:.3g} · {written(exponent)}"


@dataclass(frozen=True, eq=False)
class Shown:
    """Values as they are coloured, and the labels of their colour bar."""

    values: NDArray[np.float64]
    low: float
    high: float
    scale: Scale
    title: str
    bar: str
    peak: float = 1.0
    """The divisor of "signed" values."""


def shown(picture: Picture, key: str, part: Part = "level", unit: Unit = "m") -> Shown:
    """One array of a picture, its peak named in this unit of length.

    F is shown as its level (dB of |F|^2 relative to the peak shown), real part or phase; W as it
    is, the OTF by its modulus, irradiances in dB relative to the exact field's peak, differences
    in dB. Real values are divided by their peak, which the colour bar names.
    """
    values, title = picture.arrays[key], _TITLES[key]
    factor, named = in_unit(picture.unit, unit)
    if key in ("rays", "exact"):
        peak = float(np.max(picture.arrays["exact"]))
        return _levels(values, peak, title, f"dB relative to {_number(peak * factor)} {named}")
    if key == "difference":
        return Shown(values, -_MOST_DB, _MOST_DB, "difference", title, "dB")
    if key == "OTF":
        return Shown(np.abs(values), 0.0, 1.0, "unit", "|OTF(ξ)|", "modulus")
    if key == "F" and part == "level":
        bar = f"dB relative to {_number(picture.peak * factor**2)} {unit}⁴"
        return _levels(np.abs(values) ** 2, picture.peak, "|F(ν)|²", bar)
    if key == "F" and part == "phase":
        return Shown(np.degrees(np.angle(values)), -180, 180, "phase", "phase of F(ν)", "degrees")
    if key == "W":
        title = f"{title} over {'x' if picture.name == 'wigner_x' else 'ν'}"
    title = f"Re {title}" if key == "F" else title
    peak = float(np.max(np.abs(values.real)))
    ratio = values.real / peak if peak > 0 else values.real
    bar = f"relative to {_number(peak * factor)} {named}"
    return Shown(ratio, -1.0, 1.0, "signed", title, bar, peak)


def _levels(power: NDArray[Any], peak: float, title: str, bar: str) -> Shown:
    levels = level_db(power, peak if peak > 0 else None, FLOOR_DB)
    return Shown(levels, FLOOR_DB, 0.0, "level", title, bar)
