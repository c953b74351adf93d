"""The exact field of a source, traced into a render kernel: the estimator ``exact``. Source: (B3).

The boundary integrals of :func:`polywigner.amplitude` are evaluated in single precision. One loop
visits pieces of edges, and the number of nodes depends on the piece and the point. At distances of
three wavelengths or more, a sum over equivalent points (B8) replaces the integrals if it is faster.

Lengths are in wavelengths, relative to the centre of the source.
"""

from __future__ import annotations

import math
import operator
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial, reduce
from typing import TYPE_CHECKING, Any, ClassVar

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from polywigner.errors import SceneError
from polywigner.execution import Drjit, NumpyOperations, ops_for
from polywigner.geometry import Wavefront
from polywigner.kernels.boundary import integrals
from polywigner.kernels.boundary.integrals import distance_of
from polywigner.mitsuba.plugins.mixtures import SceneSource
from polywigner.mitsuba.plugins.samplers import cells_with_field, four, opaque
from polywigner.mitsuba.plugins.source_parameters import SourceParameters
from polywigner.numerics import phases
from polywigner.numerics.complex_pairs import Pair
from polywigner.numerics.phases import cos_sin_turns
from polywigner.propagation.boundary import Radiator, boundary_tables, panels_in, radiator_of
from polywigner.propagation.equivalent_points import equivalent_grid
from polywigner.source.normal_form import SourceElement, normal_form
from polywigner.source.obliquities import CONDITIONS, Obliquity
from polywigner.transforms.wavefronts import principal_axes

if TYPE_CHECKING:
    from polywigner.mitsuba.plugins.diffraction import Shadows
    from polywigner.mitsuba.plugins.emitter import WignerEmitter

Floats = NDArray[np.float64]
Complexes = NDArray[np.complex128]

# The points of the shorter side of a grid are code of the kernel: a point takes 5 ms to compile and
# half the run time of a loop. A panel takes as long as 33 points (benchmarks/render_exact.py).
_MOST_POINTS, _POINTS_PER_PANEL = 64, 33

AWAY = 3.0
"""Distance from the source's bounds, in wavelengths, at which equivalent points may be used. For
squares, an L, chevrons, tapers and arrays of up to 10 wavelengths, the measured error of |U|^2 is
7e-5 of its peak beyond this distance, and 1e-3 at a third of it."""
# Error of |F|^2 relative to its peak, a seventh of the specified error of |U|^2.
_ERROR = 1.5e-5
# Imaginary parts of weights below this fraction of the largest weight are rounding.
_ROUNDING = 1e-9


@dataclass(frozen=True)
class EquivalentSources:
    """Points of a grid in the plane of a source, with their amplitudes."""

    half: tuple[float, ...]
    """Half the width and height of the source's bounds in wavelengths."""
    along: tuple[float, ...]
    """Positions of the points on a line, divided by half its length."""
    lines: tuple[tuple[float, ...], ...]
    """Position of a line, then the weights of its points: for the field and for the slope, if the
    condition has these, as real parts or as real and imaginary parts."""
    is_real: bool
    has_field: bool
    is_swapped: bool
    """Whether lines are along x instead of y."""

    def field(self, ops: Any, half: Any, x: Drjit, y: Drjit, z: Drjit) -> tuple[Drjit, Drjit]:
        """Return the field at a point, without the phase of the distance from the centre."""
        distance = ops.sqrt(x * x + (y * y + z * z))
        length = half[0] if self.is_swapped else half[1]
        aside, along = (y, x) if self.is_swapped else (x, y)
        nodes = [length * share for share in self.along]
        points = [(along - node, node * (node - 2.0 * along)) for node in nodes]

        def line(at: Drjit, *weights: Drjit) -> tuple[Drjit, Drjit]:
            step = len(weights) // len(points)
            across = aside - at
            foot2, shift = across * across + z * z, at * (at - 2.0 * aside)
            total = Pair(0.0, 0.0)
            for k, (offset, own_shift) in enumerate(points):
                radius = ops.sqrt(offset * offset + foot2)
                # one division for 1/radius, and for the cycles over radius + distance
                sum_ = radius + distance
                both = 1.0 / (radius * sum_)
                inverse = sum_ * both
                wave = Pair(*cos_sin_turns(ops, (shift + own_shift) * (radius * both)))
                some = weights[k * step : (k + 1) * step]
                total = total + self._sent(z * inverse, inverse, wave.scaled(inverse), some)
            return total.real, total.imag

        real, imag = ops.sum_over(self.lines, line, 2, like=x, unroll=False)
        return real, imag

    def _sent(self, cosine: Drjit, inverse: Drjit, wave: Pair, weights: tuple[Drjit, ...]) -> Pair:
        """Return the wave of one point, including the term 1/(k r) of its near field."""
        step = 1 if self.is_real else 2
        total = Pair(0.0, 0.0)
        for k in range(0, len(weights), step):
            part = wave
            if self.has_field and k == 0:
                near = inverse * (1 / (2 * math.pi))
                part = Pair(wave.real - wave.imag * near, wave.imag + wave.real * near)
                part = part.scaled(cosine)
            is_real = self.is_real
            part = part.scaled(weights[k]) if is_real else part * Pair(*weights[k : k + 2])
            total = part if k == 0 else total + part
        return total


