"""Arrays on a lattice, every place with every frequency: which copies count, and their factors.

Which copies of the element count at a place, and where it lies among them, is found once for all
frequencies; factors once for each midpoint (or difference) of sites and each frequency, however
many places there are. Source: docs/theory.md, (L1), (L2).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polywigner.kernels.arrays import lattice_arrays
from polywigner.kernels.arrays.array_frames import ArrayFrame, steps_of
from polywigner.kernels.functions.elements import ambiguity, wigner
from polywigner.kernels.kernel import Kernel, Values
from polywigner.numerics.complex_pairs import Pair
from polywigner.numerics.trigonometry import cos_sin_turns

__all__ = ["Copies", "SharedCopies", "shared_copies"]

# Factors of more midpoints and frequencies than this are too large a table,
_MOST_FACTORS = 1 << 22
# and it repays only if each is looked up several times.
_LEAST_USES = 2

Floats = NDArray[np.floating[Any]]


@dataclass(frozen=True, eq=False)
class Copies:
    """Copies that hold places (rows,): row k has those from ``ends[k]`` to ``ends[k + 1]``."""

    ends: NDArray[np.intp]
    x: Floats
    """The place in the frame of each copy's element."""
    y: Floats
    number: NDArray[np.intp]
    """Number of the factor of each copy."""
    factors: tuple[Floats, ...]
    """(numbers, frequencies) each: real, and imaginary parts if there are any."""


@dataclass(frozen=True)
class SharedCopies:
    """How a kernel of a lattice is a sum over copies; slices are of its arguments."""

    arguments: slice
    """The place, as the caller gives it."""
    first: slice
    """In the frame: the first step that counts, and the place from there,"""
    place: slice
    turns: slice
    frequency: slice
    step: float
    """of how many steps of the lattice."""
    values: int
    counts: Callable[[ArrayFrame, Any, Any], Any]
    factor: Callable[..., Values]
    """(ops, tables, turns) -> (steps) -> its parts."""
    term: Callable[..., Values]
    """(ops, the element's tables, place, frequency, factor) -> sums."""

    def gains(self, tables: Any, inner: Values) -> bool:
        """Whether to list copies gains anything, for places (rows, 1) and frequencies (1, m)."""
        if any(np.shape(a)[-1] != 1 for a in (*inner[self.place], *inner[self.first])):
            return False
        row, _, steps = self._listed(tables.frame, inner)
        wanted = np.unique(steps, axis=1).shape[1]
        columns = max(np.size(t) for t in inner[self.turns])
        return wanted * columns <= _MOST_FACTORS and wanted * _LEAST_USES <= len(row)

    def copies(self, ops: Any, tables: Any, inner: Values) -> Copies:
        """The copies that hold such places. ``ops``: of NumPy, in the precision of the factors."""
        row, (x, y), steps = self._listed(tables.frame, inner)
        known, number = np.unique(steps, axis=1, return_inverse=True)
        turns = tuple(np.asarray(t, ops.dtype) for t in inner[self.turns])
        shape = known.shape[1], max(np.size(t) for t in turns)
        sums = tuple(values[:, None].astype(ops.dtype) for values in known)
        factors = tuple(
            np.broadcast_to(np.asarray(part, ops.dtype), shape)
            for part in self.factor(ops, tables, turns, sums)
        )
        ends = np.searchsorted(row, np.arange(len(inner[self.place][0]) + 1))
        return Copies(ends, x, y, number.ravel(), factors)

    def _listed(self, frame: ArrayFrame, inner: Values) -> tuple[Any, Any, Any]:
        """Rows of copies that may count, places in their frames, and steps to them."""
        place, first = inner[self.place], inner[self.first]
        windows = frame.means if self.step == 0.5 else frame.differences
        k, m, dx, dy = np.array(steps_of(frame, windows, self.step)).T
        with np.errstate(invalid="ignore"):
            x, y = place[0] - dx, place[1] - dy
            row, which = np.nonzero(self.counts(frame, x, y))
        steps = np.stack([first[0][row, 0] + k[which], first[1][row, 0] + m[which]])
        return row, (x[row, which], y[row, which]), steps


def _mean_factor(ops: Any, tables: Any, turns: Values, sums: Values) -> Values:
    return (tables.sites.at_means(ops, turns)(sums, sums, sums[0] == sums[0]),)


def _difference_factor(ops: Any, tables: Any, turns: Values, steps: Values) -> Values:
    factor = tables.sites.at_differences(ops, turns)(steps, steps)
    slope = tables.frame.slope
    if any(slope):
        phase = steps[0] * slope[0] + steps[1] * slope[1]
        factor = factor * Pair(*cos_sin_turns(ops, phase))
    return factor.real, factor.imag


def _wigner_term(ops: Any, part: Any, place: Values, nu: Values, factor: Values) -> Values:
    return (factor[0] * wigner(ops, part, *place, *nu),)


def _ambiguity_term(ops: Any, part: Any, xi: Values, upsilon: Values, factor: Values) -> Values:
    cosine, sine = ambiguity(ops, part, *upsilon, *xi)
    found = Pair(*factor) * Pair(cosine, -sine)
    return found.real, -found.imag


def _lags_count(frame: ArrayFrame, x: Any, y: Any) -> Any:
    """Whether A of the element may differ from 0: at differences of points of the outline's box."""
    (x0, y0), (x1, y1) = frame.support
    return (abs(x) < x1 - x0) & (abs(y) < y1 - y0)


_WIGNER = SharedCopies(
    arguments=slice(0, 2),
    first=slice(0, 2),
    place=slice(2, 4),
    turns=slice(4, 6),
    frequency=slice(6, 8),
    step=0.5,
    values=1,
    counts=lambda frame, x, y: frame.may_count(x, y),
    factor=_mean_factor,
    term=_wigner_term,
)
_AMBIGUITY = SharedCopies(
    arguments=slice(2, 4),
    first=slice(1, 3),
    place=slice(3, 5),
    turns=slice(5, 7),
    frequency=slice(7, 9),
    step=1.0,
    values=2,
    counts=_lags_count,
    factor=_difference_factor,
    term=_ambiguity_term,
)


def shared_copies(kernel: Kernel) -> SharedCopies | None:
    """How a kernel of an array on a lattice is shared, None for all others."""
    if kernel is lattice_arrays.WIGNER:
        return _WIGNER
    return _AMBIGUITY if kernel is lattice_arrays.AMBIGUITY else None
