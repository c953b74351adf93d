"""The exact field of a source, traced into a render kernel: the estimator ``exact``. Source: (B3).

The boundary integrals are those of :func:`polywigner.amplitude` in single precision, one loop over
pieces of edges with as many nodes as piece and point need. From three wavelengths on it is a sum
over equivalent points instead, if these are few (B8). Where an aperture is in its far zone, or
every element of a large array in its own, it is the far field (RP1), or a sum over elements of far
fields with the exact phase and direction of each.

Lengths are in wavelengths, relative to the middle of the source.
"""

from __future__ import annotations

import math
import operator
import warnings
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import lru_cache, partial, reduce
from itertools import islice
from typing import TYPE_CHECKING, Any, ClassVar

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from polywigner.errors import ArgumentError, IlluminationError, SceneError
from polywigner.execution import Drjit, NumpyOperations, ops_for
from polywigner.geometry import Aperture, Wavefront
from polywigner.kernels.boundary import integrals
from polywigner.kernels.boundary.integrals import distance_of
from polywigner.mitsuba.plugins.emissions import SceneSource
from polywigner.mitsuba.plugins.samplers import cells_with_field, four, opaque
from polywigner.numerics import phases
from polywigner.numerics.complex_pairs import Pair
from polywigner.numerics.phases import cos_sin_turns
from polywigner.propagation.boundary import Radiator, boundary_tables, panels_in, radiator_of
from polywigner.propagation.equivalent_points import equivalent_grid
from polywigner.source import Array, Illumination
from polywigner.source.obliquities import (
    CONDITIONS,
    Obliquity,
    times_direction_cosine,
)
from polywigner.transforms import fourier
from polywigner.transforms.wavefronts import principal_axes

if TYPE_CHECKING:
    from polywigner.mitsuba.plugins.source_parameters import SourceParameters

Floats = NDArray[np.float64]
Complexes = NDArray[np.complex128]

# Points of the shorter side of a grid are code: each compiles in some 5 ms and runs twice as fast
# as a loop. A panel takes as long as so many points (benchmarks/render_exact.py).
_MOST_POINTS, _POINTS_PER_PANEL = 64, 33

AWAY = 3.0
"""Nearest distance from the bounds of the source in wavelengths. Measured before squares, an L,
chevrons, tapers and arrays of up to 10 wavelengths, |U|^2 was within 7e-5 of its peak from there
on, and within 1e-3 at a third of it."""
# Error allowed of |F|^2 over its peak, a seventh of what is promised of |U|^2.
_ERROR = 1.5e-5
# Imaginary part of weights, over the largest, that is rounding.
_ROUNDING = 1e-9


@dataclass(frozen=True)
class EquivalentSources:
    """Points of a grid in the plane of a source, with their amplitudes."""

    half: tuple[float, ...]
    """Half the sides of the bounds along x and y."""
    along: tuple[float, ...]
    """Places on a line over half its length."""
    lines: tuple[tuple[float, ...], ...]
    """Where a line is; then of each of its points the weights: of the field's share and of its
    slope's, as far as there are any, as real parts or as real and imaginary parts."""
    is_real: bool
    has_field: bool
    is_swapped: bool
    """Whether lines are along x instead of y."""

    def field(self, ops: Any, half: Any, x: Any, y: Any, z: Any) -> tuple[Drjit, Drjit]:
        """The field at a point, relative to the phase of the distance from the middle."""
        distance = ops.sqrt(x * x + (y * y + z * z))
        length = half[0] if self.is_swapped else half[1]
        aside, along = (y, x) if self.is_swapped else (x, y)
        points = []
        for place in (length * share for share in self.along):
            points.append((along - place, place * (place - 2.0 * along)))

        def line(at: Any, *weights: Any) -> tuple[Drjit, Drjit]:
            step = len(weights) // len(points)
            across = aside - at
            foot2, shift = across * across + z * z, at * (at - 2.0 * aside)
            total = Pair(0.0, 0.0)
            for k, (offset, own_shift) in enumerate(points):
                radius = ops.sqrt(offset * offset + foot2)
                # one division for 1/radius, and for the turns over radius + distance
                whole = radius + distance
                both = 1.0 / (radius * whole)
                inverse = whole * both
                wave = Pair(*cos_sin_turns(ops, (shift + own_shift) * (radius * both)))
                own = weights[k * step : (k + 1) * step]
                total = total + self._sent(z * inverse, inverse, wave.scaled(inverse), own)
            return total.real, total.imag

        real, imag = ops.sum_over(self.lines, line, 2, like=x, unroll=False)
        return real, imag

    def _sent(self, cosine: Any, inverse: Any, wave: Pair, weights: tuple[Any, ...]) -> Pair:
        """The waves of one point; of the field with Rayleigh and Sommerfeld's term in 1/(k r)."""
        step = 1 if self.is_real else 2
        waves = []
        for k in range(0, len(weights), step):
            own = wave
            if self.has_field and k == 0:
                near = inverse * (1 / (2 * math.pi))
                own = Pair(wave.real - wave.imag * near, wave.imag + wave.real * near)
                own = own.scaled(cosine)
            waves.append(
                own.scaled(weights[k]) if self.is_real else own * Pair(*weights[k : k + 2])
            )
        return waves[0] if len(waves) == 1 else waves[0] + waves[1]


