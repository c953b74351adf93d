"""Irradiance of partially coherent light as integrals over short lags.

A lag is the difference of two positions on the source. Only lags of a few coherence widths
contribute. The integrand is the ambiguity function for parabolic waves (PC10), and an integral over
midpoints for spherical waves (PC11).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from itertools import product
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray

from polywigner.geometry import Wavefront
from polywigner.geometry.parts import grid_size, polygons_in, shifted
from polywigner.geometry.rings import edges_of_rings, sides_of
from polywigner.numerics import Complex, Floats, Indices, index_blocks
from polywigner.numerics.nodes import (
    Cells,
    chirp_node_counts,
    gaussian_product_rule,
    rule_over_cells,
)
from polywigner.optics import FirstOrder
from polywigner.source.normal_form import SourceElement, normal_form
from polywigner.source.obliquities import Obliquity, direction_cosines
from polywigner.transforms import ambiguity

Channel = Floats | None
"""None for the field, or the spatial frequency (2,) of a plane wave for its normal derivative."""

# Longest lag [coherence widths]. The degree of coherence at longer lags is below 1e-10.
_LONGEST = 6.8
# Error of the coarsest quadrature rule for a plane wave.
_ERROR = 1e-7
# Highest resolved frequency of the degree of coherence, times the coherence width.
_OF_NORMAL = 0.48
# Numbers of additional nodes of successive quadrature rules.
_LEVELS = (0, 2, 5, 10, 18)
# Largest number of kinks of the ambiguity function that divide the lags into cells.
_MOST_KINKS = 2000
# Largest number of lags for fields behind first-order optical systems.
_MOST_NODES = 1 << 20
# Number of array elements per block.
_BLOCK = 1 << 22


def _sum_over_lags(
    irradiance: Callable[[Floats, Floats, int], Floats],
    cells: Cells,
    rates: Floats,
    error: float,
) -> Floats | None:
    """Integrate the irradiance over lags; return None if successive rules do not converge.

    ``irradiance(lags, weights, extra)`` returns the contribution of lags (m, 2) with ``extra``
    additional nodes. ``rates`` (2,) are the highest frequencies of the integrand in 1/m, and
    ``error`` is relative to the largest irradiance.
    """
    previous: Floats | None = None
    for extra in _LEVELS:
        lags, weights, _ = rule_over_cells(cells, node_counts(cells, rates, _ERROR) + extra)
        # Opposite lags contribute equally, and the cells cover half of the lags.
        values = irradiance(lags, 2.0 * weights, extra)
        if previous is not None and abs(values - previous).max() <= error * abs(values).max():
            return values
        previous = values
    return None


def _longest_lags(source: Wavefront) -> Floats:
    """Return the longest lags along x and y in m that contribute to the irradiance."""
    return np.asarray(np.minimum(sides_of(source.bounds), _LONGEST * source.coherence_width))


def _lag_cells(source: Wavefront) -> Cells:
    """Return trapezoids that tile the lags with y >= 0.

    No kink of the ambiguity function crosses a trapezoid if there are at most _MOST_KINKS kinks.
    """
    # Kinks of the ambiguity function lie on the segments V - E for all vertices V and edges E.
    longest = _longest_lags(source)
    half = shapely.box(-longest[0], 0.0, longest[0], longest[1])
    begin, end = edges_of_rings(normal_form(source).rings)
    kinks: list[Any] = []
    for some in index_blocks(len(begin), 256):
        vertices = begin[some, None]
        segments = np.stack([vertices - begin, vertices - end], axis=2).reshape(-1, 2, 2)
        lines = shapely.linestrings(segments)
        kinks.extend(lines[shapely.intersects(lines, half) & (shapely.length(lines) > 0)])
        if len(kinks) > _MOST_KINKS:
            return _trapezoids_in([half])[0]
    cut = shapely.intersection(np.array(kinks, object), half)
    noded = shapely.union_all([*cut, half.boundary], grid_size=grid_size(np.diag(longest)))
    return _trapezoids_in(np.array(polygons_in(shapely.polygonize([noded])), object))[0]


def summed_over_lags(
    source: Wavefront, points: Floats, wavelength: float, system: FirstOrder, error: float
) -> Floats | None:
    """Return the irradiance (n,) at points (n, 2) in m behind a first-order system by (PC10).

    ``error`` is relative to the largest irradiance. The result is None if B is singular (an image
    along at least one direction), if the quadrature rule has too many nodes, or if successive rules
    do not converge.
    """
    determinant = abs(float(np.linalg.det(system.B)))
    if not determinant > 0.0:
        return None
    inverse = np.linalg.inv(system.B)
    bend, nu = inverse @ system.A / wavelength, points @ inverse.T / wavelength
    bend = (bend + bend.T) / 2
    (x0, y0), (x1, y1) = np.reshape(source.bounds, (2, 2))
    corners = np.array([(x0, y0), (x0, y1), (x1, y0), (x1, y1)])
    rates = corners @ (bend + source.curvature) - source.curvature @ source.centre - nu[:, None]
    frequencies = normal_form(source).frequencies
    highest = float(np.linalg.norm(frequencies, axis=1).max())
    largest = abs(rates).max(axis=(0, 1), initial=0.0) + highest
    largest = np.hypot(largest, _OF_NORMAL / source.coherence_width)
    cells = _lag_cells(source)
    if node_counts(cells, largest, _ERROR).prod(axis=1).sum() > _MOST_NODES:
        return None

    def irradiance(lags: Floats, weights: Floats, extra: int) -> Floats:
        """Return the contribution of lags (m, 2) to the irradiance at all points."""
        values = np.asarray(ambiguity(source, -lags @ bend, lags)) * weights
        total = np.empty(len(points))
        for block in index_blocks(len(points), _BLOCK // len(lags)):
            waves = np.exp(-2j * np.pi * (nu[block] @ lags.T))
            total[block] = (waves @ values).real
        return total / (wavelength**2 * determinant)

    return _sum_over_lags(irradiance, cells, largest, error)


# Computing times [ns] for each lag. _PAIR is the time for each field point and pair of source
# points, and _CUT is the time for each vertex of the overlapping outlines.
_PAIR, _CUT = 60.0, 2e4
# Computing time of the two coarsest rules together, divided by the time of the coarsest rule.
_TWO_RULES = 2.5
# Tilt [standard deviations] up to which plane waves must not graze the source plane.
_GRAZING = 5.0
# Allowed error of means over tilts.
_MEAN_ERROR = 1e-8
# Number of lags per block.
_LAGS = 256
# Number of pairs and of field points per block, small enough for the processor's cache.
_PAIRS, _POINTS = 1 << 12, 4


def channels_of(source: Wavefront, condition: Obliquity) -> list[Channel]:
    """Return the field and the normal derivatives that a boundary condition requires.

    None stands for the field, and a frequency (2,) in 1/m for the normal derivative of a plane
    wave.
    """
    channels: list[Channel] = [None] if condition.field else []
    return channels + (list(normal_form(source).frequencies) if condition.slope else [])


def channel_at(element: SourceElement, channel: Channel, x: Floats) -> Complex | float:
    """Return the field or a plane wave of an element at positions x, without its weight.

    ``x`` (..., 2) is in m; the result has the shape (...), or is 1 for a uniform field.
    """
    if channel is None:
        return 1.0 if element.illumination is None else element.illumination(x)
    amplitude = element.amplitudes[(element.frequencies == channel).all(axis=1)].sum()
    return np.asarray(amplitude * np.exp(2j * np.pi * (x @ channel)))


def summed_over_pairs(
    source: Wavefront,
    points: Floats,
    wavelength: float,
    condition: Obliquity,
    error: float,
    longest_time: float,
) -> Floats | None:
    """Return the irradiance of partially coherent light at points (n, 3) by (PC11).

    The result is None if the estimated time exceeds ``longest_time`` in ns, if the rules do not
    converge, or if normal derivatives of curved or grazing waves are required.
    """
    width, form = source.coherence_width, normal_form(source)
    steepest = np.linalg.norm(form.frequencies, axis=1).max() + _GRAZING / (2 * np.pi * width)
    is_steep = wavelength * steepest < 1.0 and source.is_flat
    if condition.needs_normal_derivative and not is_steep:
        return None
    elements = form.in_plane.elements
    # ``bend`` is an upper bound on the second derivatives of the phase [cycles/m^2].
    bend = 1.0 / (wavelength * points[:, 2].min()) + float(np.linalg.norm(source.curvature, 2))
    largest = 2.0 * abs(form.frequencies).max(axis=0)

    def mean_rates(lags: Floats) -> Floats:
        """Return the highest frequencies along x and y of the integrand over midpoints."""
        return np.asarray(bend * np.linalg.norm(lags, axis=-1, keepdims=True) + largest)

    extent = _longest_lags(source)
    rates = largest_rates(source, points, wavelength).max(axis=0)
    rates = np.hypot(rates, _OF_NORMAL / width)
    cells = _lag_cells(source)
    polygons = shapely.get_parts([element.shape.polygons for element in elements])
    tiles, _ = _trapezoids_in(polygons)
    counts = [node_counts(cells, rates, _ERROR), node_counts(tiles, mean_rates(extent / 2), _ERROR)]
    lag_count, mean_count = (float(count.prod(axis=1).sum()) for count in counts)
    time = len(points) * _PAIR * mean_count + _CUT * sum(len(ring) for ring in form.rings)
    if _TWO_RULES * lag_count * time > longest_time:
        return None
    channels = channels_of(source, condition)
    groups = 1 + (condition.field > 0 and condition.slope > 0)
    neighbours = [
        (a, b)
        for a, b in product(elements, repeat=2)
        if a.shape.polygons.distance(b.shape.polygons) <= np.linalg.norm(extent)
    ]

    def irradiance(lags: Floats, weights: Floats, extra: int) -> Floats:
        """Return the contribution of lags (m, 2) to the irradiance at all points."""
        total = np.zeros(len(points))
        for block in index_blocks(len(lags), _LAGS):
            xi = lags[block]
            degrees = _degrees(channels, xi, width, wavelength) * weights[block]
            for a, b in neighbours:
                x, amounts, lag_of = _point_pairs(a, b, xi, mean_rates(xi), extra)
                lag = xi[lag_of]
                cycles = ((x - source.centre) @ source.curvature * lag).sum(axis=1)
                factor = amounts * a.weight * np.conj(b.weight) * np.exp(2j * np.pi * cycles)
                first = [factor * channel_at(a, c, x + lag / 2) for c in channels]
                second = [np.conj(channel_at(b, c, x - lag / 2)) for c in channels]
                # Propagation multiplies all normal derivatives by the same factor, so their
                # products are added.
                mutual = np.zeros((groups, groups, len(x)), np.complex128)
                for (i, u), (j, v) in product(enumerate(first), enumerate(second)):
                    mutual[min(i, groups - 1), min(j, groups - 1)] += degrees[i, j][lag_of] * u * v
                k = 2 * math.pi / wavelength
                total += _sum_of_waves(points, x, lag, mutual, condition, k)
        return total / wavelength**2

    return _sum_over_lags(irradiance, cells, rates, error)


def _degrees(channels: Sequence[Channel], lags: Floats, width: float, wavelength: float) -> Complex:
    """Return the degrees of coherence (a, b, n) of channels a and b at lags xi (n, 2).

    The degrees are means of ``p_a conj(p_b) exp(2 pi i t.xi)`` over tilts t. The factor p is 1 for
    the field, and the direction cosine p_z of the tilted wave for a normal derivative. For two
    values of the field, the degree of coherence is exp(-|xi|^2/(2 width^2)).
    """
    if all(channel is None for channel in channels):
        return np.exp(-0.5 * (lags**2).sum(axis=1) / width**2).astype(complex)[None, None]
    extent = float(np.linalg.norm(lags, axis=1).max()) / width
    nodes, weights = gaussian_product_rule((extent, extent), _MEAN_ERROR)
    tilts = nodes / (2 * math.pi * width)
    cosines = np.stack(
        [
            np.ones(len(tilts)) if kappa is None else direction_cosines(tilts + kappa, wavelength)
            for kappa in channels
        ]
    )
    waves = np.exp(2j * np.pi * (lags @ tilts.T)) * weights
    # A product by BLAS would start threads, which takes longer than these small products.
    return np.asarray(np.einsum("at,bt,lt->abl", cosines, cosines.conj(), waves))


def _point_pairs(
    first: SourceElement, second: SourceElement, lags: Floats, rates: Floats, extra: int
) -> tuple[Floats, Floats, Indices]:
    """Return midpoints x (n, 2), weights and lag indices (n,) of pairs of points on two elements.

    A pair has its points at x + lag/2 on ``first`` and x - lag/2 on ``second``. ``rates`` (m, 2)
    contains the highest frequencies for the lags (m, 2), and ``extra`` is the number of additional
    nodes per side.
    """
    ahead, behind = (np.full(len(lags), e.shape.polygons, object) for e in (first, second))
    common = shapely.intersection(shifted(ahead, -lags / 2), shifted(behind, lags / 2))
    parts, lag_of_part = shapely.get_parts(common, return_index=True)
    has_area = shapely.area(parts) > 0
    if not has_area.any():
        return np.empty((0, 2)), np.empty(0), np.empty(0, np.intp)
    cells, part_of = _trapezoids_in(parts[has_area])
    lag_of_cell = lag_of_part[has_area][part_of]
    counts = node_counts(cells, rates[lag_of_cell], _ERROR) + extra
    nodes, weights, cell_of = rule_over_cells(cells, counts)
    return nodes, weights, lag_of_cell[cell_of]


def _sum_of_waves(
    points: Floats, means: Floats, lags: Floats, mutual: Complex, condition: Obliquity, k: float
) -> Floats:
    """Return the irradiance at points (n, 3) for pairs with mutual intensities (c, c, m).

    The c terms are those of ``condition``: the field, the normal derivative divided by ik, or both.
    The first index belongs to the point mean + lag/2. Mutual intensities include quadrature weights
    in m^4; the factor 1/wavelength^2 is omitted. ``means`` and ``lags`` (m, 2) are the midpoints
    and differences of the pairs, and ``k`` is the wavenumber in rad/m.
    """
    total = np.zeros(len(points))

    def factors(z: Floats, distance: Floats, k: float) -> list[Complex | float]:
        """Return the factors of the field and of its normal derivative at one end of a pair.

        ``k`` is negative at the conjugated end. Factors that the condition does not contain are
        omitted.
        """
        slope = np.asarray(condition.field * (z / distance) * (1 + 1j / (k * distance)), complex)
        values: list[Complex | float] = [slope] if condition.field else []
        return values + ([condition.slope] if condition.slope else [])

    for pairs, block in product(
        index_blocks(len(means), _PAIRS), index_blocks(len(points), _POINTS)
    ):
        (x, y), (xi, eta) = means[pairs].T, lags[pairs].T
        px, py, z = points[block].T[:, :, None]
        dx, dy = x - px, y - py
        along = dx * xi + dy * eta
        square = dx * dx + dy * dy + (z * z + 0.25 * (xi * xi + eta * eta))
        first, second = np.sqrt(square + along), np.sqrt(square - along)
        # This form of the difference of two distances avoids cancellation.
        phase = (2 * k) * along / (first + second)
        waves = (np.cos(phase) + 1j * np.sin(phase)) / (first * second)
        terms = zip(
            product(factors(z, first, k), factors(z, second, -k)),
            mutual[..., pairs].reshape(-1, len(x)),
            strict=True,
        )
        value = sum(ahead * behind * weights for (ahead, behind), weights in terms)
        # A product by BLAS would start threads, which takes longer than these short sums.
        total[block] += (waves.real * value.real - waves.imag * value.imag).sum(axis=1)
    return total


# Number of pairs (edge, vertex height) per block.
_BATCH = 1 << 20
# A pole at the distance d from a cell of size 2 a requires _POLE/arcsinh(d/a) additional nodes.
_POLE = 4.0


def _trapezoids_in(
    polygons: Sequence[shapely.Polygon] | NDArray[np.object_],
) -> tuple[Cells, Indices]:
    """Return trapezoids that tile polygons, cut at all vertices, and their polygon indices."""
    rings, of_ring = shapely.get_rings(polygons, return_index=True)
    vertices, ring = shapely.get_coordinates(rings, return_index=True)
    is_edge = ring[1:] == ring[:-1]
    edges = np.stack([vertices[:-1], vertices[1:]], axis=1)[is_edge]
    owner = of_ring[ring[:-1][is_edge]]
    counts = np.bincount(owner)
    parts, owners = [], []
    for count in np.unique(counts[counts > 0]).tolist():
        same = np.flatnonzero(counts == count)
        step = max(1, _BATCH // count**2)
        for block in np.split(same, range(step, len(same), step)):
            block_edges = edges[np.isin(owner, block)].reshape(-1, count, 2, 2)
            trapezoids, indices = _between_heights(block_edges)
            parts.append(trapezoids)
            owners.append(block[indices])
    return np.concatenate(parts), np.concatenate(owners)


def _between_heights(edges: Floats) -> tuple[Cells, Indices]:
    """Return the trapezoids of polygons with equal numbers of edges, and their polygon indices.

    The axes of ``edges`` are polygon, edge, end and coordinate.
    """
    (x, y), (end_x, end_y) = edges.transpose(2, 3, 0, 1)[..., None, :]
    heights = np.sort(y[:, 0])
    low, high = heights[:, :-1, None], heights[:, 1:, None]
    across = ((y <= low) != (end_y <= low)) & (low < high)
    slope = (end_x - x) / np.where(end_y == y, np.inf, end_y - y)
    ends = np.stack([np.where(across, x + (level - y) * slope, np.inf) for level in (low, high)])
    ends = np.take_along_axis(ends, np.argsort(ends.sum(axis=0), axis=-1)[None], axis=-1)
    pairs = ends[..., : 2 * (ends.shape[-1] // 2)].transpose(1, 2, 3, 0)
    x = np.concatenate([pairs[:, :, ::2], pairs[:, :, 1::2]], axis=-1)[..., [0, 2, 1, 3]]
    y = np.broadcast_to(np.concatenate([low, low, high, high], axis=-1)[:, :, None], x.shape)
    is_inside = np.isfinite(x).all(axis=-1)
    return np.stack([x, y], axis=-1)[is_inside], np.nonzero(is_inside)[0]


def node_counts(cells: Cells, rates: Floats, error: float, nearest: float = math.inf) -> Indices:
    """Return the numbers of quadrature nodes along both sides of each cell, shape (n, 2).

    ``rates``, shape (2,) or (n, 2), contains the highest frequencies of the integrand along x and y
    in 1/m. ``nearest`` is the distance in m of the nearest pole of the integrand.
    """
    origin, first, second, last = cells.transpose(1, 0, 2)
    sides = np.abs([[first - origin, last - second], [second - origin, last - first]])
    cycles = (sides * rates).sum(axis=-1).max(axis=1).T
    sizes = np.linalg.norm(sides, axis=-1).max(axis=1).T / 2
    with np.errstate(divide="ignore"):
        poles = np.ceil(_POLE / np.arcsinh(nearest / sizes))
    return np.asarray(chirp_node_counts(math.pi * cycles, error) + poles.astype(np.intp))


def largest_rates(source: Wavefront, points: Floats, wavelength: float) -> Floats:
    """Return the highest frequencies [1/m] along x and y of the field times a wave to a point.

    The result has the shape (n, 2) for n points.
    """
    low, high = np.reshape(source.bounds, (2, 2))
    corners = np.array([(x, y) for x in (low[0], high[0]) for y in (low[1], high[1])])
    away = corners - points[:, None, :2]
    # Along each axis, the phase slope is steepest at the smallest perpendicular distance.
    outside = np.maximum(np.maximum(low - points[:, :2], points[:, :2] - high), 0.0)[:, ::-1]
    distance = np.sqrt(away**2 + (outside**2 + points[:, 2:] ** 2)[:, None])
    slopes = away / (wavelength * distance) + (corners - source.centre) @ source.curvature
    return np.asarray(abs(slopes).max(axis=1) + abs(normal_form(source).frequencies).max(axis=0))
