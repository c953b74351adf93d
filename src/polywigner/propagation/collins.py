"""Fields behind first-order systems and stops, and in images of points. Source: (O4) to (O8)."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
import shapely
from numpy.typing import ArrayLike, NDArray

from polywigner import execution
from polywigner.errors import ArgumentError
from polywigner.execution import Engine, Precision
from polywigner.execution.progress import with_progress
from polywigner.geometry import Aperture, Wavefront, triangulate
from polywigner.geometry.arguments import (
    Points,
    checked_length,
    checked_row,
    checked_wavelength,
)
from polywigner.numerics.chirps import chirp_integral, waves_of_turns
from polywigner.optics import FirstOrder
from polywigner.propagation.boundary import (
    FieldEstimate,
    Radiator,
    parabolic_field,
    radiator_of,
)
from polywigner.propagation.point_grids import (
    checked_amplitude_tolerance,
    checked_coordinates,
    warn_of_missed,
)
from polywigner.propagation.quadrature import gauss_rule, node_count
from polywigner.radiometry.directions import checked_radiator
from polywigner.source import Array
from polywigner.source.normal_form import SourceElement, normal_form
from polywigner.transforms import autocorrelation, fourier, pupil
from polywigner.transforms.traced_sources import check_no_drjit
from polywigner.transforms.wavefronts import checked_wavefront, chirp_transform
from polywigner.transforms.xarray_arguments import takes_xarray

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
    """Integral (n,) over x_1 alone at ``x2`` (n,), with q_1 = ``slope`` (n,), in m of the field."""
    values = np.zeros(len(x2), np.complex128)
    curvature, wavelength = float(chirp.curvature[0]), chirp.wavelength
    for element in radiator.elements:
        edges, centre = _edges_of(element.outline, chirp.axes)
        for shift, weight in zip(element.shifts @ chirp.axes, element.weights, strict=True):
            origin, across = shift + centre, x2 - shift[1] - centre[1]
            inner = slope - curvature * origin[0]
            turns = origin[0] * (0.5 * curvature * origin[0] - slope) / wavelength
            for amplitude, kappa in zip(element.amplitudes, element.frequencies, strict=True):
                wave = kappa @ chirp.axes
                total = np.zeros(len(x2), np.complex128)
                for (x, y), (ex, ey) in edges.tolist():
                    above, below = (y + ey > across), (y > across)
                    some = np.flatnonzero(above != below)
                    at = x + ex * ((across[some] - y) / (ey or 1.0))
                    frequency = inner[some] / wavelength - wave[0]
                    part = chirp_integral(at, curvature / wavelength, frequency)
                    total[some] += math.copysign(1.0, ey) * part
                phase = turns + wave[0] * centre[0] + wave[1] * (across + centre[1])
                values += weight * amplitude * total * waves_of_turns(phase)
    return values


def _edges_of(outline: Aperture, axes: Floats) -> tuple[Floats, Floats]:
    """First ends, relative to the centre of the box, and extents of edges (m, 2, 2); the centre."""
    rings = [ring @ axes for ring in outline.rings]
    begin = np.concatenate(rings)
    extent = np.concatenate([np.roll(ring, -1, axis=0) for ring in rings]) - begin
    centre = begin.min(axis=0) / 2 + begin.max(axis=0) / 2
    return np.stack([begin - centre, extent], axis=1), centre


PublicSource = Aperture | Array

# Curvatures that differ by less are equal, relative to their rounding errors.
_EQUAL = 8 * 2.0**-52
# Errors of closed forms in double and in single precision, relative to the content.
_CLOSED = {True: 1e-13, False: 2e-6}
_ULP = 2.0**-52
_IDENTITY = FirstOrder.magnifier(1.0)
# Nodes of the two rules on a stop along a line without waves; their difference is the error.
_EXTRA = (8.0, 12.0)
# Smallest tolerance of fields on a stop.
_FINEST = 1e-13
# Largest number of waves from nodes to points, about 1e9 a minute; a node costs as many as _FEW.
_MOST_WORK, _FEW = 2e10, 1000
# Products of two waves that cost as much as one wave; lattice points per point up to which a
# lattice is used.
_PRODUCTS, _SPARSE = 50, 4
_BLOCK = 1 << 21


def collins_field(
    source: Any,
    radiator: Radiator,
    points: Floats,
    wavelength: float,
    system: FirstOrder,
    tolerance: float,
    double: bool,
    engine: Engine,
) -> FieldEstimate:
    """Compute the field at points (n, 2).

    ``tolerance``: allowed error as a fraction of the field of an image or, if that is less, of the
    bound on the field of the entire source.
    """
    left, scale, right = np.linalg.svd(system.B)
    is_image = _without_spread(system)
    if is_image.all():
        return _image(partial(_field_at, source), radiator.amplitude, points, wavelength, system,
                      double)  # fmt: skip
    if is_image[1]:
        return _line_image(radiator, points, wavelength, system, left, float(scale[0]), right)
    bend, slopes, out = _waves_of(system, points, wavelength)
    if not (abs(system.A) > system.rounding[:2, :2]).any():
        precision: Precision = None if double else "single"
        spectrum = fourier(source, slopes / wavelength, precision=precision, engine=engine)
        values = np.asarray(spectrum)
        errors = np.full(len(points), _CLOSED[double] * radiator.content)
        allowed = tolerance * np.full(len(points), radiator.content)
    else:
        curvature, axes = np.linalg.eigh((bend + bend.T) / 2)
        mean = float(curvature.mean())
        spread = np.linalg.cond(system.B) * _EQUAL * abs(curvature).max()
        if abs(bend - mean * np.eye(2)).max() <= spread:
            values, errors, allowed = _by_fresnel(
                radiator, slopes, wavelength, mean, tolerance, double, engine
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
    size = abs(out)
    return out * values, size * errors, size * allowed


def _without_spread(system: FirstOrder) -> NDArray[np.bool_]:
    """(2,) whether B is zero along its axes of the largest and of the smallest spread."""
    scale = np.linalg.svd(system.B, compute_uv=False)
    return np.asarray(scale <= np.linalg.norm(system.rounding[:2, 2:]))


def _waves_of(
    system: FirstOrder, points: Floats, wavelength: float
) -> tuple[Floats, Floats, Complex]:
    """M (2, 2), q (n, 2), c (n,) of Collins' integral c int u exp(i pi/lambda x.(M x - 2 q))."""
    inverse = np.linalg.inv(system.B)
    front = _front(system.B) / (wavelength * math.sqrt(abs(np.linalg.det(system.B))))
    out = waves_of_turns(_turns(system.D @ inverse, points, wavelength)) * front
    return inverse @ system.A, points @ inverse.T, out


