"""W and A at one place for many frequencies: the slice cut once, its boundary summed for each.

The terms are those of `edge_terms`, over the parts of edges that `cut.slice_parts` has listed for a
place: docs/theory.md, (W1), (W2), (A1), (I2), (I3).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polywigner.kernels.functions.edge_terms import EdgeTerms, term_of_part
from polywigner.kernels.outline.tables import Tables

__all__ = ["PartSum", "SharedSlice"]

Values = tuple[Any, ...]
Listed = tuple[NDArray[np.intp], NDArray[np.float64]]


@dataclass(frozen=True)
class SharedSlice:
    """How a kernel is a sum over parts of edges that depend on some of its arguments alone."""

    arguments: slice
    """Which components are the place on which the parts depend, as the caller gives them."""
    place: slice
    """Which arguments in the frame are this place."""
    frequency: slice
    """Which arguments in the frame are the frequency."""
    list_parts: Callable[..., Listed]
    """(ops of NumPy in double precision, tables, *place) -> whose, (k, 8) rows."""
    terms: Callable[[Any, Values, bool], EdgeTerms]
    """(ops, frequency, whether weights are real) -> a part's terms."""

    def summed(self, ops: Any, columns: int, is_real: bool, *frequency: Any) -> PartSum:
        """How to sum up rows of so many columns at a frequency."""
        return PartSum(self.terms, ops, columns == 4, is_real, frequency)

    def parts(self, ops: Any, tables: Tables, *place: Any) -> tuple[Listed, bool]:
        """Whose the parts of places (n,) are and their rows; whether all weights are real.

        Rows are of four numbers where weights are 1 or -1 and no frequency is shifted: a part with
        the weight -1 is one that runs the other way.
        """
        owners, rows = self.list_parts(ops, tables, *place)
        order = np.argsort(owners, kind="stable")
        owners, rows = owners[order], rows[order]
        if (abs(rows[:, 4]) == 1.0).all() and not rows[:, 5:].any():
            rows[:, 2:4] *= rows[:, 4:5]
            rows = np.ascontiguousarray(rows[:, :4])
        return (owners, rows), not rows[:, 5:6].any()


class PartSum:
    """A sum over parts at given frequencies: what they share, a part's term, the end."""

    def __init__(
        self, terms: Any, ops: Any, is_plain: bool, is_real: bool, frequency: Values
    ) -> None:
        self.ops, self.frequency = ops, frequency
        self.is_plain, self.is_real = is_plain, is_real
        self._at = terms
        self.terms: EdgeTerms = terms(ops, frequency, is_real)
        self.values = self.terms.values

    def term(self, *row: Any) -> Values:
        """What a part contributes: (x, y, dx, dy), or all columns of a row."""
        if self.is_plain:
            return term_of_part(self.ops, self.terms, (*row, 1.0, 0.0))
        # a part with a frequency of its own
        terms = self._at(self.ops, _detuned(row, self.frequency), self.is_real)
        part = (*row[:5], 0.0 if self.is_real else row[5])
        return terms.total(term_of_part(self.ops, terms, part))

    def total(self, sums: Values) -> Values:
        """The kernel's sums from those of all terms: W, or A as cosine and sine part."""
        first, *second = self.terms.total(sums) if self.is_plain else sums
        return (first, *(-value for value in second))


def _detuned(row: Sequence[Any], nu: Values) -> Values:
    return nu[0] - row[6], nu[1] - row[7]
