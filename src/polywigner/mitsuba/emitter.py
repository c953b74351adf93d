"""The emitter inside a ``wigner`` shape: the Wigner radiance of a source, for Mitsuba.

    L(x, s) = (power / int |u|^2) W(x, s_par / lambda) / lambda^2 h(theta)

in the source's own frame, for directions s on its +z side and zero on the other. W comes from the
same kernel as :func:`polywigner.wigner`, traced into Mitsuba's render kernel: that of apertures
with any field, of arrays of any elements, or of equal elements on a lattice. Where h differs from
wave to wave, h W is a sum of such terms (module `obliquity`).

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

from polywigner.engines import Traced, differentiable, ops_for
from polywigner.errors import SceneError
from polywigner.kernels import kernel_for
from polywigner.mitsuba.obliquity import depends_on_wavelength, emission_factor, emissions
from polywigner.mitsuba.parameters import EmitterSpec, check_range, rigid_pose
from polywigner.mitsuba.placement import check_place, cover, matrix_of, move
from polywigner.mitsuba.radiator import radiator_of
from polywigner.mitsuba.sampling import positions_of
from polywigner.mitsuba.traced import TracedSource
from polywigner.transforms import fourier

__all__ = ["emitter_class"]


@cache
def emitter_class(variant: str) -> Any:
    """The emitter's class for one Mitsuba variant; the same class on every call."""
    m = getattr(mi, variant)
    jit = dr.is_jit_v(m.Float)

    base: Any = m.Emitter

    class WignerEmitter(base):
        """Built by the ``wigner`` shape; not a plugin of its own."""

        is_wigner = True

        def __init__(self, spec: EmitterSpec, id: str = "") -> None:
            props = mi.Properties("wigner_emitter")
            props.set_id(id)
            props["sampling_weight"] = spec.sampling_weight
            super().__init__(props)
            self.m_flags = mi.EmitterFlags.Surface | mi.EmitterFlags.SpatiallyVarying
            self.wavelength = _adjustable(m, spec.wavelength)
            self.power = _adjustable(m, spec.power)
            self.to_world = m.Transform4f(m.Matrix4f(spec.pose))
            self._unit = spec.scene_unit
            self._ops = ops_for(m.Float)
            self._shine_like(spec, spec.wavelength)
            self._take_over()

        def _shine_like(self, spec: EmitterSpec, wavelength: float) -> None:
            """Take over all that follows from the source."""
            self.spec = spec
            radiator = spec.radiator
            self._centre = radiator.centre / self._unit
            self._shifts = [
                (m.Vector2f(x / self._unit, y / self._unit), weight)
                for x, y, weight in radiator.shifts.tolist()
            ]
            self._positions = positions_of(m, radiator, spec.sampling, self._unit)
            self._source = radiator.centred
            self._squints = depends_on_wavelength(self._source, spec.obliquity)
            self._terms = self._terms_at(wavelength)
            self._traced = TracedSource(m, radiator)

        def _terms_at(self, wavelength: float) -> list[tuple[Any, Any, Any]]:
            """(kernel, its constants, coefficients of h) of what adds up to the radiance.

            Keeps (source, coefficients) as well, for the integral over positions.
            """
            terms = []
            self._fields = []
            for term in emissions(self._source, wavelength, self.spec.obliquity):
                self._fields.append((term.source, term.coefficients))
                kernel = kernel_for("wigner", term.source)
                tables = kernel.tables(term.source, self._ops.double)
                terms.append((kernel, tables, term.coefficients))
            return terms

        # ---- what a user may change ----------------------------------------------------------

        def traverse(self, callback: Any) -> None:
            """``wavelength`` (m), ``power`` (W), ``to_world`` (rigid); vertices and weights."""
            # Where it turns the directions of waves, these are constants of the kernel.
            flag = "NonDifferentiable" if self._squints else "Differentiable"
            callback.put("wavelength", self.wavelength, getattr(mi.ParamFlags, flag))
            callback.put("power", self.power, mi.ParamFlags.Differentiable)
            # With `direct` alone: others do not move the samples along with the aperture, so that
            # the gradient lacks the change of the receiver's cosine (docs/gradients.md).
            callback.put("to_world", self.to_world, mi.ParamFlags.Differentiable)
            if self._traced.vertices is not None:
                callback.put("vertices", self._traced.vertices, mi.ParamFlags.Differentiable)
            if self._traced.weights is not None:
                callback.put("weights", self._traced.weights, mi.ParamFlags.Differentiable)

        def parameters_changed(self, keys: list[str]) -> None:
            """Take over new values; a new pose moves the mesh as well."""
            if "wavelength" in keys or "power" in keys:
                self._check_numbers()
            shape = self.get_shape()
            if "vertices" in keys or "weights" in keys:
                self._reshape(shape)
            if "wavelength" in keys and self._squints:
                self._terms = self._terms_at(_single(self.wavelength, "wavelength"))
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
            antithetic = len(spec.radiator.shifts) > 1
            radiator = radiator_of(source, spec.obliquity, antithetic)
            wavelength = _single(self.wavelength, "wavelength")
            self._shine_like(replace(spec, radiator=radiator), wavelength)
            # the arrays that a user holds, and their derivatives
            self._traced.vertices, self._traced.weights = traced.vertices, traced.weights
            if shape is not None:
                pose = rigid_pose(matrix_of(self.to_world))
                cover(shape, radiator.support, pose, self._centre, self._unit)

        def _check_numbers(self) -> None:
            wavelength = _single(self.wavelength, "wavelength")
            power = _single(self.power, "power")
            if not wavelength > 0:
                raise SceneError(f"expected a wavelength above zero, got {wavelength:.6g} m")
            if not power >= 0:
                raise SceneError(f"expected a power of zero or more, got {power:.6g} W")
            check_range(self.spec.radiator, wavelength, power, self._unit)

        def _take_over(self) -> None:
            # Opaque: as literals, every new value would compile the render kernel again.
            if jit:
                dr.make_opaque(self.wavelength, self.power)
            matrix = self.to_world.matrix
            columns = [m.Vector3f(*(matrix[row, col] for row in range(3))) for col in range(4)]
            self._axes = columns[:3]
            cx, cy = self._centre.tolist()
            self._origin = m.Point3f(columns[0] * cx + columns[1] * cy + columns[3])
            if jit:
                dr.make_opaque(self._axes, self._origin)

        # ---- the radiance --------------------------------------------------------------------

        def _radiance(self, x: Any, direction: Any) -> Any:
            """L at positions x (2D) and directions (3D unit vectors) of the aperture's frame.

            Positions are in scene units, as everything that Mitsuba sees.
            """
            inverse = 1.0 / _value(self.wavelength, jit)
            front = direction.z > 0.0
            cosine = dr.select(front, direction.z, 1.0)
            place = (x.x * self._unit, x.y * self._unit)
            frequency = (direction.x * inverse, direction.y * inverse)
            density = 0.0
            for kernel, tables, coefficients in self._terms:
                wigner = self._wigner(kernel, tables, (*place, *frequency))
                density = density + wigner * emission_factor(coefficients, cosine)
            return dr.select(front, self._scale(inverse) * density, 0.0)

        def _wigner(self, kernel: Any, tables: Any, point: Any) -> Any:
            if not jit:
                return kernel(self._ops, tables, *point)[0]
            if self._traced.is_followed() and len(self._terms) == 1:
                return self._traced.wigner(self._ops, *point)
            return differentiable(kernel, self._ops, tables, point, Traced())[0]

        def _intensity(self, direction: Any) -> Any:
            """The integral of L over positions, |F|^2 in the place of W: radiance times area."""
            inverse = 1.0 / _value(self.wavelength, jit)
            front = direction.z > 0.0
            cosine = dr.select(front, direction.z, 1.0)
            frequency = m.Vector2f(direction.x * inverse, direction.y * inverse)
            total = 0.0
            for source, coefficients in self._fields:
                amplitude = fourier(source, frequency if jit else [frequency.x, frequency.y])
                square = amplitude.real * amplitude.real + amplitude.imag * amplitude.imag
                total = total + square * emission_factor(coefficients, cosine)
            in_scene = self._scale(inverse) / self._unit**2
            return dr.select(front, in_scene * total, 0.0)

        def _scale(self, inverse: Any) -> Any:
            energy = self.spec.radiator.energy
            if self._traced.is_followed():
                energy = self._traced.energy()
            return _value(self.power, jit) * (inverse * inverse / energy)

        def _spectrum(self, value: Any, active: Any) -> Any:
            # One narrow band: the same value in every channel or at every sampled wavelength.
            return m.depolarizer(m.UnpolarizedSpectrum(dr.select(active, value, 0.0)))

        def _to_frame(self, v: Any) -> Any:
            return m.Vector3f(*(dr.dot(axis, v) for axis in self._axes))

        def _to_scene(self, v: Any) -> Any:
            ex, ey, ez = self._axes
            return ex * v.x + ey * v.y + ez * v.z

        def eval(self, si: Any, active: Any = True) -> Any:
            direction = self._to_frame(si.to_world(si.wi))
            return self._spectrum(self._radiance(si.uv, direction), active)

        # ---- sampling for receivers ----------------------------------------------------------

        def sample_direction(self, it: Any, sample: Any, active: Any = True) -> Any:
            x, per_area = self._positions.sample(sample)
            direction, distance = self._seen_from(it, x)
            cosine = direction.z
            front = cosine > 0.0
            density = per_area * (distance * distance) / dr.select(front, cosine, 1.0)
            ds = m.DirectionSample3f()
            self._place(ds, x, it.time)
            ds.d = -self._to_scene(direction)
            ds.dist = distance
            ds.pdf = dr.select(front, density, 0.0)
            ds.emitter = m.EmitterPtr(self) if jit else self
            weight = self._received(it, x, per_area) / per_area
            return ds, self._spectrum(weight, active)

        def pdf_direction(self, it: Any, ds: Any, active: Any = True) -> Any:
            cosine = -dr.dot(ds.d, self._axes[2])
            front = cosine > 0.0
            per_area = self._positions.density(ds.uv)
            density = per_area * (ds.dist * ds.dist) / dr.select(front, cosine, 1.0)
            return dr.select(front, density, 0.0)

        def eval_direction(self, it: Any, ds: Any, active: Any = True) -> Any:
            direction, distance = self._seen_from(it, ds.uv)
            front = direction.z > 0.0
            per_angle = (distance * distance) / dr.select(front, direction.z, 1.0)
            received = self._received(it, ds.uv, self._positions.density(ds.uv))
            return self._spectrum(received * per_angle, active)

        def _received(self, it: Any, x: Any, per_area: Any) -> Any:
            """L cos/r^2 at the point ``it``, the mean over the places that a sample stands for.

            With a control variate: less what the direction from the middle would give at these
            places, plus the integral of that, dealt out in proportion to the density of samples.
            """
            total = 0.0
            if self.spec.control_variate:
                middle, distance = self._seen_from(it, m.Point2f(0.0))
                fixed = middle.z / (distance * distance) * self._cosines(it, x, middle)
                total = self._intensity(middle) * fixed * per_area
            for shift, weight in self._shifts:
                place = x + shift
                direction, distance = self._seen_from(it, place)
                found = self._radiance(place, direction) * direction.z / (distance * distance)
                if self.spec.control_variate:
                    found = found - self._radiance(place, middle) * fixed
                total = total + weight * found
            return total

        def _cosines(self, it: Any, x: Any, middle: Any) -> Any:
            """The receiver's cosine towards the middle over that towards x, by which it multiplies.

            1 where there is no surface (fog has no normal), or only one of the two is in front.
            """
            normal = self._to_frame(it.n)
            own, other = dr.dot(normal, self._seen_from(it, x)[0]), dr.dot(normal, middle)
            same_side = own * other > 0.0
            return dr.select(same_side, other / dr.select(same_side, own, 1.0), 1.0)

        def _seen_from(self, it: Any, x: Any) -> tuple[Any, Any]:
            """Unit vector, in the frame, from x to the point ``it``; and the distance."""
            r = self._to_frame(it.p - self._origin) - m.Vector3f(x.x, x.y, 0.0)
            distance = dr.norm(r)
            return r / distance, distance

        def _place(self, sample: Any, x: Any, time: Any) -> None:
            """Fill in what all samples of the position x have in common."""
            ex, ey, ez = self._axes
            sample.p = self._origin + ex * x.x + ey * x.y
            sample.n = m.Normal3f(ez)
            sample.uv = x
            sample.time = m.Float(time)
            sample.delta = m.Bool(False)

        # ---- sampling of the emitted field ---------------------------------------------------

        def sample_position(self, time: Any, sample: Any, active: Any = True) -> Any:
            ps = m.PositionSample3f()
            x, per_area = self._positions.sample(sample)
            self._place(ps, x, time)
            ps.pdf = m.Float(per_area)
            return ps, dr.select(active, m.Float(1.0 / per_area), 0.0)

        def pdf_position(self, ps: Any, active: Any = True) -> Any:
            return dr.select(active, m.Float(self._positions.density(ps.uv)), 0.0)

        def sample_ray(
            self, time: Any, sample1: Any, sample2: Any, sample3: Any, active: Any = True
        ) -> Any:
            """Position as for receivers, direction by cosine: the weight's mean is the power."""
            ps, share = self.sample_position(time, sample2, active)
            direction = m.warp.square_to_cosine_hemisphere(sample3)
            wavelengths, density = _optical_wavelengths(m, sample1)
            si = m.SurfaceInteraction3f(ps, wavelengths)
            si.time = time
            weight = self._spectrum(self._radiance(ps.uv, direction) * share * dr.pi, active)
            return si.spawn_ray(self._to_scene(direction)), weight * density

        def sample_wavelengths(self, si: Any, sample: Any, active: Any = True) -> Any:
            """For the particle tracer alone, which passes the direction in scene coordinates."""
            wavelengths, density = _optical_wavelengths(m, sample)
            radiance = self._radiance(si.uv, self._to_frame(si.wi))
            return wavelengths, self._spectrum(radiance, active) * density

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


def _single(number: Any, name: str) -> float:
    values = np.asarray(dr.detach(number), dtype=np.float64).ravel()
    if values.size != 1 or not np.isfinite(values).all():
        raise SceneError(f"expected one finite number as {name}, got {values.tolist()}")
    return float(values[0])


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
