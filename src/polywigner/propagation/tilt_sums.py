"""Irradiance of partially coherent light as a mean over tilts whose fields share samples.

A tilt multiplies the source by exp(2 pi i t.x), a product of one factor for each axis. The source
is sampled on rows along x, with Gauss nodes on the trapezoids between the heights of its vertices.
One matrix product transforms each row from x to t_x, a second one the rows from y to t_y.
"""

from __future__ import annotations

import math
from functools import lru_cache
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from polywigner.execution.progress import told
from polywigner.geometry import Aperture, Wavefront
from polywigner.illumination import Array
from polywigner.illumination.obliquities import CONDITIONS, direction_cosines
from polywigner.numerics.nodes import chirp_node_counts
from polywigner.propagation.source_samples import field_at, largest_rates, waves_of
from polywigner.transforms.wavefronts import flat_of

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]
Indices = NDArray[np.intp]

# Relative error of the quadrature on the source, for nodes that count for less than the tilts.
_QUADRATURE = 1e-11
# Radians of phase from the centre of a panel to its ends.
_LONGEST_PANEL = 200.0
# Extra nodes for the pole of the kernel, which lies off the plane by the distance of a point,
# times arcsinh of this distance over half of the size.
_POLE = 4.0
# Most points of a block, which share nodes; values of a spectrum and of a batch of rows.
_POINTS, _SPECTRUM, _BATCH = 16, 1 << 21, 1 << 16
# Products of numbers in a matrix product that BLAS does not share among threads; columns of it.
_SERIAL, _COLUMNS = 1 << 18, 16
# Nanoseconds of a node for each point; of a multiplication; of a trapezoid in a block of points.
_NODE, _PRODUCT, _TRAPEZOID = 40.0, 0.15, 3e5
# Nanoseconds of a wavelength along the outline, and of an edge, for integrals along edges.
_WAVELENGTH, _EDGE = 250.0, 1e4


class Axis(NamedTuple):
    """The trapezoidal rule for normal tilts along an axis, at -half to half steps."""

    step: float
    """In cycles per metre."""
    half: int
    weights: Floats
    """(2 half + 1,), with the sum 1."""


class Block(NamedTuple):
    """Points that share nodes on the source."""

    points: Indices
    rates: Floats
    """(2,) largest frequencies of the integrand over the source along x and y in 1/m."""
    nearest: float
    """Least z of the points in m."""


class TiltSum(NamedTuple):
    """Tilts, and blocks of points."""

    axes: tuple[Axis, Axis]
    blocks: list[Block]
    cost: float
    """Estimated nanoseconds for each point."""


