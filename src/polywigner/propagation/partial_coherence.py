"""Irradiance of partially coherent light: the choice of the sum, convolutions, and tilts.

The degree of coherence is the mean of exp(2 pi i t.xi) over normal tilts t of the standard
deviation 1/(2 pi width) (PC2). In parabolic waves a tilt shifts the irradiance, so the mean is a
convolution with a normal density. In spherical waves the fields of all tilts share samples of the
source. Widths far below the size of the source leave short lags only (:mod:`.lag_sums`). The last
resort computes the field of one tilt after another.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from polywigner.errors import ArgumentError
from polywigner.execution.progress import told
from polywigner.geometry import Aperture, Wavefront
from polywigner.numerics.nodes import normal_product_rule
from polywigner.optics import FirstOrder
from polywigner.propagation.lag_sums import pair_sum, summed_over_lags, summed_over_pairs
from polywigner.propagation.quadrature import (
    Trapezoids,
    field_at,
    highest,
    largest_rates,
    node_counts,
    rows_of,
    trapezoids_of,
    waves_of,
    weighted_elements,
)
from polywigner.source.normal_form import normal_form
from polywigner.source.obliquities import CONDITIONS, Obliquity, direction_cosines
from polywigner.transforms.wavefronts import coherent_source, flat_of, tilts_of

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]
Indices = NDArray[np.intp]

# Coherence widths along the source from which on sums over short lags are considered.
_MANY = 30.0
# Standard deviations of the tilts, beyond which waves may graze the plane.
_GRAZING = 5.0
# Nanoseconds for each point that are not spent on pairs.
_MOST_COST = 1e10
# Nanoseconds of a wavelength along the outline, and of an edge, for integrals along edges.
_WAVELENGTH, _EDGE = 250.0, 1e4
# Places of a lattice, and points of all planes at which fields are computed.
_MOST_IN_LATTICE, _MOST_POINTS = 1 << 24, 1 << 22
# Points and neighbours at a time.
_BLOCK = 1 << 22


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
        compute(coherent_source(source), points[:1])  # for the checks of all arguments
        return _of_spherical_waves(source, points, wavelength, method, error)
    heights: list[float] = []
    if system is not None:
        planes = [(system, np.arange(len(points)))]
    else:
        levels, owner = np.unique(points[:, 2], return_inverse=True)
        heights = levels.tolist()
        planes = [
            (FirstOrder.free_space(height), np.flatnonzero(owner == k))
            for k, height in enumerate(heights)
        ]
    blurs = [_blur_of(source, plane.B, wavelength) for plane, _ in planes]

    def by_lags() -> Floats | None:
        found = np.empty(len(points))
        for plane, some in planes:
            if not abs(np.linalg.det(plane.B)) > 0.0:
                return None
            part = summed_over_lags(source, points[some, :2], wavelength, plane, error)
            if part is None:
                return None
            found[some] = part
        return _with_error(found, error)

    def by_convolution() -> Floats | None:
        rules = []
        for (_, some), blur in zip(planes, blurs, strict=True):
            rule = _convolution(points[some, :2], blur, error)
            if rule is None:
                return None
            rules.append(rule)
        places = [x for x, _ in rules]
        if heights:
            pairs = zip(places, heights, strict=True)
            places = [np.column_stack([x, np.full(len(x), z)]) for x, z in pairs]
        if sum(map(len, places)) > _MOST_POINTS:
            return None
        values = np.asarray(compute(coherent_source(source), np.concatenate(places)))
        parts = np.split(values, np.cumsum([len(x) for x in places])[:-1], axis=-1)
        found = np.empty((len(values), len(points)))
        for (_, some), (_, mean), part in zip(planes, rules, parts, strict=True):
            found[:, some] = mean(part)
        found[1:] += error * float(found[0].max(initial=0.0))
        return found

    is_short = max(float(blur.reaches.max()) for blur in blurs) > _MANY
    first, second = (by_lags, by_convolution) if is_short else (by_convolution, by_lags)
    found = first()
    return second() if found is None else found


class _Blur(NamedTuple):
    """The normal density of the shifts of an irradiance by tilts."""

    axes: Floats
    """(2, 2), columns: its principal directions in the plane of the points."""
    spreads: Floats
    """(2,) its standard deviations along them in m."""
    reaches: Floats
    """(2,) sides of the source, in coherence widths, that interfere along them."""


def _blur_of(source: Wavefront, transfer: Floats, wavelength: float) -> _Blur:
    """The blur by the tilts of a source: a tilt t shifts points by wavelength ``transfer`` t.

    ``transfer`` : (2, 2) in m, B of a first-order system.
    """
    axes, scales, right = np.linalg.svd(transfer)
    size = np.subtract(*np.reshape(source.bounds, (2, 2))[::-1])
    reaches = (abs(right) @ size) / source.coherence_width
    spreads = wavelength * scales / (2 * math.pi * source.coherence_width)
    return _Blur(axes, spreads, reaches)


Convolution = tuple[Floats, Callable[[Floats], Floats]]
"""Points (m, 2) at which the coherent irradiance is needed, and the means (k, n) of values there
(k, m)."""


def _convolution(points: Floats, blur: _Blur, error: float) -> Convolution | None:
    """The rule of fewest fields for points (n, 2) of a plane; None if there are too many.

    The rules are the trapezoidal rule on a lattice that the points share, and Gauss-Hermite's at
    each point. ``error`` : relative to the largest irradiance.
    """
    steps = math.sqrt(2.0 * math.log(16.0 / error))
    along = points @ blur.axes
    first, second = (
        _lattice_axis(along[:, k], float(blur.spreads[k]), float(blur.reaches[k]), steps)
        for k in (0, 1)
    )
    nodes, weights = normal_product_rule(tuple(blur.reaches.tolist()), error)
    count = len(points) * len(weights) if (blur.spreads > 0).all() else math.inf
    step = max(1, _BLOCK // (first.near.shape[1] * second.near.shape[1]))
    blocks = [slice(k, k + step) for k in range(0, len(points), step)]
    shape = len(first.places), len(second.places)
    if math.prod(shape) <= _MOST_IN_LATTICE:
        needed = np.zeros(shape, bool)
        for some in blocks:
            needed[first.near[some][:, :, None], second.near[some][:, None, :]] = True
        if np.count_nonzero(needed) <= count:
            x, y = np.nonzero(needed)

            def mean_on_lattice(values: Floats) -> Floats:
                table = np.zeros((*values.shape[:-1], *shape))
                table[..., needed] = values
                found = np.empty((*values.shape[:-1], len(points)))
                for some in blocks:
                    near = table[..., first.near[some][:, :, None], second.near[some][:, None, :]]
                    shares = first.weights[some], second.weights[some]
                    found[..., some] = np.einsum("...nij,ni,nj->...n", near, *shares)
                return found

            places = np.column_stack([first.places[x], second.places[y]])
            return places @ blur.axes.T, mean_on_lattice
    if count > _MOST_POINTS:
        return None
    shifted = along[:, None] + nodes * blur.spreads

    def mean_of_nodes(values: Floats) -> Floats:
        return np.asarray(values.reshape(*values.shape[:-1], len(points), -1) @ weights)

    return shifted.reshape(-1, 2) @ blur.axes.T, mean_of_nodes


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
    centre = np.rint((along - origin) / step).astype(np.intp)
    # places of the lattice that are near to no point are left out
    numbers = np.unique(np.unique(centre)[:, None] + np.arange(-half, half + 1))
    near = np.searchsorted(numbers, centre - half)[:, None] + np.arange(2 * half + 1)
    places = origin + step * numbers
    away = (places[near] - along[:, None]) / spread
    weights = np.exp(-0.5 * away * away)
    return _Axis(places, near, weights / weights.sum(axis=1, keepdims=True))


def _of_spherical_waves(
    source: Wavefront, points: Floats, wavelength: float, method: str, error: float
) -> Floats | None:
    """Irradiance by the cheapest sum, over tilts or pairs; None for one field after another."""
    cost = _cost_of_fields(source, wavelength, error)
    rule = _tilt_sum(source, points, wavelength, method, error)
    if rule is not None and rule.cost >= cost:
        rule = None
    if rule is not None:
        cost = rule.cost
    if _is_short(source) and (
        not CONDITIONS[method].needs_normal_derivative or _is_steep(source, wavelength)
    ):
        pairs = pair_sum(source, points, wavelength, method)
        if pairs.cost < min(cost, _MOST_COST):
            found = summed_over_pairs(pairs, source, points, wavelength, method, error)
            if found is not None:
                return _with_error(found, error)
    return None if rule is None else _with_error(_summed_over_tilts(rule), error)


def _cost_of_fields(source: Wavefront, wavelength: float, error: float) -> float:
    """Estimated nanoseconds for each point of the fields of all tilts, by integrals along edges."""
    try:
        count = len(tilts_of(source, error)[1])
    except ArgumentError:  # too many
        return math.inf
    elements = flat_of(source).elements_in_plane
    around = sum(element.polygons.length for element in elements) / wavelength
    edges = sum(len(ring) for element in elements for ring in element.rings)
    return float(count * (around * _WAVELENGTH + edges * _EDGE))


def _is_short(source: Wavefront) -> bool:
    size = np.subtract(*np.reshape(source.bounds, (2, 2))[::-1])
    return bool((size > _MANY * source.coherence_width).all())


def _is_steep(source: Wavefront, wavelength: float) -> bool:
    """Whether next to no tilted wave of a flat source grazes the plane, where p_z has a branch."""
    steepest = highest(source) + _GRAZING / (2 * math.pi * source.coherence_width)
    return source.is_flat and wavelength * steepest < 1.0


def _with_error(values: Floats, error: float) -> Floats:
    return np.stack([values, np.full(len(values), error * float(values.max(initial=0.0)))])


# ---- means over tilts whose fields share samples of the source -----------------------------------

# A tilt multiplies the source by exp(2 pi i t.x), a product of one factor for each axis. The source
# is sampled on rows along x, with Gauss nodes on the trapezoids between the heights of its
# vertices. One matrix product transforms each row from x to t_x, a second one the rows from y to
# t_y.

# Relative error of the quadrature on the source, for nodes that count for less than the tilts.
_QUADRATURE = 1e-9
# Share of the largest tilt, whose weight is next to nothing, that the nodes resolve.
_RESOLVED = 0.8
# Most points of a block, which share nodes; values of a spectrum and of a batch of rows.
_SHARED, _SPECTRUM, _BATCH = 16, 1 << 20, 1 << 16
# Products of numbers in a matrix product that BLAS does not share among threads; columns of it.
_SERIAL, _COLUMNS = 1 << 18, 32
# Nanoseconds of a node for each point; of a multiplication; of a tilt; and of a trapezoid in a
# block of points.
_NODE, _PRODUCT, _VALUE, _TRAPEZOID = 60.0, 0.25, 10.0, 3e5


class _TiltAxis(NamedTuple):
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


class _Block(NamedTuple):
    """Points that share nodes on the source."""

    points: Indices
    rates: Floats
    """(2,) largest frequencies of the integrand over the source along x and y in 1/m."""
    nearest: float
    """Least z of the points in m."""


class _TiltSum(NamedTuple):
    """A mean over tilts for blocks of points."""

    source: Wavefront
    points: Floats
    """(n, 3)."""
    wavelength: float
    condition: Obliquity
    channels: list[Any]
    """The parts of the field: None, and the frequency of each wave whose slope counts."""
    axes: list[_TiltAxis]
    blocks: list[_Block]
    cost: float
    """Estimated nanoseconds for each point."""


def _tilt_sum(
    source: Wavefront, points: Floats, wavelength: float, method: str, error: float
) -> _TiltSum | None:
    """The sum for points (n, 3); None if there are too many tilts, or for a curved wave by slopes.

    ``error`` : of the mean over tilts, relative to the largest irradiance.
    """
    condition = CONDITIONS[method]
    tail = math.sqrt(2 * math.log(8 / error))
    sides = np.subtract(*np.reshape(source.bounds, (2, 2))[::-1])
    reaches = sides / source.coherence_width + tail
    count = math.prod((tail * reaches / math.pi + 1).tolist())
    if count > _SPECTRUM or (condition.needs_normal_derivative and not source.is_flat):
        return None
    axes = [_axis(tail, reach, source.coherence_width) for reach in reaches.tolist()]
    rates = largest_rates(source, points, wavelength)
    rates += [_RESOLVED * axis.half * axis.step for axis in axes]
    order = np.argsort(rates.max(axis=1), kind="stable")
    elements = weighted_elements(source)
    channels: list[Any] = [None] if condition.field else []
    if condition.slope:
        channels += list(normal_form(source).frequencies)
    size = int(min(_SHARED, max(1, _SPECTRUM // (count * len(channels)))))
    trapezoids = np.concatenate([_trapezoids(element) for element, _ in elements])
    blocks, cost = [], 0.0
    for start in range(0, len(points), size):
        some = order[start : start + size]
        block = _Block(some, rates[some].max(axis=0), float(points[some, 2].min()))
        rows, columns = _counts(trapezoids, block).T.astype(np.float64)
        nodes, width = float((rows * columns).sum()), 2 * axes[0].half + 1
        products = nodes * width + float(rows.sum()) * count
        work = _NODE * nodes + len(channels) * (_PRODUCT * products + _VALUE * count)
        cost += work * len(some) + _TRAPEZOID * len(trapezoids)
        blocks.append(block)
    cost /= len(points)
    return _TiltSum(source, points, wavelength, condition, channels, axes, blocks, cost)


def _axis(tail: float, reach: float, width: float) -> _TiltAxis:
    """Steps of 2 pi/reach standard deviations up to ``tail``."""
    step = 2 * math.pi / reach
    half = math.ceil(tail / step)
    weights = np.exp(-0.5 * (step * np.arange(half + 1)) ** 2)
    return _TiltAxis(step / (2 * math.pi * width), half, weights / (2 * weights.sum() - 1.0))


def _summed_over_tilts(rule: _TiltSum) -> Floats:
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


@lru_cache(maxsize=64)
def _trapezoids(element: Aperture) -> Trapezoids:
    return trapezoids_of(element.polygons.geoms)[0]


def _counts(trapezoids: Trapezoids, block: _Block) -> Indices:
    return node_counts(trapezoids, block.rates, _QUADRATURE, block.nearest)


def _spectra(rule: _TiltSum, block: _Block) -> Complex:
    """Channels of the fields of all tilts at p points: (channels, t_y, t_x, p).

    Sums over cosines and after these over sines of tilts t >= 0, along both axes.
    """
    along_x, along_y = rule.axes
    source, points, count = rule.source, rule.points[block.points], len(rule.channels)
    halves = (2 * (along_y.half + 1), 2 * (along_x.half + 1), len(points))
    total = np.zeros((count, halves[0], halves[1] * halves[2]), np.complex128)
    middle = np.reshape(source.bounds, (2, 2)).mean(axis=0)
    for element, weight in weighted_elements(source):
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
    rule: _TiltSum, element: Aperture, rows: tuple[Floats, Floats, Floats], points: Floats
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


def _waves(x: Floats, axis: _TiltAxis) -> Floats:
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
