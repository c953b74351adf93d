"""Elements that are shifted copies of one, recognised by their vertices and fields."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polywigner.geometry import Aperture, Slits

__all__ = ["shifted_copies"]

# Elements are copies if their vertices, shifted, miss those of the first by this fraction of the
# largest coordinate: a few roundings; fields, which come from a sine, may miss by more.
_COPIES, _COPIED_FIELDS = 1e-15, 1e-13


def shifted_copies(
    elements: Sequence[Aperture] | Sequence[Slits],
) -> tuple[Aperture, NDArray[np.float64], NDArray[np.complex128]] | None:
    """One element, shifts (n, 2) and factors (n,) of its field that give all; None if they do not.

    For apertures only.
    """
    first = elements[0]
    if not isinstance(first, Aperture):
        return None
    corners = np.concatenate(first.rings)
    shifts, factors = [], []
    for element in elements:
        assert isinstance(element, Aperture)  # elements of one plane are of one kind
        if [len(ring) for ring in element.rings] != [len(ring) for ring in first.rings]:
            return None
        own = np.concatenate(element.rings)
        shift = (own - corners).mean(axis=0)
        allowed = _COPIES * max(float(np.abs(own).max()), float(np.abs(corners).max()))
        factor = _factor_of_copy(first.illumination, element.illumination, shift)
        if factor is None or float(np.abs(own - corners - shift).max()) > allowed:
            return None
        shifts.append(shift)
        factors.append(factor)
    return first, np.array(shifts), np.array(factors, np.complex128)


def _factor_of_copy(first: Any, other: Any, shift: NDArray[np.float64]) -> complex | None:
    """The factor between a field and another one shifted; None where there is none."""
    if first is None or other is None:
        return 1.0 if first is other else None
    moved = first.moved(shift)
    if not np.array_equal(moved.frequencies, other.frequencies):
        return None
    factor = complex(other.amplitudes[0] / moved.amplitudes[0])
    error = float(np.abs(other.amplitudes - factor * moved.amplitudes).max())
    return factor if error <= _COPIED_FIELDS * float(np.abs(other.amplitudes).max()) else None
