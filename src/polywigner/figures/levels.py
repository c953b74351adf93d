"""Levels in dB above a floor, their differences, and checks of datasets for figures."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from polywigner.errors import ArgumentError
from polywigner.geometry.arguments import (
    checked_array,
    checked_length,
    checked_number,
    checked_type,
    checked_vectors,
)
from polywigner.numerics import Floats
from polywigner.source.obliquities import OBLIQUITIES

if TYPE_CHECKING:
    import xarray


PEAK_RULE = "largest 3x3 median"
"""Definition of 0 dB by :func:`image_peak`, for labels and logs."""
COMPARED_DB = -30.0
"""Lowest compared level in dB relative to the peak; at nulls, levels in dB diverge."""

_MILLIWATT = 1e-3
# Lowest floor [dB]; lower levels of a field with 15 digits are rounding errors.
_LOWEST_DB = -300.0
# Largest relative deviation of a step from the mean step of an evenly spaced axis.
_EVEN = 1e-3
# Units for labels; the keys are the unit strings in files.
_PRINTED = {"W m-2": "W/m²", "W0.5 m-1": "√W/m", "1": ""}
_NAMES = {"wigner": "Wigner", "fresnel": "Fresnel", "fraunhofer": "Fraunhofer"}
_NAMES |= {name: obliquity.title for name, obliquity in OBLIQUITIES.items()}


def check_floor(floor_db: float) -> float:
    """Return a floor; raise ArgumentError unless it is at least -300 dB and below 0 dB."""
    meaning = f"a level below 0 dB and at least {_LOWEST_DB:g} dB"
    return checked_number(floor_db, "floor_db", meaning, lambda level: _LOWEST_DB <= level < 0)


def image_peak(values: ArrayLike) -> float | None:
    """Return the peak of an image, the largest median over 3 x 3 neighbouring pixels.

    The largest pixel of a Monte Carlo image is too high due to noise, and depends on the seed. A
    percentile depends on the fraction of the image that the beam fills. The median of nine
    neighbours ignores up to four outliers.

    Parameters
    ----------
    values : array_like, shape (height, width)
        Image in any unit. Medians that are not finite are ignored.

    Returns
    -------
    float or None
        The peak in the unit of ``values``; None if no median is positive.
    """
    padded = np.pad(checked_array(values, "values", 2), 1, mode="edge")
    windows = np.lib.stride_tricks.sliding_window_view(padded, (3, 3))
    medians = np.median(windows, axis=(-2, -1))
    peak = float(np.max(medians, initial=0.0, where=np.isfinite(medians)))
    return peak if peak > 0 else None


def level_db(values: ArrayLike, reference: float | None, floor_db: float) -> NDArray[np.float64]:
    """Convert powers to levels in dB relative to ``reference``, clipped at the floor.

    Zero and negative values, such as negative Wigner radiance, are converted to the floor.

    Parameters
    ----------
    values : array_like
        Powers: radiance, intensity, |F|^2, ...
    reference : float or None
        Value of 0 dB, in the unit of ``values``. If None, all levels equal the floor.
    floor_db : float
        Lowest level in dB, below 0.

    Returns
    -------
    ndarray
        Levels in dB, in the shape of ``values``.

    Raises
    ------
    ArgumentError
        If the values are not real numbers, the reference is not positive, or the floor is not below
        0 dB.
    """
    power = checked_vectors(values, "expected values to be real numbers", ())
    levels = np.full(power.shape, check_floor(floor_db))
    if reference is None:
        return levels
    zero = checked_length(reference, "reference")
    with np.errstate(over="ignore"):
        above = power > zero * 10 ** (floor_db / 10)
        levels[above] = 10 * (np.log10(power[above]) - np.log10(zero))
    return levels


def dbm(power: ArrayLike, floor: float = _LOWEST_DB) -> NDArray[np.float64]:
    """Convert powers in W to levels in dBm of at least ``floor``, by default -300 dBm.

    Negative powers and NaN are converted to the floor.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(np.fmax(10 * np.log10(np.asarray(power) / _MILLIWATT), floor))