def _turns(form: Floats, points: Floats, wavelength: float) -> Floats:
    """Half of y^T form y, in wavelengths."""
    return np.asarray(0.5 * ((points @ form.T) * points).sum(axis=1) / wavelength)


def _front(matrix: Floats) -> complex:
    """1/sqrt(i) for each axis, 1/sqrt(-i) for one along which a matrix is negative."""
    if np.linalg.det(matrix) < 0:
        return 1.0
    return -1j if np.trace(matrix) >= 0 else 1j


def _brightest(radiator: Radiator, chirp: Chirp) -> float:
    """Return the integral of the source in phase, or of its image by rays if that is less."""
    s1, s2 = abs(chirp.curvature)
    area = math.sqrt(s1 * s2) * radiator.content
    rays = chirp.wavelength * radiator.amplitude
    return rays / math.sqrt(s1 * s2) if area > rays else radiator.content


def _rounding(radiator: Radiator, chirp: Chirp, slopes: Floats) -> Floats:
    """Rounding errors (n,) of the integral along edges, which stem from the phases."""
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
) -> FieldEstimate:  # fmt: skip
    """Integral with the same curvature along both axes: a Fresnel field at z = 1/curvature."""
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
    scale = wavelength / curvature
    spread = np.full(len(slopes), scale)
    field, *bounds = parabolic_field(
        radiator, slopes / curvature, spread, tolerance, double, engine
    )
    centre = radiator.centre
    turns = ((0.5 * curvature * centre - slopes) @ centre) / wavelength
    return 1j * scale * waves_of_turns(turns) * field, scale * bounds[0], scale * bounds[1]


