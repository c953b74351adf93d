"""The complex field of a source at points: exact, Fresnel and Fraunhofer."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from functools import lru_cache, partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from polywigner import execution
from polywigner.errors import ArgumentError
from polywigner.execution import Engine, Precision
from polywigner.execution.progress import told
from polywigner.geometry import Aperture, Polyhedron, Wavefront
from polywigner.geometry.aperture import PlacedAperture, triangulate
from polywigner.geometry.arguments import Points, checked_flag, checked_wavelength, takes_frequency
from polywigner.geometry.silhouettes import obstacles_of
from polywigner.illumination import Array
from polywigner.illumination.obliquities import (
    CONDITIONS,
    DEFAULT,
    BoundaryCondition,
    direction_cosines,
    warn_of_slopes,
)
from polywigner.illumination.support import moved_source
from polywigner.kernels.boundary.integrals import distance_of, point_in_wavelengths
from polywigner.numerics.phases import reduced
from polywigner.optics import FirstOrder
from polywigner.propagation import shadows
from polywigner.propagation.arrangement import quartered
from polywigner.propagation.boundary import boundary_field, radiator_of
from polywigner.propagation.collins import field_behind
from polywigner.propagation.far_fields import check_slopes, far_field
from polywigner.propagation.field_slopes import has_derivatives, traced_field
from polywigner.propagation.places import (
    METHODS,
    Method,
    check_reach,
    checked_amplitude_tolerance,
    checked_method,
    checked_points,
    warn_of_missed,
)
from polywigner.propagation.screens import (
    PointSource,
    Screen,
    field_of_screen,
    incident_of_point,
)
from polywigner.transforms import Differentiable
from polywigner.transforms.wavefronts import (
    checked_wavefront,
    chirp_transform,
    flat_of,
    principal_axes,
)
from polywigner.transforms.xarray_arguments import takes_xarray

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]

# So many Gauss nodes along each side of a cell have 13 digits of waves of four turns there, and of
# the static field of places half as far away as the cell is long.
_NODES, _TURNS = 20, 4.0
# Rounding of a sum, relative to the sum of the moduli.
_ROUNDING = 1e-13
# Pairs of a point and a cell: so many nodes at a time, points at a time, and the most in all.
_READY, _POINTS, _MOST_PAIRS = 1 << 9, 1 << 9, 1 << 22


def curved_field(
    wave: Wavefront, points: Floats, wavelength: float, method: str
) -> tuple[Complex, Floats]:
    """The field at points (n, 3), and a bound on the rounding of it."""
    if method == "fresnel":
        return _fresnel(wave, points, wavelength)
    return summed_over_cells(wave, points, wavelength, partial(_terms, wave, method=method))


def _fresnel(wave: Wavefront, points: Floats, wavelength: float) -> tuple[Complex, Floats]:
    """(Q6): the transform with a further parabola in its phase, the way to each point."""
    q, axes = principal_axes(wave.curvature)
    scale = 1.0 / (wavelength * points[:, 2])
    place, centre = points[:, :2], wave.centre
    nu = (place - centre) * scale[:, None]
    found = chirp_transform(wave.source, q + scale[:, None], axes, centre, nu)
    turns = points[:, 2] / wavelength
    turns = turns - np.round(turns) + scale / 2 * ((place**2).sum(axis=1) - centre @ centre)
    values = found * (scale / 1j) * np.exp(2j * math.pi * (turns - np.round(turns)))
    return values, _ROUNDING * scale * radiator_of(wave.source).content


class _Part(NamedTuple):
    """A copy of an element: its triangles where it is, its place, and its waves."""

    triangles: Floats
    shift: Floats
    amplitudes: Complex
    frequencies: Floats


def summed_over_cells(
    wave: Wavefront,
    points: Floats,
    wavelength: float,
    terms: Callable[[_Part, Floats, Floats, float], Complex],
    components: tuple[int, ...] = (),
) -> tuple[Complex, Floats]:
    """Sums over a source at points (n, 3), (n, *components), and bounds on their rounding (n,).

    ``terms(part, cells, points, wavelength)``: (k, nodes, *components) of cells (k, 3, 2) and
    points (k, 3). Cells are so small that one rule does for all.
    """
    values, sizes = np.zeros((len(points), *components), np.complex128), np.zeros(len(points))
    with told("points", range(0, len(points), _POINTS)) as starts:
        for start in starts:
            some = points[start : start + _POINTS]
            for part in _parts(wave):
                for owners, cells in _cells(wave, part, some, wavelength):
                    found = terms(part, cells, some[owners], wavelength)
                    np.add.at(values, owners + start, found.sum(axis=1))
                    np.add.at(
                        sizes, owners + start, np.abs(found).reshape(len(cells), -1).sum(axis=1)
                    )
    return values, _ROUNDING * sizes


def _parts(wave: Wavefront) -> Iterator[_Part]:
    for element in radiator_of(wave.source).elements:
        corners, numbers = triangulate(element.outline)
        for shift, weight in zip(element.shifts, element.weights.tolist(), strict=True):
            amplitudes = weight * element.amplitudes
            yield _Part(corners[numbers] + shift, shift, amplitudes, element.frequencies)


def _cells(
    wave: Wavefront, part: _Part, points: Floats, wavelength: float
) -> Iterator[tuple[NDArray[np.intp], Floats]]:
    """Numbers of points (k,) and triangles (k, 3, 2), in blocks: each point has all of the part."""
    count = len(part.triangles)
    owners = np.repeat(np.arange(len(points)), count)
    cells = np.tile(part.triangles, (len(points), 1, 1))
    while len(owners):
        small = _are_small(wave, part, cells, points[owners], wavelength)
        ready, done = owners[small], cells[small]
        for start in range(0, len(ready), _READY):
            yield ready[start : start + _READY], done[start : start + _READY]
        owners, cells = np.repeat(owners[~small], 4), quartered(cells[~small])
        if len(owners) > _MOST_PAIRS:
            raise ArgumentError(
                "expected points farther from a source with a curved wave, or a smaller source: "
                "its exact field is a sum over places; use method='fresnel' for large ones"
            )


def _are_small(
    wave: Wavefront, part: _Part, cells: Floats, points: Floats, wavelength: float
) -> NDArray[np.bool_]:
    """Whether phases turn four times at most across a cell, at most twice as long as far."""
    sides = cells - np.roll(cells, 1, axis=1)
    size = np.linalg.norm(sides, axis=2).max(axis=1)
    away = cells - points[:, None, :2]
    height = points[:, 2]
    reach = np.sqrt((away**2).sum(axis=2) + height[:, None] ** 2)
    centre = away.mean(axis=1)
    distance = np.sqrt((centre**2).sum(axis=1) + height**2)
    near = np.maximum(height, distance - size)
    slopes = away / (wavelength * reach[..., None]) + (cells - wave.centre) @ wave.curvature
    highest = np.zeros(len(cells))
    for kappa in part.frequencies:
        own = np.linalg.norm(slopes + kappa, axis=2).max(axis=1)
        highest = np.maximum(highest, own)
    rate = highest + np.minimum(size / near, 1.0) / wavelength
    return np.asarray((rate * size <= _TURNS) & (size <= 2 * near))


def lit_nodes(
    wave: Wavefront, part: _Part, cells: Floats, wavelength: float, with_slopes: bool = False
) -> tuple[Floats, Complex, Complex]:
    """Nodes (k, n, 2) of cells, with the field (k, n) and its normal slope over ik, times weights.

    The slope is zero unless ``with_slopes``.
    """
    shares, weights = _rule()
    nodes = np.einsum("nc,kcd->knd", shares, cells)
    first, second = cells[:, 1] - cells[:, 0], cells[:, 2] - cells[:, 0]
    area = np.abs(first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0])
    inner = nodes - wave.centre
    slope = inner @ wave.curvature
    turns = ((inner * slope).sum(axis=2)) / 2
    shifted = nodes - part.shift
    field, slopes = np.zeros(turns.shape, np.complex128), np.zeros(turns.shape, np.complex128)
    for amplitude, kappa in zip(part.amplitudes.tolist(), part.frequencies, strict=True):
        here = amplitude * np.exp(2j * math.pi * (turns + shifted @ kappa))
        field += here
        if with_slopes:
            slopes += here * direction_cosines(slope + kappa, wavelength)
    share = area[:, None] * weights
    field *= share
    slopes *= share
    return np.asarray(nodes), field, slopes


def _terms(
    wave: Wavefront, part: _Part, cells: Floats, points: Floats, wavelength: float, method: str
) -> Complex:
    """Values times weights (k, nodes) of the integrand of (Q7)."""
    condition = CONDITIONS[method]
    nodes, field, slopes = lit_nodes(wave, part, cells, wavelength, condition.takes_slopes)
    height = points[:, 2, None]
    reach = np.sqrt(((nodes - points[:, None, :2]) ** 2).sum(axis=2) + height**2)
    k = 2 * math.pi / wavelength
    value = condition.slope * slopes
    value += condition.field * field * (height / reach) * (1 + 1j / (k * reach))
    way = np.exp(2j * math.pi * (reach / wavelength)) / (1j * wavelength * reach)
    return np.asarray(value * way)


@lru_cache(maxsize=1)
def _rule() -> tuple[Floats, Floats]:
    """Shares of the corners (n, 3), and weights (n,) of twice a triangle's area."""
    x, w = np.polynomial.legendre.leggauss(_NODES)
    x, w = (x + 1) / 2, w / 2
    u, v = (a.ravel() for a in np.meshgrid(x, x, indexing="ij"))
    weights = np.outer(w * x, w).ravel()
    return np.stack([1 - u, u * (1 - v), u * v], axis=1), weights


