"""Radiation patterns: the far field over angles, and its directivity."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from polywigner.errors import ArgumentError
from polywigner.execution import Engine, Precision, checked_engine, checked_precision
from polywigner.geometry import Wavefront
from polywigner.geometry.arguments import (
    checked_choice,
    checked_wavelength,
    takes_frequency,
    warn_caller,
)
from polywigner.illumination import Array
from polywigner.illumination.obliquities import (
    ObliquityName,
    checked_obliquity,
    fields_of,
    warn_of_slopes,
)
from polywigner.illumination.polarisation import MODELS, CurrentModel, checked_polarisation
from polywigner.numerics.peaks import climbed, largest
from polywigner.propagation.element_patterns import element_pattern_of
from polywigner.propagation.far_fields import check_slopes, far_field, powers_of
from polywigner.propagation.places import angle_axes, checked_phi, checked_theta, unit_vectors
from polywigner.propagation.stores_checks import source_attrs, source_coords
from polywigner.propagation.vector_fields import (
    axial_ratios,
    co_and_cross,
    far_vectors,
    ludwig_components,
    parts_of,
    vector_powers,
)
from polywigner.quantities import SPEED_OF_LIGHT
from polywigner.radiometry.directions import PlaneSource, checked_radiator
from polywigner.radiometry.hemisphere import check_width, largest_lag
from polywigner.transforms import array_factor
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
    """Theta (n,), phi (m,), directivity (n, m) in dBi, and the numbers among the attributes."""
    try:
        theta, phi = (np.asarray(pattern[name].values, np.float64) for name in ("theta", "phi"))
        levels = np.asarray(pattern["directivity"].transpose("theta", "phi").values, np.float64)
        about = {name: float(pattern.attrs[name]) for name in _ATTRIBUTES}
    except (TypeError, KeyError, IndexError, AttributeError, ValueError):
        raise ArgumentError(
            "expected a pattern with directivity over theta and phi, got "
            f"{type(pattern).__name__} without; use what polywigner.radiation_pattern returned"
        ) from None
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
    obliquity: ObliquityName | None = None,
    polarisation: str | ArrayLike | None = None,
    method: CurrentModel | None = None,
    element: xarray.Dataset | None = None,
    precision: Precision = None,
    engine: Engine = "auto",
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
    dBi, at ``peak_theta`` and ``peak_phi``.

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
    checked_precision(precision)
    checked_engine(engine)
    how: dict[str, Any] = {"precision": precision, "engine": engine}
    if element is not None and not (obliquity is None and method is None):
        raise ArgumentError(
            f"expected an element's pattern without obliquity and method, got {obliquity!r} and "
            f"{method!r}; leave them out"
        )
    if polarisation is not None and obliquity is not None:
        raise ArgumentError(
            f"expected an obliquity or a polarisation, got {obliquity!r} and {polarisation!r}; a "
            "polarised field has a method instead"
        )
    if polarisation is None and method is not None:
        raise ArgumentError(f"expected a polarisation with method={method!r}, got none; give one")
    radiator, length = checked_radiator(source), checked_wavelength(wavelength)
    polar, azimuth = checked_theta(theta), checked_phi(phi)
    check_width(largest_lag(radiator), length)
    view = _View(radiator, length, polar, azimuth)
    if element is not None:
        return _of_elements(view, element, polarisation, how)
    if polarisation is not None:
        model = checked_choice("huygens" if method is None else method, "method", MODELS)
        return _polarised(view, polarisation, model, how)
    name = checked_obliquity(obliquity)
    check_slopes(radiator, name)
    warn_of_slopes(flat_of(radiator), length, name)
    powers = powers_of(radiator, length, name)
    field = far_field(radiator, view.directions, length, name, **how)
    levels = _decibels(np.square(np.abs(field)), powers)
    beam = _beam(view, lambda s: np.square(np.abs(far_field(radiator, s, length, name))))
    about = {"obliquity": name, **_numbers(length, powers, levels, beam)}
    variables = {"directivity": levels, "field": field}
    return described(radiator, angle_axes(polar, azimuth), variables, about)


@dataclass(frozen=True, eq=False)
class _View:
    """A source at a wavelength, seen from angles."""

    source: PlaneSource | Wavefront
    wavelength: float
    theta: Values
    phi: Values

    @property
    def directions(self) -> Values:
        return unit_vectors(self.theta, self.phi)


def _polarised(view: _View, polarisation: Any, model: str, how: dict[str, Any]) -> xarray.Dataset:
    """The pattern of a polarised source."""
    parts = parts_of(view.source, polarisation)
    far = partial(far_vectors, parts, wavelength=view.wavelength, model=model)
    powers = vector_powers(parts, view.wavelength, model)
    jones = checked_polarisation(polarisation, view.source)
    return _of_vectors(view, far(view.directions, **how), far, powers, jones, {"method": model})


# Another frequency, in parts of it, than that of an element's pattern.
_OTHER_FREQUENCY = 0.01


def _of_elements(
    view: _View, pattern: Any, polarisation: Any, how: dict[str, Any]
) -> xarray.Dataset:
    """The pattern of an array of elements with a pattern of their own."""
    source, wavelength = view.source, view.wavelength
    if not isinstance(source, Array) or source.repeated is None:
        raise ArgumentError(
            "expected a phased_array with an element's pattern, got "
            f"{type(source).__name__}; make one by phased_array(element, positions, weights)"
        )
    element = element_pattern_of(pattern)
    frequency = float(pattern.attrs.get("frequency", math.nan))
    if abs(frequency * wavelength / SPEED_OF_LIGHT - 1) > _OTHER_FREQUENCY:
        warn_caller(
            f"got an element's pattern at {frequency:.6g} Hz for an array at "
            f"{SPEED_OF_LIGHT / wavelength:.6g} Hz: it is taken as it is"
        )
    _, positions = source.repeated
    weights = source.weights

    def factor(s: Values, **how: Any) -> Values:
        return np.asarray(array_factor(positions, weights, s[..., :2] / wavelength, **how))

    def far(s: Values) -> Values:
        return element.vectors(s) * factor(s)[..., None]

    extent = float(np.linalg.norm(np.ptp(positions, axis=0)))
    power = element.power(2 * math.pi * extent / wavelength, factor)
    there = element.grid(view.theta, view.phi) * factor(view.directions, **how)[..., None]
    jones = None if polarisation is None else checked_polarisation(polarisation)
    about = {"method": "pattern of the elements"}
    return _of_vectors(view, there, far, (power, math.nan), jones, about)


def _of_vectors(
    view: _View,
    there: Values,
    far: Callable[[Values], Values],
    powers: tuple[float, float],
    jones: Values | None,
    about: dict[str, Any],
) -> xarray.Dataset:
    """The pattern of far fields (n, m, 3) over the angles, and as a function of directions."""
    levels = _decibels(np.square(np.abs(there)).sum(axis=-1), powers)
    beam = _beam(view, lambda s: np.asarray(np.square(np.abs(far(s))).sum(axis=-1)))
    ahead = unit_vectors(np.array([beam[1]]), np.array([beam[2]]))[0, 0]
    of_beam = ludwig_components(far(ahead), ahead)
    if jones is None or jones.ndim > 1:
        jones = jones_of(of_beam)
    about = about | {
        **_numbers(view.wavelength, powers, levels, beam),
        "peak_axial_ratio": float(axial_ratios(of_beam)),
        "peak_cross_polar_discrimination": float(_discrimination(*co_and_cross(of_beam, jones))),
    }
    along, axes = ludwig_components(there, view.directions), angle_axes(view.theta, view.phi)
    return vector_dataset(axes, levels, along, jones, about, view.source)


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


def _decibels(intensity: Values, powers: tuple[float, float]) -> Values:
    with np.errstate(divide="ignore"):
        return np.asarray(10 * np.log10(4 * math.pi / powers[0] * intensity))


def _discrimination(co: Values, cross: Values) -> Values:
    """Co- over cross-polar in dB; infinite without a cross-polar part, NaN without both."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(20 * np.log10(np.abs(co) / np.abs(cross)))


