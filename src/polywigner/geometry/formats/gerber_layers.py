"""Dark and clear shapes of a Gerber file, one upon the other, as one region."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import groupby
from typing import Any

import numpy as np
import shapely
from shapely.geometry.base import BaseGeometry

from polywigner.errors import FileFormatError
from polywigner.geometry.formats.limits import MOST_COMBINED
from polywigner.geometry.formats.work import Work
from polywigner.geometry.grid import combined_on_grid, groups_apart, polygons_in, union_on_grid

__all__ = ["Layers", "composed"]

# Vertices of shapes that touch and are joined in some tenths of a second; those are not counted.
_QUICK = 20_000

Layers = list[tuple[bool, BaseGeometry]]
"""Shapes one upon the other, each dark (adds) or clear (cuts)."""


def composed(layers: Iterable[tuple[bool, BaseGeometry]], work: Work) -> BaseGeometry:
    """What is left when dark shapes add and clear ones cut, in their order.

    `work` is that of the file.     Raises FileFormatError where that takes too long.
    """
    copper = np.array([], dtype=object)
    left = MOST_COMBINED
    for dark, run in groupby(layers, key=lambda layer: layer[0]):
        shapes = [shape for _, shape in run if not shape.is_empty]
        if not shapes:
            continue
        if len(shapes) > 1:
            left -= _vertices_of_unions(shapes)
            _check_combined(left)
            work.check_edges(_outlines(shapes))
            shapes = [union_on_grid(shapes)]
        # The polygons apart from these shapes stay as they are.
        near = shapely.intersects(copper, shapely.box(*shapely.total_bounds(shapes)))
        if near.any():
            left -= int(shapely.get_num_coordinates(copper[near]).sum())
            _check_combined(left - int(shapely.get_num_coordinates(shapes[0])))
            found = _combined(dark, copper[near], shapes[0], work)
        else:
            found = shapes[0] if dark else shapely.MultiPolygon()
        copper = np.concatenate([copper[~near], np.array(polygons_in(found), dtype=object)])
    return copper[0] if len(copper) == 1 else shapely.MultiPolygon(list(copper))


def _vertices_of_unions(shapes: Sequence[BaseGeometry]) -> int:
    """Vertices in the groups of shapes whose union takes long."""
    counts = shapely.get_num_coordinates(shapes)
    sums = [int(counts[group].sum()) for group in groups_apart(shapes, 0.0)]
    return sum(count for count in sums if count > _QUICK)


def _check_combined(left: int) -> None:
    if left < 0:
        raise FileFormatError(
            f"expected shapes that touch, and dark and clear ones, of at most {MOST_COMBINED} "
            "vertices together, each counted for every change of polarity around it, got more; "
            "export a smaller part"
        )


def _combined(dark: bool, polygons: Any, shape: BaseGeometry, work: Work) -> BaseGeometry:
    work.check_edges(_outlines([*polygons, shape]))
    if dark:
        return union_on_grid([*polygons, shape])
    return combined_on_grid(shapely.difference, shapely.MultiPolygon(list(polygons)), shape)


def _outlines(shapes: Sequence[BaseGeometry]) -> list[Any]:
    polygons = shapely.get_parts(np.array(shapes, dtype=object))
    return [shapely.get_coordinates(ring)[:-1] for ring in shapely.get_rings(polygons)]
