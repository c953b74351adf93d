"""Irradiance of partly coherent light as a sum over short lags.

A coherence width far below the size of the source leaves short lags only. In parabolic waves the
integral over mean positions is A (:func:`summed_over_lags`). In spherical waves it is a sum over
pairs of places (:func:`summed_over_pairs`).
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
import shapely
from numpy.typing import NDArray

from polywigner.geometry import Aperture, Wavefront
from polywigner.geometry.parts import grid_size, polygons_in
from polywigner.numerics.nodes import normal_product_rule
from polywigner.propagation.quadrature import (
    Trapezoids,
    field_at,
    highest,
    largest_rates,
    node_counts,
    rule_on,
    slope,
    trapezoids_of,
    waves_of,
    weighted_elements,
)
from polywigner.source import Array
from polywigner.source.normal_form import normal_form
from polywigner.source.obliquities import CONDITIONS, direction_cosines
from polywigner.transforms import ambiguity
from polywigner.transforms.wavefronts import flat_of

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]
Indices = NDArray[np.intp]

# Values at a time.
_BLOCK = 1 << 22
# Pairs of a point and of two places at a time, in the cache; and pairs of places.
_PAIRS, _NODES = 1 << 16, 1 << 12
# Error of means of direction cosines over tilts.
_OF_DEGREES = 1e-8
# Lags in coherence widths beyond which the degree of coherence is 1e-10 and less.
_LONGEST = 6.8
# Error of a wave in the coarsest rules; frequency of the degree of coherence times the width; and
# nodes in addition, rule after rule.
_ERROR, _OF_NORMAL, _LEVELS = 1e-7, 0.48, (0, 2, 5, 10, 18)
# Segments of kinks that are looked for, and nodes.
_MOST_KINKS, _MOST_NODES = 2000, 1 << 20


class LagRule(NamedTuple):
    """Rules on half of the lags."""

    cells: Trapezoids
    """Without kinks of A inside, if there are few."""
    rates: Floats
    """(2,) largest frequencies of the integrand over lags in 1/m."""

    @property
    def size(self) -> float:
        """Number of nodes of the coarsest rule."""
        return float(node_counts(self.cells, self.rates, _ERROR).prod(axis=1).sum())

    def nodes(self, extra: int) -> tuple[Floats, Floats]:
        """Return lags (n, 2) and weights (n,), which count the opposite lags as well."""
        nodes, weights, _ = rule_on(self.cells, self.rates, _ERROR, extra)
        return nodes, 2.0 * weights


def lag_rule(source: Wavefront, rates: Floats) -> LagRule:
    """Rules on the lags of a source that interfere; ``rates`` : without the degree of coherence."""
    reach = _LONGEST * source.coherence_width
    size = np.subtract(*np.reshape(source.bounds, (2, 2))[::-1])
    low, high = np.maximum(-size, -reach), np.minimum(size, reach)
    box = shapely.box(*low, *high)
    half = shapely.box(low[0], 0.0, high[0], high[1])
    cells, _ = trapezoids_of(_cells_of_lags(flat_of(source), box, half))
    return LagRule(cells, np.hypot(rates, _OF_NORMAL / source.coherence_width))


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
    rates = abs(slopes).max(axis=(0, 1), initial=0.0) + highest(source)
    rule = lag_rule(source, rates)
    if rule.size > _MOST_NODES:
        return None
    before: Floats | None = None
    for extra in _LEVELS:
        lags, weights = rule.nodes(extra)
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


# Nanoseconds of a pair of places for each point, and times as many with slopes.
_PAIR, _SLOPES = 60.0, 2.5
# Nanoseconds of an intersection of two outlines, and of its trapezoids, for each vertex.
_CUT = 2e4
# The longest lags along the axes over typical ones, for the number of mean positions.
_TYPICAL = 2.0
# The coarsest rule and its check take so many times the nodes of the coarsest one.
_BOTH = 2.5


class PairSum(NamedTuple):
    """Pairs of places on the source at short lags, for the cost of the sum over them."""

    lags: LagRule
    bends: Floats
    """(2, 2) frequencies over the mean position of a pair for each metre of lag, in 1/m^2."""
    waves: Floats
    """(2,) largest differences of frequencies of two waves of the source in 1/m."""
    cost: float
    """Nanoseconds for each point."""

    def rates(self, lags: Floats) -> Floats:
        """Largest frequencies over mean positions of pairs at lags (n, 2), (n, 2) in 1/m."""
        return np.asarray(abs(lags) @ self.bends + self.waves)


def pair_sum(source: Wavefront, points: Floats, wavelength: float, method: str) -> PairSum:
    """The sum over pairs for points (n, 3)."""
    lags = lag_rule(source, largest_rates(source, points, wavelength).max(axis=0))
    # second derivatives of the distance, from the direction cosines of the ray
    low, high = np.reshape(source.bounds, (2, 2))
    away = np.maximum(abs(points[:, :2] - low), abs(points[:, :2] - high))
    mixed = away.prod(axis=1) / ((away**2).sum(axis=1) + points[:, 2] ** 2)
    bends = np.array([[1.0, mixed.max()], [mixed.max(), 1.0]])
    bends = abs(source.curvature) + bends / (wavelength * float(points[:, 2].min()))
    outline = flat_of(source)
    largest = abs(normal_form(source).frequencies).max(axis=0)
    rule = PairSum(lags, bends, 2.0 * largest, 0.0)
    cells, _ = trapezoids_of([part for e in outline.elements_in_plane for part in e.polygons.geoms])
    longest = np.array([abs(lags.cells[:, k]).max() for k in (2, 0)])
    counts = node_counts(cells, rule.rates(longest / _TYPICAL), _ERROR)
    pair = _PAIR * (_SLOPES if CONDITIONS[method].needs_normal_derivative else 1.0)
    vertices = sum(len(ring) for e in outline.elements_in_plane for ring in e.rings)
    cut = _CUT * vertices * len(outline.elements_in_plane) / len(points)
    work = pair * float(counts.prod(axis=1).sum()) + cut
    return rule._replace(cost=_BOTH * lags.size * work)


def summed_over_pairs(
    rule: PairSum, source: Wavefront, points: Floats, wavelength: float, method: str, error: float
) -> Floats | None:
    """Irradiance (n,) at points (n, 3), by (Q7); None if no two rules agree to an ``error``.

    The error is relative to the largest irradiance.
    """
    before: Floats | None = None
    for extra in _LEVELS:
        nodes, weights = rule.lags.nodes(extra)
        degrees = _degrees(source, nodes, wavelength, CONDITIONS[method].needs_normal_derivative)
        pairs = _pairs_of(source, nodes, weights, rule.rates(nodes), extra, degrees)
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
    source: Wavefront, lags: Floats, weights: Floats, rates: Floats, extra: int, degrees: Any
) -> Pairs:
    """Pairs at lags (n, 2). ``rates`` : (n, 2) over mean positions; ``extra`` : nodes more."""
    found, elements = [], weighted_elements(source)
    for one, a in elements:
        ahead = _shifted(one.polygons, -lags / 2)
        for other, b in elements:
            common = shapely.intersection(ahead, _shifted(other.polygons, lags / 2))
            parts, owner = shapely.get_parts(common, return_index=True)
            some = shapely.area(parts) > 0
            if not some.any():
                continue
            cells, of_part = trapezoids_of(parts[some])
            of_lag = owner[some][of_part]
            nodes, share, of_cell = rule_on(cells, rates[of_lag], _ERROR, extra)
            number = of_lag[of_cell]
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
            first, second = field_at(one, means + xi / 2), field_at(other, means - xi / 2)
            return [degree[number] * first * np.conj(second)]

        return of_fields
    reach = float(np.linalg.norm(lags, axis=1).max()) / source.coherence_width
    nodes, shares = normal_product_rule((reach, reach), _OF_DEGREES)
    tilts = nodes / (2 * math.pi * source.coherence_width)
    waves = np.exp(2j * np.pi * (lags @ tilts.T)) * shares

    def of_slopes(one: Any, other: Any, means: Floats, xi: Floats, number: Indices) -> Any:
        total = [np.zeros(len(means), np.complex128) for _ in range(4)]
        for a, kappa in waves_of(one):
            for b, nu in waves_of(other):
                turns = (means + xi / 2) @ kappa - (means - xi / 2) @ nu
                product = a * np.conj(b) * np.exp(2j * np.pi * turns)
                ahead = direction_cosines(tilts + kappa, wavelength)
                behind = direction_cosines(tilts + nu, wavelength).conj()
                forms = np.stack([np.ones(len(tilts)), ahead, behind, ahead * behind])
                # not a product of BLAS, whose threads cost more than it
                for each, degree in zip(total, np.einsum("ft,lt->fl", forms, waves), strict=True):
                    each += product * degree[number]
        return total

    return of_slopes


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
        is_complex = bool(degrees[0].imag.any())
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
                total = size * (cosine * real - sine * imag) * degrees[0].real
                if is_complex:
                    total -= size * (cosine * imag + sine * real) * degrees[0].imag
                # sums of NumPy: threads of BLAS cost more than such short products
                found[low : low + step] += total.sum(axis=1)
                continue
            wave = (cosine + 1j * sine) * (inverse / (wavelength * wavelength))
            a, b = condition.field, condition.slope
            one, other = a * slope(z, first, k), a * slope(z, second, k).conj()
            plain, ahead, behind, both = degrees
            value = other * (one * plain + b * ahead) + b * (one * behind + b * both)
            found[low : low + step] += (wave * value).real.sum(axis=1)
    return found
