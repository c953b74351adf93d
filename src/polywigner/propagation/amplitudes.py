"""The complex field of a source at points: exact, Fresnel and Fraunhofer."""

from __future__ import annotations

import math
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polywigner import execution
from polywigner.errors import ArgumentError
from polywigner.execution import Engine, Precision
from polywigner.geometry import Aperture, Wavefront
from polywigner.geometry.arguments import Points, takes_frequency
from polywigner.illumination import Array
from polywigner.illumination.obliquities import (
    CONDITIONS,
    DEFAULT,
    BoundaryCondition,
    warn_of_slopes,
)
from polywigner.illumination.support import moved_source
from polywigner.kernels.boundary.integrals import distance_of, point_in_wavelengths
from polywigner.numerics.phases import reduced
from polywigner.optics import FirstOrder
from polywigner.propagation.behind import field_behind
from polywigner.propagation.boundary import boundary_field
from polywigner.propagation.curved_fields import curved_field
from polywigner.propagation.far_fields import check_slopes, far_field
from polywigner.propagation.fields_traced import has_derivatives, traced_field
from polywigner.propagation.panels import radiator_of
from polywigner.propagation.places import (
    METHODS,
    Method,
    check_reach,
    checked_amplitude_tolerance,
    checked_method,
    checked_points,
    checked_wavelength,
    warn_of_missed,
)
from polywigner.propagation.screens import Screen, field_of_screen
from polywigner.transforms import Differentiable
from polywigner.transforms.wavefronts import checked_wavefront, flat_of
from polywigner.transforms.xarray_arguments import takes_xarray

__all__ = ["amplitude"]

# Points at a time: temporary arrays stay in the cache of one core.
_BLOCK = 1 << 12
_OPS = execution.NumpyOperations(double=True)

# Error of the Fourier transform, relative to the content.
_FOURIER_ERROR = {True: 1e-13, False: 2e-6}


@takes_frequency
@takes_xarray("points", units="W0.5 m-1", long_name="complex amplitude U")
def amplitude(
    source: Aperture | Array | Wavefront | Differentiable | Screen,
    points: Points,
    wavelength: float,
    method: Method = DEFAULT,
    *,
    through: FirstOrder | None = None,
    tolerance: float | None = None,
    obliquity: BoundaryCondition | None = None,
    return_error: bool = False,
    precision: Precision = None,
    engine: Engine = "auto",
) -> Any:
    """Field U(x, y, z) of a source of the plane z = 0, with its phase, where a wave is exp(+ikR)/R.

    The Rayleigh-Sommerfeld and Kirchhoff integrals over the aperture are reduced to integrals
    along its edges (docs/theory.md, (B1) to (B5)), without approximation, for every wave of an
    illumination, evanescent ones included. They are as good at z = 1e-6 wavelengths as far away,
    and smooth across the boundary of the geometric shadow. So is Fresnel's (B6). These are summed
    by Gauss's rules with as many nodes as each edge and point need, and an estimate of what is
    missing decides whether a point is done again with more. Fraunhofer's (B7) is a closed form.

    Parameters
    ----------
    source : an Aperture, or an Array of apertures in the plane z = 0, with any illuminations; or a
        :func:`differentiable` one; one with a curved wave, whose exact field is a sum over places
        in the opening rather than along its edges (docs/curved.md, (Q7)); or a :class:`Screen`
        that something lights from behind.
    points : (..., 3) in m, z > 0, or (..., 2) with ``through``; or a Dr.Jit array for results as
        those of :func:`fourier` are.
        Derivatives in them, and in the numbers of a differentiable source, are as accurate as the
        field (docs/gradients.md, (G5) to (G7)); "fraunhofer" has none.
    wavelength : in m.
    method : "rayleigh-sommerfeld-1" (the field in the opening is given), "rayleigh-sommerfeld-2"
        (its normal derivative is), "kirchhoff" (their mean), "fresnel" (parabolic waves, for
        points near the axis), "fraunhofer" (the far field, about the source's centre).
    through : a :class:`FirstOrder` from the source's plane to that of ``points``. There the field
        is Collins' integral (O4), instead of a ``method``, without exp(ikL) of the path L along the
        axis. An image (B = 0) is u itself. Behind systems of other curvatures along one axis than
        along the other, NumPy sums it up. No derivatives.
    tolerance : error allowed, as a fraction of the incident amplitude or, where that is less, of
        |u| area/(wavelength distance), which is what the field would be if all of the source were
        in phase (within a wavelength with the static field, |u| area/(2 pi distance^2)). Default
        1e-9 (single precision: 1e-5); at least 1e-13 (1e-6). Not for Fraunhofer.
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
    An ``xarray.DataArray`` gives one, as in :func:`fourier`.

    Warns
    -----
    PolywignerWarning if the estimate for some point exceeds the tolerance, as it may for one near
    rounding; and for "kirchhoff" and "rayleigh-sommerfeld-2" of a :func:`fit_illumination` with
    evanescent waves, whose slopes the fit does not know.

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
    if through is not None:
        others: dict[str, object] = {"obliquity": obliquity}
        others["method"] = None if method in (DEFAULT, "fresnel") else method
        return field_behind(
            source, points, wavelength, through, tolerance, others,
            return_error=return_error, precision=precision, engine=engine,
        )  # fmt: skip
    if has_derivatives(source, points, wavelength):
        if return_error or obliquity is not None:
            raise ArgumentError(
                "expected no return_error and no obliquity with derivatives; pass "
                "drjit.detach(...) of what needs none"
            )
        return traced_field(
            amplitude,
            source,
            points,
            wavelength,
            method,
            tolerance,
            precision=precision,
            engine=engine,
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
        )
        return execution.evaluate_hosted(
            compute, "points", points, 3, precision=precision, engine=engine
        )
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
        kind = checked_method(obliquity or DEFAULT, CONDITIONS)
        check_slopes(source, kind)
        warn_of_slopes(flat_of(source), length, kind)
        x, y = radiator.centre.tolist()
        directions, distance, turns = _seen_from_centre((x, y), length, flat)
        flat_field = moved_source(flat_of(source), -radiator.centre)
        centred = (
            source.on(flat_field, -radiator.centre) if isinstance(source, Wavefront) else flat_field
        )
        pattern = far_field(centred, directions, length, kind, precision=precision, engine=engine)
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
        warn_of_missed(*found[1:], "points", stacklevel=3)
    shape = places.shape[:-1]
    result = values.reshape(shape).astype(np.complex128 if double else np.complex64)[()]
    return (result, errors.reshape(shape)[()]) if return_error else result


def _seen_from_centre(
    centre: tuple[float, float], wavelength: float, points: NDArray[np.float64]
) -> tuple[NDArray[np.float64], ...]:
    """Directions (n, 3) of points, their distances in wavelengths, and the turns of these."""
    found = np.empty((len(points), 5))
    for start in range(0, len(points), _BLOCK):
        mine = slice(start, start + _BLOCK)
        place = point_in_wavelengths(_OPS, centre, wavelength, *points[mine].T)
        distance = distance_of(_OPS, place)
        for column, (high, _) in enumerate(place):
            found[mine, column] = high / distance[0]
        found[mine, 3], found[mine, 4] = distance[0], reduced(_OPS, distance)
    return found[:, :3], found[:, 3], found[:, 4]
