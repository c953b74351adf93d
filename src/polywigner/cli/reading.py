"""Options for reading aperture files; without imports that would slow `--help`."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from typing import Any, NamedTuple

from polywigner.errors import ArgumentError


class Reading(NamedTuple):
    """Options for reading an aperture file, as texts."""

    unit: str | None
    tolerance: str | None
    layer: Sequence[str] | None
    union: bool
    allow_outside: bool = False
    """Of a source file: whether it may name files outside of its folder."""

    def of_aperture(self) -> dict[str, Any]:
        """The arguments of :func:`polywigner.read_aperture`."""
        from polywigner.quantities import parse_length

        reach = None if self.tolerance is None else parse_length(self.tolerance)
        return {
            "unit": self.unit or "mm",
            "tolerance": reach,
            "layer": self.layer,
            "union": self.union,
        }


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
    from polywigner.geometry.arguments import doubt_of_wavelength

    doubt = doubt_of_wavelength(wavelength, diameter)
    if doubt is None:
        return
    if not 1 / _ABSURD <= wavelength / diameter <= _ABSURD:
        raise ArgumentError(f"expected a wavelength that belongs to the aperture, got {doubt}")
    warnings.warn(f"got {doubt}", RuntimeWarning, stacklevel=2)
