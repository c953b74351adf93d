"""The complex field of a source at points: exact, Fresnel and Fraunhofer."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from polywigner import execution
from polywigner.errors import ArgumentError
from polywigner.execution import Engine, Precision
from polywigner.geometry import Aperture, Polyhedron, Wavefront
from polywigner.geometry.aperture import PlacedAperture
from polywigner.geometry.arguments import checked_flag, checked_wavelength, takes_frequency
from polywigner.geometry.silhouettes import obstacles_of
from polywigner.kernels.boundary.integrals import distance_of, point_in_wavelengths
from polywigner.numerics.phases import reduced
from polywigner.optics import FirstOrder
from polywigner.propagation import shadows
from polywigner.propagation.boundary import boundary_field, radiator_of
from polywigner.propagation.collins import field_behind
from polywigner.propagation.curved_fields import curved_field
from polywigner.propagation.far_fields import check_slopes, far_field
from polywigner.propagation.places import (
    METHODS,
    Method,
    checked_amplitude_tolerance,
    checked_coordinates,
    checked_method,
    checked_points,
    tolerance_from,
    warn_of_missed,
)
from polywigner.propagation.screens import (
    PointSource,
    Screen,
    field_of_screen,
    incident_of_point,
)
from polywigner.source import Array
from polywigner.source.normal_form import normal_form
from polywigner.source.obliquities import (
    CONDITIONS,
    DEFAULT,
    BoundaryCondition,
)
from polywigner.transforms.traced_sources import check_no_drjit
from polywigner.transforms.wavefronts import checked_wavefront, flat_of
from polywigner.transforms.xarray_arguments import takes_xarray

Floats = NDArray[np.float64]

Obstacle = Polyhedron | PlacedAperture

_OPS = execution.NumpyOperations(double=True)

# Error of the Fourier transform, relative to the content.
_FOURIER_ERROR = {True: 1e-13, False: 2e-6}


@takes_frequency
@takes_xarray("points", units="W0.5 m-1", long_name="complex amplitude U")
def amplitude(
    source: Aperture | Array | Wavefront | Screen | PointSource,
    points: ArrayLike,
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
    source : an Aperture, or an Array of apertures in the plane z = 0, with any illuminations; or
        one with a curved wave, whose exact field is a sum over places
        in the opening (docs/curved.md, (Q7)); or a :class:`Screen` that something lights from
        behind; or a :class:`PointSource`.
    points : (..., 3) in m, z > 0 (on any side of a PointSource), or (..., 2) with ``through``.
    wavelength : in m.
    method : "rayleigh-sommerfeld-1" (the field in the opening is given), "rayleigh-sommerfeld-2"
        (its normal derivative is), "kirchhoff" (their mean), "fresnel" (parabolic waves, for
        points near the axis), "fraunhofer" (the far field, about the source's centre).
    through : a :class:`FirstOrder` from the source's plane to that of ``points``. There the field
        is Collins' integral (O4), instead of a ``method``, without exp(ikL) of the path L along the
        axis. An image (B = 0) is u itself. Or a sequence, in the light's order, of
        these and of stops: Apertures and Arrays, whose field is their transmission (O8).
    obstacles : bodies in the way, as :class:`Polyhedron`, and plates, as apertures in a pose
        (:meth:`Aperture.placed`), alone or in a sequence. They are opaque and black. Light passes
        one edge of theirs (docs/shadows.md, (SB1)): the field is smooth across the boundaries of
        shadows, and zero in bodies. Not with ``through``, "fresnel" and "fraunhofer".
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
    ArgumentError for arguments of the wrong type, shape or range, Dr.Jit arrays, points behind the
    source, Fresnel fields of points so close that their number of nodes explodes, edges of more
    than 2e8 wavelengths; GeometryError for arrays in other
    planes; EngineError without the engine.

    >>> import polywigner as pw
    >>> round(float(abs(pw.amplitude(pw.shapes.square(10e-3), (0.0, 0.0, 0.1), 3.2e-3))), 4)
    0.3103
    """
    checked_flag(return_error, "return_error")
    check_no_drjit(source=source, points=points, wavelength=wavelength)
    how: dict[str, Any] = {"precision": precision, "engine": engine}
    if obstacles is not None:
        _check_shadowed(source, method, through, obliquity)
        return _behind_obstacles(
            source, points, wavelength, method, obstacles, tolerance, return_error, how
        )
    if isinstance(source, PointSource):
        _check_alone(method, through, obliquity)
    if through is not None:
        others: dict[str, object] = {"obliquity": obliquity}
        others["method"] = None if method in (DEFAULT, "fresnel") else method
        return field_behind(
            source, points, wavelength, through, tolerance, others, return_error=return_error, **how
        )
    if isinstance(source, PointSource):
        places, length = _points_around(source, points), checked_wavelength(wavelength)
        flat = places.reshape(-1, 3)
        values = source.amplitude * incident_of_point(source.position, flat, length)
        single = execution.checked_precision(precision) == "single"
        values = values.astype(np.complex64 if single else np.complex128)
        return shaped(values, np.zeros(len(values)), places, return_error)
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
    if name == "fraunhofer" and not isinstance(source, Screen):
        kind = checked_method(DEFAULT if obliquity is None else obliquity, CONDITIONS)
        check_slopes(source, kind)
        CONDITIONS[kind].warn_of_fit(flat_of(source), length)
        directions, distance, turns = _seen_from(radiator.centre, length, flat)
        flat_field = normal_form(flat_of(source)).moved(-radiator.centre).public
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
        if name in CONDITIONS:
            CONDITIONS[name].warn_of_fit(source, length)
        found = boundary_field(radiator, flat, length, name, allowed, double, engine)
        values, errors = found[:2]
        warn_of_missed(*found[1:], "points")
    values = values.astype(np.complex128 if double else np.complex64)
    return shaped(values, errors, places, return_error)


def _check_alone(method: Any, through: Any, obliquity: Any) -> None:
    """Raise ArgumentError for options that the free field of a point source does not have."""
    if method not in CONDITIONS or through is not None or obliquity is not None:
        raise ArgumentError(
            "the free field of a PointSource is exp(ikR)/R and takes no through, no obliquity "
            f"and no method other than {', '.join(CONDITIONS)}; leave them out"
        )


def _points_around(source: PointSource, points: Any) -> Floats:
    """Points (..., 3) in metres on any side of a point source, but not on it."""
    places = checked_coordinates(points, "expected points as real numbers of shape (..., 3)", 3)
    if (places == np.array(source.position)).all(axis=-1).any():
        raise ArgumentError(
            f"point {list(source.position)} is the position of the point source; move it away"
        )
    return places


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
    points: ArrayLike,
    wavelength: float,
    method: str,
    obstacles: Any,
    tolerance: float | None,
    return_error: bool,
    how: dict[str, Any],
) -> Any:
    """The free field and the change that obstacles make, (SB1); ``how``: precision and engine."""
    limits = shadows.DEFAULT_TOLERANCE, shadows.LEAST_TOLERANCE
    allowed = tolerance_from(tolerance, *limits, " with obstacles")
    length = checked_wavelength(wavelength)
    is_point = isinstance(source, PointSource)
    places = _points_around(source, points) if is_point else checked_points(points)
    flat = places.reshape(-1, 3)
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
