"""W and A at one place for many frequencies: the slice cut once, its boundary summed for each.

The same sums as in `wigner` and `ambiguity`, over
the parts of edges that `cut.slice_parts` has listed for a place:
docs/theory.md, (W1), (W2), (A1), (I2), (I3).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polywigner.kernels.cut.slice_parts import position_slice_parts, slice_parts, wigner_of_part
from polywigner.kernels.functions.grids import GridTables, slice_grid_tables
from polywigner.kernels.functions.plane import AMBIGUITY, WIGNER
from polywigner.kernels.functions.stokes import moved_off_zero, segment_wave
from polywigner.kernels.functions.wigner import floored, kept_off_zero, ratio_along
from polywigner.kernels.kernel import Kernel, Values
from polywigner.kernels.outline.tables import Tables
from polywigner.numerics.trigonometry import sin_turns

__all__ = ["PartSum", "SharedSlice", "shared_slice"]

Listed = tuple[NDArray[np.intp], NDArray[np.float64]]


@dataclass(frozen=True)
class SharedSlice:
    """How a kernel is a sum over parts of edges that depend on some of its arguments alone."""

    arguments: slice
    """Which components are the place on which the parts depend, as the caller gives them."""
    place: slice
    """The same in the frame."""
    frequency: slice
    """The frequency in the frame."""
    list_parts: Callable[..., Listed]
    """(ops of NumPy in double precision, tables, *place) -> whose, (k, 8) rows."""
    summed: Callable[..., PartSum]
    """(ops, columns of a row, is_real, *frequency) -> how to sum rows up."""
    is_even: bool
    """Whether it is even in the frequency where rows are of four numbers."""

    def on_grid(self, ops: Any, tables: Tables, *place: Any) -> GridTables | None:
        """Constants for grids of frequencies at one place (1,); None where there are none."""
        if not self.is_even or tables.phased or any(tables.frame.carrier):
            return None
        (_, rows), _ = self.parts(ops, tables, *place)
        if rows.shape[1] > 4:
            return None
        area = sum(edge.area for edge in tables.edges) / 2
        return slice_grid_tables(tables.frame, rows.tolist(), area)

    def parts(self, ops: Any, tables: Tables, *place: Any) -> tuple[Listed, bool]:
        """Whose the parts of places (n,) are and their rows; whether all weights are real.

        Rows are of four numbers where weights are 1 or -1 and no frequency is shifted: a part with
        the weight -1 is one that runs the other way.
        """
        owners, rows = self.list_parts(ops, tables, *place)
        order = np.argsort(owners, kind="stable")
        owners, rows = owners[order], rows[order]
        if (abs(rows[:, 4]) == 1.0).all() and not rows[:, 5:].any():
            rows[:, 2:4] *= rows[:, 4:5]
            rows = np.ascontiguousarray(rows[:, :4])
        return (owners, rows), not rows[:, 5:6].any()


class PartSum:
    """A sum over parts at given frequencies: what they share, a part's term, the end."""

    values = 1

    def __init__(self, ops: Any, columns: int, is_real: bool, nu_x: Any, nu_y: Any) -> None:
        self.ops, self.is_real = ops, is_real
        self.plain = columns == 4
        self.nu = self._off_zero(nu_x, nu_y) if self.plain else (nu_x, nu_y)

    def _off_zero(self, nu_x: Any, nu_y: Any) -> Values:
        return moved_off_zero(self.ops, nu_x, nu_y)

    def term(self, *row: Any) -> Values:
        """What a part contributes: (x, y, dx, dy), or all columns of a row."""
        raise NotImplementedError

    def total(self, sums: Values) -> Values:
        """The kernel's sums from those of all terms."""
        raise NotImplementedError


class _WignerSum(PartSum):
    """(W1) for rows of four numbers, else (W2)."""

    def _off_zero(self, nu_x: Any, nu_y: Any) -> Values:
        return floored(self.ops, nu_x, nu_y)

    def term(self, *row: Any) -> Values:
        ops, (nu_x, nu_y) = self.ops, self.nu
        if not self.plain:
            return (self._of_waves(row[:6], _detuned(row, self.nu)),)
        x, y, dx, dy = row
        along, ratio = ratio_along(ops, nu_x, nu_y, dx, dy)
        middle = ops.fma(nu_x, x, nu_y * y)
        return (ratio * (sin_turns(ops, 0.5 * along) * sin_turns(ops, middle)),)

    def _of_waves(self, part: Values, nu: Values) -> Any:
        """A part with a frequency of its own."""
        if not self.is_real:
            return wigner_of_part(self.ops, False, part, nu)
        ops, (x, y, dx, dy, weight, _) = self.ops, part
        nu_x, nu_y = floored(ops, *nu)
        along, across = kept_off_zero(ops, nu_x, nu_y, dx, dy)
        wave = sin_turns(ops, 0.5 * along) * sin_turns(ops, ops.fma(nu_x, x, nu_y * y))
        # one division for both denominators: it costs as much as a sine
        square = math.pi**2 * ops.fma(nu_x, nu_x, nu_y * nu_y)
        return weight * across * wave / (along * square)

    def total(self, sums: Values) -> Values:
        if not self.plain:
            return sums
        nu_x, nu_y = self.nu
        return (sums[0] / (math.pi**2 * self.ops.fma(nu_x, nu_x, nu_y * nu_y)),)


class _AmbiguitySum(PartSum):
    """(A1), (I3)."""

    values = 2

    def term(self, *row: Any) -> Values:
        ops, (x, y, dx, dy) = self.ops, row[:4]
        v_x, v_y = self.nu if self.plain else moved_off_zero(ops, *_detuned(row, self.nu))
        length, middle = ops.fma(v_x, dx, v_y * dy), ops.fma(v_x, x, v_y * y)
        sine, cosine = segment_wave(ops, length, middle)
        c = ops.fma(v_x, dy, -v_y * dx)
        if self.plain:
            return c * sine, c * cosine
        real, imag = row[4:6]
        c = c / ops.fma(v_x, v_x, v_y * v_y)
        if self.is_real:
            return c * real * sine, c * real * cosine
        turned = ops.fma(real, sine, -imag * cosine), ops.fma(real, cosine, imag * sine)
        return c * turned[0], c * turned[1]

    def total(self, sums: Values) -> Values:
        scale: Any = 1.0 / (2 * math.pi)
        if self.plain:
            v_x, v_y = self.nu
            scale = scale / self.ops.fma(v_x, v_x, v_y * v_y)
        return sums[0] * scale, -sums[1] * scale


def _detuned(row: Sequence[Any], nu: Values) -> Values:
    return nu[0] - row[6], nu[1] - row[7]


_WIGNER = SharedSlice(slice(0, 2), slice(0, 2), slice(2, 4), slice_parts, _WignerSum, True)
_AMBIGUITY = SharedSlice(
    slice(2, 4), slice(3, 5), slice(1, 3), position_slice_parts, _AmbiguitySum, False
)


def shared_slice(kernel: Kernel) -> SharedSlice | None:
    """How slices are shared, or None where nothing is cut or it is cut in another way."""
    return _WIGNER if kernel is WIGNER else _AMBIGUITY if kernel is AMBIGUITY else None
