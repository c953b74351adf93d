"""Common parts of the kernels of one element repeated many times, on a lattice or off it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

from polywigner.kernels.cut.clipping import View
from polywigner.kernels.functions.elements import ElementTables
from polywigner.kernels.kernel import Values

__all__ = ["ElementSum", "RepeatedTables", "at_both_ends"]

Sites = TypeVar("Sites")


@dataclass(frozen=True)
class RepeatedTables(Generic[Sites]):
    """The element's tables, and where its copies are and with which weights."""

    frame: Any
    element: ElementTables
    sites: Sites
    terms: int = 1
    """Terms of the sum over copies that a sample loops through, for the choice of an engine."""

    @property
    def clips(self) -> int:
        return self.element.clips


@dataclass(frozen=True, eq=False)
class ElementSum:
    """A kernel's sum over the copies of an element, whose edges are cut in one view or in two."""

    views: tuple[View, ...]
    summed: Callable[..., Values]

    def __call__(self, ops: Any, tables: Any, *inner: Any) -> Values:
        return self.summed(ops, tables, *inner)


def at_both_ends(field: Callable[..., Values]) -> Callable[..., Values]:
    """The sums of an autocorrelation from ``field(ops, tables, *place)``, both places alike."""

    def fields(ops: Any, tables: Any, turns: Any, *places: Any) -> Values:
        half = len(places) // 2
        return (*field(ops, tables, *places[:half]), *field(ops, tables, *places[half:]))

    return fields
