"""Fields behind first-order systems and stops, (O4) to (O8)."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray

from polywigner import execution
from polywigner.errors import ArgumentError
from polywigner.execution import Engine
from polywigner.execution.progress import with_progress
from polywigner.geometry import Aperture, Wavefront, triangulate
from polywigner.geometry.arguments import check_most, checked_wavelength
from polywigner.numerics import Complex, Floats, index_blocks
from polywigner.numerics.chirps import waves_of_cycles
from polywigner.numerics.nodes import gauss_rule, node_count
from polywigner.optics import FirstOrder
from polywigner.propagation.boundary import FieldEstimate, Radiator, parabolic_field, radiator_of
from polywigner.propagation.point_grids import (
    checked_coordinates,
    tolerance_from,
    warn_of_missed,
)
from polywigner.source import Array
from polywigner.source.normal_form import normal_form
from polywigner.transforms import autocorrelation, fourier
from polywigner.transforms.traced_sources import check_no_drjit
from polywigner.transforms.wavefronts import checked_wavefront, chirp_transform

PublicSource = Aperture | Array

_ULP = 2.0**-52
# Relative difference below which curvatures count as equal, divided by the condition number of B.
_EQUAL = 8 * _ULP
# Rounding error of Fourier transforms and of the fields in images, relative to the integral of |u|.
_CLOSED = 1e-13
_IDENTITY = FirstOrder.magnifier(1.0)
# Numbers of additional nodes of the two quadrature rules whose difference is the error estimate.
_EXTRA = (8.0, 12.0)
_FINEST = 1e-13
# Largest number of pairs (node on a stop, point). About 1e9 pairs take a minute.
_MOST_WORK = 2e10
# Cost of the incident field at a node, in units of a complex exponential.
_NODE_COST = 1000
# Number of complex multiplications that take as long as a complex exponential.
_PRODUCTS = 50
# Largest ratio of lattice points to frequencies for which the lattice is used.
_SPARSE = 4
# Number of pairs (node, point) per block.
_BLOCK = 1 << 21


def collins_field(
    source: Any,
    points: Floats,
    wavelength: float,
    system: FirstOrder,
    tolerance: float,
    engine: Engine,
) -> FieldEstimate:
    """Compute the field at points (n, 2) in m behind a first-order system without stops (O4).

    The factor exp(ikL) of the axial path is omitted. ``tolerance`` is relative to the smaller of
    two bounds: the field if all parts of the source were in phase, and the field of geometrical
    optics. In an image plane, the allowed errors are infinite.
    """
    radiator = radiator_of(source)
    if _zero_scales(system).all():
        values, scale = _image(partial(_source_field, source), points, wavelength, system)
        errors = np.full(len(points), scale * _CLOSED * radiator.amplitude)
        return values, errors, np.full(len(points), math.inf)
    bend, slopes, out = _coefficients(system, points, wavelength)
    if not (abs(system.A) > system.rounding[:2, :2]).any():
        values = np.asarray(fourier(source, slopes / wavelength, engine=engine))
        errors = np.full(len(points), _CLOSED * radiator.content)
        allowed = tolerance * np.full(len(points), radiator.content)
    else:
        curvature, axes = np.linalg.eigh((bend + bend.T) / 2)
        mean = float(curvature.mean())
        spread = np.linalg.cond(system.B) * _EQUAL * abs(curvature).max()
        if abs(bend - mean * np.eye(2)).max() <= spread:
            values, errors, allowed = _by_fresnel(
                radiator, slopes, wavelength, mean, tolerance, engine
            )
        else:
            values = chirp_transform(
                source, curvature / wavelength, axes, np.zeros(2), slopes / wavelength
            )
            errors = _rounding(radiator, curvature, axes, slopes, wavelength)
            rays = wavelength * radiator.amplitude / math.sqrt(abs(curvature.prod()) or 1e-300)
            allowed = np.full(len(points), tolerance * min(radiator.content, rays))
    size = abs(out)
    return out * values, size * errors, size * allowed


def _zero_scales(system: FirstOrder) -> NDArray[np.bool_]:
    """Return which singular values (2,) of the matrix B are zero; both are zero for an image."""
    scale = np.linalg.svd(system.B, compute_uv=False)
    return np.asarray(scale <= np.linalg.norm(system.rounding[:2, 2:]))


def _coefficients(
    system: FirstOrder, points: Floats, wavelength: float
) -> tuple[Floats, Floats, Complex]:
    """Return M (2, 2), q (n, 2) and c (n,) of Collins' integral (O4) at points (n, 2).

    The integral is ``c int u(x) exp(i pi/wavelength x.(M x - 2 q)) dx``, without the factor
    exp(ikL) of the path along the axis.
    """
    inverse = np.linalg.inv(system.B)
    front = _root_phase(system.B) / (wavelength * math.sqrt(abs(np.linalg.det(system.B))))
    out = waves_of_cycles(_quadratic(system.D @ inverse, points, wavelength)) * front
    return inverse @ system.A, points @ inverse.T, out


def _quadratic(form: Floats, points: Floats, wavelength: float) -> Floats:
    """Return the phase ``y.(form y)/(2 wavelength)`` of points y (n, 2), in cycles."""
    return np.asarray(0.5 * ((points @ form.T) * points).sum(axis=1) / wavelength)


def _root_phase(matrix: Floats) -> complex:
    """Return the phase factor of Collins' integral (O4) for a matrix B.

    The factor is the product of 1/sqrt(±i) over the positive and negative eigenvalues.
    """
    if np.linalg.det(matrix) < 0:
        return 1.0
    return -1j if np.trace(matrix) >= 0 else 1j


def _rounding(
    radiator: Radiator, curvature: Floats, axes: Floats, slopes: Floats, wavelength: float
) -> Floats:
    """Return absolute errors (n,) of `chirp_transform` at the frequencies slopes/wavelength.

    ``curvature`` (2,) contains the eigenvalues of M in (O4) in 1/m, and ``axes`` (2, 2) the
    eigenvectors.
    """
    largest = float(abs(curvature).max())
    size = float(np.linalg.norm(radiator.high - radiator.low))
    along = radiator.amplitude * radiator.perimeter * min(math.sqrt(wavelength / largest), size)
    away = np.linalg.norm(slopes @ axes - curvature * (radiator.centre @ axes), axis=1)
    cycles = (away + largest * size) * (size / wavelength)
    return _ULP * along * (4.0 + cycles + size * radiator.highest_frequency)


def _by_fresnel(
    radiator: Radiator, slopes: Floats, wavelength: float, curvature: float,
    tolerance: float, engine: str,
) -> FieldEstimate:  # fmt: skip
    """Return the integral (O4), without the factor c, as a scaled Fresnel field.

    The curvatures along both axes must be equal. ``curvature`` is the common value in 1/m of both
    eigenvalues of M, and may be negative. ``slopes`` (n, 2) is q in (O4). The errors also omit the
    factor c.
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
            conjugate, -slopes, wavelength, -curvature, tolerance, engine
        )
        return values.conj(), errors, allowed
    scale = wavelength / curvature
    spread = np.full(len(slopes), scale)
    field, *bounds = parabolic_field(radiator, slopes / curvature, spread, tolerance, engine)
    centre = radiator.centre
    cycles = ((0.5 * curvature * centre - slopes) @ centre) / wavelength
    return 1j * scale * waves_of_cycles(cycles) * field, scale * bounds[0], scale * bounds[1]


