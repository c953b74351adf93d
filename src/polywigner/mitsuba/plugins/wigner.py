"""The estimator ``wigner``: the Wigner function of a source, traced into render kernels.

`TracedSource` has the same function with derivatives in vertices and weights.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, NamedTuple

import drjit as dr
import numpy as np
import shapely
from numpy.typing import NDArray

from polywigner.errors import SceneError
from polywigner.execution import Drjit, Traced, UnrolledOperations, kernel_with_derivatives, ops_for
from polywigner.geometry import Aperture, Wavefront
from polywigner.kernels import FOURIER, WIGNER, kernel_for, new_outline_of, new_tables_of
from polywigner.mitsuba.plugins.emissions import Mixture, depends_on_wavelength, emissions
from polywigner.mitsuba.plugins.samplers import four, opaque, positions_of
from polywigner.numerics.complex_pairs import Pair
from polywigner.quantities import SPEED_OF_LIGHT
from polywigner.source import Array
from polywigner.source.obliquities import DEFAULT, OBLIQUITIES
from polywigner.transforms import differentiable as differentiable_source
from polywigner.transforms import fourier
from polywigner.transforms.wavefronts import flat_of

if TYPE_CHECKING:
    from polywigner.mitsuba.plugins.source_parameters import SourceParameters

# Odd numbers whose multiples differ in all bits, for hashing; 2^32 over the golden ratio is one.
_FACTORS = (0x9E3779B9, 0x85EBCA6B, 0xC2B2AE35, 0x27D4EB2F)
_WORD = 0xFFFFFFFF


class Wave(NamedTuple):
    """The wave of a sample."""

    inverse: Any
    """Inverse of its wavelength, in 1/m."""
    tilt: Any
    """Spatial frequency (2D) in 1/m by which it is tilted; None: not at all."""


class DrawnWaves:
    """Draws the waves of a mixture, for one variant's arrays."""

    def __init__(self, m: Any, mixture: Mixture) -> None:
        self._m, self._jit, self._mixture = m, dr.is_jit_v(m.Float), mixture
        self._band = opaque(m, (mixture.bandwidth or 0.0) / SPEED_OF_LIGHT)
        self._tilt = opaque(m, 1 / (2 * math.pi * mixture.coherence_width))

    def wave(self, inverse: Any, x: Any, place: Any) -> Wave:
        """The wave of the sample that a position x (2D) and a point or direction (3D) belong to."""
        if self._mixture.is_plain:
            return Wave(inverse, None)
        key = self._key(x.x, x.y), self._key(place.x, place.y, place.z)
        tilt = None
        if self._mixture.coherence_width < math.inf:
            sample = self._m.Point2f(*(_uniform(word) for word in self._words(*key)))
            tilt = self._m.warp.square_to_std_normal(sample) * self._tilt
        if self._mixture.bandwidth is not None:
            word = self._words(key[1], key[0])[0]
            inverse = inverse + self._band * (_uniform(word) - 0.5)
        return Wave(inverse, tilt)

    def _words(self, first: Any, second: Any) -> Drjit:
        return self._m.sample_tea_32(first, second, 5)

    def _key(self, *values: Any) -> Drjit:
        """32 bits of some floats."""
        key: Any = 0
        for value, factor in zip(values, _FACTORS, strict=False):
            if self._jit:
                bits = dr.reinterpret_array(self._m.UInt32, dr.detach(self._m.Float(value)))
            else:
                bits = int(np.float32(value).view(np.uint32))
            key = key + bits * factor
        return key if self._jit else key & _WORD


def _uniform(word: Any) -> Drjit:
    """A number in (0, 1) of 32 bits."""
    return ((word >> 9) + 0.5) * 2.0**-23


Values = tuple[Any, Any]


