"""Weights at the sites of a lattice, and sums over the pairs of one midpoint or difference."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polywigner.kernels.complex_pairs import Pair
from polywigner.kernels.factors import ProfileFactor
from polywigner.kernels.trigonometry import cos_sin_turns
from polywigner.kernels.weight_tables import MeanTable, mean_table

__all__ = ["LatticeSites", "Weights", "difference_factor", "mean_factor"]

# With fewer sites of any weights, the pairs of a midpoint are summed one by one.
_LEAST_TABULATED = 64


@dataclass(frozen=True, eq=False)
class Weights:
    """The weights at the sites (n1, n2), less their even phase."""

    values: NDArray[np.complex128]

    @property
    def shape(self) -> tuple[int, int]:
        return self.values.shape[0], self.values.shape[1]

    @cached_property
    def real(self) -> tuple[float, ...]:
        return tuple(self.values.real.ravel().tolist())

    @cached_property
    def imag(self) -> tuple[float, ...]:
        return tuple(self.values.imag.ravel().tolist())

    @cached_property
    def _tables(self) -> dict[bool, MeanTable | None]:
        return {}

    def table(self, double: bool) -> MeanTable | None:
        """The factors of midpoints as a table, where it is worth making and not too large."""
        if self.values.size < _LEAST_TABULATED:
            return None
        if double not in self._tables:
            self._tables[double] = mean_table(self.values, double)
        return self._tables[double]

    def at(self, ops: Any, i: Any, j: Any) -> tuple[Pair, Any]:
        """The weight of a site, and whether there is one; 0 if not."""
        rows, columns = self.shape
        exists = (i >= 0.0) & (i < float(rows)) & (j >= 0.0) & (j < float(columns))
        index = ops.select(exists, i * float(columns) + j, 0.0)
        real, imag = (ops.lookup(table, index) for table in (self.real, self.imag))
        return Pair(ops.select(exists, real, 0.0), ops.select(exists, imag, 0.0)), exists


@dataclass(frozen=True)
class LatticeSites:
    """The weights as factors or one by one."""

    factors: tuple[ProfileFactor, ProfileFactor] | None
    """Where the weights are a product of two profiles."""
    weights: Weights


def mean_factor(ops: Any, weights: Weights, sums: Any, turns: Any) -> Any:
    """The factor of weights that are no product, by adding up all pairs of one midpoint."""
    rows, columns = weights.shape

    def term(i: Any, j: Any) -> tuple[Any]:
        other_i, other_j = sums[0] - i, sums[1] - j
        one, _ = weights.at(ops, i + 0.0 * sums[0], j + 0.0 * sums[1])
        other, _ = weights.at(ops, other_i, other_j)
        phase = (i - other_i) * turns[0] + (j - other_j) * turns[1]
        cosine, sine = cos_sin_turns(ops, phase)
        pair = one * Pair(other.real, -other.imag)
        return (pair.real * cosine + pair.imag * sine,)

    sites = [(float(i), float(j)) for i in range(rows) for j in range(columns)]
    (total,) = ops.sum_over(sites, term, 1, like=sums[0])
    return total


def difference_factor(ops: Any, weights: Weights, steps: Any, turns: Any) -> Pair:
    rows, columns = weights.shape

    def term(i: Any, j: Any) -> tuple[Any, Any]:
        other, _ = weights.at(ops, i + 0.0 * steps[0], j + 0.0 * steps[1])
        one, _ = weights.at(ops, i + steps[0], j + steps[1])
        phase = (i + 0.5 * (steps[0] - (rows - 1.0))) * turns[0]
        phase = phase + (j + 0.5 * (steps[1] - (columns - 1.0))) * turns[1]
        cosine, sine = cos_sin_turns(ops, phase)
        pair = one * Pair(other.real, -other.imag) * Pair(cosine, -sine)
        return pair.real, pair.imag

    sites = [(float(i), float(j)) for i in range(rows) for j in range(columns)]
    return Pair(*ops.sum_over(sites, term, 2, like=steps[0]))
