"""From signed radiance to levels in dB: against a peak that noise does not set, above a floor."""

from __future__ import annotations

from numbers import Real

import numpy as np
from numpy.typing import ArrayLike, NDArray

from polywigner.errors import ArgumentError

__all__ = ["PEAK_RULE", "check_floor", "level_db", "picture_peak"]

PEAK_RULE = "largest 3x3 median"
"""How :func:`picture_peak` chooses the 0 dB level, in words for labels and logs."""

_LOWEST_DB = -300.0
"""Fifteen digits of a field and thirty of its square: what is fainter is rounding."""


def check_floor(floor_db: float) -> float:
    """The floor itself, once it is known to be a level below the peak.

    Raises
    ------
    ArgumentError : not a number below 0 dB and down to -300 dB.
    """
    number = isinstance(floor_db, Real) and not isinstance(floor_db, bool)
    if not number or not _LOWEST_DB <= floor_db < 0:
        raise ArgumentError(
            f"expected a floor below 0 dB, down to {_LOWEST_DB:g} dB, got {floor_db}; give for "
            "example --db-floor -40"
        )
    return float(floor_db)


def picture_peak(values: ArrayLike) -> float | None:
    """The peak of a picture, as the largest median over 3 x 3 neighbouring pixels.

    The largest pixel of a Monte Carlo picture is its noisiest: it would set the 0 dB level too
    high and differ from seed to seed. A percentile would depend on how much of the picture the
    beam fills. The median of nine neighbours ignores up to four outliers and follows the beam.

    Parameters
    ----------
    values : (height, width), any unit; non-finite pixels are left out of the medians' choice.

    Returns
    -------
    The peak in the unit of ``values``, or None where no median is positive.
    """
    picture = np.asarray(values, dtype=np.float64)
    padded = np.pad(picture, 1, mode="edge")
    windows = np.lib.stride_tricks.sliding_window_view(padded, (3, 3))
    medians = np.median(windows, axis=(-2, -1))
    peak = float(np.max(medians, initial=0.0, where=np.isfinite(medians)))
    return peak if peak > 0 else None


def level_db(values: ArrayLike, reference: float | None, floor_db: float) -> NDArray[np.float64]:
    """Levels of power-like values in dB relative to ``reference``, never below the floor.

    Values at or below the floor, zero and negative ones among them (the Wigner radiance is
    negative in places), get the floor: no logarithm is ever taken of them.

    Parameters
    ----------
    values : any shape; radiance, intensity, |F|^2, ...
    reference : the 0 dB value, in the unit of ``values``; None puts everything on the floor.
    floor_db : lowest level, dB, below 0.

    Returns
    -------
    Levels in dB, the shape of ``values``.
    """
    power = np.asarray(values, dtype=np.float64)
    levels = np.full(power.shape, check_floor(floor_db))
    if reference is None:
        return levels
    above = power > reference * 10 ** (floor_db / 10)
    levels[above] = 10 * np.log10(power[above] / reference)
    return levels
