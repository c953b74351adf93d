"""A box seen by parallel projection: where its points, faces and edges come to lie on the page."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = ["Edge", "View", "back_edges", "back_wall", "label_edge"]

Floats = NDArray[np.float64]

_FLATTEST = 0.25
"""Smallest drawn side of a box in parts of its largest: thinner boxes are stretched to this."""


@dataclass(frozen=True)
class View:
    """Parallel projection of x, y, z (metres) along ``towards``, y upwards on the page.

    ``stretch`` (3,) multiplies lengths along x, y, z first; ``right``, ``up`` and ``towards`` (3,)
    are orthogonal unit vectors in stretched space, the last one pointing to the viewer.
    """

    stretch: Floats
    right: Floats
    up: Floats
    towards: Floats

    @staticmethod
    def of(lower: ArrayLike, upper: ArrayLike, towards: ArrayLike) -> View:
        """The view of a box between two corners from the direction ``towards`` (3,).

        Sides shorter than a quarter of the longest are stretched to that quarter.
        """
        extent = np.asarray(upper, dtype=np.float64) - np.asarray(lower, dtype=np.float64)
        stretch = np.maximum(extent, _FLATTEST * extent.max()) / extent
        direction = np.asarray(towards, dtype=np.float64)
        direction = direction / np.linalg.norm(direction)
        right = np.cross((0.0, 1.0, 0.0), direction)
        right = right / np.linalg.norm(right)
        return View(stretch, right, np.cross(direction, right), direction)

    @property
    def is_stretched(self) -> bool:
        return bool(np.any(self.stretch > 1))

    def on_page(self, points: ArrayLike) -> Floats:
        """Points (..., 3) to page coordinates (..., 2)."""
        stretched = np.asarray(points, dtype=np.float64) * self.stretch
        return np.stack([stretched @ self.right, stretched @ self.up], axis=-1)

    def corners(self, lower: Floats, upper: Floats) -> Floats:
        """The eight corners of a box on the page, (8, 2)."""
        ends = np.array(list(product(*zip(lower, upper, strict=True))))
        return self.on_page(ends)


def back_wall(view: View, axis: int, lower: Floats, upper: Floats) -> float:
    """The coordinate along ``axis`` of the face that the viewer sees from inside the box."""
    return float(lower[axis] if view.towards[axis] > 0 else upper[axis])


class Edge(NamedTuple):
    """An edge of a box along ``axis``, from ``start`` to ``end`` (3,), and its outward side.

    ``outward`` (2,), a unit vector on the page, points away from the middle of the box.
    """

    axis: int
    start: Floats
    end: Floats
    outward: Floats


def _edges(view: View, axis: int, lower: Floats, upper: Floats) -> list[tuple[Edge, int]]:
    """The four edges along an axis, each with the number of its two faces that show their front."""
    others = [a for a in range(3) if a != axis]
    middle = view.on_page((lower + upper) / 2)
    found = []
    for at_upper in product((False, True), repeat=2):
        start, end = lower.copy(), upper.copy()
        for other, is_upper in zip(others, at_upper, strict=True):
            start[other] = end[other] = (upper if is_upper else lower)[other]
        fronts = sum(
            (view.towards[other] > 0) == is_upper
            for other, is_upper in zip(others, at_upper, strict=True)
        )
        first, last = view.on_page(start), view.on_page(end)
        along = (last - first) / np.linalg.norm(last - first)
        across = np.array([-along[1], along[0]])
        outward = across * np.sign(across @ ((first + last) / 2 - middle) or 1.0)
        found.append((Edge(axis, start, end, outward), fronts))
    return found


def label_edge(view: View, axis: int, lower: Floats, upper: Floats) -> Edge:
    """The edge that carries the ticks of an axis: on the outline, low, for y at the left."""
    outline = [edge for edge, fronts in _edges(view, axis, lower, upper) if fronts == 1]

    def height(edge: Edge) -> float:
        return float((view.on_page(edge.start) + view.on_page(edge.end))[0 if axis == 1 else 1])

    return min(outline, key=height)


def back_edges(view: View, lower: Floats, upper: Floats) -> list[Edge]:
    """The nine edges of the back walls: all but the three nearest to the viewer."""
    return [
        edge for axis in range(3) for edge, fronts in _edges(view, axis, lower, upper) if fronts < 2
    ]