def _image(
    field: Callable[[Floats], Complex], largest: float, points: Floats, wavelength: float,
    system: FirstOrder, double: bool,
) -> FieldEstimate:  # fmt: skip
    """B = 0: a field of x (n, 2), magnified, with the phase of a lens."""
    inverse = np.linalg.inv(system.A)
    front = 1j * _front(system.A) if np.linalg.det(system.A) > 0 else -1j
    front = front / math.sqrt(abs(np.linalg.det(system.A)))
    values = field(points @ inverse.T)
    values = values * waves_of_turns(_turns(system.C @ inverse, points, wavelength)) * front
    errors = np.full(len(points), abs(front) * _CLOSED[double] * largest)
    return values, errors, np.full(len(points), math.inf)


def _field_at(source: Any, x: Floats) -> NDArray[np.complex128]:
    """Return u; points on the boundary count as in :func:`autocorrelation`."""
    total = np.zeros(len(x), np.complex128)
    for element in normal_form(source).in_plane.elements:
        inside = autocorrelation(element.outline, x, (0.0, 0.0), engine="numpy")
        total += inside * _element_field(element, x)
    return total


def _element_field(element: SourceElement, x: Floats) -> Complex:
    """The waves of an element at x (n, 2), times its weight."""
    waves = np.exp(2j * np.pi * (x @ element.frequencies.T))
    return np.asarray(element.weight * (waves @ element.amplitudes))


def _line_image(
    radiator: Radiator, points: Floats, wavelength: float, system: FirstOrder,
    left: Floats, b: float, right: Floats,
) -> FieldEstimate:  # fmt: skip
    """B of rank 1: an image along one axis, Collins' integral along the other."""
    # B = left diag(b, 0) right, with the rotations nearest to each other
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
    bend = (c[1, 1] - d[1, 0] * a[0, 1] / b) / size
    turns = ((0.5 * d[0, 0] * y1 + d[1, 0] * y2) * y1 / b + 0.5 * bend * y2 * y2) / wavelength
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
) -> Complex | Floats | tuple[Complex | Floats, Floats]:
    """Compute the amplitude at points (..., 2) behind a system, with ``return_error`` its error.

    ``others``: arguments for fields in free space; ArgumentError if one is not None.
    ``squared``: return the irradiance instead.
    """
    for name, value in others.items():
        if value is not None:
            raise ArgumentError(
                f"expected no {name} with through=, got {value!r}; the field behind a first-order "
                "system is Collins' integral"
            )
    check_no_drjit(source=source, points=points, wavelength=wavelength)
    systems, stops = systems_and_stops(through)
    positions = checked_points_behind(points)
    length = checked_wavelength(wavelength)
    double = execution.checked_precision(precision) != "single"
    execution.checked_engine(engine)
    allowed = checked_amplitude_tolerance(tolerance, double)
    flat = positions.reshape(-1, 2)
    phase: complex = 1.0
    if isinstance(source, Wavefront):
        source, lens, phase = as_lens(source, length)
        systems[0] = systems[0] @ lens
    source, systems, stops = _folded(source, systems, stops)
    how = {"tolerance": allowed, "double": double, "engine": engine}
    field, error, bounds = _behind(source, systems, stops, flat, length, **how)
    field = field * phase
    warn_of_missed(error, bounds, "points")
    result: Any = field
    if squared:
        result, error = squared_field(field, error)
    elif not double:
        result = field.astype(np.complex64)
    shape = positions.shape[:-1]
    values = result.reshape(shape)[()]
    return (values, error.reshape(shape)[()]) if return_error else values


def checked_points_behind(points: Any) -> Floats:
    """Return points (..., 2) behind a system; raise ArgumentError for others."""
    expected = "expected points as real numbers of shape (..., 2) with through=; z is the system's"
    return checked_coordinates(points, expected, 2)


