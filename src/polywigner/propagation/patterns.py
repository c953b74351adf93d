"""Radiation patterns over angles or along great circles, and cuts through such patterns."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, Unpack

import numpy as np
from numpy.typing import ArrayLike, NDArray

from polywigner.errors import ArgumentError
from polywigner.geometry import Wavefront
from polywigner.geometry.arguments import takes_frequency
from polywigner.geometry.rings import sides_of
from polywigner.numerics import Floats
from polywigner.propagation.element_patterns import (
    MOST_PHI,
    MOST_THETA,
    covers_front,
    element_pattern_of,
)
from polywigner.propagation.far_fields import (
    FarField,
    FarFieldOptions,
    checked_far_field,
    steered_direction,
)
from polywigner.propagation.point_grids import angle_axes, checked_theta_and_phi, unit_vectors
from polywigner.propagation.stores import source_attrs, source_coords
from polywigner.propagation.vector_fields import axial_ratios, co_and_cross, ludwig_components
from polywigner.quantities import SPEED_OF_LIGHT
from polywigner.radiometry.directions import PlaneSource
from polywigner.source.polarisation import checked_polarisation
from polywigner.transforms.wavefronts import flat_source
from polywigner.transforms.xarray_arguments import arrays_of, labelled_array, labelled_arrays

if TYPE_CHECKING:
    import xarray

Values = NDArray[Any]

# Tolerances [rad] for angles on the horizon and for opposite meridians. Angles converted from
# degrees have rounding errors.
_SAME_ANGLE = 1e-9
_OPPOSITE = 1e-6
# Number of samples per lobe of width wavelength/D, enough to resolve nulls some 30 dB deep.
_STEPS_PER_LOBE = 64
# Smallest and largest number of samples per half circle.
_LEAST_STEPS, _MOST_STEPS = 360, 32768
# Number of interpolated samples per angular step of a table.
_STEPS_PER_ANGLE = 4
# Largest level difference [dB] between the beam and the direction normal to the aperture for which
# the great circles are along x and y.
_NORMAL = 0.1
# Smallest number of meridians for interpolation over phi.
_LEAST_MERIDIANS = 8
# Rounding error of z on the horizon.
_HORIZON = 1e-15

_ATTRIBUTES = (
    "radiated_power", "aperture_power", "frequency", "peak_directivity", "peak_theta", "peak_phi",
)  # fmt: skip


@takes_frequency
def radiation_pattern(
    source: PlaneSource | Wavefront,
    wavelength: float,
    theta: ArrayLike,
    phi: ArrayLike,
    **options: Unpack[FarFieldOptions],
) -> xarray.Dataset:
    """Compute the far field and the directivity of a source over the angles theta and phi.

    The far field E is the sum of ``sqrt(g) F/(i wavelength)`` over the plane waves of the source's
    field u, where g is the obliquity factor and F the transform of :func:`fourier`. The directivity
    is ``4 pi |E|^2/P``, where P is the integral of |E|^2 over the hemisphere (docs/patterns.md).
    For |u|^2 in W/m^2, |E|^2 is in W/sr. The backward radiation is zero.

    With a ``polarisation``, E is the electric field (VP2), which is split into a co- and a
    cross-polar part by Ludwig's third definition (VP3). The directivity includes the co-polar and
    the cross-polar part.

    Parameters
    ----------
    source : Aperture, Array or Wavefront
        Source in the plane z = 0.
    wavelength : float
        Wavelength in m.
    theta : array_like, shape (n,)
        Angles from the normal in rad, from -pi to pi. A negative angle theta at phi is the same
        direction as -theta at phi + pi.
    phi : array_like, shape (m,) or ()
        Angles from the x axis in rad.
    obliquity : str, default "rayleigh-sommerfeld-1"
        Boundary condition, which determines the obliquity factor g: cos^2(theta) for
        "rayleigh-sommerfeld-1", ((1 + cos(theta))/2)^2 for "kirchhoff", 1 for
        "rayleigh-sommerfeld-2", or cos(theta) for "paper". For tapers and steering, the factor
        applies to each plane wave of the field (docs/theory.md, (D2), (D3)). Polarised sources have
        no obliquity.
    polarisation : str or array_like, optional
        Polarisation of the source, as in :func:`polywigner.field`. By default the field is scalar.
    method : {"huygens", "magnetic", "electric"}
        Equivalent currents of a polarised source.
    element : xarray.Dataset, optional
        Far field that replaces the aperture, the field and the obliquity of the elements of a
        :func:`phased_array`: a result of :func:`read_pattern`, or of this function with a
        polarisation. Each position of the array is the origin of the far field of one element. The
        radiated power includes backward radiation of the elements, and the aperture power is NaN.
        With an element pattern, ``polarisation`` only defines the co-polar part. By default it is
        the polarisation of the beam.
    precision, engine : str, optional
        See :func:`fourier`.

    Returns
    -------
    xarray.Dataset
        ``directivity`` in dBi over theta and phi, minus infinity without radiation, and the complex
        ``field`` in m times the unit of u, accurate to 1e-12 of the largest |E|. The attributes
        contain the wavelength, the frequency, the obliquity, the radiated power, the aperture
        power, which is the integral of |u|^2, and the largest directivity at these angles.
        ``peak_directivity`` in dBi, ``peak_theta`` and ``peak_phi`` describe the beam, the maximum
        over all directions. For a source with linear phases, ``steered_theta`` and ``steered_phi``
        are the direction to which it is steered.

        For a polarised source ``field`` is the co-polar part. Further variables are the complex
        ``cross_field``, the ratio ``cross_polar_discrimination`` of the co- to the cross-polar part
        in dB, and the ``axial_ratio`` in dB. The attributes contain ``method`` instead of the
        obliquity, and ``peak_axial_ratio`` and ``peak_cross_polar_discrimination`` of the beam. The
        attribute ``polarisation`` is the Jones vector of the co-polar part: real and imaginary part
        along x, then along y. If the polarisations of elements differ, it is the polarisation of
        the beam.

    Raises
    ------
    ArgumentError
        If an argument has the wrong type, shape or range.
    IlluminationError
        If the source does not radiate.
    GeometryError
        If elements of an Array do not lie in the plane z = 0.
    EngineError
        If the engine is not available.

    Examples
    --------
    >>> import polywigner as pw
    >>> pattern = pw.radiation_pattern(pw.shapes.square(10e-3), 3.2e-3, 0.0, 0.0)
    >>> round(pattern.attrs["largest_directivity"], 2)  # dBi
    21.35
    """
    polar, azimuth = checked_theta_and_phi(theta, phi)
    far = checked_far_field(source, wavelength, options)
    values = far.grid(polar, azimuth)
    return _dataset(far, values, unit_vectors(polar, azimuth), angle_axes(theta=polar, phi=azimuth))


@takes_frequency
def beam_cuts(
    source: PlaneSource | Wavefront, wavelength: float, **options: Unpack[FarFieldOptions]
) -> xarray.Dataset:
    """Compute the far field and the directivity along two great circles through the beam.

    The first circle is the meridian through the beam, and the second circle is perpendicular to it.
    If the directivity along the normal is within 0.1 dB of the beam, the tangents of the circles at
    the beam are parallel to x and y. The result is an argument of :func:`beam_metrics` and
    :func:`polywigner.figures.draw_pattern`.

    Parameters
    ----------
    source : Aperture, Array or Wavefront
        Source in the plane z = 0.
    wavelength : float
        Wavelength in m.
    **options
        Options of :func:`radiation_pattern`.

    Returns
    -------
    xarray.Dataset
        The variables and attributes of :func:`radiation_pattern` over ``cut`` and ``angle``. The
        names in ``cut`` are "meridian" and "across", or "x" and "y". ``angle`` is the angle from
        the beam in rad, with 64 steps per lobe. The angle is positive towards larger theta on the
        meridian, and towards larger phi on the other circle. The coordinates ``theta`` and ``phi``
        are the directions in rad, and ``azimuth`` contains the azimuths of the tangents at the
        beam. Values behind the plane are NaN.

    Raises
    ------
    PolywignerError
        See :func:`radiation_pattern`.

    Examples
    --------
    >>> import numpy as np, polywigner as pw
    >>> wave = pw.steering((0.5, 0.0, np.sqrt(0.75)), 3.2e-3)
    >>> square = pw.shapes.square(20e-3).with_illumination(wave)
    >>> cuts = pw.beam_cuts(square, 3.2e-3)
    >>> metrics = pw.beam_metrics(cuts)
    >>> [round(float(np.degrees(cut.half_power_beamwidth)), 2) for cut in metrics.cuts]
    [9.29, 8.09]
    """
    far = checked_far_field(source, wavelength, options)
    extent = math.hypot(*sides_of(flat_source(far.source).bounds))
    steps = math.ceil(_STEPS_PER_LOBE * math.pi * extent / far.wavelength)
    return _great_circles(far, math.pi / min(max(steps, _LEAST_STEPS), _MOST_STEPS))


def _great_circles(far: FarField, step: float) -> xarray.Dataset:
    """Return the pattern along two great circles through the beam, with steps of ``step`` rad."""
    largest, theta, phi = far.beam
    is_normal = float(far.intensity(np.array([0.0, 0.0, 1.0]))) > largest * 10 ** (-_NORMAL / 10)
    limit = math.pi if far.goes_backwards else math.pi / 2 + theta
    beam, outwards = unit_vectors(np.array([theta, theta + math.pi / 2]), np.array([phi]))[:, 0]
    around = np.array([-math.sin(phi), math.cos(phi), 0.0])
    rotation = -phi if is_normal else 0.0
    sine, cosine = math.sin(rotation), math.cos(rotation)
    tangents = np.array([cosine * outwards + sine * around, cosine * around - sine * outwards])
    count = math.ceil(limit / step - 1e-9)
    angle = np.asarray(step * np.arange(-count, count + 1), np.float64)
    directions = np.cos(angle)[:, None] * beam + np.sin(angle)[:, None] * tangents[:, None]
    azimuths = (rotation + phi + np.array([0.0, math.pi / 2])) % (2 * math.pi)
    ahead = (directions[..., 2] >= -_HORIZON) | far.goes_backwards
    values = np.full(directions.shape[: 3 if far.is_vector else 2], np.nan, np.complex128)
    values[ahead] = far.at(directions[ahead])
    kinds = np.array(("x", "y") if is_normal else ("meridian", "across"))
    axes = {
        "cut": labelled_array(kinds, ("cut",), {"long_name": "great circle"}),
        "angle": labelled_array(angle, ("angle",), {"units": "rad", "long_name": "from the beam"}),
    }
    x, y, z = np.moveaxis(directions, -1, 0)
    return _dataset(far, values, directions, axes).assign_coords(
        theta=(("cut", "angle"), np.arctan2(np.hypot(x, y), z), {"units": "rad"}),
        phi=(("cut", "angle"), np.arctan2(y, x) % (2 * math.pi), {"units": "rad"}),
        azimuth=("cut", azimuths, {"units": "rad"}),
    )


def _dataset(
    far: FarField, values: Values, directions: Values, axes: dict[str, xarray.Variable]
) -> xarray.Dataset:
    """Return a pattern from field values in given directions, with attributes of the beam."""
    power, energy = far.powers
    largest, theta, phi = far.beam
    squares = np.square(np.abs(values))
    levels = decibels(squares.sum(axis=-1) if far.is_vector else squares, power)
    about = far.about | {
        "wavelength": far.wavelength,
        "frequency": SPEED_OF_LIGHT / far.wavelength,
        "radiated_power": power,
        "aperture_power": energy,
        "largest_directivity": float(np.nanmax(levels)),
        "peak_directivity": 10 * math.log10(4 * math.pi / power * largest),
        "peak_theta": theta,
        "peak_phi": phi,
    }
    steered = steered_direction(far.source, far.wavelength, (theta, phi))
    if steered is not None:
        about |= {"steered_theta": steered[0], "steered_phi": steered[1]}
    if not far.is_vector:
        return described(far.source, axes, {"directivity": levels, "field": values}, about)
    beam = unit_vectors(np.array([theta]), np.array([phi]))[0, 0]
    beam_components = ludwig_components(far.at(beam), beam)
    jones = far.jones
    if jones is None or jones.ndim > 1:
        jones = jones_of(beam_components)
    beam_parts = co_and_cross(beam_components, jones)
    about["peak_axial_ratio"] = float(axial_ratios(beam_components))
    about["peak_cross_polar_discrimination"] = float(_discrimination(*beam_parts))
    along = ludwig_components(values, directions)
    return vector_dataset(axes, levels, along, jones, about, far.source)


def jones_of(components: tuple[Values, Values]) -> Values:
    """Return the unit Jones vector (2,) of two complex numbers, the field along x and along y.

    The phase of the vector makes the larger component real and positive.
    """
    larger = components[int(abs(components[1]) > abs(components[0]))]
    return checked_polarisation(np.stack(components) / larger)


def vector_dataset(
    axes: dict[str, xarray.Variable],
    levels: Values,
    along: tuple[Values, Values],
    jones: Values,
    about: dict[str, Any],
    source: PlaneSource | Wavefront | None = None,
) -> xarray.Dataset:
    """Return the pattern of a polarised source.

    ``levels`` is the directivity in dBi, and ``along`` the field along x and y.
    """
    co, cross = co_and_cross(along, jones)
    variables = {
        "directivity": levels,
        "field": co,
        "cross_field": cross,
        "cross_polar_discrimination": _discrimination(co, cross),
        "axial_ratio": axial_ratios(along),
    }
    about = {"polarisation": jones.view(np.float64).tolist(), **about}
    return described(source, axes, variables, about)


def decibels(intensity: Values, power: float) -> Values:
    """Convert intensities in W/sr to directivities in dBi, minus infinity for zero.

    ``power`` is the radiated power in W.
    """
    with np.errstate(divide="ignore"):
        return np.asarray(10 * np.log10(4 * math.pi / power * intensity))


def _discrimination(co: Values, cross: Values) -> Values:
    """Return the ratio of co- to cross-polar field in dB; infinite if the latter is zero."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(20 * np.log10(np.abs(co) / np.abs(cross)))


