"""The parts of edges that bound slices, listed once for each position or lag.

Where W is wanted at each position for many frequencies, cutting edges for each pair of the two is
most of the work, and most edges are found to lie outside. The parts that are left, with the waves
and weights that go with them, do not depend on the frequency: a list of rows, over which W and the
moments (T1) are plain sums, by a kernel that is the same for all sources. So it is with A at each
lag for many frequency shifts.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from polywigner.kernels.cut.clipping import AHEAD, BEHIND, MIRRORED, View
from polywigner.kernels.cut.cut_matrix import CutMatrix
from polywigner.kernels.functions.moments import LAG_MOMENTS, RayFrame
from polywigner.kernels.functions.plane import tables_of
from polywigner.kernels.functions.stokes import moved_off_zero, segment_wave
from polywigner.kernels.kernel import Kernel, Values, leave_real
from polywigner.kernels.outline.frame import Frame
from polywigner.kernels.outline.tables import Tables
from polywigner.kernels.outline.waves import difference_beats, mean_beats
from polywigner.numerics.trigonometry import sin_turns, sinc

__all__ = [
    "PART_COLUMNS",
    "PART_MOMENTS",
    "PART_WIGNER",
    "position_slice_parts",
    "slice_parts",
    "wigner_of_part",
]

PART_COLUMNS = 8
"""Middle and vector of a part, in the frame and as a lag; the complex weight; the shift of nu."""

Rows = NDArray[np.float64]


def slice_parts(ops: Any, tables: Tables, x: Any, y: Any) -> tuple[NDArray[np.intp], Rows]:
    """The parts of the slices at positions (n,) of the frame: whose each is (k,), rows (k, 8).

    ``ops`` are those of NumPy in double precision.
    """
    found = _Parts(ops, tables, (2.0 * x, 2.0 * y), (x, y))
    for own in range(len(tables.groups)):
        for other in range(len(tables.groups)):
            beats = mean_beats(tables.groups[own], tables.groups[other])
            found.add(MIRRORED, own, other, _amplitudes(ops, beats, (x, y)), -0.5, 2.0)
    return found.table()


def position_slice_parts(ops: Any, tables: Tables, x: Any, y: Any) -> tuple[NDArray[np.intp], Rows]:
    """The same for the position slices at lags (n,); vectors and middles are those of positions."""
    found = _Parts(ops, tables, (x, y), (x, y))
    for own in range(len(tables.groups)):
        for other in range(len(tables.groups)):
            fields = tables.groups[own], tables.groups[other]
            # the edges' field is the first factor in the view BEHIND, the second in AHEAD
            for view, side, pair in ((BEHIND, -0.5, fields), (AHEAD, 0.5, fields[::-1])):
                beats = _amplitudes(ops, difference_beats(*pair), (x, y))
                found.add(view, own, other, beats, side, 1.0)
    return found.table()


def _amplitudes(ops: Any, beats: Any, place: tuple[Any, Any]) -> list[tuple[Any, Any, Any]]:
    return [(beat.shift, *beat.amplitude(ops, place)) for beat in beats]


class _Parts:
    """Parts as they are found, for offsets T of the frame."""

    def __init__(self, ops: Any, tables: Tables, offset: Any, place: Any) -> None:
        self.tables, self.count = tables, place[0].size
        self.cuts = CutMatrix(ops, tables, *(np.broadcast_to(t, self.count) for t in offset))
        self.owners: list[NDArray[np.intp]] = []
        self.rows: list[Rows] = []

    def add(
        self,
        view: View,
        group: int,
        other: int,
        beats: list[tuple[Any, Any, Any]],
        side: float,
        scale: float,
    ) -> None:
        """Those of one group's edges in another's pieces, seen at ``scale (p + side T)``."""
        for found in self.cuts.parts(view, group, other):
            edge, owner = found.edge, found.place
            t, s = 0.5 * (found.low + found.high), scale * (found.high - found.low)
            tx, ty = (side * offset[owner] for offset in (self.cuts.tx, self.cuts.ty))
            place = [
                scale * (edge.ax + tx + t * edge.ex),
                scale * (edge.ay + ty + t * edge.ey),
                s * edge.ex,
                s * edge.ey,
            ]
            for shift, cosine, sine in beats:
                a, b = (np.broadcast_to(v, self.count)[owner] for v in (cosine, sine))
                weight = [a * found.real - b * found.imag, a * found.imag + b * found.real]
                self.owners.append(owner)
                self.rows.append(_stacked(place + weight, shift))

    def table(self) -> tuple[NDArray[np.intp], Rows]:
        if not self.rows:
            return np.empty(0, np.intp), np.empty((0, PART_COLUMNS))
        return np.concatenate(self.owners), np.concatenate(self.rows)


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
    terms: ClassVar[int] = 1


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


def wigner_of_part(ops: Any, is_real: bool, part: Values, nu: Values) -> Any:
    """A part's term of (W2) at a detuned frequency: ``part`` is (x, y, dx, dy, real, imag)."""
    x, y, dx, dy, real, imag = part
    nu_x, nu_y = moved_off_zero(ops, *nu)
    fma = ops.fma
    length, middle = fma(nu_x, dx, nu_y * dy), fma(nu_x, x, nu_y * y)
    if is_real:
        wave = real * sinc(ops, length) * sin_turns(ops, middle)
    else:
        sine, cosine = segment_wave(ops, length, middle)
        wave = fma(real, sine, -imag * cosine)
    square = math.pi * fma(nu_x, nu_x, nu_y * nu_y)
    return fma(nu_x, dy, -nu_y * dx) * wave / square


def _wigner(ops: Any, tables: PartTables, *inner: Any) -> Values:
    return (wigner_of_part(ops, tables.is_real, inner[:6], inner[6:8]),)


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