def systems_and_stops(through: object) -> tuple[list[FirstOrder], list[PublicSource]]:
    """Return systems, and the stops between them, one fewer; raise ArgumentError for others."""
    systems: list[FirstOrder] = [_IDENTITY]
    stops: list[PublicSource] = []
    for part in through if isinstance(through, list | tuple) else [through]:
        if isinstance(part, Aperture) or (isinstance(part, Array) and part.dimension == 2):
            stops.append(part)
            systems.append(_IDENTITY)
        elif isinstance(part, FirstOrder):
            systems[-1] = part @ systems[-1]
        else:
            raise ArgumentError(
                "expected through as a polywigner.FirstOrder, or a list of these and of stops "
                f"(Aperture or Array) in the order of the light, got {type(part).__name__}"
            )
    return systems, stops


def _folded(
    source: PublicSource, systems: list[FirstOrder], stops: list[PublicSource]
) -> tuple[PublicSource, list[FirstOrder], list[PublicSource]]:
    """Cut the source, or the previous stop, by the stops that lie in an image of it."""
    planes, paths = [source], systems[:1]
    for stop, system in zip(stops, systems[1:], strict=True):
        image = _without_spread(paths[-1])
        if not image.any():
            planes.append(stop)
            paths.append(system)
            continue
        if not image.all() or not isinstance(stop, Aperture) or stop.illumination is not None:
            raise ArgumentError(
                "stops in an image of the source or of the previous stop must be Apertures without "
                "a field, in an image along both axes; move the stop"
            )
        back = np.linalg.inv(paths[-1].A)
        outline = Aperture(shapely.transform(stop.polygons, lambda x, m=back: x @ m.T))
        planes[-1] = _cut(planes[-1], outline)
        paths[-1] = system @ paths[-1]
    image = _without_spread(paths[-1])
    if len(planes) > 1 and image.any() and not image.all():
        raise ArgumentError(
            "points lie in an image of a stop along one axis only, behind an astigmatic system; "
            "move the points"
        )
    return planes[0], paths, planes[1:]


def _cut(plane: PublicSource, outline: Aperture) -> PublicSource:
    """Return the part of a source or stop within an outline."""
    elements = normal_form(plane).in_plane.elements
    parts = [
        (e.shape & outline, e.weight)
        for e in elements
        if (e.shape.polygons & outline.polygons).area > 0
    ]
    if not parts:
        raise ArgumentError(
            "the stop transmits nothing: its opening does not overlap the image in its plane; move "
            "the stop"
        )
    if isinstance(plane, Array):
        return Array([element for element, _ in parts], [weight for _, weight in parts])
    return parts[0][0]


def _behind(
    source: Any, systems: list[FirstOrder], stops: list[Any], points: Floats, wavelength: float,
    **how: Any,
) -> FieldEstimate:  # fmt: skip
    """:func:`collins_field` behind all systems and stops (O8).

    The integral over the last stop is a Gauss rule. It resolves the fastest oscillation that
    radiation from the previous plane can have there.
    """
    *before, system = systems
    if not stops:
        return collins_field(source, radiator_of(source), points, wavelength, system, **how)
    *others, stop = stops
    # errors on the stop add up in phase in the worst case
    finer = {**how, "tolerance": max(0.1 * how["tolerance"], _FINEST), "double": True}
    inner = partial(_behind, source, before, others, wavelength=wavelength, **finer)
    if _without_spread(system).all():
        image = _image(lambda x: inner(points=x)[0] * _field_at(stop, x), 0.0, points, wavelength,
                       system, how["double"])  # fmt: skip
        _, *bounds = inner(points=points @ np.linalg.inv(system.A).T)
        scale = math.sqrt(abs(np.linalg.det(system.A)))
        return image[0], bounds[0] / scale, bounds[1] / scale
    radiator = radiator_of(stop)
    bend, slopes, out = _waves_of(system, points, wavelength)
    rate = _rate(radiator, others[-1] if others else source, before[-1], bend, slopes, wavelength)
    sums, lattice = [], _Lattice(slopes / wavelength)
    for extra in _EXTRA:
        nodes, weights = _rule(stop, rate, extra, lattice)
        there, error, _ = inner(points=nodes)
        waves = weights * there * waves_of_turns(_turns(bend, nodes, wavelength))
        sums.append(lattice.summed(nodes, waves))
    size, passed = np.abs(out), np.abs(weights)
    off: Floats = (
        np.abs(sums[1] - sums[0]) + passed @ error + _CLOSED[how["double"]] * np.abs(sums[1])
    )
    most = float(passed.sum() * abs(there).max())  # bound on the field of the stop
    return out * sums[1], size * off, size * (how["tolerance"] * most)


