"""Light of a band of frequencies: an incoherent mean over wavelengths.

The spectrum is flat from f - B/2 to f + B/2, f the frequency of the wavelength that is given, the
carrier, and B the bandwidth in Hz; the power |u|^2 is that of the whole band. The field on the
source is that of the carrier at all its frequencies, so that beams which are steered by phases
squint. Waves from two points of the source differ by its diameter D at most on their way, hence
irradiances and intensities vary over the band as waves of at most pi B D/c radians either way do,
and Gauss's rule for these is as accurate as it was asked to be.
"""

from __future__ import annotations

import math
from typing import Any

from polywigner.errors import ArgumentError
from polywigner.geometry.arguments import checked_number
from polywigner.numerics.nodes import flat_rule
from polywigner.quantities import SPEED_OF_LIGHT

__all__ = ["checked_bandwidth", "wavelengths_of_band"]

# Bandwidth times the time that light takes across the source: some so many wavelengths are summed.
_MOST_SPREAD = 500.0
_MEANING = "a bandwidth in Hz above zero, and less than twice the frequency"


def checked_bandwidth(bandwidth: Any, wavelength: float) -> float:
    """In Hz, of light about a wavelength in m; ArgumentError for what reaches down to zero."""
    width = checked_number(bandwidth, "bandwidth", _MEANING)
    carrier = SPEED_OF_LIGHT / wavelength
    if not 0 < width < 2 * carrier:
        raise ArgumentError(
            f"expected {_MEANING}, {2 * carrier:.4g} Hz, got {bandwidth!r}; leave it out for one "
            "wavelength"
        )
    return width


def wavelengths_of_band(
    wavelength: float, bandwidth: float, lag: float, error: float
) -> list[tuple[float, float]]:
    """(wavelength, weight) for the mean over the band, of a source ``lag`` m across."""
    spread = bandwidth * lag / SPEED_OF_LIGHT
    if not spread <= _MOST_SPREAD:
        raise ArgumentError(
            f"expected a bandwidth of at most {_MOST_SPREAD * SPEED_OF_LIGHT / lag:.4g} Hz for a "
            f"source of {lag:.4g} m, got {bandwidth:g}, of which some {spread:.3g} wavelengths "
            "would be summed up; check its unit, or compute parts of the band"
        )
    reach = math.pi * spread
    nodes, weights = flat_rule(reach, error)
    frequencies = SPEED_OF_LIGHT / wavelength + bandwidth / 2 * nodes
    return list(zip((SPEED_OF_LIGHT / frequencies).tolist(), weights.tolist(), strict=True))
