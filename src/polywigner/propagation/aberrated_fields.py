"""Fields of pupils with aberrations in the far field and in the Fresnel approximation."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polywigner.errors import ArgumentError
from polywigner.numerics.chirps import waves_of_turns
from polywigner.propagation.collins import FrequencyLattice
from polywigner.transforms.aberrated_pupils import AberratedPupil, Converged, converged
from polywigner.transforms.aberrations import Aberration

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]

# Largest number of waves from nodes to points, about 1e9 a minute.
_MOST_WORK = 2e10


def aberrated_spectrum(
    pupil: AberratedPupil, nu: Floats, tolerance: float, centre: Any = (0.0, 0.0)
) -> Converged:
    """Return int u exp(2 pi i W/lambda - 2 pi i nu.(x - centre)) dx (...) at nu (..., 2).

    ``tolerance``: allowed error over int |u|.
    """
    flat = nu.reshape(-1, 2)
    lattice = FrequencyLattice(flat)
    finite = flat[np.isfinite(flat).all(axis=1)]
    band = (finite.min(axis=0), finite.max(axis=0)) if len(finite) else (np.zeros(2), np.zeros(2))

    def evaluate(extra: int) -> Complex:
        rules = [pupil.rule(k, band, extra, tolerance) for k in range(len(pupil.elements))]
        nodes = np.concatenate([nodes for nodes, _ in rules])
        waves = [w * weight for (_, w), weight in zip(rules, pupil.weights, strict=True)]
        if len(nodes) * lattice.work > _MOST_WORK:
            raise ArgumentError(
                f"the aberrated pupil requires {len(nodes) * lattice.work:.1e} waves from nodes to "
                f"points, at most {_MOST_WORK:.0e}; use fewer points, or a grid along x and y"
            )
        return lattice.summed(nodes - centre, np.concatenate(waves)).reshape(nu.shape[:-1])

    return converged(evaluate, tolerance * pupil.content, "the field of the pupil")


def aberrated_fresnel_field(
    source: Any, aberration: Aberration, points: Floats, wavelength: float, tolerance: float
) -> tuple[Complex, Floats]:
    """Return Fresnel's field (n,) of an aberrated pupil at points (n, 3), and its error.

    exp(ikz)/(i lambda z) int u exp(2 pi i W/lambda + i pi |X - x|^2/(lambda z)) dx: points of one z
    share a rule.
    """
    field, errors = np.empty(len(points), np.complex128), np.empty(len(points))
    for z in np.unique(points[:, 2]).tolist():
        some = points[:, 2] == z
        scale = wavelength * z
        pupil = AberratedPupil.of(source, aberration, wavelength, 0.5 / scale)
        nu = points[some, :2] / scale
        values, error, _ = aberrated_spectrum(pupil, nu, tolerance)
        turns = math.fmod(z, wavelength) / wavelength
        turns = turns + 0.5 * np.square(points[some, :2]).sum(axis=1) / scale
        field[some] = waves_of_turns(turns) * values / (1j * scale)
        errors[some] = error / scale
    return field, errors
