"""Irradiance |U|^2 at points, also for bands of wavelengths and for partially coherent light."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any, TypedDict, Unpack

import numpy as np
from numpy.typing import ArrayLike

from polywigner import kernels
from polywigner.errors import ArgumentError
from polywigner.execution import Engine
from polywigner.geometry import Aperture, Wavefront
from polywigner.geometry.arguments import (
    checked_choice,
    checked_number,
    checked_wavelength,
    takes_frequency,
)
from polywigner.numerics import Floats
from polywigner.optics import FirstOrder
from polywigner.propagation.amplitudes import Obstacle, field_and_error
from polywigner.propagation.collins import (
    checked_points_behind,
    field_behind,
    squared_field,
    systems_and_stops,
)
from polywigner.propagation.conducting_sheets import Edge, check_edge
from polywigner.propagation.partial_coherence import partly_coherent_irradiance
from polywigner.propagation.point_grids import (
    DEFAULT_TOLERANCE,
    METHODS,
    checked_points,
)
from polywigner.propagation.screens import PointSource, Screen
from polywigner.propagation.shadows import LEAST_TOLERANCE
from polywigner.propagation.wigner_rays import irradiance_by_rays
from polywigner.radiometry.directions import (
    checked_bandwidth,
    checked_radiator,
    longest_path,
    wavelengths_of_band,
)
from polywigner.source import Array
from polywigner.source.obliquities import DEFAULT, ObliquityName, obliquity_of
from polywigner.transforms.traced_sources import check_no_drjit
from polywigner.transforms.wavefronts import coherent_source, is_partly_coherent, tilts_of
from polywigner.transforms.xarray_arguments import takes_xarray

LightSource = Aperture | Array | Wavefront | Screen | PointSource
Compute = Callable[[LightSource, float, ArrayLike], Floats]
"""Function of source, wavelength in m and points that returns irradiances and errors (2, ...)."""

_TOLERANCE = 1e-3
# Allowed error of a mean over tilts and wavelengths, as a fraction of the tolerance.
_OF_MIXTURE = 1e-4
# Upper limit of the error of a mean over tilts and wavelengths for exact fields, relative to the
# largest irradiance.
_OF_EXACT = 1e-7
# Allowed error of fields behind obstacles, as a fraction of the tolerance.
_OF_SHADOWS = 0.1


class IrradianceOptions(TypedDict, total=False):
    """Keyword arguments of :func:`irradiance`."""

    through: FirstOrder | Sequence[FirstOrder | Aperture | Array] | None
    obstacles: Obstacle | Sequence[Obstacle] | None
    edge: Edge
    obliquity: ObliquityName | None
    bandwidth: float | None
    tolerance: float
    engine: Engine


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
    edge: Edge = "black",
    obliquity: ObliquityName | None = None,
    bandwidth: float | None = None,
    tolerance: float = _TOLERANCE,
    engine: Engine = "auto",
) -> Floats:
    """Return the irradiance |U|^2 at points in front of a source.

    Wigner rays, the method of the paper, are an approximation to leading order. Each midpoint of
    two source points sends one ray to each point, with the Wigner function as radiance (R1). All
    other methods square the field of :func:`amplitude`. The irradiance does not include the cosine
    of the angle between the ray and the normal of a receiver.

    Parameters
    ----------
    source : Aperture, Array, Wavefront, Screen or PointSource
        Source, whose apertures lie in the plane z = 0. A :class:`Screen` requires a method of
        :func:`amplitude`; a :class:`PointSource` allows any method.
    points : array_like, shape (..., 3), or (..., 2) with ``through``
        Points in m, z > 0.
    wavelength : float
        Wavelength in m.
    method : str, default "wigner"
        "wigner" for rays, one of the methods of :func:`amplitude`, or "auto" for the exact field
        with the boundary condition ``obliquity``. For outlines with many edges the exact field is a
        hundred times faster than rays (300 vertices, 50 points: 0.19 s instead of 19.7 s).
    through : FirstOrder or sequence, optional
        First-order systems and stops between source and points, as in :func:`amplitude`. The
        squared modulus of Collins' integral equals the integral of the Wigner function over all
        frequencies exactly.
    obstacles : Polyhedron, placed Aperture or sequence, optional
        Bodies and plates, as in :func:`amplitude`, whose shadows include diffraction. Obstacles
        require "auto" or a method of :func:`amplitude`, and cannot be combined with a
        ``bandwidth``.
    edge : {"black", "soft", "hard"}, default "black"
        Boundary condition on the obstacles, as in :func:`amplitude`.
    obliquity : str, optional
        Boundary condition that determines the obliquity factor of rays, as in
        :func:`radiation_pattern`, or "paper" for a factor cos(theta), which corresponds to no
        boundary condition. The factor applies to each pair of plane waves of the source's field.
        "fraunhofer" allows all values but "paper". The other methods have a fixed obliquity.
    bandwidth : float, optional
        Bandwidth in Hz of a flat spectrum about the frequency of the wavelength
        (docs/coherence.md, (PC6)). By default the light has one wavelength.
    tolerance : float, default 1e-3
        Allowed relative error of the sum over rays. For irradiances below 1e-3 of the largest value
        that a source of this power and area can produce at the same distance (T2), the error is
        relative to 1e-3 of the largest value. The error of the ray approximation itself
        (docs/propagation.md) is not included. Other methods are at least as accurate as
        :func:`amplitude` by default. For partially coherent light their errors are at most 1e-4 of
        the tolerance, and at most 1e-7, relative to the largest irradiance.
    engine : {"auto", "numpy", "llvm", "cuda"}
        See :func:`fourier`.

    Returns
    -------
    ndarray of float64, shape (...)
        Irradiance in the unit of |u|^2 on the source. Near nulls, rays can give slightly negative
        values. If ``points`` is an ``xarray.DataArray``, the result is a DataArray.

    Raises
    ------
    ArgumentError
        If an argument has the wrong type, shape or range, or is a Dr.Jit array, or if the source is
        too large for rays. The largest width is some hundred wavelengths for oblique points nearby,
        and some thousand wavelengths for distant points.
    GeometryError
        If elements of an Array do not lie in the plane z = 0.
    EngineError
        If the engine is not available.

    Warns
    -----
    PolywignerWarning
        If points are less than two wavelengths from the source, where rays are not valid; if the
        tolerance is not met; and in the cases in which :func:`amplitude` warns.

    See Also
    --------
    irradiance_with_error : The irradiance and an estimate of its error.

    Examples
    --------
    >>> import polywigner as pw
    >>> round(float(pw.irradiance(pw.shapes.square(10e-3), (0.0, 0.0, 0.1), 3.2e-3, "auto")), 4)
    0.0963
    """
    return _irradiance_and_error(
        source, points, wavelength, method, through=through, obstacles=obstacles, edge=edge,
        obliquity=obliquity, bandwidth=bandwidth, tolerance=tolerance, engine=engine,
    )[0]  # fmt: skip


@takes_frequency
@takes_xarray("points", units="W m-2", long_name="irradiance |U|^2", with_error=True)
def irradiance_with_error(
    source: Aperture | Array | Wavefront | Screen | PointSource,
    points: ArrayLike,
    wavelength: float,
    method: str = "wigner",
    **options: Unpack[IrradianceOptions],
) -> tuple[Floats, Floats]:
    """Return the irradiance of :func:`irradiance`, and an estimate of its error.

    Parameters
    ----------
    source, points, wavelength, method, **options
        See :func:`irradiance`.

    Returns
    -------
    irradiance : ndarray of float64, shape (...)
        See :func:`irradiance`.
    error : ndarray of float64, shape (...)
        Estimated error of each value, in the unit of the irradiance. For rays it is the difference
        between the last two quadrature rules. The error is infinite for points so close to the
        source that no rule resolves their rays. Behind obstacles, the estimate doubles the
        computing time.

    Raises
    ------
    PolywignerError
        See :func:`irradiance`.

    Examples
    --------
    >>> import polywigner as pw
    >>> values, errors = pw.irradiance_with_error(pw.shapes.square(10e-3), (0, 0, 0.1), 3.2e-3)
    >>> bool(errors < 1e-3 * values)
    True
    """
    return _irradiance_and_error(source, points, wavelength, method, with_error=True, **options)


def _irradiance_and_error(
    source: LightSource,
    points: ArrayLike,
    wavelength: float,
    method: Any,
    *,
    through: FirstOrder | Sequence[FirstOrder | Aperture | Array] | None = None,
    obstacles: Obstacle | Sequence[Obstacle] | None = None,
    edge: Edge = "black",
    obliquity: Any = None,
    bandwidth: float | None = None,
    tolerance: float = _TOLERANCE,
    engine: Engine = "auto",
    with_error: bool = False,
) -> tuple[Floats, Floats]:
    """Return the irradiance at points, and its error, with the options of :func:`irradiance`.

    See `field_and_error` for ``with_error``.
    """
    checked_choice(method, "method", ("wigner", *METHODS, "auto"))
    meaning = "a number above 0 and below 1"
    allowed = checked_number(tolerance, "tolerance", meaning, lambda x: 0.0 < x < 1.0)
    check_no_drjit(source=source, points=points, wavelength=wavelength)
    others = {
        "method": None if method in ("wigner", "auto", "fresnel") else method,
        "obliquity": obliquity,
    }
    if method == "auto":
        condition = obliquity_of(obliquity)
        is_exact = condition.is_boundary_condition
        method, obliquity = (condition.name, None) if is_exact else ("wigner", condition.name)
    if obstacles is not None and (method == "wigner" or not (through is None is bandwidth)):
        raise ArgumentError(
            'obstacles cannot be combined with method="wigner", through= or a bandwidth, got '
            f'method={method!r} and bandwidth={bandwidth!r}; pass method="auto", and omit '
            "through= and bandwidth="
        )
    check_edge(edge, obstacles)
    if method == "wigner" and isinstance(source, PointSource):
        method = DEFAULT  # The rays of a point source are exact.
    field_tolerance = min(allowed, DEFAULT_TOLERANCE)
    if obstacles is not None:
        field_tolerance = max(_OF_SHADOWS * allowed, LEAST_TOLERANCE)

    def compute(part: LightSource, length: float, positions: ArrayLike) -> Floats:
        """Return irradiance and error (2, ...) of one source at one wavelength."""
        if through is not None:
            behind = None if allowed == _TOLERANCE else allowed
            field = field_behind(part, positions, length, through, behind, others, engine)
            return np.stack(squared_field(*field))
        if method == "wigner":
            return _by_rays(part, positions, length, obliquity, allowed, engine)
        field = field_and_error(
            part, positions, length, method, obstacles=obstacles, edge=edge, obliquity=obliquity,
            tolerance=field_tolerance, engine=engine, with_error=with_error,
        )  # fmt: skip
        return np.stack(squared_field(*field))

    by_lags = through is None and method == "wigner" and _has_closed_form(source, obliquity)
    has_tilts = is_partly_coherent(source) and not by_lags
    if bandwidth is None and not has_tilts:
        values, errors = compute(source, wavelength, points)
        return values, errors
    error = (_OF_SHADOWS if obstacles is not None else _OF_MIXTURE) * allowed
    if obstacles is None and method != "wigner":
        error = min(error, _OF_EXACT)
    total: Any = 0.0
    for part, length, weight in _band(source, wavelength, bandwidth, error):
        mean: Floats | None = None
        if has_tilts and obstacles is None:
            mean = _tilt_mean(compute, part, points, length, method, through, error)
        if mean is None:
            tilted = _tilted(part, error) if has_tilts else [(part, 1.0)]
            mean = np.asarray(sum(w * compute(s, length, points) for s, w in tilted))
        total = total + weight * mean
    return total[0], total[1]


def _by_rays(
    source: LightSource,
    points: ArrayLike,
    wavelength: float,
    obliquity: ObliquityName | None,
    tolerance: float,
    engine: Engine,
) -> Floats:
    """Return the irradiance by Wigner rays at points (..., 3), and its error, shape (2, ...)."""
    length = checked_wavelength(wavelength)
    if isinstance(source, Screen):
        raise ArgumentError(
            "Wigner rays are not available behind a Screen; use another method, such as "
            f"method={DEFAULT!r}"
        )
    radiator = checked_radiator(source, partly=_has_closed_form(source, obliquity))
    positions = checked_points(points)
    rays = irradiance_by_rays(
        radiator, positions.reshape(-1, 3), length, obliquity, tolerance, engine
    )
    return np.reshape(rays, (2, *positions.shape[:-1]))


def _has_closed_form(source: LightSource, obliquity: ObliquityName | None) -> bool:
    """Return whether (PC8) replaces the sum over tilts of partially coherent light."""
    if not is_partly_coherent(source) or obliquity_of(obliquity).needs_normal_derivative:
        return False
    return isinstance(source, Wavefront) and kernels.partly_coherent_kernel(source) is not None


def mixture_parts(
    source: Aperture | Array | Wavefront, wavelength: float, bandwidth: float | None, error: float
) -> Iterator[tuple[Aperture | Array | Wavefront, float, float]]:
    """Yield coherent sources, wavelengths in m and weights that represent partially coherent light.

    ``error`` is relative to the largest possible irradiance.
    """
    for part, length, weight in _band(source, wavelength, bandwidth, error):
        for tilted, fraction in _tilted(part, error):
            yield tilted, length, fraction * weight


def _band(
    source: Any, wavelength: float, bandwidth: float | None, error: float
) -> Iterator[tuple[Any, float, float]]:
    """Yield the source with its field at each wavelength of a band, the wavelength and a weight."""
    length = checked_wavelength(wavelength)
    band = [(length, 1.0)]
    if bandwidth is not None:
        width = checked_bandwidth(bandwidth, length)
        band = wavelengths_of_band(length, width, longest_path(source), error)
    for node, weight in band:
        yield source.at_wavelength(node), node, weight


def _tilted(source: Any, error: float) -> Iterator[tuple[Any, float]]:
    """Yield tilted coherent copies of a partially coherent source, and their weights."""
    if not is_partly_coherent(source):
        yield source, 1.0
        return
    for tilt, weight in zip(*tilts_of(source, error), strict=True):
        yield coherent_source(source, tilt), float(weight)


def _tilt_mean(
    compute: Compute,
    source: Wavefront,
    points: ArrayLike,
    wavelength: float,
    method: str,
    through: FirstOrder | Sequence[FirstOrder | Aperture | Array] | None,
    error: float,
) -> Floats | None:
    """Return irradiance and error (2, ...), averaged over all tilts with common samples.

    The result is None if the fields of the tilts must be computed separately.
    """
    checked_radiator(source, partly=True)
    systems: Sequence[FirstOrder | None] = [None]
    stops: Sequence[object] = []
    if through is not None:
        systems, stops = systems_and_stops(through)
    if stops or (through is None and method == "wigner"):
        return None
    positions = checked_points(points) if through is None else checked_points_behind(points)
    flat = positions.reshape(-1, positions.shape[-1])
    if not len(flat):
        return None

    values = partly_coherent_irradiance(
        lambda part, samples: compute(part, wavelength, samples),
        source, flat, wavelength, method, systems[0], error,
    )  # fmt: skip
    return None if values is None else values.reshape(2, *positions.shape[:-1])
