"""Two great circles through the beam: where a data sheet takes its widths and sidelobes."""

from __future__ import annotations

import math
from itertools import zip_longest
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, Unpack

import numpy as np
from numpy.typing import NDArray

from polywigner.geometry import Wavefront
from polywigner.geometry.arguments import takes_frequency
from polywigner.propagation.element_patterns import (
    MOST_PHI,
    MOST_THETA,
    covers_front,
    element_pattern_of,
)
from polywigner.propagation.patterns import (
    checked_levels,
    checked_pattern,
    cuts_of,
    far_field_dataset,
    front_of,
)
from polywigner.propagation.places import unit_vectors
from polywigner.propagation.radiators import FarFieldOptions, checked_far_field
from polywigner.propagation.vector_fields import co_and_cross, ludwig_components
from polywigner.radiometry.directions import PlaneSource
from polywigner.transforms.wavefronts import flat_of
from polywigner.transforms.xarray_arguments import labelled_array

if TYPE_CHECKING:
    import xarray

Floats = NDArray[np.float64]

# A lobe of a source D across is lambda/D wide. This number of samples draws its nulls, some 30 dB
# below the lobe; a wide source has at most that many samples.
_STEPS_PER_LOBE, _LEAST_STEPS, _MOST_STEPS = 64, 360, 32768
# Samples between two angles of a table, whose field is interpolated.
_STEPS_PER_ANGLE = 4
# A beam that exceeds the direction of the normal by less, in dB, is cut next to the x and y axes.
_NORMAL = 0.1
_LEAST_MERIDIANS = 8
# Cosines of directions on the horizon, to rounding.
_HORIZON = 1e-15


CutKind = Literal["theta", "meridian", "across", "x", "y"]
"""A meridian over theta, or a great circle through the beam."""


class Cut(NamedTuple):
    """Levels along a line of directions."""

    phi: float
    """The meridian of theta > 0 in rad; of a great circle, the azimuth of its tangent."""
    angles: Floats
    """Theta in rad; on a great circle the angle from the beam."""
    levels: Floats
    """Directivity in dBi."""
    kind: CutKind
    cross_levels: Floats | None = None
    """Directivity of the cross-polar part in dBi; None for a scalar pattern."""


@takes_frequency
def beam_cuts(
    source: PlaneSource | Wavefront,
    wavelength: float,
    **options: Unpack[FarFieldOptions],
) -> xarray.Dataset:
    """Far field and directivity of a source along two orthogonal great circles through its beam.

    The first circle contains the normal, so that it is the meridian of the beam; the second crosses
    it at a right angle. If the directivity along the normal is within 0.1 dB of the beam, the
    circles go along the axes, "x" and "y", instead. For :func:`beam_metrics` and
    :func:`polywigner.figures.draw_pattern`.

    Parameters
    ----------
    source, wavelength, options : as of :func:`radiation_pattern`.

    Returns
    -------
    xarray.Dataset
        The variables and attributes of :func:`radiation_pattern`, over ``cut`` (2,) and ``angle``
        (n,) from the beam in rad, positive to larger theta on the "meridian" and to larger phi on
        the circle "across", in 64 steps per lobe. Coordinates ``theta`` and ``phi`` (2, n) are the
        directions in rad, and ``azimuth`` (2,) that of the tangents at the beam. Directions behind
        the plane are NaN.

    Raises
    ------
    As :func:`radiation_pattern`.

    >>> import numpy as np, polywigner as pw
    >>> wave = pw.steering((0.5, 0.0, np.sqrt(0.75)), 3.2e-3)
    >>> square = pw.shapes.square(20e-3).with_illumination(wave)
    >>> cuts = pw.beam_cuts(square, 3.2e-3)
    >>> metrics = pw.beam_metrics(cuts)
    >>> [round(float(np.degrees(cut.half_power_beamwidth)), 2) for cut in metrics.cuts]
    [9.29, 8.09]
    """
    far = checked_far_field(source, wavelength, options)
    largest, theta, phi = far.beam()
    normal = float(far.intensity(np.array([0.0, 0.0, 1.0])))
    is_normal = normal > largest * 10 ** (-_NORMAL / 10)
    extent = float(np.linalg.norm(np.ptp(np.reshape(flat_of(far.source).bounds, (2, 2)), axis=0)))
    steps = math.ceil(_STEPS_PER_LOBE * math.pi * extent / far.wavelength)
    reach = math.pi if far.goes_backwards else math.pi / 2 + theta
    step = math.pi / min(max(steps, _LEAST_STEPS), _MOST_STEPS)
    azimuths, angle, directions = _circles(theta, phi, is_normal, step, reach)
    ahead = (directions[..., 2] >= -_HORIZON) | far.goes_backwards
    values = np.full(directions.shape[: 3 if far.is_vector else 2], np.nan, np.complex128)
    values[ahead] = far.at(directions[ahead])
    axes = {
        "cut": labelled_array(np.array(_kinds(is_normal)), ("cut",), {"long_name": "great circle"}),
        "angle": labelled_array(angle, ("angle",), {"units": "rad", "long_name": "from the beam"}),
    }
    found = far_field_dataset(far, values, directions, axes)
    x, y, z = np.moveaxis(directions, -1, 0)
    return found.assign_coords(
        theta=(("cut", "angle"), np.arctan2(np.hypot(x, y), z), {"units": "rad"}),
        phi=(("cut", "angle"), np.arctan2(y, x) % (2 * math.pi), {"units": "rad"}),
        azimuth=("cut", azimuths, {"units": "rad"}),
    )


