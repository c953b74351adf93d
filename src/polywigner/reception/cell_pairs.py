"""Sums of the link kernel over two sources, split into cells.

Between cells that are small compared with their distance the kernel is the product of two plane
waves along the line s of their centres and a slowly varying function of both points. That function
is interpolated at Gauss nodes, q along each side of both boxes:

    int int u_t K u_r = sum_ij M_i K_ij M'_j,    M_i = int u_t(x) exp(-ik s.x) L_i(x) dx       (RX3)

A pair of cells costs q^4 values of K, for any number of wavelengths in the cells, and sums over the
nodes in each cell. For rectangular cells this is the Gauss rule of twice the order.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise, product
from typing import Any, NamedTuple, TypeAlias

import numpy as np
import shapely
from numpy.typing import NDArray

from polywigner.errors import ArgumentError
from polywigner.geometry.parts import polygons_in
from polywigner.propagation.quadrature import (
    NODES_PER_CYCLE,
    areas,
    rule_by_triangles,
    triangulated,
)
from polywigner.radiometry.directions import steepest
from polywigner.source.normal_form import normal_form
from polywigner.source.obliquities import Obliquity
from polywigner.source.polarisation import Currents

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]
Indices = NDArray[np.intp]

# Area of the slivers that rounding leaves of a cut polygon, as a fraction of the cell's area.
_SLIVER = 1e-14
# Sides of at least this fraction of the longest side are halved with it: the nodes along the short
# side of an elongated box are too many.
_SQUARE = 0.7
# Nodes per cycle of a wave, as a fraction of the nodes for rays: 2.5, while Gauss rules need pi/2.
# With 4 more nodes, moments of triangles have errors of 1e-11 of the area.
_NODE_RATIO = 0.7
# Cached rules for other poses and orders, at most some hundred kB each.
_MOST_CACHED = 256


class Cells:
    """A tree of boxes around parts of a source, cut as needed; cell 0 is all of it.

    Lengths are in wavelengths, relative to the centre of the source's bounds.
    """

    def __init__(self, source: Any, wavelength: float) -> None:
        self._source = normal_form(source).in_plane
        self.centre = np.reshape(self._source.bounds, (2, 2)).mean(axis=0)
        self.wavelength = wavelength
        self.highest_frequency = steepest(source, wavelength)
        """Highest frequency of the field's waves, in cycles per wavelength."""
        self.low, self.high = np.empty((0, 2)), np.empty((0, 2))
        self._parts: list[tuple[NDArray[np.object_], Indices]] = []
        self._children: dict[int, list[int]] = {}
        self._nodes: dict[tuple[int, float, int, float], tuple[Floats, Complex]] = {}
        self._triangles: dict[int, tuple[Floats, Indices]] = {}
        outlines = [element.shape.polygons for element in self._source.elements]
        polygons = np.array(outlines, dtype=object)
        hull = shapely.GeometryCollection(polygons.tolist()).convex_hull
        self.corners = shapely.get_coordinates(hull)[:-1]
        """Vertices of the convex hull (n, 2), in metres."""
        self._add(polygons, np.arange(len(polygons)))

    def halved(self, cells: Indices) -> tuple[Indices, Indices]:
        """Return numbers (m,) of halves or quarters of cells (n,), and the index of their cell."""
        distinct, number = np.unique(cells, return_inverse=True)
        halves = [self._halves(int(cell)) for cell in distinct]
        counts = np.array([len(pair) for pair in halves], dtype=np.intp)[number]
        parts = np.array([half for k in number for half in halves[k]], dtype=np.intp)
        return parts, np.repeat(np.arange(len(cells)), counts)

    def nodes(self, cell: int, rate: float, order: int, extra: float) -> tuple[Floats, Complex]:
        """Return points (n, 2) in a cell, and weights (n,) times the field, in square wavelengths.

        The rule suits integrands of ``rate`` cycles per wavelength times a polynomial of an
        ``order`` over the cell. ``extra``: additional nodes along a side.
        """
        key = cell, rate, order, extra
        if key not in self._nodes:
            if len(self._nodes) >= _MOST_CACHED:
                self._nodes.clear()
            longest = float((self.high[cell] - self.low[cell]).max())
            # adds ``order`` nodes along the longest side
            cycles = _NODE_RATIO * (rate + self.highest_frequency)
            self._nodes[key] = self._rule(cell, cycles + order / (NODES_PER_CYCLE * longest), extra)
        return self._nodes[key]

    def _rule(self, cell: int, rate: float, extra: float) -> tuple[Floats, Complex]:
        triangles, owners = self._triangles_of(cell)
        nodes, weights, numbers = rule_by_triangles(triangles, rate / self.wavelength, extra)
        owners = owners[numbers]
        values = self._source.weights[owners] * (weights / self.wavelength**2)
        for owner in np.unique(owners):
            field = self._source.elements[owner].illumination
            if field is not None:
                inside = owners == owner
                values[inside] *= field(nodes[inside])
        if not self._source.is_flat:
            relative = nodes - self._source.centre
            values = values * exp_cycles(
                ((relative @ self._source.curvature) * relative).sum(axis=1) / 2
            )
        return (nodes - self.centre) / self.wavelength, values

    def _triangles_of(self, cell: int) -> tuple[Floats, Indices]:
        """Return triangles (n, 3, 2) of a cell in metres, and the numbers of their elements."""
        if cell not in self._triangles:
            polygons, numbers = self._parts[cell]
            parts = [triangulated([polygon]) for polygon in polygons]
            owners = np.repeat(numbers, [len(triangles) for triangles in parts])
            triangles = np.concatenate(parts)
            wide = areas(triangles) > 0
            self._triangles[cell] = triangles[wide], owners[wide]
        return self._triangles[cell]

    def _halves(self, cell: int) -> list[int]:
        if cell not in self._children:
            low, high = self.low[cell], self.high[cell]
            is_long = high - low > _SQUARE * (high - low).max()
            rows = np.stack([low, low / 2 + high / 2, high], axis=1)
            stops = [row if long else row[::2] for row, long in zip(rows, is_long, strict=True)]
            self._children[cell] = []
            for x, y in product(*map(pairwise, stops)):
                outline = np.transpose([x, y]) * self.wavelength + self.centre
                self._cut(cell, shapely.box(*outline.ravel()))
        return self._children[cell]

    def _cut(self, cell: int, box: shapely.Polygon) -> None:
        """Add the part of a cell inside a box, unless it is empty."""
        polygons, numbers = self._parts[cell]
        parts = shapely.intersection(polygons, box)
        wide = shapely.area(parts) > _SLIVER * box.area
        if wide.any():
            flat = [shapely.MultiPolygon(polygons_in(part)) for part in parts[wide]]
            self._children[cell].append(len(self._parts))
            self._add(np.array(flat, dtype=object), numbers[wide])

    def _add(self, polygons: NDArray[np.object_], numbers: Indices) -> None:
        self._parts.append((polygons, numbers))
        bounds = (shapely.total_bounds(polygons).reshape(2, 2) - self.centre) / self.wavelength
        self.low = np.vstack([self.low, bounds[0]])
        self.high = np.vstack([self.high, bounds[1]])


