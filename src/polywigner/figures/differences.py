"""How far one way to compute a field is from another: differences of levels, where they count."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

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
    values: ArrayLike,
    reference: ArrayLike,
    above_db: float = COMPARED_DB,
    peak: float | None = None,
) -> NDArray[np.float64]:
    """Levels of power-like values less those of a reference, dB; nan where they are not compared.

    Parameters
    ----------
    values, reference : of one shape and unit.
    above_db : lowest level of the reference that counts, dB below its own largest value.
    peak : that value; None: the largest that is given.

    Raises
    ------
    ArgumentError for different shapes.
    """
    found, true = (np.asarray(v, dtype=np.float64) for v in (values, reference))
    if found.shape != true.shape:
        raise ArgumentError(f"expected fields at the same points, got {found.shape}, {true.shape}")
    counts = _counts(true, above_db, _largest(true) if peak is None else peak) & (found > 0)
    difference = np.full(found.shape, np.nan)
    difference[counts] = 10 * np.log10(found[counts] / true[counts])
    return difference


def _largest(values: NDArray[np.float64]) -> float:
    return float(np.max(values, initial=0.0))


def _counts(reference: NDArray[np.float64], above_db: float, peak: float) -> NDArray[np.bool_]:
    return (reference >= peak * 10 ** (above_db / 10)) & (reference > 0)


def summary(values: Any, reference: Any, above_db: float = COMPARED_DB) -> Difference:
    """The largest and the rms of :func:`difference_db`.

    Parameters
    ----------
    values, reference : arrays, NumPy's or xarray's, of one shape and unit, complex ones to be
        squared. Arrays that are read when asked, in chunks, are read in slabs along the first axis,
        a chunk thick.
    above_db : as for :func:`difference_db`.
    """
    chunks = getattr(reference, "chunks", None)
    step = max(1, chunks[0][0] if chunks else len(reference))
    slabs = [slice(k, k + step) for k in range(0, len(reference), step)]
    peak = max((_largest(_power(reference[slab])) for slab in slabs), default=0.0)
    largest, squares, points, negative = 0.0, 0.0, 0, 0
    for slab in slabs:
        found, true = _power(values[slab]), _power(reference[slab])
        difference = difference_db(found, true, above_db, peak)
        known = difference[np.isfinite(difference)]
        counted = _counts(true, above_db, peak)
        negative += int(np.count_nonzero(counted & ~(found > 0)))
        points += known.size
        squares += float(np.sum(known**2))
        if known.size:
            largest = max(largest, float(known.min()), float(known.max()), key=abs)
    if points == 0:
        return Difference(math.nan, math.nan, 0, negative)
    return Difference(largest, math.sqrt(squares / points), points, negative)


def _power(values: Any) -> NDArray[np.float64]:
    array = np.asarray(values)
    return np.abs(array) ** 2 if np.iscomplexobj(array) else array.astype(np.float64)
