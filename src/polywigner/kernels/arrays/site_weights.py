"""Weights at the sites of a lattice, and sums over the pairs of one midpoint or difference."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from polywigner.kernels.arrays.factors import ProfileFactor
from polywigner.kernels.arrays.weight_tables import (
    DifferenceTable,
    MeanTable,
    difference_table,
    mean_table,
)
from polywigner.numerics.complex_pairs import Pair
from polywigner.numerics.phases import cos_sin_turns
from polywigner.plans import tabulates_products

__all__ = ["LatticeSites", "Weights"]

Pair2 = tuple[Any, Any]
Table = TypeVar("Table", MeanTable, DifferenceTable)


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
    def _tables(self) -> dict[tuple[Any, bool], Any]:
        return {}

    def table(self, make: Callable[[Any, bool], Table | None], double: bool) -> Table | None:
        """The factors as ``make`` has them, where that is not too large."""
        if (make, double) not in self._tables:
            self._tables[make, double] = make(self.values, double)
        found: Table | None = self._tables[make, double]
        return found

    def at(self, ops: Any, i: Any, j: Any) -> tuple[Pair, Any]:
        """The weight of a site, and whether there is one; 0 if not."""
        rows, columns = self.shape
        exists = (i >= 0.0) & (i < float(rows)) & (j >= 0.0) & (j < float(columns))
        row, column = (ops.truncated(ops.select(exists, value, 0.0)) for value in (i, j))
        real, imag = (ops.lookup(table, row * columns + column) for table in (self.real, self.imag))
        return Pair(ops.select(exists, real, 0.0), ops.select(exists, imag, 0.0)), exists


@dataclass(frozen=True)
class LatticeSites:
    """The weights as factors or one by one."""

    factors: tuple[ProfileFactor, ProfileFactor] | None
    """Where the weights are a product of two profiles."""
    weights: Weights

    def at_means(self, ops: Any, turns: Pair2) -> Callable[[Pair2, Pair2, Any], Any]:
        """(steps from the first, index sums, whether the midpoint counts) -> its factor."""
        table = self._table(mean_table, ops.double)
        if self.factors is not None and table is None:
            one, two = (
                _remembered(partial(factor.at_mean, ops, turns=along))
                for factor, along in zip(self.factors, turns, strict=True)
            )
            return lambda steps, sums, counts: one(steps[0], sums[0]) * two(steps[1], sums[1])
        if table is None:
            return lambda steps, sums, counts: _mean_factor(ops, self.weights, sums, turns)
        return _looked_up(ops, table, turns)

    def _table(self, make: Callable[[Any, bool], Table | None], double: bool) -> Table | None:
        """The factors as a table, if that is the best way."""
        amplitudes = None
        if self.factors is not None:
            amplitudes = sum(f.count for f in self.factors if not f.profile.is_uniform)
        if not tabulates_products(self.weights.values.size, amplitudes):
            return None
        return self.weights.table(make, double)

    def at_differences(self, ops: Any, turns: Pair2) -> Callable[[Pair2, Pair2], Pair]:
        """(steps from the first, index differences) -> the factor of the difference."""
        table = self._table(difference_table, ops.double)
        if table is not None:
            lowest = [float(n - 1) for n in self.weights.shape]
            factor = _looked_up(ops, table, (0.5 * turns[0], 0.5 * turns[1]))
            return lambda steps, apart: factor(
                steps, (apart[0] + lowest[0], apart[1] + lowest[1]), True
            )
        if self.factors is None:
            return lambda steps, apart: _difference_factor(ops, self.weights, apart, turns)
        one, two = (
            _remembered(partial(factor.at_difference, ops, turns=along))
            for factor, along in zip(self.factors, turns, strict=True)
        )
        return lambda steps, apart: one(steps[0], apart[0]) * two(steps[1], apart[1])


def _remembered(compute: Callable[[Any], Any]) -> Callable[[Any, Any], Any]:
    """``compute`` of the second argument, once for every constant that comes first."""
    known: dict[float, Any] = {}

    def of(step: Any, argument: Any) -> Any:
        if not isinstance(step, float):  # a row of an engine's table
            return compute(argument)
        if step not in known:
            known[step] = compute(argument)
        return known[step]

    return of


def _looked_up(
    ops: Any, table: MeanTable | DifferenceTable, turns: Pair2
) -> Callable[[Pair2, Pair2, Any], Any]:
    """(steps from the first, numbers, whether they count) -> the factor."""
    one, two = table.directions
    first, second = (
        _remembered(partial(direction.taps, ops, turns=along))
        for direction, along in zip(table.directions, turns, strict=True)
    )

    def factor(steps: Pair2, numbers: Pair2, counts: Any) -> Any:
        counts = counts & one.has(numbers[0]) & two.has(numbers[1])
        taps = (first(steps[0], numbers[0]), second(steps[1], numbers[1]))
        found = table.at(ops, counts, taps)
        if isinstance(found, Pair):
            return Pair(*(ops.select(counts, part, 0.0) for part in (found.real, found.imag)))
        return ops.select(counts, found, 0.0)

    return factor


def _mean_factor(ops: Any, weights: Weights, sums: Any, turns: Any) -> Any:
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


def _difference_factor(ops: Any, weights: Weights, steps: Any, turns: Any) -> Pair:
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
