"""Irradiance |U|^2 at points in front of a source: Wigner rays, and mixtures of waves.

Source: (R1), (T1), (T2).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import lru_cache
from typing import Any, TypedDict, Unpack

import numpy as np
from numpy.typing import ArrayLike, NDArray

from polywigner import execution, kernels
from polywigner.errors import ArgumentError
from polywigner.execution import Engine
from polywigner.geometry import Aperture, Wavefront
from polywigner.geometry.arguments import (
    checked_number,
    checked_wavelength,
    takes_frequency,
    warn_caller,
)
from polywigner.kernels import Kernel, kernel_for
from polywigner.kernels.functions.slices import SliceSum
from polywigner.kernels.kernel import Values
from polywigner.optics import FirstOrder
from polywigner.propagation.amplitudes import Obstacle, field_and_error
from polywigner.propagation.boundary import radiator_of
from polywigner.propagation.collins import (
    checked_points_behind,
    field_behind,
    squared_field,
    systems_and_stops,
)
from polywigner.propagation.far_fields import check_slopes
from polywigner.propagation.partial_coherence import partly_coherent_irradiance
from polywigner.propagation.point_grids import (
    DEFAULT_TOLERANCE,
    METHODS,
    checked_method,
    checked_points,
)
from polywigner.propagation.quadrature import (
    Triangles,
    gauss_rule,
    has_few_kinks,
    node_count,
    quartered,
    smooth_triangles,
    spacings,
    triangulated,
)
from polywigner.propagation.screens import PointSource, Screen
from polywigner.propagation.shadows import LEAST_TOLERANCE
from polywigner.radiometry.directions import (
    PlaneSource,
    checked_bandwidth,
    checked_radiator,
    longest_path,
    wavelengths_of_band,
)
from polywigner.source import Array
from polywigner.source.normal_form import normal_form
from polywigner.source.obliquities import DEFAULT, Forms, ObliquityName, obliquity_of
from polywigner.source.support import mutual_support
from polywigner.transforms.phase_space import energy_of
from polywigner.transforms.traced_sources import check_no_drjit
from polywigner.transforms.wavefronts import (
    coherent_source,
    flat_source,
    is_partly_coherent,
    tilts_of,
)
from polywigner.transforms.xarray_arguments import takes_xarray

Floats = NDArray[np.float64]
LightSource = Aperture | Array | Wavefront | Screen | PointSource
Compute = Callable[[LightSource, float, ArrayLike], Floats]
"""Irradiance of a coherent source at a wavelength in m and points, and its error, (2, ...)."""

# Irradiance below which errors are absolute, relative to the largest possible one (T2).
_FLOOR = 1e-3
_TOLERANCE = 1e-3
# Errors of means over tilts and wavelengths: as a fraction of the tolerance, and relative to the
# largest irradiance for exact fields.
_OF_MIXTURE, _OF_EXACT = 1e-4, 1e-7
# Errors of shadows, as a fraction of the tolerance.
_OF_SHADOWS = 0.1
# Number of edges above which rays take seconds; the exact field takes a hundredth of the time.
_MANY_EDGES = 50
# Distance to the source in wavelengths below which rays are a rough approximation.
_NEAREST = 2.0


class IrradianceOptions(TypedDict, total=False):
    """Keywords of :func:`irradiance`."""

    through: FirstOrder | Sequence[FirstOrder | Aperture | Array] | None
    obstacles: Obstacle | Sequence[Obstacle] | None
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
    obliquity: ObliquityName | None = None,
    bandwidth: float | None = None,
    tolerance: float = _TOLERANCE,
    engine: Engine = "auto",
) -> Floats:
    """Compute the irradiance |U|^2 at points in front of a source.

    Wigner rays are the paper's method, an approximation to leading order: each position on the
    automean sends one ray to each point, with the radiance W in that direction (R1). All other
    methods square the field of :func:`amplitude`. The irradiance is |U|^2, not the flux through
    a tilted receiver.

    Parameters
    ----------
    source : Aperture, Array, Wavefront, Screen or PointSource
        Apertures of an Array lie in the plane z = 0. A :class:`Screen` requires a method of
        :func:`amplitude`; a :class:`PointSource` takes any method.
    points : array_like, shape (..., 3), or (..., 2) with ``through``
        Points in m, z > 0.
    wavelength : float
        Wavelength in m.
    method : str, default "wigner"
        "wigner" (rays), one of the methods of :func:`amplitude`, or "auto": the exact field of
        the boundary condition that ``obliquity`` names. For outlines with many edges the exact
        field is a hundred times faster than rays (300 vertices, 50 points: 0.19 s, not 19.7 s).
    through : FirstOrder or sequence, optional
        First-order systems and stops between source and points, as in :func:`amplitude`. The
        square of Collins' integral is exactly the integral of W over all frequencies.
    obstacles : Polyhedron, placed Aperture or sequence, optional
        Bodies and plates whose shadows diffract, as in :func:`amplitude`. Requires "auto" or a
        method of :func:`amplitude`, and no ``bandwidth``.
    obliquity : str, optional
        Boundary condition that rays are matched to, as in :func:`radiation_pattern`, or "paper",
        a factor cos(theta) of no boundary condition. It applies to each pair of the waves of a
        field. It is also the obliquity of "fraunhofer", except "paper"; the other methods have a
        fixed one.
    bandwidth : float, optional
        Bandwidth in Hz of a flat spectrum about the wavelength's frequency (docs/coherence.md,
        (PC6)); by default the light has one wavelength.
    tolerance : float, default 1e-3
        Error of the sum over rays, relative to the irradiance where that exceeds 1e-3 of the
        largest irradiance that a source of this power and area can produce at that distance (T2),
        else relative to 1e-3 of that. It does not include the error of the ray approximation
        (docs/propagation.md). Other methods are at least as accurate as :func:`amplitude` by
        default; their means over partially coherent light err by at most 1e-4 of the tolerance,
        at most 1e-7, of the largest irradiance.
    engine : {"auto", "numpy", "llvm", "cuda"}
        See :func:`fourier`.

    Returns
    -------
    ndarray of float64, shape (...)
        Irradiance in the unit of the source's |u|^2; by rays it can be slightly negative near
        nulls. An ``xarray.DataArray`` of points gives a DataArray.

    Raises
    ------
    ArgumentError
        For arguments of the wrong type, shape or range, Dr.Jit arrays, and sources too large for
        rays (some hundred wavelengths for oblique points nearby, thousands far away).
    GeometryError
        If elements of an Array do not lie in the plane z = 0.
    EngineError
        If the engine is not available.

    Warns
    -----
    PolywignerWarning
        If rays are not valid (points nearer than two wavelengths), if the tolerance is not met,
        and where :func:`amplitude` warns of fits.

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
        source, points, wavelength, method, through=through, obstacles=obstacles,
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
    """Compute the irradiance of :func:`irradiance` and an estimate of its error.

    Parameters
    ----------
    source, points, wavelength, method, **options
        See :func:`irradiance`.

    Returns
    -------
    irradiance : ndarray of float64, shape (...)
        See :func:`irradiance`.
    error : ndarray of float64, shape (...)
        Estimated error of each value: for rays the difference between the last two rules. It is
        infinite for points so near to the source that their rays pass between the nodes of every
        rule. Behind obstacles the estimate doubles the computing time.

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
    method: str,
    *,
    through: FirstOrder | Sequence[FirstOrder | Aperture | Array] | None = None,
    obstacles: Obstacle | Sequence[Obstacle] | None = None,
    obliquity: ObliquityName | None = None,
    bandwidth: float | None = None,
    tolerance: float = _TOLERANCE,
    engine: Engine = "auto",
    with_error: bool = False,
) -> tuple[Floats, Floats]:
    """Return the irradiance (...) and its error; behind obstacles it requires ``with_error``."""
    checked_method(method, ("wigner", *METHODS, "auto"))
    allowed = checked_tolerance(tolerance)
    check_no_drjit(source=source, points=points, wavelength=wavelength)
    if obstacles is not None and (method == "wigner" or not (through is None is bandwidth)):
        raise ArgumentError(
            "obstacles require one wavelength, no system of lenses, and a method with fields, "
            f'got method={method!r} and bandwidth={bandwidth!r}; use method="auto" alone'
        )

    def compute(part: LightSource, length: float, positions: ArrayLike) -> Floats:
        if through is not None:
            others = {"method": None if method in ("wigner", "auto", "fresnel") else method}
            field = field_behind(
                part, positions, length, through, None if allowed == _TOLERANCE else allowed,
                {**others, "obliquity": obliquity}, engine,
            )  # fmt: skip
            return np.stack(squared_field(*field))
        return np.stack(
            _in_free_space(
                part, positions, length, method, obstacles, obliquity, allowed, engine, with_error
            )
        )

    by_lags = through is None and method == "wigner" and _has_closed_form(source, obliquity)
    has_tilts = is_partly_coherent(source) and not by_lags
    if bandwidth is None and not has_tilts:
        values, errors = compute(source, wavelength, points)
        return values, errors
    error = (_OF_SHADOWS if obstacles is not None else _OF_MIXTURE) * allowed
    if obstacles is None and method != "wigner":
        error = min(error, _OF_EXACT)
    name = obliquity_of(obliquity).name if method == "auto" else method
    total: Any = 0.0
    for part, length, weight in _band(source, wavelength, bandwidth, error):
        mean: Floats | None = None
        if has_tilts and obstacles is None:
            mean = _of_shared_samples(compute, part, points, length, name, through, error)
        if mean is None:
            tilted = _tilted(part, error) if has_tilts else [(part, 1.0)]
            mean = np.asarray(sum(w * compute(s, length, points) for s, w in tilted))
        total = total + weight * mean
    return total[0], total[1]


def _in_free_space(
    source: LightSource,
    points: ArrayLike,
    wavelength: float,
    method: Any,
    obstacles: Obstacle | Sequence[Obstacle] | None,
    obliquity: Any,
    allowed: float,
    engine: Engine,
    with_error: bool,
) -> tuple[Floats, Floats]:
    """Return the irradiance (...) of one wavelength without a system, and its error."""
    if method == "auto":
        condition = obliquity_of(obliquity)
        is_exact = condition.is_boundary_condition
        method, obliquity = (condition.name, None) if is_exact else ("wigner", condition.name)
    if method == "wigner" and isinstance(source, PointSource):
        method = DEFAULT  # rays of a point source carry |exp(ikR)/R|^2 exactly
    if method != "wigner":
        if obstacles is not None:
            tolerance = max(_OF_SHADOWS * allowed, LEAST_TOLERANCE)
        else:
            tolerance = min(allowed, DEFAULT_TOLERANCE)
            if not isinstance(source, (Screen, PointSource)):
                source = checked_radiator(source)
        return squared_field(
            *field_and_error(
                source, points, wavelength, method, obstacles=obstacles, obliquity=obliquity,
                tolerance=tolerance, engine=engine, with_error=with_error,
            )
        )  # fmt: skip
    length = checked_wavelength(wavelength)
    if isinstance(source, Screen):
        raise ArgumentError(
            "Wigner rays are not available behind a Screen; use another method, such as "
            f"method={DEFAULT!r}"
        )
    radiator = checked_radiator(source, partly=_has_closed_form(source, obliquity))
    positions = checked_points(points)
    flat = positions.reshape(-1, 3)
    values, errors = _by_rays(radiator, flat, length, obliquity, allowed, engine)
    shape = positions.shape[:-1]
    return values.reshape(shape)[()], errors.reshape(shape)[()]


def _has_closed_form(source: LightSource, obliquity: ObliquityName | None) -> bool:
    """Whether the light is partially coherent, with a W of all tilts in closed form (PC8).

    The obliquity must not depend on the tilt.
    """
    if not is_partly_coherent(source) or obliquity_of(obliquity).needs_normal_derivative:
        return False
    return isinstance(source, Wavefront) and kernels.partly_coherent_kernel(source) is not None


def checked_tolerance(tolerance: float) -> float:
    """Return a number above 0 and below 1; raise ArgumentError for anything else."""
    value = checked_number(tolerance, "tolerance", "a number above 0 and below 1")
    if not 0.0 < value < 1.0:
        raise ArgumentError(
            f"expected tolerance as a number above 0 and below 1, got {tolerance!r}"
        )
    return value


# ---- mixtures of waves ---------------------------------------------------------------------------


def mixture_parts(
    source: Aperture | Array | Wavefront, wavelength: float, bandwidth: float | None, error: float
) -> Iterator[tuple[Aperture | Array | Wavefront, float, float]]:
    """Yield coherent sources, wavelengths in m and weights, whose mean is the mixture of waves.

    ``error``: error of the mean, relative to the largest possible irradiance.
    """
    for part, length, weight in _band(source, wavelength, bandwidth, error):
        for tilted, fraction in _tilted(part, error):
            yield tilted, length, fraction * weight


def _band(
    source: Any, wavelength: float, bandwidth: float | None, error: float
) -> Iterator[tuple[Any, float, float]]:
    """Yield the source at the wavelengths of a band, these wavelengths in m, and weights."""
    length = checked_wavelength(wavelength)
    band = [(length, 1.0)]
    if bandwidth is not None:
        width = checked_bandwidth(bandwidth, length)
        band = wavelengths_of_band(length, width, longest_path(source), error)
    for node, weight in band:
        yield source.at_wavelength(node), node, weight


def _tilted(source: Any, error: float) -> Iterator[tuple[Any, float]]:
    """Yield the coherent source with each tilt of its partially coherent light, and weights."""
    if not is_partly_coherent(source):
        yield source, 1.0
        return
    for tilt, weight in zip(*tilts_of(source, error), strict=True):
        yield coherent_source(source, tilt), float(weight)


def _of_shared_samples(
    compute: Compute,
    source: Wavefront,
    points: ArrayLike,
    wavelength: float,
    method: str,
    through: FirstOrder | Sequence[FirstOrder | Aperture | Array] | None,
    error: float,
) -> Floats | None:
    """Return the irradiance of partially coherent light and its error, (2, ...).

    None: the mean over tilts is faster.
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

    def fields(part: Any, samples: Floats) -> Floats:
        return compute(part, wavelength, samples)

    result = partly_coherent_irradiance(fields, source, flat, wavelength, method, systems[0], error)
    return None if result is None else result.reshape(2, *positions.shape[:-1])


