"""Rules for means over a normal and over a flat density of functions whose band is known.

A function of t whose Fourier transform ends at a reach is a mean of waves exp(i w t), |w| <= reach.
A rule that errs by at most so much for each of these errs for the function by at most that share of
the mean's size. So the number of nodes is known beforehand:

- Normal density, Gauss-Hermite: n nodes err by reach^(2n) n!/(2n)! at most, their remainder. That
  takes few nodes for a short reach, and 0.7 reach^2 for a long one.
- Normal density, equidistant nodes h apart: their sum is that of exp(-(w + 2 pi m/h)^2/2) over all
  whole m (Poisson). From 2 pi/h = reach + tail on, exp(-tail^2/2) half of the error, the terms but
  m = 0 are no more than the other half. Between -tail and tail: tail (reach + tail)/pi nodes.
- Flat density, Gauss-Legendre: n nodes err by (2 reach)^(2n) (n!)^4/((2n + 1) (2n)!^3) at most.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import lru_cache
from itertools import count
from typing import Any

import numpy as np
import numpy.typing as npt

__all__ = ["Rule", "flat_rule", "normal_product_rule", "normal_rule"]

Rule = tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]
"""Nodes, and weights that add up to 1; both read-only."""


@lru_cache(maxsize=64)
def normal_rule(reach: float, error: float) -> Rule:
    """Nodes (n,) and weights (n,) for the mean over t of mean 0 and standard deviation 1."""
    tail = math.sqrt(2 * math.log(2 / error))
    half = math.ceil(tail * (reach + tail) / (2 * math.pi))
    nodes: Any
    weights: Any
    by_gauss = _fewest(lambda n: _hermite_remainder(n, reach), error, below=2 * half + 1)
    if by_gauss is not None:
        nodes, weights = np.polynomial.hermite_e.hermegauss(by_gauss)
    else:
        nodes = np.arange(-half, half + 1) * (2 * math.pi / (reach + tail))
        weights = np.exp(-(nodes**2) / 2)
    return _frozen(nodes, weights)


@lru_cache(maxsize=64)
def normal_product_rule(reaches: tuple[float, ...], error: float) -> Rule:
    """Nodes (n, d) and weights (n,) for t of d independent components, each with its own reach.

    Without the nodes of least weight, as far as these add up to a tenth of the error.
    """
    rules = [normal_rule(reach, error / (2 * len(reaches))) for reach in reaches]
    nodes = np.stack(np.meshgrid(*(n for n, _ in rules), indexing="ij"), -1)
    weights = np.ones(1)
    for _, own in rules:
        weights = np.multiply.outer(weights, own)
    flat = weights.ravel()
    order = np.argsort(flat)
    kept = np.sort(order[np.cumsum(flat[order]) > error / 10])
    return _frozen(nodes.reshape(-1, len(reaches))[kept], flat[kept])


@lru_cache(maxsize=64)
def flat_rule(reach: float, error: float) -> Rule:
    """Nodes (n,) and weights (n,) for the mean over t from -1 to 1.

    Two nodes more than the remainder asks for: what is meant also varies by powers of frequency.
    """
    least = _fewest(lambda n: _legendre_remainder(n, reach), error)
    assert least is not None
    return _frozen(*np.polynomial.legendre.leggauss(least + 2))


def _fewest(
    remainder: Callable[[int], float], error: float, below: int | None = None
) -> int | None:
    """The smallest number of nodes whose remainder, a logarithm, is within the error."""
    allowed = math.log(error)
    for n in count(1) if below is None else range(1, below):
        if remainder(n) <= allowed:
            return n
    return None


def _hermite_remainder(n: int, reach: float) -> float:
    return 2 * n * _log(reach) + math.lgamma(n + 1) - math.lgamma(2 * n + 1)


def _legendre_remainder(n: int, reach: float) -> float:
    factorials = 4 * math.lgamma(n + 1) - 3 * math.lgamma(2 * n + 1)
    return 2 * n * _log(2 * reach) + factorials - math.log(2 * n + 1)


def _log(value: float) -> float:
    return math.log(value) if value > 0 else -math.inf


def _frozen(nodes: npt.NDArray[np.float64], weights: npt.NDArray[np.float64]) -> Rule:
    weights = weights / weights.sum()
    for array in (nodes, weights):
        array.setflags(write=False)
    return nodes, weights
