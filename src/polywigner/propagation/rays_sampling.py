"""Wigner rays from drawn places: plain and quasi-Monte Carlo, for study and comparison.

W over the automean is so smooth between its kinks, and changes sign so often, that a Gauss rule
needs 10 to 10^4 times fewer places; a renderer, which cannot choose its places, draws them.
"""

from __future__ import annotations

import importlib
import math
from collections.abc import Iterator
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from polywigner.errors import ArgumentError, MissingExtraError
from polywigner.geometry import Aperture
from polywigner.geometry.arguments import checked_count
from polywigner.illumination import Array
from polywigner.propagation.rays import Rays
from polywigner.propagation.rays_adaptive import Estimate
from polywigner.transforms import sample_automean

__all__ = ["Sampling", "by_samples"]

Sampling = Literal["gauss", "sobol", "monte-carlo"]

Values = NDArray[np.float64]

# Independent batches, from whose scatter the error is estimated, to a fifth of itself.
_BATCHES = 16
_DEFAULT_SAMPLES = 1 << 14


def by_samples(
    source: Aperture | Array, rays: Rays, points: Values, sampling: str, samples: Any, seed: Any
) -> Estimate:
    """Irradiance at points (n, 3) as the mean over 16 batches of drawn places.

    The estimate of the error is the standard deviation of that mean.
    """
    count = _DEFAULT_SAMPLES if samples is None else checked_count(samples, "samples", _BATCHES)
    size = -(-count // _BATCHES)
    means = []
    for numbers in _numbers(sampling, size, seed):
        places, density = sample_automean(source, numbers, engine=rays.engine)
        means.append(rays.irradiance((places, 1.0 / (density * len(places))), points))
    scatter = np.std(means, axis=0, ddof=1) / math.sqrt(_BATCHES)
    return Estimate(np.mean(means, axis=0), scatter)


def _numbers(sampling: str, size: int, seed: Any) -> Iterator[Values]:
    """Batches (size, 2) of numbers in [0, 1); those of Sobol are rounded up to a power of two."""
    try:
        generator = np.random.default_rng(seed)
    except (TypeError, ValueError):
        raise ArgumentError(
            f"expected seed as a whole number of at least zero or a Generator, got {seed!r}"
        ) from None
    sobol = _sobol() if sampling == "sobol" else None
    for _ in range(_BATCHES):
        if sobol is None:
            yield generator.random((size, 2))
            continue
        sequence = sobol(2, scramble=True, seed=generator)
        # The largest of the numbers that scrambling makes may round to 1.
        yield np.minimum(sequence.random_base2(math.ceil(math.log2(size))), 1 - 2.0**-53)


def _sobol() -> Any:
    try:
        return importlib.import_module("scipy.stats.qmc").Sobol
    except ImportError:
        raise MissingExtraError(
            "expected scipy to be installed for sampling='sobol', got none; install it with: "
            "pip install polywigner[arrays]"
        ) from None