def _rate(
    stop: Radiator,
    previous: PublicSource,
    path: FirstOrder,
    bend: Floats,
    slopes: Floats,
    wavelength: float,
) -> float:
    """Largest frequency [1/m] of the field on a stop times the waves to all points."""
    inverse = np.linalg.inv(path.B)
    origin = radiator_of(previous)
    aside = slopes - (path.D @ inverse + bend) @ stop.centre + inverse.T @ origin.centre
    most = float(np.linalg.norm(aside, axis=1).max(initial=0.0))
    for form, radiator in ((path.D @ inverse + bend, stop), (inverse.T, origin)):
        most += float(np.linalg.norm(form, 2) * np.linalg.norm(radiator.high - radiator.low)) / 2
    return most / wavelength + stop.highest_frequency


def _rule(stop: Any, rate: float, extra: float, lattice: _Lattice) -> tuple[Floats, Complex]:
    """Return nodes (m, 2) on a stop, and weights (m,) times its transmission."""
    elements = normal_form(stop).in_plane.elements
    triangles = [corners[t] for corners, t in (triangulate(e.shape) for e in elements)]
    work = sum(node_count(part, rate, extra) for part in triangles) * lattice.work
    if not work <= _MOST_WORK:
        raise ArgumentError(
            f"the stop requires {work:.1e} waves from its nodes to the points, at most "
            f"{_MOST_WORK:.0e}; use fewer points, on a grid along x and y, or a smaller source or "
            "stop"
        )
    rules = [gauss_rule(part, rate, extra) for part in triangles]
    fields = [a * _element_field(e, x) for (x, a), e in zip(rules, elements, strict=True)]
    return np.concatenate([x for x, _ in rules]), np.concatenate(fields)