# ---- Wigner rays ---------------------------------------------------------------------------------

# Additional nodes along a side of a triangle, rule after rule. The first rule has two, which
# integrate W exactly on triangles far smaller than a wavelength, where it is a quadratic.
_LEVELS = (2.0, 3.0, 4.0, 6.0, 8.0, 11.0, 15.0, 20.0, 28.0)
# Number of triangles above which a rule with one node in each is tried first.
_MANY_TRIANGLES = 500
# Largest number of nodes of a rule, 64 MiB.
_MOST_NODES = 1 << 22
# Points whose phase rates agree within this fraction of 1/wavelength share their rules.
_RATE_STEP = 0.25
# Points whose error is smaller than this fraction of the allowed error are not computed again.
_SETTLED = 0.03

NodeSum = Callable[[tuple[Floats, Floats], Floats], Floats]
"""Irradiance (n,) by a rule (nodes, weights) at points (n, 3)."""


def _by_rays(
    source: PlaneSource | Wavefront,
    points: Floats,
    wavelength: float,
    obliquity: ObliquityName | None,
    allowed: float,
    engine: Engine,
) -> tuple[Floats, Floats]:
    """Return the irradiance by Wigner rays and its estimated error, (n,), at points (n, 3)."""
    condition, flat = obliquity_of(obliquity), flat_source(source)
    curved: tuple[float, ...] = ()
    if isinstance(source, Wavefront) and not source.is_flat:
        (xx, xy), (_, yy) = source.curvature.tolist()
        curved = (xx, xy, yy, *source.centre.tolist())
        check_slopes(source, condition.name)
    execution.checked_engine(engine)
    terms = []
    for part, forms in condition.terms(flat, wavelength):
        if is_partly_coherent(source):
            part = Wavefront(part, coherence_width=normal_form(source).coherence_width)
        kernel = _along_rays(kernel_for("wigner", part))
        terms.append((kernel, part, (wavelength, *forms, *curved)))
    radiator = radiator_of(flat)
    clearance = radiator.distance(points)
    if (clearance < _NEAREST * wavelength).any():
        warn_caller(
            "Wigner rays are a rough approximation at points less than "
            f"{_NEAREST:g} wavelengths from the source; use method={DEFAULT!r}, which is exact"
        )
    edges = sum(len(ring) for ring in normal_form(flat).rings)
    if edges > _MANY_EDGES:
        warn_caller(
            f"Wigner rays from {edges} edges take seconds; method='auto' computes the exact field, "
            "about a hundred times faster"
        )

    def node_sum(rule: tuple[Floats, Floats], some: Floats) -> Floats:
        total = np.zeros(len(some))
        for kernel, part, constants in terms:
            total += execution.evaluate_sums(
                kernel, part, *rule, some, constants, double=True, engine=engine
            )
        return total

    area = sum(element.area for element in flat.elements_in_plane)
    reach = wavelength * radiator.distance_of_centre(points)
    largest = energy_of(flat) / area * np.minimum(1.0, (area / reach) ** 2)  # (T2)
    floor = _FLOOR * largest
    values, errors = np.zeros(len(points)), np.zeros(len(points))
    rates = _phase_rates(flat, wavelength, points, curved)
    steps = np.ceil(rates * wavelength / _RATE_STEP)
    triangles = smooth_triangles(flat) if has_few_kinks(flat) else _coarse_triangles(flat)
    for step in np.unique(steps):
        rate, group = float(step) * _RATE_STEP / wavelength, np.flatnonzero(steps == step)
        _check_nodes(triangles, rate, wavelength)
        values[group], errors[group] = _refined_sums(
            node_sum, triangles, rate, points[group], clearance[group], allowed, floor[group]
        )
    if not (errors <= allowed * np.maximum(np.abs(values), floor)).all():
        warn_caller(
            "the tolerance is not met at all points; irradiance_with_error returns the errors, and "
            "method='auto' the exact field"
        )
    return values, errors