def _sums_over_points(counts: Sequence[int], panels: int) -> bool:
    """Whether a sum over a grid of points takes less time than one over panels of edges."""
    return min(counts) <= _MOST_POINTS and math.prod(counts) <= _POINTS_PER_PANEL * panels


def equivalent_sources(
    source: Any, radiator: Radiator, wavelength: float, condition: Obliquity, panels: int
) -> EquivalentSources | None:
    """Equivalent points of a source; None where a sum over so many panels is faster."""
    grid = equivalent_grid(
        source, radiator, wavelength, condition, _ERROR, lambda n: _sums_over_points(n, panels)
    )
    if grid is None:
        return None
    # in lines: the code is as long as the shorter side of the grid
    half, nodes, table = grid.half, grid.nodes, np.stack(grid.weights, axis=-1)
    is_swapped = len(nodes[0]) < len(nodes[1])
    across, along = 0, 1
    if is_swapped:
        table, across, along = np.swapaxes(table, 0, 1), 1, 0
    is_real = bool(np.abs(table.imag).max() < _ROUNDING * np.abs(table).max())
    parts = table.real if is_real else np.stack([table.real, table.imag], axis=-1)
    rows = np.column_stack([half[across] * nodes[across], parts.reshape(len(parts), -1)])
    lines = tuple(map(tuple, rows.tolist()))
    places = tuple(nodes[along].tolist())
    has_field = bool(condition.field)
    return EquivalentSources(tuple(half.tolist()), places, lines, is_real, has_field, is_swapped)


FIXED = (
    'expected derivatives in the power and in reflectances alone with the estimator "exact", got '
    'some in a place, an outline, weights or the wavelength; use the estimator "wigner"'
)
# A panel takes some 50 ns of a core at each sample.
_MOST_PANELS = 8192
# Error allowed of a panel's integral, as a share of its integrand's size, a third of 1e-4 for that
# of the sum: measured, |U|^2 is within 3e-5 of its peak.
_DIGITS = math.log(3e4)
# Panels as long as twice the distance are cheapest. Nearer, the rules are graded.
_LONGEST = 12.0
# At the distance r, waves from an element of half-diagonal a have phases of about k a^2/(6 r) that
# its far field leaves out. Of one element that a half turn leaves as it is they add to |U|^2 by
# their square, for its far field is real: 3e-5 at 200 a^2, in wavelengths; to first order
# otherwise, as in steered arrays: 4e-4 at 200 a^2. Small ones are off by some (a/r)^2.
_FAR = {True: 200.0, False: 2000.0}
_FAR_OF_SMALL = 200.0
# Imaginary part of a far field, over the content, that is rounding.
_REAL = 1e-9


# Of means over tilts and wavelengths, as a share of the largest irradiance.
_OF_MIXTURE = 3e-5