def equivalent_sources(
    source: SceneSource, radiator: Radiator, wavelength: float, condition: Obliquity, panels: int
) -> EquivalentSources | None:
    """Return equivalent points of a source; None if a sum over ``panels`` edges is faster."""

    def pays(counts: Sequence[int]) -> bool:
        return min(counts) <= _MOST_POINTS and math.prod(counts) <= _POINTS_PER_PANEL * panels

    grid = equivalent_grid(source, radiator, wavelength, condition, _ERROR, pays)
    if grid is None:
        return None
    # in lines: the code is as long as the shorter side of the grid
    half, nodes, table = grid.half, grid.nodes, np.stack(grid.weights, axis=-1)
    is_swapped = len(nodes[0]) < len(nodes[1])
    across, along = (1, 0) if is_swapped else (0, 1)
    table = np.swapaxes(table, 0, 1) if is_swapped else table
    is_real = bool(np.abs(table.imag).max() < _ROUNDING * np.abs(table).max())
    parts = table.real if is_real else np.stack([table.real, table.imag], axis=-1)
    rows = np.column_stack([half[across] * nodes[across], parts.reshape(len(parts), -1)])
    return EquivalentSources(
        tuple(half.tolist()),
        tuple(nodes[along].tolist()),
        tuple(map(tuple, rows.tolist())),
        is_real,
        bool(condition.field),
        is_swapped,
    )


FIXED = (
    'expected derivatives only in the power and in reflectances with the estimator "exact", got '
    'derivatives in a position, an outline, weights or the wavelength; use the estimator "wigner"'
)
# Largest number of panels; each takes some 50 ns of one core per sample.
_MOST_PANELS = 8192
# Log of the inverse error of a panel's integral relative to its integrand, a third of the specified
# error 1e-4 of |U|^2. The measured error of |U|^2 is 3e-5 of its peak.
_DIGITS = math.log(3e4)
# Longest panel in wavelengths. Panels twice as long as the distance are cheapest; closer points use
# graded rules.
_LONGEST = 12.0


