"""Wigner function and the area of its lag slice, by cutting edges (Stokes' theorem).

``W = 1/(pi^2 |nu|^2) sum_e (c/q) sum_pieces sin(2 pi dt q) sin(2 pi [nu.(2a - 2x) + (t0 + t1) q])``
with q = nu.e, c = cross(nu, e), and [t0, t1] the part of edge e inside the mirrored polygon. The
two copies are mirror images, so the edges of one, doubled, are the whole boundary; only the real
part is left, in which nothing cancels as nu goes to 0. In a collection each cut edge carries the
weight of its element times the conjugate of that of the piece, and cosines appear: (W2). Several
waves on the elements are several frequencies: (I2).
"""

from __future__ import annotations

from typing import Any

from polywigner.kernels.cut.clipping import MIRRORED, Clipper, total_extent
from polywigner.kernels.cut.slice_parts import slice_parts
from polywigner.kernels.cut.slice_sums import SliceSum
from polywigner.kernels.functions.edge_terms import wigner_terms
from polywigner.kernels.functions.shared_slices import SharedSlice
from polywigner.kernels.functions.wave_sums import TermSum, mean_pairings, sum_over_waves
from polywigner.kernels.outline.tables import Edge
from polywigner.kernels.outline.waves import WavePair, WavePairRow

__all__ = ["LAG_SLICE_AREA", "WIGNER_SUM", "doubled_position"]

Values = tuple[Any, ...]


def doubled_position(x: Any, y: Any, *frequency: Any) -> tuple[Any, Any]:
    """The offset between the copies: 2x."""
    return 2.0 * x, 2.0 * y


def _wigner(clipper: Clipper, x: Any, y: Any, *nu: Any) -> Values:
    """W(x, nu) in the units of the frame, for arguments in it: docs/theory.md, (W1), (W2), (I2)."""

    def sum_of(pair: WavePair | WavePairRow, is_even: bool) -> TermSum:
        terms = wigner_terms(clipper.ops, pair.detuned(nu), is_even, pair.is_real)
        return TermSum(clipper, terms, pair, 2.0)

    return tuple(sum_over_waves(clipper, mean_pairings, sum_of, (x, y), 1))


def _lag_slice_area(clipper: Clipper, x: Any, y: Any) -> Values:
    """R_x(x) of elements without illumination: the area of the lag slice, in the frame."""
    ops = clipper.ops

    def term(edge: Edge) -> Values:
        lever = ops.fma(
            clipper.ty, 2.0 * edge.ex, ops.fma(clipper.tx, -2.0 * edge.ey, 4.0 * edge.area)
        )
        # the imaginary parts of two elements and of the same two the other way round cancel
        return (lever * total_extent(clipper, edge, MIRRORED)[0],)

    found: Values = clipper.sum_over_edges(term, values=1)
    return found


_LISTED = SharedSlice(
    arguments=slice(0, 2),
    place=slice(0, 2),
    frequency=slice(2, 4),
    list_parts=slice_parts,
    terms=lambda ops, nu, is_real: wigner_terms(ops, nu, is_real, True),
)
WIGNER_SUM = SliceSum((MIRRORED,), doubled_position, _wigner, _LISTED)
LAG_SLICE_AREA = SliceSum((MIRRORED,), doubled_position, _lag_slice_area)
