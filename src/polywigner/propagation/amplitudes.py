"""The complex field of a source at points: exact, Fresnel and Fraunhofer."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, TypedDict, Unpack

import numpy as np
from numpy.typing import ArrayLike

from polywigner import execution
from polywigner.errors import ArgumentError
from polywigner.execution import Engine
from polywigner.geometry import Aperture, Polyhedron, Wavefront
from polywigner.geometry.aperture import PlacedAperture
from polywigner.geometry.arguments import checked_choice, checked_wavelength, takes_frequency
from polywigner.geometry.silhouettes import obstacles_of
from polywigner.kernels.boundary.integrals import distance_of, point_in_wavelengths
from polywigner.numerics import Complex, Floats
from polywigner.numerics.phases import reduced
from polywigner.optics import FirstOrder
from polywigner.propagation import shadows
from polywigner.propagation.boundary import boundary_field, radiator_of
from polywigner.propagation.collins import field_behind
from polywigner.propagation.conducting_sheets import Edge, check_edge
from polywigner.propagation.curved_fields import curved_field
from polywigner.propagation.far_fields import check_slopes, far_field
from polywigner.propagation.point_grids import (
    METHODS,
    Method,
    checked_coordinates,
    checked_points,
    tolerance_from,
    warn_of_missed,
)
from polywigner.propagation.pupil_fields import aberrated_fresnel_field, aberrated_spectrum
from polywigner.propagation.screens import PointSource, Screen, field_of_screen, spherical_field
from polywigner.source import Array
from polywigner.source.normal_form import normal_form
from polywigner.source.obliquities import CONDITIONS, DEFAULT, BoundaryCondition
from polywigner.transforms.aberrated_pupils import AberratedPupil, checked_aberration
from polywigner.transforms.aberrations import Aberration
from polywigner.transforms.traced_sources import check_no_drjit
from polywigner.transforms.wavefronts import checked_wavefront, flat_source
from polywigner.transforms.xarray_arguments import takes_xarray

Obstacle = Polyhedron | PlacedAperture

_OPS = execution.NumpyOperations()

# Rounding error of a Fourier transform, relative to the upper bound `Radiator.content` on its
# modulus.
_FOURIER_ERROR = 1e-13


class AmplitudeOptions(TypedDict, total=False):
    """Keyword arguments of :func:`amplitude`."""

    through: FirstOrder | Sequence[FirstOrder | Aperture | Array] | None
    obstacles: Obstacle | Sequence[Obstacle] | None
    edge: Edge
    obliquity: BoundaryCondition | None
    aberration: Aberration | None
    tolerance: float | None
    engine: Engine


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
    edge: Edge = "black",
    obliquity: BoundaryCondition | None = None,
    aberration: Aberration | None = None,
    tolerance: float | None = None,
    engine: Engine = "auto",
) -> Complex:
    """Compute the complex field U(x, y, z) of a source in the plane z = 0.

    The Rayleigh-Sommerfeld and Kirchhoff integrals over the source are reduced, without
    approximation, to integrals along its edges that include evanescent waves (docs/theory.md, (B1)
    to (B5)). The field is as accurate at z = 1e-6 wavelengths as in the far field. Like Fresnel's
    integral (B6), these fields are smooth across the boundary of the geometric shadow. Fraunhofer's
    field (B7) follows from the Fourier transform of the source. The phase convention is exp(+ikR)/R
    for a spherical wave.

    Parameters
    ----------
    source : Aperture, Array, Wavefront, Screen or PointSource
        Apertures in the plane z = 0 with any illumination. The exact field of a curved wave is a
        sum over nodes on the source (docs/curved.md, (Q7)). A :class:`Screen` is illuminated from
        behind.
    points : array_like, shape (..., 3), or (..., 2) with ``through``
        Points in m, with z > 0 unless the source is a PointSource.
    wavelength : float
        Wavelength in m.
    method : str, default "rayleigh-sommerfeld-1"
        "rayleigh-sommerfeld-1" (the field is given in the plane z = 0), "rayleigh-sommerfeld-2"
        (its normal derivative is given), "kirchhoff" (average of these two integrals), "fresnel"
        (parabolic waves, for points near the axis) or "fraunhofer" (far field about the centre of
        the source).
    through : FirstOrder or sequence, optional
        First-order system from the plane of the source to the plane of ``points``, or a sequence of
        systems and stops in the order in which the light passes them. The field is Collins'
        integral (O4) without the factor exp(ikL) of the axial path length L, and ``method`` is not
        used. If the points lie in an image plane of the source (B = 0), the field is the image of
        u. A stop is an Aperture or an Array whose field is its transmission (O8).
    obstacles : Polyhedron, placed Aperture or sequence, optional
        Opaque black bodies and plates. A plate is an aperture placed in space
        (:meth:`Aperture.placed`). Each ray is diffracted by at most one edge (docs/shadows.md,
        (SB1)). The field is smooth across the boundaries of shadows, and zero in bodies. Obstacles
        cannot be combined with ``through``, "fresnel" and "fraunhofer".
    edge : {"black", "soft", "hard"}, default "black"
        Boundary condition on the obstacles: "soft" for u = 0, "hard" for a normal derivative of
        zero. Soft and hard obstacles must be plates in one plane. Such plates also reflect the wave
        (docs/shadows.md, (SB9)).
    obliquity : str, optional
        Boundary condition of the far field for "fraunhofer" only: "rayleigh-sommerfeld-1"
        (default), "kirchhoff" or "rayleigh-sommerfeld-2".
    aberration : Aberration, optional
        Path length in m on the source, for "fresnel" and "fraunhofer" (docs/imaging.md, (IM3)).
    tolerance : float, optional
        Allowed error, by default 1e-9, at least 1e-13. The tolerance is a fraction of the incident
        amplitude, or of the field with all parts of the source in phase if this field is smaller.
        This in-phase field is |u| area/(wavelength distance), or, within a wavelength of the
        source, the static field |u| area/(2 pi distance^2). With obstacles the tolerance is a
        fraction of the largest field at three or more wavelengths from the source; the default is
        1e-6, and the smallest value is 1e-8. The tolerance is not used by "fraunhofer" without an
        aberration.
    engine : {"auto", "numpy", "llvm", "cuda"}
        See :func:`fourier`.

    Returns
    -------
    ndarray of complex128, shape (...)
        Field in the unit of the source's field. If ``points`` is an ``xarray.DataArray``, the
        result is a DataArray.

    Raises
    ------
    ArgumentError
        If an argument has the wrong type, shape or range or is a Dr.Jit array, if a point lies
        behind the source, if a system requires too many nodes, or if the total length of the edges
        exceeds 2e8 wavelengths.
    GeometryError
        If elements of an Array do not lie in the plane z = 0.
    EngineError
        If the engine is not available.

    Warns
    -----
    PolywignerWarning
        If the estimated error exceeds the tolerance at some point.

    See Also
    --------
    amplitude_with_error : The field and an estimate of its error.

    Examples
    --------
    >>> import polywigner as pw
    >>> round(float(abs(pw.amplitude(pw.shapes.square(10e-3), (0.0, 0.0, 0.1), 3.2e-3))), 4)
    0.3103
    """
    return field_and_error(
        source, points, wavelength, method, through=through, obstacles=obstacles, edge=edge,
        obliquity=obliquity, aberration=aberration, tolerance=tolerance, engine=engine,
    )[0]  # fmt: skip


@takes_frequency
@takes_xarray("points", units="W0.5 m-1", long_name="complex amplitude U", with_error=True)
def amplitude_with_error(
    source: Aperture | Array | Wavefront | Screen | PointSource,
    points: ArrayLike,
    wavelength: float,
    method: Method = DEFAULT,
    **options: Unpack[AmplitudeOptions],
) -> tuple[Complex, Floats]:
    """Compute the complex field of :func:`amplitude`, and an estimate of its error.

    Parameters
    ----------
    source, points, wavelength, method, **options
        See :func:`amplitude`.

    Returns
    -------
    field : ndarray of complex128, shape (...)
        See :func:`amplitude`.
    error : ndarray of float64, shape (...)
        Estimated error of each value, in the unit of the field. The estimate covers the sum over
        quadrature nodes, but not the approximation of "fresnel" or "fraunhofer". Behind obstacles
        the estimate may double the computing time.

    Raises
    ------
    PolywignerError
        See :func:`amplitude`.

    Examples
    --------
    >>> import polywigner as pw
    >>> square = pw.shapes.square(10e-3)
    >>> field, error = pw.amplitude_with_error(square, (0.0, 0.0, 0.1), 3.2e-3)
    >>> bool(error < 1e-9)
    True
    """
    return field_and_error(source, points, wavelength, method, with_error=True, **options)


def field_and_error(
    source: Aperture | Array | Wavefront | Screen | PointSource,
    points: ArrayLike,
    wavelength: float,
    method: Method,
    *,
    through: FirstOrder | Sequence[FirstOrder | Aperture | Array] | None = None,
    obstacles: Obstacle | Sequence[Obstacle] | None = None,
    edge: Edge = "black",
    obliquity: BoundaryCondition | None = None,
    aberration: Aberration | None = None,
    tolerance: float | None = None,
    engine: Engine = "auto",
    with_error: bool = False,
) -> tuple[Complex, Floats]:
    """Return the field of :func:`amplitude` at points, and an estimate of its error.

    The error includes the error of diffraction by obstacles only if ``with_error`` is true.
    """
    check_no_drjit(source=source, points=points, wavelength=wavelength)
    if aberration is not None:
        _check_aberrated(source, method, through, obstacles, obliquity)
    if through is not None and obstacles is None and not isinstance(source, PointSource):
        others: dict[str, object] = {"obliquity": obliquity}
        others["method"] = None if method in (DEFAULT, "fresnel") else method
        return field_behind(source, points, wavelength, through, tolerance, others, engine)
    if isinstance(source, PointSource) or obstacles is not None:
        _check_options(source, method, through, obliquity)
    if isinstance(method, str) and method == "wigner":
        raise ArgumentError(
            f'expected method to be one of {", ".join(METHODS)}, got "wigner", whose rays have no '
            "phase; use polywigner.irradiance for rays"
        )
    name, length = checked_choice(method, "method", METHODS), checked_wavelength(wavelength)
    if isinstance(source, PointSource):
        positions = _points_around(source, points)
    else:
        positions = checked_points(points)
    execution.checked_engine(engine)
    flat = positions.reshape(-1, 3)
    check_edge(edge, obstacles)
    if obstacles is not None:
        limits = shadows.DEFAULT_TOLERANCE, shadows.LEAST_TOLERANCE
        allowed, tolerance = tolerance_from(tolerance, *limits, " with obstacles"), None
    if aberration is not None:
        allowed = tolerance_from(tolerance)
        field, errors = _aberrated_field(source, aberration, flat, length, name, allowed)
    else:
        field, errors = _free_field(source, flat, length, name, obliquity, tolerance, engine)
    if obstacles is not None:
        bodies = obstacles_of(obstacles, length)
        change, inside, missed = shadows.shadow_of(
            source, bodies, flat, length, name, allowed, engine, with_error, edge
        )
        field = np.where(inside, 0.0, field + change)
        errors = np.where(inside, 0.0, errors + missed)
    shape = positions.shape[:-1]
    return field.reshape(shape)[()], errors.reshape(shape)[()]


def _check_options(source: object, method: object, through: object, obliquity: object) -> None:
    """Raise ArgumentError for options that obstacles and point sources do not allow."""
    if through is not None or obliquity is not None or method not in CONDITIONS:
        raise ArgumentError(
            "a PointSource, and any source with obstacles, requires one of the methods "
            f"{', '.join(CONDITIONS)}, got method={method!r}; also omit through= and obliquity="
        )
    if isinstance(source, Screen):
        raise ArgumentError(
            "a Screen cannot be combined with obstacles; pass the screen's plate as an obstacle "
            "and its PointSource as the source"
        )


def _check_aberrated(
    source: object, method: object, through: object, obstacles: object, obliquity: object
) -> None:
    """Raise ArgumentError if another argument cannot be combined with an aberration."""
    is_valid = isinstance(source, Aperture | Array | Wavefront) and through is obstacles is None
    if not is_valid or obliquity is not None or method not in ("fresnel", "fraunhofer"):
        raise ArgumentError(
            'an aberration requires an Aperture, Array or Wavefront and method="fresnel" or '
            f'"fraunhofer", got method={method!r}; also omit through=, obstacles= and obliquity=, '
            "or use polywigner.psf for a lens"
        )


def _aberrated_field(
    source: Any,
    aberration: Aberration,
    points: Floats,
    wavelength: float,
    method: str,
    tolerance: float,
) -> tuple[Complex, Floats]:
    """Return the Fresnel or Fraunhofer field of an aberrated source at points, and its error."""
    if isinstance(source, Wavefront):
        checked_wavefront(source)
    checked_aberration(aberration, wavelength)
    if method == "fresnel":
        return aberrated_fresnel_field(source, aberration, points, wavelength, tolerance)
    pupil = AberratedPupil.of(source, aberration, wavelength, 0.0)
    centre = radiator_of(flat_source(source)).centre
    directions, distance, wave = _seen_from(centre, points, wavelength)
    nu, cosine = directions[:, :2] / wavelength, np.maximum(directions[:, 2], 0.0)
    values, errors, _ = aberrated_spectrum(pupil, nu, tolerance, centre)
    scale = cosine / (distance * wavelength**2)
    return scale * values * wave / 1j, scale * errors


def _seen_from(centre: Floats, points: Floats, wavelength: float) -> tuple[Floats, Floats, Complex]:
    """Return unit directions (n, 3), distances [wavelengths] and phase factors exp(ikR) of points.

    The distances and directions of the points (n, 3) are relative to the position ``centre`` (2,)
    in the plane z = 0, in m.
    """
    x, y = centre.tolist()
    ahead = point_in_wavelengths(_OPS, (x, y), wavelength, *points.T)
    doubled = distance_of(_OPS, ahead)
    directions = np.stack([high / doubled[0] for high, _ in ahead], axis=1)
    return directions, doubled[0], np.exp(2j * math.pi * reduced(_OPS, doubled))


def _free_field(
    source: Aperture | Array | Wavefront | Screen | PointSource,
    points: Floats,
    wavelength: float,
    method: str,
    obliquity: BoundaryCondition | None,
    tolerance: float | None,
    engine: Engine,
) -> tuple[Complex, Floats]:
    """Return the field without obstacles at points (n, 3), and its estimated error."""
    allowed = tolerance_from(tolerance)
    if isinstance(source, PointSource):
        field = source.amplitude * spherical_field(source.position, points, wavelength)
        return field, np.zeros(len(points))
    if method == "fraunhofer" and not isinstance(source, Screen):
        return _fraunhofer(source, points, wavelength, obliquity, engine)
    if obliquity is not None:
        raise ArgumentError(
            f'obliquity={obliquity!r} requires method="fraunhofer", got method={method!r}; omit '
            "the obliquity, since the other methods have a fixed obliquity"
        )
    if isinstance(source, Screen):
        return field_of_screen(source, points, wavelength, method, allowed, engine)
    if isinstance(source, Wavefront):
        return curved_field(checked_wavefront(source), points, wavelength, method)
    radiator = radiator_of(source)
    field, errors, limits = boundary_field(radiator, points, wavelength, method, allowed, engine)
    warn_of_missed(errors, limits, "points")
    return field, errors


def _points_around(source: PointSource, points: ArrayLike) -> Floats:
    """Return points (..., 3); raise ArgumentError if a point is the position of the source."""
    positions = checked_coordinates(
        points, "expected points to be real numbers of shape (..., 3)", 3
    )
    if (positions == np.array(source.position)).all(axis=-1).any():
        raise ArgumentError(
            f"the field is infinite at point {list(source.position)}, which is the position of "
            "the point source; move the point"
        )
    return positions


def _fraunhofer(
    source: Aperture | Array | Wavefront,
    points: Floats,
    wavelength: float,
    obliquity: BoundaryCondition | None,
    engine: Engine,
) -> tuple[Complex, Floats]:
    """Return the Fraunhofer field (B7) at points (n, 3), and a bound on its rounding error.

    An ``obliquity`` of None selects the default boundary condition.
    """
    kind = checked_choice(DEFAULT if obliquity is None else obliquity, "obliquity", CONDITIONS)
    flat = flat_source(source)
    radiator = radiator_of(flat)
    check_slopes(source, kind)
    directions, distance, wave = _seen_from(radiator.centre, points, wavelength)
    centred = normal_form(flat).moved(-radiator.centre).public
    if isinstance(source, Wavefront):
        centred = source.on(centred, -radiator.centre)
    pattern = far_field(centred, directions, wavelength, kind, engine=engine)
    error = _FOURIER_ERROR * radiator.content
    return pattern * wave / (distance * wavelength), error / wavelength**2 / distance
