"""The estimator ``exact``, which evaluates the field of a source in render kernels.

Boundary integrals, (B3) of docs/theory/exact_fields.md, are evaluated in single precision. At
distances of three wavelengths or more, a sum over equivalent point sources, (B8), replaces these
integrals if the sum is faster. Lengths are in wavelengths, relative to the centre of the source.
"""

from __future__ import annotations

import math
import operator
import warnings
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import lru_cache, partial, reduce
from typing import TYPE_CHECKING, Any, ClassVar

import drjit as dr
import mitsuba as mi
import numpy as np

from polywigner.errors import SceneError
from polywigner.execution import Drjit, NumpyOperations, ops_for
from polywigner.geometry import Wavefront
from polywigner.geometry.arguments import check_most
from polywigner.kernels.boundary import integrals
from polywigner.kernels.boundary.integrals import distance_of
from polywigner.mitsuba.plugins.mixtures import SceneSource
from polywigner.mitsuba.plugins.samplers import cells_with_field, opaque, times_stokes
from polywigner.mitsuba.plugins.source_parameters import SourceParameters
from polywigner.numerics import Complex, Floats, phases
from polywigner.numerics.phases import Pair
from polywigner.propagation.boundary import Radiator, boundary_tables, panels_in, radiator_of
from polywigner.propagation.equivalent_points import equivalent_grid, wave_ahead
from polywigner.source.normal_form import SourceElement, normal_form
from polywigner.source.obliquities import CONDITIONS, Obliquity
from polywigner.transforms.wavefronts import principal_axes

if TYPE_CHECKING:
    from polywigner.mitsuba.plugins.diffraction import Shadows
    from polywigner.mitsuba.plugins.emitter import WignerEmitter


# Largest number of equivalent points on the shorter side of their grid. Each point adds code to the
# kernel that takes 5 ms to compile.
_MOST_POINTS = 64
# Cost of a panel relative to the cost of an equivalent point (benchmarks/render_exact.py).
_POINTS_PER_PANEL = 25

AWAY = 3.0
"""Distance from a source's bounding box [wavelengths] beyond which equivalent points are used.

Beyond this distance, the measured error of |U|^2 is 7e-5 of its peak, for sources up to 10
wavelengths in size.
"""
# Tolerance of the far-field pattern |F|^2 relative to its peak.
_ERROR = 1.5e-5


def equivalent_point_field(
    source: SceneSource, radiator: Radiator, wavelength: float, condition: Obliquity, panels: int
) -> tuple[Floats, Callable[..., tuple[Drjit, Drjit]]] | None:
    """Return the half-widths of a source in wavelengths, and the field of its equivalent points.

    The field is a function ``field(ops, half, x, y, z)`` of the operations, the half-widths and a
    position in wavelengths. This function returns the real and imaginary parts, without the phase
    due to the distance from the centre. The result is None if a sum over panels is faster.
    """

    def pays(counts: Sequence[int]) -> bool:
        """Return whether a grid with these numbers of points is faster than the panels."""
        return min(counts) <= _MOST_POINTS and math.prod(counts) <= _POINTS_PER_PANEL * panels

    grid = equivalent_grid(source, radiator, wavelength, condition, _ERROR, pays)
    if grid is None:
        return None
    # Code size is proportional to the number of points on a line, so lines run along the shorter
    # side.
    is_swapped = len(grid.nodes[0]) < len(grid.nodes[1])
    (half, _), (positions, nodes) = grid.half, grid.nodes
    table = np.stack(grid.weights, axis=-1)
    if is_swapped:
        (_, half), (nodes, positions), table = grid.half, grid.nodes, np.swapaxes(table, 0, 1)
    parts = np.stack([table.real, table.imag], axis=-1)
    lines = np.column_stack([half * positions, parts.reshape(len(parts), -1)]).tolist()
    has_field, none = bool(condition.field), (0.0, 0.0)

    def field(ops: Any, half: Sequence[Drjit], x: Drjit, y: Drjit, z: Drjit) -> tuple[Drjit, Drjit]:
        distance = ops.sqrt(x * x + (y * y + z * z))
        length, aside, along = (half[0], y, x) if is_swapped else (half[1], x, y)

        def line(at: Drjit, *weights: Drjit) -> tuple[Drjit, Drjit]:
            """Return the field of the equivalent points on a line at the position ``at``."""
            step = len(weights) // len(nodes)
            total = Pair(0.0, 0.0)
            for k, node in enumerate(length * position for position in nodes.tolist()):
                ahead = aside - at, along - node, z
                radius = ops.sqrt(sum(c * c for c in ahead))
                excess = at * (at - 2.0 * aside) + node * (node - 2.0 * along)
                of_node = weights[k * step : (k + 1) * step]
                of_field = of_node[:2] if has_field else none
                of_slope = of_node[-2:] if step > 2 * has_field else none
                turns = excess / (radius + distance)
                total = total + wave_ahead(ops, ahead, of_field, of_slope, turns)
            return total.real, total.imag

        real, imag = ops.sum_over(lines, line, 2, like=x, unroll=False)
        return real, imag

    return grid.half, field