@lru_cache(maxsize=64)
def _along_rays(base: Kernel) -> Kernel:
    """Return the integrand of (R1) for a kernel of W.

    Arguments: ``x, y`` on the source, X, Y and Z of the point, the wavelength, the coefficients of
    the forms of obliquity (D2), and for a curved wave Q_xx, Q_xy, Q_yy and its centre, whose
    frequency depends on the position.
    """

    def enter(ops: Any, frame: Any, x: Any, y: Any, *rest: Any) -> Values:
        point, wavelength, forms, curved = rest[:3], rest[3], Forms(*rest[4:7]), rest[7:]
        along_x, along_y = point[0] - x, point[1] - y
        square = along_x * along_x + along_y * along_y + point[2] * point[2]
        inverse = 1.0 / ops.sqrt(square)
        scale = inverse / wavelength
        nu: Values = (along_x * scale, along_y * scale)
        if curved:
            (xx, xy, yy), (dx, dy) = curved[:3], (x - curved[3], y - curved[4])
            nu = nu[0] - (xx * dx + xy * dy), nu[1] - (xy * dx + yy * dy)
        factor = forms.irradiance(point[2] * inverse) * scale * scale
        return (factor, *base.enter(ops, frame, x, y, *nu))

    base_sum = base.edge_sum

    def edge_sum(ops: Any, tables: Any, _: Any, *inner: Any) -> Values:
        return base_sum(ops, tables, *inner)

    def leave(ops: Any, frame: Any, inner: Values, sums: Values) -> Values:
        return (inner[0] * base.leave(ops, frame, inner[1:], sums)[0],)

    return replace(
        base,
        name=f"{base.name} along rays",
        enter=enter,
        edge_sum=base_sum.after(1) if isinstance(base_sum, SliceSum) else edge_sum,
        leave=leave,
    )


