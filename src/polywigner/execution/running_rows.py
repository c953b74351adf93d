"""Sums over lists of rows that differ from sample to sample, with a number that runs along them.

Parts of the operations namespaces, as those of :mod:`polywigner.execution.ranges`. For NumPy arrays
the rows of all samples are one flat list; for Dr.Jit arrays they are a loop of the kernel.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import numpy.typing as npt

from polywigner.execution.drjit_ranges import DrjitRanges
from polywigner.execution.ranges import NumpyRanges, ScalarRanges

__all__ = ["DrjitRows", "NumpyRows", "ScalarRows"]

Values = tuple[Any, ...]
Array = npt.NDArray[Any]

# Rows at a time: temporary arrays stay in the cache of one core.
_BLOCK = 3 << 12
# Where products are rounded, lines that cross at a smaller angle are off by more than 1/0.03 ulps.
_NEARLY_PARALLEL = 0.03
# More than rounding does to a cross product of vectors shorter than 4, by bytes of a float.
_ROUNDED = {8: 1e-14, 4: 1e-5}


class NumpyRows(NumpyRanges):
    """Rows for NumPy arrays (n,) of samples."""

    cross: Callable[..., Any]

    def as_float(self, number: Any) -> Any:
        """A whole number as a float."""
        return np.asarray(number).astype(self.dtype)

    def reach(self, ax: Any, ay: Any, bx: Any, by: Any) -> Any:
        """The level below which orientations along two edges a and b are wanted to an ulp.

        Where these are nearly parallel and cross, levels of their ends are at most |cross(a, b)|.
        """
        across = np.abs(ax * by - ay * bx)
        size = (np.abs(ax) + np.abs(ay)) * (np.abs(bx) + np.abs(by))
        rounded = _ROUNDED[self.dtype.itemsize] * (size > 0.0)  # no edge, no doubt
        return across * (across < _NEARLY_PARALLEL * size) + rounded

    def orientation(self, ax: Any, ay: Any, bx: Any, by: Any, reach: Any) -> Any:
        """cross(a, b), exact in sign, and to an ulp where it is below ``reach``."""
        rough = np.asarray(ax * by - ay * bx)
        near = np.abs(rough) < reach
        if near.any():
            rough[near] = self.cross(
                *(np.broadcast_to(v, near.shape)[near] for v in (ax, ay, bx, by))
            )
        return rough

    def sum_over_listed(
        self,
        first: Any,
        end: Any,
        runs: Any,
        term: Callable[..., Values],
        values: int,
        *samples: Any,
    ) -> list[Any]:
        """The sums of ``term(number, level, *samples)`` over all numbers of the runs in a range.

        ``runs``: a table of the first number, the end of the numbers, and the level.
        """
        totals = [np.zeros(np.shape(first)) for _ in range(values)]
        for some in _blocks(end - first):
            owner, run = _flat(first[some], (end - first)[some])
            begin, stop, level, _ = self.gather(runs, run)
            of_run, number = _flat(begin, stop - begin)
            for part in (slice(k, k + _BLOCK) for k in range(0, len(number), _BLOCK)):
                own = owner[of_run[part]] + some.start
                found = term(number[part], level[of_run[part]], *(s[own] for s in samples))
                _add(totals, own, found)
        return [total.astype(self.dtype) for total in totals]

    def sum_over_each(
        self, first: Any, end: Any, term: Callable[..., Values], values: int, *samples: Any
    ) -> list[Any]:
        """The sums of ``term(row, *samples)`` over rows in a range."""
        totals = [np.zeros(np.shape(first)) for _ in range(values)]
        for some in _blocks(end - first):
            owner, row = _flat(first[some], (end - first)[some])
            if len(row):
                owner += some.start
                _add(totals, owner, term(row, *(s[owner] for s in samples)))
        return [total.astype(self.dtype) for total in totals]

    def sum_over_rows(
        self,
        first: Any,
        end: Any,
        change: Callable[..., tuple[Any, Any, Any, Values]],
        weight: Callable[..., Any],
        term: Callable[..., Values],
        values: int,
        *samples: Any,
    ) -> list[Any]:
        """The sums of weighted terms over rows in a range, with a level that runs along them.

        ``change(row, *samples)`` is whether the level is set there, to what, its jump at the row,
        and what terms take; ``weight(level, jump, *taken)`` and ``term(*taken, *samples)`` are the
        row's, at the level before its jump.
        """
        totals = [np.zeros(np.shape(first)) for _ in range(values)]
        for some in _blocks(end - first):
            owner, row = _flat(first[some], (end - first)[some])
            if not len(row):
                continue
            owner += some.start
            own = [s[owner] for s in samples]
            sets, start, jump, taken = change(row, *own)
            before = np.cumsum(jump) - jump
            last = np.maximum.accumulate(np.where(sets, np.arange(len(row)), 0))
            factor = weight(before + (start - before)[last], jump, *taken)
            (kept,) = np.nonzero(factor)
            found = term(*(v[kept] for v in taken), *(v[kept] for v in own))
            _add(totals, owner[kept], [factor[kept] * value for value in found])
        return [total.astype(self.dtype) for total in totals]


def _flat(first: Array, counts: Array) -> tuple[Array, Array]:
    """Whose, and row, of all rows from each first on."""
    owner = np.repeat(np.arange(len(counts)), counts)
    return owner, np.arange(len(owner)) + (first - (np.cumsum(counts) - counts))[owner]


def _blocks(counts: Array) -> Iterator[slice]:
    """Samples that have some rows together."""
    ends, start = np.cumsum(counts), 0
    while start < len(counts):
        done = int(ends[start - 1]) if start else 0
        stop = max(start + 1, int(np.searchsorted(ends, done + _BLOCK, side="right")))
        yield slice(start, stop)
        start = stop


def _add(totals: list[Array], owner: Array, found: Any) -> None:
    for total, value in zip(totals, found, strict=True):
        total += np.bincount(owner, value, len(total))


class ScalarRows(ScalarRanges):
    """Rows for one sample of Python floats."""

    cross: Callable[..., Any]

    def as_float(self, number: Any) -> Any:
        return float(number)

    def reach(self, ax: Any, ay: Any, bx: Any, by: Any) -> None:
        return None

    def orientation(self, ax: Any, ay: Any, bx: Any, by: Any, reach: Any) -> Any:
        return self.cross(ax, ay, bx, by)

    def sum_over_listed(
        self,
        first: Any,
        end: Any,
        runs: Any,
        term: Callable[..., Values],
        values: int,
        *samples: Any,
    ) -> list[Any]:
        totals = [0.0] * values
        for begin, stop, level, _ in runs[first:end]:
            for number in range(begin, stop):
                found = term(number, level, *samples)
                totals = [a + b for a, b in zip(totals, found, strict=True)]
        return totals

    def sum_over_each(
        self, first: Any, end: Any, term: Callable[..., Values], values: int, *samples: Any
    ) -> list[Any]:
        return self.sum_over_range(first, end, lambda row: term(row, *samples), values)

    def sum_over_rows(
        self,
        first: Any,
        end: Any,
        change: Callable[..., tuple[Any, Any, Any, Values]],
        weight: Callable[..., Any],
        term: Callable[..., Values],
        values: int,
        *samples: Any,
    ) -> list[Any]:
        totals, level = [0.0] * values, 0.0
        for row in range(first, end):
            sets, start, jump, taken = change(row, *samples)
            level = start if sets else level
            factor = weight(level, jump, *taken)
            level += jump
            if factor:
                found = term(*taken, *samples)
                totals = [a + factor * b for a, b in zip(totals, found, strict=True)]
        return totals


class DrjitRows(DrjitRanges):
    """Rows for Dr.Jit arrays."""

    cross: Callable[..., Any]

    def as_float(self, number: Any) -> Any:
        return self.float_type(number)

    def reach(self, ax: Any, ay: Any, bx: Any, by: Any) -> None:
        return None

    def orientation(self, ax: Any, ay: Any, bx: Any, by: Any, reach: Any) -> Any:
        return self.cross(ax, ay, bx, by)

    def sum_over_listed(
        self,
        first: Any,
        end: Any,
        runs: Any,
        term: Callable[..., Values],
        values: int,
        *samples: Any,
    ) -> list[Any]:
        return self.sum_over_runs(
            first, end, runs, lambda number, level: term(number, level, *samples), values
        )

    def sum_over_each(
        self, first: Any, end: Any, term: Callable[..., Values], values: int, *samples: Any
    ) -> list[Any]:
        return self.sum_over_range(first, end, lambda row: term(row, *samples), values)

    def sum_over_rows(
        self,
        first: Any,
        end: Any,
        change: Callable[..., tuple[Any, Any, Any, Values]],
        weight: Callable[..., Any],
        term: Callable[..., Values],
        values: int,
        *samples: Any,
    ) -> list[Any]:
        def step(row: Any, level: Any, *sums: Any) -> Values:
            sets, start, jump, taken = change(row, *samples)
            level = self._drjit.select(sets, start, level)
            factor = weight(level, jump, *taken)
            terms = [factor * value for value in term(*taken, *samples)]
            added = tuple(zip(sums, terms, strict=False))
            lost = tuple(
                total + self._lost(a, b)
                for total, (a, b) in zip(sums[values:], added, strict=False)
            )
            return row + 1, level + jump, *(a + b for a, b in added), *lost

        # in single precision what rounding of the sums loses is summed up as well
        count = values if self._drjit.itemsize_v(self.float_type) == 8 else 2 * values
        zeros = (self.float_type(0.0) for _ in range(1 + count))
        _, _, *sums = self._drjit.while_loop(
            (self._numbers(first), *zeros), lambda row, *_: row < end, step
        )
        return [sum(sums[k::values][1:], sums[k]) for k in range(values)]