class WignerRadiance:
    """The sum of h W over the fields of a source (:func:`emissions`), for one variant's arrays."""

    def __init__(self, m: Any, spec: SourceParameters, wavelength: float) -> None:
        self._m, self._jit, self._unit = m, dr.is_jit_v(m.Float), spec.scene_unit
        self._ops = ops_for(m.Float)
        source = spec.at_origin
        self.positions = positions_of(m, source, spec.region, spec.sampling, spec.scene_unit)
        self.waves = DrawnWaves(m, spec.mixture)
        self._terms = []
        # (source, forms of h) as well, for the integral over positions
        self.fields = [
            (field, forms, stokes)
            for part, stokes in spec.fields_of(source)
            for field, forms in emissions(part, wavelength, spec.obliquity)
        ]
        for field, forms, stokes in self.fields:
            flat = flat_of(field)
            kernel = kernel_for("wigner", flat)
            self._terms.append((kernel, kernel.tables(flat, self._ops.double), forms, stokes))
        self._wave = source if isinstance(source, Wavefront) else None

    @property
    def is_single(self) -> bool:
        """Whether the source's own W makes it up."""
        return len(self._terms) == 1

    def at(self, x: Any, direction: Any, wave: Wave, own: Callable[..., Any] | None) -> Drjit:
        """The sum at positions (2D) and directions (3D) of the source's frame, in m^2, zero behind.

        Four Stokes numbers of a source of several polarisations. ``own``: W in the place of that of
        the fields, of operations and four coordinates.
        """
        front = direction.z > 0.0
        cosine = dr.select(front, direction.z, 1.0)
        place = (x.x * self._unit, x.y * self._unit)
        frequency = self._sheared(*_frequency(direction, wave), place, wave.inverse)
        density = 0.0
        for kernel, tables, forms, stokes in self._terms:
            point = (*place, *frequency)
            wigner = own(self._ops, *point) if own else self._wigner(kernel, tables, point)
            density = density + four(self._m, stokes, wigner * forms.radiance(cosine))
        return dr.select(front, density, 0.0)

    def _sheared(self, x: Any, y: Any, place: Values, inverse: Any) -> Values:
        """The frequency relative to the curved wave's at a place, at an inverse wavelength."""
        if self._wave is None:
            return x, y
        (xx, xy), (_, yy) = self._wave.curvature.tolist()
        dx, dy = (a - c for a, c in zip(place, self._wave.centre.tolist(), strict=True))
        if self._wave.wavelength is not None:  # the radius is the same at all wavelengths
            ratio = inverse * self._wave.wavelength
            dx, dy = dx * ratio, dy * ratio
        return x - (xx * dx + xy * dy), y - (xy * dx + yy * dy)

    def _wigner(self, kernel: Any, tables: Any, point: Any) -> Drjit:
        if not self._jit:
            return kernel(self._ops, tables, *point)[0]
        return kernel_with_derivatives(kernel, self._ops, tables, point, Traced())[0]

    def integral(self, direction: Any, wave: Wave, own: Callable[..., Any] | None) -> Drjit:
        """The integral over positions, |F|^2 in the place of W, in m^4; ``own``: |F|^2."""
        front = direction.z > 0.0
        cosine = dr.select(front, direction.z, 1.0)
        frequency = self._m.Vector2f(*_frequency(direction, wave))
        total = 0.0
        for field, forms, stokes in self.fields:
            square = own(self._ops, *frequency) if own else self._square(field, frequency)
            total = total + four(self._m, stokes, square * forms.radiance(cosine))
        return dr.select(front, total, 0.0)

    def _square(self, field: Any, frequency: Any) -> Drjit:
        """|F|^2."""
        amplitude = fourier(field, frequency if self._jit else [frequency.x, frequency.y])
        return amplitude.real * amplitude.real + amplitude.imag * amplitude.imag


def _frequency(direction: Any, wave: Wave) -> tuple[Drjit, Drjit]:
    """The two spatial frequencies at which a tilted wave leaves in a direction."""
    along = (direction.x * wave.inverse, direction.y * wave.inverse)
    if wave.tilt is None:
        return along
    return along[0] - wave.tilt.x, along[1] - wave.tilt.y


