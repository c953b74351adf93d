"""The estimator ``wigner``, which evaluates the Wigner function of a source in render kernels.

`TracedSource` adds derivatives of this function with respect to vertices and weights.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, NamedTuple

import drjit as dr
import mitsuba as mi
import numpy as np
import shapely
from numpy.typing import NDArray

from polywigner.errors import SceneError
from polywigner.execution import Drjit, DrjitOperations, Traced, kernel_with_derivatives, ops_for
from polywigner.geometry import Aperture, Wavefront
from polywigner.geometry.arguments import finite_array
from polywigner.geometry.convex import trapezoids
from polywigner.kernels import FOURIER, WIGNER, kernel_for, new_tables_of, outline_tables
from polywigner.kernels.kernel import Kernel
from polywigner.mitsuba.plugins.mixtures import (
    Mixture,
    SceneSource,
    depends_on_wavelength,
    emissions,
)
from polywigner.mitsuba.plugins.samplers import Positions, opaque, times_stokes
from polywigner.mitsuba.plugins.source_parameters import SourceParameters
from polywigner.numerics.phases import Pair
from polywigner.quantities import SPEED_OF_LIGHT
from polywigner.source import Array
from polywigner.source.normal_form import normal_form
from polywigner.source.obliquities import DEFAULT, OBLIQUITIES, Forms
from polywigner.source.polarisation import Stokes
from polywigner.transforms import differentiable as differentiable_source
from polywigner.transforms import fourier
from polywigner.transforms.wavefronts import flat_source

if TYPE_CHECKING:
    from polywigner.mitsuba.plugins.emitter import WignerEmitter

# Odd multipliers of a hash function; the first one is 2^32 divided by the golden ratio.
_FACTORS = (0x9E3779B9, 0x85EBCA6B, 0xC2B2AE35, 0x27D4EB2F)
_WORD = 0xFFFFFFFF

Point = tuple[Drjit, Drjit]


class Wave(NamedTuple):
    """Wavelength and tilt of the wave of a sample."""

    inverse: Drjit
    """Inverse wavelength in 1/m."""
    tilt: Drjit | None
    """Spatial frequency along x and y in 1/m, or None for coherent light."""


class DrawnWaves:
    """Sampler of wavelengths and tilts of partially coherent or broadband sources."""

    def __init__(self, m: Any, mixture: Mixture) -> None:
        self._m, self._jit, self._mixture = m, dr.is_jit_v(m.Float), mixture
        self._band = opaque(m, (mixture.bandwidth or 0.0) / SPEED_OF_LIGHT)
        self._tilt = opaque(m, 1 / (2 * math.pi * mixture.coherence_width))

    def wave(self, inverse: Drjit, x: mi.Point2f, end: mi.Point3f) -> Wave:
        """Return a random wave for a sample from ``x`` to the point or direction ``end``.

        ``inverse`` is the mean inverse wavelength in 1/m. The random numbers are a hash of ``x``
        and ``end``.
        """
        if self._mixture.is_plain:
            return Wave(inverse, None)
        start, end = self._hash(x.x, x.y), self._hash(end.x, end.y, end.z)
        tilt = None
        if self._mixture.coherence_width < math.inf:
            sample = self._m.Point2f(*map(_uniform, self._m.sample_tea_32(start, end, 5)))
            tilt = self._m.warp.square_to_std_normal(sample) * self._tilt
        if self._mixture.bandwidth is not None:
            word = self._m.sample_tea_32(end, start, 5)[0]
            inverse = inverse + self._band * (_uniform(word) - 0.5)
        return Wave(inverse, tilt)

    def _hash(self, *values: Drjit) -> Drjit:
        """Return a hash of the bits of single-precision numbers, as an unsigned integer."""
        key: Drjit = 0
        for value, factor in zip(values, _FACTORS, strict=False):
            if self._jit:
                bits = dr.reinterpret_array(self._m.UInt32, dr.detach(self._m.Float(value)))
            else:
                bits = int(np.float32(value).view(np.uint32))
            key = key + bits * factor
        return key if self._jit else key & _WORD


def _uniform(word: Drjit) -> Drjit:
    """Convert a 32-bit random integer to a number between 0 and 1."""
    return ((word >> 9) + 0.5) * 2.0**-23


class _Term(NamedTuple):
    """Term of the radiance: an obliquity factor h times a Wigner function W."""

    source: SceneSource
    forms: Forms
    stokes: Stokes | None
    kernel: Kernel
    tables: Any


class WignerRadiance:
    """Wigner radiance of a source, the sum of h W over the terms of :func:`emissions`."""

    def __init__(self, m: Any, spec: SourceParameters, wavelength: float) -> None:
        self._m, self._jit, self._unit = m, dr.is_jit_v(m.Float), spec.scene_unit
        self._ops = ops_for(m.Float)
        source = spec.at_origin
        self.positions = Positions(m, trapezoids(spec.outline.rings))
        self.waves = DrawnWaves(m, spec.mixture)
        self.terms = []
        for part, stokes in spec.fields_of(source):
            for term, forms in emissions(part, wavelength, spec.obliquity):
                kernel = kernel_for("wigner", flat_source(term))
                tables = kernel.tables(flat_source(term), self._ops.double)
                self.terms.append(_Term(term, forms, stokes, kernel, tables))
        self._wave = source if isinstance(source, Wavefront) else None

    def at(
        self, x: Drjit, direction: Drjit, wave: Wave, wigner: Callable[..., Drjit] | None = None
    ) -> Drjit:
        """Return the radiance times the squared wavelength in m^2, as a number or Stokes vector.

        The position ``x`` is relative to the centre of the source, in scene units, and
        ``direction`` is a unit vector in its frame. ``wigner(ops, x, y, nu_x, nu_y)``, with
        arguments in m and 1/m, replaces the Wigner function of each term.
        """
        position = (x.x * self._unit, x.y * self._unit)
        frequency = self._flattened(_frequency(direction, wave), position, wave.inverse)
        point = (*position, *frequency)

        def wigner_of(term: _Term) -> Drjit:
            """Return the Wigner function of a term."""
            if wigner is not None:
                return wigner(self._ops, *point)
            if self._jit:
                arguments = term.kernel, self._ops, term.tables, point, Traced()
                return kernel_with_derivatives(*arguments)[0]
            return term.kernel(self._ops, term.tables, *point)[0]

        return self._sum_over_terms(direction, wigner_of)

    def _sum_over_terms(self, direction: Drjit, value_of: Callable[[_Term], Drjit]) -> Drjit:
        """Return the sum of h times ``value_of(term)``, or zero in backward directions."""
        front = direction.z > 0.0
        cosine = dr.select(front, direction.z, 1.0)
        total = 0.0
        for term in self.terms:
            value = value_of(term) * term.forms.radiance(cosine)
            total = total + times_stokes(self._m, term.stokes, value)
        return dr.select(front, total, 0.0)

    def _flattened(self, frequency: Point, position: Point, inverse: Drjit) -> Point:
        """Subtract the local spatial frequency of a curved wave from a frequency in 1/m.

        ``position`` is in m, and ``inverse`` is the inverse wavelength in 1/m.
        """
        if self._wave is None:
            return frequency
        (xx, xy), (_, yy) = self._wave.curvature.tolist()
        dx, dy = (a - c for a, c in zip(position, self._wave.centre.tolist(), strict=True))
        # The radius of curvature is independent of the wavelength.
        if self._wave.wavelength is not None:
            ratio = inverse * self._wave.wavelength
            dx, dy = dx * ratio, dy * ratio
        return frequency[0] - (xx * dx + xy * dy), frequency[1] - (xy * dx + yy * dy)

    def integral(
        self, direction: Drjit, wave: Wave, intensity: Callable[..., Drjit] | None = None
    ) -> Drjit:
        """Return the integral of :meth:`at` over all positions, in m^4.

        ``intensity(ops, nu_x, nu_y)``, with frequencies in 1/m, replaces the |F|^2 of each term.
        """
        x, y = _frequency(direction, wave)

        def intensity_of(term: _Term) -> Drjit:
            """Return |F|^2 of a term."""
            if intensity is not None:
                return intensity(self._ops, x, y)
            value = fourier(term.source, self._m.Vector2f(x, y) if self._jit else [x, y])
            return value.real * value.real + value.imag * value.imag

        return self._sum_over_terms(direction, intensity_of)


def _frequency(direction: mi.Vector3f, wave: Wave) -> Point:
    """Return the spatial frequency of a direction in 1/m, relative to the tilt of a wave."""
    x, y = direction.x * wave.inverse, direction.y * wave.inverse
    return (x, y) if wave.tilt is None else (x - wave.tilt.x, y - wave.tilt.y)


class WignerEstimator:
    """Estimator of irradiance and ray weights from the radiance of random points."""

    needs_distance = False
    is_constant = False

    def __init__(
        self, m: Any, spec: SourceParameters, wavelength: float, radiance: WignerRadiance
    ) -> None:
        self._radiance = radiance
        self.draw = radiance.positions.sample
        """Function from the unit square to positions on the source."""
        self.density: float | None = radiance.positions.density
        """Probability density of positions per area."""
        self._inverse = opaque(m, 1.0 / wavelength)
        self._scale = opaque(m, spec.scene_unit**2 / spec.norm)

    @staticmethod
    def check(spec: SourceParameters) -> None:
        """Raise SceneError if the waves of a source have different obliquity factors."""
        mixture = spec.mixture
        oblique = (
            mixture.coherence_width < math.inf
            and OBLIQUITIES[spec.obliquity].needs_normal_derivative
        )
        disperses = mixture.bandwidth and depends_on_wavelength(spec.source, spec.obliquity)
        if oblique or disperses:
            raise SceneError(
                f'{mixture} requires the obliquity {DEFAULT!r} or "paper", got '
                f"{spec.obliquity!r}, whose factor differs between the waves of the mixture"
            )

    def irradiance(self, light: WignerEmitter, it: mi.Interaction3f, x: mi.Point2f) -> Drjit:
        """Return L cos/r^2 for the position ``x``, divided by the density of positions, in W/m^2.

        Here L is the radiance, r is the distance, and cos is the cosine of the emission angle at
        the source. The cosine of incidence and obstacles are not included.
        """
        direction, distance = light.direction_to(it, x)
        value = light.radiance(x, direction, light.wave(x, it.p)) * direction.z
        return value / (distance * distance * self.density)

    def received(
        self, x: Drjit, direction: Drjit, point: Drjit = None, distance: Drjit = None
    ) -> Drjit:
        """Return the weight in m^2 of a ray that leaves a receiver at ``x``, in its frame.

        The weight is h W cos/N, divided by the density of positions, with the obliquity factor h,
        the Wigner function W and the norm N. ``point`` and ``distance`` are not used.
        """
        wave = self._radiance.waves.wave(self._inverse, x, direction)
        return self._scale * self._radiance.at(x, direction, wave) * direction.z / self.density


# Overlaps between elements below this fraction of the total area are treated as rounding errors.
_OVERLAP = 1e-9
# Largest number of edge pairs in a differentiable source. Each pair takes 7 ms to compile, and the
# compiler fails at 9,000 pairs.
_MOST_CUTS = 4096


class TracedSource:
    """Vertices and weights of a source as differentiable parameters of a scene.

    The attributes ``vertices`` and ``weights`` are None in scalar variants, and for sources with
    non-uniform fields, overlapping elements, several polarisations or too many edges.
    """

    def __init__(self, m: Any, spec: SourceParameters) -> None:
        self._m, self._spec = m, spec
        source = spec.source
        self.vertices: Any = None
        self.weights: Any = None
        if not dr.is_jit_v(m.Float) or spec.has_several or not _is_differentiable(source):
            return
        self._tables = new_tables_of(flat_source(spec.at_origin), dr.itemsize_v(m.Float) == 8)
        if self._tables.clips > _MOST_CUTS:
            return
        self.vertices = m.Float(_vertices_of(source).ravel().tolist())
        if isinstance(source, Array):
            self.weights = m.Float(_real_and_imaginary_parts(source.weights).ravel().tolist())

    def has_gradients(self) -> bool:
        """Return whether derivatives with respect to vertices or weights are enabled."""
        return any(v is not None and dr.grad_enabled(v) for v in (self.vertices, self.weights))

    def changed(self) -> Aperture | Array | None:
        """Return the source with the user's vertices and weights, or None if none has changed."""
        if self.vertices is None:
            return None
        source: Any = self._spec.source
        known = _vertices_of(source).astype(np.float32)
        points = self._checked_pairs("vertices", self.vertices, len(known))
        has_changed = not np.array_equal(points, known)
        if has_changed:
            columns = (self._m.Float(column.tolist()) for column in points.T)
            source = differentiable_source(source, vertices=self._m.Point2f(*columns)).source
        if isinstance(source, Array):
            known = _real_and_imaginary_parts(source.weights).astype(np.float32)
            pairs = self._checked_pairs("weights", self.weights, len(known))
            if not np.array_equal(pairs, known):
                weights = self._m.TensorXf(pairs)
                source, has_changed = differentiable_source(source, weights=weights).source, True
        return source if has_changed else None

    def _checked_pairs(self, name: str, flat: Drjit, count: int) -> NDArray[np.float32]:
        """Return a parameter as an array (count, 2); raise SceneError unless it is finite."""
        values = np.array(dr.detach(flat), np.float32).ravel()
        expected = f"expected {2 * count} finite numbers, two for each of {count} {name}"
        finite_array(values, expected, (2 * count,), error=SceneError)
        return values.reshape(-1, 2)

    def wigner(self, ops: Any, *point: Drjit) -> Drjit:
        """Return the Wigner function W(x, nu) of the centred source in m^2, with derivatives.

        ``point`` contains x, y in m, and nu_x, nu_y in 1/m.
        """
        frame = self._tables.frame
        x, y = zip(*(frame.position(ops, *corner) for corner in self._vertices()), strict=True)
        fields = None
        if self.weights is not None:
            pairs = zip(self._pairs_of_numbers(self.weights), self._tables.factors, strict=True)
            scaled = [Pair(*weight) * Pair(f.real, f.imag) for weight, f in pairs]
            fields = tuple(w.real for w in scaled), tuple(w.imag for w in scaled)
        traced = Traced((x, y), fields)
        (value,) = kernel_with_derivatives(WIGNER, ops, self._tables, point, traced)
        return value

    def intensity(self, ops: Any, *nu: Drjit) -> Drjit:
        """Return |F(nu)|^2 of the centred source in m^4, with derivatives; ``nu`` is in 1/m."""
        code = DrjitOperations(ops.float_type, most_as_code=math.inf)
        corners = iter(self._vertices())
        weights = None if self.weights is None else self._pairs_of_numbers(self.weights)
        total = Pair(0.0, 0.0)
        for number, element in enumerate(flat_source(self._spec.at_origin).elements_in_plane):
            outline = outline_tables(element.rings)
            vertices = [outline.frame.position(ops, *next(corners)) for _ in outline.edges]
            x, y = zip(*vertices, strict=True)
            value = Pair(*kernel_with_derivatives(FOURIER, code, outline, nu, Traced((x, y))))
            total = total + (value if weights is None else value * Pair(*weights[number]))
        return total.real * total.real + total.imag * total.imag

    def _pairs_of_numbers(self, flat: Drjit) -> list[Point]:
        """Return the pairs of numbers of a flat array, with derivatives."""
        m = self._m
        numbers = [dr.gather(m.Float, flat, m.UInt32(k)) for k in range(dr.width(flat))]
        return list(zip(numbers[::2], numbers[1::2], strict=True))

    def _vertices(self) -> list[Point]:
        """Return the vertices in m from the centre of the source, with derivatives."""
        cx, cy = self._spec.support.centre.tolist()
        return [(x - cx, y - cy) for x, y in self._pairs_of_numbers(self.vertices)]


def _vertices_of(source: Aperture | Array) -> NDArray[np.float64]:
    """Return the vertices of all elements in m, shape (n, 2)."""
    return np.concatenate(normal_form(source).rings)


def _real_and_imaginary_parts(weights: NDArray[np.complex128]) -> NDArray[np.float64]:
    """Return complex weights (n,) as real and imaginary parts, shape (n, 2)."""
    return np.stack([weights.real, weights.imag], axis=-1)


def _is_differentiable(source: SceneSource) -> bool:
    """Return whether a source is differentiable: disjoint elements with uniform fields."""
    if isinstance(source, Wavefront):
        return False
    elements = source.elements_in_plane
    if any(element.illumination is not None for element in elements):
        return False
    joint = shapely.union_all([element.polygons for element in elements]).area
    total = sum(element.area for element in elements)
    return bool(abs(joint - total) <= _OVERLAP * total)
