"""Sampling of the emitter inside a ``wigner`` shape, for receivers and for emitted rays."""

from __future__ import annotations

from functools import cache
from typing import Any

import drjit as dr
import mitsuba as mi

__all__ = ["sampled_emitter_class"]


@cache
def sampled_emitter_class(variant: str) -> Any:
    """The base of the emitter's class for one variant, which has no radiance yet.

    What it is built on has ``_positions`` to draw from, ``_shifts``, the frame's ``_axes`` and
    ``_origin``, ``_radiance`` and ``_intensity``.
    """
    m = getattr(mi, variant)
    jit = dr.is_jit_v(m.Float)

    base: Any = m.Emitter

    class SampledEmitter(base):
        """Not a plugin of its own."""

        def _spectrum(self, value: Any, active: Any) -> Any:
            # One narrow band: the same value in every channel or at every sampled wavelength.
            return m.depolarizer(m.UnpolarizedSpectrum(dr.select(active, value, 0.0)))

        def _to_frame(self, v: Any) -> Any:
            return m.Vector3f(*(dr.dot(axis, v) for axis in self._axes))

        def _to_scene(self, v: Any) -> Any:
            ex, ey, ez = self._axes
            return ex * v.x + ey * v.y + ez * v.z

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
            # As for a point light: no sampled reflection meets a surface that is not there.
            ds.delta = m.Bool(not self.spec.visible)
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

    return SampledEmitter


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
