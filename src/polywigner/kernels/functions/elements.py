"""One aperture's functions in its frame, by whichever kernel is the best for its field.

Kernels of arrays of one element see it through these.
"""

from __future__ import annotations

from typing import Any

from polywigner.geometry import Aperture
from polywigner.kernels.functions import membership, separable
from polywigner.kernels.functions.ambiguity import AMBIGUITY_SUM
from polywigner.kernels.functions.plane import tables_of
from polywigner.kernels.functions.separable import SeparableTables, separable_tables
from polywigner.kernels.functions.wigner import WIGNER_SUM
from polywigner.kernels.outline.tables import Tables

__all__ = ["ElementTables", "ambiguity", "element_tables", "field", "wigner"]

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