@lru_cache(maxsize=16)
def cells_of(source: Any, wavelength: float) -> Cells:
    """Return the cells of a source at a wavelength in m; equal sources share them."""
    return Cells(source, wavelength)


def link_kernel(condition: Obliquity, sight: Sight) -> tuple[Floats, Floats]:
    """Return real and imaginary part of K (...) with a boundary condition at both ends: (RX1)."""
    cosine, sine = sight.wave
    nr, mr, nm = sight.rise, sight.away, sight.lean
    # real and imaginary parts are computed separately, since all factors are real, and in place:
    # couplings take a third to a fifth of the time of complex arrays
    a, b = condition.field, condition.slope
    inverse = 1.0 / sight.distance
    near = inverse * (0.5 / math.pi)
    both = inverse * ((a * a) * nr)
    both *= inverse
    both *= mr
    imag = -3.0 * both
    imag += (a * a) * nm
    imag *= near
    real = imag * near
    real += both
    np.subtract(b * b, real, out=real)
    if a * b:
        mixed = inverse * ((a * b) * (nr - mr))
        real += mixed
        mixed *= near
        imag += mixed
    # times -i exp(ikR)/R
    real *= inverse
    imag *= inverse
    first = real * sine
    first += np.multiply(imag, cosine, out=near)
    imag *= sine
    real *= cosine
    imag -= real
    return first, imag


