"""Fields behind first-order systems: Collins' integral, by the rank of B. Source: (O4) to (O7)."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polywigner import execution
from polywigner.errors import ArgumentError
from polywigner.geometry import Aperture, Wavefront
from polywigner.geometry.arguments import checked_wavelength, real_numbers
from polywigner.illumination import Array
from polywigner.illumination.array import tilted_source
from polywigner.numerics.chirps import chirp_integral, waves_of_turns
from polywigner.optics import FirstOrder
from polywigner.propagation.boundary import boundary_field
from polywigner.propagation.field_slopes import has_derivatives
from polywigner.propagation.panels import Radiator, radiator_of
from polywigner.propagation.places import checked_amplitude_tolerance, warn_of_missed
from polywigner.transforms import autocorrelation, fourier
from polywigner.transforms.calls import checked_system
from polywigner.transforms.wavefronts import checked_wavefront, chirp_transform

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]


@dataclass(frozen=True)
class Chirp:
    """exp(i pi/lambda (x^T S x - 2 q.x)) in the axes of S."""

    axes: Floats
    """Columns: directions of x_1 and x_2, a rotation."""
    curvature: Floats
    """s_1 and s_2, |s_1| the larger one, in 1/m."""
    wavelength: float


def line_integral(radiator: Radiator, chirp: Chirp, x2: Floats, slope: Floats) -> Complex:
    """The integral over x_1 alone at ``x2``, with q_1 = ``slope``, both (n,), in m of the field."""
    values = np.zeros(len(x2), np.complex128)
    curvature, wavelength = float(chirp.curvature[0]), chirp.wavelength
    for element in radiator.elements:
        edges, middle = _edges_of(element.outline, chirp.axes)
        for shift, weight in zip(element.shifts @ chirp.axes, element.weights, strict=True):
            place, across = shift + middle, x2 - shift[1] - middle[1]
            own = slope - curvature * place[0]
            turns = place[0] * (0.5 * curvature * place[0] - slope) / wavelength
            for amplitude, kappa in zip(element.amplitudes, element.frequencies, strict=True):
                wave = kappa @ chirp.axes
                found = np.zeros(len(x2), np.complex128)
                for (x, y), (ex, ey) in edges.tolist():
                    above, below = (y + ey > across), (y > across)
                    some = np.flatnonzero(above != below)
                    at = x + ex * ((across[some] - y) / (ey or 1.0))
                    frequency = own[some] / wavelength - wave[0]
                    part = chirp_integral(at, curvature / wavelength, frequency)
                    found[some] += math.copysign(1.0, ey) * part
                phase = turns + wave[0] * middle[0] + wave[1] * (across + middle[1])
                values += weight * amplitude * found * waves_of_turns(phase)
    return values


def _edges_of(outline: Aperture, axes: Floats) -> tuple[Floats, Floats]:
    """Beginnings and extents (m, 2, 2) of edges from the middle of their box, and that place."""
    rings = [ring @ axes for ring in outline.rings]
    begin = np.concatenate(rings)
    extent = np.concatenate([np.roll(ring, -1, axis=0) for ring in rings]) - begin
    middle = begin.min(axis=0) / 2 + begin.max(axis=0) / 2
    return np.stack([begin - middle, extent], axis=1), middle


Found = tuple[NDArray[np.complex128], Floats, Floats]

# Curvatures along all axes that differ by less, relative to what rounding makes of them, are equal.
_EQUAL = 8 * 2.0**-52
# Of closed forms, relative to the content, in double and in single precision.
_CLOSED = {True: 1e-13, False: 2e-6}
_ULP = 2.0**-52
# Most turns of phase along an outline whose Fresnel field is summed up.
_MOST_TURNS = 1e6


def collins_field(
    source: Any,
    radiator: Radiator,
    points: Floats,
    wavelength: float,
    system: FirstOrder,
    tolerance: float,
    double: bool,
    engine: str,
) -> Found:
    """Field at points (n, 2), estimate of its error, and allowed error, all (n,).

    ``tolerance``: what is allowed as a fraction of the field of an image or, where that is less, of
    what could come from all of the source.
    """
    left, scale, right = np.linalg.svd(system.B)
    none = scale <= np.linalg.norm(system.rounding[:2, 2:])
    if none.all():
        return _image(radiator, source, points, wavelength, system, double)
    if none[1]:
        return _line_image(radiator, points, wavelength, system, left, float(scale[0]), right)
    inverse = np.linalg.inv(system.B)
    bend, slopes = inverse @ system.A, points @ inverse.T
    front = _front(system.B) / (wavelength * math.sqrt(abs(np.linalg.det(system.B))))
    out = waves_of_turns(_turns(system.D @ inverse, points, wavelength)) * front
    if not (abs(system.A) > system.rounding[:2, :2]).any():
        how: dict[str, Any] = {"precision": None if double else "single", "engine": engine}
        values = np.asarray(fourier(source, slopes / wavelength, **how))
        errors = np.full(len(points), _CLOSED[double] * radiator.content)
        allowed = tolerance * np.full(len(points), radiator.content)
    else:
        curvature, axes = np.linalg.eigh((bend + bend.T) / 2)
        middle = float(curvature.mean())
        spread = np.linalg.cond(system.B) * _EQUAL * abs(curvature).max()
        if abs(bend - middle * np.eye(2)).max() <= spread:
            values, errors, allowed = _by_fresnel(
                radiator, slopes, wavelength, middle, tolerance, double, engine
            )
        else:
            order = np.argsort(-abs(curvature))
            axes = axes[:, order] * [1.0, np.linalg.det(axes[:, order])]
            chirp = Chirp(axes, curvature[order], wavelength)
            allowed = np.full(len(points), tolerance * _brightest(radiator, chirp))
            values = chirp_transform(
                source, chirp.curvature / wavelength, axes, np.zeros(2), slopes / wavelength
            )
            errors = _rounding(radiator, chirp, slopes)
    size = abs(front)
    return out * values, size * errors, size * allowed


def _turns(form: Floats, points: Floats, wavelength: float) -> Floats:
    """Half of y^T form y, in wavelengths."""
    return np.asarray(0.5 * ((points @ form.T) * points).sum(axis=1) / wavelength)


def _front(matrix: Floats) -> complex:
    """1/sqrt(i) for each axis, 1/sqrt(-i) for one along which a matrix is negative."""
    if np.linalg.det(matrix) < 0:
        return 1.0
    return -1j if np.trace(matrix) >= 0 else 1j


def _brightest(radiator: Radiator, chirp: Chirp) -> float:
    """The integral where all of the source is in phase, or of its image by rays if that is less."""
    s1, s2 = abs(chirp.curvature)
    area = math.sqrt(s1 * s2) * radiator.content
    rays = chirp.wavelength * radiator.amplitude
    return rays / math.sqrt(s1 * s2) if area > rays else radiator.content


def _rounding(radiator: Radiator, chirp: Chirp, slopes: Floats) -> Floats:
    """Rounding of the integral along edges: of phases, times the sum of moduli."""
    width = math.sqrt(chirp.wavelength / abs(chirp.curvature[0]))
    size = float(np.linalg.norm(radiator.high - radiator.low))
    along = radiator.amplitude * radiator.perimeter * min(width, size)
    away = np.linalg.norm(
        (slopes @ chirp.axes) - chirp.curvature * (radiator.centre @ chirp.axes), axis=1
    )
    turns = (away + abs(chirp.curvature[0]) * size) * (size / chirp.wavelength)
    return _ULP * along * (4.0 + turns + size * radiator.highest_frequency)


def _by_fresnel(
    radiator: Radiator, slopes: Floats, wavelength: float, curvature: float,
    tolerance: float, double: bool, engine: str,
) -> Found:  # fmt: skip
    """The integral of the chirp of one curvature: a Fresnel field at z = 1/curvature.

    Only z times the wavelength matters: the source's size is taken for the latter, so that panels
    are as long as edges.
    """
    if curvature < 0:
        mirrored = tuple(
            replace(
                element,
                amplitudes=element.amplitudes.conj(),
                frequencies=-element.frequencies,
                weights=element.weights.conj(),
            )
            for element in radiator.elements
        )
        conjugate = replace(radiator, elements=mirrored)
        values, errors, allowed = _by_fresnel(
            conjugate, -slopes, wavelength, -curvature, tolerance, double, engine
        )
        return values.conj(), errors, allowed
    unit = float((radiator.high - radiator.low).max())
    z = wavelength / (curvature * unit)
    places = np.column_stack([slopes / curvature, np.full(len(slopes), z)])
    _check_turns(radiator, places, unit)
    found = boundary_field(radiator, places, unit, "collins", tolerance, double, engine)
    centre = radiator.centre
    turns = ((0.5 * curvature * centre - slopes) @ centre) / wavelength
    scale = unit * z
    return 1j * scale * waves_of_turns(turns) * found[0], scale * found[1], scale * found[2]


def _check_turns(radiator: Radiator, places: Floats, unit: float) -> None:
    aside = np.maximum(places[:, :2] - radiator.low, radiator.high - places[:, :2])
    slope = np.linalg.norm(aside, axis=1) / places[:, 2] + unit * radiator.highest_frequency
    turns = radiator.perimeter / unit * float(slope.max(initial=0.0))
    if not turns <= _MOST_TURNS:
        raise ArgumentError(
            f"expected a system with up to {_MOST_TURNS:.3g} turns of phase along the outline, got "
            f"{turns:.3g}; take points nearer to the light, or a plane farther from an image"
        )


def _image(
    radiator: Radiator, source: Any, points: Floats, wavelength: float, system: FirstOrder,
    double: bool,
) -> Found:  # fmt: skip
    """B = 0: the field of the source, magnified, with the phase of a lens."""
    inverse = np.linalg.inv(system.A)
    front = 1j * _front(system.A) if np.linalg.det(system.A) > 0 else -1j
    front = front / math.sqrt(abs(np.linalg.det(system.A)))
    values = _field_at(source, points @ inverse.T)
    values = values * waves_of_turns(_turns(system.C @ inverse, points, wavelength)) * front
    errors = np.full(len(points), abs(front) * _CLOSED[double] * radiator.amplitude)
    return values, errors, np.full(len(points), math.inf)


def _field_at(source: Any, x: Floats) -> NDArray[np.complex128]:
    """u itself; points on the boundary as in :func:`autocorrelation`."""
    if isinstance(source, Array):
        parts = zip(source.elements_in_plane, source.weights.tolist(), strict=True)
        total = np.zeros(len(x), np.complex128)
        for element, weight in parts:
            total += weight * _field_at(element, x)
        return total
    inside = autocorrelation(source.with_illumination(None), x, (0.0, 0.0), engine="numpy")
    field = source.illumination
    return np.asarray(inside if field is None else inside * field(x))


def _line_image(
    radiator: Radiator, points: Floats, wavelength: float, system: FirstOrder,
    left: Floats, b: float, right: Floats,
) -> Found:  # fmt: skip
    """B of rank 1: an image along one axis, Collins' integral along the other."""
    # B = left diag(b, 0) right, by rotations that are as near to each other as can be
    left, right = left.copy(), right.copy()
    left[:, 1] *= np.linalg.det(left)
    right[1] *= np.linalg.det(right)
    if np.trace(right @ left) < 0:
        left, b = -left, -b
    a, c, d = (left.T @ block @ right.T for block in (system.A, system.C, system.D))
    (y1, y2), size = (points @ left).T, float(a[1, 1])
    chirp = Chirp(right.T, np.array([a[0, 0] / b, 0.0]), wavelength)
    x2 = y2 / size
    values = line_integral(radiator, chirp, x2, (y1 - a[0, 1] * x2) / b)
    own = (c[1, 1] - d[1, 0] * a[0, 1] / b) / size
    turns = ((0.5 * d[0, 0] * y1 + d[1, 0] * y2) * y1 / b + 0.5 * own * y2 * y2) / wavelength
    front = np.exp(-0.25j * math.pi * math.copysign(1.0, b)) * (1.0 if size > 0 else -1j)
    front = front / math.sqrt(abs(wavelength * b * size))
    width = float(np.linalg.norm(radiator.high - radiator.low))
    error = np.full(len(points), abs(front) * _CLOSED[True] * radiator.amplitude * width)
    return front * waves_of_turns(turns) * values, error, np.full(len(points), math.inf)


