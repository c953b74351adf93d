"""Tables of a source as memory of an engine instead of constants of its code.

An outline that changes from call to call, as in an optimisation, then runs through one compiled
kernel: as long as as many edges meet as many pieces in the same way.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

from polywigner.execution.aligned import array_of
from polywigner.execution.operations import DrjitOperations
from polywigner.kernels.functions.fourier import OutlineTables
from polywigner.kernels.outline.frame import Frame
from polywigner.kernels.outline.tables import Tables
from polywigner.numerics import phases

__all__ = ["TracedOperations", "UnrolledOperations", "as_data", "with_frame_as_data"]


class TracedOperations(DrjitOperations):
    """Edges are rows of tables, and never code."""

    target = "data"

    def sum_over(self, rows: Any, term: Any, values: int, like: Any, *, unroll: bool = True) -> Any:
        return super().sum_over(rows, term, values, like, unroll=False)


class UnrolledOperations(DrjitOperations):
    """Terms of a sum are code, however many: where each has arrays of its own."""

    def sum_over(self, rows: Any, term: Any, values: int, like: Any, *, unroll: bool = True) -> Any:
        if unroll:
            return self.sum_large_terms(rows, term, 0)
        return super().sum_over(rows, term, values, like, unroll=False)


@dataclass(frozen=True)
class _DataFrame(Frame):
    """A frame whose centre is in memory, as pairs of floats."""

    def position(self, ops: Any, x: Any, y: Any) -> tuple[Any, Any]:
        pairs: Any = self.centre
        nearest = tuple(high for high, _ in pairs)
        kept = {field.name: getattr(self, field.name) for field in fields(Frame)}
        return Frame(**{**kept, "centre": nearest}).position(ops, x, y)


def with_frame_as_data(ops: DrjitOperations, tables: Tables) -> Tables:
    """Tables with the centre of their frame in memory; their lists are so in any case."""
    held = _Held(ops)
    pairs = [phases.doubled(c, ops.double) for c in tables.frame.centre]
    centre = [(held.add(high), held.add(low)) for high, low in pairs]
    held.send()
    return replace(tables, frame=_framed(tables.frame, held, centre))


def as_data(ops: DrjitOperations, tables: Any) -> Any:
    """Tables of an aperture or an array with arrays of one entry in place of numbers."""
    held = _Held(ops)
    pairs = [phases.doubled(c, ops.double) for c in tables.frame.centre]
    centre = [(held.add(high), held.add(low)) for high, low in pairs]
    if isinstance(tables, OutlineTables):
        held.send()
        return replace(tables, frame=_framed(tables.frame, held, centre))
    names = ("dx", "dy", "offset", "px", "py")
    lines = [{name: held.add(getattr(line, name)) for name in names} for line in tables.lines]
    weights = [(held.add(piece.real), held.add(piece.imag)) for piece in tables.pieces]
    held.send()
    pieces = tables.pieces
    if not tables.uniform:
        pieces = tuple(
            replace(piece, real=held[real], imag=held[imag])
            for piece, (real, imag) in zip(pieces, weights, strict=True)
        )
    found = zip(tables.lines, lines, strict=True)
    return replace(
        tables,
        frame=_framed(tables.frame, held, centre),
        lines=tuple(replace(line, **{n: held[k] for n, k in own.items()}) for line, own in found),
        pieces=pieces,
    )


def _framed(frame: Frame, held: _Held, centre: Sequence[tuple[int, int]]) -> _DataFrame:
    kept = {field.name: getattr(frame, field.name) for field in fields(Frame)}
    kept["centre"] = tuple((held[high], held[low]) for high, low in centre)
    return _DataFrame(**kept)


class _Held:
    """Numbers of one array, looked up one by one."""

    def __init__(self, ops: DrjitOperations) -> None:
        self.ops = ops
        self.values: list[float] = []
        self.memory: Any = None

    def add(self, value: float) -> int:
        self.values.append(float(value))
        return len(self.values) - 1

    def send(self) -> None:
        self.memory = array_of(self.ops.float_type, self.values)

    def __getitem__(self, index: int) -> Any:
        import drjit as dr

        kind = self.ops.float_type
        return dr.gather(kind, self.memory, dr.uint32_array_t(kind)(index))