_VARIABLES = {
    "directivity": ("dBi", "directivity"),
    "field": ("W0.5 sr-0.5", "far field r exp(-ikr) U"),
    "cross_field": ("W0.5 sr-0.5", "cross-polar far field"),
    "cross_polar_discrimination": ("dB", "co- over cross-polar"),
    "axial_ratio": ("dB", "axial ratio"),
    "nominal": ("dBi", "directivity without errors"),
    "expected": ("dBi", "mean level, closed form"),
    "mean": ("dBi", "mean level of the samples"),
    "low": ("dBi", "level of 5 % of the samples"),
    "high": ("dBi", "level of 95 % of the samples"),
}


def described(
    source: PlaneSource | Wavefront | None,
    axes: dict[str, xarray.Variable],
    variables: dict[str, Values],
    about: dict[str, Any],
) -> xarray.Dataset:
    """Return a dataset with units, long names and the source."""
    from polywigner import __version__

    convention = {
        "convention": "waves exp(+ikr)/r, time exp(-i omega t)",
        "polywigner_version": __version__,
    }
    labelled = {}
    for name, values in variables.items():
        units, meaning = _VARIABLES[name]
        attrs = {"units": units, "long_name": meaning} | (convention if "field" in name else {})
        labelled[name] = labelled_array(values, tuple(axes), attrs)
    if source is not None:
        axes, about = axes | source_coords(source), about | source_attrs(source)
    return labelled_arrays(labelled, axes, about)