FIXED = (
    'with the estimator "exact", derivatives are available only with respect to powers and '
    "reflectances, but derivatives with respect to a position, an outline, weights or the "
    'wavelength are enabled; use the estimator "wigner"'
)
# Largest number of panels; each panel takes 50 ns per sample on one core.
_MOST_PANELS = 8192
# Negative natural logarithm of the relative tolerance of a panel integral.
_DIGITS = math.log(3e4)
# Largest length of a panel [wavelengths], chosen for speed.
_LONGEST = 12.0


class ExactEstimator:
    """Estimator of irradiance and ray weights from the exact field of a source."""

    needs_distance = True
    is_constant = True
    density: None = None
    """None, because the entire source illuminates each point."""
    scene_is_known: ClassVar[bool] = False
    """Whether the scene that is being rendered has been passed to the plugins."""

    def __init__(self, m: Any, spec: SourceParameters, wavelength: float, _: object) -> None:
        self._m, self._unit = m, spec.scene_unit
        source = spec.at_origin
        self.draw = cells_with_field(m, source, self._unit).sample
        """Sampler of the positions where shadow rays end, with the density |u|^2."""
        self._fields = [
            (ExactField(m, field, wavelength, spec.obliquity), stokes)
            for field, stokes in spec.fields_of(source)
        ]
        self._scale = opaque(m, wavelength**2 * self._unit**2 / spec.norm)
        self._diffracts = spec.diffraction
        self._shadows: Shadows | None = None
        self.shadows_key = ""
        """Digest of the scene for which shadows are set; empty if there is none."""

    @staticmethod
    def check(spec: SourceParameters) -> None:
        """Raise SceneError if this estimator does not support the source."""
        if not spec.mixture.is_plain:
            raise SceneError(
                'the estimator "exact" requires coherent light of a single wavelength, got '
                f'{spec.mixture}; use the estimator "wigner"'
            )
        if spec.diffraction and spec.has_several:
            raise SceneError(
                "diffraction requires the same polarisation for all elements, got several "
                "polarisations; omit diffraction"
            )
        if spec.obliquity not in CONDITIONS:
            raise SceneError(
                'the estimator "exact" requires a boundary condition as obliquity, got '
                f"{spec.obliquity!r}; use one of {', '.join(CONDITIONS)}, or the estimator "
                '"wigner"'
            )
        count = panels_in(radiator_of(plane_waves_of(spec.source)), spec.wavelength, _LONGEST)
        things = "pieces of the edges of a source, counted once for each plane wave"
        check_most(count, _MOST_PANELS, things, 'use the estimator "wigner"', SceneError)

    def irradiance(self, light: WignerEmitter, it: mi.Interaction3f, x: mi.Point2f) -> Drjit:
        """Return the exact irradiance |U|^2 at a point in W/m^2, without the cosine of incidence.

        The irradiance is zero behind the source, and ``x`` is not used. Raises SceneError if
        derivatives with respect to the source are enabled.
        """
        if light.has_gradients():
            raise SceneError(FIXED)
        point = light.frame.to_local(it.p - light.frame.origin)
        front = point.z > 0.0
        value = self.intensity(self._m.Point3f(point.x, point.y, dr.select(front, point.z, 1.0)))
        return dr.select(front, value * light.power_scale(), 0.0)

    def received(
        self, x: Drjit, direction: Drjit, point: Drjit = None, distance: Drjit = None
    ) -> Drjit:
        """Return the weight lambda^2 r^2 |U|^2/N of a ray in m^2, where U is the field at its end.

        N is the norm of the receiver in W. The end ``point``, in the receiver's frame, and the
        length r = ``distance`` are in scene units; ``x`` and ``direction`` are not used.
        """
        return self._scale * (distance * distance) * self.intensity(point)

    def set_shadows(self, key: str, shadows: Shadows | None) -> None:
        """Set the shadows of the scene with the digest ``key``, or None without obstacles."""
        self.shadows_key, self._shadows = key, shadows

    def intensity(self, point: mi.Point3f) -> Drjit:
        """Return the irradiance |U|^2 at a point in scene units, for a source with |u|^2 = 1.

        The point is in the source's frame. For elements with several polarisations, the result is a
        Stokes vector. If diffraction requires a scene that is not known, the result is NaN with a
        warning, or a SceneError in scalar variants.
        """
        if self._diffracts and not self.shadows_key and not self.scene_is_known:
            message = (
                "a source or a receiver with diffraction requires its scene, which Mitsuba does "
                "not pass; render with polywigner.mitsuba.render, or within `with "
                "polywigner.mitsuba.receiving(scene)`"
            )
            if not dr.is_jit_v(self._m.Float):
                raise SceneError(message)
            # Dr.Jit also traces sources of scenes that are not rendered, so an error would be
            # wrong.
            warnings.warn(
                f"{message}. The light of this source is NaN", RuntimeWarning, stacklevel=2
            )
            return self._m.Float(math.nan)
        if self._shadows is not None:
            free = partial(self._fields[0][0].intensity, unit=self._unit)
            return self._shadows.intensity_or_free(point, free)
        values = [times_stokes(self._m, s, f.intensity(point, self._unit)) for f, s in self._fields]
        return reduce(operator.add, values)


