"""The parts of edges that bound slices, listed once for each position or lag.

Where W is wanted at each position for many frequencies, cutting edges for each pair of the two is
most of the work, and most edges are found to lie outside. The parts that are left, with the waves
and weights that go with them, do not depend on the frequency: a list of rows, over which W and the
moments (T1) are plain sums, by a kernel that is the same for all sources. So it is with A at each
lag for many frequency shifts.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from polywigner.kernels.cut.clipping import AHEAD, BEHIND, MIRRORED, View
from polywigner.kernels.cut.winding import ListedParts
from polywigner.kernels.outline.tables import Tables
from polywigner.kernels.outline.waves import difference_pairs, mean_pairs

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
            wave_pairs = mean_pairs(tables.groups[own], tables.groups[other])
            found.add(MIRRORED, own, other, _amplitudes(ops, wave_pairs, (x, y)), -0.5, 2.0)
    return found.table()


def position_slice_parts(ops: Any, tables: Tables, x: Any, y: Any) -> tuple[NDArray[np.intp], Rows]:
    """Parts of the position slices at lags (n,); vectors and middles are positions."""
    found = _Parts(ops, tables, (x, y), (x, y))
    for own in range(len(tables.groups)):
        for other in range(len(tables.groups)):
            fields = tables.groups[own], tables.groups[other]
            # the edges' field is the first factor in the view BEHIND, the second in AHEAD
            for view, side, pair in ((BEHIND, -0.5, fields), (AHEAD, 0.5, fields[::-1])):
                wave_pairs = _amplitudes(ops, difference_pairs(*pair), (x, y))
                found.add(view, own, other, wave_pairs, side, 1.0)
    return found.table()


def _amplitudes(ops: Any, wave_pairs: Any, place: tuple[Any, Any]) -> list[tuple[Any, Any, Any]]:
    return [(wave_pair.shift, *wave_pair.amplitude(ops, place)) for wave_pair in wave_pairs]


class _Parts:
    """Parts as they are found, for offsets T of the frame."""

    def __init__(self, ops: Any, tables: Tables, offset: Any, place: Any) -> None:
        self.ops, self.tables, self.count = ops, tables, place[0].size
        self.offset = tuple(np.broadcast_to(t, self.count) for t in offset)
        self.owners: list[NDArray[np.intp]] = []
        self.rows: list[Rows] = []

    def add(
        self,
        view: View,
        group: int,
        other: int,
        wave_pairs: list[tuple[Any, Any, Any]],
        side: float,
        scale: float,
    ) -> None:
        """Add parts of one group's edges inside another's, seen at ``scale (p + side T)``."""
        found = ListedParts(self.ops, self.tables, (view, group, other), *self.offset)
        edge, owner = found.edge, found.owner
        t, s = 1.0 - 0.5 * found.part, scale * found.part
        tx, ty = (side * offset[owner] for offset in self.offset)
        real, imag = (np.broadcast_to(w, len(owner)) for w in found.weight)
        if view is AHEAD:
            imag = -imag
        place = [
            scale * (edge.ax + tx + t * edge.ex),
            scale * (edge.ay + ty + t * edge.ey),
            s * edge.ex,
            s * edge.ey,
        ]
        for shift, cosine, sine in wave_pairs:
            a, b = (np.broadcast_to(v, self.count)[owner] for v in (cosine, sine))
            weight = [a * real - b * imag, a * imag + b * real]
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
