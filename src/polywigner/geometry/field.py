"""What geometry needs to know of the field on a source: that it is a sum of plane waves."""

from __future__ import annotations

from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from polywigner.errors import ArgumentError, IlluminationError

__all__ = ["Field", "checked_field", "checked_shift"]


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


def checked_shift(shift: Any, dimension: int) -> NDArray[np.float64]:
    """A shift as (dimension,) finite numbers; ArgumentError if it is none."""
    try:
        offset = np.array(shift, dtype=np.float64)
    except (TypeError, ValueError):
        offset = np.empty(0)
    if offset.shape != (dimension,) or not np.isfinite(offset).all():
        raise ArgumentError(f"expected a shift of {dimension} finite numbers, got {shift!r}")
    return offset