class _Lattice:
    """Frequencies (n, 2), factorised by axes if the points lie on a grid."""

    def __init__(self, nu: Floats) -> None:
        axes = [np.unique(nu[:, k], return_inverse=True) for k in (0, 1)]
        self.axes = [values for values, _ in axes]
        self.index: tuple[NDArray[np.intp], ...] | None = tuple(index for _, index in axes)
        size = math.prod(map(len, self.axes))
        if size > _SPARSE * len(nu):
            self.axes, self.index, size = [*nu.T], None, len(nu) * _PRODUCTS
        self.work = _FEW + sum(map(len, self.axes)) + size / _PRODUCTS

    def summed(self, nodes: Floats, waves: Complex) -> Complex:
        """Sums (n,) of waves (m,) at nodes (m, 2) times exp(-2 pi i nu.x)."""
        total: Any = 0.0
        rows = max(1, _BLOCK // max(1, sum(map(len, self.axes))))
        with with_progress("waves", range(0, len(nodes), rows)) as starts:
            for start in starts:
                some = slice(start, start + rows)
                first, second = (
                    waves_of_turns(-np.outer(axis, x))
                    for axis, x in zip(self.axes, nodes[some].T, strict=True)
                )
                if self.index is None:
                    total = total + (first * second) @ waves[some]
                else:
                    total = total + (first * waves[some]) @ second.T
        return np.asarray(total if self.index is None else total[self.index])


def as_lens(wave: Wavefront, wavelength: float) -> tuple[PublicSource, FirstOrder, complex]:
    """Return a curved wave as a flat source, a lens directly behind it, and a phase.

    (x - c).Q (x - c) = x.Q x - 2 x.Q c + c.Q c: the second is a tilt, the third the phase.
    """
    checked_wavefront(wave)
    q, slope = wavelength * wave.curvature, wave.curvature @ wave.centre
    lens = FirstOrder(np.block([[np.eye(2), np.zeros((2, 2))], [q, np.eye(2)]]))
    turns = float(wave.centre @ slope) / 2
    phase = complex(np.exp(2j * np.pi * (turns - round(turns))))
    return normal_form(wave.source).tilted(-slope).public, lens, phase


def squared_field(field: Complex, error: Floats) -> tuple[Floats, Floats]:
    """Return |U|^2 and its error."""
    modulus = np.abs(field).astype(np.float64)
    return np.square(modulus), (2 * modulus + error) * error


@takes_xarray("points", units="m-2", long_name="point spread function")
def psf(
    source: Aperture | Array,
    points: Points,
    wavelength: ArrayLike,
    focal_length: float,
    defocus: float = 0.0,
    pupil_radius: float | None = None,
    *,
    weights: ArrayLike | None = None,
    precision: Precision = None,
    engine: Engine = "auto",
) -> Floats:
    """Compute the point spread function of a lens with a pupil of this shape.

    This is the irradiance in the focal plane of a lens from a star on the axis, per m^2 and per
    power of the star. Its integral over the plane is 1, its Fourier transform is :func:`otf`. For
    several wavelengths it is the mean, as a detector of all of them measures. For other
    first-order systems use :func:`irradiance` with ``through``.

    Parameters
    ----------
    source : Aperture or Array
        Field in the pupil, in the plane z = 0; the axis passes through the origin.
    points : array_like, shape (..., 2)
        Points in the image in m.
    wavelength : float or array_like, shape (k,)
        Wavelength in m, or wavelengths of a polychromatic source.
    focal_length : float
        Focal length, or distance of the image from the pupil, in m.
    defocus : float, default 0
        Wavefront aberration W20 at ``pupil_radius``, in waves of the mean wavelength; the
        aberration in m is the same at all wavelengths.
    pupil_radius : float, optional
        See :func:`otf`.
    weights : array_like, shape (k,), optional
        Weights of the wavelengths, at least 0; equal by default.
    precision, engine
        See :func:`fourier`.

    Returns
    -------
    ndarray of float64, shape (...)
        Values in 1/m^2, at least 0. An ``xarray.DataArray`` of points gives a DataArray.

    Raises
    ------
    ArgumentError
        For arguments of the wrong type, shape or range.
    IlluminationError
        If the fields of an Array cancel everywhere.
    GeometryError
        If elements of an Array do not lie in the plane z = 0.
    EngineError
        If the engine is not available.

    Examples
    --------
    >>> import polywigner as pw
    >>> pupil = pw.shapes.square(10e-3)
    >>> peak = pw.psf(pupil, (0.0, 0.0), 0.5e-6, 0.1)  # area/(lambda f)^2
    >>> round(float(peak * (0.5e-6 * 0.1) ** 2 / 1e-4), 12)
    1.0
    """
    checked_radiator(source)
    lengths = checked_row(wavelength, "expected a wavelength in m or (k,) of them")
    for length in lengths.tolist():
        checked_length(length, "wavelength")
    distance = checked_length(focal_length, "focal_length")
    system = FirstOrder.fourier(distance)
    fractions = pupil.fractions_of(weights, lengths.size)
    radius = pupil.checked_pupil_radius(source, pupil_radius)
    # exp(2 pi i w |x|^2/a^2) is a lens of power -2 w lambda/a^2, the same for all wavelengths
    bend = 2.0 * pupil.checked_waves(defocus) * float(fractions @ lengths) / radius / radius
    if bend:
        system = system @ FirstOrder([[1.0, 0.0], [bend, 1.0]])
    total: Any = 0.0
    for fraction, length in zip(fractions.tolist(), lengths.tolist(), strict=True):
        total = total + fraction * field_behind(
            source.at_wavelength(length), points, length, system, None, {},
            squared=True, precision=precision, engine=engine,
        )  # fmt: skip
    return np.asarray(total / pupil.checked_energy(source))[()]