class ExactField:
    """Exact irradiance |U|^2 of a coherent source, for the arrays of one variant."""

    def __init__(self, m: Any, source: SceneSource, wavelength: float, obliquity: str) -> None:
        source, condition = plane_waves_of(source), CONDITIONS[obliquity]
        self._m, self._jit = m, dr.is_jit_v(m.Float)
        # Scalar variants compute one sample at a time, so NumPy evaluates all nodes together.
        self._ops = ops_for(m.Float) if self._jit else NumpyOperations()
        radiator = radiator_of(source)
        self._tables = boundary_tables(
            radiator, wavelength, _LONGEST, self._ops.double, condition.field
        )
        self._centre = [opaque(m, c) for c in (radiator.centre / wavelength).tolist()]
        self._inverse = opaque(m, 1 / wavelength)
        panels = len(self._tables.edges)
        self._points = equivalent_point_field(source, radiator, wavelength, condition, panels)
        if self._points is not None:
            self._half = [opaque(m, half) for half in self._points[0].tolist()]

    def intensity(self, point: mi.Point3f, unit: float) -> Drjit:
        """Return the exact irradiance |U|^2 at a point, for a source with |u|^2 = 1.

        Coordinates are in units of ``unit`` metres.
        """
        # Dr.Jit silently returns zero derivatives for nested loops.
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
        """Return the complex field at a point in wavelengths, without the phase of the distance."""
        if self._points is None:
            return self._panel_field(x, y, z)
        half_x, half_y = self._half
        away = (z > AWAY) | (abs(x) > half_x + AWAY) | (abs(y) > half_y + AWAY)
        points = partial(self._points[1], self._ops, self._half)
        if self._jit:
            return dr.if_stmt((x, y, z), away, points, self._panel_field, mode="symbolic")
        return (points if away[0] else self._panel_field)(x, y, z)

    def _panel_field(self, x: Drjit, y: Drjit, z: Drjit) -> tuple[Drjit, Drjit]:
        """Return the field at a point in wavelengths by boundary integrals over panels."""
        # The function edge_sum requires each coordinate and the distance as a sum of two floats.
        if self._jit:
            m = self._m
            wide = ops_for(m.Float64)
            point = tuple((m.Float64(value), 0.0) for value in (x, y, z))
            distance: Sequence[Drjit] = [
                m.Float(half) for half in phases.split(wide, distance_of(wide, point))
            ]
            zero, digits = m.Float(0.0), m.Float(_DIGITS)
        else:
            distance = distance_of(self._ops, ((x, 0.0), (y, 0.0), (z, 0.0)))
            zero, digits = np.zeros(1), np.full(1, _DIGITS)
        arguments = (x, zero, y, zero, z, zero, *distance, zero, digits)
        real, imag, _ = integrals.edge_sum(self._ops, self._tables, *arguments)
        return real, imag