CutKind = Literal["theta", "meridian", "across", "x", "y"]


class Cut(NamedTuple):
    """Directivity along a meridian, or along a great circle through the beam."""

    phi: float
    """Azimuth of the meridian at theta > 0, or of the circle's tangent, in rad."""
    angles: Floats
    """Theta, or angle from the beam, in rad."""
    levels: Floats
    """Directivity in dBi."""
    kind: CutKind
    cross_levels: Floats | None = None
    """Cross-polar directivity in dBi, None for a scalar pattern."""


def checked_pattern(pattern: Any) -> tuple[Floats, Floats, Floats, dict[str, float]]:
    """Return theta (n,) and phi (m,) in rad, directivity (n, m) in dBi, and numerical attributes.

    Raises ArgumentError for other datasets, and if a level is NaN.
    """
    theta, phi, levels, about = _checked_levels(pattern, ("theta", "phi"))
    if np.isnan(levels).any():
        raise ArgumentError(
            "the pattern contains NaN at some angles; expected numbers, or minus infinity in "
            "directions without radiation"
        )
    return theta, phi, levels, about


def _checked_levels(
    pattern: Any, axes: tuple[str, str]
) -> tuple[NDArray[Any], Floats, Floats, dict[str, float]]:
    """Return both axes of a pattern, directivity in dBi, and numerical attributes."""
    names = dict(zip(axes, axes, strict=True)) | {"directivity": " ".join(axes)}
    first, second, levels, *values = arrays_of(
        pattern, names, "polywigner.radiation_pattern", *_ATTRIBUTES
    )
    if not levels.size:
        raise ArgumentError("the pattern contains no angles; expected at least one angle")
    return first, second, levels, dict(zip(_ATTRIBUTES, map(float, values), strict=True))


