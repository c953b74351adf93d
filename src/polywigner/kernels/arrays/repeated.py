"""Common parts of the kernels of one element repeated many times, on a lattice or off it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Generic, TypeVar

from polywigner.kernels.functions.elements import ElementTables
from polywigner.kernels.kernel import Values
from polywigner.kernels.outline.tables import Piece

__all__ = ["RepeatedTables", "at_both_ends"]

Sites = TypeVar("Sites")


@dataclass(frozen=True)
class RepeatedTables(Generic[Sites]):
    """The element's tables, and where its copies are and with which weights."""

    frame: Any
    element: ElementTables
    edges: tuple[Any, ...]
    """Edges of the element over which this part of a sum runs."""
    sites: Sites
    sums_per_edge: int = 1
    """Sums over an edge that a kernel unrolls, for several copies: what splitting it counts."""
    terms: int = 1
    """Terms of the sum over copies that a sample loops through, for the choice of an engine."""

    @property
    def part(self) -> ElementTables:
        """The element with these edges only."""
        return replace(self.element, edges=self.edges)

    @property
    def pieces(self) -> tuple[Piece, ...]:
        return self.element.pieces

    @property
    def clips(self) -> int:
        return self.part.clips

    @property
    def waves_per_cut(self) -> int:
        return self.element.waves_per_cut * self.sums_per_edge


def at_both_ends(field: Callable[..., Values]) -> Callable[..., Values]:
    """The sums of an autocorrelation from ``field(ops, tables, *place)``, both places alike."""

    def fields(ops: Any, tables: Any, turns: Any, *places: Any) -> Values:
        half = len(places) // 2
        return (*field(ops, tables, *places[:half]), *field(ops, tables, *places[half:]))

    return fields