def _image(
    field: Callable[[Floats], Complex], points: Floats, wavelength: float, system: FirstOrder
) -> tuple[Complex, float]:
    """Return the image of a field behind a system with B = 0, and its amplitude scale.

    ``field`` is a function of positions (n, 2) in the source plane. The image includes the scale.
    """
    inverse, scale = np.linalg.inv(system.A), 1 / math.sqrt(abs(np.linalg.det(system.A)))
    front = 1j * _root_phase(system.A) if np.linalg.det(system.A) > 0 else -1j
    waves = waves_of_cycles(_quadratic(system.C @ inverse, points, wavelength))
    return field(points @ inverse.T) * waves * (front * scale), scale


def _source_field(source: Any, x: Floats) -> NDArray[np.complex128]:
    """Return the field u (n,) at positions (n, 2) in the plane of a source.

    The field is 0 outside the source.
    """
    total = np.zeros(len(x), np.complex128)
    for element in normal_form(source).in_plane.elements:
        inside = autocorrelation(element.outline, x, (0.0, 0.0), engine="numpy")
        total += inside * element.weight * element.waves_at(x)
    return total


def field_behind(
    source: Any,
    points: Any,
    wavelength: Any,
    through: Any,
    tolerance: float | None,
    others: dict[str, Any],
    engine: Engine,
) -> tuple[Complex, Floats]:
    """Return the field at points (..., 2) in m behind first-order systems and stops, and its error.

    The factor exp(ikL) of the axial path is omitted. ``others`` are arguments that apply only to
    free space. Raises ArgumentError if any of the ``others`` is not None.
    """
    for name, value in others.items():
        if value is not None:
            raise ArgumentError(
                f"{name}={value!r} cannot be combined with through=; omit {name}, since the field "
                "behind a first-order system is always Collins' integral"
            )
    check_no_drjit(source=source, points=points, wavelength=wavelength)
    systems, stops = systems_and_stops(through)
    positions = checked_points_behind(points)
    length = checked_wavelength(wavelength)
    execution.checked_engine(engine)
    allowed = tolerance_from(tolerance)
    phase: complex = 1.0
    if isinstance(source, Wavefront):
        source, lens, phase = as_lens(source, length)
        systems[0] = systems[0] @ lens
    planes, systems = _clipped_planes([source, *stops], systems)
    field, error, bounds = _behind_stops(
        planes, systems, positions.reshape(-1, 2), length, allowed, engine
    )
    warn_of_missed(error, bounds, "points")
    shape = positions.shape[:-1]
    return (phase * field).reshape(shape)[()], error.reshape(shape)[()]