def _coarse_triangles(source: PlaneSource) -> Triangles:
    """Return triangles of the automean for sources with too many kinks of W.

    Kinks cross these triangles. The gradient of W is continuous across most kinks, so the errors of
    Gauss rules fall as the fourth power of the size of a triangle.
    """
    return quartered(triangulated(list(mutual_support(source).polygons.geoms)))


def _refined_sums(
    node_sum: NodeSum,
    triangles: Triangles,
    rate: float,
    points: Floats,
    clearance: Floats,
    tolerance: float,
    floor: Floats,
) -> tuple[Floats, Floats]:
    """Return irradiance and error estimates (n,), from rules refined until all points are settled.

    The allowed error is ``tolerance`` times the irradiance or ``floor`` (n,), if that is larger.
    ``clearance`` (n,): distances from the source. The integrand has singularities at complex
    positions as far from the real ones. At a distance d, nodes h apart err by a fraction of
    exp(-2 pi d/h). If that exceeds 1/e, two rules may agree although neither is right.
    """
    values, errors = np.zeros(len(points)), np.full(len(points), np.inf)
    remaining = np.arange(len(points))
    previous: Floats | None = None
    for extra in (1.0, *_LEVELS) if len(triangles) > _MANY_TRIANGLES else _LEVELS:
        if previous is not None and node_count(triangles, rate, extra) > _MOST_NODES:
            break
        sums = node_sum(gauss_rule(triangles, rate, extra), points[remaining])
        values[remaining] = sums
        if previous is None:
            previous = sums
            continue
        change = np.abs(sums - previous)
        change[clearance[remaining] < spacings(triangles, rate, extra).max() / (2 * np.pi)] = np.inf
        errors[remaining] = change
        allowed = tolerance * np.maximum(np.abs(sums), floor[remaining])
        if (change <= allowed).all():
            break
        unsettled = change > _SETTLED * allowed
        remaining, previous = remaining[unsettled], sums[unsettled]
    return values, errors