class ExactEstimator:
    """Estimator of irradiance and ray weights from the exact field U of the entire source."""

    needs_distance = True
    is_constant = True
    density: None = None
    """None, because a point is illuminated by all of the source at once."""
    scene_is_known: ClassVar[bool] = False
    """Whether a render has passed its scene. Kernels also contain the sources of other scenes."""

    def __init__(self, m: Any, spec: SourceParameters, wavelength: float, _: object) -> None:
        self._m, self._unit = m, spec.scene_unit
        source = spec.at_origin
        self.draw = cells_with_field(m, source, self._unit).sample
        """Return a position with density |u|^2, from which a ray tests for obstacles."""
        self._fields = [
            (ExactField(m, field, wavelength, spec.obliquity), stokes)
            for field, stokes in spec.fields_of(source)
        ]
        self._scale = opaque(m, wavelength**2 * self._unit**2 / spec.norm)
        self._diffracts = spec.diffraction
        self._shadows: Shadows | None = None
        self.shadows_key = ""
        """Digest of the scene whose shadows were set; empty before."""

    @staticmethod
    def check(spec: SourceParameters) -> None:
        """Raise SceneError for a source that this estimator does not support."""
        if not spec.mixture.is_plain:
            raise SceneError(
                'expected coherent light of one wavelength with the estimator "exact", got '
                f'{spec.mixture}; use the estimator "wigner"'
            )
        if spec.diffraction and spec.has_several:
            raise SceneError(
                "expected one polarisation of all elements with diffraction, got several; leave "
                "diffraction out"
            )
        if spec.obliquity not in CONDITIONS:
            raise SceneError(
                f'expected a boundary condition as obliquity with the estimator "exact", got '
                f'{spec.obliquity!r}; use one of {", ".join(CONDITIONS)}, or the estimator "wigner"'
            )
        count = panels_in(radiator_of(plane_waves_of(spec.source)), spec.wavelength, _LONGEST)
        if not count <= _MOST_PANELS:
            raise SceneError(
                f"expected at most {_MOST_PANELS} pieces of edges, once for each wave, with the "
                f'estimator "exact", got {count:.0f}; use the estimator "wigner"'
            )

    def lit(self, light: WignerEmitter, it: mi.Interaction3f, x: mi.Point2f) -> Drjit:
        """Return |U|^2 at the point ``it``; the surface there multiplies it by its cosine."""
        if light.has_gradients():
            raise SceneError(FIXED)
        point = light.frame.to_own(it.p - light.frame.origin)
        front = point.z > 0.0
        value = self.intensity(self._m.Point3f(point.x, point.y, dr.select(front, point.z, 1.0)))
        return dr.select(front, value * light.watts_per_norm(), 0.0)

    def received(
        self, x: Drjit, direction: Drjit, point: Drjit = None, distance: Drjit = None
    ) -> Drjit:
        """Return lambda^2 r^2 |U|^2/N at the point where the ray ends."""
        return self._scale * (distance * distance) * self.intensity(point)

    def set_shadows(self, key: str, shadows: Shadows | None) -> None:
        """Set the shadows in a scene with the digest ``key``; None without obstacles."""
        self.shadows_key, self._shadows = key, shadows

    def intensity(self, point: mi.Point3f) -> Drjit:
        """Return |U|^2 at a point in front in scene units, relative to |u|^2 = 1."""
        if self._diffracts and not self.shadows_key and not self.scene_is_known:
            message = (
                "expected the scene of a source or a receiver with diffraction, got none from "
                "Mitsuba; render with polywigner.mitsuba.render, or within `with "
                "polywigner.mitsuba.receiving(scene)`"
            )
            if not dr.is_jit_v(self._m.Float):
                raise SceneError(message)
            # no error: Dr.Jit also traces the sources of scenes that are not rendered
            warnings.warn(f"{message}. Its light is NaN", RuntimeWarning, stacklevel=2)
            return self._m.Float(math.nan)
        if self._shadows is not None:
            free = partial(self._fields[0][0].intensity, unit=self._unit)
            return self._shadows.either(point, free)
        values = [four(self._m, s, f.intensity(point, self._unit)) for f, s in self._fields]
        return reduce(operator.add, values)


class ExactField:
    """|U|^2 of a source in coherent light for one variant's arrays."""

    def __init__(self, m: Any, source: SceneSource, wavelength: float, obliquity: str) -> None:
        source, condition = plane_waves_of(source), CONDITIONS[obliquity]
        self._m, self._jit = m, dr.is_jit_v(m.Float)
        # scalar variants have one sample: NumPy evaluates all panels and nodes at once
        self._ops = ops_for(m.Float) if self._jit else NumpyOperations()
        radiator = radiator_of(source)
        self._tables = boundary_tables(
            radiator, wavelength, _LONGEST, self._ops.double, condition.field
        )
        self._centre = [opaque(m, c) for c in (radiator.centre / wavelength).tolist()]
        self._inverse = opaque(m, 1 / wavelength)
        panels = len(self._tables.edges)
        self._points = equivalent_sources(source, radiator, wavelength, condition, panels)
        if self._points is not None:
            self._half = [opaque(m, half) for half in self._points.half]

    def intensity(self, point: mi.Point3f, unit: float) -> Drjit:
        """Return |U|^2 at a point in front in units of ``unit`` metres, relative to |u|^2 = 1."""
        # Dr.Jit's derivatives of nested loops are zero without an error
        if self._jit and dr.grad_enabled(point):
            raise SceneError(FIXED)
        x, y, z = (c * (unit * self._inverse) for c in (point.x, point.y, point.z))
        x, y = x - self._centre[0], y - self._centre[1]
        if not self._jit:
            x, y, z = (np.array([value]) for value in (x, y, z))
        real, imag = self._field(x, y, z)
        value = real * real + imag * imag
        return value if self._jit else float(value[0])

    def _field(self, x: Drjit, y: Drjit, z: Drjit) -> tuple[Drjit, Drjit]:
        if self._points is None:
            return self._near(x, y, z)
        half_x, half_y = self._half
        away = (z > AWAY) | (abs(x) > half_x + AWAY) | (abs(y) > half_y + AWAY)
        points = partial(self._points.field, self._ops, self._half)
        if self._jit:
            return dr.if_stmt((x, y, z), away, points, self._near, mode="symbolic")
        return (points if away[0] else self._near)(x, y, z)

    def _near(self, x: Drjit, y: Drjit, z: Drjit) -> tuple[Drjit, Drjit]:
        """Return the integrals along the edges."""
        # coordinates and distance from the centre as pairs of floats; the phase is not shifted
        if self._jit:  # the distance as two float32 numbers, from float64
            m = self._m
            wide = ops_for(m.Float64)
            point = tuple((m.Float64(value), 0.0) for value in (x, y, z))
            distance: Sequence[Drjit] = [
                m.Float(half) for half in phases.halves(wide, distance_of(wide, point))
            ]
            zero, digits = m.Float(0.0), m.Float(_DIGITS)
        else:
            distance = distance_of(self._ops, ((x, 0.0), (y, 0.0), (z, 0.0)))
            zero, digits = np.zeros(1), np.full(1, _DIGITS)
        arguments = (x, zero, y, zero, z, zero, *distance, zero, digits)
        real, imag, _ = integrals.edge_sum(self._ops, self._tables, *arguments)
        return real, imag


