"""Kernels: transforms in three steps, which enter the frame, sum over edges, and leave the frame.

The steps are separate, so that an engine may compute the first in float64 and the second in
float32.
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
    """Number of components of each argument of the transform."""
    tables: Callable[[Any, bool], Any]
    """Function (source, double) -> cached constants of the kernel, with the attributes ``frame``
    and ``edges``."""
    enter: Callable[..., Values]
    """Function (ops, frame, *arguments) -> arguments in the frame."""
    edge_sum: Callable[..., Values]
    """Function (ops, tables, *arguments in the frame) -> sums over edges. It is a `SliceSum` if the
    kernel cuts edges, and an `OutlineSum` if F on grids is computed from the axes of the grids."""
    leave: Callable[..., Values]
    """Function (ops, frame, arguments in the frame, sums) -> results in the user's units."""

    def tables_for(self, source: Any, double: bool) -> Any:
        """Return the tables of a source, from the cache of the source if it has one."""
        known = getattr(source, "__dict__", {}).get("_tables")
        if known is None:
            return self.tables(source, double)
        tables = known.get((self, double))
        if tables is None:
            tables = known.setdefault((self, double), self.tables(source, double))
        return tables

    @property
    def slices(self) -> SliceSum | None:
        """The sum over cut edges; None if the kernel cuts no edges."""
        return self.edge_sum if isinstance(self.edge_sum, SliceSum) else None

    def __call__(self, ops: Any, tables: Any, *arguments: Any) -> Values:
        """Return the transform at arguments in the user's units, computed with ``ops``."""
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
