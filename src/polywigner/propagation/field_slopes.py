"""Derivatives of exact and of Fresnel fields as integrals along edges. Source: (G5) to (G7)."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polywigner import execution
from polywigner.errors import ArgumentError
from polywigner.execution.choice import resolved
from polywigner.execution.points import Parameters
from polywigner.geometry import Aperture
from polywigner.geometry.arguments import checked_wavelength
from polywigner.geometry.silhouettes import Obstacles, obstacles_of
from polywigner.illumination import Array, Illumination
from polywigner.illumination.obliquities import OBLIQUITIES
from polywigner.kernels.boundary.integrals import (
    FRESNEL_STRIPS,
    STRIPS,
    distance_of,
    paraxial_distance,
    point_in_wavelengths,
)
from polywigner.numerics import phases
from polywigner.propagation import shadows
from polywigner.propagation.boundary import (
    Radiator,
    boundary_field,
    cosines_of,
    pieces_of,
    radiator_of,
    reaches,
    starts,
    strata_of,
)
from polywigner.propagation.places import checked_method
from polywigner.propagation.screens import PointSource, Screen, incident_of_point
from polywigner.radiometry.directions import checked_source
from polywigner.transforms import Differentiable
from polywigner.transforms.traced_sources import parameters_of

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]

_OPS = execution.NumpyOperations(double=True)
# Pairs of a point and a panel at a time.
_PAIRS = 1 << 17
# One costs about as much as so many terms of other kernels, for the choice of an engine.
_TERMS = 16
# Tolerance of integrals along edges over that of the field, since they may cancel.
_SHARE = 1e-2


@dataclass(frozen=True)
class _Strips:
    """Panels times waves (m,), lengths in wavelengths."""

    begin: Floats
    """(m, 2), relative to the centre."""
    along: Floats
    """(m, 2)."""
    length: Floats
    plane: Floats
    """p_x and p_y, (m, 2)."""
    cosine: Complex
    """p_z."""
    start: Floats
    amplitude: Complex
    first: NDArray[np.intp]
    """Number of the vertex at which the panel's edge begins; where it ends."""
    last: NDArray[np.intp]
    share: Floats
    """Share of the edge before the panel, and (``rate``) in a wavelength of it."""
    rate: Floats

    @property
    def normal(self) -> Floats:
        """Outward, (m, 2)."""
        return np.stack([self.along[:, 1], -self.along[:, 0]], axis=1)


@dataclass(frozen=True)
class EdgeSums:
    """Integrals of u times functions of R along panels (m,), seen from points (n,): (n, m) each.

    Lengths in wavelengths, G = exp(2 pi i R)/R.
    """

    where: NDArray[np.intp]
    """Numbers of the points (n,)."""
    places: Floats
    """These points (n, 3), from the centre of the source."""
    strips: _Strips
    wave: Complex
    """Integrals of u G; ``wave_by_length``: of t u G, t the length from the panel's beginning."""
    wave_by_length: Complex
    rise: Complex
    """Integrals of h = u (1/R - 2 pi i) G/R, zero for Fresnel; ``rise_by_length``: of t h."""
    rise_by_length: Complex


@dataclass(frozen=True)
class _Sums:
    """Integrals along panels (m,) seen from points ``where`` (n,): arrays (n, m)."""

    where: NDArray[np.intp]
    strips: _Strips
    kernel: Complex
    """Integral of amplitude times u times the field's kernel K; ``by_length``: of t times that."""
    by_length: Complex
    height: Complex
    """Integral of the edges' part of the derivative in z."""


