"""The parts of edges that bound lag slices, listed once for each position.

Where W is wanted at each position for many frequencies, cutting edges for each pair of the two is
most of the work, and most edges are found to lie outside. The parts that are left, with the waves
and weights that go with them, do not depend on the frequency: a list of rows, over which W and the
moments (T1) are plain sums, by a kernel that is the same for all sources.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polywigner.kernels.clipping import MIRRORED, Clipper
from polywigner.kernels.frame import Frame
from polywigner.kernels.kernel import Kernel, Values, leave_real
from polywigner.kernels.moments import LAG_MOMENTS, RayFrame
from polywigner.kernels.plane import tables_of
from polywigner.kernels.stokes import moved_off_zero, segment_wave
from polywigner.kernels.tables import Edge, Tables
from polywigner.kernels.trigonometry import sin_turns, sinc
from polywigner.kernels.waves import mean_beats

__all__ = ["PART_COLUMNS", "PART_MOMENTS", "PART_WIGNER", "slice_parts"]

# What rounding may part two pieces of a cut edge by, as a fraction of it.
_ADJOINING = 1e-13

PART_COLUMNS = 8
"""Middle and vector of a part, in the frame and as a lag; the complex weight; the shift of nu."""

Rows = NDArray[np.float64]


def slice_parts(ops: Any, tables: Tables, x: Any, y: Any) -> tuple[NDArray[np.intp], Rows]:
    """The parts of the slices at positions (n,) of the frame: whose each is (k,), rows (k, 8).

    ``ops`` are those of NumPy in double precision. One edge at a time; memory for the parts found.
    """
    clipper = Clipper(ops, tables, 2.0 * x, 2.0 * y)
    owners: list[Any] = []
    rows: list[Any] = []
    for group, own in enumerate(tables.groups):
        for other, waves in enumerate(tables.groups):
            beats = [(beat.shift, *beat.amplitude(ops, (x, y))) for beat in mean_beats(own, waves)]
            for edge in clipper.edges_of(group):
                for found, low, high, real, imag in _joined(clipper, edge, other, x.shape):
                    t, s = low + high, 2.0 * (high - low)
                    place = [
                        2.0 * edge.ax - clipper.tx[found] + t * edge.ex,
                        2.0 * edge.ay - clipper.ty[found] + t * edge.ey,
                        s * edge.ex,
                        s * edge.ey,
                    ]
                    for shift, cosine, sine in beats:
                        a, b = (np.broadcast_to(v, x.shape)[found] for v in (cosine, sine))
                        weight = [a * real - b * imag, a * imag + b * real]
                        owners.append(found)
                        rows.append(_stacked(place + weight, shift))
    if not rows:
        return np.empty(0, np.intp), np.empty((0, PART_COLUMNS))
    return np.concatenate(owners), np.concatenate(rows)


def _joined(
    clipper: Clipper, edge: Edge, group: int, shape: tuple[int, ...]
) -> Iterator[tuple[NDArray[np.intp], Any, Any, float, float]]:
    """(whose, from, to, weight) of the parts of an edge, those in adjoining pieces as one."""
    by_weight: dict[tuple[float, float], list[Any]] = {}
    for middle, extent, real, imag in clipper.intervals(edge, MIRRORED, group):
        ends = np.broadcast_arrays(
            0.5 * (middle - extent), 0.5 * (middle + extent), np.empty(shape)
        )
        by_weight.setdefault((real, imag), []).append(ends[:2])
    for (real, imag), intervals in by_weight.items():
        low, high = np.array(intervals).swapaxes(0, 1)
        low = np.where(high > low, low, np.inf)  # empty ones last
        order = np.argsort(low, axis=0)
        low, high = (np.take_along_axis(v, order, axis=0) for v in (low, high))
        start, end = low[0], high[0]
        for k in range(1, len(low) + 1):
            last = k == len(low)
            adjoins = np.zeros(shape, bool) if last else abs(low[k] - end) <= _ADJOINING
            (found,) = np.nonzero(~adjoins & (start < np.inf))
            if len(found):
                yield found, start[found], end[found], real, imag
            if not last:
                start, end = np.where(adjoins, start, low[k]), high[k]


def _stacked(columns: list[Any], shift: tuple[float, ...]) -> Rows:
    table = np.empty((len(columns[0]), PART_COLUMNS))
    table[:, :6] = np.stack(columns, axis=-1)
    table[:, 6:] = shift
    return table


@dataclass(frozen=True)
class PartTables:
    """What the kernels of parts need to know of a source: whether waves and weights differ."""

    frame: Frame
    is_aligned: bool
    is_real: bool
    edges: tuple[int, ...] = (0,)  # one sum, of nothing that could be split


@lru_cache(maxsize=256)
def _part_tables(source: Any, double: bool) -> PartTables:
    tables = tables_of(source, True)
    still = all(not any(wave.frequency) for group in tables.groups for wave in group)
    is_real = len(tables.groups) == 1 and not tables.phased
    return PartTables(tables.frame, still and not any(tables.frame.carrier), is_real)


def _enter(ops: Any, frame: Frame, *arguments: Any) -> Values:
    """(part, detuned frequency of its waves, whole frequency)."""
    part, nu = arguments[:6], arguments[PART_COLUMNS:]
    detuned = frame.detuned(ops, *nu)
    shifted = (n - s for n, s in zip(detuned, arguments[6:PART_COLUMNS], strict=True))
    return (*part, *shifted, *frame.frequency(ops, *nu))


def _wigner(ops: Any, tables: PartTables, *inner: Any) -> Values:
    """A part's term of (W2)."""
    x, y, dx, dy, real, imag = inner[:6]
    nu_x, nu_y = moved_off_zero(ops, *inner[6:8])
    fma = ops.fma
    length, middle = fma(nu_x, dx, nu_y * dy), fma(nu_x, x, nu_y * y)
    if tables.is_real:
        wave = real * sinc(ops, length) * sin_turns(ops, middle)
    else:
        sine, cosine = segment_wave(ops, length, middle)
        wave = fma(real, sine, -imag * cosine)
    square = math.pi * fma(nu_x, nu_x, nu_y * nu_y)
    return (fma(nu_x, dy, -nu_y * dx) * wave / square,)


def _moments(ops: Any, tables: PartTables, *inner: Any) -> Values:
    """A part's term of (T3)."""
    x, y, dx, dy, real, imag = inner[:6]
    axes = RayFrame(ops, tables.frame, inner[6:8], inner[8:10], tables.is_aligned)
    (p, q), (dp, dq) = axes.turned(x, y), axes.turned(dx, dy)
    found = axes.of_part([p, dp], [q, dq], axes.turns(x, y), axes.turns(dx, dy))
    even = [2.0 * (real * a - imag * b) for a, b in zip(*found, strict=True)]
    odd = [-2.0 * (real * b + imag * a) for a, b in zip(*found, strict=True)]
    return (even[0], odd[1], even[2], even[3], odd[4], odd[5])


PART_WIGNER = Kernel("wigner by parts", 0, _part_tables, _enter, _wigner, leave_real)
PART_MOMENTS = Kernel("lag moments by parts", 0, _part_tables, _enter, _moments, LAG_MOMENTS.leave)
