"""A source in cells: boxes of its plane, cut where a link needs it, with nodes in each.

Lengths are in wavelengths, relative to the centre of the source's bounds.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from itertools import pairwise, product
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray

from polywigner.geometry import Aperture, Wavefront
from polywigner.geometry.parts import polygons_in
from polywigner.illumination.obliquities import fields_of
from polywigner.propagation.arrangement import (
    NODES_PER_CYCLE,
    areas,
    rule_by_triangles,
    triangulated,
)
from polywigner.transforms.wavefronts import flat_of

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]

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
    """A tree of boxes around parts of a source; cell 0 is all of it."""

    def __init__(self, source: Any, wavelength: float) -> None:
        self._wave = source if isinstance(source, Wavefront) else None
        source = flat_of(source)
        xmin, ymin, xmax, ymax = source.bounds
        self.centre = np.array([xmin / 2 + xmax / 2, ymin / 2 + ymax / 2])
        self.wavelength = wavelength
        self._elements = source.elements_in_plane
        self._weights = (
            np.ones(1, np.complex128) if isinstance(source, Aperture) else source.weights
        )
        waves = [np.zeros((1, 2)) if f is None else f.frequencies for f in fields_of(source)]
        frequencies = np.linalg.norm(np.concatenate(waves), axis=1)
        self.highest_frequency = float(frequencies.max()) * wavelength
        """Highest frequency of the field's waves, in cycles per wavelength."""
        if self._wave is not None:
            corners = np.array([(x, y) for x in (xmin, xmax) for y in (ymin, ymax)])
            slopes = (corners - self._wave.centre) @ self._wave.curvature
            self.highest_frequency += float(np.linalg.norm(slopes, axis=1).max()) * wavelength
        self.low, self.high = np.empty((0, 2)), np.empty((0, 2))
        self._parts: list[tuple[NDArray[np.object_], NDArray[np.intp]]] = []
        self._children: dict[int, list[int]] = {}
        self._nodes: dict[tuple[int, float, int, float], tuple[Floats, Complex]] = {}
        self._triangles: dict[int, tuple[Floats, NDArray[np.intp]]] = {}
        self.corners = _hull(self._elements)
        """Vertices of the convex hull (n, 2), in metres."""
        whole = np.array([element.polygons for element in self._elements], dtype=object)
        self._add(whole, np.arange(len(whole)))

    def halved(self, cells: NDArray[np.intp]) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Numbers of the halves of cells (n,), and for each the place of its cell in (n,).

        Halves, or quarters of those that are about as wide as long.
        """
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
        values = self._weights[owners] * (shares / self.wavelength**2)
        for owner in np.unique(owners):
            field = self._elements[owner].illumination
            if field is not None:
                mine = owners == owner
                values[mine] *= field(nodes[mine])
        if self._wave is not None:
            inner = nodes - self._wave.centre
            turns = ((inner @ self._wave.curvature) * inner).sum(axis=1) / 2
            values = values * np.exp(2j * np.pi * turns)
        return (nodes - self.centre) / self.wavelength, values.astype(np.complex128)

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
            stops = [
                [low[axis], middle[axis], high[axis]] if is_long[axis] else [low[axis], high[axis]]
                for axis in range(2)
            ]
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


def _hull(elements: Sequence[Aperture]) -> Floats:
    polygons = shapely.GeometryCollection([element.polygons for element in elements])
    return shapely.get_coordinates(polygons.convex_hull)[:-1]


@lru_cache(maxsize=16)
def cells_of(source: Any, wavelength: float) -> Cells:
    """The cells of a source at a wavelength in m; equal sources share theirs."""
    return Cells(source, wavelength)