def polarised_kernel(
    currents: Currents, sent: Complex, taken: Complex, sight: Sight
) -> tuple[Floats, Floats]:
    """Return real and imaginary part of K (...) of currents along q (3,) and q' (3,): (RX9).

    Both are unit vectors along the fields, in the axes of the transmitter and of the receiver.
    """
    rotation = sight.rotation
    taken, normal = rotation @ taken, rotation[:, :, 2]
    m, e = currents
    inverse = 1.0 / sight.distance
    a = 0.5j / math.pi * inverse
    r = sight.r

    def along(v: Complex) -> Complex:
        v = np.broadcast_to(v, taken.shape)
        return np.asarray(sum(v[:, k, None, None] * r[k] for k in range(3)) * inverse)

    def dyad(first: Complex, second: Complex) -> Complex:
        both = np.broadcast_to(first * second, taken.shape).sum(axis=1)[:, None, None]
        first_term = (1 + a * (1 + a)) * both
        return np.asarray(first_term - (1 + 3 * a * (1 + a)) * along(first) * along(second))

    turned, turned_there = np.cross([0.0, 0.0, 1.0], sent), np.cross(normal, taken)
    total: Any = 0.0
    if e:
        total = e * e * dyad(sent, taken)
    if m:
        total = total - m * m * dyad(turned, turned_there)
    if e and m:
        mixed = np.cross(taken, turned) - np.cross(sent, turned_there)
        total = total + e * m * (1 + a) * along(mixed)
    wave = sight.wave[0] + 1j * sight.wave[1]
    values = np.asarray(total * wave * inverse / 1j)
    return values.real, values.imag


# Values of the kernel, or of fields at nodes, in one step: their arrays stay in the cache.
_BLOCK = 1 << 14
# Terms of a matrix product in one step: for more terms BLAS starts threads, which are slower.
_PRODUCT = 1 << 18
# Moments in one step: 64 MiB.
_MOMENTS = 1 << 21
# Step to which the rates of waves are rounded up, so that poses share their nodes.
_RATE_STEP = 0.125

Pairs: TypeAlias = Any
"""Record array of pairs of cells: pose, transmitter and receiver are indices."""


def _table(names: str, *columns: NDArray[Any]) -> Pairs:
    """Return a record array of columns (n,)."""
    make: Any = np.rec.fromarrays  # NumPy's types require formats
    return make(columns, names=names)


_PAIR = "pose,transmitter,receiver"


class Sight:
    """Distances and cosines (n, i, j) between nodes x (n, i, 2) and y (n, j, 3) of two cells.

    Nodes are relative to the centres of their sources, which are ``offset`` (n, 3) apart.
    ``rotation`` (n, 3, 3): rotation of the receiver's frame.
    """

    def __init__(self, x: Floats, y: Floats, offset: Floats, rotation: Floats) -> None:
        self._x, self._y, self._offset, self.rotation = x, y, offset, rotation
        normal = rotation[:, :, 2]
        straight = np.sqrt((offset * offset).sum(axis=1))[:, None, None]
        ones = np.ones((*x.shape[:2], 1)), np.ones((len(y), 1, y.shape[1]))
        # |offset + y - x|^2 - |offset|^2 = (|x|^2 - 2 offset.x) + (|y|^2 + 2 offset.y) - 2 x.y
        of_x = (x * x).sum(axis=2) - 2 * (x @ offset[:, :2, None])[..., 0]
        of_y = (y * y).sum(axis=2) + 2 * (y @ offset[:, :, None])[..., 0]
        left = np.concatenate([-2 * x, of_x[..., None], ones[0]], axis=2)
        right = np.concatenate([np.swapaxes(y[..., :2], 1, 2), ones[1], of_y[:, None]], axis=1)
        longer = left @ right
        self.distance = longer + straight * straight
        np.sqrt(self.distance, out=self.distance)
        longer /= self.distance + straight
        longer *= 2 * np.pi
        self.wave = np.cos(longer), np.sin(longer)
        """exp(ik(R - |offset|))."""
        self.rise = (offset[:, None, 2] + y[..., 2])[:, None, :]
        """n.r, (n, 1, j)."""
        away = (offset * normal).sum(axis=1)[:, None] - (x @ normal[:, :2, None])[..., 0]
        self.away = away[..., None]
        """m.r, (n, i, 1)."""
        self.lean = normal[:, 2, None, None]
        """n.m, (n, 1, 1)."""

    @property
    def r(self) -> list[Floats]:
        """The components of r, (n, i, j) or (n, 1, j)."""
        across = [
            (self._offset[:, axis, None] + self._y[..., axis])[:, None, :]
            - self._x[..., axis, None]
            for axis in range(2)
        ]
        return [*across, self.rise]