class WignerEstimator:
    """Points are lit, and rays weighed, by signed radiance from a random place of the source."""

    needs_distance = False
    is_constant = False

    def __init__(
        self, m: Any, spec: SourceParameters, wavelength: float, own: WignerRadiance
    ) -> None:
        self._m, self._spec, self._own = m, spec, own
        unit = spec.scene_unit
        self._shifts = [
            (m.Vector2f(x / unit, y / unit), weight) for x, y, weight in spec.region.shifts.tolist()
        ]
        self._inverse = opaque(m, 1.0 / wavelength)
        self._scale = opaque(m, unit**2 / spec.norm)

    @staticmethod
    def check(spec: SourceParameters) -> None:
        """Raise SceneError for light without single waves to draw, or a curved control variate."""
        if isinstance(spec.source, Wavefront) and spec.control_variate:
            raise SceneError(
                "expected no control_variate with a curved wave, got true; leave it out: its "
                "integral over places would be a sum for each sample"
            )
        mixture = spec.mixture
        oblique = (
            mixture.coherence_width < math.inf
            and OBLIQUITIES[spec.obliquity].needs_normal_derivative
        )
        disperses = mixture.bandwidth and depends_on_wavelength(spec.source, spec.obliquity)
        if oblique or disperses:
            raise SceneError(
                f'expected the obliquity {DEFAULT!r} or "paper" with {mixture}, got '
                f"{spec.obliquity!r}, by which each wave of the mixture would have a factor of its "
                "own"
            )

    def draw(self, sample: Any) -> tuple[Drjit, Drjit]:
        """A place, and the density there."""
        return self._own.positions.sample(sample)

    def density(self, x: Any) -> Drjit:
        """Per area, at a place."""
        return self._own.positions.density(x)

    def lit(self, light: Any, it: Any, x: Any, per_area: Any) -> Drjit:
        """L cos/r^2 over the density at the point ``it``, the mean over the places of a sample.

        A control variate takes off what the direction from the middle would give at these places,
        and adds the integral of that, in proportion to the density of samples.
        """
        total, wave = 0.0, light.wave(x, it.p)
        varies = self._spec.control_variate
        if varies:
            middle, distance = light.seen_from(it, self._m.Point2f(0.0))
            fixed = middle.z / (distance * distance) * self._cosines(light, it, x, middle)
            total = light.intensity(middle, wave) * fixed * per_area
        for shift, weight in self._shifts:
            place = x + shift
            direction, distance = light.seen_from(it, place)
            cosine = direction.z / (distance * distance)
            found = light.radiance(place, direction, wave) * cosine
            if varies:
                found = found - light.radiance(place, middle, wave) * fixed
            total = total + weight * found
        return total / per_area

    def _cosines(self, light: Any, it: Any, x: Any, middle: Any) -> Drjit:
        """The receiver's cosine towards the middle over that towards x, by which it multiplies."""
        normal = light.frame.to_own(it.n)
        own, other = dr.dot(normal, light.seen_from(it, x)[0]), dr.dot(normal, middle)
        same_side = own * other > 0.0
        return dr.select(same_side, other / dr.select(same_side, own, 1.0), 1.0)

    def received(
        self, x: Any, direction: Any, per_area: Any, point: Any = None, distance: Any = None
    ) -> Drjit:
        """g W/N over the density, in units of the scene; g = h cos."""
        wave = self._own.waves.wave(self._inverse, x, direction)
        return self._scale * self._own.at(x, direction, wave, None) * direction.z / per_area


# Overlaps below this fraction of an area are rounding errors.
_APART = 1e-9
# Pairs of edges of a source with derivatives, which are code of every kernel of a render: a pair
# compiles in 7 ms, and 9000 exhaust the compiler.
_MOST_CUTS = 4096


