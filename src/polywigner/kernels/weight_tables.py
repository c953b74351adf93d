"""Array factors of any weights on a lattice, from a table that is periodic in the frequency.

Weights that are no product of two profiles have factors (L1) of up to n1 n2 terms at a midpoint.
Each is a trigonometric polynomial of 2 nu.b along both directions. It is tabulated at twice the
rate that its degree asks for, less what an interpolating kernel of a few samples puts on each of
its waves: a non-uniform FFT of type 2. Source: A. H. Barnett, J. Magland, L. af Klinteberg, SIAM J.
Sci. Comput. 41, C479 (2019), the kernel exp(beta (sqrt(1 - z^2) - 1)).
"""

from __future__ import annotations

import math
from collections.abc import Hashable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["MeanTable", "Taps", "mean_table"]

# Samples under the kernel along each direction: errors of 1e-13 and 3e-7 of sum |w|^2.
_WIDTH = {True: 14, False: 7}
_BETA = 2.30  # times the width, for twice the needed rate
_RATE = 2
# Larger tables are not made; the factors are then summed pair by pair.
_MOST_BYTES = 1 << 28

Pair2 = tuple[int, int]


@dataclass(frozen=True, eq=False)
class MeanTable:
    """The factors of all midpoints at M1 x M2 frequencies, prepared for interpolation."""

    midpoints: Pair2
    """2n - 1 along each direction."""
    samples: Pair2
    width: int
    values: NDArray[np.float64]
    """(midpoints x samples, 1)"""
    held: dict[Hashable, Any] = field(default_factory=dict)

    def taps(self, ops: Any, turns: tuple[Any, Any]) -> tuple[Taps, Taps]:
        """What the interpolation at a frequency needs of the two directions."""
        one, two = (
            Taps(ops, 2.0 * t, count, self.width)
            for t, count in zip(turns, self.samples, strict=True)
        )
        return one, two

    def at(self, ops: Any, sums: tuple[Any, Any], taps: tuple[Taps, Taps]) -> Any:
        """The factor at a midpoint, by its two index sums; 0 where there is none."""
        if ops.key not in self.held:
            self.held[ops.key] = ops.held(self.values)
        table = self.held[ops.key]
        exists = (sums[0] >= 0.0) & (sums[0] < float(self.midpoints[0]))
        exists = exists & (sums[1] >= 0.0) & (sums[1] < float(self.midpoints[1]))
        inside = [ops.select(exists, s, 0.0) for s in sums]
        first, second = (ops.truncated(s) for s in inside)
        base = (first * self.midpoints[1] + second) * (self.samples[0] * self.samples[1])
        one, two = (tap.signed(ops, s) for tap, s in zip(taps, inside, strict=True))
        total: Any = 0.0
        for row, weight in zip(taps[0].index, one, strict=True):
            start = base + row * self.samples[1]
            line: Any = 0.0
            for column, other in zip(taps[1].index, two, strict=True):
                (value,) = ops.gather(table, start + column)
                line = ops.fma(value, other, line)
            total = ops.fma(line, weight, total)
        return ops.select(exists, total, 0.0 * total)


class Taps:
    """Weights and places of the samples around t, which has period 1 up to a sign."""

    def __init__(self, ops: Any, t: Any, samples: int, width: int) -> None:
        u = t * float(samples)
        start = ops.round(u - 0.5 * width + 0.5)
        self.index: list[Any] = []
        self._weights: list[Any] = []
        self._turned: list[Any] = []
        for q in range(width):
            m = start + float(q)
            z = (u - m) * (2.0 / width)
            root = ops.sqrt(ops.maximum(1.0 - z * z, 0.0))
            self._weights.append(ops.exp((root - 1.0) * (_BETA * width)))
            periods = ops.round((m + 0.5) * (1.0 / samples) - 0.5)
            self.index.append(ops.truncated(m - periods * float(samples)))
            self._turned.append(abs(periods - 2.0 * ops.round(0.5 * periods)))

    def signed(self, ops: Any, index_sum: Any) -> list[Any]:
        """The weights with the sign that odd index sums take from period to period."""
        odd = abs(index_sum - 2.0 * ops.round(0.5 * index_sum))
        return [
            weight * (1.0 - 2.0 * odd * turned)
            for weight, turned in zip(self._weights, self._turned, strict=True)
        ]


def mean_table(weights: NDArray[np.complex128], double: bool) -> MeanTable | None:
    """The table of weights (n1, n2), or None if it would be too large."""
    width = _WIDTH[double]
    n1, n2 = weights.shape
    samples = (max(_RATE * n1, width + 1), max(_RATE * n2, width + 1))
    midpoints = (2 * n1 - 1, 2 * n2 - 1)
    entries = math.prod(midpoints) * math.prod(samples)
    if entries * (8 if double else 4) > _MOST_BYTES:
        return None
    values = np.empty((*midpoints, *samples), np.float64 if double else np.float32)
    first, second = (_Direction(n, m, width) for n, m in zip((n1, n2), samples, strict=True))
    for h in range(midpoints[0]):
        one = first.one[h], first.other[h]
        left, right = (weights[index] for index in one)
        pairs = left[:, second.one] * right[:, second.other].conj()  # (n1, midpoints, n2)
        pairs *= first.share[h][:, None, None] * second.share
        waves = np.fft.fft2(pairs.transpose(1, 0, 2), s=samples, axes=(1, 2))
        waves *= first.turn[h][:, None] * second.turn[:, None, :]
        values[h] = waves.real
    return MeanTable(midpoints, samples, width, values.reshape(-1, 1))


class _Direction:
    """Along one direction, for each midpoint: the pairs of sites, and what their waves become."""

    def __init__(self, count: int, samples: int, width: int) -> None:
        h = np.arange(2 * count - 1)[:, None]
        k = np.arange(count)
        pairs = np.minimum(h, 2 * count - 2 - h) + 1
        exists = k < pairs
        low = np.maximum(0, h - count + 1)
        self.one = np.where(exists, low + k, 0)
        """(midpoints, count) the site with the larger index last; 0 where there is no pair."""
        self.other = np.where(exists, h - low - k, 0)
        # what the kernel's samples sum up to on a wave: by Poisson's formula its transform
        node, weight = np.polynomial.legendre.leggauss(200)
        kernel = np.exp(_BETA * width * (np.sqrt(1 - node**2) - 1)) * weight * (width / 2)
        kappa = k - (pairs - 1) / 2
        p = np.cos(2 * np.pi * kappa[..., None] * node * (width / 2) / samples) @ kernel
        self.share = np.where(exists, 1 / p, 0.0)
        # an FFT has waves 0, 1, ... where these are symmetric about 0
        self.turn = np.exp(1j * np.pi * (pairs - 1) * np.arange(samples) / samples)