def checked_dataset(dataset: Any) -> xarray.Dataset:
    """Return a dataset; raise ArgumentError for other types."""
    import xarray

    result: xarray.Dataset = checked_type(
        dataset, "dataset to be an xarray.Dataset", xarray.Dataset
    )
    return result


class Difference(NamedTuple):
    """Difference of a field from a reference at the compared points."""

    largest: float
    """Difference with the largest magnitude in dB; NaN if no points are compared."""
    rms: float
    """Root mean square of the differences in dB; NaN if no points are compared."""
    points: int
    """Number of compared points."""
    negative: int
    """Number of ignored points, where the field is zero or negative."""


def difference_db(values: ArrayLike, reference: ArrayLike) -> xarray.DataArray:
    """Return level differences in dB between powers and a reference, or NaN at ignored points.

    Points are ignored if the reference is more than 30 dB below its peak, or if the power is not
    positive.
    """
    import xarray

    field, true = xarray.DataArray(values), xarray.DataArray(reference)
    return 10 * np.log10(field.where(_is_compared(true) & (field > 0)) / true)


def _is_compared(reference: xarray.DataArray) -> xarray.DataArray:
    """Return a mask of the points at which the reference is not below -30 dB."""
    return (reference > 0) & (reference >= float(reference.max()) * 10 ** (COMPARED_DB / 10))


def summary(values: Any, reference: Any) -> Difference:
    """Return the difference of largest magnitude and the rms difference of two fields in dB.

    The points are the same as in :func:`difference_db`. Both fields may be lazy xarray.DataArrays.
    The squared moduli of complex values are compared.
    """
    import xarray

    field, true = (
        xarray.DataArray(abs(a) ** 2 if np.iscomplexobj(a) else a) for a in (values, reference)
    )
    difference = difference_db(field, true)
    largest = max(float(difference.min()), float(difference.max()), key=abs)
    rms = math.sqrt(float((difference**2).mean()))
    negative = int((_is_compared(true) & (field <= 0)).sum())
    return Difference(largest, rms, int(difference.notnull().sum()), negative)


def even_axis(name: str, values: Floats) -> Floats:
    """Return the values of an axis; raise ArgumentError unless they ascend in even steps."""
    step = (values[-1] - values[0]) / max(len(values) - 1, 1)
    if not (step > 0 and np.allclose(np.diff(values), step, rtol=_EVEN, atol=0.0)):
        raise ArgumentError(
            f"{name} must have at least two evenly spaced, ascending values, got {len(values)} "
            "values with other spacing"
        )
    return values


def peak_of(values: NDArray[Any], name: str) -> float:
    """Return the largest value; raise ArgumentError unless it is finite and above zero."""
    peak = float(np.max(values))
    if not (peak > 0 and math.isfinite(peak)):
        raise ArgumentError(f"{name} must have values above zero, got a maximum of {peak:g}")
    return peak


def printed_unit(array: Any) -> str:
    """Return the unit of a DataArray for labels, such as "W/m²"."""
    unit = str(array.attrs.get("units", ""))
    return _PRINTED.get(unit, unit)


def quantity_of(array: Any) -> str:
    """Return the name of the quantity in a DataArray, by default "irradiance"."""
    return str(array.attrs.get("quantity", "irradiance"))


def label_of(array: Any, name: str) -> str:
    """Return the label of a method, such as ``Wigner, obliquity Kirchhoff``, or ``name``."""
    method, obliquity = (
        str(array.attrs.get(k, d)) for k, d in (("method", name), ("obliquity", ""))
    )
    label = _NAMES.get(method, name)
    if method == "wigner" and obliquity:
        label += f", obliquity {_NAMES.get(obliquity, obliquity)}"
    return label