def checked_points_behind(points: Any) -> Floats:
    """Return points (..., 2) in m behind a system; raise ArgumentError for other values."""
    expected = (
        "with through=, expected points to be real numbers of shape (..., 2), since the system "
        "determines z"
    )
    return checked_coordinates(points, expected, 2)


def systems_and_stops(through: object) -> tuple[list[FirstOrder], list[PublicSource]]:
    """Return the n + 1 first-order systems of ``through``, and the n stops between them.

    Consecutive systems are multiplied. Raises ArgumentError if an element has another type.
    """
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
                "expected through to be a polywigner.FirstOrder, or a list of FirstOrder systems "
                "and stops (Aperture or Array) in the order in which the light passes them, got "
                f"an element of type {type(part).__name__}"
            )
    return systems, stops


def _clipped_planes(
    planes: list[PublicSource], systems: list[FirstOrder]
) -> tuple[list[PublicSource], list[FirstOrder]]:
    """Return new lists in which clipped sources replace stops in image planes.

    ``systems`` contains the system behind each source or stop in ``planes``.
    """
    remaining, paths = planes[:1], systems[:1]
    for stop, system in zip(planes[1:], systems[1:], strict=True):
        image = _zero_scales(paths[-1])
        if not image.any():
            remaining.append(stop)
            paths.append(system)
            continue
        if not image.all() or not isinstance(stop, Aperture) or stop.illumination is not None:
            raise ArgumentError(
                "a stop in an image of the source or of the previous stop must be an Aperture "
                "without a field, and the image must be sharp along both axes; move the stop"
            )
        back = np.linalg.inv(paths[-1].A)
        outline = Aperture(shapely.transform(stop.polygons, lambda x, m=back: x @ m.T))
        remaining[-1] = _clipped(remaining[-1], outline)
        paths[-1] = system @ paths[-1]
    image = _zero_scales(paths[-1])
    if image.any() and not image.all():
        raise ArgumentError(
            "the points lie in an image of the source or of a stop that is sharp along one axis "
            "only (astigmatic system); move the points along the optical axis"
        )
    return remaining, paths


