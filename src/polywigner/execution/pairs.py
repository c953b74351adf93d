"""Arguments of which each changes along the leading axes alone, or along the trailing ones.

Every position with every frequency: ``x`` of shape (n, 1, 2) and ``nu`` of shape (m, 2), or a
table of four dimensions. Such arguments are brought into the frame once each, not once for each
pair, and compiled kernels look them up in two short lists instead of reading them from memory.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

__all__ = ["Pairs", "one_row_of", "pairs_of"]

# In shorter rows little is shared.
_LEAST_COLUMNS = 64

Array = npt.NDArray[Any]


@dataclass(frozen=True, eq=False)
class Pairs:
    """Components of shape (rows, 1) or (1, columns) each."""

    components: tuple[Array, ...]
    rows: int
    columns: int

    def blocks(self, size: int) -> Iterator[tuple[slice, slice]]:
        """Rows and columns of blocks of about ``size`` samples, most of them of one shape."""
        columns = min(self.columns, size)
        rows = max(1, size // columns)
        for r in range(0, self.rows, rows):
            for c in range(0, self.columns, columns):
                yield slice(r, r + rows), slice(c, c + columns)

    def block(self, rows: slice, columns: slice) -> tuple[Array, ...]:
        """The components of a block, in float64."""
        chosen = (
            c[rows] if len(c) > 1 else c[:, columns] if self.columns == c.shape[1] else c
            for c in self.components
        )
        return tuple(c.astype(np.float64, copy=False) for c in chosen)

    def transposed(self) -> Pairs:
        """Rows as columns, and columns as rows."""
        return Pairs(tuple(c.T for c in self.components), self.columns, self.rows)


def one_row_of(components: Sequence[Array], shape: tuple[int, ...]) -> Pairs | None:
    """Components of which some are one number each, in one row; None for a short one."""
    columns = math.prod(shape)
    if columns < _LEAST_COLUMNS:
        return None
    whole = (c if c.size == 1 else np.broadcast_to(c, shape) for c in components)
    return Pairs(tuple(c.reshape(1, -1) for c in whole), 1, columns)


def pairs_of(components: Sequence[Array], shape: tuple[int, ...]) -> Pairs | None:
    """Components that broadcast to ``shape`` as rows and columns; None where they are none."""
    dimensions = len(shape)
    whole = [c.reshape((1,) * (dimensions - c.ndim) + c.shape) for c in components]
    best: tuple[int, int] | None = None
    for k in range(1, dimensions):
        rows, columns = math.prod(shape[:k]), math.prod(shape[k:])
        if rows < 2 or columns < _LEAST_COLUMNS:
            continue
        if all(c.size == math.prod(c.shape[:k]) or c.size == math.prod(c.shape[k:]) for c in whole):
            best = min(best or (rows + columns, k), (rows + columns, k))
    if best is None:
        return None
    k = best[1]

    def flat(component: Array) -> Array:
        if component.size == math.prod(component.shape[k:]):
            return np.broadcast_to(component.reshape(component.shape[k:]), shape[k:]).reshape(1, -1)
        leading = component.reshape(component.shape[:k])
        return np.broadcast_to(leading, shape[:k]).reshape(-1, 1)

    return Pairs(tuple(map(flat, whole)), math.prod(shape[:k]), math.prod(shape[k:]))
