"""The field on a source as geometry sees it: a sum of plane waves."""

from __future__ import annotations

import math
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from polywigner.errors import ArgumentError, IlluminationError
from polywigner.geometry.arguments import checked_number, real_numbers, warn_of_degrees


@runtime_checkable
class Field(Protocol):
    """The part of :class:`polywigner.Illumination` that travels with a source.

    Fields are made in the room above this one.
    """

    amplitudes: Any
    frequencies: Any

    @property
    def dimension(self) -> int: ...

    def moved(self, shift: Any) -> Field: ...

    def turned(self, angle: Any) -> Field: ...

    def scaled(self, factor: float) -> Field: ...


def checked_field(field: Any, dimension: int) -> Field:
    """The field of a source in ``dimension`` dimensions.

    Raises ArgumentError for what is not an Illumination, IlluminationError for one of another
    dimension.
    """
    if not isinstance(field, Field):
        advice = (
            "give its .illumination"
            if isinstance(getattr(field, "illumination", None), Field)
            else "make one with polywigner.Illumination(amplitudes, frequencies) or "
            "polywigner.steering(...)"
        )
        raise ArgumentError(f"expected an Illumination, got {type(field).__name__}; {advice}")
    if field.dimension != dimension:
        raise IlluminationError(
            f"expected an illumination with frequencies of {dimension} components, got "
            f"{field.dimension}"
        )
    return field


def checked_shift(shift: Any, dimension: int, name: str = "a shift") -> NDArray[np.float64]:
    """A shift as (dimension,) finite numbers; ArgumentError if it is none."""
    try:
        offset = real_numbers(shift)
    except ValueError:
        offset = np.empty(0)
    if offset.shape != (dimension,) or not np.isfinite(offset).all():
        raise ArgumentError(f"expected {name} of {dimension} finite numbers, got {shift!r}")
    return offset


def turned_points(points: NDArray[np.float64], angle: Any) -> NDArray[np.float64]:
    """Points (n, 2) turned counter-clockwise about the origin by an angle in radians.

    Quarter turns are exact. Raises ArgumentError for an angle that is not a finite number.
    """
    turn = checked_number(angle, "angle", "an angle in radians")
    if (2.0 * turn).is_integer():  # turns that add up may go on and on
        warn_of_degrees("angle", np.array([turn]))
    quarters = round(turn / (math.pi / 2))
    c, s = math.cos(turn), math.sin(turn)
    if turn == quarters * (math.pi / 2):
        c, s = ((1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0))[quarters % 4]
    x, y = points.T
    return np.column_stack([c * x - s * y, s * x + c * y]) + 0.0  # no negative zeros
