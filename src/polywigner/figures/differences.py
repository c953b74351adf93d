"""How far one way to compute a field is from another: differences of levels, where they count."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from polywigner.errors import ArgumentError

__all__ = ["COMPARED_DB", "Difference", "difference_db", "summary"]

COMPARED_DB = -30.0
"""Levels that are compared, relative to the peak of the reference: in a null of one field another
is infinitely many dB away, and means nothing by it."""


class Difference(NamedTuple):
    """Between two fields where they were compared: the largest in size and the rms, in dB, over
    ``points`` points; nan without any. ``negative`` counts points left out since the field that is
    compared is zero or less there, as sums of Wigner functions may be."""

    largest: float
    rms: float
    points: int
    negative: int


def difference_db(
    values: ArrayLike, reference: ArrayLike, above_db: float = COMPARED_DB
) -> NDArray[np.float64]:
    """Levels of power-like values less those of a reference, dB; nan where they are not compared.

    Parameters
    ----------
    values, reference : of one shape and unit.
    above_db : lowest level of the reference that counts, dB below its own largest value.

    Raises
    ------
    ArgumentError for different shapes.
    """
    found, true = (np.asarray(v, dtype=np.float64) for v in (values, reference))
    if found.shape != true.shape:
        raise ArgumentError(f"expected fields at the same points, got {found.shape}, {true.shape}")
    counts = _counts(true, above_db) & (found > 0)
    difference = np.full(found.shape, np.nan)
    difference[counts] = 10 * np.log10(found[counts] / true[counts])
    return difference


def _counts(reference: NDArray[np.float64], above_db: float) -> NDArray[np.bool_]:
    peak = float(np.max(reference, initial=0.0))
    return (reference >= peak * 10 ** (above_db / 10)) & (reference > 0)


def summary(values: ArrayLike, reference: ArrayLike, above_db: float = COMPARED_DB) -> Difference:
    """The largest and the rms of :func:`difference_db`."""
    difference = difference_db(values, reference, above_db)
    known = difference[np.isfinite(difference)]
    counted = _counts(np.asarray(reference, dtype=np.float64), above_db)
    negative = int(np.count_nonzero(counted & ~(np.asarray(values) > 0)))
    if known.size == 0:
        return Difference(math.nan, math.nan, 0, negative)
    largest = float(known[np.argmax(np.abs(known))])
    return Difference(largest, float(np.sqrt(np.mean(known**2))), known.size, negative)