class ExactEstimator:
    """Points are lit, and rays weighed, by the exact irradiance |U|^2 of the whole source."""

    needs_distance = True
    is_constant = True
    tells: ClassVar[bool] = False
    """Whether a scene is told of: kernels are traced through the sources of others as well."""

    def __init__(self, m: Any, spec: SourceParameters, wavelength: float, own: Any) -> None:
        self._m, self._unit = m, spec.scene_unit
        source = spec.at_origin
        self._cells = cells_with_field(m, source, self._unit)
        self._fields = []
        for field, stokes in spec.fields_of(source):
            parts = list(spec.mixture.parts(field, wavelength, _OF_MIXTURE))
            exact = [
                (ExactField(m, part, length, spec.obliquity, len(parts) > 1), share)
                for part, length, share in parts
            ]
            self._fields.append((exact, stokes))
        self._scale = opaque(m, wavelength**2 * self._unit**2 / spec.norm)
        self._diffracts, self._shadows = spec.diffraction, None
        self.shadows_key = ""
        """Digest of the scene that `cast` has told of; empty before."""

    @staticmethod
    def check(spec: SourceParameters) -> None:
        """SceneError where a source has no exact field, or one that costs too much a sample."""
        options = {"antithetic": spec.antithetic, "control_variate": spec.control_variate}
        for option in (option for option, is_on in options.items() if is_on):
            raise SceneError(
                f'expected no {option} with the estimator "exact", got true; leave it out: a point '
                "that sees the whole source has no noise there"
            )
        if spec.diffraction and not spec.mixture.is_plain:
            raise SceneError(
                f"expected coherent light of one wavelength with diffraction, got {spec.mixture}; "
                "leave diffraction out, or add the pictures of its waves"
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
        try:
            parts = spec.mixture.parts(spec.source, spec.wavelength, _OF_MIXTURE)
            first, length, _ = next(parts)
            # of each wave of a mixture as many
            each = panels_in(radiator_of(plane_waves_of(first)), length, _LONGEST)
            count = each * (1 + sum(1 for _ in islice(parts, int(_MOST_PANELS / each))))
        except ArgumentError as error:  # too many tilts
            raise SceneError(str(error)) from None
        if not count <= _MOST_PANELS:
            raise SceneError(
                f"expected at most {_MOST_PANELS} pieces of edges, once for each wave, in a sample "
                f'with the estimator "exact", got {count:.0f} or more; use the estimator "wigner"'
            )

    def draw(self, sample: Any) -> tuple[Drjit, None]:
        """A place in proportion to |u|^2, from which obstacles are looked for."""
        return self._cells.sample(sample), None

    def density(self, x: Any) -> None:
        """None: a point sees all of the source at once."""

    def lit(self, light: Any, it: Any, x: Any, per_area: Any) -> Drjit:
        """|U|^2 at the point ``it``; the surface there multiplies it by its own cosine."""
        if light.is_followed():
            raise SceneError(FIXED)
        m = self._m
        place = light.frame.to_own(it.p - light.frame.origin)
        front = place.z > 0.0
        found = self.intensity(m.Point3f(place.x, place.y, dr.select(front, place.z, 1.0)))
        return dr.select(front, found * light.watts_per_norm(), 0.0)

    def received(
        self, x: Any, direction: Any, per_area: Any, point: Any = None, distance: Any = None
    ) -> Drjit:
        """lambda^2 r^2 |U|^2/N of the point that the ray meets, or of one far out."""
        return self._scale * (distance * distance) * self.intensity(point)

    def cast(self, key: str, shadows: Any) -> None:
        """Take over the shadows of a scene with the digest ``key``; None: nothing is in the way."""
        self.shadows_key, self._shadows = key, shadows

    def intensity(self, point: Any) -> Drjit:
        """|U|^2 at a point in front, in units of the scene; in the unit of |u|^2."""
        if self._diffracts and not self.shadows_key and not self.tells:
            message = (
                "expected the scene of a source or a receiver with diffraction, got none from "
                "Mitsuba; render with polywigner.mitsuba.render, or within `with "
                "polywigner.mitsuba.receiving(scene)`"
            )
            if not dr.is_jit_v(self._m.Float):
                raise SceneError(message)
            # Dr.Jit traces the sources of all scenes into a kernel, not only of the one rendered
            warnings.warn(f"{message}. Its light is NaN", RuntimeWarning, stacklevel=2)
            return self._m.Float(math.nan)
        if self._shadows is not None:
            ((first, _),) = self._fields[0][0]
            return self._shadows.either(point, partial(first.intensity, unit=self._unit))
        each = [four(self._m, s, self._mean(parts, point)) for parts, s in self._fields]
        return reduce(operator.add, each)

    def _mean(self, parts: list[tuple[ExactField, float]], point: Any) -> Drjit:
        """|U|^2 of one field, the mean over the waves of a mixture."""
        if len(parts) == 1:
            return parts[0][0].intensity(point, self._unit)
        terms = [partial(self._term, *term) for term in parts]
        m = self._m
        if not dr.is_jit_v(m.Float):
            return sum(term(point) for term in terms)
        # calls of one kind share their code, whose constants are data

        def add(k: Drjit, total: Drjit) -> tuple[Drjit]:
            return (total + dr.switch(k, terms, point),)

        return ops_for(m.Float).fold(0, len(terms), (0.0,), add)[0]

    def _term(self, field: ExactField, share: float, point: Any) -> Drjit:
        return opaque(self._m, share) * field.intensity(point, self._unit)


class ExactField:
    """|U|^2 of a source in coherent light for one variant's arrays.

    ``is_part``: of a mixture, whose waves share their code as sums over edges, for which numbers
    are data: 76 tilts of a square compile in 0.3 s instead of 8 s, within 3e-6 of the peak.
    """

    def __init__(
        self,
        m: Any,
        source: Any,
        wavelength: float,
        obliquity: str,
        is_part: bool = False,
    ) -> None:
        is_curved = isinstance(source, Wavefront)
        source = plane_waves_of(source)
        CONDITIONS[obliquity].warn_of_fit(source, wavelength)
        self._m, self._jit = m, dr.is_jit_v(m.Float)
        # a scalar variant has one sample: all panels, and all nodes, are taken at once
        self._ops = ops_for(m.Float) if self._jit else NumpyOperations(double=True)
        radiator = radiator_of(source)
        self._condition = CONDITIONS[obliquity]
        self._tables = boundary_tables(
            radiator, wavelength, _LONGEST, self._ops.double, self._condition.field
        )
        self._centre = radiator.centre
        self._middle = [opaque(m, c) for c in (radiator.centre / wavelength).tolist()]
        self._inverse = opaque(m, 1 / wavelength)
        self._elements: list[tuple[float, ...]] = []
        self._points: EquivalentSources | None = None
        if is_part:
            return
        self._points = equivalent_sources(
            source, radiator, wavelength, self._condition, len(self._tables.edges)
        )
        if self._points is not None:
            self._half = [opaque(m, half) for half in self._points.half]
        # of one aperture the far field is less work than its points, of an array more
        if len(radiator.elements) == 1:
            element = radiator.elements[0]
            # the far field of a curved wave is more work than its edges, and a minute to compile
            if not is_curved and (len(element.weights) == 1 or self._points is None):
                self._set_elements(element, wavelength)

    def _set_elements(self, element: Any, wavelength: float) -> None:
        """Set the tables of the sum over equal elements in their far zones."""
        outline = element.outline
        corners = np.reshape(outline.bounds, (2, 2))
        middle = corners.mean(axis=0)
        own = outline.moved(-middle)
        places = (element.shifts + middle - self._centre) / wavelength
        weights = element.weights
        self._elements = list(
            map(tuple, np.stack([*places.T, weights.real, weights.imag], axis=1).tolist())
        )
        reach = math.dist(*corners) / (2 * wavelength)
        is_real = len(weights) == 1 and _is_symmetric(own, wavelength)
        far = max(_FAR[is_real] * reach * reach, _FAR_OF_SMALL * reach)
        farthest = far + float(np.hypot(*places.T).max())
        self._farthest = opaque(self._m, farthest)
        self._fields = []
        if self._condition.field:
            self._fields.append((own, False))
        if self._condition.slope:
            with suppress(IlluminationError):  # all waves graze the plane: their cosines are zero
                self._fields.append((times_direction_cosine(own, wavelength), True))

    def intensity(self, point: Any, unit: float) -> Drjit:
        """|U|^2 at a point in front, in units of ``unit`` metres; in the unit of |u|^2."""
        # Dr.Jit's derivatives of loops within loops are zero without a word.
        if self._jit and dr.grad_enabled(point):
            raise SceneError(FIXED)
        x, y, z = (c * (unit * self._inverse) for c in (point.x, point.y, point.z))
        x, y = x - self._middle[0], y - self._middle[1]
        if not self._jit:
            x, y, z = (np.array([value]) for value in (x, y, z))
        if self._elements:
            real, imag = self._either(self._is_far, self._far, self._closer, x, y, z)
        else:
            real, imag = self._closer(x, y, z)
        found = real * real + imag * imag
        return found if self._jit else float(found[0])

    def _closer(self, x: Any, y: Any, z: Any) -> tuple[Drjit, Drjit]:
        """The field where elements are not in their far zones."""
        if self._points is None:
            return self._near(x, y, z)
        away = partial(self._points.field, self._ops, self._half)
        return self._either(self._is_away, away, self._near, x, y, z)

    def _either(
        self, condition: Any, away: Any, otherwise: Any, *point: Any
    ) -> tuple[Drjit, Drjit]:
        """The field by ``away`` where that will do."""
        holds = condition(*point)
        if self._jit:
            return dr.if_stmt(point, holds, away, otherwise, mode="symbolic")
        return (away if holds[0] else otherwise)(*point)

    def _near(self, x: Any, y: Any, z: Any) -> tuple[Drjit, Drjit]:
        """The integrals along the edges."""
        real, imag, _ = integrals.edge_sum(self._ops, self._tables, *self._inner(x, y, z))
        return real, imag

    def _inner(self, x: Any, y: Any, z: Any) -> tuple[Drjit, ...]:
        """Coordinates and distance from the centre in two floats each; no turns; accuracy."""
        m = self._m
        if not self._jit:
            distance = distance_of(self._ops, ((x, 0.0), (y, 0.0), (z, 0.0)))
            zero = np.zeros(1)
            return (x, zero, y, zero, z, zero, *distance, zero, zero + _DIGITS)
        # the distance of two floats of float32, by float64
        wide = ops_for(m.Float64)
        point = tuple((m.Float64(value), 0.0) for value in (x, y, z))
        halves = [m.Float(half) for half in phases.halves(wide, distance_of(wide, point))]
        zero = m.Float(0.0)
        return (x, zero, y, zero, z, zero, *halves, zero, m.Float(_DIGITS))

    def _is_away(self, x: Any, y: Any, z: Any) -> Drjit:
        """Whether a point is so far from the bounds that equivalent sources will do."""
        half_x, half_y = self._half
        return (z > AWAY) | (abs(x) > half_x + AWAY) | (abs(y) > half_y + AWAY)

    def _is_far(self, x: Any, y: Any, z: Any) -> Drjit:
        """Whether a point is in the far zone of every element."""
        return x * x + y * y + z * z > self._farthest * self._farthest

    def _far(self, x: Any, y: Any, z: Any) -> tuple[Drjit, Drjit]:
        """The sum over elements, each in its own far zone."""
        distance = self._ops.sqrt(x * x + y * y + z * z)
        term = partial(self._element, x, y, z, distance)
        real, imag = self._ops.sum_over(self._elements, term, 2, like=x, unroll=False)
        return real, imag

    def _element(
        self, x: Any, y: Any, z: Any, distance: Any, at_x: Any, at_y: Any, real: Any, imag: Any
    ) -> tuple[Drjit, Drjit]:
        """Field of one element, its phase relative to the distance from the centre."""
        ops = self._ops
        dx, dy = x - at_x, y - at_y
        radius = ops.sqrt(dx * dx + dy * dy + z * z)
        longer = (at_x * (at_x - 2.0 * x) + at_y * (at_y - 2.0 * y)) / (radius + distance)
        inverse = 1.0 / radius
        value = self._spectrum(dx * inverse, dy * inverse, z * inverse, inverse)
        wave = Pair(*cos_sin_turns(ops, longer)) * Pair(real, imag)
        found = (value * wave).scaled(inverse)
        return found.real, found.imag

    def _spectrum(self, along_x: Any, along_y: Any, cosine: Any, inverse: Any) -> Pair:
        """The far field (RP1) of an element towards a direction, times distance in wavelengths."""
        nu_x, nu_y = along_x * self._inverse, along_y * self._inverse
        nu: Any = self._m.Vector2f(nu_x, nu_y) if self._jit else np.stack([nu_x, nu_y], axis=-1)
        scale = self._inverse * self._inverse
        total = Pair(0.0, 0.0)
        for field, is_slope in self._fields:
            found = fourier(field, nu)
            part = Pair(found.real, found.imag)
            if is_slope:
                total = total + part.scaled(self._condition.slope * scale)
            else:
                near = Pair(1.0, inverse * (1 / (2 * math.pi)))
                total = total + (part * near).scaled(self._condition.field * scale * cosine)
        return total


def _is_symmetric(element: Aperture, wavelength: float) -> bool:
    """Whether its far field is real: seen in directions that have no symmetry of their own."""
    directions = np.array([[0.31, 0.17], [-0.53, 0.61], [0.83, -0.29]])
    values = fourier(element, directions / wavelength)
    return bool(np.abs(values.imag).max() < _REAL * element.area)


# ---- curved waves as sums of plane waves ---------------------------------------------------------

# Error of a curved wave as plane waves, relative to its modulus; largest sum of the moduli, which
# single precision multiplies by 6e-8; and periods of the waves over the size of an element: shorter
# periods need more waves, longer ones have larger amplitudes.
_OF_CURVED, _LARGEST_SUM, _PERIODS = 1e-5, 30.0, (1.2, 1.5, 2.0, 3.0)
# Rounding of singular values, relative to the largest; most waves along an axis.
_SINGULAR, _MOST_WAVES = 1e-9, 64


@lru_cache(maxsize=16)
def plane_waves_of(source: Any) -> SceneSource:
    """The source with its curved wave as a sum of plane waves on each of its elements."""
    if not isinstance(source, Wavefront):
        return source
    flat, weights = source.source, getattr(source.source, "weights", [1.0])
    elements = []
    for element in flat.elements_in_plane:
        own = _curved_on(element, source)
        flat_field = element.illumination
        whole = own if flat_field is None else own * flat_field
        elements.append(element.with_illumination(whole))
    return elements[0] if isinstance(flat, Aperture) else Array(elements, weights)


def _curved_on(element: Aperture, wave: Wavefront) -> Illumination:
    """Plane waves whose sum is the curved wave on an element: a product over its two axes."""
    curvatures, axes = principal_axes(wave.curvature)
    places = (np.concatenate(element.rings) - wave.centre) @ axes
    amplitudes, frequencies = np.ones(1, np.complex128), np.zeros((1, 2))
    for q, own, axis in zip(curvatures.tolist(), places.T, axes.T, strict=True):
        values, along = _chirp(q, float(own.min()), float(own.max()))
        values = values * np.exp(-2j * math.pi * along * (wave.centre @ axis))
        amplitudes = np.outer(amplitudes, values).ravel()
        frequencies = (frequencies[:, None] + along[:, None] * axis).reshape(-1, 2)
    return Illumination(amplitudes, frequencies)


def _chirp(q: float, low: float, high: float) -> tuple[Complexes, Floats]:
    """Amplitudes and frequencies of waves whose sum is exp(i pi q y^2) from ``low`` to ``high``."""
    middle, size = (low + high) / 2, high - low
    turns = abs(q) * size * size
    if turns < _OF_CURVED:
        centred = np.ones(1, np.complex128), np.zeros(1)
    else:
        count = 8 * math.ceil(min(turns, _MOST_WAVES) + 20)
        places = -np.cos(np.linspace(0.0, math.pi, count)) * size / 2
        wanted = np.exp(1j * math.pi * q * places * places)
        # its frequencies spread over as many steps of 1/size as it has turns
        fits = (
            _fit(places, wanted, np.linspace(-0.5, 0.5, n) * ((n - 1) / (period * size)))
            for n in range(3 + 2 * int(min(turns, _MOST_WAVES) / 2), _MOST_WAVES + 1, 2)
            for period in _PERIODS
        )
        found = next((fit for fit in fits if fit is not None), None)
        if found is None:
            raise SceneError(
                'expected a wave of less curvature with the estimator "exact", got one that turns '
                f"{turns / 8:.3g} times from the middle to the edge of its element; use the "
                'estimator "wigner"'
            )
        centred = found
    amplitudes, frequencies = centred
    # about the middle: q y^2 = q (y - m)^2 + 2 q m (y - m) + q m^2
    shifted = frequencies + q * middle
    phase = q * middle * middle / 2 - shifted * middle
    return amplitudes * np.exp(2j * math.pi * phase), shifted


def _fit(
    places: Floats,
    wanted: Complexes,
    frequencies: Floats,
) -> tuple[Complexes, Floats] | None:
    """Amplitudes of these waves with the wanted sum; None if they miss it, or are too large."""
    waves = np.exp(2j * math.pi * np.outer(places, frequencies))
    found = np.asarray(np.linalg.lstsq(waves, wanted, rcond=_SINGULAR)[0], np.complex128)
    fits = np.abs(waves @ found - wanted).max() <= _OF_CURVED
    return (found, frequencies) if fits and np.abs(found).sum() <= _LARGEST_SUM else None
