"""One element repeated many times, on a lattice or off it: its functions, and its copies."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

from polywigner.geometry import Aperture
from polywigner.kernels.cut.clipping import View
from polywigner.kernels.functions import membership, separable
from polywigner.kernels.functions.plane import tables_of
from polywigner.kernels.functions.separable import SeparableTables, separable_tables
from polywigner.kernels.functions.slices import AMBIGUITY_SUM, WIGNER_SUM
from polywigner.kernels.kernel import Values
from polywigner.kernels.outline.tables import Tables

__all__ = [
    "ElementSum",
    "ElementTables",
    "RepeatedTables",
    "ambiguity",
    "at_both_ends",
    "element_tables",
    "field",
    "wigner",
]

ElementTables = Tables | SeparableTables


def element_tables(aperture: Aperture, double: bool) -> ElementTables:
    """The tables of an element, for float64 or float32 kernels."""
    return separable_tables(aperture, double) or tables_of(aperture, double)


def wigner(ops: Any, tables: ElementTables, x: Any, y: Any, nu_x: Any, nu_y: Any) -> Any:
    """W(x, nu) in the element's frame."""
    if isinstance(tables, SeparableTables):
        return separable.wigner(ops, tables, x, y, nu_x, nu_y)
    return WIGNER_SUM(ops, tables, x, y, nu_x, nu_y)[0]


def ambiguity(
    ops: Any, tables: ElementTables, upsilon_x: Any, upsilon_y: Any, xi_x: Any, xi_y: Any
) -> tuple[Any, Any]:
    """A(upsilon, xi) in the element's frame as (cosine part, sine part)."""
    if isinstance(tables, SeparableTables):
        return separable.ambiguity(ops, tables, upsilon_x, upsilon_y, xi_x, xi_y)
    real, imag = AMBIGUITY_SUM(ops, tables, 0.0, upsilon_x, upsilon_y, xi_x, xi_y)
    return real, imag


def field(ops: Any, tables: ElementTables, x: Any, y: Any) -> tuple[Any, Any]:
    """(real, imaginary) part of u at a point of the element's frame, less the carrier's phase."""
    if isinstance(tables, SeparableTables):
        return separable.field(ops, tables, x, y)
    return membership.field(ops, tables, x, y)


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
