"""Whole edges of many slices at one frequency, from sums along the outline made beforehand.

An edge that lies inside the other copy as a whole contributes a wave whose phase depends on the
place through the copies' offset T alone: for W, exp(-2 pi i nu.T) times something that depends on
the edge and the frequency. Sums of that something along the outline, one for each frequency of an
outer product, make of a run of edges the difference of two of them: docs/theory, (K2).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polywigner.kernels.cut.clipping import AHEAD, MIRRORED, View
from polywigner.kernels.functions.stokes import moved_off_zero, segment_wave
from polywigner.kernels.functions.wigner import floored, ratio_along
from polywigner.kernels.outline.tables import Tables
from polywigner.numerics.trigonometry import cos_sin_turns, sin_turns

__all__ = ["RunSums", "edge_columns", "edge_waves", "has_run_sums"]

Values = tuple[Any, ...]


def has_run_sums(tables: Tables) -> bool:
    """Whether one wave with real weights is all there is; else places enter in other ways."""
    one = len(tables.groups) == 1 and len(tables.groups[0]) == 1
    return one and not tables.phased and tables.groups[0][0].amplitude == 1.0


def edge_columns(tables: Tables) -> NDArray[np.float64]:
    """(edges, 5): what :func:`edge_waves` takes of an edge: a, e and the weight."""
    return np.array([(e.ax, e.ay, e.ex, e.ey, e.real) for e in tables.edges])


def edge_waves(ops: Any, mirrored: bool, edge: Values, nu: Values) -> Values:
    """An edge's two terms at a frequency: of W (``mirrored``) sine and cosine, of A sine and
    cosine less one."""
    ax, ay, ex, ey, weight = edge
    if mirrored:
        nu_x, nu_y = floored(ops, *nu)
        q, ratio = ratio_along(ops, nu_x, nu_y, ex, ey)
        size = weight * ratio * sin_turns(ops, q)
        cosine, sine = cos_sin_turns(ops, ops.fma(nu_x, 2.0 * ax, ops.fma(nu_y, 2.0 * ay, q)))
        return size * sine, size * cosine
    v_x, v_y = moved_off_zero(ops, *nu)
    q = ops.fma(v_x, ex, v_y * ey)
    c = weight * ops.fma(v_x, ey, -v_y * ex)
    sine, cosine = segment_wave(ops, q, ops.fma(0.5, q, ops.fma(v_x, ax, v_y * ay)))
    return c * sine, c * cosine


@dataclass(frozen=True)
class RunSums:
    """Sums along the outline, looked up for a run of edges and the frequency of a sample."""

    ops: Any
    nu: Values
    """In the frame."""
    vectors: Any
    """Held, a row for each vertex: the sum of weight times e of the edges before it."""
    waves: tuple[Any, Any]
    """Held, a row for each vertex and frequency: the sums of what :func:`edge_waves` gives."""
    column: Any
    columns: Any

    def of_run(self, view: View, offset: Values, begin: Any, end: Any) -> Values:
        """What the edges from ``begin`` up to ``end`` contribute to a kernel's sums."""
        first, second = self._differences(begin, end)
        if view is MIRRORED:
            nu_x, nu_y = floored(self.ops, *self.nu)
            turns = self.ops.fma(nu_x, offset[0], nu_y * offset[1])
            cosine, sine = cos_sin_turns(self.ops, turns)
            return (cosine * first - sine * second,)
        v_x, v_y = moved_off_zero(self.ops, *self.nu)
        side = 0.5 if view is AHEAD else -0.5
        turns = side * self.ops.fma(v_x, offset[0], v_y * offset[1])
        cosine, sine = cos_sin_turns(self.ops, turns)
        half = sin_turns(self.ops, 0.5 * turns)
        vectors = (self.ops.gather(self.vectors, place) for place in (end, begin))
        ex, ey = (a - b for a, b in zip(*vectors, strict=True))
        c = self.ops.fma(v_x, ey, -v_y * ex)
        real = cosine * first + sine * (second + c)
        return real, cosine * second - 2.0 * half * half * c - sine * first

    def _differences(self, begin: Any, end: Any) -> Values:
        last, first = (place * self.columns + self.column for place in (end, begin))
        return tuple(self._read(wave, last) - self._read(wave, first) for wave in self.waves)

    def _read(self, wave: Any, place: Any) -> Any:
        """The sum for the one or four frequencies of a lane."""
        entries = self.ops.gather(wave, place)
        return self.ops.value_type(*entries) if len(entries) > 1 else entries[0]