Obstacle = Polyhedron | PlacedAperture

_OPS = execution.NumpyOperations(double=True)

# Error of the Fourier transform, relative to the content.
_FOURIER_ERROR = {True: 1e-13, False: 2e-6}


@takes_frequency
@takes_xarray("points", units="W0.5 m-1", long_name="complex amplitude U")
def amplitude(
    source: Aperture | Array | Wavefront | Differentiable | Screen | PointSource,
    points: Points,
    wavelength: float,
    method: Method = DEFAULT,
    *,
    through: FirstOrder | Sequence[FirstOrder | Aperture | Array] | None = None,
    obstacles: Obstacle | Sequence[Obstacle] | None = None,
    tolerance: float | None = None,
    obliquity: BoundaryCondition | None = None,
    return_error: bool = False,
    precision: Precision = None,
    engine: Engine = "auto",
) -> Any:
    """Field U(x, y, z) of a source of the plane z = 0, with its phase, where a wave is exp(+ikR)/R.

    The Rayleigh-Sommerfeld and Kirchhoff integrals are reduced to integrals along the edges
    (docs/theory.md, (B1) to (B5)), without approximation, evanescent waves included. They are as
    good at z = 1e-6 wavelengths as far away, and smooth across the boundary of the geometric
    shadow. So is Fresnel's (B6). Fraunhofer's (B7) is a closed form.

    Parameters
    ----------
    source : an Aperture, or an Array of apertures in the plane z = 0, with any illuminations; or a
        :func:`differentiable` one; one with a curved wave, whose exact field is a sum over places
        in the opening (docs/curved.md, (Q7)); or a :class:`Screen` that something lights from
        behind; or a :class:`PointSource`, with obstacles.
    points : (..., 3) in m, z > 0, or (..., 2) with ``through``; or a Dr.Jit array.
        Derivatives in them, and in the numbers of a differentiable source, are as accurate as the
        field (docs/gradients.md, (G5) to (G7)); "fraunhofer" has none.
    wavelength : in m.
    method : "rayleigh-sommerfeld-1" (the field in the opening is given), "rayleigh-sommerfeld-2"
        (its normal derivative is), "kirchhoff" (their mean), "fresnel" (parabolic waves, for
        points near the axis), "fraunhofer" (the far field, about the source's centre).
    through : a :class:`FirstOrder` from the source's plane to that of ``points``. There the field
        is Collins' integral (O4), instead of a ``method``, without exp(ikL) of the path L along the
        axis. An image (B = 0) is u itself. No derivatives. Or a sequence, in the light's order, of
        these and of stops: Apertures and Arrays, whose field is their transmission (O8).
    obstacles : bodies in the way, as :class:`Polyhedron`, and plates, as apertures in a pose
        (:meth:`Aperture.placed`), alone or in a sequence. They are opaque and black. Light passes
        one edge of theirs (docs/shadows.md, (SB1)): the field is smooth across the boundaries of
        shadows, and zero in bodies. Not with ``through``, "fresnel" and "fraunhofer".
        Derivatives are in points alone, with the silhouettes held (SB4).
    tolerance : error allowed, as a fraction of the incident amplitude or, where that is less, of
        |u| area/(wavelength distance), which is what the field would be if all of the source were
        in phase (within a wavelength with the static field, |u| area/(2 pi distance^2)). Default
        1e-9 (single precision: 1e-5); at least 1e-13 (1e-6). With obstacles 1e-6, at least 1e-8,
        of the largest field, from three wavelengths off the source. Not for Fraunhofer.
    obliquity : of "fraunhofer" alone: that of the far field of "rayleigh-sommerfeld-1" (default),
        "kirchhoff" or "rayleigh-sommerfeld-2".
    return_error : also return the estimated error of each value, |.|: of the sum over nodes, not
        of Fresnel's or Fraunhofer's approximation.
    precision : "double" or None; "single": points and phases are still taken in double.
    engine : "auto", "numpy", "llvm" or "cuda".

    Returns
    -------
    (...) complex, in the unit of the source's field; with ``return_error`` a pair of that and (...)
    of floats. complex64 for single precision.
    An ``xarray.DataArray`` gives one.

    Warns
    -----
    PolywignerWarning if the estimate for some point exceeds the tolerance; and for "kirchhoff" and
    "rayleigh-sommerfeld-2" of a :func:`fit_illumination` with evanescent waves, whose slopes the
    fit does not know.

    Raises
    ------
    ArgumentError for arguments of the wrong type, shape or range, points behind the source, and
    Fresnel fields of points so close that their number of nodes explodes, edges of more than 2e8
    wavelengths, and lengths beyond 1e-75 to 1e75 m; GeometryError for arrays in other planes;
    EngineError without the engine.

    >>> import polywigner as pw
    >>> round(float(abs(pw.amplitude(pw.shapes.square(10e-3), (0.0, 0.0, 0.1), 3.2e-3))), 4)
    0.3103
    """
    checked_flag(return_error, "return_error")
    if obstacles is not None:
        _check_shadowed(source, method, through, obliquity)
    is_traced = has_derivatives(source, points, wavelength)
    how: dict[str, Any] = {"precision": precision, "engine": engine}
    if obstacles is not None and not is_traced and not execution.is_drjit(points):
        return _behind_obstacles(
            source, points, wavelength, method, obstacles, tolerance, return_error, how
        )
    if isinstance(source, PointSource) and obstacles is None:
        raise ArgumentError("expected a PointSource with obstacles, or on a Screen, got it alone")
    if through is not None:
        others: dict[str, object] = {"obliquity": obliquity}
        others["method"] = None if method in (DEFAULT, "fresnel") else method
        return field_behind(
            source, points, wavelength, through, tolerance, others, return_error=return_error, **how
        )
    if is_traced:
        if return_error or obliquity is not None:
            raise ArgumentError(
                "expected no return_error and no obliquity with derivatives; pass "
                "drjit.detach(...) of what needs none"
            )
        return traced_field(
            amplitude, source, points, wavelength, method, tolerance, obstacles=obstacles, **how
        ).amplitude()
    assert not isinstance(source, Differentiable)
    if execution.is_drjit(points):
        compute = partial(
            amplitude,
            source,
            wavelength=wavelength,
            method=method,
            tolerance=tolerance,
            obliquity=obliquity,
            return_error=return_error,
            obstacles=obstacles,
        )
        return execution.evaluate_hosted(compute, "points", points, 3, **how)
    assert not isinstance(source, PointSource)
    if isinstance(method, str) and method == "wigner":
        raise ArgumentError(
            f'expected method to be one of {", ".join(METHODS)}, got "wigner", whose rays have no '
            "phase; use polywigner.irradiance for them"
        )
    name = checked_method(method)
    places = checked_points(points)
    length = checked_wavelength(wavelength)
    double = execution.checked_precision(precision) != "single"
    execution.checked_engine(engine)
    allowed = checked_amplitude_tolerance(tolerance, double)
    flat = places.reshape(-1, 3)
    radiator = radiator_of(source.outline if isinstance(source, Screen) else flat_of(source))
    check_reach(places, float((radiator.high - radiator.low).max()), length, rays=False)
    if name == "fraunhofer" and not isinstance(source, Screen):
        kind = checked_method(DEFAULT if obliquity is None else obliquity, CONDITIONS)
        check_slopes(source, kind)
        warn_of_slopes(flat_of(source), length, kind)
        directions, distance, turns = _seen_from(radiator.centre, length, flat)
        flat_field = moved_source(flat_of(source), -radiator.centre)
        centred = (
            source.on(flat_field, -radiator.centre) if isinstance(source, Wavefront) else flat_field
        )
        pattern = far_field(centred, directions, length, kind, **how)
        values = pattern * np.exp(2j * math.pi * turns) / (distance * length)  # (B7)
        errors = _FOURIER_ERROR[double] * radiator.content / length**2 / distance
    elif obliquity is not None:
        raise ArgumentError(
            f'expected an obliquity with method="fraunhofer" only, got {obliquity!r} with {name!r};'
            " the other methods have their own"
        )
    elif isinstance(source, Screen):
        values, errors = field_of_screen(source, flat, length, name, allowed, engine)
    elif isinstance(source, Wavefront):
        values, errors = curved_field(checked_wavefront(source), flat, length, name)
    else:
        warn_of_slopes(source, length, name)
        found = boundary_field(radiator, flat, length, name, allowed, double, engine)
        values, errors = found[:2]
        warn_of_missed(*found[1:], "points")
    values = values.astype(np.complex128 if double else np.complex64)
    return shaped(values, errors, places, return_error)


