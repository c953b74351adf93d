"""Integral of a link kernel over two sources, which are divided into cells.

The kernel K(x, y) is the field at a point y of the receiver due to a point x of the transmitter.
Between distant cells, K is the product of plane waves along the line s between the cell centres and
a smooth function. This function is interpolated at q Gauss nodes along each side of the cells'
bounding boxes, so that

    int int u_t K u_r = sum_ij M_i K_ij M'_j,    M_i = int u_t(x) exp(-ik s.x) L_i(x) dx       (RX3)

with the Lagrange polynomial L_i of node i. A pair of cells requires q^4 values of K, regardless of
its size in wavelengths.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise, product
from typing import Any, TypeAlias

import numpy as np
import shapely
from numpy.typing import NDArray

from polywigner.errors import ArgumentError
from polywigner.geometry.parts import polygons_in
from polywigner.numerics import Complex, Floats, Indices, index_blocks, sums_by_index
from polywigner.numerics.chirps import waves_of_cycles
from polywigner.numerics.nodes import NODES_PER_CYCLE, areas, gauss_rule, triangles_of
from polywigner.radiometry.directions import largest_transverse_cosine
from polywigner.source.normal_form import normal_form

# Area below which a clipped part counts as a rounding error, relative to the clipping box.
_SLIVER = 1e-14
# Smallest ratio of the shorter to the longer side for which a box is divided into four parts.
# Longer boxes are halved.
_SQUARE = 0.7
# Number of nodes per cycle, as a fraction of NODES_PER_CYCLE. This gives 2.5 nodes per cycle, while
# Gauss rules need pi/2. With 4 additional nodes, integrals of waves over triangles have errors of
# 1e-11 of the area.
_NODE_RATIO = 0.7
# Largest number of cached rules, each of which takes hundreds of kB.
_MOST_CACHED = 256


class Cells:
    """A source divided into a tree of cells; a cell is the part of the source inside a rectangle.

    Cell 0 is the entire source. Other cells are created on demand. Positions are in wavelengths
    from the centre of the bounding box.
    """

    def __init__(self, source: Any, wavelength: float) -> None:
        """Create the tree with the entire source as its only cell."""
        self._source = normal_form(source).in_plane
        self.centre = np.reshape(self._source.bounds, (2, 2)).mean(axis=0)
        self.wavelength = wavelength
        self.highest_frequency = largest_transverse_cosine(source, wavelength)
        """Highest spatial frequency of the field, in cycles per wavelength."""
        self.low, self.high = np.empty((0, 2)), np.empty((0, 2))
        self._parts: list[tuple[NDArray[np.object_], Indices]] = []
        self._children: dict[int, list[int]] = {}
        self.nodes = lru_cache(_MOST_CACHED)(self._nodes)
        self._triangles_of = lru_cache(None)(self._triangles)
        outlines = [element.shape.polygons for element in self._source.elements]
        polygons = np.array(outlines, dtype=object)
        hull = shapely.GeometryCollection(polygons.tolist()).convex_hull
        self.corners = shapely.get_coordinates(hull)[:-1]
        """Vertices of the convex hull in metres, shape (n, 2)."""
        self._add(polygons, np.arange(len(polygons)))

    def halved(self, cells: Indices) -> tuple[Indices, Indices]:
        """Divide cells; return the new cells, and the indices of their parents in ``cells``.

        Each cell is divided into two or four cells. Empty parts are omitted.
        """
        distinct, number = np.unique(cells, return_inverse=True)
        halves = [self._halves(int(cell)) for cell in distinct]
        counts = np.array([len(parts) for parts in halves], dtype=np.intp)[number]
        numbers = np.array([part for k in number for part in halves[k]], dtype=np.intp)
        return numbers, np.repeat(np.arange(len(cells)), counts)

    def _nodes(self, cell: int, rate: float, order: int, extra: float) -> tuple[Floats, Complex]:
        """Return a cell's nodes (n, 2) in wavelengths, and weights (n,) times the field.

        Weights are in square wavelengths. The rule integrates the product of a wave with ``rate``
        cycles per wavelength and a polynomial of order ``order``. The rule has ``extra`` additional
        nodes per side.
        """
        longest = float((self.high[cell] - self.low[cell]).max())
        cycles = _NODE_RATIO * (rate + self.highest_frequency)
        cycles += order / (NODES_PER_CYCLE * longest)
        triangles, owners = self._triangles_of(cell)
        nodes, weights, triangle = gauss_rule(triangles, cycles / self.wavelength, extra)
        owners = owners[triangle]
        values = self._source.weights[owners] * (weights / self.wavelength**2)
        for owner in np.unique(owners):
            field = self._source.elements[owner].illumination
            if field is not None:
                inside = owners == owner
                values[inside] *= field(nodes[inside])
        if not self._source.is_flat:
            relative = nodes - self._source.centre
            values = values * waves_of_cycles(
                ((relative @ self._source.curvature) * relative).sum(axis=1) / 2
            )
        return (nodes - self.centre) / self.wavelength, values

    def _triangles(self, cell: int) -> tuple[Floats, Indices]:
        """Return triangles (n, 3, 2) that tile a cell, in m, and their element indices."""
        polygons, numbers = self._parts[cell]
        triangles, owner = triangles_of(polygons)
        wide = areas(triangles) > 0
        return triangles[wide], numbers[owner[wide]]

    def _halves(self, cell: int) -> list[int]:
        """Return the indices of the two or four parts of a cell, which are created on demand."""
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
        """Add the part of a cell inside a box in m as a new cell, unless it is empty."""
        polygons, numbers = self._parts[cell]
        parts = shapely.intersection(polygons, box)
        wide = shapely.area(parts) > _SLIVER * box.area
        if wide.any():
            flat = [shapely.MultiPolygon(polygons_in(part)) for part in parts[wide]]
            self._children[cell].append(len(self._parts))
            self._add(np.array(flat, dtype=object), numbers[wide])

    def _add(self, polygons: NDArray[np.object_], numbers: Indices) -> None:
        """Add a cell made of polygons in m, whose element indices are ``numbers``."""
        self._parts.append((polygons, numbers))
        bounds = (shapely.total_bounds(polygons).reshape(2, 2) - self.centre) / self.wavelength
        self.low = np.vstack([self.low, bounds[0]])
        self.high = np.vstack([self.high, bounds[1]])


@lru_cache(maxsize=16)
def cells_of(source: Any, wavelength: float) -> Cells:
    """Return the tree of cells of a source, cached for equal sources."""
    return Cells(source, wavelength)


# Number of kernel or field values per block, which fit into the processor's cache.
_BLOCK = 1 << 14
# Number of terms in a matrix product above which BLAS starts threads, which would be slower.
_PRODUCT = 1 << 18
# Number of integrals M_i of equation (RX3) per block, which take 64 MiB.
_MOMENTS = 1 << 21
# Step to which frequencies are rounded up [cycles per wavelength], so that different poses use the
# same nodes.
_RATE_STEP = 0.125

Pairs: TypeAlias = Any
"""Record array with the indices of a pose, a transmitter cell and a receiver cell."""


def _table(names: str, *columns: NDArray[Any]) -> Pairs:
    """Return columns as a record array; ``names`` are separated by commas."""
    make: Any = np.rec.fromarrays  # The type hints of NumPy require formats.
    return make(columns, names=names)


_PAIR = "pose,transmitter,receiver"


class Sight:
    """Arguments of a link kernel: distances and dot products between nodes.

    The nodes x (n, i, 2) of the transmitter and y (n, j, 3) of the receiver are relative to the
    centres of their sources, in the transmitter's frame. ``offset`` (n, 3) is the vector between
    the centres, and ``rotation`` (n, 3, 3) is the rotation of the receiver's frame. R is the length
    of the vector r from x to y; n and m are the normals of the transmitter and the receiver.
    """

    def __init__(self, x: Floats, y: Floats, offset: Floats, rotation: Floats) -> None:
        """Compute distances and dot products between all pairs of nodes."""
        self._x, self._y, self._offset, self.rotation = x, y, offset, rotation
        normal = rotation[:, :, 2]
        centre_distance = np.sqrt((offset * offset).sum(axis=1))[:, None, None]
        ones = np.ones((*x.shape[:2], 1)), np.ones((len(y), 1, y.shape[1]))
        # This form loses no digits at large distances: |offset + y - x|^2 - |offset|^2 =
        # (|x|^2 - 2 offset.x) + (|y|^2 + 2 offset.y) - 2 x.y.
        of_x = (x * x).sum(axis=2) - 2 * (x @ offset[:, :2, None])[..., 0]
        of_y = (y * y).sum(axis=2) + 2 * (y @ offset[:, :, None])[..., 0]
        left = np.concatenate([-2 * x, of_x[..., None], ones[0]], axis=2)
        right = np.concatenate([np.swapaxes(y[..., :2], 1, 2), ones[1], of_y[:, None]], axis=1)
        excess = left @ right
        self.distance = np.sqrt(excess + centre_distance * centre_distance)
        phase = 2 * np.pi * excess / (self.distance + centre_distance)
        self.wave = np.cos(phase), np.sin(phase)
        """Real and imaginary part of ``exp(ik(R - |offset|))``, shape (n, i, j)."""
        self.rise = (offset[:, None, 2] + y[..., 2])[:, None, :]
        """n.r, shape (n, 1, j)."""
        away = (offset * normal).sum(axis=1)[:, None] - (x @ normal[:, :2, None])[..., 0]
        self.away = away[..., None]
        """m.r, shape (n, i, 1)."""
        self.lean = normal[:, 2, None, None]
        """n.m, shape (n, 1, 1)."""

    @property
    def r(self) -> list[Floats]:
        """Components of r in wavelengths, each of shape (n, i, j) or (n, 1, j)."""
        across = [
            (self._offset[:, axis, None] + self._y[..., axis])[:, None, :]
            - self._x[..., axis, None]
            for axis in range(2)
        ]
        return [*across, self.rise]


@dataclass(frozen=True, eq=False)
class Links:
    """A transmitter and a receiver in n relative poses, in wavelengths."""

    transmitter: Cells
    receiver: Cells
    rotation: Floats
    """Rotation from the receiver's frame to the transmitter's frame, shape (n, 3, 3)."""
    offset: Floats
    """Vector from the transmitter's centre to the receiver's centre, shape (n, 3)."""
    kernel: Callable[[Sight], tuple[Floats, Floats]]
    """Real and imaginary part of the kernel, such as ``link_kernel``."""
    extra: float
    """Number of additional nodes along each side of a cell, which determines the accuracy."""

    def sizes(self, pairs: Pairs) -> tuple[Floats, Floats, Floats]:
        """Return half the diagonal of each cell of a pair, and the distance between their centres.

        All lengths (n,) are in wavelengths.
        """
        ends = (self.transmitter, pairs.transmitter), (self.receiver, pairs.receiver)
        half = [np.linalg.norm(cells.high[k] - cells.low[k], axis=1) / 2 for cells, k in ends]
        return half[0], half[1], np.linalg.norm(self._between(pairs), axis=1)

    def _between(self, pairs: Pairs) -> Floats:
        """Return the vectors (n, 3) from the transmitter cell to the receiver cell of each pair.

        The vectors between the cell centres are in wavelengths, in the transmitter's frame.
        """
        vectors = self.offset[pairs.pose].copy()
        there = _centre(self.receiver, pairs.receiver)
        vectors += np.einsum("nij,nj->ni", self.rotation[pairs.pose][:, :, :2], there)
        vectors[:, :2] -= _centre(self.transmitter, pairs.transmitter)
        return vectors

    def sums(self, pairs: Pairs, order: int) -> tuple[Complex, Floats]:
        """Return each pair's contribution to the coupling, equation (RX3), and its sum of moduli.

        Values are in square wavelengths. The phase due to the distance between the sources is
        omitted. ``order``: number q of nodes along each side of a cell.
        """
        values, size = np.zeros(len(pairs), np.complex128), np.zeros(len(pairs))
        for rows, here, there, sight in self._blocks(pairs, order):
            real, imag = self.kernel(sight)
            values[rows] += _contracted(here, real, imag, there)
            sample = np.s_[:, :: order + 1, :: order + 1]
            largest = np.hypot(real[sample], imag[sample]).max(axis=(1, 2))
            size[rows] += largest * np.abs(here).sum(axis=1) * np.abs(there).sum(axis=1)
        return values, size

    def _blocks(self, pairs: Pairs, order: int) -> Iterator[tuple[slice, Complex, Complex, Sight]]:
        """Yield slices of pairs, M_i and M'_j of equation (RX3), and distances between nodes."""
        count = order * order
        step = max(1, _BLOCK // count**2)
        for several in index_blocks(len(pairs), _MOMENTS // count):
            part = pairs[several]
            towards = self._between(part)
            towards /= np.linalg.norm(towards, axis=1)[:, None]
            back = np.einsum("nji,nj->ni", self.rotation[part.pose], towards)
            here = self._moments(self.transmitter, part.transmitter, -towards[:, :2], order)
            there = self._moments(self.receiver, part.receiver, back[:, :2], order)
            for local in index_blocks(len(part), step):
                block_pairs = part[local]
                ahead = towards[local, :, None]
                x, from_x = _nodes(self.transmitter, block_pairs.transmitter, order)
                offset, rotation = self.offset[block_pairs.pose], self.rotation[block_pairs.pose]
                axes = np.swapaxes(rotation[:, :, :2], 1, 2)
                receiver_nodes = _nodes(self.receiver, block_pairs.receiver, order)
                y, from_y = (nodes @ axes for nodes in receiver_nodes)
                left = here[local] * waves_of_cycles((from_x @ ahead[:, :2])[..., 0])
                right = there[local] * waves_of_cycles(-(from_y @ ahead)[..., 0])
                block = slice(several.start + local.start, several.start + local.stop)
                for row in index_blocks(count, _BLOCK // (step * count)):
                    yield block, left[:, row], right, Sight(x[:, row], y, offset, rotation)

    def _moments(self, cells: Cells, numbers: Indices, waves: Floats, order: int) -> Complex:
        """Return the integrals M_i of equation (RX3), shape (n, q^2).

        ``waves`` (n, 2): frequencies f of the factors exp(2 pi i f.x) in cycles per wavelength,
        with x relative to the cell centres.
        """
        fastest = float(np.linalg.norm(waves, axis=1).max(initial=0.0))
        rate = float(np.ceil(fastest / _RATE_STEP) * _RATE_STEP)
        moments = np.zeros((len(numbers), order, order), np.complex128)
        for cell in np.unique(numbers).tolist():
            (rows,) = np.nonzero(numbers == cell)
            points, weights = cells.nodes(cell, rate, order, self.extra)
            half, relative = (cells.high[cell] - cells.low[cell]) / 2, points - _centre(cells, cell)
            for part in index_blocks(len(points), _PRODUCT // (2 * order * order)):
                first, second = _lagrange(relative[part] / half, order)
                size = 1 + len(rows) * first.size // _BLOCK
                for block in np.array_split(rows, min(len(rows), size)):
                    field = waves_of_cycles(waves[block] @ relative[part].T) * weights[part]
                    # BLAS cannot multiply real by complex matrices.
                    terms = (field[:, :, None] * second).view(np.float64)
                    moments[block] += (first.T @ terms).view(np.complex128)
        return moments.reshape(len(numbers), order * order)


def _nodes(cells: Cells, numbers: Indices, order: int) -> tuple[Floats, Floats]:
    """Return the interpolation nodes (n, q^2, 2) of cells, and the nodes relative to the centres.

    Lengths are in wavelengths. ``order``: number q of nodes along each side.
    """
    half = (cells.high[numbers] - cells.low[numbers]) / 2
    relative = half[:, None] * _rule(order)[0]
    return relative + _centre(cells, numbers)[:, None], relative


def _contracted(left: Complex, real: Floats, imag: Floats, right: Complex) -> Complex:
    """Return ``sum_ij left_i K_ij right_j`` for each pair, where ``K = real + i imag``."""
    columns = np.stack([right.real, right.imag], axis=2)
    of_real, of_imag = real @ columns, imag @ columns
    inner = of_real[..., 0] - of_imag[..., 1] + 1j * (of_real[..., 1] + of_imag[..., 0])
    return np.asarray((left * inner).sum(axis=1))


def _centre(cells: Cells, numbers: Indices | int) -> Floats:
    """Return the centres (n, 2) of cells in wavelengths."""
    return np.asarray((cells.low[numbers] + cells.high[numbers]) / 2)


@lru_cache(maxsize=32)
def _rule(order: int) -> tuple[Floats, Floats]:
    """Return Gauss nodes (q^2, 2) on [-1, 1]^2 and the matrix (q, q) of the Legendre transform."""
    nodes, weights = np.polynomial.legendre.leggauss(order)
    x, y = np.meshgrid(nodes, nodes, indexing="ij")
    series = np.polynomial.legendre.legvander(nodes, order - 1).T * weights
    series *= (np.arange(order) + 0.5)[:, None]
    return np.stack([x.ravel(), y.ravel()], axis=1), series


def _lagrange(points: Floats, order: int) -> Floats:
    """Return Lagrange polynomials (2, n, q) of Gauss nodes at points (n, 2) in [-1, 1]^2."""
    return np.asarray(np.polynomial.legendre.legvander(points.T, order - 1) @ _rule(order)[1])


# Orders of interpolation. Pairs that need a higher order are divided. High orders are faster than
# small cells: for two sources of 10 wavelengths that are 10 wavelengths apart, order 22 needs 2e5
# kernel values, and smaller cells with order 18 need twice as many.
_ORDERS = np.array([2, 3, 4, 5, 6, 8, 10, 12, 15, 18, 22, 26, 32, 38, 46, 56])
# Largest phase [rad] of the interpolated function across a pair.
_MOST_PHASE = 70.0
# Largest ratio of the sum of both cells' half diagonals to the distance between the cells.
_MOST_RATIO = 4.0
# Ratio of the interpolation order to the phase in rad, below which no digit of the result is
# correct. Gauss rules require a ratio of 1/2.
_IDLE = 0.25
# Rounding error of a pair, relative to its sum of moduli.
_ROUNDING = 1e-15
# Largest number of kernel values per pose, which take several minutes, and largest number of cell
# pairs per pose.
_MOST_VALUES, _MOST_PAIRS = 1 << 29, 1 << 17


def link_sums(links: Links, tolerance: float, floor: Floats) -> tuple[Complex, Floats, Floats]:
    """Return ``int int u_t K u_r`` for n poses, and the estimated and allowed errors.

    Values are in square wavelengths. The phase due to the distance is omitted. The allowed error is
    ``tolerance`` times the larger of the modulus and ``floor`` (n,). Raises ArgumentError for
    computations that would take more than several minutes.
    """
    count = len(links.offset)
    first = np.zeros(count, np.intp)
    digits = -math.log10(tolerance)
    parts = _initial(links, _divided(links, _table(_PAIR, np.arange(count), first, first)), digits)
    work = 0.0
    while True:
        pose = parts.pose
        total = sums_by_index(pose, parts.values, count)
        allowed = tolerance * np.maximum(np.abs(total), floor)
        open_ = _to_refine(parts, allowed / 2)
        if not open_.any():
            break
        per_pair = (allowed / 2 / np.maximum(np.bincount(pose[open_], minlength=count), 1))[pose]
        halved = open_ & (_expected_error(links, parts) > per_pair)
        smaller = _initial(links, _divided(links, _halves(links, parts[halved])), digits)
        raised = _next_order(links, parts[open_ & ~halved])
        work += sum(float((_ORDERS[part.orders] ** 4.0).sum()) for part in (smaller, raised))
        if work > _MOST_VALUES * count:
            raise _too_much(links, parts)
        parts = _joined(parts[~open_], smaller, raised)
    errors = np.bincount(pose, parts.errors, count).astype(np.float64)
    return total, errors, allowed


def _to_refine(parts: Pairs, allowed: Floats) -> NDArray[np.bool_]:
    """Return a mask of pairs to refine.

    The errors of all other pairs add up to at most ``allowed`` per pose.
    """
    pose = parts.pose
    ordered = np.lexsort((parts.errors, pose))
    sums = np.cumsum(parts.errors[ordered])
    starts = np.searchsorted(pose[ordered], np.arange(len(allowed)))
    before = np.concatenate([[0.0], sums])[starts]
    is_large = np.zeros(len(pose), np.bool_)
    is_large[ordered] = sums - before[pose[ordered]] > allowed[pose[ordered]]
    return is_large & (parts.errors > _ROUNDING * parts.sizes)


def _expected_error(links: Links, parts: Pairs) -> Floats:
    """Return the expected errors at the highest order; infinite for pairs at this order."""
    idle = _IDLE * _phase(links, parts)
    falling = np.maximum(_ORDERS[np.maximum(parts.orders - 1, 0)] - idle, 1.0)
    size = np.maximum(np.maximum(np.abs(parts.values), parts.errors), 1e-300)
    rate = np.log(np.maximum(parts.errors, 1e-300) / size) / falling
    expected = size * np.exp(rate * np.maximum(_ORDERS[-2] - idle, 1.0))
    return np.where(parts.orders == len(_ORDERS) - 1, np.inf, expected)


def _initial(links: Links, pairs: Pairs, digits: float) -> Pairs:
    """Evaluate pairs at the two lowest orders that may give ``digits`` correct decimal digits."""
    phase = _phase(links, pairs)
    # The formula was fitted to the lowest orders that are sufficient for pairs of squares, over all
    # distances between the squares.
    likely = 1 + digits / 3 + 0.8 * np.sqrt(phase)
    least = np.minimum(np.maximum(2 + _IDLE * phase, likely), _ORDERS[-2])
    orders = np.searchsorted(_ORDERS, least)
    return _next_order(links, _evaluated(links, pairs, orders, np.full(len(pairs), np.inf)))


def _next_order(links: Links, parts: Pairs) -> Pairs:
    """Evaluate pairs at the next higher order."""
    return _evaluated(links, parts, parts.orders + 1, parts.values)


def _evaluated(links: Links, pairs: Pairs, orders: Indices, before: Complex | Floats) -> Pairs:
    """Evaluate pairs at the given orders; errors are the changes from the values ``before``.

    ``orders``: indices into _ORDERS. Raises ArgumentError for too many kernel values.
    """
    if (_ORDERS[orders] ** 4.0).sum() > _MOST_VALUES * len(links.offset):
        raise _too_much(links, pairs)
    values, sizes = np.empty(len(pairs), np.complex128), np.empty(len(pairs))
    for order in np.unique(orders):
        rows = np.flatnonzero(orders == order)
        values[rows], sizes[rows] = links.sums(pairs[rows], int(_ORDERS[order]))
    columns = pairs.pose, pairs.transmitter, pairs.receiver, values, orders
    names = f"{_PAIR},values,orders,errors,sizes"
    return _table(names, *columns, np.abs(values - before), sizes)


def _joined(*pairs: Pairs) -> Pairs:
    """Concatenate record arrays."""
    return np.concatenate(pairs).view(np.recarray)


def _too_much(links: Links, pairs: Pairs) -> ArgumentError:
    """Return the error for a coupling that would take too long."""
    _, _, distance = links.sizes(pairs)
    nearest = int(distance.argmin())
    return ArgumentError(
        f"the coupling requires more than {len(pairs)} pairs of cells of both sources, the "
        f"closest of which are {distance[nearest]:.3g} wavelengths apart at pose "
        f"{int(pairs.pose[nearest])}; use smaller sources, a larger distance or a larger "
        "tolerance, or check the units"
    )


def _phase(links: Links, pairs: Pairs) -> Floats:
    """Return the largest phase [rad] of the interpolated function along a coordinate."""
    here, there, distance = links.sizes(pairs)
    return np.asarray(2 * math.pi * np.maximum(here, there) * (here + there) / distance)


def _divided(links: Links, pairs: Pairs) -> Pairs:
    """Divide pairs of cells until all pairs can be interpolated with the available orders."""
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
    """Divide the larger cell of each pair."""
    here, there, _ = links.sizes(pairs)
    at_transmitter = here >= there
    first, second = pairs[at_transmitter], pairs[~at_transmitter]
    cells, row = links.transmitter.halved(first.transmitter)
    halved = _table(_PAIR, first.pose[row], cells, first.receiver[row])
    cells, row = links.receiver.halved(second.receiver)
    return _joined(halved, _table(_PAIR, second.pose[row], second.transmitter[row], cells))
