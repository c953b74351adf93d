"""Radiation patterns: the far field over angles, and its directivity."""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from polywigner.errors import ArgumentError
from polywigner.execution import Engine, Precision, checked_engine, checked_precision
from polywigner.geometry import Wavefront
from polywigner.geometry.arguments import checked_wavelength, takes_frequency
from polywigner.illumination.obliquities import (
    DEFAULT,
    OBLIQUITIES,
    ObliquityName,
    fields_of,
    warn_of_slopes,
)
from polywigner.numerics.peaks import climbed, largest
from polywigner.propagation.far_fields import check_slopes, far_field, powers_of
from polywigner.propagation.places import checked_name, checked_phi, checked_theta, unit_vectors
from polywigner.propagation.stores_checks import source_attrs, source_coords
from polywigner.quantities import SPEED_OF_LIGHT
from polywigner.radiometry.directions import PlaneSource, checked_radiator
from polywigner.radiometry.hemisphere import check_width, largest_lag
from polywigner.transforms.wavefronts import flat_of
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
    """Theta (n,), phi (m,), directivity (n, m) in dBi, and the numbers among the attributes.

    Raises ArgumentError for anything but a pattern, one without angles, and what is no number.
    """
    try:
        dims = tuple(pattern["directivity"].dims)
        theta, phi = (np.asarray(pattern[name].values, np.float64) for name in ("theta", "phi"))
        levels = np.asarray(pattern["directivity"].values, np.float64)
        about = {name: float(pattern.attrs[name]) for name in _ATTRIBUTES}
    except (TypeError, KeyError, IndexError, AttributeError, ValueError):
        dims = ()
    if sorted(dims) != ["phi", "theta"]:
        raise ArgumentError(
            "expected a pattern with directivity over theta and phi, got "
            f"{type(pattern).__name__} without; use what polywigner.radiation_pattern returned"
        )
    levels = levels if dims[0] == "theta" else levels.T
    if not levels.size or np.isnan(levels).any():
        what = "angles that are not a number" if levels.size else "no angles"
        raise ArgumentError(f"expected a pattern with numbers at its angles, got {what}")
    return theta, phi, levels, about


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

# Samples of direction cosines across the hemisphere at least: where the source is small the
# obliquity is what varies. Directions at a time: some megabytes.
_LEAST_STEPS = 16
_BLOCK = 1 << 17
# Directions of the whole hemisphere, a tenth of a second; of wider sources those near their waves,
# so many lobes of an element away.
_MOST, _LOBES = 1 << 20, 4.0


