"""Slits: one-dimensional apertures, each a set of disjoint intervals."""

from __future__ import annotations

from functools import cached_property
from typing import Any, final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from polywigner.errors import GeometryError
from polywigner.geometry.arguments import finite_array
from polywigner.geometry.illumination import Illumination, checked_field, checked_shift
from polywigner.geometry.wavefront import TakesWaves

# Largest overlap of intervals that count as touching, as a fraction of the largest coordinate.
_ROUNDING = 2.0**-46


@final
class Slits(TakesWaves):
    """A one-dimensional aperture of intervals, with an optional illumination.

    Without an illumination, the field on the slits is 1. Slits that touch are merged.

    Parameters
    ----------
    intervals : array_like, shape (m, 2) or (2,)
        Start and end of each slit, or of a single slit, in any order. The numbers are in metres;
        any other unit works if it is used consistently.

    Raises
    ------
    GeometryError
        If a number is not finite, a slit has zero width, or slits overlap.

    Examples
    --------
    >>> import polywigner as pw
    >>> pw.Slits([[0.0, 1e-3], [3e-3, 4e-3]]).length
    0.002
    """

    intervals: NDArray[np.float64]
    """Start and end of each slit in metres, shape (m, 2), ascending, read-only."""
    illumination: Illumination | None
    """Field on the slits; None for the field 1."""

    def __init__(self, intervals: ArrayLike) -> None:
        self._set(intervals=_merged_intervals(intervals), illumination=None)

    def with_illumination(self, illumination: Illumination | None) -> Slits:
        """Return the slits with a different field.

        Parameters
        ----------
        illumination : Illumination or None
            The field in one dimension; None for the field 1.

        Returns
        -------
        Slits
            The same intervals with the field.

        Raises
        ------
        ArgumentError
            If the field is neither an Illumination nor None.
        IlluminationError
            If the field has two dimensions.
        """
        return Slits._of(intervals=self.intervals, illumination=checked_field(illumination, 1))

    def moved(self, shift: ArrayLike) -> Slits:
        """Return the slits and their field, translated.

        Parameters
        ----------
        shift : float or array_like, shape (1,)
            Translation in metres.

        Returns
        -------
        Slits
            The translated slits.

        Raises
        ------
        ArgumentError
            If the shift is not one finite number.
        """
        offset = checked_shift(shift, 1)
        field = None if self.illumination is None else self.illumination.moved(offset)
        return Slits._of(intervals=self.intervals + offset, illumination=field)

    @property
    def elements_in_plane(self) -> tuple[Slits, ...]:
        """Tuple with these slits as its only element; arrays have several elements."""
        return (self,)

    @cached_property
    def length(self) -> float:
        """Sum of the widths in metres."""
        return float(np.diff(self.intervals, axis=1).sum())

    @cached_property
    def bounds(self) -> tuple[float, float]:
        """Start of the first slit and end of the last slit in metres."""
        return float(self.intervals[0, 0]), float(self.intervals[-1, 1])

    @property
    def centre(self) -> float:
        """Centre of the bounds in metres."""
        return self.bounds[0] / 2 + self.bounds[1] / 2

    @cached_property
    def diameter(self) -> float:
        """Distance in metres from the start of the first slit to the end of the last slit."""
        return self.bounds[1] - self.bounds[0]

    @cached_property
    def _key(self) -> tuple[bytes, Illumination | None]:
        """Intervals and field, which are equal for equal slits."""
        return (self.intervals + 0.0).tobytes(), self.illumination

    def __repr__(self) -> str:
        field = "" if self.illumination is None else f", {self.illumination!r}"
        return f"Slits({self.intervals.tolist()}{field})"


def _merged_intervals(intervals: Any) -> NDArray[np.float64]:
    """Sort intervals (m, 2), with the start of each interval first, and merge touching intervals.

    Raises GeometryError if an interval has zero width, or intervals overlap.
    """
    expected = "expected slits to be an (m, 2) array of starts and ends"
    array = finite_array(intervals, expected, (None, 2), (2,), error=GeometryError).reshape(-1, 2)
    array = np.sort(array, axis=1)
    array = array[np.argsort(array[:, 0], kind="stable")]
    tolerance = _ROUNDING * float(np.abs(array).max())
    widths = array[:, 1] - array[:, 0]
    if (widths <= 0).any():
        bad = array[int(np.argmin(widths))].tolist()
        raise GeometryError(f"expected slits wider than zero, got {bad}")
    overlap = array[:-1, 1] - array[1:, 0]
    if (overlap > tolerance).any():
        k = int(np.argmax(overlap))
        raise GeometryError(
            f"expected slits that do not overlap, got {array[k].tolist()} and "
            f"{array[k + 1].tolist()}; merge them into one slit"
        )
    starts = np.insert(np.flatnonzero(np.abs(overlap) > tolerance) + 1, 0, 0)
    ends = np.append(starts[1:] - 1, len(array) - 1)
    return np.column_stack([array[starts, 0], array[ends, 1]])
