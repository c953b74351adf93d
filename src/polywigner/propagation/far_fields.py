"""The far field of a source over directions, for each boundary condition, and its power."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from polywigner.errors import IlluminationError
from polywigner.execution import Engine, Precision
from polywigner.illumination.direction_cosines import times_direction_cosine
from polywigner.illumination.obliquities import SHARES
from polywigner.radiometry.directions import PlaneSource
from polywigner.radiometry.hemisphere import directions_and_weights, largest_lag
from polywigner.transforms import fourier, lag_marginal

__all__ = ["far_field", "radiated_power"]

# Rounding leaves 1e-13 of the energy; a directivity relative to less than this has no digits.
_DARK = 1e-12


def far_field(
    source: PlaneSource,
    directions: NDArray[np.float64],
    wavelength: float,
    obliquity: str,
    *,
    precision: Precision = None,
    engine: Engine = "auto",
) -> NDArray[Any]:
    """lim r exp(-i k r) U(r s) (...), complex, at unit vectors s (..., 3): docs/patterns.md, (RP1).

    In m times the unit of u; zero where z < 0.
    """
    nu, cosine = directions[..., :2] / wavelength, directions[..., 2]
    front = np.maximum(cosine, 0.0)

    def spectrum(turned: bool) -> Any:
        try:
            field = times_direction_cosine(source, wavelength) if turned else source
        except IlluminationError:  # all waves graze the plane: their cosines are zero
            return 0.0
        return fourier(field, nu, precision=precision, engine=engine)

    if obliquity == "paper":
        total = np.sqrt(front) * spectrum(False)
    else:
        of_field, of_slope = SHARES[obliquity]
        total = of_field * front * spectrum(False) if of_field else 0.0
        total = total + of_slope * spectrum(True) if of_slope else total
    values = np.where(cosine < 0, 0.0, total / (1j * wavelength))
    return values.astype(np.complex64 if precision == "single" else np.complex128)


def radiated_power(source: PlaneSource, wavelength: float, obliquity: str) -> float:
    """int |E|^2 dOmega over the hemisphere, in W, to 1e-12 of int |u|^2: (RP2).

    Raises IlluminationError for a source that radiates nothing.
    """
    blocks = directions_and_weights(largest_lag(source), wavelength)
    power = float(
        sum(w @ np.square(np.abs(far_field(source, s, wavelength, obliquity))) for s, w in blocks)
    )
    energy = float(np.real(lag_marginal(source, (0.0, 0.0), engine="numpy")))
    if not power > _DARK * max(0.0, energy):
        raise IlluminationError(
            f"expected a source that radiates at a wavelength of {wavelength:g} m, got one whose "
            f"far field carries {power:.3g} W"
        )
    return power
