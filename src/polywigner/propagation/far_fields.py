"""Far fields as functions of direction: field, radiated power, beam and steering direction."""

from __future__ import annotations

import math
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cached_property, partial
from typing import TYPE_CHECKING, Any, TypedDict

import numpy as np
from numpy.typing import ArrayLike, NDArray

from polywigner.errors import ArgumentError, IlluminationError
from polywigner.execution import Engine, Precision, checked_engine, checked_precision
from polywigner.geometry import Wavefront
from polywigner.geometry.arguments import (
    check_options,
    checked_choice,
    checked_wavelength,
    takes_frequency,
    warn_caller,
)
from polywigner.geometry.rings import sides_of
from polywigner.numerics import Complex, Floats, index_blocks
from polywigner.propagation.element_patterns import element_pattern_of
from polywigner.propagation.point_grids import unit_vectors
from polywigner.propagation.vector_fields import far_vectors, polarised_parts, vector_powers
from polywigner.quantities import SPEED_OF_LIGHT
from polywigner.radiometry.directions import (
    PlaneSource,
    check_width,
    checked_powers,
    checked_radiator,
    directions_and_weights,
    largest_lag,
    power_by_lags,
)
from polywigner.radiometry.flux import radiant_intensity
from polywigner.source import Array
from polywigner.source.normal_form import normal_form
from polywigner.source.obliquities import (
    DEFAULT,
    OBLIQUITIES,
    ObliquityName,
    obliquity_of,
    times_direction_cosine,
)
from polywigner.source.polarisation import MODELS, CurrentModel, checked_polarisation
from polywigner.transforms import array_factor, fourier
from polywigner.transforms.public_transforms import energy_of
from polywigner.transforms.wavefronts import flat_source, is_partly_coherent

if TYPE_CHECKING:
    import xarray

Values = NDArray[Any]


def far_field(
    source: Any,
    directions: Floats,
    wavelength: float,
    obliquity: str,
    *,
    precision: Precision = None,
    engine: Engine = "auto",
) -> Complex:
    """Return the far field of a source in directions s (..., 3) (RP1).

    The far field is the limit of ``r exp(-i k r) U(r s)`` at large distances r, in m times the unit
    of the source's field. The far field is zero at z < 0.
    """
    nu, cosine = directions[..., :2] / wavelength, directions[..., 2]
    front = np.maximum(cosine, 0.0)
    condition = OBLIQUITIES[obliquity]
    factor = condition.field * front if condition.is_boundary_condition else np.sqrt(front)
    total: Complex = np.zeros(front.shape, np.complex128)
    if condition.field or not condition.is_boundary_condition:
        spectrum = fourier(source, nu, precision=precision, engine=engine)
        total = np.asarray(factor * spectrum, np.complex128)
    if condition.needs_normal_derivative:
        # If all waves graze the plane, times_direction_cosine raises an error. The normal
        # derivative is then zero.
        with suppress(IlluminationError):
            slopes = times_direction_cosine(source, wavelength)
            spectrum = fourier(slopes, nu, precision=precision, engine=engine)
            total = total + condition.slope * spectrum
    values = np.where(cosine < 0, 0.0, total / (1j * wavelength))
    return values.astype(np.complex64 if precision == "single" else np.complex128)


@takes_frequency
def radiated_power(
    source: PlaneSource | Wavefront, wavelength: float, obliquity: ObliquityName = DEFAULT
) -> float:
    """Return the radiated power of a source: the integral of |E|^2 over the hemisphere (RP2).

    The radiated power differs from the integral of |u|^2 over the source, because evanescent waves
    do not radiate, and because it depends on the boundary condition (docs/patterns.md). For
    example, a patch of a third of a wavelength radiates a seventh of this integral. With
    ``obliquity="paper"`` the result equals :func:`power`.

    Parameters
    ----------
    source : Aperture, Array or Wavefront
        Source in the plane z = 0 with |u|^2 in W/m^2. A Wavefront may be curved or partially
        coherent.
    wavelength : float
        Wavelength in m.
    obliquity : str, default "rayleigh-sommerfeld-1"
        See :func:`radiation_pattern`.

    Returns
    -------
    float
        Power in W, accurate to 1e-12 of the integral of |u|^2 over the source.

    Notes
    -----
    The function computes the Fourier transform of the source in about
    15 (diameter/wavelength)^2 + 1000 directions. For sources wider than 600 wavelengths the power
    is an integral over lags, as in :func:`power`. This integral is accurate to 1e-8, or to 1e-5 for
    obliquities with normal derivatives.

    Raises
    ------
    ArgumentError
        If an argument has the wrong type or range.
    IlluminationError
        If the source radiates nothing.
    GeometryError
        If elements of an Array do not lie in the plane z = 0.

    Examples
    --------
    >>> import polywigner as pw
    >>> patch = pw.shapes.rectangle(1.2e-3, 0.9e-3)  # |u|^2 = 1 W/m^2 on 1.08 mm^2
    >>> round(pw.radiated_power(patch, 3.9e-3) / patch.area, 3)
    0.135
    """
    name = checked_choice(obliquity, "obliquity", OBLIQUITIES)
    radiator, length = checked_radiator(source, partly=True), checked_wavelength(wavelength)
    check_slopes(radiator, name)
    return powers_of(radiator, length, name)[0]