@dataclass(frozen=True, eq=False)
class Links:
    """A transmitter and a receiver in n poses, lengths in wavelengths."""

    transmitter: Cells
    receiver: Cells
    rotation: Floats
    """Rotations (n, 3, 3) of the receiver's frame into the transmitter's frame."""
    offset: Floats
    """Vectors (n, 3) from the transmitter's centre to the receiver's centre."""
    kernel: Callable[[Sight], tuple[Floats, Floats]]
    """Real and imaginary part of K, such as :func:`link_kernel` with a boundary condition."""
    extra: float
    """Nodes along a side of a cell, in addition to the number that waves and polynomials need."""

    def sizes(self, pairs: Pairs) -> tuple[Floats, Floats, Floats]:
        """Return half the diagonals of both cells of pairs, and their distance, (n,) each."""
        ends = (self.transmitter, pairs.transmitter), (self.receiver, pairs.receiver)
        half = [np.linalg.norm(cells.high[k] - cells.low[k], axis=1) / 2 for cells, k in ends]
        return half[0], half[1], np.linalg.norm(self._between(pairs), axis=1)

    def _between(self, pairs: Pairs) -> Floats:
        """Return vectors (n, 3) from the centres of the transmitter's boxes to the receiver's."""
        vectors = self.offset[pairs.pose].copy()
        there = _centre(self.receiver, pairs.receiver)
        vectors += np.einsum("nij,nj->ni", self.rotation[pairs.pose][:, :, :2], there)
        vectors[:, :2] -= _centre(self.transmitter, pairs.transmitter)
        return vectors

    def sums(self, pairs: Pairs, order: int) -> tuple[Complex, Floats]:
        """Return (RX3) of pairs (n,) without the phase of the sources' distance, and its size.

        The size is about the sum of the moduli of all terms.
        """
        values, size = np.zeros(len(pairs), np.complex128), np.zeros(len(pairs))
        for rows, here, there, sight in self._blocks(pairs, order):
            real, imag = self.kernel(sight)
            values[rows] += _contracted(here, real, imag, there)
            some = np.s_[:, :: order + 1, :: order + 1]
            largest = np.hypot(real[some], imag[some]).max(axis=(1, 2))
            size[rows] += largest * np.abs(here).sum(axis=1) * np.abs(there).sum(axis=1)
        return values, size

    def _blocks(self, pairs: Pairs, order: int) -> Iterator[tuple[slice, Complex, Complex, Sight]]:
        """Yield blocks of pairs, moments at nodes of both cells, and the geometry between them."""
        count = order * order
        most = max(1, _MOMENTS // count)
        step = max(1, _BLOCK // count**2)
        rows = max(1, _BLOCK // (step * count))
        for begin in range(0, len(pairs), most):
            part = pairs[begin : begin + most]
            towards = self._between(part)
            towards /= np.linalg.norm(towards, axis=1)[:, None]
            back = np.einsum("nji,nj->ni", self.rotation[part.pose], towards)
            here = self._moments(self.transmitter, part.transmitter, -towards[:, :2], order)
            there = self._moments(self.receiver, part.receiver, back[:, :2], order)
            for start in range(0, len(part), step):
                rows_here = slice(start, min(start + step, len(part)))
                some = part[rows_here]
                ahead = towards[rows_here, :, None]
                x, from_x = _nodes(self.transmitter, some.transmitter, order)
                axes = np.swapaxes(self.rotation[some.pose][:, :, :2], 1, 2)
                y, from_y = (nodes @ axes for nodes in _nodes(self.receiver, some.receiver, order))
                left = here[rows_here] * exp_cycles((from_x @ ahead[:, :2])[..., 0])
                right = there[rows_here] * exp_cycles(-(from_y @ ahead)[..., 0])
                offset, rotation = self.offset[some.pose], self.rotation[some.pose]
                block = slice(begin + rows_here.start, begin + rows_here.stop)
                for first in range(0, count, rows):
                    row = slice(first, first + rows)
                    yield block, left[:, row], right, Sight(x[:, row], y, offset, rotation)

    def _moments(self, cells: Cells, numbers: Indices, waves: Floats, order: int) -> Complex:
        """Return M_i of (RX3), (n, q^2), for cells with the given numbers (n,).

        ``waves`` (n, 2): cycles per wavelength, relative to the centre of each cell.
        """
        fastest = float(np.linalg.norm(waves, axis=1).max(initial=0.0))
        rate = float(np.ceil(fastest / _RATE_STEP) * _RATE_STEP)
        moments = np.zeros((len(numbers), order, order), np.complex128)
        step = max(1, _PRODUCT // (2 * order * order))
        for cell in np.unique(numbers).tolist():
            (rows,) = np.nonzero(numbers == cell)
            points, weights = cells.nodes(cell, rate, order, self.extra)
            half, relative = (cells.high[cell] - cells.low[cell]) / 2, points - _centre(cells, cell)
            for start in range(0, len(points), step):
                part = slice(start, start + step)
                first, second = _basis(relative[part] / half, order)
                size = 1 + len(rows) * first.size // _BLOCK
                for some in np.array_split(rows, min(len(rows), size)):
                    field = exp_cycles(waves[some] @ relative[part].T) * weights[part]
                    # as pairs of real numbers: BLAS has no product of real and complex matrices
                    terms = (field[:, :, None] * second).view(np.float64)
                    moments[some] += (first.T @ terms).view(np.complex128)
        return moments.reshape(len(numbers), order * order)


def exp_cycles(cycles: Floats) -> Complex:
    """Return exp(2 pi i cycles)."""
    phase = 2 * np.pi * cycles
    values = np.empty(phase.shape, np.complex128)
    values.real, values.imag = np.cos(phase), np.sin(phase)
    return values


def _nodes(cells: Cells, numbers: Indices, order: int) -> tuple[Floats, Floats]:
    """Return Gauss nodes in boxes (n, q^2, 2), and the same relative to the boxes' centres."""
    half = (cells.high[numbers] - cells.low[numbers]) / 2
    relative = half[:, None] * _rule(order)[0]
    return relative + _centre(cells, numbers)[:, None], relative


def _contracted(left: Complex, real: Floats, imag: Floats, right: Complex) -> Complex:
    """Return sum_ij left_i kernel_ij right_j of each pair."""
    columns = np.stack([right.real, right.imag], axis=2)
    of_real, of_imag = real @ columns, imag @ columns
    inner = of_real[..., 0] - of_imag[..., 1] + 1j * (of_real[..., 1] + of_imag[..., 0])
    result: Complex = (left * inner).sum(axis=1)
    return result


def _centre(cells: Cells, numbers: Indices | int) -> Floats:
    return np.asarray((cells.low[numbers] + cells.high[numbers]) / 2)


@lru_cache(maxsize=32)
def _rule(order: int) -> tuple[Floats, Floats]:
    """Return Gauss nodes (q^2, 2) of the square [-1, 1]^2, and values to Legendre series (q, q)."""
    nodes, weights = np.polynomial.legendre.leggauss(order)
    x, y = np.meshgrid(nodes, nodes, indexing="ij")
    series = np.polynomial.legendre.legvander(nodes, order - 1).T * weights
    series *= (np.arange(order) + 0.5)[:, None]
    return np.stack([x.ravel(), y.ravel()], axis=1), series


def _basis(points: Floats, order: int) -> Floats:
    """Return polynomials (2, n, q) in x and in y at points (n, 2): 1 at one node, 0 at others."""
    return np.asarray(np.polynomial.legendre.legvander(points.T, order - 1) @ _rule(order)[1])


# ---- links to a tolerance -----------------------------------------------------------------------

# Orders of interpolation. The difference between two orders is the error of the lower one. Pairs
# beyond the last order are split. Splitting earlier costs more: for 10 wavelengths at a distance of
# 10, one pair of order 22 has 2e5 values, and its parts of order 18 have twice as many.
_ORDERS = np.array([2, 3, 4, 5, 6, 8, 10, 12, 15, 18, 22, 26, 32, 38, 46, 56])
# Pairs are split at once if the phase across them exceeds this limit in radians, ...
_MOST_PHASE = 70.0
# ... or if both cells together exceed their distance by this factor.
_MOST_RATIO = 4.0
# Orders per radian below which rules have no accuracy: less than 1/2, the number for Gauss rules.
_IDLE = 0.25
# Rounding error of a pair's sum, relative to the sum of moduli.
_ROUNDING = 1e-15
# Limits per pose: values of the kernel, some minutes' work, and pairs that need as many in the end.
_MOST_VALUES, _MOST_PAIRS = 1 << 29, 1 << 17


class LinkSums(NamedTuple):
    """Couplings of n poses without the phase of the distance and the norms, and errors."""

    values: Complex
    errors: Floats
    allowed: Floats


def link_sums(links: Links, tolerance: float, floor: Floats) -> LinkSums:
    """Return int int u_t K u_r of n poses to ``tolerance`` of the value or of ``floor`` (n,).

    The larger of both counts. Raises ArgumentError if the sums would take longer than minutes.
    """
    count = len(links.offset)
    first = np.zeros(count, np.intp)
    digits = -math.log10(tolerance)
    parts = _first(links, _feasible(links, _table(_PAIR, np.arange(count), first, first)), digits)
    work = 0.0
    while True:
        pose = parts.pose
        real, imag = (np.bincount(pose, v, count) for v in (parts.values.real, parts.values.imag))
        total = real + 1j * imag
        allowed = tolerance * np.maximum(np.abs(total), floor)
        open_ = _to_refine(parts, allowed / 2)
        if not open_.any():
            break
        per_pair = (allowed / 2 / np.maximum(np.bincount(pose[open_], minlength=count), 1))[pose]
        halved = open_ & (_expected_error(links, parts) > per_pair)
        raised = open_ & ~halved
        fresh = _first(links, _feasible(links, _halves(links, parts[halved])), digits)
        again = _raised(links, parts[raised])
        work += sum(float((_ORDERS[part.orders] ** 4.0).sum()) for part in (fresh, again))
        if work > _MOST_VALUES * count:
            raise _too_much(links, parts)
        parts = _joined(parts[~open_], fresh, again)
    errors = np.bincount(pose, parts.errors, count).astype(np.float64)
    return LinkSums(total, errors, allowed)


def _to_refine(parts: Pairs, allowed: Floats) -> NDArray[np.bool_]:
    """Select pairs with the largest errors; all other errors add up to ``allowed`` per pose."""
    pose = parts.pose
    ordered = np.lexsort((parts.errors, pose))
    sums = np.cumsum(parts.errors[ordered])
    starts = np.searchsorted(pose[ordered], np.arange(len(allowed)))
    before = np.concatenate([[0.0], sums])[starts]
    is_large = np.zeros(len(pose), np.bool_)
    is_large[ordered] = sums - before[pose[ordered]] > allowed[pose[ordered]]
    return is_large & (parts.errors > _ROUNDING * parts.sizes)


def _expected_error(links: Links, parts: Pairs) -> Floats:
    """Return the expected error of pairs at the highest order; infinite at that order."""
    idle = _IDLE * _phase(links, parts)
    falling = np.maximum(_ORDERS[np.maximum(parts.orders - 1, 0)] - idle, 1.0)
    size = np.maximum(np.maximum(np.abs(parts.values), parts.errors), 1e-300)
    rate = np.log(np.maximum(parts.errors, 1e-300) / size) / falling
    expected = size * np.exp(rate * np.maximum(_ORDERS[-2] - idle, 1.0))
    return np.where(parts.orders == len(_ORDERS) - 1, np.inf, expected)


def _first(links: Links, pairs: Pairs, digits: float) -> Pairs:
    """Evaluate pairs at the first two orders with any accuracy."""
    phase = _phase(links, pairs)
    # the lowest sufficient order for squares at any distance, from trials
    likely = 1 + digits / 3 + 0.8 * np.sqrt(phase)
    least = np.minimum(np.maximum(2 + _IDLE * phase, likely), _ORDERS[-2])
    orders = np.searchsorted(_ORDERS, least)
    return _raised(links, _evaluated(links, pairs, orders, np.full(len(pairs), np.inf)))


def _raised(links: Links, parts: Pairs) -> Pairs:
    """Evaluate pairs at the next order."""
    return _evaluated(links, parts, parts.orders + 1, parts.values)


def _evaluated(links: Links, pairs: Pairs, orders: Indices, before: Complex | Floats) -> Pairs:
    """Evaluate pairs at orders (n,); errors are differences to values ``before``."""
    values, sizes = _at(links, pairs, orders)
    columns = pairs.pose, pairs.transmitter, pairs.receiver, values, orders
    names = f"{_PAIR},values,orders,errors,sizes"
    return _table(names, *columns, np.abs(values - before), sizes)


def _joined(*pairs: Pairs) -> Pairs:
    return np.concatenate(pairs).view(np.recarray)


def _at(links: Links, pairs: Pairs, orders: Indices) -> tuple[Complex, Floats]:
    work = float((_ORDERS[orders].astype(np.float64) ** 4).sum())
    if work > _MOST_VALUES * len(links.offset):
        raise _too_much(links, pairs)
    values, sizes = np.empty(len(pairs), np.complex128), np.empty(len(pairs))
    for order in np.unique(orders):
        rows = np.flatnonzero(orders == order)
        values[rows], sizes[rows] = links.sums(pairs[rows], int(_ORDERS[order]))
    return values, sizes


def _too_much(links: Links, pairs: Pairs) -> ArgumentError:
    _, _, distance = links.sizes(pairs)
    nearest = int(distance.argmin())
    return ArgumentError(
        "expected sources of fewer wavelengths, or farther from each other, got a link with "
        f"{len(pairs)} pairs of parts, {distance[nearest]:.3g} wavelengths apart at pose "
        f"{int(pairs.pose[nearest])}; allow a larger tolerance, or check the units"
    )


def _phase(links: Links, pairs: Pairs) -> Floats:
    """Return the largest phase in radians along one coordinate, beyond the two plane waves."""
    here, there, distance = links.sizes(pairs)
    result: Floats = 2 * math.pi * np.maximum(here, there) * (here + there) / distance
    return result


def _feasible(links: Links, pairs: Pairs) -> Pairs:
    """Split pairs until interpolation is feasible."""
    small = pairs[:0]
    while len(pairs):
        here, there, distance = links.sizes(pairs)
        good = (_phase(links, pairs) <= _MOST_PHASE) | (here + there < 1e-3)
        good &= here + there <= _MOST_RATIO * distance
        small = _joined(small, pairs[good])
        pairs = _halves(links, pairs[~good])
        if len(pairs) + len(small) > _MOST_PAIRS * len(links.offset):
            raise _too_much(links, pairs)
    return small


def _halves(links: Links, pairs: Pairs) -> Pairs:
    """Halve the larger cell of each pair."""
    here, there, _ = links.sizes(pairs)
    first = here >= there
    one, other = pairs[first], pairs[~first]
    cells, row = links.transmitter.halved(one.transmitter)
    halved = _table(_PAIR, one.pose[row], cells, one.receiver[row])
    cells, row = links.receiver.halved(other.receiver)
    return _joined(halved, _table(_PAIR, other.pose[row], other.transmitter[row], cells))