def _clipped(plane: PublicSource, outline: Aperture) -> PublicSource:
    """Return the part of a source inside an outline; raise ArgumentError if it is empty."""
    elements = normal_form(plane).in_plane.elements
    parts = [
        (e.shape & outline, e.weight)
        for e in elements
        if (e.shape.polygons & outline.polygons).area > 0
    ]
    if not parts:
        raise ArgumentError(
            "the stop transmits no light: its opening does not overlap the image in its plane; "
            "move or enlarge the stop"
        )
    if isinstance(plane, Array):
        return Array([element for element, _ in parts], [weight for _, weight in parts])
    return parts[0][0]


def _behind_stops(
    planes: list[PublicSource],
    systems: list[FirstOrder],
    points: Floats,
    wavelength: float,
    tolerance: float,
    engine: Engine,
) -> FieldEstimate:
    """Compute the field at points (n, 2) behind stops, each followed by a system (O8).

    ``planes`` contains the source and then the stops. ``systems`` contains the system behind each
    of these planes.
    """
    *others, stop = planes
    *earlier_systems, system = systems
    if not others:
        return collins_field(stop, points, wavelength, system, tolerance, engine)

    def on_stop(nodes: Floats) -> FieldEstimate:
        """Return the incident field at nodes (m, 2) on the last stop, with its errors."""
        # The tolerance on the stop is smaller, because errors at its nodes may add up in phase.
        finer = max(0.1 * tolerance, _FINEST)
        return _behind_stops(others, earlier_systems, nodes, wavelength, finer, engine)

    if _zero_scales(system).all():
        _, *bounds = on_stop(points @ np.linalg.inv(system.A).T)
        image, scale = _image(
            lambda x: on_stop(x)[0] * _source_field(stop, x), points, wavelength, system
        )
        return image, bounds[0] * scale, bounds[1] * scale
    bend, slopes, out = _coefficients(system, points, wavelength)
    rate = _stop_rate(radiator_of(stop), others[-1], earlier_systems[-1], bend, slopes, wavelength)
    sums, lattice = [], FrequencyLattice(slopes / wavelength)
    for extra in _EXTRA:
        nodes, weights = _stop_rule(stop, rate, extra, lattice)
        there, error, _ = on_stop(nodes)
        waves = weights * there * waves_of_cycles(_quadratic(bend, nodes, wavelength))
        sums.append(lattice.fourier_sum(nodes, waves))
    size, areas = np.abs(out), np.abs(weights)
    off: Floats = np.abs(sums[1] - sums[0]) + areas @ error + _CLOSED * np.abs(sums[1])
    bound = float(areas.sum() * abs(there).max())
    return out * sums[1], size * off, size * (tolerance * bound)


def _stop_rate(
    stop: Radiator,
    previous: PublicSource,
    path: FirstOrder,
    bend: Floats,
    slopes: Floats,
    wavelength: float,
) -> float:
    """Return the highest spatial frequency [1/m] of Collins' integrand on a stop.

    ``path`` is the system in front of the stop. ``bend`` and ``slopes`` are M and q (n, 2) in (O4)
    of the system behind the stop.
    """
    inverse = np.linalg.inv(path.B)
    origin = radiator_of(previous)
    aside = slopes - (path.D @ inverse + bend) @ stop.centre + inverse.T @ origin.centre
    steepest = float(np.linalg.norm(aside, axis=1).max(initial=0.0))
    for form, radiator in ((path.D @ inverse + bend, stop), (inverse.T, origin)):
        diagonal = np.linalg.norm(radiator.high - radiator.low)
        steepest += float(np.linalg.norm(form, 2) * diagonal) / 2
    return steepest / wavelength + stop.highest_frequency


