"""Input that is probably a slip: a unit left out, or three zeros too many."""

from __future__ import annotations

import warnings

from polywigner.errors import ArgumentError

__all__ = ["check_wavelength"]

# From an aperture that is a point, in effect, to the largest telescopes at visible light; a slip
# between units is a factor of a thousand or a billion.
_LARGEST_RATIO = 1e4
_SMALLEST_RATIO = 1e-6

# Nothing but a slip; and pictures cannot have axes of 1e-300.
_ABSURD = 1e12


def check_wavelength(wavelength: float, diameter: float) -> None:
    """Warn of a wavelength that hardly belongs to an aperture.

    Parameters
    ----------
    wavelength : m, above zero.
    diameter : of the aperture, m, above zero.

    Raises
    ------
    ArgumentError : the two differ by more than twelve orders of magnitude.
    """
    ratio = wavelength / diameter
    if _SMALLEST_RATIO <= ratio <= _LARGEST_RATIO:
        return
    question = "GHz for the frequency" if ratio > 1 else "mm for the wavelength"
    finding = (
        f"a wavelength of {wavelength:.3g} m, which is {ratio:.1g} times the aperture's diameter "
        f"of {diameter:.3g} m; did you mean {question}, or another unit for the aperture?"
    )
    if not 1 / _ABSURD <= ratio <= _ABSURD:
        raise ArgumentError(f"expected a wavelength that belongs to the aperture, got {finding}")
    warnings.warn(f"got {finding}", RuntimeWarning, stacklevel=2)
