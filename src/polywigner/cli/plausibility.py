"""Input that is probably a slip: a unit left out, or three zeros too many."""

from __future__ import annotations

import warnings

from polywigner.errors import ArgumentError
from polywigner.geometry.arguments import doubt_of_wavelength

__all__ = ["check_wavelength"]

# Nothing but a slip; and pictures cannot have axes of 1e-300.
_ABSURD = 1e12


def check_wavelength(wavelength: float, diameter: float) -> None:
    """Warn of a wavelength that hardly belongs to an aperture, as functions in Python do.

    Parameters
    ----------
    wavelength : m, above zero.
    diameter : of the aperture, m, above zero.

    Raises
    ------
    ArgumentError : the two differ by more than twelve orders of magnitude.
    """
    doubt = doubt_of_wavelength(wavelength, diameter)
    if doubt is None:
        return
    if not 1 / _ABSURD <= wavelength / diameter <= _ABSURD:
        raise ArgumentError(f"expected a wavelength that belongs to the aperture, got {doubt}")
    warnings.warn(f"got {doubt}", RuntimeWarning, stacklevel=2)