def check_slopes(source: PlaneSource | Wavefront, name: str) -> None:
    """Raise ArgumentError for a Wavefront with an obliquity that requires normal derivatives."""
    if isinstance(source, Wavefront) and OBLIQUITIES[name].needs_normal_derivative:
        raise ArgumentError(
            f"obliquity {name!r} is not available for curved waves and partially coherent light, "
            "because its factor varies with position and tilt; use "
            f'{DEFAULT!r} or "paper", or compute the near field of coherent light with '
            "polywigner.amplitude"
        )


def powers_of(
    source: PlaneSource | Wavefront, wavelength: float, obliquity: str
) -> tuple[float, float]:
    """Return the radiated power of a source, and the integral of |u|^2 over the source, in W.

    ``obliquity`` is a key of ``OBLIQUITIES``. Raises IlluminationError if the source radiates
    almost nothing.
    """
    power = power_by_lags(source, wavelength, obliquity)
    if power is None:
        blocks = directions_and_weights(largest_lag(source), wavelength)
        power = float(sum(w @ _intensity(source, s, wavelength, obliquity) for s, w in blocks))
    return checked_powers(power, energy_of(source), wavelength)


def _intensity(
    source: PlaneSource | Wavefront, directions: NDArray[np.float64], wavelength: float, name: str
) -> NDArray[np.float64]:
    """Return |E|^2 in W/sr in directions (n, 3), also for partially coherent sources."""
    if not is_partly_coherent(source):
        return np.square(np.abs(far_field(source, directions, wavelength, name)))
    # `radiant_intensity` includes the factor cos(theta) of "paper". The default condition requires
    # cos^2(theta).
    factor = 1.0 if name == "paper" else directions[:, 2]
    return np.asarray(radiant_intensity(source, directions, wavelength) * factor)


# Smallest number of samples along a direction cosine, enough for the obliquity factor of small
# sources.
_LEAST_STEPS = 16
# Number of directions per block, which takes some megabytes.
_BLOCK = 1 << 17
# Largest number of directions in a search of the whole hemisphere, which takes a tenth of a second.
_MOST = 1 << 20
# Radius of the search for the peak of a wide source about the direction of each plane wave, in
# widths of an element's main lobe.
_LOBES = 4.0
# Relative frequency difference between element and array that causes a warning.
_OTHER_FREQUENCY = 0.01