def field_behind(
    source: Any,
    points: Any,
    wavelength: Any,
    through: Any,
    tolerance: float | None,
    others: dict[str, Any],
    *,
    squared: bool = False,
    return_error: bool = False,
    precision: Any = None,
    engine: Any = "auto",
) -> Any:
    """The amplitude at points (..., 2) behind a system, and with ``return_error`` its error.

    ``others``: arguments that are for fields in front of the source; none may be given.
    ``squared``: the irradiance instead.
    """
    for name, value in others.items():
        if value is not None:
            raise ArgumentError(
                f"expected no {name} with through=, got {value!r}; the field behind a first-order "
                "system is Collins' integral"
            )
    if has_derivatives(source, points, wavelength):
        raise ArgumentError(
            "expected no derivatives with through=; pass drjit.detach(...) of the arguments, or "
            "differentiate polywigner.wigner, which takes through= as well"
        )
    system = checked_system(through)
    if execution.is_drjit(points):
        compute = partial(
            field_behind, source, wavelength=wavelength, through=system, tolerance=tolerance,
            others={}, squared=squared, return_error=return_error,
        )  # fmt: skip
        return execution.evaluate_hosted(
            compute, "points", points, 2, precision=precision, engine=engine
        )
    places = _checked_plane(points)
    length = checked_wavelength(wavelength)
    double = execution.checked_precision(precision) != "single"
    execution.checked_engine(engine)
    allowed = checked_amplitude_tolerance(tolerance, double)
    flat = places.reshape(-1, 2)
    phase: complex = 1.0
    if isinstance(source, Wavefront):
        source, lens, phase = as_lens(source, length)
        system = system @ lens
    field, error, bounds = collins_field(
        source, radiator_of(source), flat, length, system, allowed, double, engine
    )
    field = field * phase
    warn_of_missed(error, bounds, "points", stacklevel=4)
    if squared:
        field, error = squared_field(field, error)
    elif not double:
        field = field.astype(np.complex64)
    shape = places.shape[:-1]
    values = field.reshape(shape)[()]
    return (values, error.reshape(shape)[()]) if return_error else values


