"""Samples of a field on evenly spaced axes, as figures need them, from labelled arrays."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polywigner.errors import ArgumentError

__all__ = [
    "Samples",
    "chosen_method",
    "even_axis",
    "field_samples",
    "methods_of",
    "peak_of",
    "printed_unit",
]

Floats = NDArray[np.float64]

_EVEN = 1e-3
"""By how much of a step places may differ from even ones: single precision leaves 1e-5 on a hundred
wavelengths of a thousand samples, and a tenth of a pixel is not seen."""

# As printed: W m-2 is how files write it.
_PRINTED = {"W m-2": "W/m²", "W m^-2": "W/m²", "1": "", "m": "m"}


@dataclass(frozen=True, eq=False)
class Samples:
    """Real values (n1, n2, ...) of a quantity on evenly spaced axes in metres.

    ``corners`` are the places of the first and of the last sample, ``unit`` that of the values, as
    it is printed.
    """

    name: str
    unit: str
    values: Floats
    corners: tuple[Floats, Floats]

    @property
    def spacing(self) -> Floats:
        lower, upper = self.corners
        return (upper - lower) / (np.array(self.values.shape) - 1)

    def zero_db(self, reference: float | None) -> float:
        """The value of 0 dB: the reference, or the largest value; ArgumentError if not above 0."""
        if reference is None:
            return peak_of(self.values, self.name)
        if not (reference > 0 and math.isfinite(reference)):
            raise ArgumentError(f"expected a reference above zero, got {reference:g}")
        return float(reference)


def field_samples(found: Any, name: str, dims: tuple[str, ...], most: int | None = None) -> Samples:
    """The real samples of ``found[name]`` over the axes ``dims``, in this order.

    Parameters
    ----------
    found : xarray.Dataset with evenly spaced coordinates in metres.
    most : along an axis; of longer ones every second, third, ... sample. Arrays that are read when
        asked are asked for these samples only. None: all.

    Raises
    ------
    ArgumentError : no such quantity or axes, fewer than two samples along an axis, uneven ones,
    samples that are nan (a file that has not been finished).
    """
    if name not in found:
        raise ArgumentError(f"expected {name!r} among what there is, got {', '.join(found)}")
    array = found[name]
    if sorted(array.dims) != sorted(dims):
        raise ArgumentError(
            f"expected {name} over {', '.join(dims)}, got it over {', '.join(map(str, array.dims))}"
        )
    array = array.transpose(*dims)
    if most is not None:
        array = array[tuple(slice(None, None, -(-n // most)) for n in array.shape)]
    axes = [even_axis(d, np.asarray(array[d].values, dtype=np.float64)) for d in dims]
    values = np.asarray(array.values)
    if np.iscomplexobj(values):
        raise ArgumentError(f"expected {name} as real values, got complex ones; draw their squares")
    values = values.astype(np.float64)
    if np.isnan(values).any():
        raise ArgumentError(
            f"expected {name} at all points, got nan at {np.isnan(values).mean():.1%} of them; "
            "finish the run that computes it"
        )
    unit = str(array.attrs.get("units", ""))
    ends = np.array([[a[0], a[-1]] for a in axes])
    return Samples(name, _PRINTED.get(unit, unit), values, (ends[:, 0], ends[:, 1]))


def even_axis(name: str, places: Floats) -> Floats:
    """The places themselves; ArgumentError unless they are at least two, rising in even steps."""
    if len(places) < 2:
        raise ArgumentError(
            f"expected at least two samples along {name} to draw, got {len(places)}"
        )
    steps = np.diff(places)
    step = (places[-1] - places[0]) / (len(places) - 1)
    if not (step > 0 and np.all(np.abs(steps - step) <= _EVEN * step)):
        raise ArgumentError(f"expected evenly spaced {name}, rising, got other places")
    return places


def peak_of(values: NDArray[Any], name: str) -> float:
    """The largest of real values; ArgumentError if that is not above zero."""
    peak = float(np.max(values))
    if not (peak > 0 and math.isfinite(peak)):
        raise ArgumentError(f"expected some {name} above zero, got {peak:g} at most")
    return peak


def chosen_method(fields: dict[str, NDArray[Any]], against: str | None) -> str:
    """The method that others are compared with, by default the last; ArgumentError for others."""
    if against is None:
        return list(fields)[-1]
    if against not in fields:
        raise ArgumentError(f"expected against to be one of {', '.join(fields)}, got {against!r}")
    return against


def printed_unit(array: Any) -> str:
    """The unit of a labelled array, as it is printed."""
    unit = str(array.attrs.get("units", ""))
    return _PRINTED.get(unit, unit)


def methods_of(found: Any, name: str) -> dict[str, NDArray[Any]]:
    """The values of ``found[name]`` by each method, over the other axes in their order.

    Without an axis ``method``, one entry under what the attributes call it, or its name.

    Raises
    ------
    ArgumentError : no such quantity, or values that are nan.
    """
    if name not in found:
        raise ArgumentError(f"expected {name!r} among what there is, got {', '.join(found)}")
    array = found[name]
    if "method" not in array.dims:
        called = str(array.attrs.get("method", found.attrs.get("method", name)))
        return {called: np.asarray(array.values)}
    methods = [str(method) for method in found["method"].values]
    ordered = array.transpose("method", ...)
    return dict(zip(methods, np.asarray(ordered.values), strict=True))
