"""Filled shapes of an SVG file.

The picture is kept as it looks: SVG's y axis points down, so (x, y) of the file's coordinates
becomes (x, -y), about the file's own origin. What counts is where something is painted, in whatever
colour; strokes have no part in it.
"""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from typing import Any

import numpy as np

from polywigner.errors import FileFormatError
from polywigner.geometry.formats.curves import Points, flattened
from polywigner.geometry.formats.drawing import Drawing
from polywigner.geometry.formats.layers import overlap_remedy
from polywigner.geometry.formats.outlines import filled
from polywigner.geometry.formats.svg_document import Document, parsed
from polywigner.geometry.formats.svg_shapes import view_box
from polywigner.geometry.formats.svg_values import PIXEL, physical_length
from polywigner.geometry.formats.work import Work

__all__ = ["read_svg"]


def read_svg(
    content: bytes, unit_metres: float, tolerance: float | None, layers: Sequence[str] = ()
) -> Drawing:
    """The filled shapes of an SVG file, y up, each flattened and filled by its own rule.

    Parameters
    ----------
    content
        The file.
    unit_metres
        Metres of one unit of the file's coordinates, unless the file states a size.
    tolerance
        Largest distance in metres between a curve and its chords; None: see `flattened`.
    layers
        Names or ids of the groups or shapes to read alone, even where they are hidden; none: all.

    Raises
    ------
    FileFormatError, MissingExtraError; ArgumentError for a layer that is not there.
    """
    root = parsed(content)
    metres, matrix = _unit(root, unit_metres)
    shapes = list(Document(root, layers).shapes(matrix))
    if not shapes:
        raise FileFormatError(
            "expected filled shapes, got none; give the outlines a fill (strokes have no inside)"
        )
    subpaths = [subpath for shape in shapes for subpath in shape.subpaths]
    outlines = flattened(subpaths, None if tolerance is None else tolerance / metres)
    rings, work = iter(outlines), Work()
    polygons = [
        polygon
        for shape in shapes
        for polygon in filled([next(rings) for _ in shape.subpaths], shape.rule, work)
    ]
    if not polygons:
        raise FileFormatError("expected shapes that enclose an area, got none that do")
    names = [shape.layer for shape in shapes for _ in shape.subpaths]
    return Drawing(polygons, metres, overlap_remedy(outlines, names))


def _unit(root: Any, unit_metres: float) -> tuple[float, Points]:
    """Metres of a unit of the file's coordinates, and the map that flips y.

    A width or height in mm, cm, Q, in, pt or pc states the size of the viewBox, or, without one,
    that a unit is a CSS pixel. Otherwise a unit is what the caller says.
    """
    sizes = {}
    for name in ("width", "height"):
        text = root.get(name)
        physical = None if text in (None, "auto") else physical_length(text, f"the {name}")
        if physical is not None:
            sizes[name] = physical
    box = view_box(root)
    if not sizes:
        return unit_metres, np.diag([1.0, -1.0])
    if box is None:
        return float(PIXEL), np.diag([1.0, -1.0])
    extents = {"width": Fraction(box[2]), "height": Fraction(box[3])}
    x, y = (float(sizes[n] / extents[n]) if n in sizes else None for n in ("width", "height"))
    if x is None or y is None:
        metres = y if x is None else x
        assert metres is not None
        return metres, np.diag([1.0, -1.0])
    fit = root.get("preserveAspectRatio", "").split()
    if "none" in fit:
        return x, np.diag([1.0, -y / x])
    return (max if "slice" in fit else min)(x, y), np.diag([1.0, -1.0])