class TracedSource:
    """The numbers of one emitter's source that a scene's parameters expose."""

    def __init__(self, m: Any, spec: SourceParameters) -> None:
        self._m, self._spec = m, spec
        source = spec.source
        self.vertices: Any = None
        self.weights: Any = None
        self.why_not = ""
        if not dr.is_jit_v(m.Float):
            self.why_not = "a variant of Mitsuba that compiles, such as llvm_ad_rgb"
        elif spec.has_several:
            self.why_not = "an array of one polarisation"
        elif not _is_simple(source):
            self.why_not = "a uniform aperture, or an array of such that do not overlap"
        else:
            self._tables = new_tables_of(flat_of(spec.at_origin), dr.itemsize_v(m.Float) == 8)
            cuts = self._tables.clips
            if cuts > _MOST_CUTS:
                self.why_not = (
                    f"a source of few edges, as code of the render's kernel, got {cuts} pairs of "
                    "edges; gradients of pw.wigner and pw.fourier have no such limit"
                )
        if self.why_not:
            return
        self.vertices = m.Float(_corners(source).ravel().tolist())
        if isinstance(source, Array):
            self.weights = m.Float(_pairs(source.weights).ravel().tolist())

    def is_followed(self) -> bool:
        """Whether derivatives are asked of any."""
        return any(v is not None and dr.grad_enabled(v) for v in (self.vertices, self.weights))

    def changed(self) -> Aperture | Array | None:
        """Return the source with the present values, or None if nothing changed."""
        if self.vertices is None:
            return None
        source: Any = self._spec.source
        known = _corners(source).astype(np.float32)
        points = self._values("vertices", self.vertices, len(known))
        has_changed = not np.array_equal(points, known)
        if has_changed:
            columns = (self._m.Float(column.tolist()) for column in points.T)
            moved = self._m.Point2f(*columns)
            source = differentiable_source(source, vertices=moved).source
        if isinstance(source, Array):
            known = _pairs(source.weights).astype(np.float32)
            pairs = self._values("weights", self.weights, len(known))
            if not np.array_equal(pairs, known):
                weights = self._m.TensorXf(pairs)  # a lattice stays one
                source, has_changed = differentiable_source(source, weights=weights).source, True
        return source if has_changed else None

    def _values(self, name: str, flat: Any, count: int) -> NDArray[np.float32]:
        values = np.array(dr.detach(flat), np.float32)
        if values.size != 2 * count or not np.isfinite(values).all():
            raise SceneError(
                f"expected {name} as {2 * count} finite numbers, two for each of {count}, got "
                f"{values.size} numbers"
            )
        return values.reshape(-1, 2)

    def wigner(self, ops: Any, *point: Any) -> Drjit:
        """W of the centred source, with derivatives in all numbers."""
        frame = self._tables.frame
        x, y = zip(*(frame.position(ops, *corner) for corner in self._centred()), strict=True)
        fields = None
        if self.weights is not None:
            real, imag = zip(*self._scaled_weights(), strict=True)
            fields = real, imag
        traced = Traced((x, y), fields)
        (value,) = kernel_with_derivatives(WIGNER, ops, self._tables, point, traced)
        return value

    def intensity(self, ops: Any, *nu: Any) -> Drjit:
        """|F|^2 of the source, with derivatives in all numbers."""
        code = UnrolledOperations(ops.float_type)
        corners = iter(self._centred())
        total = Pair(0.0, 0.0)
        for number, element in enumerate(flat_of(self._spec.at_origin).elements_in_plane):
            outline = new_outline_of(element)
            own = [outline.frame.position(ops, *next(corners)) for _ in outline.edges]
            x, y = zip(*own, strict=True)
            value = Pair(*kernel_with_derivatives(FOURIER, code, outline, nu, Traced((x, y))))
            if self.weights is not None:
                value = value * Pair(*self._pair(self.weights, number))
            total = total + value
        return total.real * total.real + total.imag * total.imag

    def _pair(self, flat: Any, number: int) -> tuple[Drjit, Drjit]:
        m = self._m
        first, second = (dr.gather(m.Float, flat, m.UInt32(2 * number + k)) for k in (0, 1))
        return first, second

    def _centred(self) -> list[tuple[Drjit, Drjit]]:
        cx, cy = self._spec.region.centre.tolist()
        count = dr.width(self.vertices) // 2
        pairs = (self._pair(self.vertices, number) for number in range(count))
        return [(x - cx, y - cy) for x, y in pairs]

    def _scaled_weights(self) -> list[tuple[Drjit, Drjit]]:
        result = []
        for number, factor in enumerate(self._tables.factors):
            real, imag = self._pair(self.weights, number)
            a, b = factor.real, factor.imag
            result.append((real * a - imag * b, real * b + imag * a))
        return result


def _corners(source: Aperture | Array) -> NDArray[np.float64]:
    return np.concatenate([ring for element in source.elements_in_plane for ring in element.rings])


def _pairs(weights: NDArray[np.complex128]) -> NDArray[np.float64]:
    return np.stack([weights.real, weights.imag], axis=-1)


def _is_simple(source: Any) -> bool:
    """Whether the field is constant on each element, and its energy the sum of theirs."""
    if isinstance(source, Wavefront):
        return False
    elements = source.elements_in_plane
    if any(element.illumination is not None for element in elements):
        return False
    whole = shapely.union_all([element.polygons for element in elements]).area
    total = sum(element.area for element in elements)
    return bool(abs(whole - total) <= _APART * total)