def _kinds(is_normal: bool) -> tuple[CutKind, CutKind]:
    return ("x", "y") if is_normal else ("meridian", "across")


def _circles(
    theta: float, phi: float, is_normal: bool, step: float, reach: float
) -> tuple[Floats, Floats, Floats]:
    """Azimuths (2,), angles from the beam (n,) and unit vectors (2, n, 3) of the great circles."""
    beam = unit_vectors(np.array([theta]), np.array([phi]))[0, 0]
    outwards = unit_vectors(np.array([theta + math.pi / 2]), np.array([phi]))[0, 0]
    around = np.array([-math.sin(phi), math.cos(phi), 0.0])
    turn = -phi if is_normal else 0.0
    tangents = np.stack(
        [
            math.cos(turn) * outwards + math.sin(turn) * around,
            math.cos(turn) * around - math.sin(turn) * outwards,
        ]
    )
    count = math.ceil(reach / step - 1e-9)
    angle = np.asarray(step * np.arange(-count, count + 1), np.float64)
    sine, cosine = np.sin(angle)[:, None], np.cos(angle)[:, None]
    directions: Floats = cosine * beam + sine * tangents[:, None]
    first = 0.0 if is_normal else phi
    return np.array([first, (first + math.pi / 2) % (2 * math.pi)]), angle, directions


def cuts_in(pattern: Any) -> list[Cut]:
    """Return the great circles of a dataset of :func:`beam_cuts`, or the meridians of a pattern.

    ArgumentError for anything else.
    """
    if "cut" not in getattr(pattern, "dims", ()):
        theta, phi, levels, _ = checked_pattern(pattern)
        crossed = _cross_polar(pattern, levels, ("theta", "phi"))
        front, values = front_of(theta, levels)
        meridians = cuts_of(front, phi, values)
        across = [] if crossed is None else cuts_of(front, phi, front_of(theta, crossed)[1])
        return [
            Cut(angle, along, values, "theta", None if part is None else part[2])
            for (angle, along, values), part in zip_longest(meridians, across)
        ]
    levels, _ = checked_levels(pattern, ("cut", "angle"))
    angle, azimuth = (np.asarray(pattern[name].values, np.float64) for name in ("angle", "azimuth"))
    crossed = _cross_polar(pattern, levels, ("cut", "angle"))
    circles = []
    for k, kind in enumerate(pattern["cut"].values.tolist()):
        values = levels[k]
        ahead = ~np.isnan(values)
        part = None if crossed is None else crossed[k, ahead]
        circles.append(Cut(float(azimuth[k]), angle[ahead], values[ahead], kind, part))
    return circles


def circles_through_beam(pattern: Any) -> list[Cut]:
    """Return the great circles through the beam of a pattern, interpolated between its angles.

    The list is empty if the pattern has no field over the front in even steps.
    """
    theta, phi, _, about = checked_pattern(pattern)
    polar, turns = np.unique(theta), np.unique(phi.round(12) % (2 * math.pi))
    fine_enough = _LEAST_MERIDIANS <= len(turns) <= MOST_PHI and 3 <= len(polar) <= MOST_THETA
    if "field" not in pattern or not fine_enough or not covers_front(polar, turns):
        return []
    is_scalar = "cross_field" not in pattern
    if is_scalar:  # by Ludwig's third definition a field along x, which is smooth over the pole
        pattern = pattern.assign(cross_field=0 * pattern["field"])
        pattern = pattern.assign_attrs(polarisation=[1.0, 0.0, 0.0, 0.0])
    element = element_pattern_of(pattern, "pattern")
    jones = np.asarray(pattern.attrs["polarisation"], np.float64).view(np.complex128)
    beam = about["peak_theta"], about["peak_phi"]
    step = min(polar[1] - polar[0], turns[1] - turns[0]) / _STEPS_PER_ANGLE

    def levels_at(directions: Floats) -> tuple[Floats, Floats]:
        parts = co_and_cross(ludwig_components(element.vectors(directions), directions), jones)
        co, cross = (np.square(np.abs(part)) for part in parts)
        with np.errstate(divide="ignore"):
            total, crossed = (
                10 * np.log10(4 * math.pi / about["radiated_power"] * part)
                for part in (co + cross, cross)
            )
        return total, crossed

    normal = float(levels_at(np.array([[0.0, 0.0, 1.0]]))[0][0])
    is_normal = normal > about["peak_directivity"] - _NORMAL
    reach = math.pi if element.is_whole else math.pi / 2 + beam[0]
    azimuths, angle, directions = _circles(*beam, is_normal, step, reach)
    circles = []
    for kind, azimuth, line in zip(_kinds(is_normal), azimuths, directions, strict=True):
        ahead = (line[:, 2] >= -_HORIZON) | element.is_whole
        total, crossed = levels_at(line[ahead])
        part = None if is_scalar else crossed
        circles.append(Cut(float(azimuth), angle[ahead], total, kind, part))
    return circles


def _cross_polar(pattern: Any, levels: Floats, axes: tuple[str, str]) -> Floats | None:
    """Directivity of the cross-polar part in dBi; None for a scalar pattern."""
    if "cross_field" not in pattern:
        return None
    ratio = pattern["cross_polar_discrimination"].transpose(*axes).values
    with np.errstate(invalid="ignore"):
        part = np.nan_to_num(-10 * np.log10(1 + 10 ** (ratio / 10)), nan=0.0)
    return np.asarray(levels + part)
