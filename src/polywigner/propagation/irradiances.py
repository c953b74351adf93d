"""Irradiance |U|^2 at points in front of a source."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from polywigner import execution, kernels
from polywigner.errors import ArgumentError
from polywigner.execution import Engine, Precision
from polywigner.geometry import Aperture, Wavefront
from polywigner.geometry.arguments import (
    checked_flag,
    checked_number,
    checked_wavelength,
    takes_frequency,
    warn_caller,
)
from polywigner.optics import FirstOrder
from polywigner.propagation.amplitudes import Obstacle, amplitude, shaped
from polywigner.propagation.boundary import radiator_of
from polywigner.propagation.collins import (
    checked_points_behind,
    field_behind,
    squared_field,
    systems_and_stops,
)
from polywigner.propagation.far_fields import check_slopes
from polywigner.propagation.partial_coherence import partly_coherent_irradiance
from polywigner.propagation.places import (
    DEFAULT_TOLERANCE,
    METHODS,
    checked_method,
    checked_points,
)
from polywigner.propagation.screens import PointSource, Screen
from polywigner.propagation.shadows import LEAST_TOLERANCE
from polywigner.propagation.wigner_rays import Rays, summed_rays
from polywigner.radiometry.directions import (
    checked_bandwidth,
    checked_radiator,
    longest_path,
    wavelengths_of_band,
)
from polywigner.source import Array
from polywigner.source.obliquities import (
    DEFAULT,
    ObliquityName,
    obliquity_of,
)
from polywigner.transforms.phase_space import energy_of
from polywigner.transforms.traced_sources import check_no_drjit
from polywigner.transforms.wavefronts import coherent_source, flat_of, is_partly_coherent, tilts_of
from polywigner.transforms.xarray_arguments import takes_xarray


def mean_over_mixture(
    compute: Callable[[Any, float], Any],
    source: Any,
    wavelength: Any,
    bandwidth: float | None,
    error: float,
    return_error: bool,
    by_lags: bool = False,
) -> Any:
    """The mean of ``compute(source, wavelength)`` over the tilts and wavelengths of light.

    With ``return_error`` of values and of errors. ``error`` : of the mean, relative to the largest
    irradiance that there could be.
    """
    total: Any = 0.0
    parts = parts_of(source, checked_wavelength(wavelength), bandwidth, error, by_lags)
    for one, length, weight in parts:
        total = total + weight * np.asarray(compute(one, length))
    return (total[0][()], total[1][()]) if return_error else total[()]


def parts_of(
    source: Any,
    wavelength: float,
    bandwidth: float | None,
    error: float,
    by_lags: bool = False,
) -> Iterator[tuple[Any, float, float]]:
    """Sources, wavelengths in m, and weights, whose mean is the mixture.

    The sources are coherent, unless partly coherent light is computed ``by_lags``.
    """
    band = [(wavelength, 1.0)]
    if bandwidth is not None:
        width = checked_bandwidth(bandwidth, wavelength)
        band = wavelengths_of_band(wavelength, width, longest_path(source), error)
    for length, weight in band:
        lit = source.at_wavelength(length)
        for tilted, share in [(lit, 1.0)] if by_lags else _tilted(lit, error):
            yield tilted, length, share * weight


def _tilted(source: Any, error: float) -> Iterator[tuple[Any, float]]:
    if not is_partly_coherent(source):
        yield source, 1.0
        return
    for tilt, share in zip(*tilts_of(source, error), strict=True):
        yield coherent_source(source, tilt), float(share)


Values = NDArray[np.float64]

# Relative to the largest irradiance that there can be at a distance: below, errors are absolute.
_FLOOR = 1e-3
_TOLERANCE = 1e-3
# Least tolerance that float32 kernels can keep, relative to the same.
_SINGLE = 1e-5
# Errors of means over tilts and wavelengths: as a fraction of the tolerance, a tenth of the floor;
# and of those of exact fields.
_OF_MIXTURE, _OF_EXACT = 1e-4, 1e-7
# Errors of shadows, as a fraction of the tolerance.
_OF_SHADOWS = 0.1
# Edges from which on rays take seconds, and the exact field a hundredth of that.
_MANY_EDGES = 50
# Distance to the source in wavelengths below which rays are a rough approximation.
_NEAREST = 2.0


@takes_frequency
@takes_xarray("points", units="W m-2", long_name="irradiance |U|^2")
def irradiance(
    source: Aperture | Array | Wavefront | Screen | PointSource,
    points: ArrayLike,
    wavelength: float,
    method: str = "wigner",
    *,
    through: FirstOrder | Sequence[FirstOrder | Aperture | Array] | None = None,
    obstacles: Obstacle | Sequence[Obstacle] | None = None,
    obliquity: ObliquityName | None = None,
    tolerance: float = _TOLERANCE,
    return_error: bool = False,
    bandwidth: float | None = None,
    precision: Precision = None,
    engine: Engine = "auto",
) -> Any:
    """Irradiance |U|^2 at points in front of a source, by Wigner rays or one of the other methods.

    By rays, each position on the automean sends one to each point, with the radiance W in that
    direction (R1): the paper's method, to leading order. It is not the flux through a receiver
    that is tilted. All other methods are the square of :func:`amplitude`, and exact.

    Parameters
    ----------
    source : an Aperture, or an Array of apertures in the plane z = 0, uniform or with
        illuminations; one with a curved wave; or a :class:`Screen`, by the methods of
        :func:`amplitude`; or a :class:`PointSource`, by any method.
    points : (..., 3) in m, z > 0, or (..., 2) with ``through``.
    wavelength : in m.
    method : "wigner" (the default), or one of :func:`amplitude`; or "auto", the exact field of the
        boundary condition that ``obliquity`` names. Rays are for study: behind an outline of many
        edges the exact field is a hundred times as fast (300 vertices, 50 points: 0.19 s instead
        of 19.7 s).
    through : as of :func:`amplitude`: the square of Collins' integral, which is exactly the
        integral of W over all frequencies.
    obstacles : bodies and plates in the way, whose shadows diffract, as in :func:`amplitude`; with
        "auto" or a method of :func:`amplitude`, for light of one wavelength.
    obliquity : the boundary condition that the rays are matched to, as of
        :func:`radiation_pattern`; or "paper", a factor cos(theta) of no boundary condition. Of
        fields of several waves it is applied to each pair of waves. Also that of "fraunhofer",
        "paper" excepted; the other methods have their own.
    tolerance : error of the sum over rays, relative to the irradiance where that is above 1e-3 of
        the largest that a source of this power and area can make at that distance, else relative
        to 1e-3 of that: (T2); in single precision at least 1e-5 of the largest. It is not the error
        of rays as such, which docs/propagation.md has.
        The other methods are at least as accurate as :func:`amplitude` is by default; in partly
        coherent light they err by up to 1e-4 of the tolerance, 1e-7, of the largest irradiance.
    return_error : return an estimate of that error as well.
    bandwidth : in Hz; the mean over light of all frequencies that are at most half of it from that
        of the wavelength (docs/coherence.md, (PC6)). None: light of the one wavelength.
    precision, engine : see :func:`fourier`.

    Returns
    -------
    (...) float64, in the unit of the source's |u|^2; slightly negative at places, near nulls. With
    ``return_error`` a pair, the second the estimated errors of the sum, the difference between the
    last two rules; infinite at points so near to the source that their rays pass between the nodes
    of every rule.
    An ``xarray.DataArray`` gives one.

    Raises
    ------
    ArgumentError for arguments of the wrong type, shape or range, Dr.Jit arrays, sources of more
    wavelengths than rays can be summed up of (some hundred for points aslant nearby, thousands far
    away); GeometryError for an Array whose elements do not lie in the plane z = 0; EngineError
    without the engine.

    Warns
    -----
    PolywignerWarning where rays are not valid: points nearer than two wavelengths; where a
    tolerance cannot be met; and where :func:`amplitude` does of fits.

    >>> import polywigner as pw
    >>> round(float(pw.irradiance(pw.shapes.square(10e-3), (0.0, 0.0, 0.1), 3.2e-3, "auto")), 4)
    0.0963
    """
    run: dict[str, Any] = {"precision": precision, "engine": engine}
    how: dict[str, Any] = {"obliquity": obliquity, "tolerance": tolerance}
    checked_method(method, ("wigner", *METHODS, "auto"))
    checked_flag(return_error, "return_error")
    allowed = checked_tolerance(tolerance)
    check_no_drjit(source=source, points=points, wavelength=wavelength)
    if obstacles is not None:
        _check_shadowed(method, through, bandwidth)
    by_lags = through is None and method == "wigner" and _is_by_lags(source, obliquity)
    if bandwidth is not None or (is_partly_coherent(source) and not by_lags):

        def compute(one: Any, length: float, places: Any = points) -> Any:
            options: dict[str, Any] = {"through": through, "obstacles": obstacles, **how, **run}
            return irradiance(one, places, length, method, return_error=return_error, **options)

        error, lit = _OF_MIXTURE * allowed, compute
        if obstacles is not None:
            error = _OF_SHADOWS * allowed
        elif method != "wigner":
            error = min(error, _OF_EXACT)
        if is_partly_coherent(source) and not by_lags and obstacles is None:
            name = obliquity_of(obliquity).name if method == "auto" else method
            lit = partial(_of_partly_coherent, compute, points, name, through, error, return_error)
        return mean_over_mixture(
            lit, source, wavelength, bandwidth, error, return_error, by_lags=obstacles is None
        )
    if through is not None:
        others = {"method": None if method in ("wigner", "auto", "fresnel") else method}
        return field_behind(
            source, points, wavelength, through, None if allowed == _TOLERANCE else allowed,
            {**others, "obliquity": obliquity}, squared=True, return_error=return_error, **run,
        )  # fmt: skip
    if method == "auto":
        condition = obliquity_of(obliquity)
        is_exact = condition.is_boundary_condition
        method, obliquity = (condition.name, None) if is_exact else ("wigner", condition.name)
    if obstacles is not None:
        run["tolerance"] = max(_OF_SHADOWS * allowed, LEAST_TOLERANCE)
        options: dict[str, Any] = {"obstacles": obstacles, "obliquity": obliquity, **run}
        return _squared(source, points, wavelength, method, return_error, options)
    length = checked_wavelength(wavelength)
    if isinstance(source, PointSource):  # its rays carry |exp(ikR)/R|^2 exactly
        options = {**run, "obliquity": obliquity}
        exact = DEFAULT if method == "wigner" else method
        return _squared(source, points, length, exact, return_error, options)
    radiator = source if isinstance(source, Screen) else checked_radiator(source, partly=by_lags)
    places = checked_points(points)
    if method != "wigner":
        run["obliquity"] = obliquity
        if allowed < DEFAULT_TOLERANCE[precision != "single"]:
            run["tolerance"] = allowed
        return _squared(radiator, places, length, method, return_error, run)
    if isinstance(radiator, Screen):
        raise ArgumentError(
            'expected another method than "wigner" behind a Screen, whose field has no rays of '
            f"its own; use method={DEFAULT!r}"
        )
    found = _by_rays(radiator, places, length, obliquity, allowed, **run)
    return shaped(*found, places, return_error)


def _by_rays(
    source: Aperture | Array | Wavefront,
    places: Values,
    wavelength: float,
    obliquity: Any,
    allowed: float,
    precision: Precision,
    engine: Engine,
) -> tuple[Values, Values]:
    """Irradiance by Wigner rays, and the estimate of its error, (n,) at all points (..., 3)."""
    condition = obliquity_of(obliquity)
    name = condition.name
    flat_source: Any = flat_of(source)
    curved = _curved(source)
    if curved:
        check_slopes(source, name)
    execution.checked_engine(engine)
    double = execution.checked_precision(precision) != "single"
    fields = condition.terms(flat_source, wavelength)
    width = source.coherence_width if isinstance(source, Wavefront) else math.inf
    rays = Rays(fields, wavelength, engine, double, curved, width)
    points, radiator = places.reshape(-1, 3), radiator_of(flat_source)
    if (radiator.distance(points) < _NEAREST * wavelength).any():
        warn_caller(
            f"Wigner rays are a rough approximation nearer than {_NEAREST:g} wavelengths to the "
            "source, where some of the points are; boundary integrals are exact there"
        )
    edges = sum(len(ring) for e in flat_source.elements_in_plane for ring in e.rings)
    if edges > _MANY_EDGES:
        warn_caller(
            f"rays from {edges} edges take seconds; method='auto' gives the exact field, and is "
            "some hundred times as fast"
        )
    share = _FLOOR if double else max(_FLOOR, _SINGLE / allowed)
    floor = share * _largest(flat_source, radiator.distance_of_centre(points), wavelength)
    values, errors = summed_rays(flat_source, rays, points, allowed, floor)
    if not (errors <= allowed * np.maximum(np.abs(values), floor)).all():
        warn_caller(
            "the tolerance asked for is not met at all points; return_error=True tells where, and "
            "method='auto' gives the exact field"
        )
    return values, errors


def _of_partly_coherent(
    compute: Callable[..., Any],
    points: Any,
    method: str,
    through: Any,
    error: float,
    return_error: bool,
    source: Wavefront,
    wavelength: float,
) -> Any:
    """Irradiance of partly coherent light of one wavelength; ``compute`` takes coherent sources."""
    checked_radiator(source, partly=True)
    systems, stops = ([], []) if through is None else systems_and_stops(through)
    if (through is not None or method != "wigner") and not stops:
        places = checked_points(points) if through is None else checked_points_behind(points)

        def fields(one: Any, some: Any) -> Any:
            found = compute(one, wavelength, some)
            return found if return_error else np.asarray(found)[None]

        flat = places.reshape(-1, places.shape[-1])
        if len(flat):
            system = systems[0] if systems else None
            found = partly_coherent_irradiance(
                fields, source, flat, wavelength, method, system, error
            )
            if found is not None:
                values = [part.reshape(places.shape[:-1]) for part in found]
                return tuple(values[:2]) if return_error else values[0]
    return mean_over_mixture(compute, source, wavelength, None, error, return_error)


def _check_shadowed(method: str, through: Any, bandwidth: Any) -> None:
    """Raise ArgumentError for options that fields behind obstacles do not have."""
    if through is not None:
        raise ArgumentError(
            "fields with obstacles have no system of lenses; leave through or obstacles out"
        )
    if method == "wigner" or bandwidth is not None:
        raise ArgumentError(
            "expected light of one wavelength and another method than rays with obstacles, got "
            f'method={method!r} and bandwidth={bandwidth!r}; use method="auto"'
        )


def _is_by_lags(source: Any, obliquity: Any) -> bool:
    """Whether the light is partly coherent, and rays have the W of all of its tilts together.

    With an obliquity that does not depend on the tilt, and where it has a closed form.
    """
    if not is_partly_coherent(source) or obliquity_of(obliquity).needs_normal_derivative:
        return False
    return kernels.partly_coherent_kernel(source) is not None


def _curved(source: Any) -> tuple[float, ...]:
    """Curvatures and centre of a wave, as rays have them; () of a flat one."""
    if not isinstance(source, Wavefront) or source.is_flat:
        return ()
    (xx, xy), (_, yy) = source.curvature.tolist()
    return (xx, xy, yy, *source.centre.tolist())


def _squared(
    source: Aperture | Array | Wavefront | Screen | PointSource,
    points: Any,
    wavelength: float,
    method: Any,
    return_error: bool,
    how: dict[str, Any],
) -> Any:
    """|U|^2 of an amplitude, and its error."""
    if "obstacles" in how and not return_error:  # where an error takes as long as the field
        return np.abs(amplitude(source, points, wavelength, method, **how)) ** 2
    field, error = amplitude(source, points, wavelength, method, return_error=True, **how)
    values, errors = squared_field(field, error)
    return (values, errors) if return_error else values


def checked_tolerance(tolerance: Any) -> float:
    """A number above 0 and below 1; ArgumentError for anything else."""
    value = checked_number(tolerance, "tolerance", "a number above 0 and below 1")
    if not 0.0 < value < 1.0:
        raise ArgumentError(
            f"expected tolerance as a number above 0 and below 1, got {tolerance!r}"
        )
    return value


def _largest(source: Aperture | Array, distance: Values, wavelength: float) -> Values:
    """(T2): the largest irradiance that a source of this power and area can make there, (n,)."""
    area = sum(element.area for element in source.elements_in_plane)
    mean = energy_of(source) / area
    return mean * np.minimum(1.0, (area / (wavelength * distance)) ** 2)
