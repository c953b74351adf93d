"""Sums over rows of tables for NumPy arrays, of those rows only that matter to a sample."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

__all__ = ["sums_of_some"]

Array = npt.NDArray[Any]

# Values of a temporary array that stay in the cache of one core.
_BLOCK = 1 << 14
# Rows that are listed at a time, of which most are then left out.
_LISTED = 1 << 17


def sums_of_some(
    first: Array,
    end: Array,
    keep: Callable[..., Any],
    term: Callable[..., Sequence[Any]],
    values: int,
    samples: Sequence[Any],
) -> list[Array]:
    """The sums of ``term(row, *samples)`` for rows from ``first`` up to ``end`` that are kept.

    In float64. Of arrays (n, 1) and (1, m), ranges and what is kept are for the n.
    """
    shape = np.broadcast_shapes(np.shape(first), *map(np.shape, samples)) or (1,)
    by_rows = len(shape) == 2 and np.shape(first) == (shape[0], 1)
    flat = [np.asarray(a) for a in (first, end, *samples)]
    if not by_rows:
        flat = [a if a.size == 1 else np.broadcast_to(a, shape).ravel() for a in flat]
        flat[:2] = [np.broadcast_to(a.ravel(), math.prod(shape)) for a in flat[:2]]
    begin, counts, samples = flat[0].ravel(), (flat[1] - flat[0]).ravel(), tuple(flat[2:])
    column = (slice(None), None) if by_rows else slice(None)
    totals = [np.zeros(shape if by_rows else len(begin)) for _ in range(values)]
    for owner, row in _listed(begin, counts):
        kept = keep(row[column], *_of(samples, owner, len(begin)))
        (kept,) = np.nonzero(np.ravel(kept))
        for part in _blocks(kept, max(1, _BLOCK * len(begin) // totals[0].size)):
            own = owner[part]
            terms = term(row[part][column], *_of(samples, own, len(begin)))
            for total, found in zip(totals, terms, strict=True):
                np.add.at(total, own, found)
    return [total.reshape(shape) for total in totals]


def _listed(first: Array, counts: Array) -> Iterator[tuple[Array, Array]]:
    """Whose, and row, of all rows from each first on; some at a time."""
    ends = counts.cumsum()
    starts = ends - counts
    for begin in range(0, int(ends[-1]) if len(ends) else 0, _LISTED):
        number = np.arange(begin, min(begin + _LISTED, int(ends[-1])))
        owner = np.searchsorted(ends, number, side="right")
        yield owner, first[owner] + (number - starts[owner])


def _blocks(numbers: Array, size: int) -> Iterator[Array]:
    return (numbers[k : k + size] for k in range(0, len(numbers), size))


def _of(samples: Sequence[Array], owner: Array, count: int) -> list[Array]:
    """The samples of some owners, of ``count``; what is one for all as it is."""
    return [a[owner] if a.ndim and len(a) == count else a for a in samples]