@dataclass(frozen=True, eq=False)
class FieldSlopes:
    """Derivatives of the field of a source by one method, in points, vertices and fields."""

    source: Aperture | Array
    wavelength: float
    method: str
    tolerance: float
    by_waves: bool
    """Whether ``of_fields`` is of amplitudes of waves, instead of weights of elements."""

    @cached_property
    def _radiator(self) -> Radiator:
        return radiator_of(self.source)

    @property
    def _paraxial(self) -> bool:
        return self.method == "fresnel"

    def of_points(self, points: Floats) -> Complex:
        """dU/d(x, y, z) at points (n, 3), (n, 3): (G6)."""
        return self.reverse(points, np.zeros(len(points), np.complex128), True, False)[0]

    def forward(self, points: Floats, change: Floats) -> Complex:
        """Along a change (v, 2) of the vertices, (n,): (G5)."""
        found = np.zeros(len(points), np.complex128)
        for sums in map(self._combined, self.edge_sums(points)):
            strips = sums.strips
            begin, end = (
                (strips.normal * change[k]).sum(axis=1) for k in (strips.first, strips.last)
            )
            rate = strips.rate * (end - begin)
            constant = begin + strips.share * (end - begin)
            found[sums.where] += (sums.kernel @ constant + sums.by_length @ rate) / self.wavelength
        return found

    def reverse(
        self, points: Floats, cotangent: Complex, of_points: bool, of_vertices: bool
    ) -> tuple[Complex, Floats]:
        """:meth:`of_points`, and sum_j Re(cotangent_j* dU_j/d vertex), (v, 2); those wanted."""
        slopes = np.zeros((len(points), 3), np.complex128)
        vertices = np.zeros((sum(len(_next_vertices(e)) for e in self.source.elements_in_plane), 2))
        for axis in range(3) if of_points else ():
            slopes[:, axis] = self._carried(points, axis)
        wanted = self.edge_sums(points) if of_points or of_vertices else ()
        for sums in map(self._combined, wanted):
            if of_points:
                edges = sums.kernel @ sums.strips.normal
                slopes[sums.where, :2] -= edges / self.wavelength
                slopes[sums.where, 2] += sums.height.sum(axis=1) / self.wavelength
            if of_vertices:  # at both ends of the edges of panels
                strips, weight = sums.strips, cotangent[sums.where].conj() / self.wavelength
                whole, by_length = (weight @ sums.kernel).real, (weight @ sums.by_length).real
                at_end = strips.share * whole + strips.rate * by_length
                for number, value in ((strips.first, whole - at_end), (strips.last, at_end)):
                    np.add.at(vertices, number, value[:, None] * strips.normal)
        return slopes, vertices

    def of_fields(self, points: Floats) -> Complex:
        """The fields of single elements or waves, (n, k)."""
        columns = [
            self._field(radiator_of(part), points) for part in parts_of(self.source, self.by_waves)
        ]
        return np.stack(columns, axis=1)

    def _field(self, radiator: Radiator, points: Floats, method: str | None = None) -> Complex:
        name = method or self.method
        how = (self.wavelength, name, self.tolerance, True, "auto")
        return boundary_field(radiator, points, *how)[0]

    def _carried(self, points: Floats, axis: int) -> Complex | float:
        """The field of waves that are each multiplied by 2 pi i times their rate along an axis."""
        elements = []
        for element in self._radiator.elements:
            if axis < 2:
                rates = element.frequencies[:, axis].astype(np.complex128)
            else:
                cosines = cosines_of(element.frequencies, self.wavelength, self._paraxial)
                rates = cosines / self.wavelength
            amplitudes = element.amplitudes * (2j * math.pi * rates)
            elements.append(replace(element, amplitudes=amplitudes))
        if not any(element.amplitudes.any() for element in elements):
            return 0.0
        radiator = replace(self._radiator, elements=tuple(elements))
        other = {"rayleigh-sommerfeld-1": "rayleigh-sommerfeld-2"}
        other |= {second: first for first, second in other.items()}
        return self._field(radiator, points, other.get(self.method) if axis == 2 else None)

    def edge_sums(self, points: Floats) -> Iterator[EdgeSums]:
        """Integrals along all panels, for blocks of points (n, 3) in m."""
        digits = -math.log(max(self.tolerance * _SHARE, 1e-14))
        x, y = self._radiator.centre.tolist()
        entered = point_in_wavelengths(_OPS, (x, y), self.wavelength, *points.T)
        places = np.stack([high for high, _ in entered], axis=1)
        turns = phases.reduced(
            _OPS, (paraxial_distance if self._paraxial else distance_of)(_OPS, entered)
        )
        waves = np.exp(2j * math.pi * turns)[:, None]
        for where, longest in strata_of(self._radiator, points, self.wavelength, self._paraxial):
            strips = self._strips(longest)
            step = max(1, _PAIRS // len(strips.length))
            for k in range(0, len(where), step):
                mine = where[k : k + step]
                yield self._block(places[mine], waves[mine], mine, strips, digits)

    def _block(
        self,
        places: Floats,
        waves: Complex,
        where: NDArray[np.intp],
        strips: _Strips,
        digits: float,
    ) -> EdgeSums:
        along = (strips.plane * strips.along).sum(axis=1)
        rows = [column[:, None] for column in places.T]
        columns = (*strips.begin.T, *strips.along.T, strips.length, along, strips.start)
        pairs = [*rows, *(column[None] for column in columns), np.full((1, 1), digits)]
        sums = execution.evaluate(
            FRESNEL_STRIPS if self._paraxial else STRIPS,
            None,
            pairs,
            double=True,
            engine=resolved("auto", len(places) * len(along), _TERMS),
            outputs=4 if self._paraxial else 8,
        )
        found = [
            (a + 1j * b) * strips.amplitude * waves
            for a, b in zip(sums[::2], sums[1::2], strict=True)
        ]
        found += [np.zeros_like(found[0])] * (4 - len(found))
        return EdgeSums(where, places, strips, *found)

    def _combined(self, sums: EdgeSums) -> _Sums:
        """Integrals of the field's kernel from integrals with u G and u (1/R - 2 pi i) G/R."""
        strips, places = sums.strips, sums.places
        left = -strips.normal
        away = (strips.begin * left).sum(axis=1) - places[:, :2] @ left.T
        across = (strips.plane * left).sum(axis=1)
        z = places[:, 2:]
        if self._paraxial:
            kernel, by_length = (value / (1j * z) for value in (sums.wave, sums.wave_by_length))
            height = -0.5 * (across - away / z) * kernel
            return _Sums(sums.where, strips, kernel, by_length, height)
        condition = OBLIQUITIES[self.method]
        of_field = condition.field / (2 * math.pi)
        first, second = of_field * z, -1j * condition.slope * strips.cosine
        height = away * sums.rise + 2j * math.pi * across * sums.wave
        return _Sums(
            sums.where,
            strips,
            first * sums.rise + second * sums.wave,
            first * sums.rise_by_length + second * sums.wave_by_length,
            of_field * height,
        )

    def _strips(self, longest: float) -> _Strips:
        elements = self.source.elements_in_plane
        weights = np.ones(1) if isinstance(self.source, Aperture) else self.source.weights
        found: list[tuple[NDArray[Any], ...]] = []
        count = 0
        for element, weight in zip(elements, weights.tolist(), strict=True):
            found += self._strips_of(element, weight, count, longest)
            count += sum(map(len, element.rings))
        return _Strips(*map(np.concatenate, zip(*found, strict=True)))

    def _strips_of(
        self, element: Aperture, weight: complex, count: int, longest: float
    ) -> Iterator[tuple[NDArray[Any], ...]]:
        """Strips of each wave, in the order of :class:`_Strips`."""
        field = element.illumination or Illumination([1.0], [[0.0, 0.0]])
        plane = field.frequencies * self.wavelength
        cosines = cosines_of(field.frequencies, self.wavelength, self._paraxial)
        after = _next_vertices(element) + count
        for wave, reach in enumerate(reaches(plane, longest)):
            pieces = pieces_of(element, reach * self.wavelength)
            size = len(pieces.length)
            length = pieces.length / self.wavelength
            yield (
                (pieces.begin - self._radiator.centre) / self.wavelength,
                pieces.along,
                length,
                np.broadcast_to(plane[wave], (size, 2)),
                np.full(size, cosines[wave]),
                starts(pieces.begin, field.frequencies[wave]),
                np.full(size, weight * field.amplitudes[wave], np.complex128),
                pieces.owner + count,
                after[pieces.owner],
                pieces.share,
                pieces.step / length,
            )


def parts_of(source: Aperture | Array, by_waves: bool) -> Iterator[Aperture]:
    """The elements of a source, or the waves of an aperture, each with the amplitude 1."""
    if not by_waves:
        yield from source.elements_in_plane
        return
    (aperture,) = source.elements_in_plane
    assert aperture.illumination is not None
    for kappa in aperture.illumination.frequencies:
        yield aperture.with_illumination(Illumination([1.0], kappa[None]))


def _next_vertices(element: Aperture) -> NDArray[np.intp]:
    """The number of the vertex after each of ``element.rings``."""
    found, count = [], 0
    for ring in element.rings:
        found.append(np.roll(np.arange(len(ring)), -1) + count)
        count += len(ring)
    return np.concatenate(found)


@dataclass(frozen=True, eq=False)
class ShadowSlopes:
    """Derivatives of the field behind obstacles, in points alone."""

    source: Any
    bodies: Obstacles
    wavelength: float
    method: str
    tolerance: float

    def of_points(self, points: Floats) -> Complex:
        """dU/d(x, y, z) at points (n, 3), (n, 3): (SB4)."""
        change, inside = shadows.slopes_of_shadow(
            self.source, self.bodies, points, self.wavelength, self.method, self.tolerance
        )
        return np.where(inside[:, None], 0.0, self._free(points) + change)

    def reverse(
        self, points: Floats, cotangent: Complex, of_points: bool, of_vertices: bool
    ) -> tuple[Complex, Floats]:
        """See :meth:`FieldSlopes.reverse`."""
        return self.of_points(points), np.zeros((0, 2))

    def _free(self, points: Floats) -> Complex:
        if not isinstance(self.source, PointSource):
            free = FieldSlopes(self.source, self.wavelength, self.method, _TOLERANCE, False)
            return free.of_points(points)
        ahead = points - np.array(self.source.position)
        distance = np.linalg.norm(ahead, axis=1)
        wave = incident_of_point(self.source.position, points, self.wavelength)
        rate = self.source.amplitude * wave * (2j * math.pi / self.wavelength - 1.0 / distance)
        return np.asarray(rate[:, None] * ahead / distance[:, None])


# Default tolerance of derivatives, which are sums of float64.
_TOLERANCE = 1e-9


def has_derivatives(source: Any, points: Any, wavelength: Any) -> bool:
    """Whether an argument is there to be differentiated in."""
    if isinstance(source, Differentiable) or execution.is_drjit(wavelength):
        return True
    return execution.is_drjit(points) and execution.has_gradient(points)


def traced_field(
    compute: Any,
    source: Any,
    points: Any,
    wavelength: Any,
    method: Any,
    tolerance: float | None,
    *,
    precision: str | None,
    engine: str,
    obstacles: Any = None,
) -> execution.TracedField:
    """The field of a source, by ``compute(plain source, points, wavelength, method, ...)``.

    Raises ArgumentError for a wavelength that is an array, for Fraunhofer's field, for screens, and
    for numbers of a source that has obstacles before it.
    """
    if isinstance(source, Screen):
        raise ArgumentError(
            "expected no derivatives of fields behind a Screen, which has none; pass "
            "drjit.detach(...) of the points"
        )
    name = checked_method(method)
    if name == "fraunhofer":
        raise ArgumentError(
            'expected a method other than "fraunhofer" with derivatives; differentiate the '
            "transform pw.fourier instead, or pass drjit.detach(...) of what needs none"
        )
    if execution.is_drjit(wavelength):
        raise ArgumentError(
            'expected a wavelength without derivatives, which only method="wigner" has, got a '
            f"{type(wavelength).__name__}; pass a float"
        )
    how: dict[str, Any] = {"precision": execution.checked_precision(precision)}
    how["engine"] = execution.checked_engine(engine)
    plain = source.source if isinstance(source, Differentiable) else source
    if not isinstance(plain, PointSource):
        checked_source(plain)
    length = checked_wavelength(wavelength)
    field = partial(compute, plain, wavelength=length, method=name, tolerance=tolerance)
    slopes: FieldSlopes | ShadowSlopes
    if obstacles is None:
        traced = source if plain is not source else Differentiable(source)
        own = _TOLERANCE if tolerance is None else tolerance
        slopes = FieldSlopes(traced.source, length, name, own, traced.amplitudes is not None)
        return execution.hosted_field(field, slopes, points, parameters_of(traced), **how)
    if plain is not source:
        raise ArgumentError(
            "expected a plain source with obstacles, got a differentiable one; derivatives behind "
            "obstacles are in points alone: move points and obstacles instead of the source"
        )
    own = shadows.checked_shadow_tolerance(tolerance)
    slopes = ShadowSlopes(source, obstacles_of(obstacles, length), length, name, own)
    field = partial(field, obstacles=obstacles)
    return execution.hosted_field(field, slopes, points, Parameters(None, None), **how)