# ---- curved waves as sums of plane waves ---------------------------------------------------------

# Error of the sum of plane waves relative to the modulus of the curved wave; largest sum of their
# moduli, which rounding multiplies by 6e-8; and tested periods of the waves over the size of an
# element. Shorter periods need more waves, longer periods have larger amplitudes.
_CURVED_ERROR, _LARGEST_SUM, _PERIODS = 1e-5, 30.0, (1.2, 1.5, 2.0, 3.0)
# Singular values below this fraction of the largest are rounding errors; largest number of waves
# along an axis.
_SINGULAR, _MOST_WAVES = 1e-9, 64


@lru_cache(maxsize=16)
def plane_waves_of(source: SceneSource) -> SceneSource:
    """Return a source with its curved wave as a sum of plane waves on each of its elements."""
    if not isinstance(source, Wavefront):
        return source
    flat = normal_form(source.source)
    elements = [_curved(element, source) for element in flat.in_plane.elements]
    result: SceneSource = flat.with_elements(elements).public
    return result


def _curved(element: SourceElement, wave: Wavefront) -> SourceElement:
    """Return an element times the curved wave, which is a product over two axes."""
    curvatures, axes = principal_axes(wave.curvature)
    corners = (np.concatenate(element.rings) - wave.centre) @ axes
    amplitudes, frequencies = element.amplitudes, element.frequencies
    for q, along, axis in zip(curvatures.tolist(), corners.T, axes.T, strict=True):
        values, waves = _chirp(q, float(along.min()), float(along.max()))
        values = values * np.exp(-2j * math.pi * waves * (wave.centre @ axis))
        amplitudes = np.outer(amplitudes, values).ravel()
        frequencies = (frequencies[:, None] + waves[:, None] * axis).reshape(-1, 2)
    return replace(element, amplitudes=amplitudes, frequencies=frequencies)


def _chirp(q: float, low: float, high: float) -> tuple[Complexes, Floats]:
    """Return amplitudes and frequencies of waves that add up to exp(i pi q y^2) on an interval."""
    centre, size = (low + high) / 2, high - low
    cycles = abs(q) * size * size
    waves: tuple[Complexes, Floats] | None = np.ones(1, np.complex128), np.zeros(1)
    if cycles >= _CURVED_ERROR:
        count = 8 * math.ceil(min(cycles, _MOST_WAVES) + 20)
        y = -np.cos(np.linspace(0.0, math.pi, count)) * size / 2
        chirp = np.exp(1j * math.pi * q * y * y)
        # the chirp's frequencies span one step of 1/size per cycle
        fits = (
            _fit(y, chirp, np.linspace(-0.5, 0.5, n) * ((n - 1) / (period * size)))
            for n in range(3 + 2 * int(min(cycles, _MOST_WAVES) / 2), _MOST_WAVES + 1, 2)
            for period in _PERIODS
        )
        waves = next((fit for fit in fits if fit is not None), None)
    if waves is None:
        raise SceneError(
            'expected a wave of less curvature with the estimator "exact", got one with '
            f"{cycles / 8:.3g} cycles from the centre to the edge of its element; use the "
            'estimator "wigner"'
        )
    amplitudes, frequencies = waves
    # with y relative to the centre m: q y^2 = q (y - m)^2 + 2 q m (y - m) + q m^2
    shifted = frequencies + q * centre
    phase = q * centre * centre / 2 - shifted * centre
    return amplitudes * np.exp(2j * math.pi * phase), shifted


def _fit(y: Floats, values: Complexes, frequencies: Floats) -> tuple[Complexes, Floats] | None:
    """Return waves that add up to values at y; None if the error or amplitudes are too large."""
    waves = np.exp(2j * math.pi * np.outer(y, frequencies))
    fit = np.asarray(np.linalg.lstsq(waves, values, rcond=_SINGULAR)[0], np.complex128)
    fits = np.abs(waves @ fit - values).max() <= _CURVED_ERROR
    return (fit, frequencies) if fits and np.abs(fit).sum() <= _LARGEST_SUM else None
