"""Kernels for rectangles whose field u(x, y) is a product f(x) g(y) along the sides.

All transforms are products of two transforms in one dimension, each a sum over pairs of plane
waves, (I4) of docs/theory.md. For example, a Taylor taper along both axes has 49 waves with 1,225
pairs, but only 7 waves with 28 pairs along each axis.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, ClassVar

import numpy as np
import shapely

from polywigner.geometry import Aperture
from polywigner.geometry.rings import signed_area
from polywigner.kernels.functions import plane
from polywigner.kernels.functions.intervals import LineField
from polywigner.kernels.kernel import Kernel, Values, leave_wave, wave_sums
from polywigner.kernels.outline import Frame, frame_along, power_of_two
from polywigner.kernels.wave_pairs import Wave, Waves, carrier_of, waves_in_frame
from polywigner.numerics import Floats, Indices, Number, cluster_indices, phases
from polywigner.source.lattices import column_and_row

# An outline is treated as a rectangle if its corners deviate by at most _ROUNDING times the shorter
# side, or by at most _ROUNDINGS rounding errors of the largest coordinate. The second limit cannot
# exceed _SHAPELESS times the shorter side.
_ROUNDING, _ROUNDINGS, _SHAPELESS = 1e-14, 8, 1e-6

_UNIT = np.finfo(np.float64).eps / 2


def _rectangle_of(aperture: Aperture) -> tuple[Floats, float] | None:
    """Return the corners of a rectangle, from its longer side on, and their largest allowed error.

    The result is None if the outline is not a rectangle.
    """
    if len(aperture.rings) != 1:
        return None
    (ring,) = aperture.rings
    local = ring - ring[0]
    envelope = shapely.oriented_envelope(shapely.Polygon(local))
    box = shapely.get_coordinates(envelope)[:4]
    box = box if signed_area(box) > 0 else box[::-1]
    corners = ring[[int(np.hypot(*(local - corner).T).argmin()) for corner in box]]
    sides = np.hypot(*(np.roll(corners, -1, axis=0) - corners).T)
    rounding, short = _ROUNDINGS * _UNIT * float(np.abs(ring).max()), float(sides.min())
    allowed = max(_ROUNDING * short, min(rounding, _SHAPELESS * short))
    if abs(envelope.area - signed_area(local)) > allowed * sides.sum():
        return None
    return (corners if sides[0] >= sides[1] else np.roll(corners, -1, axis=0)), allowed


# _PRODUCT is the largest deviation of amplitudes from a product of profiles, relative to the
# largest amplitude. _EQUAL is the largest difference of frequencies that are treated as equal, in
# cycles per side or relative to the largest frequency. Deviations up to these limits change W by
# less than 1e-13 of the energy.
_PRODUCT, _EQUAL = 4e-15, 1e-14
# Largest rounding error of frequencies [cycles per side] that is added to the limit for equal
# frequencies.
_LARGEST_ROUNDING = 1e-6
# Cost of a pair of waves, in units of the cost of an edge pair.
_CLIPS_PER_PAIR = 0.5


@dataclass(frozen=True, eq=False)
class SeparableTables:
    """The fields along both axes of a rectangle, in the frame of the rectangle."""

    frame: Frame
    fields: tuple[LineField, LineField]
    coherence_widths: tuple[float, float] = (math.inf, math.inf)
    """Coherence width along each axis, in units of the frame."""
    terms: ClassVar[int] = 1

    @property
    def clips(self) -> int:
        """Cost of one sample, in units of the cost of an edge pair."""
        return int(_CLIPS_PER_PAIR * sum(field.pairs for field in self.fields))


def is_separable(aperture: Aperture) -> bool:
    """Return whether an aperture is a rectangle whose field is a product along its sides.

    The result is False for uniform fields and for single plane waves.
    """
    return separable_tables(aperture, True) is not None


@lru_cache(maxsize=256)
def separable_tables(aperture: Aperture, double: bool) -> SeparableTables | None:
    """Return the fields along both axes of a rectangle; None for other apertures and fields.

    The result is also None for uniform fields and for single plane waves.
    """
    illumination = aperture.illumination
    if illumination is None or len(illumination.amplitudes) < 2:
        return None
    rectangle = _rectangle_of(aperture)
    if rectangle is None:
        return None
    corners, rounding = rectangle
    low, high = corners.min(axis=0), corners.max(axis=0)
    a, b, c, d = corners
    (length, width), direction = (high - low).tolist(), (1.0, 0.0)
    is_rotated = bool((b - a).all())
    # The first axis has the mean direction of both longer sides.
    if is_rotated:
        length, width = float(np.hypot(*(b - a))), float(np.hypot(*(d - a)))
        along = (b - a) + (c - d)
        direction = tuple((along / np.hypot(*along)).tolist())
    sizes = power_of_two(length), power_of_two(width)
    frame = frame_along(corners, low + (high - low) / 2, direction, sizes)
    frame = replace(frame, carrier=carrier_of([illumination], 2))
    # Frequencies have a rounding error of some ulps. For a rotated rectangle, the error of the
    # rotation angle is added, which is the rounding error of the corners divided by the length of
    # the rectangle.
    largest = float(np.hypot(*illumination.frequencies.T).max())
    phase_rounding = 2 * np.pi * _ROUNDINGS * _UNIT * largest * float(np.abs(corners).max())
    relative = _ROUNDINGS * _UNIT + (rounding / length if is_rotated else 0.0)
    roundings = relative * largest * length, relative * largest * width
    profiles = _profiles(waves_in_frame(illumination, frame), roundings, phase_rounding)
    if profiles is None:
        return None
    halves = np.abs(frame.vertices(corners)).mean(axis=0).tolist()
    along_x, along_y = (
        LineField(half, waves) for half, waves in zip(halves, profiles, strict=True)
    )
    return SeparableTables(frame, (along_x, along_y))


def _profiles(
    waves: Waves, frequency_rounding: tuple[float, float], phase_rounding: float
) -> tuple[Waves, Waves] | None:
    """Return the waves along both axes whose products are the waves of a field, or None."""
    frequencies = np.array([wave.frequency for wave in waves])
    amplitudes = np.array([wave.amplitude for wave in waves])
    (rates_x, i), (rates_y, j) = (
        _distinct(column, rounding)
        for column, rounding in zip(frequencies.T, frequency_rounding, strict=True)
    )
    if len(rates_x) * len(rates_y) != len(waves):
        return None
    table = np.zeros((len(rates_x), len(rates_y)), np.complex128)
    table[i, j] = amplitudes
    product = column_and_row(table, _PRODUCT + phase_rounding)
    if product is None:
        return None
    along_x, along_y = (
        tuple(Wave(a, (f,)) for a, f in zip(column.tolist(), rates.tolist(), strict=True))
        for column, rates in zip(product, (rates_x, rates_y), strict=True)
    )
    return along_x, along_y


def _distinct(values: Floats, rounding: float) -> tuple[Floats, Indices]:
    """Return the distinct values, up to rounding errors, and the index of each value in them."""
    tolerance = _EQUAL * max(1.0, float(np.abs(values).max())) + min(rounding, _LARGEST_ROUNDING)
    index = cluster_indices(values[:, None], tolerance)
    return np.bincount(index, values) / np.bincount(index), index


def _enter_frequency(ops: Any, frame: Frame, *nu: Any) -> Values:
    """Return the phase nu.c of the centre c in cycles, and nu minus the carrier in the frame."""
    return (phases.cycles_to_centre(ops, frame.centre, *nu), *frame.detuned(ops, *nu))


def wigner(ops: Any, tables: SeparableTables, x: Any, y: Any, nu_x: Any, nu_y: Any) -> Number:
    """Return the Wigner function W(x, nu), for arguments in the frame, (I4).

    The frequency is relative to the carrier. The result does not include the factor
    ``frame.measure``.
    """
    along_x, along_y = tables.fields
    width_x, width_y = tables.coherence_widths
    return along_x.wigner(ops, x, nu_x, width_x) * along_y.wigner(ops, y, nu_y, width_y)


def ambiguity(
    ops: Any, tables: SeparableTables, upsilon_x: Any, upsilon_y: Any, xi_x: Any, xi_y: Any
) -> tuple[Any, Any]:
    """Return the real part and the negated imaginary part of the ambiguity function.

    The arguments are in the frame. The result does not include the factor ``frame.measure`` or the
    phases of the centre and the carrier.
    """
    along_x, along_y = tables.fields
    return wave_sums(
        along_x.ambiguity(ops, upsilon_x, xi_x) * along_y.ambiguity(ops, upsilon_y, xi_y)
    )


def fourier(ops: Any, tables: SeparableTables, nu_x: Any, nu_y: Any) -> tuple[Any, Any]:
    """Return the real part and the negated imaginary part of the Fourier transform.

    The frequency is in the frame, relative to the carrier. The result does not include the factor
    ``frame.measure`` or the phase of the centre.
    """
    along_x, along_y = tables.fields
    return wave_sums(along_x.fourier(ops, nu_x) * along_y.fourier(ops, nu_y))


def field(ops: Any, tables: SeparableTables, x: Any, y: Any) -> tuple[Any, Any]:
    """Return the real and imaginary part of the field at a point in the frame, without the carrier.

    The rectangle includes its lower end along each axis, but not its upper end.
    """
    along_x, along_y = tables.fields
    value = along_x.field(ops, x) * along_y.field(ops, y)
    return value.real, value.imag


WIGNER = replace(
    plane.WIGNER,
    name="wigner of a product",
    tables=separable_tables,
    edge_sum=lambda ops, tables, *inner: (wigner(ops, tables, *inner),),
)
AMBIGUITY = replace(
    plane.AMBIGUITY,
    name="ambiguity of a product",
    tables=separable_tables,
    edge_sum=lambda ops, tables, cycles, *inner: ambiguity(ops, tables, *inner),
)
FOURIER = Kernel(
    "fourier of a product",
    2,
    separable_tables,
    _enter_frequency,
    lambda ops, tables, cycles, *nu: fourier(ops, tables, *nu),
    leave_wave,
)
AUTOCORRELATION = replace(
    plane.AUTOCORRELATION,
    name="autocorrelation of a product",
    tables=separable_tables,
    edge_sum=plane.at_both_ends(field),
)