def _cross_levels(
    pattern: Any, axes: tuple[str, str], about: dict[str, float], levels: Floats
) -> Floats:
    """Return the cross-polar directivity in dBi; for a scalar pattern, return ``levels``."""
    if "cross_field" not in pattern:
        return levels
    values = pattern["cross_field"].transpose(*axes).values
    return decibels(np.square(np.abs(values)), about["radiated_power"])


def front_of(theta: Floats, levels: Floats) -> tuple[Floats, Floats]:
    """Return theta in rad and directivity in front of the plane, including the horizon.

    ``levels`` has theta along its first axis.
    """
    front = np.abs(theta) <= math.pi / 2 + _SAME_ANGLE
    return theta[front], levels[front]


def cuts_of(theta: Floats, phi: Floats, levels: Floats) -> Iterator[tuple[float, Floats, Floats]]:
    """Yield phi, theta and levels of each meridian, in ascending theta, from levels (n, m).

    If theta is never negative, columns at phi and phi + pi are joined, and theta is negative in the
    second column.
    """
    order = np.argsort(theta)
    has_both_signs = theta.min() < -_SAME_ANGLE
    remaining = np.full(len(phi), True)
    for j, angle in enumerate(phi):
        if not remaining[j]:
            continue
        remaining[j] = False
        is_opposite = np.abs((phi - angle) % (2 * math.pi) - math.pi) < _OPPOSITE
        opposite = np.flatnonzero(remaining & is_opposite)
        if has_both_signs or not opposite.size:
            yield float(angle), theta[order], levels[order, j]
            continue
        remaining[opposite[0]] = False
        back = order[::-1] if theta[order[0]] > _SAME_ANGLE else order[:0:-1]
        angles = np.concatenate([-theta[back], theta[order]])
        yield float(angle), angles, np.concatenate([levels[back, opposite[0]], levels[order, j]])