def _check_shadowed(source: Any, method: Any, through: Any, obliquity: Any) -> None:
    """Raise ArgumentError for options that fields behind obstacles do not have."""
    if through is not None or obliquity is not None or method in ("fresnel", "fraunhofer"):
        raise ArgumentError(
            f"expected obstacles with one of the methods {', '.join(CONDITIONS)} alone, got them "
            "with a system, an obliquity or another method; leave one out"
        )
    if isinstance(source, Screen):
        raise ArgumentError(
            "expected a source without a screen before obstacles, got a Screen; pass the screen's "
            "plate as an obstacle and its PointSource as the source"
        )


def _behind_obstacles(
    source: Any,
    points: Points,
    wavelength: float,
    method: str,
    obstacles: Any,
    tolerance: float | None,
    return_error: bool,
    how: dict[str, Any],
) -> Any:
    """The free field and the change that obstacles make, (SB1); ``how``: precision and engine."""
    allowed = shadows.checked_shadow_tolerance(tolerance)
    places, length = checked_points(points), checked_wavelength(wavelength)
    flat = places.reshape(-1, 3)
    if isinstance(source, PointSource):
        free = source.amplitude * incident_of_point(source.position, flat, length)
        off = np.zeros(len(flat))
    else:
        free, off = amplitude(source, flat, wavelength, method, return_error=True, **how)
    bodies = obstacles_of(obstacles, length)
    change, inside, missed = shadows.shadow_of(
        source, bodies, flat, length, method, allowed, how["engine"], return_error
    )
    values, errors = np.where(inside, 0.0, free + change), np.where(inside, 0.0, off + missed)
    values = values.astype(np.complex64 if how["precision"] == "single" else np.complex128)
    return shaped(values, errors, places, return_error)


def shaped(values: Any, errors: Any, places: Any, return_error: bool) -> Any:
    """Values, and with ``return_error`` errors, (n,) of all places (..., d) in their shape."""
    found = tuple(a.reshape(places.shape[:-1])[()] for a in (values, errors))
    return found if return_error else found[0]


def _seen_from(centre: Floats, wavelength: float, points: Floats) -> tuple[Floats, ...]:
    """Directions (n, 3) of points, their distances in wavelengths, and the turns of these."""
    x, y = centre.tolist()
    place = point_in_wavelengths(_OPS, (x, y), wavelength, *points.T)
    distance = distance_of(_OPS, place)
    directions = np.stack([high / distance[0] for high, _ in place], axis=1)
    return directions, distance[0], reduced(_OPS, distance)