def _numbers(
    wavelength: float,
    powers: tuple[float, float],
    levels: Values,
    beam: tuple[float, float, float],
) -> dict[str, float]:
    """The attributes of a pattern that are numbers."""
    power, energy = powers
    return {
        "wavelength": wavelength,
        "frequency": SPEED_OF_LIGHT / wavelength,
        "radiated_power": power,
        "aperture_power": energy,
        "largest_directivity": float(levels.max()),
        "peak_directivity": 10 * math.log10(4 * math.pi / power * beam[0]),
        "peak_theta": beam[1],
        "peak_phi": beam[2],
    }


def _beam(view: _View, intensity: Callable[[Values], Values]) -> tuple[float, float, float]:
    """Return the largest |E|^2 of all directions in front, in W/sr, and its theta and phi.

    Of several equal ones, that of the smallest theta, and then phi.
    """
    width = np.ptp(np.reshape(flat_of(view.source).bounds, (2, 2)), axis=0) / view.wavelength
    steps = np.maximum(2 * np.ceil(2 * width), _LEAST_STEPS).astype(int)
    windows = [(np.zeros(2), steps // 2)]
    if steps.prod() > _MOST:
        windows = _windows(view, 2 / steps)
    evaluate = partial(_intensity, intensity)
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


def _windows(view: _View, step: Values) -> list[tuple[Values, NDArray[np.intp]]]:
    """Middles of windows of direction cosines that hold the beam of a wide source; half counts."""
    source, wavelength = view.source, view.wavelength
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


def _intensity(intensity: Callable[[Values], Values], places: Values) -> tuple[Values, Values]:
    """Return direction cosines (..., 2), moved into the unit disc, and |E|^2 (...) there."""
    places = places / np.maximum(1, np.linalg.norm(places, axis=-1, keepdims=True))
    cosine = np.sqrt(np.maximum(0, 1 - np.square(places).sum(axis=-1, keepdims=True)))
    directions = np.concatenate([places, cosine], axis=-1).reshape(-1, 3)
    return places, intensity(directions).reshape(places.shape[:-1])


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
