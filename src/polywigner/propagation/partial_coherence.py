"""Irradiance of partly coherent light, at fewer fields than one for each point and tilt.

The degree of coherence is the mean of exp(2 pi i t.xi) over normal tilts t of the standard deviation
1/(2 pi width) (PC2). Three forms of the same mean:

- In parabolic waves a tilt shifts the irradiance as it is. The mean is a convolution with a normal
  density, which all points share (:func:`convolved`).
- A coherence width far below the size of the source leaves short lags only. Parabolic waves need A
  at these lags (:func:`summed_over_lags`).
- In spherical waves the fields of all tilts are sums over the same nodes on the source
  (:func:`summed_over_nodes`).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import shapely
from numpy.typing import NDArray

from polywigner.errors import ArgumentError
from polywigner.execution.progress import told
from polywigner.geometry import Aperture, Wavefront
from polywigner.geometry.parts import grid_size, polygons_in
from polywigner.illumination import Array, Illumination
from polywigner.illumination.obliquities import CONDITIONS, direction_cosines
from polywigner.numerics.nodes import normal_product_rule
from polywigner.optics import FirstOrder
from polywigner.propagation.arrangement import (
    gauss_rule,
    node_count,
    rule_by_triangles,
    triangulated,
)
from polywigner.transforms import ambiguity
from polywigner.transforms.wavefronts import coherent_source, flat_of, tilts_of

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]
Indices = NDArray[np.intp]

# Points of one lattice, and of all lattices, at which fields are computed.
_MOST_IN_LATTICE, _MOST_POINTS = 1 << 24, 1 << 22
# Points and neighbours at a time.
_BLOCK = 1 << 22


class _Share(NamedTuple):
    """Points (m, 2) at which the coherent irradiance is needed, and the mean of its values."""

    points: Floats
    mean: Callable[[Floats], Floats]


class Blur(NamedTuple):
    """The normal density of the shifts of an irradiance by tilts."""

    axes: Floats
    """(2, 2), columns: its principal directions in the plane of the points."""
    spreads: Floats
    """(2,) its standard deviations along them in m."""
    reaches: Floats
    """(2,) sides of the source, in coherence widths, that interfere along them."""


def blur_of(source: Wavefront, transfer: Floats, wavelength: float) -> Blur:
    """The blur by the tilts of a source: a tilt t shifts points by wavelength ``transfer`` t.

    ``transfer`` : (2, 2) in m, B of a first-order system.
    """
    axes, scales, right = np.linalg.svd(transfer)
    size = np.subtract(*np.reshape(source.bounds, (2, 2))[::-1])
    reaches = (abs(right) @ size) / source.coherence_width
    spreads = wavelength * scales / (2 * math.pi * source.coherence_width)
    return Blur(axes, spreads, reaches)


def convolved(
    compute: Callable[[list[Floats]], Floats], groups: list[Floats], blurs: list[Blur], error: float
) -> Floats | None:
    """Irradiances at points of several planes, (n, 2) each, blurred; None for too many points.

    ``compute`` : points of each plane -> coherent irradiances (k, m) of all of them.
    ``error`` : relative to the largest irradiance. The rules are the trapezoidal rule on a lattice
    that the points of a plane share, and Gauss-Hermite's at each point: the one of fewer fields.
    """
    shares = [
        _share_of(points, blur, error) for points, blur in zip(groups, blurs, strict=True)
    ]  # fmt: skip
    if any(share is None for share in shares):
        return None
    parts = [share for group in shares if group is not None for share in group]
    if sum(len(share.points) for share in parts) > _MOST_POINTS:
        return None
    counts = [sum(len(share.points) for share in group or ()) for group in shares]
    values = compute(
        [np.concatenate([share.points for share in group or ()]) for group in shares]
    )  # fmt: skip
    assert values.shape[-1] == sum(counts)
    ends = np.cumsum([len(share.points) for share in parts])[:-1]
    pieces = np.split(values, ends, axis=-1)
    found = [share.mean(piece) for share, piece in zip(parts, pieces, strict=True)]
    return np.concatenate(found, axis=-1)


def _share_of(points: Floats, blur: Blur, error: float) -> list[_Share] | None:
    """Where the irradiance is needed for points (n, 2) of a plane; in parts if they lie far off."""
    steps = math.sqrt(2.0 * math.log(16.0 / error))
    along = points @ blur.axes
    axes = [
        _lattice_axis(along[:, k], float(blur.spreads[k]), float(blur.reaches[k]), steps)
        for k in (0, 1)
    ]
    size = math.prod(len(axis.places) for axis in axes)
    if size > _MOST_IN_LATTICE:
        if len(points) == 1:
            return None
        axis = int(np.ptp(along, axis=0).argmax())
        order = np.argsort(along[:, axis], kind="stable")
        halves = np.array_split(order, 2)
        parts = [_share_of(points[half], blur, error) for half in halves]
        if parts[0] is None or parts[1] is None:
            return None
        return [_reordered(parts[0] + parts[1], [len(half) for half in halves], order)]
    return [_cheapest(points, along, axes, blur, error)]


def _reordered(shares: list[_Share], _: list[int], order: Indices) -> _Share:
    """Shares of points in an order as one share."""
    ends = np.cumsum([len(share.points) for share in shares])[:-1]

    def mean(values: Floats) -> Floats:
        pieces = np.split(values, ends, axis=-1)
        found = np.concatenate(
            [share.mean(piece) for share, piece in zip(shares, pieces, strict=True)], axis=-1
        )
        result = np.empty_like(found)
        result[..., order] = found
        return result

    return _Share(np.concatenate([share.points for share in shares]), mean)


class _Axis(NamedTuple):
    """Places (m,) of a lattice along an axis; those near points (n, k), and their weights."""

    places: Floats
    near: Indices
    weights: Floats


def _lattice_axis(along: Floats, spread: float, reach: float, steps: float) -> _Axis:
    """The trapezoidal rule for a normal density about points (n,), on one lattice.

    The irradiance has frequencies up to reach/(2 pi spread), so that steps of
    2 pi spread/(reach + steps) leave exp(-steps^2/2) of it by aliases.
    """
    step = 2 * math.pi * spread / (reach + steps)
    if step <= 1e-12 * float(np.ptp(along)) or spread == 0.0:  # no blur along this axis
        places, near = np.unique(along, return_inverse=True)
        return _Axis(places, near[:, None], np.ones((len(along), 1)))
    half = math.ceil(steps * spread / step)
    origin = float(along.min())
    first = np.rint((along - origin) / step).astype(np.intp)
    near = first[:, None] + np.arange(2 * half + 1)
    places = origin + step * np.arange(-half, int(first.max()) + half + 1)
    away = (places[near] - along[:, None]) / spread
    weights = np.exp(-0.5 * away * away)
    return _Axis(places, near, weights / weights.sum(axis=1, keepdims=True))


def _cheapest(
    points: Floats, along: Floats, axes: list[_Axis], blur: Blur, error: float
) -> _Share:
    """The lattice, or a rule at each point where that takes fewer fields."""
    nodes, weights = normal_product_rule(tuple(blur.reaches.tolist()), error)
    first, second = axes
    needed = np.zeros((len(first.places), len(second.places)), bool)
    step = max(1, _BLOCK // (first.near.shape[1] * second.near.shape[1]))
    blocks = [slice(k, k + step) for k in range(0, len(points), step)]
    for some in blocks:
        needed[first.near[some][:, :, None], second.near[some][:, None, :]] = True
    count = int(np.count_nonzero(needed))
    if (blur.spreads > 0).all() and len(points) * len(weights) < count:
        shifted = along[:, None] + nodes * blur.spreads

        def mean_of_rule(values: Floats) -> Floats:
            return np.asarray(values.reshape(*values.shape[:-1], len(points), -1) @ weights)

        return _Share(shifted.reshape(-1, 2) @ blur.axes.T, mean_of_rule)
    here = np.nonzero(needed)
    places = np.column_stack([first.places[here[0]], second.places[here[1]]])

    def mean_of_lattice(values: Floats) -> Floats:
        table = np.zeros((*values.shape[:-1], *needed.shape))
        table[..., needed] = values
        found = np.empty((*values.shape[:-1], len(points)))
        for some in blocks:
            near = table[..., first.near[some][:, :, None], second.near[some][:, None, :]]
            found[..., some] = np.einsum(
                "...nij,ni,nj->...n", near, first.weights[some], second.weights[some]
            )
        return found

    return _Share(places @ blur.axes.T, mean_of_lattice)


# --- short lags

# Lags in coherence widths beyond which the degree of coherence is 1e-10 and less.
_LONGEST = 6.8
# Nodes along a side of a triangle of lags beyond those of the phase, rule after rule.
_LEVELS = (10.0, 14.0, 20.0, 28.0)
# Segments of kinks that are looked for, and nodes.
_MOST_KINKS, _MOST_NODES = 2000, 1 << 20


def lag_nodes(source: Wavefront, rate: float) -> Callable[[float], Any] | None:
    """A function of the level that gives a rule on half of the lags; None for too many nodes.

    ``rate`` : largest frequency of the integrand over lags in 1/m.
    """
    cells = lag_cells(source)
    if node_count(cells, rate, _LEVELS[1]) > _MOST_NODES:
        return None

    def rule(level: float) -> Any:
        nodes, weights = gauss_rule(cells, rate, level)
        return nodes, 2.0 * weights

    return rule


def lag_cells(source: Wavefront) -> Floats:
    """Triangles (n, 3, 2) of half of the lags, without kinks of A inside, where they are few."""
    reach = _LONGEST * source.coherence_width
    size = np.subtract(*np.reshape(source.bounds, (2, 2))[::-1])
    low, high = np.maximum(-size, -reach), np.minimum(size, reach)
    box = shapely.box(*low, *high)
    half = shapely.box(low[0], 0.0, high[0], high[1])
    return triangulated(_cells_of_lags(flat_of(source), box, half))


def _cells_of_lags(source: Aperture | Array, box: Any, half: Any) -> Any:
    """Polygons of lags in half of the box that no kink of A crosses: V_i - E_k, all i and k."""
    rings = [ring for element in source.elements_in_plane for ring in element.rings]
    begin = np.concatenate(rings)
    end = np.concatenate([np.roll(ring, -1, axis=0) for ring in rings])
    found: list[Any] = []
    for start in range(0, len(begin), 256):
        vertices = begin[start : start + 256, None]
        segments = np.stack([vertices - begin, vertices - end], axis=2).reshape(-1, 2, 2)
        lines = shapely.linestrings(segments)
        found.extend(lines[shapely.intersects(lines, half) & (shapely.length(lines) > 0)])
        if len(found) > _MOST_KINKS:
            return np.array([half], object)
    grid = grid_size(shapely.get_coordinates(box))
    cut = shapely.intersection(np.array(found, object), half)
    noded = shapely.union_all([*cut, half.boundary], grid_size=grid)
    return np.array(polygons_in(shapely.polygonize([noded])), object)


def summed_over_lags(
    source: Wavefront, points: Floats, wavelength: float, system: Any, error: float
) -> Floats | None:
    """Irradiance at points (n, 2) behind a first-order system; None for too many nodes.

    The Fourier transform of A(-M xi/wavelength, xi) times the degree of coherence, M = B^-1 A. Sums
    converge if two rules agree within ``error`` of the largest irradiance.
    """
    inverse = np.linalg.inv(system.B)
    bend, nu = inverse @ system.A / wavelength, points @ inverse.T / wavelength
    bend = (bend + bend.T) / 2
    corners = np.reshape(source.bounds, (2, 2))
    corners = np.array([(x, y) for x in corners[:, 0] for y in corners[:, 1]])
    curved = bend + source.curvature
    slopes = corners @ curved - source.curvature @ source.centre - nu[:, None]
    rate = float(np.linalg.norm(slopes, axis=-1).max(initial=0.0)) + _highest(source)
    rule = lag_nodes(source, rate)
    if rule is None:
        return None
    before: Floats | None = None
    for level in _LEVELS:
        lags, weights = rule(level)
        values = np.asarray(ambiguity(source, -lags @ bend, lags)) * weights
        found = np.empty(len(points))
        step = max(1, _BLOCK // len(lags))
        for start in range(0, len(points), step):
            some = nu[start : start + step]
            found[start : start + step] = (np.exp(-2j * np.pi * (some @ lags.T)) @ values).real
        found /= wavelength**2 * abs(float(np.linalg.det(system.B)))
        if before is not None and abs(found - before).max() <= error * abs(found).max():
            return found
        before = found
    return None


# Nodes along a side beyond those of the phase, of a triangle of lags and of one of mean positions.
_PAIR_LEVELS = ((8.0, 3.0), (10.0, 4.0), (14.0, 6.0), (20.0, 9.0), (28.0, 13.0))
# Nanoseconds of a pair of places for each point.
_PAIR = 60.0
# Nanoseconds of an intersection of two outlines, and of its triangles.
_CUT = 1e5
# Standard deviations of the tilts, beyond which waves may graze the plane.
_GRAZING = 5.0
# Nanoseconds for each point that are not spent on pairs.
_MOST_COST = 1e10


class PairSum(NamedTuple):
    """Pairs of places on the source at short lags, for the cost of the sum over them."""

    cells: Floats
    """Triangles (n, 3, 2) of lags."""
    rate: float
    """Largest frequency of the integrand over lags in 1/m."""
    rate_of_mean: float
    """Largest frequency over the mean position of a pair in 1/m."""
    cost: float
    """Nanoseconds for each point."""


def pair_sum(source: Wavefront, points: Floats, wavelength: float) -> PairSum:
    """The sum over pairs for points (n, 3)."""
    cells = lag_cells(source)
    rate = float(_largest_slopes(source, points, wavelength).max(initial=0.0))
    reach = float(np.linalg.norm(cells.reshape(-1, 2), axis=1).max())
    bend = float(np.linalg.norm(source.curvature, 2))
    bend += 1.0 / (wavelength * float(points[:, 2].min(initial=math.inf)))
    rate_of_mean = min(reach * bend, 2.0 * rate) + 2.0 * _highest(source)
    of_lags, of_mean = _PAIR_LEVELS[1]
    elements = flat_of(source).elements_in_plane
    triangles = np.concatenate([triangulated(list(e.polygons.geoms)) for e in elements])
    lags = node_count(cells, rate, of_lags)
    count = lags * node_count(triangles, rate_of_mean, of_mean)
    cut = _CUT * lags * len(elements) ** 2 / max(1, len(points))
    return PairSum(cells, rate, rate_of_mean, 1.6 * (_PAIR * count + cut))


def summed_over_pairs(
    rule: PairSum, source: Wavefront, points: Floats, wavelength: float, method: str, error: float
) -> Floats | None:
    """Irradiance (n,) at points (n, 3), by (Q7); None if no two rules agree to an ``error``.

    The error is relative to the largest irradiance.
    """
    before: Floats | None = None
    for of_lags, of_mean in _PAIR_LEVELS:
        nodes, weights = gauss_rule(rule.cells, rule.rate, of_lags)
        degrees = _degrees(source, nodes, wavelength, CONDITIONS[method].takes_slopes)
        rates = (rule.rate_of_mean, of_mean)
        pairs = _pairs_of(source, nodes, 2.0 * weights, rates, degrees)
        found = _sum_of_pairs(pairs, points, wavelength, method)
        if before is not None and abs(found - before).max() <= error * abs(found).max():
            return found
        before = found
    return None


class Pairs(NamedTuple):
    """Pairs of places on the source."""

    means: Floats
    """(n, 2) mean positions."""
    lags: Floats
    """(n, 2)."""
    weights: list[Complex]
    """(n,) mutual intensities times weights of the rule: of the fields; and if normal derivatives
    count, of the derivative and the field, the field and the derivative, and both derivatives."""


def _pairs_of(
    source: Wavefront, lags: Floats, weights: Floats, rates: tuple[float, float], degrees: Any
) -> Pairs:
    """Pairs at lags (n, 2). ``rates`` : frequency over mean positions, and nodes in addition."""
    flat = flat_of(source)
    factors = flat.weights.tolist() if isinstance(flat, Array) else [1.0]
    elements = list(zip(flat.elements_in_plane, factors, strict=True))
    found = []
    for one, a in elements:
        ahead = _shifted(one.polygons, -lags / 2)
        for other, b in elements:
            common = shapely.intersection(ahead, _shifted(other.polygons, lags / 2))
            parts, owner = shapely.get_parts(common, return_index=True)
            some = shapely.area(parts) > 0
            if not some.any():
                continue
            cut = shapely.constrained_delaunay_triangles(parts[some])
            triangles, of_part = shapely.get_parts(cut, return_index=True)
            corners = shapely.get_coordinates(triangles).reshape(-1, 4, 2)[:, :3]
            nodes, share, of_triangle = rule_by_triangles(corners, *rates)
            number = owner[some][of_part][of_triangle]
            xi = lags[number]
            turns = (((nodes - source.centre) @ source.curvature) * xi).sum(axis=1)
            factor = a * np.conj(b) * share * weights[number] * np.exp(2j * np.pi * turns)
            mutual = degrees(one, other, nodes, xi, number)
            found.append(Pairs(nodes, xi, [factor * each for each in mutual]))
    sums = [np.concatenate(parts) for parts in zip(*(p.weights for p in found), strict=True)]
    return Pairs(
        np.concatenate([p.means for p in found]), np.concatenate([p.lags for p in found]), sums
    )


def _degrees(source: Wavefront, lags: Floats, wavelength: float, has_slopes: bool) -> Any:
    """A function that gives the mutual intensities of two elements at means and lags (n, 2).

    The derivative along the normal of a wave kappa with the tilt t is ik p_z(kappa + t) times the
    wave, so that its mutual intensities are means of p_z over the tilts.
    """
    if not has_slopes:
        degree = np.exp(-0.5 * (lags**2).sum(axis=1) / source.coherence_width**2)

        def of_fields(one: Any, other: Any, means: Floats, xi: Floats, number: Indices) -> Any:
            first, second = _field_at(one, means + xi / 2), _field_at(other, means - xi / 2)
            return [degree[number] * first * np.conj(second)]

        return of_fields
    reach = 2 * float(np.linalg.norm(lags, axis=1).max()) / source.coherence_width
    nodes, shares = normal_product_rule((reach, reach), 1e-9)
    tilts = nodes / (2 * math.pi * source.coherence_width)
    waves = np.exp(2j * np.pi * (lags @ tilts.T)) * shares

    def of_slopes(one: Any, other: Any, means: Floats, xi: Floats, number: Indices) -> Any:
        total = [np.zeros(len(means), np.complex128) for _ in range(4)]
        for a, kappa in _waves_of(one):
            for b, nu in _waves_of(other):
                turns = (means + xi / 2) @ kappa - (means - xi / 2) @ nu
                product = a * np.conj(b) * np.exp(2j * np.pi * turns)
                ahead = direction_cosines(tilts + kappa, wavelength)
                behind = direction_cosines(tilts + nu, wavelength).conj()
                forms = np.stack([np.ones(len(tilts)), ahead, behind, ahead * behind])
                for each, degree in zip(total, forms @ waves.T, strict=True):
                    each += product * degree[number]
        return total

    return of_slopes


def _waves_of(element: Aperture) -> Any:
    field: Any = element.illumination
    if field is None:
        return [(1.0, np.zeros(2))]
    return list(zip(field.amplitudes.tolist(), field.frequencies, strict=True))


def _shifted(polygon: Any, shifts: Floats) -> Any:
    """Copies (n,) of a polygon at shifts (n, 2)."""
    copies = np.full(len(shifts), polygon, object)
    corners, owner = shapely.get_coordinates(copies, return_index=True)
    return shapely.set_coordinates(copies, corners + shifts[owner])


def _sum_of_pairs(pairs: Pairs, points: Floats, wavelength: float, method: str) -> Floats:
    """Sum over pairs of the mutual intensity times h(P - x_1) conj h(P - x_2)."""
    condition = CONDITIONS[method]
    found = np.zeros(len(points))
    k = 2 * math.pi / wavelength
    step = max(1, _PAIRS // _NODES)
    columns = (*pairs.means.T, *pairs.lags.T, 0.25 * (pairs.lags**2).sum(axis=1))
    for start in range(0, len(pairs.means), _NODES):
        some = slice(start, start + _NODES)
        x, y, xi, eta, quarter = (column[some] for column in columns)
        degrees = [weights[some] for weights in pairs.weights]
        mutual = degrees[0]
        is_complex = bool(mutual.imag.any())
        for low in range(0, len(points), step):
            px, py, z = points[low : low + step].T[:, :, None]
            dx, dy = x - px, y - py
            along = dx * xi + dy * eta
            square = dx * dx + dy * dy + (z * z + quarter)
            first, second = np.sqrt(square + along), np.sqrt(square - along)
            turn = (2 * k) * along / (first + second)
            cosine, sine = np.cos(turn), np.sin(turn)
            inverse = 1.0 / (first * second)
            if not condition.slope:
                # (1 + i/(k R_1)) (1 - i/(k R_2)) times the wave, without complex numbers
                real, imag = 1.0 + inverse / (k * k), (second - first) * (inverse / k)
                size = np.square(inverse * (z / wavelength))
                found[low : low + step] += (size * (cosine * real - sine * imag)) @ mutual.real
                if is_complex:
                    found[low : low + step] -= (size * (cosine * imag + sine * real)) @ mutual.imag
                continue
            wave = (cosine + 1j * sine) * (inverse / (wavelength * wavelength))
            a, b = condition.field, condition.slope
            one, other = a * _slope(z, first, k), a * _slope(z, second, k).conj()
            plain, ahead, behind, both = degrees
            value = (wave * one * other) @ plain + b * ((wave * other) @ ahead)
            value += b * ((wave * one) @ behind) + b * b * (wave @ both)
            found[low : low + step] += value.real
    return found


def _slope(z: Floats, radius: Floats, k: float) -> Complex:
    """Derivative along the normal of a spherical wave, over the wave times -ik."""
    return np.asarray((z / radius) * (1 + 1j / (k * radius)))


# --- sums over nodes on the source

# Nodes along a side of a triangle beyond those of the phase, for 1e-9 of the field; and cycles of
# phase that stand for the pole of the kernel at a distance, which lies as far off the plane.
_EXTRA, _POLE = 8.0, 1.6
# Share of the largest tilt, whose weight is next to nothing, that the nodes resolve.
_STEEPEST = 0.7
# Nanoseconds of a node for each tilt; of a wavelength along the outline, and of an edge, whose
# integrals take the place of nodes.
_NODE, _WAVELENGTH, _EDGE = 0.7, 250.0, 1e4
# Pairs of a point and a node at a time, in the cache and in matrices; and nodes at a time.
_PAIRS, _MATRIX, _NODES = 1 << 16, 1 << 20, 1 << 12


class NodeSum(NamedTuple):
    """Fields of all tilts as sums over the same nodes on the source."""

    nodes: Floats
    fields: list[tuple[Complex, Complex]]
    """Weights (n,) of the rule times a field, and its cosines p_z (t,) in the light of each tilt."""
    tilts: Floats
    shares: Floats


def node_sum(
    source: Wavefront, points: Floats, wavelength: float, method: str, rule: tuple[Floats, Floats]
) -> NodeSum | None:
    """The sum for points (n, 3); None where integrals along edges take less time.

    ``rule`` : tilts and their shares, of :func:`tilts_of`.
    """
    has_slopes = CONDITIONS[method].takes_slopes
    if has_slopes and not source.is_flat:
        return None
    flat, (tilts, shares) = flat_of(source), rule
    rate = float(_largest_slopes(source, points, wavelength).max(initial=0.0))
    rate += _STEEPEST * float(np.linalg.norm(tilts, axis=1).max(initial=0.0))
    rate = max(rate, _POLE / float(points[:, 2].min(initial=math.inf)))
    elements = [(flat, 1.0)]
    if isinstance(flat, Array):
        elements = list(zip(flat.elements_in_plane, flat.weights.tolist(), strict=True))
    triangles = [triangulated(list(element.polygons.geoms)) for element, _ in elements]
    count = sum(node_count(found, rate, _EXTRA) for found in triangles)
    if not count * _NODE <= _cost_of_edges(source, wavelength):
        return None
    rules = [gauss_rule(found, rate, _EXTRA) for found in triangles]
    nodes = np.concatenate([x for x, _ in rules])
    if not has_slopes:
        parts = [w * a * _field_at(e, x) for (x, a), (e, w) in zip(rules, elements, strict=True)]
        field = np.concatenate(parts) * _curved_wave(source, nodes)
        return NodeSum(nodes, [(field, np.zeros(len(tilts), np.complex128))], tilts, shares)
    ends = np.cumsum([0, *(len(a) for _, a in rules)])
    fields: dict[tuple[float, ...], Complex] = {}
    for k, ((x, a), (element, w)) in enumerate(zip(rules, elements, strict=True)):
        own = element.illumination or Illumination([1.0], [(0.0, 0.0)])
        for amplitude, kappa in zip(own.amplitudes, own.frequencies, strict=True):
            wave = fields.setdefault(tuple(kappa.tolist()), np.zeros(len(nodes), np.complex128))
            wave[ends[k] : ends[k + 1]] += w * a * amplitude * np.exp(2j * np.pi * (x @ kappa))
    waves = [(f, direction_cosines(tilts + k, wavelength)) for k, f in fields.items()]
    return NodeSum(nodes, waves, tilts, shares)


def _field_at(element: Aperture, x: Floats) -> Any:
    return 1.0 if element.illumination is None else element.illumination(x)


def _curved_wave(source: Wavefront, x: Floats) -> Complex:
    away = x - source.centre
    return np.asarray(np.exp(1j * np.pi * ((away @ source.curvature) * away).sum(axis=1)))


def _largest_slopes(source: Wavefront, points: Floats, wavelength: float) -> Floats:
    """Most cycles per metre of the field on the source times the waves to each point, (n,)."""
    low, high = np.reshape(source.bounds, (2, 2))
    corners = np.array([(x, y) for x in (low[0], high[0]) for y in (low[1], high[1])])
    away = corners - points[:, None, :2]
    distance = np.sqrt((away**2).sum(axis=-1) + points[:, None, 2] ** 2)
    slopes = away / (wavelength * distance[..., None])
    slopes = slopes + (corners - source.centre) @ source.curvature
    return np.asarray(np.linalg.norm(slopes, axis=-1).max(axis=-1) + _highest(source))


def _highest(source: Wavefront) -> float:
    """Highest frequency of the waves on a source in 1/m."""
    fields = [element.illumination for element in flat_of(source).elements_in_plane]
    waves = [field.frequencies for field in fields if field is not None]
    return max((float(np.linalg.norm(w, axis=1).max()) for w in waves), default=0.0)


def summed_over_nodes(rule: NodeSum, points: Floats, wavelength: float, method: str) -> Floats:
    """Irradiance (n,) at points (n, 3), by (Q7)."""
    condition = CONDITIONS[method]
    found = np.empty(len(points))
    step = max(1, _MATRIX // max(_NODES, len(rule.shares)))
    k = 2 * math.pi / wavelength
    with told("points", range(0, len(points), step)) as starts:
        for start in starts:
            some = points[start : start + step]
            total = np.zeros((len(some), len(rule.shares)), np.complex128)
            for first in range(0, len(rule.nodes), _NODES):
                x = rule.nodes[first : first + _NODES]
                tilted = np.exp(2j * math.pi * (x @ rule.tilts.T))
                squares = ((some[:, None, :2] - x) ** 2).sum(axis=-1)
                height = some[:, 2, None]
                reach = np.sqrt(squares + height**2)
                # the phase relative to that of the height, whose turns would be rounded
                turns = squares / (reach + height) / wavelength
                waves = np.exp(2j * math.pi * turns) / (1j * wavelength * reach)
                slope = _slope(height, reach, k)
                for field, cosines in rule.fields:
                    lit = waves * field[first : first + _NODES]
                    total += condition.field * ((lit * slope) @ tilted)
                    if condition.slope:
                        total += condition.slope * cosines * (lit @ tilted)
            found[start : start + step] = np.square(np.abs(total)) @ rule.shares
    return found


# --- the choice

# Coherence widths along the source from which on lags are tried first.
_MANY = 30.0
# The same from which on pairs at short lags are looked at.
_SHORT = 5.0


def partly_coherent_irradiance(
    compute: Callable[[Any, Floats], Any],
    source: Wavefront,
    points: Floats,
    wavelength: float,
    method: str,
    system: FirstOrder | None,
    error: float,
) -> Floats | None:
    """Irradiance (k, n) at points (n, 2) behind a system, or (n, 3); None for a mean over tilts.

    ``compute`` : a coherent source and points to irradiances (k, n), k = 2 with errors.
    ``error`` : of the mean, relative to the largest irradiance.
    """
    if system is None and method != "fresnel":
        if method not in CONDITIONS:
            return None
        return _of_spherical_waves(source, points, wavelength, method, error)
    planes, owner = [system], np.zeros(len(points), np.intp)
    if system is None:
        heights, owner = np.unique(points[:, 2], return_inverse=True)
        planes = [FirstOrder.free_space(height) for height in heights.tolist()]
    groups = [points[owner == k, :2] for k in range(len(planes))]
    blurs = [blur_of(source, plane.B, wavelength) for plane in planes if plane is not None]
    order = np.argsort(np.argsort(owner, kind="stable"), kind="stable")

    def by_lags() -> Floats | None:
        parts = []
        for group, plane in zip(groups, planes, strict=True):
            if not abs(np.linalg.det(plane.B)) > 0.0:
                return None
            part = summed_over_lags(source, group, wavelength, plane, error)
            if part is None:
                return None
            parts.append(part)
        return _with_error(np.concatenate(parts)[order], error)

    def by_convolution() -> Floats | None:
        lit = coherent_source(source)

        def fields(places: list[Floats]) -> Floats:
            if system is None:
                places = [
                    np.column_stack([x, np.full(len(x), z)])
                    for x, z in zip(places, heights.tolist(), strict=True)
                ]
            return np.asarray(compute(lit, np.concatenate(places)))

        found = convolved(fields, groups, blurs, error)
        return None if found is None else found[..., order]

    many = max(float(blur.reaches.max()) for blur in blurs) > _MANY
    forms = [by_lags, by_convolution] if many else [by_convolution, by_lags]
    first = forms[0]()
    return forms[1]() if first is None else first


def _of_spherical_waves(
    source: Wavefront, points: Floats, wavelength: float, method: str, error: float
) -> Floats | None:
    """Irradiance by the cheapest of the sums over pairs and nodes; None for that over tilts."""
    tilts: Any
    try:
        tilts = tilts_of(source, error)
    except ArgumentError:  # too many
        tilts = None
    cost, rule = math.inf, None
    if tilts is not None:
        cost = len(tilts[1]) * _cost_of_edges(source, wavelength)
        rule = node_sum(source, points, wavelength, method, tilts)
    if rule is not None:
        cost = min(cost, len(tilts[1]) * len(rule.nodes) * len(rule.fields) * _NODE)
    if _is_short(source) and (not CONDITIONS[method].takes_slopes or _is_steep(source, wavelength)):
        pairs = pair_sum(source, points, wavelength)
        if pairs.cost < min(cost, _MOST_COST):
            found = summed_over_pairs(pairs, source, points, wavelength, method, error)
            if found is not None:
                return _with_error(found, error)
    if rule is None:
        return None
    return _with_error(summed_over_nodes(rule, points, wavelength, method), error)


def _is_short(source: Wavefront) -> bool:
    size = np.subtract(*np.reshape(source.bounds, (2, 2))[::-1])
    return bool((size > _SHORT * source.coherence_width).all())


def _is_steep(source: Wavefront, wavelength: float) -> bool:
    """Whether next to no tilted wave of a flat source grazes the plane, where p_z has a branch."""
    highest = _highest(source) + _GRAZING / (2 * math.pi * source.coherence_width)
    return source.is_flat and wavelength * highest < 1.0


def _cost_of_edges(source: Wavefront, wavelength: float) -> float:
    """About how many nanoseconds the field at a point takes by integrals along edges."""
    elements = flat_of(source).elements_in_plane
    around = sum(element.polygons.length for element in elements) / wavelength
    edges = sum(len(ring) for element in elements for ring in element.rings)
    return float(around * _WAVELENGTH + edges * _EDGE)


def _with_error(values: Floats, error: float) -> Floats:
    return np.stack([values, np.full(len(values), error * float(values.max(initial=0.0)))])
