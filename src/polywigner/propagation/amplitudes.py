"""The complex field of a source at points: exact, Fresnel and Fraunhofer."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, TypeVar

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
from polywigner.propagation.point_grids import (
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
from polywigner.transforms.wavefronts import checked_wavefront, flat_source
from polywigner.transforms.xarray_arguments import takes_xarray

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]
Result = TypeVar("Result", np.float64, np.complex128)

Obstacle = Polyhedron | PlacedAperture

_OPS = execution.NumpyOperations()

# Error of the Fourier transform in double and in single precision, relative to the content.
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
    """Compute the complex field U(x, y, z) of a source in the plane z = 0.

    A free wave is exp(+ikR)/R. The Rayleigh-Sommerfeld and Kirchhoff integrals are reduced to
    integrals along the edges without approximation, evanescent waves included (docs/theory.md,
    (B1) to (B5)). They are as accurate at z = 1e-6 wavelengths as far away, and smooth across the
    boundary of the geometric shadow, as is Fresnel's integral (B6). Fraunhofer's field (B7) is a
    closed form.

    Parameters
    ----------
    source : Aperture, Array, Wavefront, Screen or PointSource
        Apertures in the plane z = 0 with any illuminations. The exact field of a curved wave is a
        sum over nodes on the source (docs/curved.md, (Q7)). A :class:`Screen` is illuminated from
        behind.
    points : array_like, shape (..., 3), or (..., 2) with ``through``
        Points in m, z > 0; on any side of a PointSource.
    wavelength : float
        Wavelength in m.
    method : str, default "rayleigh-sommerfeld-1"
        "rayleigh-sommerfeld-1" (given field in the opening), "rayleigh-sommerfeld-2" (given normal
        derivative), "kirchhoff" (their mean), "fresnel" (parabolic waves, for points near the
        axis) or "fraunhofer" (far field about the centre of the source).
    through : FirstOrder or sequence, optional
        First-order system from the plane of the source to that of ``points``, or a sequence of
        systems and stops in the order of the light. The field is Collins' integral (O4) without
        the factor exp(ikL) of the axial path L, and replaces ``method``. An image (B = 0) is u
        itself. Stops are Apertures and Arrays, whose field is their transmission (O8).
    obstacles : Polyhedron, placed Aperture or sequence, optional
        Opaque black bodies, and plates as apertures in a pose (:meth:`Aperture.placed`). Radiation
        passes at most one edge (docs/shadows.md, (SB1)): the field is smooth across the boundaries
        of shadows, and zero in bodies. Not with ``through``, "fresnel" and "fraunhofer".
    tolerance : float, optional
        Allowed error, as a fraction of the incident amplitude or, if that is less, of
        |u| area/(wavelength distance), the field of the source in phase (within a wavelength, of
        the static field |u| area/(2 pi distance^2)). Default 1e-9 (single precision: 1e-5), at
        least 1e-13 (1e-6). With obstacles: default 1e-6, at least 1e-8, of the largest field, from
        three wavelengths off the source. Not for "fraunhofer".
    obliquity : str, optional
        Boundary condition of "fraunhofer" only: that of the far field of "rayleigh-sommerfeld-1"
        (default), "kirchhoff" or "rayleigh-sommerfeld-2".
    return_error : bool, default False
        Also return the estimated error of each value. It covers the sum over nodes, not the
        approximation of "fresnel" or "fraunhofer".
    precision : {None, "double", "single"}
        Points and phases are in double precision in any case.
    engine : {"auto", "numpy", "llvm", "cuda"}
        See :func:`fourier`.

    Returns
    -------
    ndarray of complex128 (complex64 in single precision), shape (...)
        Field in the unit of the source's field; with ``return_error`` a pair of the field and an
        array of floats. An ``xarray.DataArray`` of points gives a DataArray.

    Raises
    ------
    ArgumentError
        For arguments of the wrong type, shape or range, Dr.Jit arrays, points behind the source,
        Fresnel fields that require too many nodes, and edges of more than 2e8 wavelengths.
    GeometryError
        If elements of an Array do not lie in the plane z = 0.
    EngineError
        If the engine is not available.

    Warns
    -----
    PolywignerWarning
        If the estimated error exceeds the tolerance at some point.

    Examples
    --------
    >>> import polywigner as pw
    >>> round(float(abs(pw.amplitude(pw.shapes.square(10e-3), (0.0, 0.0, 0.1), 3.2e-3))), 4)
    0.3103
    """
    checked_flag(return_error, "return_error")
    check_no_drjit(source=source, points=points, wavelength=wavelength)
    if obstacles is not None:
        _check_shadowed(source, method, through, obliquity)
        positions, field, errors = _behind_obstacles(
            source,
            points,
            wavelength,
            method,
            obstacles,
            tolerance,
            return_error,
            engine,
            precision,
        )
        return shaped(_in_precision(field, precision), errors, positions, return_error)
    if isinstance(source, PointSource) and (
        method not in CONDITIONS or through is not None or obliquity is not None
    ):
        raise ArgumentError(
            "the free field of a PointSource is exp(ikR)/R and takes no through, no obliquity "
            f"and no method other than {', '.join(CONDITIONS)}; leave them out"
        )
    if through is not None:
        others: dict[str, object] = {"obliquity": obliquity}
        others["method"] = None if method in (DEFAULT, "fresnel") else method
        return field_behind(
            source, points, wavelength, through, tolerance, others,
            return_error=return_error, precision=precision, engine=engine,
        )  # fmt: skip
    double = execution.checked_precision(precision) != "single"
    if isinstance(source, PointSource):
        positions, length = _points_around(source, points), checked_wavelength(wavelength)
        flat = positions.reshape(-1, 3)
        field = source.amplitude * incident_of_point(source.position, flat, length)
        errors = np.zeros(len(flat))
        return shaped(_in_precision(field, precision), errors, positions, return_error)
    if isinstance(method, str) and method == "wigner":
        raise ArgumentError(
            f'expected method to be one of {", ".join(METHODS)}, got "wigner", whose rays have no '
            "phase; use polywigner.irradiance for them"
        )
    name = checked_method(method)
    positions = checked_points(points)
    length = checked_wavelength(wavelength)
    execution.checked_engine(engine)
    allowed = checked_amplitude_tolerance(tolerance, double)
    flat = positions.reshape(-1, 3)
    if name == "fraunhofer" and not isinstance(source, Screen):
        field, errors = _fraunhofer(source, flat, length, obliquity, precision, engine)
    elif obliquity is not None:
        raise ArgumentError(
            f'expected an obliquity with method="fraunhofer" only, got {obliquity!r} with {name!r};'
            " the obliquity of the other methods is fixed"
        )
    elif isinstance(source, Screen):
        field, errors = field_of_screen(source, flat, length, name, allowed, engine)
    elif isinstance(source, Wavefront):
        field, errors = curved_field(checked_wavefront(source), flat, length, name)
    else:
        radiator = radiator_of(source)
        field, errors, limits = boundary_field(
            radiator, flat, length, name, allowed, double, engine
        )
        warn_of_missed(errors, limits, "points")
    return shaped(_in_precision(field, precision), errors, positions, return_error)


def _in_precision(field: Complex, precision: Precision) -> Complex:
    return field.astype(np.complex64 if precision == "single" else np.complex128)


def shaped(
    values: NDArray[Result], errors: Floats, points: Floats, return_error: bool
) -> NDArray[Result] | tuple[NDArray[Result], Floats]:
    """Return values (n,), and with ``return_error`` errors, in the shape of points (..., d)."""
    shape = points.shape[:-1]
    field = values.reshape(shape)[()]
    return (field, errors.reshape(shape)[()]) if return_error else field


def _points_around(source: PointSource, points: ArrayLike) -> Floats:
    """Points (..., 3) in metres on any side of a point source, but not on it."""
    positions = checked_coordinates(points, "expected points as real numbers of shape (..., 3)", 3)
    if (positions == np.array(source.position)).all(axis=-1).any():
        raise ArgumentError(
            f"point {list(source.position)} is the position of the point source; move it away"
        )
    return positions


def _fraunhofer(
    source: Aperture | Array | Wavefront,
    points: Floats,
    wavelength: float,
    obliquity: BoundaryCondition | None,
    precision: Precision,
    engine: Engine,
) -> tuple[Complex, Floats]:
    """Far field (B7) and its error at points (n, 3), with the distance from the centre."""
    kind = checked_method(DEFAULT if obliquity is None else obliquity, CONDITIONS)
    flat = flat_source(source)
    radiator = radiator_of(flat)
    check_slopes(source, kind)
    x, y = radiator.centre.tolist()
    ahead = point_in_wavelengths(_OPS, (x, y), wavelength, *points.T)
    doubled = distance_of(_OPS, ahead)
    distance = doubled[0]
    directions = np.stack([high / distance for high, _ in ahead], axis=1)
    centred = normal_form(flat).moved(-radiator.centre).public
    if isinstance(source, Wavefront):
        centred = source.on(centred, -radiator.centre)
    pattern = far_field(centred, directions, wavelength, kind, precision=precision, engine=engine)
    wave = np.exp(2j * math.pi * reduced(_OPS, doubled))
    error = _FOURIER_ERROR[precision != "single"] * radiator.content
    return pattern * wave / (distance * wavelength), error / wavelength**2 / distance


def _check_shadowed(source: object, method: str, through: object, obliquity: object) -> None:
    """Raise ArgumentError for options that fields behind obstacles do not have."""
    if through is not None or obliquity is not None or method in ("fresnel", "fraunhofer"):
        raise ArgumentError(
            f"expected obstacles with one of the methods {', '.join(CONDITIONS)} alone, got them "
            "with a system, an obliquity or another method; leave one out"
        )
    if isinstance(source, Screen):
        raise ArgumentError(
            "a Screen cannot be combined with obstacles; pass the screen's plate as an obstacle "
            "and its PointSource as the source"
        )


def _behind_obstacles(
    source: Aperture | Array | Wavefront | Screen | PointSource,
    points: ArrayLike,
    wavelength: float,
    method: Method,
    obstacles: Obstacle | Sequence[Obstacle],
    tolerance: float | None,
    with_error: bool,
    engine: Engine,
    precision: Precision,
) -> tuple[Floats, Complex, Floats]:
    """Points (..., 3), and (n,) the free field with the change by obstacles (SB1), and errors."""
    limits = shadows.DEFAULT_TOLERANCE, shadows.LEAST_TOLERANCE
    allowed = tolerance_from(tolerance, *limits, " with obstacles")
    length = checked_wavelength(wavelength)
    if isinstance(source, PointSource):
        positions = _points_around(source, points)
    else:
        positions = checked_points(points)
    flat = positions.reshape(-1, 3)
    free, error = amplitude(
        source, flat, wavelength, method, return_error=True, precision=precision, engine=engine
    )
    bodies = obstacles_of(obstacles, length)
    change, inside, missed = shadows.shadow_of(
        source, bodies, flat, length, method, allowed, engine, with_error
    )
    errors = np.where(inside, 0.0, error + missed)
    return positions, np.where(inside, 0.0, free + change), errors