def as_lens(wave: Wavefront, wavelength: float) -> tuple[Any, FirstOrder, complex]:
    """A curved wave as a flat source, a lens directly behind it, and a phase.

    (x - c).Q (x - c) = x.Q x - 2 x.Q c + c.Q c: the second is a tilt, the third the phase.
    """
    checked_wavefront(wave)
    q, slope = wavelength * wave.curvature, wave.curvature @ wave.centre
    lens = FirstOrder(np.block([[np.eye(2), np.zeros((2, 2))], [q, np.eye(2)]]))
    turns = float(wave.centre @ slope) / 2
    phase = complex(np.exp(2j * np.pi * (turns - round(turns))))
    return tilted_source(wave.source, -slope), lens, phase


def squared_field(field: Any, error: Any) -> tuple[Any, Any]:
    """|U|^2, and its error."""
    modulus = np.abs(field).astype(np.float64)
    return np.square(modulus), (2 * modulus + error) * error


def _checked_plane(points: Any) -> NDArray[np.float64]:
    """Points (..., 2) of the plane behind a system."""
    expected = "expected points as real numbers of shape (..., 2) with through="
    try:
        array = real_numbers(points)
    except ValueError as error:
        raise ArgumentError(f"{expected}, in metres, got {error}") from None
    if array.ndim == 0 or array.shape[-1] != 2:
        hint = "; z is the system's" if array.ndim and array.shape[-1] == 3 else ""
        raise ArgumentError(f"{expected}, x and y in the plane behind it, got {array.shape}{hint}")
    if not np.isfinite(array).all():
        raise ArgumentError("expected finite points, got inf or nan; leave such points out")
    return array
