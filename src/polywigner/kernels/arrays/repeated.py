"""W, A and the field of the element that an array repeats, and tables of the copies."""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import dataclass, field
from typing import Any, Generic, TypeVar

from numpy.typing import NDArray

from polywigner.geometry import Aperture
from polywigner.kernels.functions import plane, separable
from polywigner.kernels.functions.plane import tables_of
from polywigner.kernels.functions.separable import SeparableTables, separable_tables
from polywigner.kernels.functions.slices import AMBIGUITY_SUM, WIGNER_SUM
from polywigner.kernels.outline.tables import Tables
from polywigner.numerics import Number
from polywigner.numerics.complex_pairs import Pair

ElementTables = Tables | SeparableTables


def element_tables(aperture: Aperture, double: bool) -> ElementTables:
    """Return the tables of an element for kernels in float64 (``double``) or float32."""
    return separable_tables(aperture, double) or tables_of(aperture, double)


def element_wigner(ops: Any, tables: ElementTables, x: Any, y: Any, nu_x: Any, nu_y: Any) -> Number:
    """Return W(x, nu) in the element's frame."""
    if isinstance(tables, SeparableTables):
        return separable.wigner(ops, tables, x, y, nu_x, nu_y)
    return WIGNER_SUM(ops, tables, x, y, nu_x, nu_y)[0]


def element_ambiguity(ops: Any, tables: ElementTables, *arguments: Any) -> Pair:
    """Return A(upsilon, xi) in the element's frame."""
    if isinstance(tables, SeparableTables):
        cosine, sine = separable.ambiguity(ops, tables, *arguments)
    else:
        cosine, sine = AMBIGUITY_SUM(ops, tables, 0.0, *arguments)
    return Pair(cosine, -sine)


def element_field(ops: Any, tables: ElementTables, x: Any, y: Any) -> tuple[Any, Any]:
    """Return the (real, imaginary) field u of the element in its frame, without the carrier."""
    if isinstance(tables, SeparableTables):
        return separable.field(ops, tables, x, y)
    return plane.field(ops, tables, x, y)


Element = TypeVar("Element")
Sites = TypeVar("Sites")


@dataclass(frozen=True)
class RepeatedTables(Generic[Element, Sites]):
    """Tables of an element, and the positions and weights of its copies."""

    frame: Any
    element: Element
    sites: Sites
    terms: int = 1
    """Number of copies that are summed at each sample, which determines the choice of the engine.
    """


@dataclass(frozen=True, eq=False)
class DeviceTable:
    """A table (rows, columns) that is copied once into the memory of each engine."""

    values: NDArray[Any]
    copies: dict[Hashable, Any] = field(default_factory=dict)

    def in_memory(self, ops: Any) -> Any:
        """Return the copy of the table in the memory of an engine."""
        if ops.key not in self.copies:
            self.copies[ops.key] = ops.on_device(self.values)
        return self.copies[ops.key]
