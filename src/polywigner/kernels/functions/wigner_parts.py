"""W as a sum over listed parts of edges, with each part as one sample of a kernel."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, ClassVar

from polywigner.geometry import Wavefront
from polywigner.kernels.cut.slice_sums import PART_COLUMNS
from polywigner.kernels.functions.edge_terms import term_of_part, wigner_terms
from polywigner.kernels.functions.partly_coherent import coherence_of, term_of_lags
from polywigner.kernels.functions.plane import tables_of
from polywigner.kernels.kernel import Kernel, Values, leave_real
from polywigner.kernels.outline.frame import Frame, Matrix


@dataclass(frozen=True)
class PartTables:
    """Properties of a source for sums over parts, a part for each sample of a kernel."""

    frame: Frame
    is_real: bool
    coherence: Matrix | None = None
    terms: ClassVar[int] = 1


@lru_cache(maxsize=256)
def _part_tables(source: Any, double: bool) -> PartTables:
    """Tables of a source, or of a Wavefront of partly coherent light."""
    is_partly = isinstance(source, Wavefront)
    tables = tables_of(source.source if is_partly else source, True)
    is_real = len(tables.groups) == 1 and not tables.phased
    light = coherence_of(tables.frame, source.coherence_width) if is_partly else None
    return PartTables(tables.frame, is_real, light)


def _enter_part(ops: Any, frame: Frame, *arguments: Any) -> Values:
    """Return the part, and the frequency relative to the frequencies of its waves."""
    part, shifts, nu = arguments[:6], arguments[6:PART_COLUMNS], arguments[PART_COLUMNS:]
    return (*part, *(n - s for n, s in zip(frame.detuned(ops, *nu), shifts, strict=True)))


def _part_wigner(ops: Any, tables: PartTables, *inner: Any) -> Values:
    """Term of (W1) or (W2) of a part."""
    terms = wigner_terms(ops, inner[6:8], tables.is_real, True)
    weight = (inner[4], 0.0 if tables.is_real else inner[5])
    return terms.total(term_of_part(ops, terms, (*inner[:4], *weight)))


def _partly_coherent(ops: Any, tables: PartTables, *inner: Any) -> Values:
    """Term of (I5) of a part and of its mirror image."""
    assert tables.coherence is not None
    x, y, dx, dy, real, imag = inner[:6]
    found = term_of_lags(ops, tables.coherence, inner[6:8], (x, y), (dx, dy))
    if tables.is_real:
        return (2.0 * real * found[0],)
    return (2.0 * (real * found[0] - imag * found[1]),)


PART_WIGNER = Kernel("wigner by parts", 0, _part_tables, _enter_part, _part_wigner, leave_real)
PART_PARTLY_COHERENT = replace(
    PART_WIGNER, name="wigner by parts of partly coherent light", edge_sum=_partly_coherent
)
