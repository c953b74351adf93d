"""Radiation patterns: the far field over angles, and its directivity."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any, Unpack

import numpy as np
from numpy.typing import ArrayLike, NDArray

from polywigner.errors import ArgumentError
from polywigner.geometry import Wavefront
from polywigner.geometry.arguments import takes_frequency
from polywigner.propagation.places import angle_axes, checked_phi, checked_theta, unit_vectors
from polywigner.propagation.radiators import (
    FarField,
    FarFieldOptions,
    checked_far_field,
    steered_direction,
)
from polywigner.propagation.stores import source_attrs, source_coords
from polywigner.propagation.vector_fields import axial_ratios, co_and_cross, ludwig_components
from polywigner.quantities import SPEED_OF_LIGHT
from polywigner.radiometry.directions import PlaneSource
from polywigner.source.polarisation import checked_polarisation
from polywigner.transforms.xarray_arguments import labelled_array, labelled_arrays

if TYPE_CHECKING:
    import xarray


# Two meridians half a turn apart, and the horizon, to the rounding of degrees.
_SAME_ANGLE = 1e-9
_OPPOSITE = 1e-6

_ATTRIBUTES = (
    "radiated_power", "aperture_power", "frequency", "peak_directivity", "peak_theta", "peak_phi",
)  # fmt: skip

Levels = NDArray[np.float64]


def checked_pattern(pattern: Any) -> tuple[Levels, Levels, Levels, dict[str, float]]:
    """Theta (n,), phi (m,), directivity (n, m) in dBi, and the numbers among the attributes."""
    levels, about = checked_levels(pattern, ("theta", "phi"))
    theta, phi = (np.asarray(pattern[name].values, np.float64) for name in ("theta", "phi"))
    if np.isnan(levels).any():
        raise ArgumentError(
            "expected a pattern with numbers at its angles, got angles that are not a number"
        )
    return theta, phi, levels, about


def checked_levels(pattern: Any, axes: tuple[str, str]) -> tuple[Levels, dict[str, float]]:
    """Directivity (n, m) in dBi over two axes, and the numbers among the attributes."""
    try:
        for name in axes:
            len(pattern[name].values)
        levels = np.asarray(pattern["directivity"].transpose(*axes).values, np.float64)
        about = {name: float(pattern.attrs[name]) for name in _ATTRIBUTES}
    except (TypeError, KeyError, IndexError, AttributeError, ValueError):
        raise ArgumentError(
            f"expected a pattern with directivity over {' and '.join(axes)}, got "
            f"{type(pattern).__name__} without; use what polywigner.radiation_pattern returned"
        ) from None
    if not levels.size:
        raise ArgumentError("expected a pattern with numbers at its angles, got no angles")
    return levels, about


def front_of(theta: Levels, levels: Levels) -> tuple[Levels, Levels]:
    """Theta and levels (n, m) in front of the plane."""
    front = np.abs(theta) <= math.pi / 2 + _SAME_ANGLE
    return theta[front], levels[front]


def cuts_of(theta: Levels, phi: Levels, levels: Levels) -> Iterator[tuple[float, Levels, Levels]]:
    """(phi, theta (k,), levels (k,)) along meridians, with theta from one horizon to the other.

    Half a meridian where the other half is not among the levels (n, m) over theta and phi.
    """
    order = np.argsort(theta)
    is_whole = theta.min() < -_SAME_ANGLE
    left = np.full(len(phi), True)
    for j, angle in enumerate(phi):
        if not left[j]:
            continue
        left[j] = False
        opposite = np.flatnonzero(
            left & (np.abs((phi - angle) % (2 * math.pi) - math.pi) < _OPPOSITE)
        )
        if is_whole or not opposite.size:
            yield float(angle), theta[order], levels[order, j]
            continue
        left[opposite[0]] = False
        back = order[::-1] if theta[order[0]] > _SAME_ANGLE else order[:0:-1]
        places = np.concatenate([-theta[back], theta[order]])
        yield float(angle), places, np.concatenate([levels[back, opposite[0]], levels[order, j]])


def angle_between(a: float, b: float) -> float:
    """The angle between two whole meridians."""
    rest = (a - b) % math.pi
    return min(rest, math.pi - rest)


Values = NDArray[Any]


@takes_frequency
def radiation_pattern(
    source: PlaneSource | Wavefront,
    wavelength: float,
    theta: ArrayLike,
    phi: ArrayLike,
    **options: Unpack[FarFieldOptions],
) -> xarray.Dataset:
    """Far field and directivity of a source over angles from its normal.

    E = sum over the field's waves of sqrt(g) F/(i lambda), F from :func:`fourier`; the directivity
    is 4 pi |E|^2/P, with P the integral of |E|^2 over the hemisphere to rounding
    (docs/patterns.md). |E|^2 is in W/sr for |u|^2 in W/m^2. Nothing goes backwards. With a
    ``polarisation`` E is the electric field (VP2), of which the directivity counts all, split into
    a co- and a cross-polar part by Ludwig's third definition, (VP3).

    Parameters
    ----------
    source : Aperture or Array of apertures in the plane z = 0, with any fields; or one with a
        curved wave.
    wavelength : in m.
    theta : (n,) angles from the normal in rad, from -pi to pi; negative ones, for cuts, lie at the
        opposite phi.
    phi : (m,) angles from the x axis in rad; or one.
    obliquity : g, a boundary condition: cos^2 ("rayleigh-sommerfeld-1", or None), ((1 + cos)/2)^2
        ("kirchhoff"), 1 ("rayleigh-sommerfeld-2"), or cos ("paper"); for tapers and steering wave
        by wave (docs/theory.md, (D2), (D3)). Not with a polarisation.
    polarisation : of the source, as of :func:`polywigner.field`; None: the field is scalar.
    method : of a polarised source: "huygens" (default), "magnetic" or "electric", the currents that
        stand for it.
    element : far field of each element of a :func:`phased_array`, in place of its aperture, field
        and obliquity: of :func:`read_pattern`, or of this function with a polarisation. Its origin
        is at the positions; the power counts directions behind the plane where it has some; the
        aperture power is NaN. Co-polar refers to ``polarisation``; None: that of the beam.
    precision, engine : see :func:`fourier`.

    Returns
    -------
    xarray.Dataset with
    ``directivity`` (n, m) in dBi, minus infinity where nothing is radiated, and ``field`` (n, m),
    complex, in m times the unit of u; accurate to 1e-12 of the largest |E|. Attributes: the
    wavelength, frequency, obliquity, radiated power, aperture power int |u|^2, the largest
    directivity on these angles, and that of the beam in all directions, ``peak_directivity`` in
    dBi, at ``peak_theta`` and ``peak_phi``; and ``steered_theta`` and ``steered_phi`` if the phases
    of the source point to one direction.

    Of a polarised source ``field`` is the co-polar part, and there are ``cross_field``, complex,
    ``cross_polar_discrimination`` (co- over cross-polar) and ``axial_ratio``, (n, m) in dB.
    Attributes have method in place of obliquity, ``polarisation``, the Jones vector that co-polar
    refers to (real and imaginary part along x, then y; of elements of several polarisations that of
    the beam), and ``peak_axial_ratio`` and ``peak_cross_polar_discrimination`` of the beam.

    Raises
    ------
    ArgumentError for arguments of the wrong type, shape or range; IlluminationError for a source
    that radiates nothing; GeometryError for an Array whose elements do not lie in the plane z = 0;
    EngineError without the engine.

    Warns
    -----
    PolywignerWarning for "kirchhoff" and "rayleigh-sommerfeld-2" of a :func:`fit_illumination` with
    evanescent waves, whose slopes the fit does not know.

    >>> import polywigner as pw
    >>> pattern = pw.radiation_pattern(pw.shapes.square(10e-3), 3.2e-3, 0.0, 0.0)
    >>> round(pattern.attrs["largest_directivity"], 2)  # dBi
    21.35
    """
    polar, azimuth = checked_theta(theta), checked_phi(phi)
    far = checked_far_field(source, wavelength, options)
    values = far.on_grid(polar, azimuth)
    directions = unit_vectors(polar, azimuth)
    return far_field_dataset(far, values, directions, angle_axes(polar, azimuth))


def far_field_dataset(
    far: FarField, values: Values, directions: Values, axes: dict[str, xarray.Variable]
) -> xarray.Dataset:
    """The pattern of a far field (..., or ..., 3) at unit vectors (..., 3) over axes."""
    beam = far.beam()
    if not far.is_vector:
        levels = decibels(np.square(np.abs(values)), far.powers)
        about = {**far.about, **_numbers(far, levels, beam)}
        return described(far.source, axes, {"directivity": levels, "field": values}, about)
    levels = decibels(np.square(np.abs(values)).sum(axis=-1), far.powers)
    ahead = unit_vectors(np.array([beam[1]]), np.array([beam[2]]))[0, 0]
    of_beam = ludwig_components(far.at(ahead), ahead)
    jones = far.jones
    if jones is None or jones.ndim > 1:
        jones = jones_of(of_beam)
    about = far.about | {
        **_numbers(far, levels, beam),
        "peak_axial_ratio": float(axial_ratios(of_beam)),
        "peak_cross_polar_discrimination": float(_discrimination(*co_and_cross(of_beam, jones))),
    }
    along = ludwig_components(values, directions)
    return vector_dataset(axes, levels, along, jones, about, far.source)


def jones_of(components: tuple[Values, Values]) -> Values:
    """The Jones vector of a field with components along x and y, its larger one real."""
    larger = components[int(abs(components[1]) > abs(components[0]))]
    return checked_polarisation(np.stack(components) / larger)


def vector_dataset(
    axes: dict[str, xarray.Variable],
    levels: Values,
    along: tuple[Values, Values],
    jones: Values,
    about: dict[str, Any],
    source: Any = None,
) -> xarray.Dataset:
    """The pattern of a polarised source: directivity (n, m) in dBi, components along x and y."""
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


def decibels(intensity: Values, powers: tuple[float, float]) -> Values:
    with np.errstate(divide="ignore"):
        return np.asarray(10 * np.log10(4 * math.pi / powers[0] * intensity))


def _discrimination(co: Values, cross: Values) -> Values:
    """Co- over cross-polar in dB; infinite without a cross-polar part, NaN without both."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(20 * np.log10(np.abs(co) / np.abs(cross)))


