"""Levels in dB above a floor, their differences, and the labelled arrays that figures read."""

from __future__ import annotations

import math
from collections.abc import Mapping
from numbers import Real
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from polywigner.errors import ArgumentError
from polywigner.geometry.arguments import checked_array, checked_length, real_numbers
from polywigner.source.obliquities import OBLIQUITIES

Floats = NDArray[np.float64]

PEAK_RULE = "largest 3x3 median"
"""Rule by which :func:`picture_peak` chooses 0 dB, in words for labels and logs."""

_LOWEST_DB = -300.0
"""Fifteen digits of a field and thirty of its square: fainter values are rounding."""


def check_floor(floor_db: float) -> float:
    """The floor itself, once it is known to be a level below the peak."""
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
    picture = checked_array(values, "values", 2)
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
    try:
        power = real_numbers(values)
    except ValueError as error:
        raise ArgumentError(f"expected values as real numbers, got {error}") from None
    levels = np.full(power.shape, check_floor(floor_db))
    if reference is None:
        return levels
    zero = checked_length(reference, "reference")
    with np.errstate(over="ignore"):
        above = power > zero * 10 ** (floor_db / 10)
        levels[above] = 10 * (np.log10(power[above]) - np.log10(zero))
    return levels


def checked_dataset(found: Any, name: str) -> Any:
    """An xarray.Dataset, or ArgumentError."""
    import xarray

    if not isinstance(found, xarray.Dataset):
        raise ArgumentError(f"expected {name} as an xarray.Dataset, got {type(found).__name__}")
    return found


def arrays_of(found: Any, axes: Mapping[str, str], maker: str) -> list[NDArray[Any]]:
    """Arrays of a dataset of the function ``maker``, over axes in order; "": as they are.

    Raises ArgumentError without one of the arrays, and for other axes.
    """
    try:
        return [
            np.asarray((found[name].transpose(*own.split()) if own else found[name]).values)
            for name, own in axes.items()
        ]
    except (TypeError, KeyError, IndexError, AttributeError, ValueError):
        raise ArgumentError(f"expected what {maker} returns, got {type(found).__name__}") from None


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
    """Differences of levels to a reference in dB; nan where they are not compared."""
    found, true = (np.asarray(v, dtype=np.float64) for v in (values, reference))
    if found.shape != true.shape:
        raise ArgumentError(f"expected fields at the same points, got {found.shape}, {true.shape}")
    counts = _counts(true, above_db, float(true.max(initial=0.0))) & (found > 0)
    difference = np.full(found.shape, np.nan)
    difference[counts] = 10 * np.log10(found[counts] / true[counts])
    return difference


def _counts(reference: Any, above_db: float, peak: float) -> Any:
    return (reference >= peak * 10 ** (above_db / 10)) & (reference > 0)


def summary(values: Any, reference: Any, above_db: float = COMPARED_DB) -> Difference:
    """Return the largest and the rms difference of two fields in dB; lazy ones are read by chunks.

    ``values`` and ``reference`` are arrays or xarray.DataArrays; complex values are squared.
    """
    import xarray

    arrays = (xarray.DataArray(each) for each in (values, reference))
    found, true = (abs(each) ** 2 if np.iscomplexobj(each) else each for each in arrays)
    compared = _counts(true, above_db, float(true.max()))
    positive = compared & (found > 0)
    points = int(positive.sum())
    negative = int(compared.sum()) - points
    if points == 0:
        return Difference(math.nan, math.nan, 0, negative)
    difference = 10 * np.log10(found.where(positive) / true.where(positive))
    largest = max(float(difference.min()), float(difference.max()), key=abs)
    return Difference(largest, math.sqrt(float((difference**2).mean())), points, negative)


_EVEN = 1e-3
"""By how much of a step places may differ from even ones: single precision leaves 1e-5 on a hundred
wavelengths of a thousand samples, and a tenth of a pixel is not seen."""


def even_axis(name: str, places: Floats) -> Floats:
    """Return the points of an axis; ArgumentError unless two or more rise in even steps."""
    step = (places[-1] - places[0]) / max(len(places) - 1, 1)
    if not (step > 0 and np.allclose(np.diff(places), step, rtol=_EVEN, atol=0.0)):
        raise ArgumentError(
            f"expected two or more evenly spaced values of {name}, rising, got {len(places)} others"
        )
    return places


def peak_of(values: NDArray[Any], name: str) -> float:
    """The largest of real values; ArgumentError if that is not above zero."""
    peak = float(np.max(values))
    if not (peak > 0 and math.isfinite(peak)):
        raise ArgumentError(f"expected some {name} above zero, got {peak:g} at most")
    return peak


# Units as printed; files write W m-2.
_PRINTED = {"W m-2": "W/m²", "W0.5 m-1": "√W/m", "1": ""}


def printed_unit(array: Any) -> str:
    """The unit of a labelled array, as it is printed."""
    unit = str(array.attrs.get("units", ""))
    return _PRINTED.get(unit, unit)


def quantity_of(array: Any) -> str:
    """The quantity of a variable: "irradiance" unless its attributes say something else."""
    return str(array.attrs.get("quantity", "irradiance"))


def label_of(array: Any, name: str) -> str:
    """Name of a method in a figure: ``Wigner, obliquity Kirchhoff``."""
    about = array.attrs
    method = str(about.get("method", name))
    label = _CALLED.get(method, name)
    if method == "wigner":
        obliquity = str(about.get("obliquity", ""))
        label += f", obliquity {_CALLED.get(obliquity, obliquity)}" if obliquity else ""
    return label


_CALLED = {"wigner": "Wigner", "fresnel": "Fresnel", "fraunhofer": "Fraunhofer"}
_CALLED |= {name: each.title for name, each in OBLIQUITIES.items()}
