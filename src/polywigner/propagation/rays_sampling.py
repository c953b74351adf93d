"""Wigner rays from drawn places: plain and quasi-Monte Carlo, for study and comparison.

W over the automean is so smooth between its kinks, and changes sign so often, that a Gauss rule
needs 10 to 10^4 times fewer places; a renderer, which cannot choose its places, draws them.
"""

from __future__ import annotations

import importlib
import math
from collections.abc import Callable
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from polywigner.errors import MissingExtraError, install_command
from polywigner.geometry import Aperture
from polywigner.geometry.arguments import checked_count, checked_generator
from polywigner.illumination import Array
from polywigner.propagation.rays import Rays
from polywigner.propagation.rays_adaptive import Estimate
from polywigner.transforms import sample_automean

__all__ = ["Sampling", "by_samples", "sobol_numbers"]

Sampling = Literal["gauss", "sobol", "monte-carlo"]

Values = NDArray[np.float64]

# Independent batches, from whose scatter the error is estimated, to a fifth of itself.
_BATCHES = 16
# To begin with, and the most that a tolerance brings: minutes for a plane of 256 x 256 points.
_FIRST_SAMPLES, _MOST_SAMPLES = 1 << 14, 1 << 18

Draw = Callable[[int], Values]
"""How many -> numbers (n, 2) in [0, 1), others at each call."""


def by_samples(
    source: Aperture | Array,
    rays: Rays,
    points: Values,
    sampling: str,
    samples: Any,
    seed: Any,
    allowed: Callable[[Values, NDArray[np.intp]], Values],
) -> Estimate:
    """Irradiance at points (n, 3) as the mean over 16 batches of drawn places.

    The estimate of the error is the standard deviation of that mean. Without a number of
    ``samples`` they are doubled, up to 2^18, until it is at most ``allowed``: (values, numbers of
    points) -> errors allowed.
    """
    fixed = samples is not None
    count = checked_count(samples, "samples", _BATCHES) if fixed else _FIRST_SAMPLES
    draws, size, drawn = _draws(sampling, seed), -(-count // _BATCHES), 0
    sums = np.zeros((_BATCHES, len(points)))
    result = Estimate(np.zeros(len(points)), np.full(len(points), np.inf))
    open_ = np.arange(len(points))
    while True:
        for batch, draw in zip(sums, draws, strict=True):
            places, density = sample_automean(source, draw(size), engine=rays.engine)
            batch[open_] += rays.irradiance((places, 1.0 / density), points[open_])
        drawn += len(places)
        means = sums[:, open_] / drawn
        result.values[open_] = means.mean(axis=0)
        result.errors[open_] = np.std(means, axis=0, ddof=1) / math.sqrt(_BATCHES)
        # As of rules, see rays_adaptive: places are drawn one to this square, on the average.
        spacing = math.sqrt(float(np.mean(1.0 / density)) / (drawn * _BATCHES))
        unseen = _gaps(source, points[open_]) < spacing / (2 * math.pi)
        result.errors[open_[unseen]] = np.inf
        missed = result.errors[open_] > allowed(result.values[open_], open_)
        result.is_met = not (unseen if fixed else missed).any()
        if fixed or result.is_met or 2 * drawn * _BATCHES > _MOST_SAMPLES:
            return result
        open_, size = open_[missed], drawn


def _gaps(source: Aperture | Array, points: Values) -> Values:
    """Distances of points (n, 3) from the source's bounds, (n,)."""
    xmin, ymin, xmax, ymax = source.bounds
    aside = points[:, :2] - np.clip(points[:, :2], (xmin, ymin), (xmax, ymax))
    result: Values = np.sqrt((aside**2).sum(axis=-1) + points[:, 2] ** 2)
    return result


def _draws(sampling: str, seed: Any) -> list[Draw]:
    """Numbers drawn for each batch. Those of Sobol are rounded up to a power of two."""
    generator = checked_generator(seed)
    if sampling != "sobol":
        return [lambda size: generator.random((size, 2))] * _BATCHES
    sobol = _sobol()
    return [_sobol_draw(sobol(2, scramble=True, seed=generator)) for _ in range(_BATCHES)]


def _sobol_draw(sequence: Any) -> Draw:
    def draw(size: int) -> Values:
        return _below_one(sequence.random_base2(math.ceil(math.log2(size))))

    return draw


def sobol_numbers(size: int, columns: int, generator: np.random.Generator) -> Values:
    """The first numbers (size, columns) in [0, 1) of a Sobol sequence, scrambled anew.

    Raises MissingExtraError without scipy.
    """
    sequence = _sobol()(columns, scramble=True, seed=generator)
    return _below_one(sequence.random_base2(math.ceil(math.log2(size)))[:size])


def _below_one(numbers: Values) -> Values:
    # The largest of the numbers that scrambling makes may round to 1.
    return np.minimum(numbers, 1 - 2.0**-53)


def _sobol() -> Any:
    try:
        return importlib.import_module("scipy.stats.qmc").Sobol
    except ImportError:
        raise MissingExtraError(
            "expected scipy to be installed for quasi-random numbers (Sobol), got none; run "
            f"{install_command('arrays')}"
        ) from None