def _numbers(far: FarField, levels: Values, beam: tuple[float, float, float]) -> dict[str, float]:
    """The attributes of a pattern that are numbers."""
    power, energy = far.powers
    numbers = {
        "wavelength": far.wavelength,
        "frequency": SPEED_OF_LIGHT / far.wavelength,
        "radiated_power": power,
        "aperture_power": energy,
        "largest_directivity": float(np.nanmax(levels)),
        "peak_directivity": 10 * math.log10(4 * math.pi / power * beam[0]),
        "peak_theta": beam[1],
        "peak_phi": beam[2],
    }
    steered = steered_direction(far.source, far.wavelength, beam[1:])
    if steered is not None:
        numbers |= {"steered_theta": steered[0], "steered_phi": steered[1]}
    return numbers


_VARIABLES = {
    "directivity": {"units": "dBi", "long_name": "directivity"},
    "field": {"units": "W0.5 sr-0.5", "long_name": "far field r exp(-ikr) U"},
    "cross_field": {"units": "W0.5 sr-0.5", "long_name": "cross-polar far field"},
    "cross_polar_discrimination": {"units": "dB", "long_name": "co- over cross-polar"},
    "axial_ratio": {"units": "dB", "long_name": "axial ratio"},
}


def described(
    source: PlaneSource | Wavefront | None,
    axes: dict[str, xarray.Variable],
    variables: dict[str, Values],
    about: dict[str, Any],
) -> xarray.Dataset:
    from polywigner import __version__

    convention = {
        "convention": "waves exp(+ikr)/r, time exp(-i omega t)",
        "polywigner_version": __version__,
    }
    labelled = {}
    for name, values in variables.items():
        attrs = _VARIABLES[name] | (convention if "field" in name else {})
        labelled[name] = labelled_array(values, tuple(axes), attrs)
    if source is not None:
        axes, about = axes | source_coords(source), about | source_attrs(source)
    return labelled_arrays(labelled, axes, about)
