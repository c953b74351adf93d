"""Kernels of the Wigner function in partially coherent light, (I5) of docs/theory.md.

The integrand of W contains the degree of coherence exp(-xi^2/(2 width^2)) at the lag xi. Compared
with coherent light, only the contribution of a part of an edge changes.
"""

from __future__ import annotations

import math
from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np

from polywigner.geometry import Wavefront
from polywigner.kernels.functions import intervals, plane, separable
from polywigner.kernels.functions.edge_terms import EdgeTerms
from polywigner.kernels.functions.gauss_schell import wave_over_edge
from polywigner.kernels.functions.intervals import SlitPairs
from polywigner.kernels.functions.separable import SeparableTables, separable_tables
from polywigner.kernels.functions.slices import WIGNER_SUM
from polywigner.kernels.kernel import Values
from polywigner.kernels.outline import Tables, determinant
from polywigner.numerics.phases import Pair


@lru_cache(maxsize=256)
def _tables_of(source: Wavefront, double: bool) -> Tables:
    """Return the tables of the flat source, with the matrix from lags to coherence widths."""
    tables = plane.tables_of(source.source, double)
    coherence = np.transpose(tables.frame.rows) / source.coherence_width
    return replace(tables, coherence=coherence.tolist())


class _LagTerms(EdgeTerms):
    """Contributions of parts of edges to W in partially coherent light, (I5)."""

    values, by_part = 2, True

    def __init__(self, ops: Any, tables: Tables, nu: Values, is_even: bool, is_real: bool) -> None:
        self.ops, self.coherence, self.nu = ops, tables.coherence, nu

    def of_part(self, x: Any, y: Any, dx: Any, dy: Any, real: Any, imag: Any) -> Values:
        """Return the complex integral of (I5) over a part of an edge in the frame."""
        ops, nu = self.ops, self.nu
        (xx, xy), (yx, yy) = self.coherence
        size = determinant(self.coherence)
        ux, uy = ops.fma(xx, dx, xy * dy), ops.fma(yx, dx, yy * dy)
        square = ops.fma(ux, ux, uy * uy)
        is_part = square > 0.0
        length = ops.sqrt(ops.select(is_part, square, 1.0))
        inverse = 1.0 / length
        half = ops.select(is_part, 0.5 * length, 0.0)
        ux, uy = ux * inverse, uy * inverse
        foot = ops.fma(xx, x, xy * y) * ux + ops.fma(yx, x, yy * y) * uy
        distance = ops.fma(x, dy, -(y * dx)) * (size * inverse)
        along = ops.fma(nu[0], dx, nu[1] * dy) * inverse
        across = nu[0] * (yy * uy + xy * ux) - nu[1] * (yx * uy + xx * ux)
        ends = foot - half, foot + half
        wave = Pair(*wave_over_edge(ops, *ends, distance, along, across * (1 / size)))
        term = wave.scaled(1 / size) * Pair(real, imag)
        return term.real, term.imag

    def total(self, sums: Values) -> Values:
        """Return twice the sums, which also include the mirrored edges of the other copy."""
        # The mirrored edges of the other copy of the outline contribute the complex conjugate.
        return 2.0 * sums[0], 2.0 * sums[1]


WIGNER = replace(
    plane.WIGNER,
    name="wigner of partly coherent light",
    tables=_tables_of,
    edge_sum=replace(WIGNER_SUM, terms=_LagTerms, arguments=None),
)


@lru_cache(maxsize=256)
def _pairs_of(source: Wavefront, double: bool) -> SlitPairs:
    """Return the pairs of slits of the flat source for W, with the coherence width in the frame."""
    pairs = intervals.pair_tables(source.source, double, of_lags=True)
    return replace(pairs, coherence_width=source.coherence_width / pairs.frame.measure)


WIGNER_OF_SLITS = replace(
    intervals.WIGNER, name="wigner of partly coherent light in slits", tables=_pairs_of
)


@lru_cache(maxsize=256)
def _product_of(source: Wavefront, double: bool) -> SeparableTables:
    """Return the fields along both axes of a rectangle, with coherence widths in its frame."""
    tables = separable_tables(source.source, double)
    assert tables is not None
    width_x, width_y = (source.coherence_width / math.hypot(*row) for row in tables.frame.rows)
    return replace(tables, coherence_widths=(width_x, width_y))


WIGNER_OF_PRODUCT = replace(
    separable.WIGNER, name="wigner of a partly coherent product", tables=_product_of
)
