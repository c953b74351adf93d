"""Fields of curved waves: exact sums over cells of the source (Q7), and Fresnel fields (Q6).

The phase changes by at most four cycles on each triangular cell, so all cells use the same Gauss
rule.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from polywigner.execution.progress import with_progress
from polywigner.geometry import Wavefront
from polywigner.geometry.aperture import triangulate
from polywigner.geometry.arguments import check_most
from polywigner.numerics import Complex, Floats, index_blocks
from polywigner.numerics.nodes import cell_rules, cells_of, quartered
from polywigner.propagation.boundary import radiator_of
from polywigner.source.obliquities import CONDITIONS, direction_cosines
from polywigner.transforms.wavefronts import chirp_transform, principal_axes

# Number of Gauss nodes along each side of a cell.
_NODES = 20
# Largest number of phase cycles along a side of a cell, for an accuracy of 13 digits. The rule
# integrates the static field 1/R^2 as accurately if the point is half a side away from the cell.
_MOST_CYCLES = 4.0
# Rounding error of a sum over nodes, relative to the sum of moduli.
_ROUNDING = 1e-13
# Number of cells per block, number of points per block, and largest number of pairs (point, cell).
_CELLS, _POINTS, _MOST_PAIRS = 1 << 9, 1 << 9, 1 << 22


def curved_field(
    wave: Wavefront, points: Floats, wavelength: float, method: str
) -> tuple[Complex, Floats]:
    """Return the field of a curved wave at points (n, 3), and a bound on its rounding errors."""
    if method == "fresnel":
        return _fresnel(wave, points, wavelength)
    return summed_over_cells(wave, points, wavelength, partial(_integrand, wave, method=method))


def _fresnel(wave: Wavefront, points: Floats, wavelength: float) -> tuple[Complex, Floats]:
    """Return the Fresnel field (Q6) at points, and a bound on its rounding errors."""
    q, axes = principal_axes(wave.curvature)
    scale = 1.0 / (wavelength * points[:, 2])
    position, centre = points[:, :2], wave.centre
    nu = (position - centre) * scale[:, None]
    spectrum = chirp_transform(wave.source, q + scale[:, None], axes, centre, nu)
    cycles = points[:, 2] / wavelength
    cycles = cycles - np.round(cycles) + scale / 2 * ((position**2).sum(axis=1) - centre @ centre)
    values = spectrum * (scale / 1j) * np.exp(2j * math.pi * (cycles - np.round(cycles)))
    return values, _ROUNDING * scale * radiator_of(wave.source).content


class _Element(NamedTuple):
    """An element of a curved source, divided into triangles, with m plane waves."""

    triangles: Floats
    """Corners of the triangles in m, shape (n, 3, 2)."""
    shift: Floats
    """Position of the element in m, which the triangles include, shape (2,)."""
    amplitudes: Complex
    """Amplitudes of the plane waves, shape (m,)."""
    frequencies: Floats
    """Spatial frequencies in 1/m of waves with phases relative to ``shift``, shape (m, 2)."""


def summed_over_cells(
    wave: Wavefront,
    points: Floats,
    wavelength: float,
    terms: Callable[[_Element, Floats, Floats, float], Complex],
    components: tuple[int, ...] = (),
) -> tuple[Complex, Floats]:
    """Return an integral over a curved source for n points, and bounds (n,) on its rounding errors.

    ``terms(part, cells, points, wavelength)`` returns the weighted integrand (k, nodes,
    *components) of k cells, for one point per cell. The integral has the shape (n, *components).
    """
    values, sizes = np.zeros((len(points), *components), np.complex128), np.zeros(len(points))
    with with_progress("points", range(0, len(points), _POINTS)) as starts:
        for start in starts:
            block = points[start : start + _POINTS]
            for part in _elements(wave):
                for owners, cells in _point_cells(wave, part, block, wavelength):
                    integrand = terms(part, cells, block[owners], wavelength)
                    moduli = np.abs(integrand).reshape(len(cells), -1).sum(axis=1)
                    np.add.at(values, owners + start, integrand.sum(axis=1))
                    np.add.at(sizes, owners + start, moduli)
    return values, _ROUNDING * sizes


def _elements(wave: Wavefront) -> Iterator[_Element]:
    """Yield each element of a curved source."""
    for element in radiator_of(wave.source).elements:
        corners, numbers = triangulate(element.outline)
        for shift, weight in zip(element.shifts, element.weights.tolist(), strict=True):
            amplitudes = weight * element.amplitudes
            yield _Element(corners[numbers] + shift, shift, amplitudes, element.frequencies)


def cells_of_wave(wave: Wavefront, wavelength: float) -> Iterator[tuple[_Element, Floats]]:
    """Yield parts of a curved source, and their cells (k, 3, 2), which suit any plane wave."""
    for part in _elements(wave):
        cells = part.triangles
        while len(cells):
            highest = _highest(wave, part, cells, 0.0) + 1.0 / wavelength
            small = highest * _longest_sides(cells) <= _MOST_CYCLES
            yield part, cells[small]
            cells = quartered(cells[~small])
            remedy = "use a larger radius of curvature, or a smaller source"
            check_most(len(cells), _MOST_PAIRS, "cells of a source with a curved wave", remedy)


def _longest_sides(cells: Floats) -> Floats:
    """Return the length of the longest side of each triangle (k, 3, 2)."""
    return np.asarray(np.linalg.norm(cells - np.roll(cells, 1, axis=1), axis=2).max(axis=1))


def _highest(wave: Wavefront, part: _Element, cells: Floats, frequencies: Any) -> Floats:
    """Return the highest spatial frequency [1/m], on each cell, of the field times another wave.

    ``frequencies`` (k, 3, 2) contains the spatial frequencies of the other wave at the corners of
    the cells.
    """
    frequencies = frequencies + (cells - wave.centre) @ wave.curvature
    highest = np.zeros(len(cells))
    for kappa in part.frequencies:
        highest = np.maximum(highest, np.linalg.norm(frequencies + kappa, axis=2).max(axis=1))
    return highest


def _point_cells(
    wave: Wavefront, part: _Element, points: Floats, wavelength: float
) -> Iterator[tuple[NDArray[np.intp], Floats]]:
    """Yield indices (k,) of points, and the cells (k, 3, 2) that each point requires."""
    count = len(part.triangles)
    owners = np.repeat(np.arange(len(points)), count)
    cells = np.tile(part.triangles, (len(points), 1, 1))
    while len(owners):
        small = _are_small(wave, part, cells, points[owners], wavelength)
        small_owners, small_cells = owners[small], cells[small]
        for block in index_blocks(len(small_cells), _CELLS):
            yield small_owners[block], small_cells[block]
        owners, cells = np.repeat(owners[~small], 4), quartered(cells[~small])
        remedy = "use points farther away, a smaller source, or method='fresnel'"
        check_most(len(owners), _MOST_PAIRS, "cells of a source with a curved wave", remedy)


def _are_small(
    wave: Wavefront, part: _Element, cells: Floats, points: Floats, wavelength: float
) -> NDArray[np.bool_]:
    """Return a mask (k,) of the cells that are small enough for one Gauss rule.

    ``points`` contains one field point for each cell.
    """
    size = _longest_sides(cells)
    away = cells - points[:, None, :2]
    height = points[:, 2]
    corner_distance = np.sqrt((away**2).sum(axis=2) + height[:, None] ** 2)
    centre = away.mean(axis=1)
    distance = np.sqrt((centre**2).sum(axis=1) + height**2)
    near = np.maximum(height, distance - size)
    highest = _highest(wave, part, cells, away / (wavelength * corner_distance[..., None]))
    rate = highest + np.minimum(size / near, 1.0) / wavelength
    return np.asarray((rate * size <= _MOST_CYCLES) & (size <= 2 * near))


def field_at_nodes(
    wave: Wavefront, part: _Element, cells: Floats, wavelength: float, with_slopes: bool = False
) -> tuple[Floats, Complex, Complex]:
    """Return nodes (k, n, 2) on cells, and the weighted field and normal derivative (k, n).

    ``cells`` contains triangles (k, 3, 2) in m, in the element ``part``. Field and derivative are
    multiplied by quadrature weights in m^2. The derivative is divided by ik, and is zero unless
    ``with_slopes`` is true.
    """
    count = len(cells)
    ((_, nodes, weights),) = cell_rules(cells_of(cells), np.full((count, 2), _NODES))
    nodes, weights = nodes.reshape(count, -1, 2), weights.reshape(count, -1)
    inner = nodes - wave.centre
    slope = inner @ wave.curvature
    cycles = ((inner * slope).sum(axis=2)) / 2
    shifted = nodes - part.shift
    field, slopes = np.zeros((2, *cycles.shape), np.complex128)
    for amplitude, kappa in zip(part.amplitudes.tolist(), part.frequencies, strict=True):
        plane_wave = amplitude * np.exp(2j * math.pi * (cycles + shifted @ kappa))
        field += plane_wave
        if with_slopes:
            slopes += plane_wave * direction_cosines(slope + kappa, wavelength)
    return nodes, field * weights, slopes * weights


def _integrand(
    wave: Wavefront, part: _Element, cells: Floats, points: Floats, wavelength: float, method: str
) -> Complex:
    """Return the weighted integrand (k, nodes) of (Q7) on k cells, for one point per cell."""
    condition = CONDITIONS[method]
    nodes, field, slopes = field_at_nodes(
        wave, part, cells, wavelength, condition.needs_normal_derivative
    )
    height = points[:, 2, None]
    distance = np.sqrt(((nodes - points[:, None, :2]) ** 2).sum(axis=2) + height**2)
    k = 2 * math.pi / wavelength
    value = condition.slope * slopes
    value += condition.field * field * (height / distance) * (1 + 1j / (k * distance))
    wave_to_point = np.exp(2j * math.pi * (distance / wavelength)) / (1j * wavelength * distance)
    return np.asarray(value * wave_to_point)
