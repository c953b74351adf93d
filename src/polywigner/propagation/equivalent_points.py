"""Point sources with the far field of an aperture (B8).

The points lie at Gauss nodes on the bounding box of the source, with weights fitted to its far
field in the required directions. Lengths are in wavelengths.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from polywigner.errors import ArgumentError, IlluminationError
from polywigner.execution import NumpyOperations
from polywigner.geometry import Wavefront
from polywigner.kernels.boundary.edge_waves import Point
from polywigner.numerics import Complex, Floats, index_blocks
from polywigner.numerics.nodes import gauss_legendre
from polywigner.numerics.phases import Pair, cos_sin_cycles
from polywigner.propagation.boundary import Radiator, radiator_of
from polywigner.propagation.curved_fields import cells_of_wave, field_at_nodes
from polywigner.propagation.screens import PointSource
from polywigner.source.obliquities import CONDITIONS, Obliquity, times_direction_cosine
from polywigner.transforms import fourier
from polywigner.transforms.wavefronts import flat_source

_MOST_SOURCES = 1 << 15
# Numbers of additional nodes along a side that are tried in turn. The numbers in the first tuple
# are added to the number that a uniform aperture needs, and the numbers in the second tuple to the
# number that resolves any source.
_MORE_OF_UNIFORM, _MORE_OF_ANY = (0, 2, 4, 6, 9, 12, 16, 20), (0, 8, 16)
# Relative magnitude below which singular values are rounding errors.
_ROUNDING = 1e-9
# The required range of sines is extended at both ends by _MARGIN divided by the side of the
# bounding box in wavelengths.
_MARGIN = 4.0
# Number of triangles per block. Each triangle has 400 nodes.
_CELLS = 1 << 6
# Number of test directions of the fit for each cycle of phase, and number of additional test
# directions.
_DIRECTIONS, _MORE_DIRECTIONS = 4.0, 24


@dataclass(frozen=True)
class EquivalentGrid:
    """Point sources at Gauss nodes on the bounding box of a source."""

    nodes: tuple[Floats, Floats]
    """Coordinates along x and y from the centre, in units of half a side."""
    half: Floats
    """Half the sides in wavelengths, shape (2,)."""
    weights: tuple[Complex, ...]
    """Weights (nx, ny) of the field and of the normal derivative, in units of u times a square
    wavelength, without the terms that are absent from the boundary condition."""


Sines = tuple[tuple[float, float], tuple[float, float]]
"""Smallest and largest sine of directions, along x and along y."""
_ALL_SINES: Sines = ((-1.0, 1.0), (-1.0, 1.0))


def equivalent_grid(
    source: Any,
    radiator: Radiator,
    wavelength: float,
    condition: Obliquity,
    error: float,
    allowed: Callable[[Sequence[int]], bool],
    sines: Sines = _ALL_SINES,
) -> EquivalentGrid | None:
    """Return a grid of point sources with the far field of a source.

    Nodes are added until the error of the squared far field within ``sines`` is at most ``error``
    times its peak. Returns None if ``allowed`` rejects the numbers of nodes, if the largest number
    of nodes is not sufficient, or if the source has no far field.
    """
    half = (radiator.high - radiator.low) / (2 * wavelength)
    centres, widths = np.mean(sines, axis=1), np.ptp(sines, axis=1) / 2
    # Phase difference [cycles] over half a side between the outermost and the central direction.
    cycles = half * widths
    waves: list[Floats] = []
    spectra: list[Complex] = []
    for counts in zip(*(_numbers_of_nodes(c, error) for c in cycles), strict=True):
        if not allowed(counts):
            return None
        if not spectra:
            numbers = [math.ceil(2 * _DIRECTIONS * c) + _MORE_DIRECTIONS for c in cycles]
            waves = [
                m + w * np.cos(math.pi * (np.arange(n) + 0.5) / n)
                for m, w, n in zip(centres, widths, numbers, strict=True)
            ]
            spectra = _spectra(source, waves, radiator.centre, wavelength, condition)
            if not spectra:
                return None
        x, y = (gauss_legendre(n)[:, 0] for n in counts)
        weights = [_fitted(s, waves, (half[0] * x, half[1] * y), error) for s in spectra]
        if all(part is not None for part in weights):
            return EquivalentGrid((x, y), half, tuple(w for w in weights if w is not None))
    return None


def _numbers_of_nodes(cycles: float, error: float) -> list[int]:
    """Return ascending numbers of Gauss nodes to try, for ``cycles`` cycles along half a side."""
    # The last numbers of nodes resolve any field on the source.
    uniform = math.ceil(3.0 * cycles) + math.ceil(-0.7 * math.log10(error) * cycles ** (1 / 3)) + 1
    numbers = [uniform + more for more in _MORE_OF_UNIFORM]
    return numbers + [
        max(numbers[-1], math.ceil(2.0 * math.pi * cycles)) + more for more in _MORE_OF_ANY
    ]


def _spectra(
    source: Any, sines: list[Floats], centre: Floats, wavelength: float, condition: Obliquity
) -> list[Complex]:
    """Return the far fields due to a source's field and to its normal derivative.

    Each array (nx, ny) contains all pairs of sines along x and y. The unit is a square wavelength
    times the unit of the field. Parts that the boundary condition does not contain are omitted.
    """
    nu = np.stack(np.meshgrid(*sines, indexing="ij"), axis=-1) / wavelength
    phase = np.exp(2j * math.pi * (nu @ centre)) / wavelength**2
    spectra = []
    if condition.field:
        spectra.append(condition.field * fourier(source, nu) * phase)
    if condition.slope and isinstance(source, Wavefront) and not source.is_flat:
        spectra.append(condition.slope * _slope_spectrum(source, sines, wavelength) * phase)
    elif condition.slope:
        # If all waves graze the plane, times_direction_cosine raises an error. The normal
        # derivative is then zero.
        with suppress(IlluminationError):
            slopes = times_direction_cosine(flat_source(source), wavelength)
            spectra.append(condition.slope * fourier(slopes, nu) * phase)
    return spectra


def _slope_spectrum(wave: Wavefront, sines: list[Floats], wavelength: float) -> Complex:
    """Return the Fourier transform of a curved wave's normal derivative divided by ik.

    The result (nx, ny) is in m^2 times the unit of the field.
    """
    total = np.zeros([len(s) for s in sines], np.complex128)
    for part, cells in cells_of_wave(wave, wavelength):
        for some in index_blocks(len(cells), _CELLS):
            nodes, _, slopes = field_at_nodes(wave, part, cells[some], wavelength, True)
            x, y = (
                np.exp(-2j * math.pi / wavelength * np.multiply.outer(s, nodes[..., k].ravel()))
                for k, s in enumerate(sines)
            )
            total += (x * slopes.ravel()) @ y.T
    return total


def _fitted(
    spectrum: Complex, sines: list[Floats], nodes: tuple[Floats, Floats], error: float
) -> Complex | None:
    """Fit weights (nx, ny) of point sources to a far field, or return None.

    The error of the squared far field must not exceed ``error`` times its peak.
    """
    waves = [np.exp(-2j * math.pi * np.outer(s, x)) for s, x in zip(sines, nodes, strict=True)]
    first, second = (np.linalg.pinv(wave, rcond=_ROUNDING) for wave in waves)
    weights = first @ spectrum @ second.T
    fit = waves[0] @ weights @ waves[1].T
    real = np.add.outer(sines[0] ** 2, sines[1] ** 2) <= 1.0
    expected = np.abs(spectrum[real]) ** 2
    deviation = np.abs(np.abs(fit[real]) ** 2 - expected).max()
    return weights if deviation <= error * expected.max() else None


def sines_towards(low: Floats, high: Floats, boxes: Floats) -> Sines:
    """Return bounds on the sines of directions from a rectangle in z = 0 to boxes (n, 2, 3).

    Lengths are in wavelengths. ``low`` and ``high`` are corners of the rectangle, and boxes contain
    their lowest and highest corners. The bounds include the diffraction angle of the rectangle.
    """
    start = np.column_stack([low, high]).T
    first, last = boxes[:, 0].copy(), boxes[:, 1].copy()
    first[:, :2] -= start[1]
    last[:, :2] -= start[0]
    near = np.where((first < 0.0) & (last > 0.0), 0.0, np.minimum(abs(first), abs(last)))
    far = np.maximum(abs(first), abs(last))
    bounds = []
    for k in range(2):
        others = [m for m in range(3) if m != k]
        closest, farthest = (np.linalg.norm(part[:, others], axis=1) for part in (near, far))
        margin = _MARGIN / max(high[k] - low[k], 1e-9)
        # The sine along an axis increases with the displacement along this axis. A positive sine
        # decreases with the displacement along the other axes.
        largest = last[:, k] / np.hypot(last[:, k], np.where(last[:, k] > 0.0, closest, farthest))
        least = first[:, k] / np.hypot(first[:, k], np.where(first[:, k] < 0.0, closest, farthest))
        lowest = max(-1.0, float(least.min()) - margin)
        highest = min(1.0, float(largest.max()) + margin)
        # Symmetric ranges need fewer Gauss nodes.
        if lowest < 0.0 < highest:
            highest = max(-lowest, highest)
            lowest = -highest
        bounds.append((lowest, highest))
    return bounds[0], bounds[1]


def spherical_wave(ops: Any, ahead: Point, cycles: Any = None) -> Pair:
    """Return the spherical wave ``exp(2 pi i R)/(i R)``, where R is the length of ``ahead``.

    Lengths are in wavelengths. ``cycles`` replaces R in the phase if the number of cycles is known
    more accurately than R.
    """
    distance = ops.sqrt(sum(a * a for a in ahead))
    c, s = cos_sin_cycles(ops, distance if cycles is None else cycles)
    return Pair(s, -c).scaled(1.0 / distance)


def wave_ahead(ops: Any, ahead: Point, field: Point, slope: Point, cycles: Any = None) -> Pair:
    """Return the wave of a point source at the displacement ``ahead`` in wavelengths.

    ``field`` and ``slope`` contain the real and the imaginary part of the weights of the field and
    of the normal derivative. See :func:`spherical_wave` for ``cycles``.
    """
    of_field = Pair(*field) * dipole_obliquity(ops, ahead)
    return spherical_wave(ops, ahead, cycles) * (of_field + Pair(*slope))


def dipole_obliquity(ops: Any, ahead: Point) -> Pair:
    """Return the ratio (1 + i/(2 pi R)) z/R of the wave of a dipole along z to a spherical wave."""
    inverse = 1.0 / ops.sqrt(sum(a * a for a in ahead))
    return Pair(1.0, (0.5 / math.pi) * inverse).scaled(ahead[2] * inverse)


class RadiatingPoint(NamedTuple):
    """A point source that represents part of an aperture, in wavelengths."""

    position: Floats
    field: complex
    """Weight of the field."""
    slope: complex
    """Weight of the normal derivative."""

    @property
    def weights(self) -> list[tuple[float, float]]:
        """Real and imaginary parts of the weights of the field and of its normal derivative."""
        return [(self.field.real, self.field.imag), (self.slope.real, self.slope.imag)]

    @property
    def row(self) -> Floats:
        """Position and weights, shape (7,)."""
        return np.array([*self.position, *self.weights[0], *self.weights[1]])

    def wave(self, points: Floats) -> Complex:
        """Return the field (n,) of the point source at points (3, n) in wavelengths."""
        ahead = points - self.position[:, None]
        wave = wave_ahead(NumpyOperations(), tuple(ahead), *self.weights)
        return np.asarray(wave.real + 1j * wave.imag)


def radiating_points(
    source: Any,
    wavelength: float,
    method: str,
    error: float,
    most: int = _MOST_SOURCES,
    targets: Floats | None = None,
) -> list[RadiatingPoint]:
    """Return point sources, with positions in wavelengths, that have the far field of a source.

    ``method`` is the name of the boundary condition.
    The error of the squared far field is at most ``error`` times its peak, in the directions of
    ``targets`` (boxes of shape (n, 2, 3) in wavelengths), by default in all directions. Raises
    ArgumentError if more than ``most`` points are needed, or if no number of points is sufficient.
    """
    if isinstance(source, PointSource):
        # The factor i/wavelength converts exp(ikR)/(i R/wavelength) to exp(ikR)/R.
        position = np.array(source.position) / wavelength
        return [RadiatingPoint(position, 0j, 1j * source.amplitude / wavelength)]
    radiator = radiator_of(flat_source(source))
    condition = CONDITIONS[method]
    low, high = radiator.low / wavelength, radiator.high / wavelength
    sines = _ALL_SINES if targets is None else sines_towards(low, high, targets)
    tried: list[int] = []

    def allowed(counts: Sequence[int]) -> bool:
        """Record the numbers of nodes, and return whether their product is small enough."""
        tried[:] = counts
        return math.prod(counts) <= most

    grid = equivalent_grid(source, radiator, wavelength, condition, error, allowed, sines)
    if grid is None:
        size, count = " × ".join(f"{side:.3g}" for side in high - low), math.prod(tried)
        raise ArgumentError(
            f"the source is too large for obstacles: a source of {size} wavelengths requires at "
            f"least {count} equivalent points, but at most {most} are allowed; move obstacles "
            "and points away from the source, or use a part of the source"
            if count > most
            else (
                f"the field of the source of {size} wavelengths cannot be represented by "
                f"{count} equivalent points, as obstacles require; increase the tolerance"
            )
        )
    centre = radiator.centre / wavelength
    x, y = (c + h * n for c, h, n in zip(centre, grid.half, grid.nodes, strict=True))
    none = np.zeros_like(grid.weights[0])
    field = grid.weights[0] if condition.field else none
    slope = grid.weights[-1] if len(grid.weights) > bool(condition.field) else none
    return [
        RadiatingPoint(np.array([a, b, 0.0]), complex(field[i, j]), complex(slope[i, j]))
        for i, a in enumerate(x)
        for j, b in enumerate(y)
    ]
