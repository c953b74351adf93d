"""The energy of a field: int |u|^2 over its source."""

from __future__ import annotations

import numpy as np

from polywigner.geometry import Aperture, Wavefront
from polywigner.illumination import Array
from polywigner.transforms.phase_space import lag_marginal

__all__ = ["energy_of"]


def energy_of(source: Aperture | Array | Wavefront) -> float:
    """int |u|^2 = R_xi(0) of a source in the plane, in m^2 times the unit of |u|^2.

    Rounding may make it negative where elements cancel each other everywhere.
    """
    # NumPy: one value is less work than the compilation of a kernel.
    return float(np.real(lag_marginal(source, (0.0, 0.0), engine="numpy")))
