"""Directions into which sources are steered."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from polywigner.errors import ArgumentError
from polywigner.geometry.numbers import real_numbers

__all__ = ["transverse", "unit_vector"]

# Directions that passed through single precision, or were typed with seven digits, pass.
_UNIT = 1e-6

_ADVICE = "divide it by its length"


def unit_vector(direction: Any) -> NDArray[np.float64]:
    """A unit vector (3,) that points away from the aperture, as given; ArgumentError if not."""
    vector = _numbers(direction)
    if vector.shape != (3,):
        raise ArgumentError(f"expected a direction as a unit vector (3,), got {direction!r}")
    length = _length(vector)
    if abs(length - 1) > _UNIT:
        raise ArgumentError(
            f"expected a direction of length 1, got one of length {length:.6g}; {_ADVICE}"
        )
    if vector[2] < 0:
        raise ArgumentError(
            f"expected a direction into z > 0, to which the aperture radiates, got {direction!r}"
        )
    return vector


def transverse(direction: Any) -> NDArray[np.float64]:
    """The components of a direction along the aperture: (2,), or (1,) for slits.

    From a unit vector (3,), from these components (2,), or from the sine of an angle, a number or
    (1,). Raises ArgumentError for anything else, and for components longer than 1 together.
    """
    given = np.atleast_1d(_numbers(direction))
    if given.shape == (3,):
        return unit_vector(given)[:2]
    if given.shape not in ((1,), (2,)):
        raise ArgumentError(
            "expected a direction as a unit vector (3,), its components (2,) along the aperture, "
            f"or the sine of an angle for slits, got {direction!r}"
        )
    length = _length(given)
    if length > 1 + _UNIT:
        raise ArgumentError(
            "expected components along the aperture of a unit vector, got a length of "
            f"{length:.6g}; {_ADVICE}"
        )
    return given


def _length(vector: NDArray[np.float64]) -> float:
    with np.errstate(over="ignore"):
        return float(np.linalg.norm(vector))


def _numbers(direction: Any) -> NDArray[np.float64]:
    try:
        vector = real_numbers(direction)
    except ValueError:
        vector = np.array(np.nan)
    if not np.isfinite(vector).all():
        raise ArgumentError(f"expected a direction of finite numbers, got {direction!r}")
    return vector