def _check_nodes(triangles: Triangles, rate: float, wavelength: float) -> None:
    count = node_count(triangles, rate, _LEVELS[0])
    if not count <= _MOST_NODES:
        across = float(np.ptp(triangles.reshape(-1, 2), axis=0).max()) / wavelength
        raise ArgumentError(
            f"source of {across:.3g} wavelengths is too large for Wigner rays to these points, "
            f"which need {count:.2g} nodes; use method={DEFAULT!r}, which is exact, and check the "
            "unit of the wavelength"
        )


def _phase_rates(
    source: PlaneSource, wavelength: float, points: Floats, curved: Sequence[float]
) -> Floats:
    """Return the largest |nu - kappa| over rays to each point and waves kappa, in 1/m."""
    xmin, ymin, xmax, ymax = source.bounds
    corners = np.array([(x, y) for x in (xmin, xmax) for y in (ymin, ymax)])
    rays = points[:, None, :2] - corners
    length = np.sqrt((rays**2).sum(axis=-1) + points[:, None, 2] ** 2)
    nu = rays / (wavelength * length[..., None])
    bent = 0.0
    if curved:
        q = np.array([curved[:2], curved[1:3]])
        nu = nu - (corners - np.array(curved[3:])) @ q
        bent = float(np.linalg.norm(q, 2) * np.hypot(xmax - xmin, ymax - ymin))
    rates = np.zeros(len(points))
    for kappa in normal_form(source).frequencies:
        rates = np.maximum(rates, np.linalg.norm(nu - kappa, axis=-1).max(axis=1))
    return rates + bent
