"""The emitter inside a ``wigner`` shape: the Wigner radiance of a source, for Mitsuba.

    L(x, s) = (power/N) W(x, s_par/lambda)/lambda^2 h(theta),    N = int g |F|^2 dOmega/lambda^2

in the source's own frame, for directions s on its +z side and zero on the other. N is the power
that the field radiates as it is, a number of the host or, with derivatives, a traced sum over
directions; h = g/cos(theta). W comes from the same kernel as :func:`polywigner.wigner`, traced into
Mitsuba's render kernel: that of apertures with any field, of arrays of any elements, or of equal
elements on a lattice. Where h differs from wave to wave, h W is a sum of such terms (module
`obliquity`).

Positions are relative to the middle of the source. They are drawn, and directions formed, in the
source's frame: the reference point is brought there first. An aperture of some millimetres may then
stand a hundred metres from the origin of the world, where single precision resolves hundredths of a
millimetre, without losing its pattern. Rays that hit the mesh by chance carry their position as
texture coordinates, for the same reason.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import shapely
from numpy.typing import NDArray

from polywigner.errors import SceneError
from polywigner.execution import Traced, UnrolledOperations, kernel_with_derivatives
from polywigner.geometry import Aperture, Wavefront
from polywigner.kernels import FOURIER, WIGNER, new_outline_of, new_tables_of
from polywigner.mitsuba.plugins.parameters import ESTIMATORS, rigid_pose
from polywigner.mitsuba.plugins.placement import Frame, check_place, cover, move
from polywigner.mitsuba.plugins.polarisation import Polariser
from polywigner.mitsuba.plugins.sampling import opaque, single, spectrum
from polywigner.mitsuba.plugins.sources import (
    CentredSource,
    SourceSpec,
    centred_source,
    depends_on_wavelength,
    norm_of,
)
from polywigner.mitsuba.plugins.wigner import Wave, WignerRadiance
from polywigner.mitsuba.scenes.surfaces import ROUNDING, matrix_of, shadow_end
from polywigner.numerics.complex_pairs import Pair
from polywigner.radiometry.directions import directions_and_weights, largest_lag
from polywigner.source import Array
from polywigner.transforms import differentiable as differentiable_source

# What overlaps by less than this fraction of an area does so by rounding.
_APART = 1e-9
# Pairs of edges of a source with derivatives, which are code of every kernel of a render: each
# compiles in 7 ms, and 9000 exhaust the compiler.
_MOST_CUTS = 4096
# Stands for a density without bound; its square, and products with radiances, fit into float32.
_OVERWHELMING = 1e12


class TracedSource:
    """The numbers of one emitter's source that a scene's parameters expose."""

    def __init__(self, m: Any, centred: CentredSource, has_several: bool) -> None:
        self._m, self._source = m, centred
        self.vertices: Any = None
        self.weights: Any = None
        self.why_not = ""
        if not dr.is_jit_v(m.Float):
            self.why_not = "a variant of Mitsuba that compiles, such as llvm_ad_rgb"
        elif has_several:
            self.why_not = "an array of one polarisation"
        elif not _is_simple(centred.source):
            self.why_not = "a uniform aperture, or an array of such that do not overlap"
        else:
            self._tables = new_tables_of(centred.at_origin, dr.itemsize_v(m.Float) == 8)
            cuts = self._tables.clips
            if cuts > _MOST_CUTS:
                self.why_not = (
                    f"a source of few edges, as code of the render's kernel, got {cuts} pairs of "
                    "edges; gradients of pw.wigner and pw.fourier have no such limit"
                )
        if self.why_not:
            return
        self.vertices = m.Float(_corners(centred.source).ravel().tolist())
        if isinstance(centred.source, Array):
            self.weights = m.Float(_pairs(centred.source.weights).ravel().tolist())

    def is_followed(self) -> bool:
        """Whether derivatives are asked of any."""
        return any(v is not None and dr.grad_enabled(v) for v in (self.vertices, self.weights))

    def changed(self) -> Aperture | Array | None:
        """Return the source with the present values, or None if nothing changed."""
        if self.vertices is None:
            return None
        source: Any = self._source.source
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

    def wigner(self, ops: Any, *point: Any) -> Any:
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

    def intensity(self, ops: Any, *nu: Any) -> Any:
        """|F|^2 of the source, with derivatives in all numbers."""
        code = UnrolledOperations(ops.float_type)
        corners = iter(self._centred())
        total = Pair(0.0, 0.0)
        for number, element in enumerate(self._source.at_origin.elements_in_plane):
            outline = new_outline_of(element)
            own = [outline.frame.position(ops, *next(corners)) for _ in outline.edges]
            x, y = zip(*own, strict=True)
            value = Pair(*kernel_with_derivatives(FOURIER, code, outline, nu, Traced((x, y))))
            if self.weights is not None:
                value = value * Pair(*self._pair(self.weights, number))
            total = total + value
        return total.real * total.real + total.imag * total.imag

    def _pair(self, flat: Any, number: int) -> tuple[Any, Any]:
        m = self._m
        first, second = (dr.gather(m.Float, flat, m.UInt32(2 * number + k)) for k in (0, 1))
        return first, second

    def _centred(self) -> list[tuple[Any, Any]]:
        cx, cy = self._source.centre.tolist()
        count = dr.width(self.vertices) // 2
        pairs = (self._pair(self.vertices, number) for number in range(count))
        return [(x - cx, y - cy) for x, y in pairs]

    def _scaled_weights(self) -> list[tuple[Any, Any]]:
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


@cache
def emitter_class(variant: str) -> Any:
    """The emitter's class for one Mitsuba variant; the same class on every call."""
    m = getattr(mi, variant)
    jit = dr.is_jit_v(m.Float)

    base: Any = m.Emitter

    class WignerEmitter(base):
        """Built by the ``wigner`` shape; not a plugin of its own."""

        is_wigner = True

        def __init__(self, spec: SourceSpec, id: str = "") -> None:
            props = mi.Properties("wigner_emitter")
            props.set_id(id)
            props["sampling_weight"] = spec.sampling_weight
            super().__init__(props)
            flags = mi.EmitterFlags.Surface | mi.EmitterFlags.SpatiallyVarying
            if not spec.visible:  # or the particle tracer would show it to the camera
                flags |= mi.EmitterFlags.DeltaPosition
            self.m_flags = flags
            self.wavelength = _adjustable(m, spec.wavelength)
            self.power = _adjustable(m, spec.power)
            self.to_world = m.Transform4f(m.Matrix4f(spec.pose))
            # a literal is folded into loops, which Dr.Jit cannot record for a single sample then
            self._dark = opaque(m, 0.0)
            self._unit = spec.scene_unit
            self.polariser = Polariser(m, spec.polarisation)
            self._set_source(spec, spec.wavelength)
            self._take_over()

        def _set_source(self, spec: SourceSpec, wavelength: float) -> None:
            """Take over all that follows from the source."""
            self.spec = spec
            self._centre = spec.centred.centre / self._unit
            self._is_dispersive = depends_on_wavelength(spec.source, spec.obliquity)
            self._own = WignerRadiance(m, spec, wavelength)
            self.estimator = ESTIMATORS[spec.estimator](m, spec, wavelength, self._own)
            self._traced = TracedSource(m, spec.centred, spec.has_several)

        # ---- what a user may change ----------------------------------------------------------

        def traverse(self, callback: Any) -> None:
            """``wavelength`` (m), ``power`` (W), ``to_world`` (rigid); vertices and weights."""
            # Where it turns the directions of waves, these are constants of the kernel.
            constant = self._is_dispersive or self.estimator.is_constant
            flag = "NonDifferentiable" if constant else "Differentiable"
            callback.put("wavelength", self.wavelength, getattr(mi.ParamFlags, flag))
            callback.put("power", self.power, mi.ParamFlags.Differentiable)
            # With `direct` alone: others do not move the samples along with the aperture, so that
            # the gradient lacks the change of the receiver's cosine (docs/gradients.md).
            callback.put("to_world", self.to_world, mi.ParamFlags.Differentiable)
            if self._traced.vertices is not None:
                callback.put("vertices", self._traced.vertices, mi.ParamFlags.Differentiable)
            if self._traced.weights is not None:
                callback.put("weights", self._traced.weights, mi.ParamFlags.Differentiable)

        @property
        def vertices(self) -> Any:
            """x and y of each vertex (m), as a scene's parameters have them; else SceneError."""
            return self._exposed(self._traced.vertices)

        @property
        def weights(self) -> Any:
            """Real and imaginary part of each weight, as a scene's parameters; else SceneError."""
            return self._exposed(self._traced.weights)

        def _exposed(self, values: Any) -> Any:
            if values is None:
                reason = self._traced.why_not or "an array"
                raise SceneError(f"expected, for parameters with derivatives, {reason}")
            return values

        def parameters_changed(self, keys: list[str]) -> None:
            """Take over new values; a new pose moves the mesh as well."""
            if "wavelength" in keys or "power" in keys:
                self._check_numbers()
            shape = self.get_shape() if self.spec.visible else None
            if "vertices" in keys or "weights" in keys:
                self._reshape(shape)
            if "wavelength" in keys and (self._is_dispersive or self.estimator.is_constant):
                wavelength, kept = single(self.wavelength, "wavelength"), self._traced
                self._set_source(self.spec, wavelength)
                self._traced = kept
            self._take_over()
            if "to_world" in keys and shape is not None:
                move(shape, rigid_pose(matrix_of(self.to_world)), self._centre)
            elif "parent" in keys and shape is not None:
                check_place(shape, matrix_of(self.to_world), self._centre)

        def _reshape(self, shape: Any) -> None:
            """Take over vertices and weights, and give the mesh the region that radiates now."""
            source = self._traced.changed()
            if source is None:
                return
            traced, spec = self._traced, self.spec
            centred = centred_source(source, spec.obliquity, spec.antithetic)
            wavelength = single(self.wavelength, "wavelength")
            norm = norm_of(source, wavelength, spec.obliquity, spec.mixture)
            self._set_source(replace(spec, centred=centred, norm=norm), wavelength)
            # the arrays that a user holds, and their derivatives
            self._traced.vertices, self._traced.weights = traced.vertices, traced.weights
            if shape is not None:
                pose = rigid_pose(matrix_of(self.to_world))
                cover(shape, centred.support, pose, self._centre, self._unit)

        def _check_numbers(self) -> None:
            wavelength = single(self.wavelength, "wavelength")
            power = single(self.power, "power")
            if not wavelength > 0:
                raise SceneError(f"expected a wavelength above zero, got {wavelength:.6g} m")
            if not power >= 0:
                raise SceneError(f"expected a power of zero or more, got {power:.6g} W")
            spec = self.spec
            self.spec = replace(spec, norm=spec.norm_at(wavelength))

        def _take_over(self) -> None:
            # Opaque: as literals, every new value would compile the render kernel again.
            if jit:
                dr.make_opaque(self.wavelength, self.power)
            self.frame = Frame(m, self.to_world, self._centre)
            self.stand_at(float(np.abs(matrix_of(self.to_world)).max()))
            self._norm = self._traced_norm() if self.is_followed() else opaque(m, self.spec.norm)

        def stand_at(self, reach: float) -> None:
            """Take over the ``reach`` of its place in a scene; see module `surfaces`."""
            self._reach = opaque(m, reach)

        def is_followed(self) -> bool:
            """Whether derivatives are asked of the wavelength, of vertices or of weights."""
            return jit and (self._traced.is_followed() or dr.grad_enabled(self.wavelength))

        def _traced_norm(self) -> Any:
            """N with derivatives; its value is the host's."""
            wavelength = single(self.wavelength, "wavelength")
            source = self.spec.centred.at_origin
            lag = largest_lag(source)
            blocks = [np.column_stack(both) for both in directions_and_weights(lag, wavelength)]
            nodes = np.concatenate(blocks)
            waves = self.spec.mixture.nodes(source, wavelength)
            both = np.concatenate(
                [np.repeat(nodes, len(waves), axis=0), np.tile(waves, (len(nodes), 1))], axis=1
            )
            x, y, z, solid_angle, shift, tilt_x, tilt_y, share = map(m.Float, both.T.tolist())
            inverse = 1.0 / self.wavelength + shift
            wave = Wave(inverse, m.Vector2f(tilt_x, tilt_y))
            own = self._traced.intensity if self._follows() else None
            intensity = self._own.integral(m.Vector3f(x, y, z), wave, own) * inverse * inverse
            if self.spec.has_several:
                intensity = intensity.x
            total = dr.sum(intensity * z * solid_angle * share)
            return self.spec.norm * (total / dr.detach(total))

        # ---- the radiance --------------------------------------------------------------------

        def wave(self, x: Any, place: Any) -> Wave:
            """The wave of the sample at x (2D) for a receiver at a point, or into a direction."""
            return self._own.waves.wave(1.0 / _value(self.wavelength, jit), x, place)

        def radiance(self, x: Any, direction: Any, wave: Wave) -> Any:
            """L at positions x (2D) and directions (3D unit vectors) of the aperture's frame."""
            own = self._traced.wigner if self._follows() else None
            return self._scale(wave.inverse) * self._own.at(x, direction, wave, own)

        def watts_per_norm(self) -> Any:
            """Radiated over the power of the field as it is."""
            return _value(self.power, jit) / self._norm

        def intensity(self, direction: Any, wave: Wave) -> Any:
            """The integral of L over positions: radiance times area."""
            own = self._traced.intensity if self._follows() else None
            in_scene = self._scale(wave.inverse) / self._unit**2
            return in_scene * self._own.integral(direction, wave, own)

        def _follows(self) -> bool:
            """Whether derivatives in vertices or weights are asked of the radiance."""
            return jit and self._traced.is_followed() and self._own.is_single

        def _scale(self, inverse: Any) -> Any:
            return _value(self.power, jit) * (inverse * inverse / self._norm)

        def eval(self, si: Any, active: Any = True) -> Any:
            if not self.spec.visible:  # or unseen for a while, with a surface of its own
                return spectrum(m, self._dark, active)
            along = si.to_world(si.wi)
            direction = self.frame.to_own(along)
            found = self.radiance(si.uv, direction, self.wave(si.uv, direction))
            return self.polariser.sent(found, direction, self.frame, active, along)

        # ---- sampling for receivers ----------------------------------------------------------

        def sample_direction(self, it: Any, sample: Any, active: Any = True) -> Any:
            x, per_area = self.estimator.draw(sample)
            direction, distance = self.seen_from(it, x)
            ds = m.DirectionSample3f()
            self._place(ds, x, it.time)
            ds.d = -self.frame.to_scene(direction)
            ds.dist = distance
            ds.pdf = self._density(direction.z, distance, per_area)
            if self.spec.diffraction:  # what is in the way is in the weight
                away = (1.0 + dr.max(dr.abs(it.p))) * (2.0 * m.math.RayEpsilon)
                ds.p = it.p + ds.d * away
            else:
                ds.p = shadow_end(it, ds.p, self.frame.axes[2], self._reach)
            ds.emitter = m.EmitterPtr(self) if jit else self
            found = self.estimator.lit(self, it, x, per_area)
            return ds, self.polariser.sent(found, direction, self.frame, active)

        def pdf_direction(self, it: Any, ds: Any, active: Any = True) -> Any:
            cosine = -dr.dot(ds.d, self.frame.axes[2])
            return self._density(cosine, ds.dist, self.estimator.density(ds.uv))

        def eval_direction(self, it: Any, ds: Any, active: Any = True) -> Any:
            direction, distance = self.seen_from(it, ds.uv)
            per_area = self.estimator.density(ds.uv)
            density = self._density(direction.z, distance, per_area)
            found = self.estimator.lit(self, it, ds.uv, per_area) * density
            return self.polariser.sent(found, direction, self.frame, active)

        def _density(self, cosine: Any, distance: Any, per_area: Any) -> Any:
            """Per solid angle; overwhelming where no light comes by rays that meet the source.

            Integrators weigh samples of a light against such rays by the squares of densities. A
            light that has no surface is met by none. Exact light must not be counted twice; mirrors
            take no samples of lights, and show the radiance. As a `delta` light, for which there is
            no weighing, it would be too bright in ``direct`` with several samples of lights.
            """
            front = cosine > 0.0
            density = m.Float(_OVERWHELMING)
            if per_area is not None and self.spec.visible:
                density = per_area * (distance * distance) / dr.select(front, cosine, 1.0)
            return dr.select(front, density, 0.0)

        def seen_from(self, it: Any, x: Any) -> tuple[Any, Any]:
            """Unit vector, in the frame, from x to the point ``it``; and the distance."""
            r = self.frame.to_own(it.p - self.frame.origin) - m.Vector3f(x.x, x.y, 0.0)
            distance = dr.norm(r)
            return r / distance, distance

        def _place(self, sample: Any, x: Any, time: Any) -> None:
            """Fill in the numbers that all samples of the position x share."""
            sample.p = self.frame.point(x)
            sample.n = m.Normal3f(self.frame.axes[2])
            sample.uv = x
            sample.time = m.Float(time)
            sample.delta = m.Bool(False)

        # ---- sampling of the emitted field ---------------------------------------------------

        def sample_position(self, time: Any, sample: Any, active: Any = True) -> Any:
            ps = m.PositionSample3f()
            x, per_area = self._own.positions.sample(sample)
            self._place(ps, x, time)
            ps.pdf = m.Float(per_area)
            return ps, dr.select(active, m.Float(1.0 / per_area), 0.0)

        def pdf_position(self, ps: Any, active: Any = True) -> Any:
            return dr.select(active, m.Float(self._own.positions.density(ps.uv)), 0.0)

        def sample_ray(
            self, time: Any, sample1: Any, sample2: Any, sample3: Any, active: Any = True
        ) -> Any:
            """Position as for receivers, direction by cosine: the weight's mean is the power."""
            ps, share = self.sample_position(time, sample2, active)
            direction = m.warp.square_to_cosine_hemisphere(sample3)
            wavelengths, density = _optical_wavelengths(m, sample1)
            si = m.SurfaceInteraction3f(ps, wavelengths)
            si.time = time
            found = self.radiance(ps.uv, direction, self.wave(ps.uv, direction))
            weight = self.polariser.sent(found * share * dr.pi, direction, self.frame, active)
            start = ps.p + self.frame.axes[2] * (ROUNDING * self._reach)
            return m.Ray3f(start, self.frame.to_scene(direction), time, wavelengths), (
                weight * density
            )

        def sample_wavelengths(self, si: Any, sample: Any, active: Any = True) -> Any:
            """For the particle tracer alone, which passes the direction in scene coordinates."""
            wavelengths, density = _optical_wavelengths(m, sample)
            direction = self.frame.to_own(si.wi)
            radiance = self.radiance(si.uv, direction, self.wave(si.uv, direction))
            return wavelengths, self.polariser.sent(
                radiance, direction, self.frame, active
            ) * density

        def bbox(self) -> Any:
            return self.get_shape().bbox()

        def to_string(self) -> str:
            return (
                f"WignerEmitter[\n  wavelength = {self.wavelength},\n  power = {self.power},\n"
                f"  obliquity = {self.spec.obliquity},\n  source = {self.spec.source!r}\n]"
            )

    return WignerEmitter


def _adjustable(m: Any, value: float) -> Any:
    """A number that Mitsuba's ``traverse`` can change in place."""
    if dr.is_jit_v(m.Float):
        return dr.opaque(m.Float, value)
    # A Python float cannot be written to, an array of one can.
    return dr.scalar.ArrayXf(value)


def _value(number: Any, jit: bool) -> Any:
    return number if jit else number[0]


def _optical_wavelengths(m: Any, sample: Any) -> tuple[Any, Any]:
    """Wavelengths of the renderer's own colour spectrum and their inverse density.

    Only spectral variants have any. They stand for colours, not for the wave of the aperture,
    whose radiance is the same at each.
    """
    zero = dr.zeros(m.Ray3f).wavelengths
    if dr.size_v(type(zero)) == 0:
        return zero, 1.0
    shifts = [sample + i / len(zero) for i in range(len(zero))]
    return m.sample_uniform_spectrum(type(zero)(*(shift - dr.floor(shift) for shift in shifts)))
