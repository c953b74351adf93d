"""Fields that are a product u(x, y) = f(x) g(y) on a rectangle, in its own axes.

All transforms are then products of two in one dimension, each a sum over the pairs of a few waves
(docs/theory.md, (I4)): a Taylor taper along both axes has 49 waves with 1225 pairs, but 7 with 28
along either axis. Which fields are such is found out from their waves.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
import numpy.typing as npt

from polywigner.geometry import Aperture
from polywigner.kernels import phases
from polywigner.kernels.complex_pairs import Pair
from polywigner.kernels.frame import Frame, frame_along, power_of_two
from polywigner.kernels.kernel import Values
from polywigner.kernels.line_fields import LineField, line_field
from polywigner.kernels.tables import Piece
from polywigner.kernels.waves import Wave, Waves, carrier_of, waves_in_frame

__all__ = [
    "SeparableTables",
    "ambiguity",
    "enter_frequency",
    "field",
    "fourier",
    "is_separable",
    "separable_tables",
    "wigner",
]

# An outline counts as a rectangle if it misses one by less than this share of its shorter side
# (one that is turned and lies off the origin does by rounding), and amplitudes as a product by this
# share of the largest: neither moves W by 1e-13 of the energy.
_RECTANGLE, _PRODUCT = 1e-14, 4e-15
# Frequencies along an axis that agree to this, in cycles per side or of the largest, are one.
_EQUAL = 1e-14
# What a pair of waves counts as, in cuts of an edge.
_CLIPS_PER_PAIR = 0.5

Floats = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class SeparableTables:
    """The field along either axis of the rectangle, in its frame."""

    frame: Frame
    fields: tuple[LineField, LineField]
    edges: tuple[Any, ...] = ((),)
    """Nothing is cut."""
    pieces: tuple[Piece, ...] = ()
    waves_per_cut: int = 1

    @property
    def clips(self) -> int:
        return int(_CLIPS_PER_PAIR * sum(field.pairs for field in self.fields))


def is_separable(aperture: Aperture) -> bool:
    """Whether an aperture is a rectangle with a field of several waves that is a product."""
    return separable_tables(aperture, True) is not None


@lru_cache(maxsize=256)
def separable_tables(aperture: Aperture, double: bool) -> SeparableTables | None:
    """The tables of a field that is a product on a rectangle; None of any other."""
    illumination = aperture.illumination
    if illumination is None or len(illumination.amplitudes) < 2:
        return None
    corners = _rectangle(aperture)
    if corners is None:
        return None
    frame = _frame(corners, carrier_of([illumination], 2))
    profiles = _profiles(waves_in_frame(illumination, frame))
    if profiles is None:
        return None
    halves = np.abs(frame.vertices(corners)).max(axis=0).tolist()
    one, two = (line_field(half, waves) for half, waves in zip(halves, profiles, strict=True))
    return SeparableTables(frame, (one, two))


def _rectangle(aperture: Aperture) -> Floats | None:
    """The four corners (4, 2) of an aperture that is a rectangle."""
    if len(aperture.rings) != 1:
        return None
    (ring,) = aperture.rings
    before, after = ring - np.roll(ring, 1, axis=0), np.roll(ring, -1, axis=0) - ring
    turn = before[:, 0] * after[:, 1] - before[:, 1] * after[:, 0]
    sizes = np.hypot(*before.T) * np.hypot(*after.T)
    corners = ring[np.abs(turn) > 1e-12 * sizes]
    if len(corners) != 4:
        return None
    first, second = corners[1] - corners[0], corners[3] - corners[0]
    lengths = np.hypot(*first), np.hypot(*second)
    skew = abs(first @ second) / max(lengths)
    gap = np.abs(corners[2] - corners[1] - second).max()
    straight = _distance_from_sides(ring, corners)
    return corners if max(skew, gap, straight) <= _RECTANGLE * min(lengths) else None


def _distance_from_sides(ring: Floats, corners: Floats) -> float:
    """How far the vertices lie from the nearest line through a side."""
    along = np.roll(corners, -1, axis=0) - corners
    along = along / np.hypot(*along.T)[:, None]
    apart = ring[:, None] - corners
    return float(np.abs(apart[..., 0] * along[:, 1] - apart[..., 1] * along[:, 0]).min(1).max())


def _frame(corners: Floats, carrier: tuple[float, ...]) -> Frame:
    first, second = corners[1] - corners[0], corners[3] - corners[0]
    if first.all():  # not along an axis
        length, width = (float(np.hypot(*side)) for side in (first, second))
        direction = (float(first[0]) / length, float(first[1]) / length)
    else:
        length, width = np.ptp(corners, axis=0).tolist()
        direction = (1.0, 0.0)
    low, high = corners.min(axis=0), corners.max(axis=0)
    sizes = (power_of_two(length), power_of_two(width))
    frame = frame_along(corners, low + (high - low) / 2, direction, sizes)
    return replace(frame, carrier=carrier)


def _profiles(waves: Waves) -> tuple[Waves, Waves] | None:
    """The waves along either axis of which these are the products."""
    frequencies = np.array([wave.frequency for wave in waves])
    amplitudes = np.array([wave.amplitude for wave in waves])
    (own, i), (other, j) = (_distinct(column) for column in frequencies.T)
    if len(own) * len(other) != len(waves):
        return None
    table = np.zeros((len(own), len(other)), np.complex128)
    table[i, j] = amplitudes
    k, m = np.unravel_index(int(np.argmax(np.abs(table))), table.shape)
    column, row = table[:, m] / table[k, m], table[k, :]
    if np.abs(np.outer(column, row) - table).max() > _PRODUCT * abs(table[k, m]):
        return None
    return _line_waves(column, own), _line_waves(row, other)


def _distinct(values: Floats) -> tuple[Floats, npt.NDArray[np.intp]]:
    """The different ones in order, those that rounding alone tells apart as one; numbers of all."""
    order = np.argsort(values)
    tolerance = _EQUAL * max(1.0, float(np.abs(values).max()))
    number = np.cumsum(np.diff(values[order], prepend=values[order[0]]) > tolerance)
    found = np.empty(len(values), np.intp)
    found[order] = number
    return np.bincount(found, values) / np.bincount(found), found


def _line_waves(amplitudes: npt.NDArray[np.complex128], frequencies: Floats) -> Waves:
    pairs = zip(amplitudes.tolist(), frequencies.tolist(), strict=True)
    return tuple(Wave(amplitude, (frequency,)) for amplitude, frequency in pairs)


def enter_frequency(ops: Any, frame: Frame, *nu: Any) -> Values:
    """(phase of the centre, nu in the frame less the carrier)."""
    return (phases.turns_to_centre(ops, frame.centre, *nu), *frame.detuned(ops, *nu))


def wigner(ops: Any, tables: SeparableTables, x: Any, y: Any, nu_x: Any, nu_y: Any) -> Any:
    """W(x, nu) in the frame. Source: (I4)."""
    one, two = tables.fields
    return one.wigner(ops, x, nu_x) * two.wigner(ops, y, nu_y)


def ambiguity(
    ops: Any, tables: SeparableTables, upsilon_x: Any, upsilon_y: Any, xi_x: Any, xi_y: Any
) -> tuple[Any, Any]:
    """A(upsilon, xi) in the frame as (cosine part, sine part), A = cosine - i sine."""
    one, two = tables.fields
    return _parts(one.ambiguity(ops, upsilon_x, xi_x) * two.ambiguity(ops, upsilon_y, xi_y))


def fourier(ops: Any, tables: SeparableTables, nu_x: Any, nu_y: Any) -> tuple[Any, Any]:
    """F(nu) in the frame as (cosine part, sine part)."""
    one, two = tables.fields
    return _parts(one.fourier(ops, nu_x) * two.fourier(ops, nu_y))


def field(ops: Any, tables: SeparableTables, x: Any, y: Any) -> tuple[Any, Any]:
    """(real, imaginary) part of u at a place of the frame, less the carrier's phase.

    Lower ends of either axis belong to the rectangle, upper ones do not.
    """
    one, two = tables.fields
    value = one.field(ops, x) * two.field(ops, y)
    return value.real, value.imag


def _parts(value: Pair) -> tuple[Any, Any]:
    return value.real, -value.imag
