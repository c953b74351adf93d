"""Ambiguity function and the area of the position slice: two shifted copies of a polygon.

``A = i/(2 pi |v|^2) sum c [sinc(q) exp(-2 pi i v.m) - 1]`` over the cut edges of both copies,
v = upsilon, q = v.e, c = cross(v, e), m the middle: the edge sum of the paper with the sum of c,
which vanishes, taken out, so that nothing is lost as v goes to 0. (Cheaper than triangles, and cut
edges are many; the frame has no slivers that would make it less accurate.)
Source: docs/theory.md, (A1), (I3).
"""

from __future__ import annotations

from typing import Any

from polywigner.kernels.cut.clipping import AHEAD, BEHIND, Clipper, total_extent
from polywigner.kernels.cut.slice_parts import position_slice_parts
from polywigner.kernels.cut.slice_sums import SliceSum
from polywigner.kernels.functions.edge_terms import ambiguity_terms
from polywigner.kernels.functions.shared_slices import SharedSlice
from polywigner.kernels.functions.wave_sums import (
    COPIES,
    TermSum,
    difference_pairings,
    sum_over_waves,
)
from polywigner.kernels.outline.tables import Edge
from polywigner.kernels.outline.waves import WavePair, WavePairRow

__all__ = ["AMBIGUITY_SUM", "POSITION_SLICE_AREA"]

Values = tuple[Any, ...]


def _lag(*inner: Any) -> tuple[Any, Any]:
    """The offset between the copies: xi, the last of the arguments."""
    return inner[-2], inner[-1]


def _ambiguity(clipper: Clipper, turns: Any, v_x: Any, v_y: Any, *xi: Any) -> Values:
    """A(upsilon, xi) in the frame, as (cosine part, sine part) with A = cosine - i sine."""

    def sum_of(pair: WavePair | WavePairRow, is_even: bool) -> TermSum:
        terms = ambiguity_terms(clipper.ops, pair.detuned((v_x, v_y)))
        return TermSum(clipper, terms, pair, 1.0)

    real, imag = sum_over_waves(clipper, difference_pairings, sum_of, xi, 2)
    return real, -imag


def _position_slice_area(clipper: Clipper, *xi: Any) -> Values:
    """R_xi(xi), the area of the position slice in the frame, weighted by the mutual field.

    As real and imaginary part; the latter is there only for complex fields.
    """
    ops, is_phased = clipper.ops, clipper.tables.phased

    def term(edge: Edge) -> Values:
        lever = ops.fma(clipper.tx, edge.ey, clipper.ty * -edge.ex)
        real: Any = 0.0
        imag: Any = 0.0
        for view, side in COPIES:
            share = ops.fma(lever, side, edge.area)
            extent, turned = total_extent(clipper, edge, view)
            real = ops.fma(share, extent, real)
            if is_phased:
                imag = ops.fma(share, turned, imag)
        return (real, imag) if is_phased else (real,)

    real, *imag = clipper.sum_over_edges(term, values=2 if is_phased else 1)
    # not 0 times it: Dr.Jit makes a constant of that, which is as wide as the first samples were
    return 0.5 * real, 0.5 * imag[0] if imag else real - real


_LISTED = SharedSlice(
    arguments=slice(2, 4),
    place=slice(3, 5),
    frequency=slice(1, 3),
    list_parts=position_slice_parts,
    terms=lambda ops, upsilon, is_real: ambiguity_terms(ops, upsilon),
)
AMBIGUITY_SUM = SliceSum((BEHIND, AHEAD), _lag, _ambiguity, _LISTED)
POSITION_SLICE_AREA = SliceSum((BEHIND, AHEAD), _lag, _position_slice_area)
