"""Where the copies of one element are, and their weights; checks of both."""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polywigner.errors import ArgumentError, IlluminationError
from polywigner.geometry.arguments import shape_of
from polywigner.geometry.numbers import real_numbers
from polywigner.illumination.lattices import Lattice, lattice_of

__all__ = ["Sites", "checked_sites", "checked_weights"]

# Products of two weights and an area must neither overflow nor vanish.
_LARGEST_WEIGHT = 1e100


class Sites:
    """Positions (n, d) and complex weights (n,), compared by content; to be left unchanged."""

    def __init__(self, positions: NDArray[np.float64], weights: NDArray[np.complex128]) -> None:
        self.positions, self.weights = positions, weights
        self._key = (positions.shape, positions.tobytes(), weights.tobytes())

    @property
    def dimension(self) -> int:
        return int(self.positions.shape[1])

    @cached_property
    def lattice(self) -> Lattice | None:
        """The plane lattice that the sites are on, if they are."""
        if self.dimension != 2 or len(self.positions) < 2:
            return None
        return lattice_of(self.positions, self.weights)

    def __eq__(self, other: object) -> bool:
        return self._key == other._key if isinstance(other, Sites) else NotImplemented

    def __hash__(self) -> int:
        return hash(self._key)


def checked_sites(
    positions: Any, weights: Any, dimension: int | None = None
) -> tuple[NDArray[np.float64], NDArray[np.complex128]]:
    """Positions (n, d) and weights (n,), read-only; of one dimension, or of any up to three.

    Raises ArgumentError and IlluminationError as :func:`polywigner.phased_array` does.
    """
    try:
        places = real_numbers(positions)
    except ValueError:
        places = np.empty(0)
    if dimension in (1, None) and places.ndim == 1:
        places = places[:, None]
    allowed = (1, 2, 3) if dimension is None else (dimension,)
    if places.ndim != 2 or places.shape[1] not in allowed or not len(places):
        raise ArgumentError(
            f"expected positions of shape (n, {dimension or 'd'}), got {shape_of(positions)}"
        )
    if not np.isfinite(places).all():
        raise ArgumentError("expected finite positions, got inf or nan")
    places += 0.0
    places.setflags(write=False)
    return places, checked_weights(weights, len(places))


def checked_weights(weights: Any, count: int) -> NDArray[np.complex128]:
    """Weights (n,) of n elements, read-only; None for all 1.

    Raises IlluminationError as :class:`polywigner.Array` does.
    """
    array = np.ones(count, np.complex128) if weights is None else _numbers(weights, count)
    if array.shape != (count,):
        raise IlluminationError(
            f"expected one weight for each of {count} elements, got shape {array.shape}"
        )
    if not np.isfinite(array).all():
        bad = array[~np.isfinite(array)][0]
        raise IlluminationError(f"expected finite weights, got {bad}")
    if not array.any():
        raise IlluminationError("expected a weight other than zero, got zeros only")
    largest = float(np.abs(array).max())
    if not 1 / _LARGEST_WEIGHT <= largest <= _LARGEST_WEIGHT:
        raise IlluminationError(
            f"expected a largest weight from {1 / _LARGEST_WEIGHT:g} to {_LARGEST_WEIGHT:g}, got "
            f"{largest:g}; divide all by it"
        )
    array += 0.0  # no negative zeros, which equal zeros but hash differently
    array.setflags(write=False)
    return array


def _numbers(weights: Any, count: int) -> NDArray[np.complex128]:
    if np.ma.is_masked(weights):
        raise IlluminationError(f"expected {count} weights, got masked ones; use .filled(0)")
    try:
        array = np.asarray(weights)
        if array.dtype.kind in "US":  # which NumPy would parse
            raise TypeError
        return np.array(array, dtype=np.complex128)
    except (TypeError, ValueError, OverflowError):
        raise IlluminationError(
            f"expected {count} complex weights, got {type(weights).__name__}"
        ) from None