def angle_between(a: float, b: float) -> float:
    """Return the angle between meridians at the azimuths a and b in rad, from 0 to pi/2 rad."""
    return abs(math.remainder(a - b, math.pi))


def cuts_in(pattern: Any) -> list[Cut]:
    """Return the meridians of a pattern, or the great circles of :func:`beam_cuts`.

    Meridians end at the horizon. Raises ArgumentError for datasets that are not a pattern.
    """
    if "cut" not in getattr(pattern, "dims", ()):
        theta, phi, levels, about = checked_pattern(pattern)
        crossed = _cross_levels(pattern, ("theta", "phi"), about, levels)
        fronts = (front_of(theta, part) for part in (levels, crossed))
        co, cross = (cuts_of(angles, phi, part) for angles, part in fronts)
        cuts = [
            Cut(azimuth, angles, values, "theta", others)
            for (azimuth, angles, values), (_, _, others) in zip(co, cross, strict=True)
        ]
    else:
        kinds, angles, levels, about = _checked_levels(pattern, ("cut", "angle"))
        crossed = _cross_levels(pattern, ("cut", "angle"), about, levels)
        azimuths = pattern["azimuth"].values.tolist()
        cuts = [
            Cut(azimuths[k], angles[ahead], levels[k, ahead], kinds.item(k), crossed[k, ahead])
            for k, ahead in enumerate(~np.isnan(levels))
        ]
    is_scalar = "cross_field" not in pattern
    return [cut._replace(cross_levels=None) for cut in cuts] if is_scalar else cuts


def circles_through_beam(pattern: Any) -> list[Cut]:
    """Interpolate a pattern along two perpendicular great circles through its peak.

    The list is empty unless the pattern has a field over the hemisphere in even steps.
    """
    theta, phi, _, about = checked_pattern(pattern)
    polar, azimuths = np.unique(theta), np.unique(phi.round(12) % (2 * math.pi))
    fine_enough = _LEAST_MERIDIANS <= len(azimuths) <= MOST_PHI and 3 <= len(polar) <= MOST_THETA
    if "field" not in pattern or not fine_enough or not covers_front(polar, azimuths):
        return []
    is_scalar = "cross_field" not in pattern
    # A scalar field, treated as a field along x (Ludwig's third definition), is smooth at the pole.
    if is_scalar:
        pattern = pattern.assign(cross_field=0 * pattern["field"])
        pattern = pattern.assign_attrs(polarisation=[1.0, 0.0, 0.0, 0.0])
    element = element_pattern_of(pattern, "pattern")
    power = about["radiated_power"]
    largest = 10 ** (about["peak_directivity"] / 10) * power / (4 * math.pi)
    jones = np.asarray(pattern.attrs["polarisation"], np.float64).view(np.complex128)
    far = FarField(
        None, SPEED_OF_LIGHT / about["frequency"], element.vectors, (power, math.nan), {},
        jones=jones, goes_backwards=element.covers_sphere,
        known_beam=(largest, about["peak_theta"], about["peak_phi"]),
    )  # fmt: skip
    step = min(polar[1] - polar[0], azimuths[1] - azimuths[0]) / _STEPS_PER_ANGLE
    circles = cuts_in(_great_circles(far, step))
    return [cut._replace(cross_levels=None) for cut in circles] if is_scalar else circles