def _stop_rule(
    stop: Any, rate: float, extra: float, lattice: FrequencyLattice
) -> tuple[Floats, Complex]:
    """Return nodes (m, 2) in m on a stop, and quadrature weights (m,) times its transmission.

    Raises ArgumentError for too many pairs of a node and a point.
    """
    elements = normal_form(stop).in_plane.elements
    triangles = [corners[t] for corners, t in (triangulate(e.shape) for e in elements)]
    work = sum(node_count(part, rate, extra) for part in triangles) * lattice.work
    remedy = "use fewer points, points on a grid along x and y, or a smaller source or stop"
    check_most(work, _MOST_WORK, "pairs of a quadrature node on the stop and a point", remedy)
    rules = [gauss_rule(part, rate, extra)[:2] for part in triangles]
    fields = [a * e.weight * e.waves_at(x) for (x, a), e in zip(rules, elements, strict=True)]
    return np.concatenate([x for x, _ in rules]), np.concatenate(fields)


class FrequencyLattice:
    """Spatial frequencies (n, 2) of a Fourier sum over quadrature nodes.

    On a lattice, the complex exponentials are products of factors along x and y.
    """

    def __init__(self, nu: Floats) -> None:
        """Prepare sums for the frequencies nu (n, 2)."""
        axes = [np.unique(nu[:, k], return_inverse=True) for k in (0, 1)]
        self.axes = [values for values, _ in axes]
        self.index: tuple[NDArray[np.intp], ...] | None = tuple(index for _, index in axes)
        size = math.prod(map(len, self.axes))
        if size > _SPARSE * len(nu):
            self.axes, self.index, size = [*nu.T], None, len(nu) * _PRODUCTS
        self.work = _NODE_COST + sum(map(len, self.axes)) + size / _PRODUCTS
        """Cost of a node, in units of a complex exponential."""

    def fourier_sum(self, nodes: Floats, waves: Complex) -> Complex:
        """Return ``sum_k waves_k exp(-2 pi i nu.x_k)`` for all frequencies nu, shape (n,).

        ``nodes`` (m, 2) contains the positions x_k, and ``waves`` (m,) the weighted values at these
        positions.
        """
        total: Any = 0.0
        blocks = index_blocks(len(nodes), _BLOCK // max(1, sum(map(len, self.axes))))
        with with_progress("waves", blocks) as remaining:
            for block in remaining:
                first, second = (
                    waves_of_cycles(-np.outer(axis, x))
                    for axis, x in zip(self.axes, nodes[block].T, strict=True)
                )
                if self.index is None:
                    total = total + (first * second) @ waves[block]
                else:
                    total = total + (first * waves[block]) @ second.T
        return np.asarray(total if self.index is None else total[self.index])


def as_lens(wave: Wavefront, wavelength: float) -> tuple[PublicSource, FirstOrder, complex]:
    """Return a curved wave as a flat source, a lens behind it, and a phase factor.

    The phase of the wave is ``pi (x - c).Q (x - c)``, with the centre c and the curvature Q in
    1/m^2. The lens has the phase ``pi x.Q x``, the source is tilted by ``-2 pi x.Q c``, and the
    factor has the phase ``pi c.Q c``.
    """
    checked_wavefront(wave)
    q, slope = wavelength * wave.curvature, wave.curvature @ wave.centre
    lens = FirstOrder(np.block([[np.eye(2), np.zeros((2, 2))], [q, np.eye(2)]]))
    cycles = float(wave.centre @ slope) / 2
    phase = complex(np.exp(2j * np.pi * (cycles - round(cycles))))
    return normal_form(wave.source).tilted(-slope).public, lens, phase


def squared_field(field: Complex, error: Floats) -> tuple[Floats, Floats]:
    """Return the squared modulus of a complex field, and its error.

    ``error`` is an upper bound on the modulus of the error of the field.
    """
    modulus = np.abs(field).astype(np.float64)
    return np.square(modulus), (2 * modulus + error) * error
