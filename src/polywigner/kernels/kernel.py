"""A transform in three steps: enter the frame, sum over edges, leave the frame.

The steps are separate so that an engine may run the first in float64 and the second in float32.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from polywigner.kernels.functions.slices import SliceSum
from polywigner.numerics import phases

Values = tuple[Any, ...]


@dataclass(frozen=True, eq=False)
class Kernel:
    """A transform in three steps, of which ``edge_sum`` takes most of the time."""

    name: str
    dimension: int
    """Number of components of each argument."""
    tables: Callable[[Any, bool], Any]
    """(source, double) -> the constants of the kernel, with ``frame`` and ``edges``; cached."""
    enter: Callable[..., Values]
    """(ops, frame, *arguments) -> arguments in the frame."""
    edge_sum: Callable[..., Values]
    """(ops, tables, *arguments in the frame) -> sums over edges. It is a `SliceSum` if edges are
    cut, and an `OutlineSum` if grids of frequencies are computed from their axes.
    """
    leave: Callable[..., Values]
    """(ops, frame, arguments in the frame, sums) -> results, scaled to the user's units."""

    def tables_for(self, source: Any, double: bool) -> Any:
        """Return the tables of a source, from its cache if it has one."""
        known = getattr(source, "__dict__", {}).get("_tables")
        if known is None:
            return self.tables(source, double)
        tables = known.get((self, double))
        if tables is None:
            tables = known.setdefault((self, double), self.tables(source, double))
        return tables

    @property
    def slices(self) -> SliceSum | None:
        """The sum over edges if edges are cut, else None."""
        return self.edge_sum if isinstance(self.edge_sum, SliceSum) else None

    def __call__(self, ops: Any, tables: Any, *arguments: Any) -> Values:
        """Return the transform at arguments in the user's units, in one operations namespace."""
        inner = self.enter(ops, tables.frame, *arguments)
        return self.leave(ops, tables.frame, inner, self.edge_sum(ops, tables, *inner))


def leave_real(ops: Any, frame: Any, inner: Values, sums: Values) -> Values:
    """Return a real sum, scaled to the units of the user."""
    return (sums[0] * frame.measure,)


def leave_wave(ops: Any, frame: Any, inner: Values, sums: Values) -> Values:
    """Return (cosine, sine) sums, rotated by the phase of the centre and scaled.

    The phase of the centre is the first argument in the frame.
    """
    real, imag = phases.rotated(ops, inner[0], *sums)
    return real * frame.measure, imag * frame.measure
