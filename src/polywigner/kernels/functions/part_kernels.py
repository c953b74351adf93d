"""W and its moments as sums over listed parts of edges, a part for each sample of a kernel."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, ClassVar

from polywigner.geometry import Wavefront
from polywigner.kernels.cut.slice_parts import PART_COLUMNS
from polywigner.kernels.functions.edge_terms import term_of_part, wigner_terms
from polywigner.kernels.functions.moments import LAG_MOMENTS, RayFrame, weighted_moments
from polywigner.kernels.functions.partly_coherent import coherence_of, term_of_lags
from polywigner.kernels.functions.plane import tables_of
from polywigner.kernels.kernel import Kernel, Values, leave_real
from polywigner.kernels.outline.frame import Frame, Matrix


@dataclass(frozen=True)
class PartTables:
    """Properties of a source for kernels of parts: whether waves and weights differ."""

    frame: Frame
    is_aligned: bool
    is_real: bool
    coherence: Matrix | None = None
    terms: ClassVar[int] = 1


@lru_cache(maxsize=256)
def _part_tables(source: Any, double: bool) -> PartTables:
    """Tables of a source, or of a Wavefront of partly coherent light."""
    tables = tables_of(source.source if isinstance(source, Wavefront) else source, True)
    still = all(not any(wave.frequency) for group in tables.groups for wave in group)
    is_real = len(tables.groups) == 1 and not tables.phased
    light = None
    if isinstance(source, Wavefront):
        light = coherence_of(tables.frame, source.coherence_width)
    return PartTables(tables.frame, still and not any(tables.frame.carrier), is_real, light)


def _enter(ops: Any, frame: Frame, *arguments: Any) -> Values:
    """(part, detuned frequency of its waves, whole frequency, and of the ray if it is another)."""
    part, shifts, nu = arguments[:6], arguments[6:PART_COLUMNS], arguments[PART_COLUMNS:]
    detuned = frame.detuned(ops, *nu[:2])
    shifted = (n - s for n, s in zip(detuned, shifts, strict=True))
    whole = (frame.frequency(ops, *nu[k : k + 2]) for k in range(0, len(nu), 2))
    return (*part, *shifted, *(component for one in whole for component in one))


def _wigner(ops: Any, tables: PartTables, *inner: Any) -> Values:
    """A part's term of (W1) or (W2)."""
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


def _moments(ops: Any, tables: PartTables, *inner: Any) -> Values:
    """A part's term of (T3)."""
    x, y, dx, dy, real, imag = inner[:6]
    is_aligned = tables.is_aligned and len(inner) == 10
    axes = RayFrame(ops, tables.frame, inner[6:8], inner[-2:], is_aligned)
    (p, q), (dp, dq) = axes.turned(x, y), axes.turned(dx, dy)
    found = axes.of_part([p, dp], [q, dq], axes.turns(x, y), axes.turns(dx, dy))
    return tuple(weighted_moments((real, imag), *found))


PART_WIGNER = Kernel("wigner by parts", 0, _part_tables, _enter, _wigner, leave_real)
PART_PARTLY_COHERENT = replace(
    PART_WIGNER, name="wigner by parts of partly coherent light", edge_sum=_partly_coherent
)
PART_MOMENTS = Kernel("lag moments by parts", 0, _part_tables, _enter, _moments, LAG_MOMENTS.leave)
PART_MOMENTS_ALONG = replace(PART_MOMENTS, name="lag moments by parts, apart")
