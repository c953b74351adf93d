"""Sources in cells, and the share of a cell of a transmitter and one of a receiver in a link.

Between cells that are small compared with their distance the kernel is, but for two plane waves
along the line s of their centres, a slowly varying function of both places. It is interpolated at
Gauss's nodes, q along each side of both boxes:

    int int u_t K u_r = sum_ij M_i K_ij M'_j,    M_i = int u_t(x) exp(-ik s.x) L_i(x) dx       (RX3)

so that a pair costs q^4 values of K, however many wavelengths its cells have, and sums over the
nodes in each cell. Of cells that are rectangles it is the rule of Gauss, of twice the order.
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

# What rounding of a cut leaves of a polygon, as a fraction of the cell's area.
_SLIVER = 1e-14
# Sides of at least this fraction of the longest are halved with it: in a box that is longer one way
# the nodes along the other are too many.
_SQUARE = 0.7
# Nodes for a cycle of a wave, as a fraction of those of rays: 2.5, where Gauss needs pi/2. With 4
# nodes more, moments of triangles err by 1e-11 of the area.
_SHARE = 0.7
# Rules kept for other poses and orders, of some hundred kB at most.
_MOST_KEPT = 256


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
        self._parts: list[tuple[NDArray[np.object_], NDArray[np.intp]]] = []
        self._children: dict[int, list[int]] = {}
        self._nodes: dict[tuple[int, float, int, float], tuple[Floats, Complex]] = {}
        self._triangles: dict[int, tuple[Floats, NDArray[np.intp]]] = {}
        outlines = [element.shape.polygons for element in self._source.elements]
        whole = np.array(outlines, dtype=object)
        hull = shapely.GeometryCollection(whole.tolist()).convex_hull
        self.corners = shapely.get_coordinates(hull)[:-1]
        """Vertices of the convex hull (n, 2), in metres."""
        self._add(whole, np.arange(len(whole)))

    def halved(self, cells: NDArray[np.intp]) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Numbers of halves of cells (n,), quarters of square ones, and of their cells in (n,)."""
        different, place = np.unique(cells, return_inverse=True)
        halves = [self._halves(int(cell)) for cell in different]
        counts = np.array([len(pair) for pair in halves], dtype=np.intp)[place]
        found = np.array([half for cell in place for half in halves[cell]], dtype=np.intp)
        return found, np.repeat(np.arange(len(cells)), counts)

    def nodes(self, cell: int, rate: float, order: int, extra: float) -> tuple[Floats, Complex]:
        """Places (n, 2) in a cell, and weights (n,) times the field, in square wavelengths.

        For integrands of ``rate`` cycles per wavelength times a polynomial of an ``order`` over all
        of the cell; ``extra``: nodes along a side beyond those.
        """
        key = cell, rate, order, extra
        if key not in self._nodes:
            if len(self._nodes) >= _MOST_KEPT:
                self._nodes.clear()
            longest = float((self.high[cell] - self.low[cell]).max())
            # so that the longest side has as many nodes more as the order is
            waving = _SHARE * (rate + self.highest_frequency) + order / (NODES_PER_CYCLE * longest)
            self._nodes[key] = self._rule(cell, waving, extra)
        return self._nodes[key]

    def _rule(self, cell: int, rate: float, extra: float) -> tuple[Floats, Complex]:
        triangles, owners = self._triangles_of(cell)
        nodes, shares, numbers = rule_by_triangles(triangles, rate / self.wavelength, extra)
        owners = owners[numbers]
        values = self._source.weights[owners] * (shares / self.wavelength**2)
        for owner in np.unique(owners):
            field = self._source.elements[owner].illumination
            if field is not None:
                mine = owners == owner
                values[mine] *= field(nodes[mine])
        if not self._source.is_flat:
            inner = nodes - self._source.centre
            turns = ((inner @ self._source.curvature) * inner).sum(axis=1) / 2
            values = values * np.exp(2j * np.pi * turns)
        return (nodes - self.centre) / self.wavelength, values

    def _triangles_of(self, cell: int) -> tuple[Floats, NDArray[np.intp]]:
        """Triangles (n, 3, 2) of a cell in metres, and the elements that they belong to."""
        if cell not in self._triangles:
            polygons, numbers = self._parts[cell]
            found = [triangulated([polygon]) for polygon in polygons]
            owners = np.repeat(numbers, [len(triangles) for triangles in found])
            triangles = np.concatenate(found)
            wide = areas(triangles) > 0
            self._triangles[cell] = triangles[wide], owners[wide]
        return self._triangles[cell]

    def _halves(self, cell: int) -> list[int]:
        if cell not in self._children:
            low, high = self.low[cell], self.high[cell]
            middle = low / 2 + high / 2
            is_long = high - low > _SQUARE * (high - low).max()
            every = np.stack([low, middle, high], axis=1)
            stops = [row if long else row[::2] for row, long in zip(every, is_long, strict=True)]
            self._children[cell] = []
            for x, y in product(*map(pairwise, stops)):
                outline = np.transpose([x, y]) * self.wavelength + self.centre
                self._cut(cell, shapely.box(*outline.ravel()))
        return self._children[cell]

    def _cut(self, cell: int, box: shapely.Polygon) -> None:
        """Adds the part of a cell that lies in a box, if there is one."""
        polygons, numbers = self._parts[cell]
        found = shapely.intersection(polygons, box)
        kept = shapely.area(found) > _SLIVER * box.area
        if kept.any():
            flat = [shapely.MultiPolygon(polygons_in(part)) for part in found[kept]]
            self._children[cell].append(len(self._parts))
            self._add(np.array(flat, dtype=object), numbers[kept])

    def _add(self, polygons: NDArray[np.object_], numbers: NDArray[np.intp]) -> None:
        self._parts.append((polygons, numbers))
        bounds = (shapely.total_bounds(polygons).reshape(2, 2) - self.centre) / self.wavelength
        self.low = np.vstack([self.low, bounds[0]])
        self.high = np.vstack([self.high, bounds[1]])