@takes_frequency
def radiation_pattern(
    source: PlaneSource | Wavefront,
    wavelength: float,
    theta: ArrayLike,
    phi: ArrayLike,
    *,
    obliquity: ObliquityName = DEFAULT,
    precision: Precision = None,
    engine: Engine = "auto",
) -> xarray.Dataset:
    """Far field and directivity of a source over angles from its normal.

    E = sum over the field's waves of sqrt(g) F/(i lambda), F from :func:`fourier`, without any
    interpolation; the directivity is 4 pi |E|^2/P, with P the integral of |E|^2 over the hemisphere
    to rounding (docs/patterns.md). |E|^2 is in W/sr for |u|^2 in W/m^2. The field is scalar; what
    polarisation it stands for is told to :func:`write_pattern`. Nothing goes backwards.

    Parameters
    ----------
    source : Aperture or Array of apertures in the plane z = 0, with any fields; or one with a
        curved wave.
    wavelength : in m.
    theta : (n,) angles from the normal in rad, from -pi to pi; negative ones, for cuts, lie at the
        opposite phi.
    phi : (m,) angles from the x axis in rad; or one.
    obliquity : g, a boundary condition: cos^2 ("rayleigh-sommerfeld-1"), ((1 + cos)/2)^2
        ("kirchhoff"), 1 ("rayleigh-sommerfeld-2"), or cos ("paper"); for tapers and steering wave
        by wave (docs/theory.md, (D2), (D3)).
    precision, engine : see :func:`fourier`.

    Returns
    -------
    xarray.Dataset with
    ``directivity`` (n, m) in dBi, minus infinity where nothing is radiated, and ``field`` (n, m),
    complex, in m times the unit of u; accurate to 1e-12 of the largest |E|. Attributes: the
    wavelength, frequency, obliquity, radiated power, aperture power int |u|^2, the largest
    directivity on these angles, and that of the beam in all directions, ``peak_directivity`` in
    dBi, at ``peak_theta`` and ``peak_phi``.

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
    checked_precision(precision)
    checked_engine(engine)
    name = checked_name("obliquity", obliquity, OBLIQUITIES)
    radiator, length = checked_radiator(source), checked_wavelength(wavelength)
    polar, azimuth = checked_theta(theta), checked_phi(phi)
    check_slopes(radiator, name)
    warn_of_slopes(flat_of(radiator), length, name)
    check_width(largest_lag(radiator), length)
    power, energy = powers_of(radiator, length, name)
    directions = unit_vectors(polar, azimuth)
    field = far_field(radiator, directions, length, name, precision=precision, engine=engine)
    with np.errstate(divide="ignore"):
        directivity = 10 * np.log10(4 * math.pi / power * np.square(np.abs(field)))
    intensity, peak_theta, peak_phi = _beam(radiator, length, name)
    axes = {"theta": (polar, "angle from z"), "phi": (azimuth, "angle from x")}
    about = {
        "wavelength": length,
        "frequency": SPEED_OF_LIGHT / length,
        "obliquity": name,
        "radiated_power": power,
        "aperture_power": energy,
        "largest_directivity": float(directivity.max()),
        "peak_directivity": 10 * math.log10(4 * math.pi / power * intensity),
        "peak_theta": peak_theta,
        "peak_phi": peak_phi,
    }
    return _described(radiator, axes, field, directivity, about)


def _beam(
    source: PlaneSource | Wavefront, wavelength: float, obliquity: str
) -> tuple[float, float, float]:
    """Return the largest |E|^2 of all directions in front, in W/sr, and its theta and phi.

    Of several equal ones, that of the smallest theta, and then phi.
    """
    width = np.ptp(np.reshape(flat_of(source).bounds, (2, 2)), axis=0) / wavelength
    steps = np.maximum(2 * np.ceil(2 * width), _LEAST_STEPS).astype(int)
    windows = [(np.zeros(2), steps // 2)]
    if steps.prod() > _MOST:
        windows = _windows(source, wavelength, 2 / steps)
    evaluate = partial(_intensity, source, wavelength, obliquity)
    found = []
    for middle, counts in windows:
        across, along = (
            m + step * np.arange(-n, n + 1)
            for m, step, n in zip(middle, 2 / steps, counts, strict=True)
        )
        rows = max(1, _BLOCK // len(across))
        for k in range(0, len(along), rows):
            grid = np.stack(np.meshgrid(across, along[k : k + rows]), axis=-1).reshape(-1, 2)
            found.append(largest(*evaluate(grid), 2 / steps, width))
    places, values = (np.concatenate(parts) for parts in zip(*found, strict=True))
    places, _ = largest(places, values, 2 / steps, width)
    places, values = climbed(evaluate, places, 2 / steps, width)
    theta = np.arcsin(np.minimum(1, np.linalg.norm(places, axis=-1)))
    phi = np.arctan2(places[:, 1], places[:, 0]) % (2 * math.pi)
    first = np.lexsort([phi.round(6), theta.round(6)])[0]
    return float(values.max()), float(theta[first]), float(phi[first])


def _windows(
    source: PlaneSource | Wavefront, wavelength: float, step: Values
) -> list[tuple[Values, NDArray[np.intp]]]:
    """Middles of windows of direction cosines that hold the beam of a wide source; half counts.

    Elements radiate within some lobes about their waves, whatever their weights add up to.
    """
    flat = flat_of(source)
    sides = [np.ptp(np.reshape(e.bounds, (2, 2)), axis=0) for e in flat.elements_in_plane]
    reach = _LOBES * wavelength / np.min(sides, axis=0)
    if isinstance(source, Wavefront):
        half = np.ptp(np.reshape(flat.bounds, (2, 2)), axis=0) / 2
        reach = reach + wavelength * np.abs(source.curvature) @ half
    counts = np.ceil(np.minimum(reach, 1.0) / step).astype(np.intp)
    waves = [np.zeros((1, 2)) if f is None else f.frequencies for f in fields_of(flat)]
    middles = np.unique(np.round(np.concatenate(waves) * wavelength / step), axis=0) * step
    return [(middle, counts) for middle in middles if np.linalg.norm(middle) <= 1.0]


def _intensity(
    source: PlaneSource | Wavefront, wavelength: float, obliquity: str, places: Values
) -> tuple[Values, Values]:
    """Return direction cosines (..., 2), moved into the unit disc, and |E|^2 (...) there."""
    places = places / np.maximum(1, np.linalg.norm(places, axis=-1, keepdims=True))
    cosine = np.sqrt(np.maximum(0, 1 - np.square(places).sum(axis=-1, keepdims=True)))
    directions = np.concatenate([places, cosine], axis=-1).reshape(-1, 3)
    field = far_field(source, directions, wavelength, obliquity)
    return places, np.square(np.abs(field)).reshape(places.shape[:-1])


def _described(
    source: PlaneSource | Wavefront,
    axes: dict[str, tuple[Values, str]],
    field: Values,
    directivity: Values,
    about: dict[str, Any],
) -> xarray.Dataset:
    from polywigner import __version__

    dims = tuple(axes)
    names = {"units": "dBi", "long_name": "directivity"}
    far = {
        "units": "W0.5 sr-0.5",
        "long_name": "far field r exp(-ikr) U",
        "convention": "waves exp(+ikr)/r, time exp(-i omega t)",
        "polywigner_version": __version__,
    }
    return labelled_arrays(
        {
            "directivity": labelled_array(directivity, dims, names),
            "field": labelled_array(field, dims, far),
        },
        {
            name: labelled_array(values, (name,), {"units": "rad", "long_name": meaning})
            for name, (values, meaning) in axes.items()
        }
        | source_coords(source),
        about | source_attrs(source),
    )