# Tolerance for the approximation of a curved wave by a sum of plane waves, relative to the wave's
# modulus.
_CURVED_ERROR = 1e-5
# Largest sum of the moduli of plane waves; the rounding error is 6e-8 times this sum.
_LARGEST_SUM = 30.0
# Trial periods of the sum of plane waves, relative to the size of an element. Short periods need
# more waves, and long periods larger amplitudes.
_PERIODS = (1.2, 1.5, 2.0, 3.0)
# Cutoff for singular values, relative to the largest singular value.
_CUTOFF = 1e-9
# Largest number of plane waves per axis.
_MOST_WAVES = 64


@lru_cache(maxsize=16)
def plane_waves_of(source: SceneSource) -> SceneSource:
    """Return a source whose curved wave is replaced by a sum of plane waves on each element.

    A source without a curved wave is returned unchanged. Raises SceneError for a large curvature.
    """
    if not isinstance(source, Wavefront):
        return source
    flat = normal_form(source.source)
    elements = [_times_curved_wave(element, source) for element in flat.in_plane.elements]
    result: SceneSource = flat.with_elements(elements).public
    return result


def _times_curved_wave(element: SourceElement, wave: Wavefront) -> SourceElement:
    """Multiply the field of an element by a curved wave, written as a sum of plane waves."""
    curvatures, axes = principal_axes(wave.curvature)
    corners = (np.concatenate(element.rings) - wave.centre) @ axes
    amplitudes, frequencies = element.amplitudes, element.frequencies
    for q, along, axis in zip(curvatures.tolist(), corners.T, axes.T, strict=True):
        values, waves = _waves_of_chirp(q, float(along.min()), float(along.max()))
        values = values * np.exp(-2j * math.pi * waves * (wave.centre @ axis))
        amplitudes = np.outer(amplitudes, values).ravel()
        frequencies = (frequencies[:, None] + waves[:, None] * axis).reshape(-1, 2)
    return replace(element, amplitudes=amplitudes, frequencies=frequencies)


def _waves_of_chirp(q: float, low: float, high: float) -> tuple[Complex, Floats]:
    """Approximate exp(i pi q y^2) for y from ``low`` to ``high`` by a sum of plane waves.

    Return the amplitudes and the frequencies of the waves exp(2 pi i frequency y).
    """
    centre, size = (low + high) / 2, high - low
    cycles = abs(q) * size * size
    waves: tuple[Complex, Floats] | None = np.ones(1, np.complex128), np.zeros(1)
    if cycles >= _CURVED_ERROR:
        count = 8 * math.ceil(min(cycles, _MOST_WAVES) + 20)
        y = -np.cos(np.linspace(0.0, math.pi, count)) * size / 2
        chirp = np.exp(1j * math.pi * q * y * y)
        fits = (
            _fitted_waves(y, chirp, np.linspace(-0.5, 0.5, n) * ((n - 1) / (period * size)))
            for n in range(3 + 2 * int(min(cycles, _MOST_WAVES) / 2), _MOST_WAVES + 1, 2)
            for period in _PERIODS
        )
        waves = next((fit for fit in fits if fit is not None), None)
    if waves is None:
        raise SceneError(
            f'the curvature of the wave is too large for the estimator "exact": {cycles / 8:.3g} '
            "cycles of phase from the centre to the edge of an element; use the estimator "
            '"wigner"'
        )
    amplitudes, frequencies = waves
    shifted = frequencies + q * centre
    phase = q * centre * centre / 2 - shifted * centre
    return amplitudes * np.exp(2j * math.pi * phase), shifted


def _fitted_waves(y: Floats, values: Complex, frequencies: Floats) -> tuple[Complex, Floats] | None:
    """Fit amplitudes of plane waves to values at positions y, by least squares.

    Return amplitudes and frequencies, or None if the fit is inaccurate.
    """
    waves = np.exp(2j * math.pi * np.outer(y, frequencies))
    fit = np.asarray(np.linalg.lstsq(waves, values, rcond=_CUTOFF)[0], np.complex128)
    fits = np.abs(waves @ fit - values).max() <= _CURVED_ERROR
    return (fit, frequencies) if fits and np.abs(fit).sum() <= _LARGEST_SUM else None
