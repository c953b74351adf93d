"""From values to what is looked at: levels in dB, real parts, phases, with scales and labels."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from polywigner.explorer.choices import Part
from polywigner.explorer.views import Picture
from polywigner.figures.levels import level_db

__all__ = ["FLOOR_DB", "Shown", "shown"]

Scale = Literal["level", "signed", "phase", "unit", "difference"]

FLOOR_DB = -40.0
"""Lowest level of pictures in dB."""
_MOST_DB = 3.0  # of differences, as in the figures of planes

_TITLES = {
    "F": "F(ν)", "W": "W(x, ν)", "OTF": "OTF(ξ)", "rays": "Wigner rays",
    "exact": "Kirchhoff, exact", "difference": "rays minus exact",
}  # fmt: skip


@dataclass(frozen=True, eq=False)
class Shown:
    """Values as they are coloured, and what their colour bar says."""

    values: NDArray[np.float64]
    low: float
    high: float
    scale: Scale
    title: str
    bar: str
    peak: float = 1.0
    """The divisor of "signed" values."""


def shown(picture: Picture, key: str, part: Part = "level") -> Shown:
    """One array of a picture.

    F is shown as its level (dB of |F|^2 relative to the peak shown), real part or phase; W as it
    is, the OTF by its modulus, irradiances in dB relative to the exact field's peak, differences
    in dB. Real values are divided by their peak, which the colour bar names.
    """
    values, title = picture.arrays[key], _TITLES[key]
    if key in ("rays", "exact"):
        peak = float(np.max(picture.arrays["exact"]))
        return _levels(values, peak, title, f"dB relative to {peak:.3g} {picture.unit}")
    if key == "difference":
        return Shown(values, -_MOST_DB, _MOST_DB, "difference", title, "dB")
    if key == "OTF":
        return Shown(np.abs(values), 0.0, 1.0, "unit", "|OTF(ξ)|", "modulus")
    if key == "F" and part == "level":
        power = np.abs(values) ** 2
        peak = float(power.max())
        return _levels(power, peak, "|F(ν)|²", f"dB relative to {peak:.3g} m⁴")
    if key == "F" and part == "phase":
        return Shown(np.degrees(np.angle(values)), -180, 180, "phase", "phase of F(ν)", "degrees")
    if key == "W":
        title = f"{title} over {'x' if picture.name == 'wigner_x' else 'ν'}"
    return _signed(values.real, f"Re {title}" if key == "F" else title, picture.unit)


def _levels(power: NDArray[Any], peak: float, title: str, bar: str) -> Shown:
    levels = level_db(power, peak if peak > 0 else None, FLOOR_DB)
    return Shown(levels, FLOOR_DB, 0.0, "level", title, bar)


def _signed(values: NDArray[np.float64], title: str, unit: str) -> Shown:
    peak = float(np.max(np.abs(values)))
    ratio = values / peak if peak > 0 else values
    bar = f"relative to {peak:.3g} {unit}"
    return Shown(ratio, -1.0, 1.0, "signed", title, bar, peak)