@dataclass(frozen=True, eq=False)
class FarField:
    """The far field of a source as a function of direction."""

    source: PlaneSource | Wavefront | None
    """Source of the far field; None for a table."""
    wavelength: float
    """Wavelength in m."""
    at: Callable[..., Values]
    """Function that returns the field, or its vectors, in given directions (unit vectors)."""
    powers: tuple[float, float]
    """Radiated power, and integral of |u|^2 over the source, in W."""
    about: dict[str, Any]
    """Boundary condition or model of currents."""
    is_vector: bool = True
    """Whether the field is an electric field (three components)."""
    jones: Values | None = None
    """Jones vector of the co-polar part; None for the polarisation of the beam."""
    goes_backwards: bool = False
    """Whether the source radiates to z < 0."""
    known_beam: tuple[float, float, float] | None = None
    """Value of ``beam`` for a table."""
    on_grid: Callable[[Values, Values], Values] | None = None
    """Function that returns the field over theta (n,) and phi (m,), if it is faster than ``at``."""
    how: dict[str, Any] = field(default_factory=dict)
    """Keyword arguments ``precision`` and ``engine`` of ``at``."""

    def grid(self, theta: Values, phi: Values) -> Values:
        """Return the field (n, m), or its vectors (n, m, 3), over theta and phi in rad."""
        if self.on_grid is not None:
            return self.on_grid(theta, phi)
        return self.at(unit_vectors(theta, phi), **self.how)

    def intensity(self, directions: Values) -> Values:
        """Return the radiant intensity |E|^2 in W/sr in directions (..., 3) (unit vectors)."""
        squares = np.square(np.abs(self.at(directions)))
        return np.asarray(squares.sum(axis=-1) if self.is_vector else squares)

    @cached_property
    def beam(self) -> tuple[float, float, float]:
        """Largest |E|^2 [W/sr] in front of the plane, and theta and phi [rad] of its direction.

        Among equal maxima, the direction with the smallest theta, then the smallest phi, is used.
        """
        if self.known_beam is not None:
            return self.known_beam
        extent = sides_of(flat_source(self.source).bounds)
        width = extent / self.wavelength
        steps = np.maximum(2 * np.ceil(2 * width), _LEAST_STEPS).astype(int)
        windows = [(np.zeros(2), steps // 2)]
        if steps.prod() > _MOST:
            windows = self._windows(2 / steps)
        candidates = []
        for centre, counts in windows:
            across, along = (
                m + step * np.arange(-n, n + 1)
                for m, step, n in zip(centre, 2 / steps, counts, strict=True)
            )
            for rows in index_blocks(len(along), _BLOCK // len(across)):
                grid = np.stack(np.meshgrid(across, along[rows]), axis=-1).reshape(-1, 2)
                candidates.append(_near_peak(*self._on_disc(grid), 2 / steps, width))
        cosines, values = (np.concatenate(parts) for parts in zip(*candidates, strict=True))
        cosines, _ = _near_peak(cosines, values, 2 / steps, width)
        cosines, values = _peaks(self._on_disc, cosines, 2 / steps, width)
        theta = np.arcsin(np.minimum(1, np.linalg.norm(cosines, axis=-1)))
        phi = np.arctan2(cosines[:, 1], cosines[:, 0]) % (2 * math.pi)
        first = np.lexsort([phi.round(6), theta.round(6)])[0]
        return float(values.max()), float(theta[first]), float(phi[first])

    def _windows(self, step: Values) -> list[tuple[Values, NDArray[np.intp]]]:
        """Return regions of direction cosines to search for the beam: centres and step counts.

        The counts (2,) are numbers of steps on each side of a centre (2,).
        """
        source, wavelength = self.source, self.wavelength
        flat = flat_source(source)
        sides = [sides_of(e.bounds) for e in flat.elements_in_plane]
        radius = _LOBES * wavelength / np.min(sides, axis=0)
        if isinstance(source, Wavefront):
            half = sides_of(flat.bounds) / 2
            radius = radius + wavelength * np.abs(source.curvature) @ half
        counts = np.ceil(np.minimum(radius, 1.0) / step).astype(np.intp)
        waves = normal_form(flat).frequencies
        centres = np.unique(np.round(waves * wavelength / step), axis=0) * step
        return [(centre, counts) for centre in centres if np.linalg.norm(centre) <= 1.0]

    def _on_disc(self, cosines: Values) -> tuple[Values, Values]:
        """Move direction cosines (..., 2) into the unit disc; return them with intensities.

        Cosines outside the disc are scaled onto its rim. Intensities (...) are in W/sr.
        """
        cosines = cosines / np.maximum(1, np.linalg.norm(cosines, axis=-1, keepdims=True))
        third = np.sqrt(np.maximum(0, 1 - np.square(cosines).sum(axis=-1, keepdims=True)))
        directions = np.concatenate([cosines, third], axis=-1).reshape(-1, 3)
        return cosines, self.intensity(directions).reshape(cosines.shape[:-1])


# The spectrum |F|^2 of a source of width D is at least cos^2(pi d D) times the peak at the distance
# d from the peak, along an axis. This value is a lower bound on the sample next to the largest
# peak. _WINDOW is the number of samples on each side of the centre of the search window, and the
# factor by which the window shrinks in each of _ROUNDS rounds. The position of the peak is accurate
# to 4^-8 steps. The height varies quadratically and is accurate to about 1e-9.
_WINDOW, _ROUNDS = 4, 8
_EQUAL = 1e-9
# Largest number of samples from which a local search starts.
_MOST_REFINED = 256


def _near_peak(
    points: Floats, values: Floats, step: Floats, width: Floats
) -> tuple[Floats, Floats]:
    """Return samples that may lie next to the largest peak, in descending order of their values.

    Points have the shape (n, 2), and values have the shape (n,). The product of ``step`` and
    ``width`` (source width in wavelengths) is at most 1/2.
    """
    fraction = float(np.cos(math.pi * width * step / 2).prod()) ** 2
    best = np.argsort(-values, kind="stable")[:_MOST_REFINED]
    best = best[values[best] >= min(fraction, 1 - _EQUAL) * values[best[0]]]
    return points[best], values[best]


def _peaks(
    evaluate: Callable[[Floats], tuple[Floats, Any]], points: Floats, step: Floats, width: Floats
) -> tuple[Floats, Floats]:
    """Return positions and heights of the largest peaks, from samples near them.

    ``evaluate`` moves points into its domain, and returns them with the values.
    """
    around = np.arange(-_WINDOW, _WINDOW + 1) / _WINDOW
    window = np.stack(np.meshgrid(around, around), axis=-1).reshape(-1, 2)
    values = np.empty(0)
    for _ in range(_ROUNDS):
        near, values = evaluate(points[:, None] + step * window)
        step = step / _WINDOW
        best = np.arange(len(near)), values.argmax(axis=-1)
        distinct = np.unique((near[best] / step).round(), axis=0, return_index=True)[1]
        points, values = _near_peak(near[best][distinct], values[best][distinct], step, width)
    return points, values


class FarFieldOptions(TypedDict, total=False):
    """Options of :func:`radiation_pattern` and :func:`beam_cuts`."""

    obliquity: ObliquityName | None
    polarisation: str | ArrayLike | None
    method: CurrentModel | None
    element: xarray.Dataset | None
    precision: Precision
    engine: Engine


def checked_far_field(source: Any, wavelength: Any, options: FarFieldOptions) -> FarField:
    """Return the far field for the arguments of :func:`radiation_pattern`."""
    check_options(options, FarFieldOptions)
    obliquity, polarisation, method, element = (
        options.get(name) for name in ("obliquity", "polarisation", "method", "element")
    )
    how: dict[str, Any] = {
        "precision": checked_precision(options.get("precision")),
        "engine": checked_engine(options.get("engine", "auto")),
    }
    if element is not None and not (obliquity is None and method is None):
        raise ArgumentError(
            "element= cannot be combined with an obliquity or a method, got "
            f"obliquity={obliquity!r} and method={method!r}; omit both, since the pattern of the "
            "element replaces them"
        )
    if polarisation is not None and obliquity is not None:
        raise ArgumentError(
            f"expected either an obliquity or a polarisation, got obliquity={obliquity!r} and "
            f"polarisation={polarisation!r}; for polarised fields, pass method instead of "
            "obliquity"
        )
    if polarisation is None and method is not None:
        raise ArgumentError(f"method={method!r} requires a polarisation; pass polarisation=")
    radiator, length = checked_radiator(source), checked_wavelength(wavelength)
    check_width(largest_lag(radiator), length)
    if element is not None:
        return _array_field(radiator, length, element, polarisation, how)
    if polarisation is not None:
        model = checked_choice("huygens" if method is None else method, "method", MODELS)
        parts = polarised_parts(radiator, polarisation)
        at = partial(far_vectors, parts, wavelength=length, model=model)
        powers = vector_powers(parts, length, model)
        jones = checked_polarisation(polarisation, radiator)
        return FarField(radiator, length, at, powers, {"method": model}, jones=jones, how=how)
    name = obliquity_of(obliquity).name
    check_slopes(radiator, name)
    at = partial(far_field, radiator, wavelength=length, obliquity=name)
    powers = powers_of(radiator, length, name)
    return FarField(radiator, length, at, powers, {"obliquity": name}, is_vector=False, how=how)


def _array_field(
    source: Any, wavelength: float, pattern: Any, polarisation: Any, how: dict[str, Any]
) -> FarField:
    """Return the far field of an array whose elements have a given pattern (a dataset).

    Raises ArgumentError unless the source is a phased array.
    """
    if not isinstance(source, Array) or source.repeated is None:
        raise ArgumentError(
            f"element= requires a phased_array, got {type(source).__name__}; create one with "
            "phased_array(element, positions, weights)"
        )
    element = element_pattern_of(pattern)
    frequency = float(pattern.attrs.get("frequency", math.nan))
    if abs(frequency * wavelength / SPEED_OF_LIGHT - 1) > _OTHER_FREQUENCY:
        warn_caller(
            f"the element pattern was computed at {frequency:.6g} Hz, but the array is used at "
            f"{SPEED_OF_LIGHT / wavelength:.6g} Hz; the pattern is used without correction"
        )
    _, positions = source.repeated

    def factor(s: Values, **how: Any) -> Values:
        """Return the array factor in directions (..., 3)."""
        return np.asarray(array_factor(positions, source.weights, s[..., :2] / wavelength, **how))

    def at(s: Values) -> Values:
        """Return far-field vectors in directions (..., 3)."""
        return element.vectors(s) * factor(s)[..., None]

    def on_grid(theta: Values, phi: Values) -> Values:
        """Return far-field vectors (n, m, 3) at angles theta (n,) and phi (m,)."""
        return element.grid(theta, phi) * factor(unit_vectors(theta, phi), **how)[..., None]

    extent = float(np.linalg.norm(np.ptp(positions, axis=0)))
    power = element.power(2 * math.pi * extent / wavelength, factor)
    jones = None if polarisation is None else checked_polarisation(polarisation)
    return FarField(
        source, wavelength, at, (power, math.nan), {"method": "pattern of the elements"},
        jones=jones, goes_backwards=element.covers_sphere, on_grid=on_grid,
    )  # fmt: skip


# Largest deviation [rad] of an array's phases from linear phases. Phases in rounded tables deviate
# less, and phases of quantised phase shifters deviate more.
_LINEAR = 0.02
# Tolerance for the symmetry of frequencies, as a fraction of 1/wavelength.
_SYMMETRIC = 1e-6
_MOST_WAVES = 4096


def steered_direction(
    source: PlaneSource | Wavefront | None, wavelength: float, beam: tuple[float, float]
) -> tuple[float, float] | None:
    """Return theta and phi in rad to which a source is steered, or None if unknown.

    The direction is known for an array with linear phases (except for sign changes), and for an
    aperture with a real taper times a plane wave. The angles of ``beam`` select one of several
    grating lobes.
    """
    if source is None or isinstance(source, Wavefront):
        return None
    if isinstance(source, Array):
        if source.repeated is None:
            return None
        positions = source.repeated[1]
        near = math.sin(beam[0]) * np.array([math.cos(beam[1]), math.sin(beam[1])])
        cosines = _phase_slope(positions, source.weights, wavelength, near)
    else:
        cosines = _central_wave(source.illumination, wavelength)
    if cosines is None or np.linalg.norm(cosines) > 1:
        return None
    theta = math.asin(float(np.linalg.norm(cosines)))
    phi = round(math.atan2(cosines[1], cosines[0]), 12) % (2 * math.pi)
    return theta, phi if theta > _SYMMETRIC else 0.0


def _phase_slope(
    positions: Values, weights: Values, wavelength: float, near: Values
) -> Values | None:
    """Return the direction cosines (2,) to which the weights of an array are steered, or None.

    The phases must be linear, except for sign changes. The direction cosines ``near`` (2,) select
    one of several grating lobes.
    """
    if len(weights) < 2:
        return None
    residual = weights * np.exp(-2j * np.pi * (positions @ near) / wavelength)
    # Squaring removes the signs of tapers.
    squares = residual**2 * np.conj((residual**2).sum())
    phases, strength = np.angle(squares) / 2, np.abs(weights)
    columns = np.column_stack([positions / wavelength * 2 * np.pi, np.ones(len(weights))])
    slope = np.linalg.lstsq(columns * strength[:, None], phases * strength, rcond=1e-9)[0]
    error = np.abs(phases - columns @ slope)[strength > 1e-6 * strength.max()].max()
    return near + slope[:2] if error <= _LINEAR else None


def _central_wave(illumination: Any, wavelength: float) -> Values | None:
    """Return the direction cosines (2,) of a real taper times a plane wave, or None."""
    if illumination is None:
        return np.zeros(2)
    waves, sizes = illumination.frequencies * wavelength, np.abs(illumination.amplitudes)
    if len(waves) > _MOST_WAVES or not sizes.any():
        return None
    centre = (waves * np.square(sizes)[:, None]).sum(axis=0) / np.square(sizes).sum()
    rows = np.column_stack([waves - centre, sizes / sizes.max()])
    opposite = rows * (-1, -1, 1)
    order, reverse = (np.lexsort(part.round(6).T) for part in (rows, opposite))
    is_symmetric = np.abs(rows[order] - opposite[reverse]).max() <= _SYMMETRIC
    return centre if is_symmetric else None
