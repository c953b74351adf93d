"""Irradiance of partially coherent light as a mean over tilts whose fields share samples.

A tilt multiplies the source by exp(2 pi i t.x), a product of one factor for each axis. The source
is sampled on rows along x, with Gauss nodes on the trapezoids between the heights of its vertices.
One matrix product transforms each row from x to t_x, a second one the rows from y to t_y.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from polywigner.execution.progress import told
from polywigner.geometry import Aperture, Wavefront
from polywigner.propagation.row_rules import Trapezoids, node_counts, rows_of, trapezoids_of
from polywigner.propagation.source_samples import field_at, largest_rates, waves_of
from polywigner.source import Array
from polywigner.source.obliquities import CONDITIONS, Obliquity, direction_cosines
from polywigner.transforms.wavefronts import flat_of

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]
Indices = NDArray[np.intp]

# Relative error of the quadrature on the source, for nodes that count for less than the tilts.
_QUADRATURE = 1e-9
# Share of the largest tilt, whose weight is next to nothing, that the nodes resolve.
_RESOLVED = 0.8
# Most points of a block, which share nodes; values of a spectrum and of a batch of rows.
_POINTS, _SPECTRUM, _BATCH = 16, 1 << 20, 1 << 16
# Products of numbers in a matrix product that BLAS does not share among threads; columns of it.
_SERIAL, _COLUMNS = 1 << 18, 32
# Nanoseconds of a node for each point; of a multiplication; of a tilt; and of a trapezoid in a
# block of points.
_NODE, _PRODUCT, _VALUE, _TRAPEZOID = 60.0, 0.25, 10.0, 3e5


class Axis(NamedTuple):
    """The trapezoidal rule for normal tilts along an axis, at -half to half steps."""

    step: float
    """In cycles per metre."""
    half: int
    weights: Floats
    """(half + 1,) for tilts from 0 on."""

    def tilts(self, is_even: bool) -> tuple[Floats, Floats]:
        """Return tilts and weights; of cosines and sines instead of waves if all is even in t."""
        tilts = self.step * np.arange(self.half + 1)
        if is_even:
            both = np.where(tilts > 0.0, 2.0, 1.0) * self.weights
            return np.tile(tilts, 2), np.tile(both, 2)
        mirrored = [values[:0:-1] for values in (-tilts, self.weights)]
        return np.concatenate([mirrored[0], tilts]), np.concatenate([mirrored[1], self.weights])


class Block(NamedTuple):
    """Points that share nodes on the source."""

    points: Indices
    rates: Floats
    """(2,) largest frequencies of the integrand over the source along x and y in 1/m."""
    nearest: float
    """Least z of the points in m."""


class TiltSum(NamedTuple):
    """A mean over tilts for blocks of points."""

    source: Wavefront
    points: Floats
    """(n, 3)."""
    wavelength: float
    condition: Obliquity
    channels: list[Any]
    """The parts of the field: None, and the frequency of each wave whose slope counts."""
    axes: list[Axis]
    blocks: list[Block]
    cost: float
    """Estimated nanoseconds for each point."""


def tilt_sum(
    source: Wavefront, points: Floats, wavelength: float, method: str, error: float
) -> TiltSum | None:
    """The sum for points (n, 3); None if there are too many tilts, or for a curved wave by slopes.

    ``error`` : of the mean over tilts, relative to the largest irradiance.
    """
    condition = CONDITIONS[method]
    tail = math.sqrt(2 * math.log(8 / error))
    sides = np.subtract(*np.reshape(source.bounds, (2, 2))[::-1])
    reaches = sides / source.coherence_width + tail
    count = math.prod((tail * reaches / math.pi + 1).tolist())
    if count > _SPECTRUM or (condition.takes_slopes and not source.is_flat):
        return None
    axes = [_axis(tail, reach, source.coherence_width) for reach in reaches.tolist()]
    rates = largest_rates(source, points, wavelength)
    rates += [_RESOLVED * axis.half * axis.step for axis in axes]
    order = np.argsort(rates.max(axis=1), kind="stable")
    elements = _elements(source)
    channels: list[Any] = [None] if condition.field else []
    if condition.slope:
        waves = [kappa for element, _ in elements for _, kappa in waves_of(element)]
        channels += list(np.unique(waves, axis=0))
    size = int(min(_POINTS, max(1, _SPECTRUM // (count * len(channels)))))
    trapezoids = np.concatenate([_trapezoids(element) for element, _ in elements])
    blocks, cost = [], 0.0
    for start in range(0, len(points), size):
        some = order[start : start + size]
        block = Block(some, rates[some].max(axis=0), float(points[some, 2].min()))
        rows, columns = _counts(trapezoids, block).T.astype(np.float64)
        nodes, width = float((rows * columns).sum()), 2 * axes[0].half + 1
        products = nodes * width + float(rows.sum()) * count
        work = _NODE * nodes + len(channels) * (_PRODUCT * products + _VALUE * count)
        cost += work * len(some) + _TRAPEZOID * len(trapezoids)
        blocks.append(block)
    cost /= len(points)
    return TiltSum(source, points, wavelength, condition, channels, axes, blocks, cost)


def _axis(tail: float, reach: float, width: float) -> Axis:
    """Steps of 2 pi/reach standard deviations up to ``tail``."""
    step = 2 * math.pi / reach
    half = math.ceil(tail / step)
    weights = np.exp(-0.5 * (step * np.arange(half + 1)) ** 2)
    return Axis(step / (2 * math.pi * width), half, weights / (2 * weights.sum() - 1.0))


def summed_over_tilts(rule: TiltSum) -> Floats:
    """Irradiance (n,) at all points, by (Q7)."""
    found = np.empty(len(rule.points))
    channels = rule.channels
    # |c + i s|^2 + |c - i s|^2 = 2 |c|^2 + 2 |s|^2
    is_even = not any(kappa is not None and kappa.any() for kappa in channels)
    (over_x, of_x), (over_y, of_y) = (axis.tilts(is_even) for axis in rule.axes)
    plane = np.stack(np.meshgrid(over_x, over_y), axis=-1)
    cosines: list[Any] = [
        1.0 if kappa is None else direction_cosines(plane + kappa, rule.wavelength)[..., None]
        for kappa in channels
    ]
    with told("blocks of points", rule.blocks) as blocks:
        for block in blocks:
            spectra = _spectra(rule, block)
            if not is_even:
                spectra = _of_both_signs(_of_both_signs(spectra, 1), 2)
            total = cosines[0] * spectra[0]
            for cosine, spectrum in zip(cosines[1:], spectra[1:], strict=True):
                spectrum *= cosine
                total += spectrum
            intensity = np.square(total.real)
            intensity += np.square(total.imag)
            found[block.points] = of_x @ np.tensordot(of_y, intensity, 1)
    return found


def _elements(source: Wavefront) -> list[tuple[Aperture, complex]]:
    flat = flat_of(source)
    weights = flat.weights.tolist() if isinstance(flat, Array) else [1.0]
    return list(zip(flat.elements_in_plane, weights, strict=True))


@lru_cache(maxsize=64)
def _trapezoids(element: Aperture) -> Trapezoids:
    return trapezoids_of(element.polygons.geoms)[0]


def _counts(trapezoids: Trapezoids, block: Block) -> Indices:
    return node_counts(trapezoids, block.rates, _QUADRATURE, block.nearest)


def _spectra(rule: TiltSum, block: Block) -> Complex:
    """Channels of the fields of all tilts at p points: (channels, t_y, t_x, p).

    Sums over cosines and after these over sines of tilts t >= 0, along both axes.
    """
    along_x, along_y = rule.axes
    source, points, count = rule.source, rule.points[block.points], len(rule.channels)
    halves = (2 * (along_y.half + 1), 2 * (along_x.half + 1), len(points))
    total = np.zeros((count, halves[0], halves[1] * halves[2]), np.complex128)
    middle = np.reshape(source.bounds, (2, 2)).mean(axis=0)
    for element, weight in _elements(source):
        trapezoids = _trapezoids(element)
        for one, counts in zip(trapezoids, _counts(trapezoids, block), strict=True):
            x, y, weights = rows_of(one, counts)
            # rows of a rectangle share x
            places = (x if np.diff(one[1:]).any() else x[:1]) - middle[0]
            inner = np.empty((count, len(y), *halves[1:]), np.complex128)
            columns = count * len(points) + (along_x.half if len(places) > 1 else 0)
            step = max(1, _BATCH // (x.shape[1] * columns))
            for start in range(0, len(y), step):
                some = slice(start, start + step)
                rows = (x[some], y[some], weights[some])
                waves = _waves(places[some] if len(places) > 1 else places, along_x)
                values = _samples(rule, element, rows, points)
                inner[:, some] = _product(waves, values)
            if weight != 1:
                inner *= weight
            waves = _waves(y - middle[1], along_y)
            total += _product(waves, inner.reshape(count, len(y), -1))
    return total.reshape(count, *halves)


def _samples(
    rule: TiltSum, element: Aperture, rows: tuple[Floats, Floats, Floats], points: Floats
) -> Complex:
    """Channels of the field at nodes times waves to points (p, 3): (channels, m, n, p).

    ``rows`` : x (m, n), y (m,) and weights (m, n) of the nodes.
    """
    source, condition, wavelength = rule.source, rule.condition, rule.wavelength
    x, y, weights = rows
    px, py, z = points.T
    squares = (x[..., None] - px) ** 2 + ((y[:, None] - py) ** 2)[:, None]
    reach = np.sqrt(squares + z * z)
    # the phase relative to the phase of the height, whose cycles would be rounded
    cycles = squares / ((reach + z) * wavelength)
    cycles -= np.rint(cycles)
    cycles *= 2 * math.pi
    sine, cosine = np.sin(cycles), np.cos(cycles)
    inverse = 1.0 / reach
    size = inverse * (weights / wavelength)[..., None]
    nodes = np.stack([x, np.broadcast_to(y[:, None], x.shape)], axis=-1)
    found = np.empty((len(rule.channels), *reach.shape), np.complex128)
    for kappa, values in zip(rule.channels, found, strict=True):
        if kappa is None:
            field = field_at(element, nodes.reshape(-1, 2))
            if not source.is_flat:
                field = field * _curved_wave(source, nodes.reshape(-1, 2))
            # the wave times (z/R) (1 + i/(kR))
            size_of_field = size * inverse * (condition.field * z)
            imaginary = size_of_field * inverse * (wavelength / (2 * math.pi))
            values.real = size_of_field * sine + imaginary * cosine
            values.imag = imaginary * sine - size_of_field * cosine
        else:
            amplitude = sum(a for a, nu in waves_of(element) if (nu == kappa).all())
            field = condition.slope * amplitude * np.exp(2j * math.pi * (nodes @ kappa))
            values.real, values.imag = size * sine, -size * cosine
        if np.ndim(field):
            values *= field.reshape(x.shape)[..., None]
    return found


def _curved_wave(source: Wavefront, x: Floats) -> Complex:
    away = x - source.centre
    return np.asarray(np.exp(1j * np.pi * ((away @ source.curvature) * away).sum(axis=1)))


def _waves(x: Floats, axis: Axis) -> Floats:
    """Cosines and sines of 2 pi x t at x (..., n) and tilts t >= 0: (..., 2 (half + 1), n)."""
    turn = np.exp(2j * math.pi * axis.step * x)[..., None, :]
    powers = np.repeat(turn, axis.half + 1, axis=-2)
    powers[..., 0, :] = 1.0
    np.multiply.accumulate(powers, axis=-2, out=powers)
    return np.concatenate([powers.real, powers.imag], axis=-2)


def _of_both_signs(sums: Complex, axis: int) -> Complex:
    """Sums over waves exp(2 pi i x t) of both signs of t, from those over cosines and sines."""
    cosines, sines = np.split(sums, 2, axis=axis)
    sines = 1j * sines
    negative = np.flip(cosines - sines, axis).take(range(cosines.shape[axis] - 1), axis)
    return np.concatenate([negative, cosines + sines], axis=axis)


def _product(table: Floats, values: Complex) -> Complex:
    """The matrix product, in pieces that BLAS computes on one thread.

    Its threads wait for each other, which takes longer than such products on a busy machine.
    """
    numbers = values.view(np.float64)
    stacked = np.broadcast_shapes(table.shape[:-2], values.shape[:-2])
    product = np.empty((*stacked, table.shape[-2], numbers.shape[-1]))
    step = max(1, _SERIAL // (table.shape[-1] * _COLUMNS))
    for low in range(0, table.shape[-2], step):
        rows = slice(low, low + step)
        for first in range(0, numbers.shape[-1], _COLUMNS):
            columns = slice(first, first + _COLUMNS)
            np.matmul(table[..., rows, :], numbers[..., columns], out=product[..., rows, columns])
    return product.view(np.complex128)
