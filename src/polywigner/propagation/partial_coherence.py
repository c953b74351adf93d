"""Irradiance of partially coherent light, with parabolic or spherical waves.

The irradiance is a mean over random tilts of a coherent source. The tilts, in cycles per metre,
have a standard deviation of 1/(2 pi width) for the coherence width (PC2). Parabolic waves need a
convolution (PC9). For spherical waves, all tilts use the same samples of the source. For small
coherence widths, :mod:`.lag_sums` is faster.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from polywigner.execution.progress import with_progress
from polywigner.geometry import Aperture, Wavefront
from polywigner.geometry.convex import trapezoids
from polywigner.geometry.rings import sides_of
from polywigner.numerics import Complex, Floats, Indices, index_blocks
from polywigner.numerics.chirps import waves_of_cycles
from polywigner.numerics.nodes import Cells, cell_rules, gaussian_product_rule
from polywigner.optics import FirstOrder
from polywigner.propagation.lag_sums import (
    Channel,
    channel_at,
    channels_of,
    largest_rates,
    node_counts,
    summed_over_lags,
    summed_over_pairs,
)
from polywigner.source.normal_form import SourceElement, normal_form
from polywigner.source.obliquities import CONDITIONS, Obliquity, direction_cosines
from polywigner.transforms.wavefronts import coherent_source

Compute = Callable[[Any, Floats], Floats]
"""Function that returns the irradiance and error (2, n) of a coherent source at n points."""


def partly_coherent_irradiance(
    compute: Compute,
    source: Wavefront,
    points: Floats,
    wavelength: float,
    method: str,
    system: FirstOrder | None,
    error: float,
) -> Floats | None:
    """Return irradiances and errors (2, n), or None if a separate field for each tilt is faster.

    Points have the shape (n, 2) behind a first-order system, otherwise (n, 3). ``error`` is
    relative to the largest irradiance.
    """
    if system is not None or method == "fresnel":
        return _in_parabolic_waves(compute, source, points, wavelength, system, error)
    if method not in CONDITIONS:
        return None
    # This call raises the errors of invalid arguments.
    compute(coherent_source(source), points[:1])
    values = _in_spherical_waves(source, points, wavelength, CONDITIONS[method], error)
    return None if values is None else _with_error(values, error)


def _with_error(values: Floats, error: float) -> Floats:
    """Return irradiances, and an error relative to the largest irradiance, shape (2, n)."""
    return np.stack([values, np.full(len(values), error * float(values.max(initial=0.0)))])


# Size of the source [coherence widths] above which sums over lags are tried first.
_SHORT = 30.0
# Largest number of lattice points in a plane, and largest number of field points in all planes.
_MOST_IN_LATTICE, _MOST_POINTS = 1 << 24, 1 << 22
# Number of array elements per block.
_BLOCK = 1 << 22


def _in_parabolic_waves(
    compute: Compute,
    source: Wavefront,
    points: Floats,
    wavelength: float,
    system: FirstOrder | None,
    error: float,
) -> Floats | None:
    """Return irradiances and errors (2, n) of Fresnel fields, or behind a first-order system.

    The result is None if sums over lags do not converge and convolutions need too many nodes.
    """
    heights, plane_of = np.zeros(1), np.zeros(len(points), np.intp)
    systems = [system]
    if system is None:
        heights, plane_of = np.unique(points[:, 2], return_inverse=True)
        systems = [FirstOrder.free_space(height) for height in heights.tolist()]
    planes = [(s, np.flatnonzero(plane_of == k)) for k, s in enumerate(systems) if s is not None]
    blurs = [_blur_of(source, plane.B, wavelength) for plane, _ in planes]

    def by_lags() -> Floats | None:
        """Return irradiances and errors as sums over lags, or None if they do not converge."""
        values = np.empty(len(points))
        for plane, members in planes:
            part = summed_over_lags(source, points[members, :2], wavelength, plane, error)
            if part is None:
                return None
            values[members] = part
        return _with_error(values, error)

    def by_convolution() -> Floats | None:
        """Return irradiances and errors as convolutions, or None for too many nodes."""
        rules = []
        for (_, members), blur in zip(planes, blurs, strict=True):
            rule = _convolution(points[members, :2], blur, error)
            if rule is None:
                return None
            rules.append(rule)
        nodes = [x for x, _ in rules]
        counts = [len(x) for x in nodes]
        if sum(counts) > _MOST_POINTS:
            return None
        samples = np.concatenate(nodes)
        if system is None:
            samples = np.column_stack([samples, np.repeat(heights, counts)])
        values = compute(coherent_source(source), samples)
        parts = np.split(values, np.cumsum(counts)[:-1], axis=-1)
        means = np.empty((len(values), len(points)))
        for (_, members), (_, mean), part in zip(planes, rules, parts, strict=True):
            means[:, members] = mean(part)
        means[1:] += error * float(means[0].max(initial=0.0))
        return means

    is_short = max(float(blur.extents.max()) for blur in blurs) > _SHORT
    first, second = (by_lags, by_convolution) if is_short else (by_convolution, by_lags)
    values = first()
    return second() if values is None else values


class _Blur(NamedTuple):
    """Blur of the irradiance in a plane by random tilts of the source."""

    axes: Floats
    """Principal directions as columns, shape (2, 2)."""
    spreads: Floats
    """Standard deviations along the principal directions in m, shape (2,)."""
    extents: Floats
    """Extents of the source along the principal directions in coherence widths, shape (2,)."""


def _blur_of(source: Wavefront, transfer: Floats, wavelength: float) -> _Blur:
    """Return the blur of the irradiance by random tilts, behind a system with the matrix B.

    A tilt t displaces the irradiance by ``wavelength B t``.
    """
    axes, scales, right = np.linalg.svd(transfer)
    extents = (abs(right) @ sides_of(source.bounds)) / source.coherence_width
    spreads = wavelength * scales / (2 * math.pi * source.coherence_width)
    return _Blur(axes, spreads, extents)


def _convolution(
    points: Floats, blur: _Blur, error: float
) -> tuple[Floats, Callable[[Floats], Floats]] | None:
    """Return m nodes (m, 2), and a function that maps values (k, m) at the nodes to means (k, n).

    The rule is either a trapezoidal rule on a common lattice, or a Gauss-Hermite rule about each
    point, whichever has fewer nodes. The result is None if both have too many nodes.
    """
    steps = math.sqrt(2.0 * math.log(16.0 / error))
    along = points @ blur.axes
    first, second = (
        _lattice_axis(along[:, k], float(blur.spreads[k]), float(blur.extents[k]), steps)
        for k in (0, 1)
    )
    nodes, weights = gaussian_product_rule(tuple(blur.extents.tolist()), error)
    count = len(points) * len(weights) if (blur.spreads > 0).all() else math.inf
    blocks = index_blocks(len(points), _BLOCK // (first.near.shape[1] * second.near.shape[1]))
    shape = len(first.nodes), len(second.nodes)
    if math.prod(shape) <= _MOST_IN_LATTICE:
        needed = np.zeros(shape, bool)
        for block in blocks:
            needed[first.near[block][:, :, None], second.near[block][:, None, :]] = True
        if np.count_nonzero(needed) <= count:
            x, y = np.nonzero(needed)

            def mean_on_lattice(values: Floats) -> Floats:
                """Return means (k, n) of values (k, m) at the lattice points."""
                table = np.zeros((*values.shape[:-1], *shape))
                table[..., needed] = values
                means = np.empty((*values.shape[:-1], len(points)))
                for block in blocks:
                    near = table[..., first.near[block][:, :, None], second.near[block][:, None, :]]
                    factors = first.weights[block], second.weights[block]
                    means[..., block] = np.einsum("...nij,ni,nj->...n", near, *factors)
                return means

            lattice = np.column_stack([first.nodes[x], second.nodes[y]])
            return lattice @ blur.axes.T, mean_on_lattice
    if count > _MOST_POINTS:
        return None
    shifted = along[:, None] + nodes * blur.spreads

    def mean_of_nodes(values: Floats) -> Floats:
        """Return means (k, n) of values (k, m) at the nodes of all points."""
        return np.asarray(values.reshape(*values.shape[:-1], len(points), -1) @ weights)

    return shifted.reshape(-1, 2) @ blur.axes.T, mean_of_nodes


class _LatticeAxis(NamedTuple):
    """Lattice nodes along an axis, and their weights in the means about n points."""

    nodes: Floats
    """Coordinates of the nodes in m, shape (m,)."""
    near: Indices
    """Indices of the nodes near each point, shape (n, k)."""
    weights: Floats
    """Weights of the nodes near each point, shape (n, k)."""


def _lattice_axis(along: Floats, spread: float, extent: float, steps: float) -> _LatticeAxis:
    """Return lattice nodes along an axis, and normal weights of the nodes near each point.

    ``along`` (n,) contains the coordinates of the points, and ``extent`` is the extent of the
    source in coherence widths. The weights extend to ``steps`` times the standard deviation
    ``spread``, and the error is exp(-steps^2/2).
    """
    # The irradiance is band-limited to extent/(2 pi spread), so the aliasing error is
    # exp(-steps^2/2).
    step = 2 * math.pi * spread / (extent + steps)
    # Without blur along this axis, the nodes are the points themselves.
    if step <= 1e-12 * float(np.ptp(along)) or spread == 0.0:
        nodes, near = np.unique(along, return_inverse=True)
        return _LatticeAxis(nodes, near[:, None], np.ones((len(along), 1)))
    half = math.ceil(steps * spread / step)
    origin = float(along.min())
    centre = np.rint((along - origin) / step).astype(np.intp)
    # Only the lattice nodes near a point are used.
    numbers = np.unique(np.unique(centre)[:, None] + np.arange(-half, half + 1))
    near = np.searchsorted(numbers, centre - half)[:, None] + np.arange(2 * half + 1)
    nodes = origin + step * numbers
    distance = (nodes[near] - along[:, None]) / spread
    weights = np.exp(-0.5 * distance * distance)
    return _LatticeAxis(nodes, near, weights / weights.sum(axis=1, keepdims=True))


# The factor exp(2 pi i t.x) of a tilt t separates into x and y. One matrix product transforms each
# row of nodes from y to t_y, and a second product transforms all rows from x to t_x.

# Relative error of the quadrature over the source.
_QUADRATURE = 1e-9
# The quadrature resolves tilts up to this fraction of the largest tilt. Larger tilts have
# negligible weights.
_RESOLVED = 0.8
# Largest number of points that share a quadrature rule, largest number of array elements per
# spectrum over tilts, and largest number of array elements per block.
_SHARED, _SPECTRUM, _BATCH = 16, 1 << 20, 1 << 16
# Computing times [ns] of sums over tilts at one point. _NODE is the time for each quadrature node,
# and _TILT is the time for each pair of a row of nodes and a tilt.
_NODE, _TILT = 60.0, 2.0
# Computing times [ns] of boundary integrals at one point for one tilt. _WAVELENGTH is the time for
# each wavelength of edge length, and _EDGE is the time for each edge.
_WAVELENGTH, _EDGE = 250.0, 1e4
# Longest computing time [ns] of sums over pairs, per point.
_LONGEST_TIME = 1e10


class _TiltAxis(NamedTuple):
    """Quadrature rule for tilts along an axis."""

    step: float
    """Difference of adjacent tilts in cycles per metre."""
    half: int
    """Number of positive tilts."""
    weights: Floats
    """Weights of the tilts, which add up to 1."""

    @property
    def tilts(self) -> Floats:
        """Tilts in cycles per metre, in ascending order."""
        return np.asarray(self.step * np.arange(-self.half, self.half + 1), np.float64)


def _tilt_axis(tail: float, extent: float, width: float) -> _TiltAxis:
    """Return a quadrature rule for tilts along an axis, up to ``tail`` standard deviations.

    The step is 2 pi/extent standard deviations.
    """
    step = 2 * math.pi / extent
    half = math.ceil(tail / step)
    weights = np.exp(-0.5 * (step * np.arange(-half, half + 1)) ** 2)
    return _TiltAxis(step / (2 * math.pi * width), half, weights / weights.sum())


class _TiltSum(NamedTuple):
    """Source and quadrature rule of a mean over tilts."""

    source: Wavefront
    elements: Sequence[SourceElement]
    wavelength: float
    condition: Obliquity
    channels: Sequence[Channel]
    axes: Sequence[_TiltAxis]


def _in_spherical_waves(
    source: Wavefront, points: Floats, wavelength: float, condition: Obliquity, error: float
) -> Floats | None:
    """Return the irradiance at points (n, 3), or None if boundary integrals are the fastest method.

    The other methods are sums over tilts (Q7) and over pairs of points (PC11).
    """
    tail = math.sqrt(2 * math.log(8 / error))
    extents = sides_of(source.bounds) / source.coherence_width + tail
    count = math.prod((tail * extents / math.pi + 1).tolist())
    axes = [_tilt_axis(tail, extent, source.coherence_width) for extent in extents.tolist()]
    channels, form = channels_of(source, condition), normal_form(source)
    elements = form.in_plane.elements
    rates = largest_rates(source, points, wavelength)
    rates += [_RESOLVED * axis.half * axis.step for axis in axes]
    order = np.argsort(rates.max(axis=1), kind="stable")
    size = min(_SHARED, _SPECTRUM // (count * len(channels)))
    is_curved = condition.needs_normal_derivative and not source.is_flat
    blocks, time = [], math.inf if is_curved or count > _SPECTRUM else 0.0
    for block in index_blocks(len(points), size):
        members = order[block]
        counts = [
            node_counts(
                _trapezoids(element.outline),
                rates[members].max(axis=0),
                _QUADRATURE,
                float(points[members, 2].min()),
            )
            for element in elements
        ]
        blocks.append((members, counts))
        for rows, on_row in np.concatenate(counts).tolist():
            time += len(members) * rows * (_NODE * on_row + _TILT * count)
    cycles = sum(element.shape.polygons.length for element in elements) / wavelength
    per_tilt = _WAVELENGTH * cycles + _EDGE * sum(len(ring) for ring in form.rings)
    by_boundaries = len(points) * min(count * per_tilt, _LONGEST_TIME)
    if (sides_of(source.bounds) > _SHORT * source.coherence_width).all():
        longest = min(time, by_boundaries)
        values = summed_over_pairs(source, points, wavelength, condition, error, longest)
        if values is not None:
            return values
    if time > by_boundaries:
        return None
    rule = _TiltSum(source, elements, wavelength, condition, channels, axes)
    return _summed_over_tilts(rule, points, blocks)


def _summed_over_tilts(
    rule: _TiltSum, points: Floats, blocks: Sequence[tuple[Indices, Sequence[Indices]]]
) -> Floats:
    """Return the mean of |U|^2 (Q7) over tilts at points (n, 3).

    Each block contains indices of points, and the node counts of each element.
    """
    plane = np.stack(np.meshgrid(*(axis.tilts for axis in rule.axes), indexing="ij"), axis=-1)
    cosines: list[Any] = [
        1.0 if kappa is None else direction_cosines(plane + kappa, rule.wavelength)[..., None]
        for kappa in rule.channels
    ]
    values = np.empty(len(points))
    with with_progress("blocks of points", blocks) as remaining:
        for members, counts in remaining:
            spectra = _spectra(rule, points[members], counts)
            spectra = _of_both_signs(_of_both_signs(spectra, 1), 2)
            total = sum(c * spectrum for c, spectrum in zip(cosines, spectra, strict=True))
            intensity = np.square(total.real) + np.square(total.imag)
            over_x, over_y = (axis.weights for axis in rule.axes)
            values[members] = over_y @ np.tensordot(over_x, intensity, 1)
    return values


@lru_cache(maxsize=64)
def _trapezoids(outline: Aperture) -> Cells:
    """Return the cached corners (n, 4, 2) of trapezoids that tile an outline."""
    return trapezoids(outline.rings).corners


def _spectra(rule: _TiltSum, points: Floats, counts: Sequence[Indices]) -> Complex:
    """Return integrals over the source, with axes (channel, t_x, t_y, point).

    The first half of a tilt axis contains the factors cos(2 pi x t) for t >= 0, and the second half
    the factors sin(2 pi x t). For each element and cell, ``counts`` contains the number of rows of
    constant x and the number of nodes per row.
    """
    along_x, along_y = rule.axes
    channels = len(rule.channels)
    halves = (2 * (along_x.half + 1), 2 * (along_y.half + 1), len(points))
    total = np.zeros((channels, halves[0], halves[1] * halves[2]), np.complex128)
    centre = np.reshape(rule.source.bounds, (2, 2)).mean(axis=0)
    for element, of_element in zip(rule.elements, counts, strict=True):
        rules = cell_rules(_trapezoids(element.outline), of_element)
        for nodes, weights in (pair for _, *parts in rules for pair in zip(*parts, strict=True)):
            x, y = nodes[:, 0, 0] - centre[0], nodes[..., 1] - centre[1]
            # All rows of a rectangle have the same y coordinates, so a single row is sufficient.
            rows = y if np.ptp(y, axis=0).any() else y[:1]
            inner = np.empty((channels, len(x), *halves[1:]), np.complex128)
            columns = channels * len(points) + (along_y.half if len(rows) > 1 else 0)
            for block in index_blocks(len(x), _BATCH // (y.shape[1] * columns)):
                waves = _cosines_and_sines(rows[block] if len(rows) > 1 else rows, along_y)
                values = _integrand(rule, element, nodes[block], weights[block], points)
                inner[:, block] = _real_product(waves, values)
            inner *= element.weight
            waves = _cosines_and_sines(x, along_x)
            total += _real_product(waves, inner.reshape(channels, len(x), -1))
    return total.reshape(channels, *halves)


def _integrand(
    rule: _TiltSum, element: SourceElement, nodes: Floats, weights: Floats, points: Floats
) -> Complex:
    """Return the weighted integrand of (Q7) without tilt, with axes (channel, row, node, point)."""
    source, condition, wavelength = rule.source, rule.condition, rule.wavelength
    px, py, z = points.T
    squares = (nodes[..., :1] - px) ** 2 + (nodes[..., 1:] - py) ** 2
    distance = np.sqrt(squares + z * z)
    # This form of the phase R - z avoids cancellation. The omitted phase z is constant and does not
    # change the irradiance.
    waves = waves_of_cycles(squares / ((distance + z) * wavelength)) / (1j * distance)
    waves *= (weights / wavelength)[..., None]
    samples = []
    for kappa in rule.channels:
        field = np.asarray(channel_at(element, kappa, nodes))
        values = condition.slope * waves
        if kappa is None:
            if not source.is_flat:
                offset = nodes - source.centre
                field = field * waves_of_cycles(((offset @ source.curvature) * offset).sum(-1) / 2)
            near = 1.0 + (0.5j * wavelength / math.pi) / distance
            values = (condition.field * z / distance) * near * waves
        samples.append(values * field[..., None])
    return np.stack(samples)


def _cosines_and_sines(x: Floats, axis: _TiltAxis) -> Floats:
    """Return cos(2 pi x t), then sin(2 pi x t), for t >= 0, shape (..., 2 (half + 1), n)."""
    factor = np.exp(2j * math.pi * axis.step * x)[..., None, :]
    powers = np.repeat(factor, axis.half + 1, axis=-2)
    powers[..., 0, :] = 1.0
    np.multiply.accumulate(powers, axis=-2, out=powers)
    return np.concatenate([powers.real, powers.imag], axis=-2)


def _of_both_signs(sums: Complex, axis: int) -> Complex:
    """Convert sums with cosines and sines to sums with exp(2 pi i x t), in ascending order of t."""
    cosines, sines = np.split(sums, 2, axis=axis)
    sines = 1j * sines
    negative = np.flip(cosines - sines, axis).take(range(cosines.shape[axis] - 1), axis)
    return np.concatenate([negative, cosines + sines], axis=axis)


def _real_product(table: Floats, values: Complex) -> Complex:
    """Multiply a real matrix by a complex matrix, for which BLAS has no function."""
    return np.asarray((table @ values.view(np.float64)).view(np.complex128))
