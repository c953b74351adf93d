"""How many random positions on a source a pixel needs, for the noise of its irradiance."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polywigner.errors import ArgumentError
from polywigner.geometry.arguments import checked_number
from polywigner.illumination.support import mutual_support
from polywigner.radiometry.directions import PlaneSource
from polywigner.transforms import fourier, sample_automean, wigner

__all__ = ["checked_decibels", "samples_for_error"]

_SEED = 20220202  # any: the same call gives the same number

# Frequencies tried, of which some are at the level; and of those, directions with their positions.
_TRIED, _DIRECTIONS, _POSITIONS = 1 << 14, 64, 1024
# Pixels count as being at the level within this factor.
_NEAR = 10**0.15
# Beyond these, squares of errors and levels are rounding, and samples past counting.
_LEAST_ERROR, _LOWEST = 1e-4, -150.0
# Nulls within the band of levels are rare and need any number of samples.
_QUANTILE = 0.9

Values = NDArray[np.float64]


def checked_decibels(error_db: Any, level_db: Any) -> tuple[float, float]:
    """An error above zero, and a level of at most zero; ArgumentError for others."""
    error = checked_number(error_db, "error_db", "decibels above zero")
    level = checked_number(level_db, "level_db", "decibels of at most zero")
    if not _LEAST_ERROR <= error <= -_LOWEST:
        raise ArgumentError(
            f"expected error_db as decibels above zero, from {_LEAST_ERROR:g} to {-_LOWEST:g}, got "
            f"{error_db!r}"
        )
    if not _LOWEST <= level <= 0:
        raise ArgumentError(
            f"expected level_db as decibels of at most zero, from {_LOWEST:g}, got {level_db!r}"
        )
    return error, level


def samples_for_error(source: PlaneSource, wavelength: float, error: float, level: float) -> int:
    """Independent uniform positions x in the support S that give I within an error in dB, rms (N7).

    The estimate of |F|^2 by n positions is area(S) times the mean of W(x, nu), and its relative
    variance (area(S) int W^2 dx/|F|^4 - 1)/n. The number is for nine of ten directions of the
    far field whose |F|^2 lies within 1.5 dB of the level.
    """
    rng = np.random.default_rng(_SEED)
    nu, intensity = _at_level(source, wavelength, 10 ** (level / 10), rng)
    support = mutual_support(source)
    x, _ = sample_automean(support, _POSITIONS, seed=rng)
    values = np.asarray(wigner(source, x, nu[:, None, :]))
    spread = support.area**2 * np.mean(values**2, axis=1) / intensity**2 - 1
    relative = 10 ** (error / 10) - 1
    needed = float(np.quantile(np.maximum(spread, 0.0), _QUANTILE)) / relative**2
    return max(1, math.ceil(needed))


def _at_level(
    source: PlaneSource, wavelength: float, level: float, rng: np.random.Generator
) -> tuple[Values, Values]:
    """Frequencies (k, 2) of propagating waves at a level of |F|^2 below its peak, and |F|^2."""
    radius, angle = rng.random(_TRIED), 2 * math.pi * rng.random(_TRIED)
    # Equally many per octave of distance from the beam, which may be narrow and point anywhere.
    centre = _brightest(source, wavelength, rng)
    distance = 2 / wavelength * 10 ** (-4 * radius)
    nu = centre + distance[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    nu = np.concatenate([centre[None], nu[np.linalg.norm(nu, axis=-1) < 1 / wavelength]])
    found = np.square(np.abs(np.asarray(fourier(source, _lifted(source, nu)))))
    levels = found / found.max()
    chosen = np.flatnonzero((levels > level / _NEAR) & (levels < level * _NEAR))
    if not len(chosen):  # nothing so weak is radiated: the weakest there is
        chosen = np.argsort(np.abs(np.log(levels / level)))[:_DIRECTIONS]
    chosen = rng.permutation(chosen)[:_DIRECTIONS]
    return nu[chosen], found[chosen]


def _brightest(source: PlaneSource, wavelength: float, rng: np.random.Generator) -> Values:
    """About where |F|^2 is largest, (2,): the best of random frequencies, then of ever nearer."""
    best, reach = np.zeros(2), 1 / wavelength
    while reach > 1e-4 / wavelength:
        nu = best + reach * (2 * rng.random((_TRIED // 4, 2)) - 1)
        nu = np.concatenate([best[None], nu[np.linalg.norm(nu, axis=-1) < 1 / wavelength]])
        best = nu[int(np.argmax(np.abs(np.asarray(fourier(source, _lifted(source, nu))))))]
        reach /= 4
    return np.asarray(best)


def _lifted(source: Any, nu: Values) -> Values:
    """nu with a third component, which placed elements ask for."""
    return np.concatenate([nu, np.zeros((len(nu), 1))], axis=-1)