@lru_cache(maxsize=16)
def cells_of(source: Any, wavelength: float) -> Cells:
    """The cells of a source at a wavelength in m; equal sources share theirs."""
    return Cells(source, wavelength)


def link_kernel(condition: Obliquity, sight: Sight) -> tuple[Floats, Floats]:
    """Real and imaginary part of K (...) of a boundary condition at both ends: (RX1)."""
    cosine, sine = sight.wave
    nr, mr, nm = sight.rise, sight.away, sight.lean
    # 1/(kR) is real, and so are all factors of its powers: real and imaginary part on their own;
    # in place, since fresh memory costs more than the sums
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
    """Real and imaginary part of K (...) of currents along q (3,) and q' (3,): (RX9).

    Both are unit vectors along the fields, each in the axes of its own source.
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


# Values of the kernel, or of fields at nodes, at a time: their arrays stay in the cache.
_BLOCK = 1 << 14
# Terms of a product of matrices at a time: of more BLAS starts threads, which such sizes delay.
_PRODUCT = 1 << 18
# Moments at a time: 64 MiB.
_MOMENTS = 1 << 21
# Steps in which the rates of waves are rounded up, so that poses share their nodes.
_RATE_STEP = 0.125


# Pairs of cells: fields pose, transmitter and receiver, the numbers of a pose and of both cells.
Pairs: TypeAlias = Any
table: Any = np.rec.fromarrays  # NumPy's types ask for formats, which columns have


def pairs_of(pose: Indices, transmitter: Indices, receiver: Indices) -> Pairs:
    """Return pairs of cells (n,), an array with named fields."""
    return table([pose, transmitter, receiver], names="pose,transmitter,receiver")


class Sight:
    """Distances and cosines between nodes x (n, i, 2) and y (n, j, 3) of two cells, (n, i, j).

    From the centres of their sources, which are ``offset`` (n, 3) apart. ``rotation`` (n, 3, 3):
    of the receiver's frame. Heights above either plane are the same for all points in the other's.
    """

    def __init__(self, x: Floats, y: Floats, offset: Floats, rotation: Floats) -> None:
        self._x, self._y, self._offset, self.rotation = x, y, offset, rotation
        normal = rotation[:, :, 2]
        whole = np.sqrt((offset * offset).sum(axis=1))[:, None, None]
        ones = np.ones((*x.shape[:2], 1)), np.ones((len(y), 1, y.shape[1]))
        # |offset + y - x|^2 - |offset|^2 = (|x|^2 - 2 offset.x) + (|y|^2 + 2 offset.y) - 2 x.y
        of_x = (x * x).sum(axis=2) - 2 * (x @ offset[:, :2, None])[..., 0]
        of_y = (y * y).sum(axis=2) + 2 * (y @ offset[:, :, None])[..., 0]
        left = np.concatenate([-2 * x, of_x[..., None], ones[0]], axis=2)
        right = np.concatenate([np.swapaxes(y[..., :2], 1, 2), ones[1], of_y[:, None]], axis=1)
        longer = left @ right
        self.distance = longer + whole * whole
        np.sqrt(self.distance, out=self.distance)
        longer /= self.distance + whole
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
        found = [
            (self._offset[:, axis, None] + self._y[..., axis])[:, None, :]
            - self._x[..., axis, None]
            for axis in range(2)
        ]
        return [*found, self.rise]


@dataclass(frozen=True, eq=False)
class Links:
    """A transmitter and a receiver in n poses, lengths in wavelengths."""

    transmitter: Cells
    receiver: Cells
    rotation: Floats
    """(n, 3, 3), of the receiver's frame into the transmitter's."""
    offset: Floats
    """(n, 3) from the transmitter's centre to the receiver's."""
    kernel: Callable[[Sight], tuple[Floats, Floats]]
    """Real and imaginary part of K, such as :func:`link_kernel` of a boundary condition."""
    extra: float
    """Nodes along a side of a cell, added to the count that waves and polynomials need."""

    def sizes(self, pairs: Pairs) -> tuple[Floats, Floats, Floats]:
        """Half the diagonals of both cells of pairs, and their distance, (n,) each."""
        half = [
            np.linalg.norm(cells.high[own] - cells.low[own], axis=1) / 2
            for cells, own in (
                (self.transmitter, pairs.transmitter),
                (self.receiver, pairs.receiver),
            )
        ]
        return half[0], half[1], np.linalg.norm(self._between(pairs), axis=1)

    def _between(self, pairs: Pairs) -> Floats:
        """Vectors (n, 3) from the centres of the transmitter's boxes to the receiver's."""
        found = self.offset[pairs.pose].copy()
        there = _middle(self.receiver, pairs.receiver)
        found += np.einsum("nij,nj->ni", self.rotation[pairs.pose][:, :, :2], there)
        found[:, :2] -= _middle(self.transmitter, pairs.transmitter)
        return found

    def sums(self, pairs: Pairs, order: int) -> tuple[Complex, Floats]:
        """(RX3) of pairs (n,), less the phase of the distance of the sources; and its size.

        The size is about the sum of the moduli of all terms.
        """
        found, size = np.zeros(len(pairs), np.complex128), np.zeros(len(pairs))
        for mine, here, there, sight in self._blocks(pairs, order):
            real, imag = self.kernel(sight)
            found[mine] += _contracted(here, real, imag, there)
            some = np.s_[:, :: order + 1, :: order + 1]
            largest = np.hypot(real[some], imag[some]).max(axis=(1, 2))
            size[mine] += largest * np.abs(here).sum(axis=1) * np.abs(there).sum(axis=1)
        return found, size

    def _blocks(self, pairs: Pairs, order: int) -> Iterator[tuple[slice, Complex, Complex, Sight]]:
        """Blocks of pairs, moments at nodes of both cells, and the geometry between these."""
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
                mine = slice(start, min(start + step, len(part)))
                some = part[mine]
                own = slice(begin + mine.start, begin + mine.stop)
                x, y, from_x, from_y = self._places(some, order)
                left = here[mine] * exp_turns((from_x @ towards[mine, :2, None])[..., 0])
                right = there[mine] * exp_turns(-(from_y @ towards[mine, :, None])[..., 0])
                offset, rotation = self.offset[some.pose], self.rotation[some.pose]
                for first in range(0, count, rows):
                    row = slice(first, first + rows)
                    yield own, left[:, row], right, Sight(x[:, row], y, offset, rotation)

    def _places(self, pairs: Pairs, order: int) -> tuple[Floats, Floats, Floats, Floats]:
        """Nodes of both cells in axes of the transmitter, from the centres of their sources.

        (n, q^2, 2) and (n, q^2, 3); then the same from the middles of the cells.
        """
        x, from_x = self._points(self.transmitter, pairs.transmitter, order)
        turned = np.swapaxes(self.rotation[pairs.pose][:, :, :2], 1, 2)
        y, from_y = self._points(self.receiver, pairs.receiver, order)
        return x, y @ turned, from_x, from_y @ turned

    @staticmethod
    def _points(cells: Cells, own: Indices, order: int) -> tuple[Floats, Floats]:
        """Gauss's nodes in boxes (n, q^2, 2), and the same relative to the boxes' middles."""
        half = (cells.high[own] - cells.low[own]) / 2
        relative = half[:, None] * _rule(order)[0]
        return relative + _middle(cells, own)[:, None], relative

    def _moments(self, cells: Cells, own: Indices, waves: Floats, order: int) -> Complex:
        """M_i of (RX3), (n, q^2).

        ``waves`` (n, 2): cycles per wavelength, about the middle of each cell.
        """
        fastest = float(np.linalg.norm(waves, axis=1).max(initial=0.0))
        rate = np.ceil(fastest / _RATE_STEP) * _RATE_STEP
        found = np.zeros((len(own), order, order), np.complex128)
        step = max(1, _PRODUCT // (2 * order * order))
        for cell, mine in _groups(own, np.argsort(own, kind="stable")):
            places, weights = cells.nodes(cell, float(rate), order, self.extra)
            middle, half = _middle(cells, cell), (cells.high[cell] - cells.low[cell]) / 2
            relative = places - middle
            for start in range(0, len(places), step):
                part = slice(start, start + step)
                first, second = _basis(relative[part] / half, order)
                size = 1 + len(mine) * first.size // _BLOCK
                for some in np.array_split(mine, min(len(mine), size)):
                    field = exp_turns(waves[some] @ relative[part].T) * weights[part]
                    # pairs of real numbers, since a product of a real and a complex matrix is none
                    terms = (field[:, :, None] * second).view(np.float64)
                    found[some] += (first.T @ terms).view(np.complex128)
        return found.reshape(len(own), order * order)


def exp_turns(turns: Floats) -> Complex:
    """exp(2 pi i turns)."""
    phase = 2 * np.pi * turns
    found = np.empty(phase.shape, np.complex128)
    found.real, found.imag = np.cos(phase), np.sin(phase)
    return found


def _contracted(left: Complex, real: Floats, imag: Floats, right: Complex) -> Complex:
    """sum_ij left_i kernel_ij right_j of each pair."""
    columns = np.stack([right.real, right.imag], axis=2)
    of_real, of_imag = real @ columns, imag @ columns
    inner = of_real[..., 0] - of_imag[..., 1] + 1j * (of_real[..., 1] + of_imag[..., 0])
    result: Complex = (left * inner).sum(axis=1)
    return result


def _middle(cells: Cells, own: Indices | int) -> Floats:
    result: Floats = (cells.low[own] + cells.high[own]) / 2
    return result


def _groups(own: Indices, ordered: Indices) -> Iterator[tuple[int, Indices]]:
    """Each cell with the places at which it stands in ``own``."""
    cells, starts = np.unique(own[ordered], return_index=True)
    yield from zip(cells.tolist(), np.split(ordered, starts[1:]), strict=True)


@lru_cache(maxsize=32)
def _rule(order: int) -> tuple[Floats, Floats]:
    """Gauss's nodes (q^2, 2) of the square [-1, 1]^2, and (q, q) Legendre's series from values."""
    nodes, weights = np.polynomial.legendre.leggauss(order)
    x, y = np.meshgrid(nodes, nodes, indexing="ij")
    series = np.polynomial.legendre.legvander(nodes, order - 1).T * weights
    series *= (np.arange(order) + 0.5)[:, None]
    return np.stack([x.ravel(), y.ravel()], axis=1), series


def _basis(places: Floats, order: int) -> Floats:
    """Polynomials (n, q) of x and of y (n, 2) that are 1 at one node and 0 at all others."""
    result: Floats = np.polynomial.legendre.legvander(places.T, order - 1) @ _rule(order)[1]
    return result