def tilt_sum(
    source: Wavefront, points: Floats, wavelength: float, method: str, error: float
) -> TiltSum | None:
    """The sum for points (n, 3); None if there are too many tilts, or for a curved wave by slopes.

    ``error`` : of the mean over tilts, relative to the largest irradiance.
    """
    takes_slopes = CONDITIONS[method].takes_slopes
    tail = math.sqrt(2 * math.log(8 / error))
    sides = np.subtract(*np.reshape(source.bounds, (2, 2))[::-1])
    reaches = sides / source.coherence_width + tail
    count = math.prod((tail * reaches / math.pi + 1).tolist())
    if count > _SPECTRUM or (takes_slopes and not source.is_flat):
        return None
    axes = [_axis(tail, reach, source.coherence_width) for reach in reaches.tolist()]
    rates = largest_rates(source, points, wavelength)
    rates += [axis.half * axis.step for axis in axes]
    order = np.argsort(rates.max(axis=1), kind="stable")
    channels = len(_channels(source, method))
    size = int(min(_POINTS, max(1, _SPECTRUM // (count * channels))))
    trapezoids = np.concatenate([_trapezoids(element) for element, _ in _elements(source)])
    blocks, cost = [], 0.0
    for start in range(0, len(points), size):
        some = order[start : start + size]
        block = Block(some, rates[some].max(axis=0), float(points[some, 2].min()))
        rows, columns = (a.prod(axis=0) for a in _counts(trapezoids, block))
        nodes, width = float((rows * columns).sum()), len(axes[0].weights)
        products = nodes * width + float(rows.sum()) * count
        work = _NODE * nodes + _PRODUCT * channels * products
        cost += work * len(some) + _TRAPEZOID * len(trapezoids)
        blocks.append(block)
    return TiltSum((axes[0], axes[1]), blocks, cost / len(points))


def _axis(tail: float, reach: float, width: float) -> Axis:
    """Steps of 2 pi/reach standard deviations up to ``tail``."""
    step = 2 * math.pi / reach
    half = math.ceil(tail / step)
    weights = np.exp(-0.5 * (step * np.arange(-half, half + 1)) ** 2)
    return Axis(step / (2 * math.pi * width), half, weights / weights.sum())


def summed_over_tilts(
    rule: TiltSum, source: Wavefront, points: Floats, wavelength: float, method: str
) -> Floats:
    """Irradiance (n,) at points (n, 3), by (Q7)."""
    found = np.empty(len(points))
    along_x, along_y = rule.axes
    tilts = [axis.step * np.arange(-axis.half, axis.half + 1) for axis in rule.axes]
    plane = np.stack(np.meshgrid(*tilts), axis=-1)
    channels = _channels(source, method)
    with told("blocks of points", rule.blocks) as blocks:
        for block in blocks:
            spectra = _spectra(rule, block, source, points[block.points], wavelength, method)
            total = np.zeros(spectra.shape[1:], np.complex128)
            for kappa, spectrum in zip(channels, spectra, strict=True):
                if kappa is not None:
                    spectrum *= direction_cosines(plane + kappa, wavelength)[..., None]
                total += spectrum
            intensity = total.real**2 + total.imag**2
            found[block.points] = along_x.weights @ np.tensordot(along_y.weights, intensity, 1)
    return found


def _channels(source: Wavefront, method: str) -> list[Any]:
    """The parts of the field: None, and the frequency of each wave whose slope counts."""
    condition = CONDITIONS[method]
    channels: list[Any] = [None] if condition.field else []
    if condition.slope:
        waves = [kappa for element, _ in _elements(source) for _, kappa in waves_of(element)]
        channels += list(np.unique(waves, axis=0))
    return channels


def _elements(source: Wavefront) -> list[tuple[Aperture, complex]]:
    flat = flat_of(source)
    weights = flat.weights.tolist() if isinstance(flat, Array) else [1.0]
    return list(zip(flat.elements_in_plane, weights, strict=True))


@lru_cache(maxsize=64)
def _trapezoids(element: Aperture) -> Floats:
    """Trapezoids (n, 3, 2) that tile an outline, between heights of vertices.

    y, x on the left, and x on the right, of the lower and the upper side.
    """
    begin = np.concatenate(element.rings)
    end = np.concatenate([np.roll(ring, -1, axis=0) for ring in element.rings])
    found = []
    for low, high in pairwise(np.unique(begin[:, 1]).tolist()):
        across = (begin[:, 1] <= low) != (end[:, 1] <= low)
        a, b = begin[across], end[across]
        share = (np.array([[low], [high]]) - a[:, 1]) / (b - a)[:, 1]
        x = a[:, 0] + share * (b - a)[:, 0]
        left, right = (x[:, np.argsort(x.sum(axis=0))[k::2]].T for k in (0, 1))
        found.append(np.stack([np.broadcast_to([low, high], left.shape), left, right], axis=1))
    return np.concatenate(found)


def _counts(trapezoids: Floats, block: Block) -> tuple[Indices, Indices]:
    """Panels, and nodes of each, (2, n): of the rows of trapezoids, and of the nodes on a row."""
    y, left, right = trapezoids.transpose(1, 0, 2)
    height, width = y[:, 1] - y[:, 0], (right - left).max(axis=1)
    aslant = np.maximum(abs(np.diff(left)), abs(np.diff(right)))[:, 0]
    over_x, over_y = block.rates
    turns = np.stack([over_y * height + over_x * aslant, over_x * width])
    panels = np.maximum(np.ceil(math.pi * turns / _LONGEST_PANEL), 1.0)
    sizes = np.stack([np.maximum(height, aslant), width]) / 2
    with np.errstate(divide="ignore"):
        pole = np.ceil(_POLE / np.arcsinh(block.nearest * panels / sizes))
    each = chirp_node_counts(math.pi * turns / panels, _QUADRATURE) + pole
    counts = np.stack([panels, each], axis=1).astype(np.intp)
    return counts[0], counts[1]


def _rule(panels: int, count: int) -> tuple[Floats, Floats]:
    """Nodes and weights on [0, 1]."""
    nodes, weights = _legendre(count)
    nodes = (np.arange(panels)[:, None] + (nodes + 1) / 2) / panels
    return nodes.ravel(), np.tile(weights / (2 * panels), panels)


@lru_cache(maxsize=256)
def _legendre(count: int) -> tuple[Floats, Floats]:
    return np.polynomial.legendre.leggauss(count)


def _spectra(
    rule: TiltSum, block: Block, source: Wavefront, points: Floats, wavelength: float, method: str
) -> Complex:
    """Channels of the fields of all tilts at points (p, 3): (channels, t_y, t_x, p)."""
    along_x, along_y = rule.axes
    channels = _channels(source, method)
    found = np.zeros(
        (len(channels), len(along_y.weights), len(along_x.weights), len(points)), np.complex128
    )
    middle = np.reshape(source.bounds, (2, 2)).mean(axis=0)
    for element, weight in _elements(source):
        trapezoids = _trapezoids(element)
        for (y, left, right), rows, columns in zip(
            trapezoids, *(a.T for a in _counts(trapezoids, block)), strict=True
        ):
            share, of_rows = _rule(*rows.tolist())
            place, on_row = _rule(*columns.tolist())
            heights, start, stop = (a[0] + share * (a[1] - a[0]) for a in (y, left, right))
            is_even = bool(np.ptp(left) == np.ptp(right) == 0)
            shape = (len(channels), len(share), len(along_x.weights), len(points))
            inner = np.empty(shape, np.complex128)
            most = len(channels) * len(points) + (0 if is_even else along_x.half)
            step = max(1, _BATCH // (len(place) * most))
            for k in range(0, len(share), step):
                some = slice(k, k + step)
                length = (stop - start)[some, None]
                x = start[some, None] + length * place
                nodes = (x, heights[some], (y[1] - y[0]) * of_rows[some, None] * length * on_row)
                values = _samples(source, element, nodes, points, wavelength, method, channels)
                columns_x = (x[:1] if is_even else x) - middle[0]
                inner[:, some] = _transformed(values, columns_x, along_x)
            flat = inner.reshape(len(channels), len(share), -1)
            spectra = _transformed(flat, heights - middle[1], along_y)
            found += weight * spectra.reshape(found.shape)
    return found


def _samples(
    source: Wavefront,
    element: Aperture,
    rows: tuple[Floats, Floats, Floats],
    points: Floats,
    wavelength: float,
    method: str,
    channels: list[Any],
) -> Complex:
    """Channels of the field at nodes times waves to points (p, 3): (channels, m, n, p).

    ``rows`` : x (m, n), y (m,) and weights (m, n) of the nodes.
    """
    condition, k = CONDITIONS[method], 2 * math.pi / wavelength
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
    found = np.empty((len(channels), *reach.shape), np.complex128)
    for kappa, values in zip(channels, found, strict=True):
        if kappa is None:
            field = field_at(element, nodes.reshape(-1, 2))
            if not source.is_flat:
                field = field * _curved_wave(source, nodes.reshape(-1, 2))
            # the wave times (z/R) (1 + i/(kR))
            size_of_field = size * inverse * (condition.field * z)
            imaginary = size_of_field * inverse / k
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


def _transformed(values: Complex, x: Floats, axis: Axis) -> Complex:
    """Sums over n of values (..., n, p) times exp(2 pi i x t) at x (..., n): (..., t, p).

    Opposite tilts share products of real numbers, with cosines and sines.
    """
    turn = np.exp(2j * math.pi * axis.step * x)[..., None, :]
    powers = np.repeat(turn, axis.half + 1, axis=-2)
    powers[..., 0, :] = 1.0
    np.multiply.accumulate(powers, axis=-2, out=powers)
    table = np.concatenate([powers.real, powers.imag], axis=-2)
    product = _product(table, values.view(np.float64)).view(np.complex128)
    cosines, sines = np.split(product, 2, axis=-2)
    sines = 1j * sines
    return np.concatenate([(cosines - sines)[..., :0:-1, :], cosines + sines], axis=-2)


def _product(table: Floats, values: Floats) -> Floats:
    """The matrix product, in pieces that BLAS computes on one thread.

    Its threads wait for each other, which takes longer than such products on a busy machine.
    """
    stacked = np.broadcast_shapes(table.shape[:-2], values.shape[:-2])
    count = values.shape[-1]
    found = np.empty((*stacked, table.shape[-2], count))
    step = max(1, _SERIAL // (table.shape[-1] * _COLUMNS))
    for row in range(0, table.shape[-2], step):
        for column in range(0, count, _COLUMNS):
            piece = np.s_[..., column : column + _COLUMNS]
            np.matmul(
                table[..., row : row + step, :],
                values[piece],
                out=found[..., row : row + step, column : column + _COLUMNS],
            )
    return found


def cost_of_edges(source: Wavefront, wavelength: float) -> float:
    """Estimated nanoseconds of the field at a point by integrals along edges."""
    elements = flat_of(source).elements_in_plane
    around = sum(element.polygons.length for element in elements) / wavelength
    edges = sum(len(ring) for element in elements for ring in element.rings)
    return float(around * _WAVELENGTH + edges * _EDGE)
