"""Kernels, which compute a transform in three steps.

The steps convert the arguments to the frame of the source, sum over its edges, and convert the sums
to the user's units. The first step may be computed in float64 and the second in float32.
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
    """A transform in the three steps ``enter``, ``edge_sum`` and ``leave``."""

    name: str
    dimension: int
    """Number of components of each argument of the transform."""
    tables: Callable[[Any, bool], Any]
    """Function (source, double) that returns the cached constants of the kernel, with the
    attributes ``frame`` and ``edges``."""
    enter: Callable[..., Values]
    """Function (ops, frame, *arguments) that converts the arguments to the frame of the source."""
    edge_sum: Callable[..., Values]
    """Function (ops, tables, *arguments in the frame) that returns the sums over edges. The
    function is a `SliceSum` for W and A."""
    leave: Callable[..., Values]
    """Function (ops, frame, arguments in the frame, sums) that returns results in user units."""
    grid_tables: Callable[[Any], Any] | None = None
    """Function (source) that returns the constants of a faster method for grids of frequencies, or
    None if the source has no such method."""

    def tables_for(self, source: Any, double: bool) -> Any:
        """Return the constants of the kernel for a source, from the source's cache if possible."""
        known = getattr(source, "__dict__", {}).get("_tables")
        if known is None:
            return self.tables(source, double)
        tables = known.get((self, double))
        if tables is None:
            tables = known.setdefault((self, double), self.tables(source, double))
        return tables

    @property
    def slices(self) -> SliceSum | None:
        """Sum over clipped edges, or None if the kernel clips no edges."""
        return self.edge_sum if isinstance(self.edge_sum, SliceSum) else None

    def __call__(self, ops: Any, tables: Any, *arguments: Any) -> Values:
        """Return the transform in the user's units, computed with the operations ``ops``."""
        inner = self.enter(ops, tables.frame, *arguments)
        return self.leave(ops, tables.frame, inner, self.edge_sum(ops, tables, *inner))


def leave_real(ops: Any, frame: Any, inner: Values, sums: Values) -> Values:
    """Return a real transform in the user's units from its sum over edges."""
    return (sums[0] * frame.measure,)


def wave_sums(value: phases.Pair) -> Values:
    """Return the real part and minus the imaginary part of a complex sum, for `leave_wave`."""
    return value.real, -value.imag


def leave_wave(ops: Any, frame: Any, inner: Values, sums: Values) -> Values:
    """Return the real and imaginary part of a transform in the user's units.

    ``sums`` are the real part and minus the imaginary part, as from :func:`wave_sums`. The result
    includes the factor exp(-2 pi i phase), where the phase in cycles is the first number in
    ``inner``.
    """
    real, imag = phases.rotated(ops, inner[0], *sums)
    return real * frame.measure, imag * frame.measure
