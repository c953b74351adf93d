"""Outlines: of files, changed by hand, and as the source that the package computes with."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from functools import lru_cache
from pathlib import Path

import numpy as np
import shapely

import polywigner as pw
from polywigner.errors import ArgumentError, FileFormatError, GeometryError
from polywigner.explorer.state import Point, Ring, State
from polywigner.geometry import Aperture
from polywigner.geometry.io.outlines import nested
from polywigner.illumination.texts import fed

Rings = tuple[Ring, ...]
Source = pw.Aperture | pw.Array

LARGEST_UPLOAD = 1 << 20
"""Bytes of a file that a visitor sends: ten thousand vertices as text; the page edits a tenth."""

MOST_ELEMENTS = 256
"""Most elements of an array: one visitor's picture must not keep the others waiting for long."""

# Of the source's longer side: W of less is a sum over more than a thousand tilts.
_LEAST_COHERENCE = 0.1

_SUFFIXES = (".geojson", ".json", ".wkt", ".csv", ".svg", ".dxf", ".txt")
_DIGITS = 6


# --- Files


def rings_of_aperture(aperture: Aperture, per_metre: float = 1) -> Rings:
    """Outlines in units, rounded to a millionth of the size, as one would type them."""
    size = aperture.diameter * per_metre
    digits = max(0, _DIGITS - 1 - math.floor(math.log10(size)))
    return tuple(
        tuple((_round(x * per_metre, digits), _round(y * per_metre, digits)) for x, y in ring)
        for ring in aperture.rings
    )


def check_upload(name: str, size: int) -> tuple[str, str]:
    """The name of a file that a visitor sends, as it is shown, and its suffix.

    Raises FileFormatError for more than 1 MiB, and for a suffix that the page does not read.
    """
    shown = "".join(c if c.isprintable() else "?" for c in name[-60:]) or "the file"
    if size > LARGEST_UPLOAD:
        raise FileFormatError(
            f"{shown}: expected at most {LARGEST_UPLOAD >> 20} MiB, got "
            f"{size / 2**20:.1f} MiB; simplify what it describes"
        )
    suffix = Path(shown).suffix.lower()
    if suffix not in _SUFFIXES:
        raise FileFormatError(
            f"{shown}: expected GeoJSON, WKT, CSV, SVG or DXF, got {suffix or 'no suffix'}"
        )
    return shown, suffix


def without_advice(text: str) -> str:
    """Text of an error without advice that needs Python."""
    return text.split("; split it with")[0]


# --- Changes by hand


def snapped(rings: Sequence[Sequence[Point]], step: float) -> Rings:
    """Vertices on a raster of this step; step 0 leaves them where they are."""

    def on_raster(value: float) -> float:
        if not step > 0:
            return float(value)
        # a raster of 0.1 has 0.3 on it, not 0.30000000000000004
        return _round(round(value / step) * step, max(0, 3 - math.floor(math.log10(step))))

    return tuple(tuple((on_raster(x), on_raster(y)) for x, y in ring) for ring in rings)


def _round(value: float, digits: int) -> float:
    return round(value, digits) + 0.0  # no -0.0


def rounded(point: Point, step: float) -> Point:
    """To the digits of a step, as one would type it."""
    digits = max(0, -math.floor(math.log10(step)))
    return _round(point[0], digits), _round(point[1], digits)


def rounded_where_new(rings: Rings, before: Rings, step: float) -> Rings:
    """Vertices to the digits of a step that a mouse has moved; those from before stay exact."""
    known = {point for ring in before for point in ring}
    return tuple(tuple(p if p in known else rounded(p, step) for p in ring) for ring in rings)


def rows_of_rings(rings: Rings) -> list[tuple[int, float, float]]:
    """One row (number of the outline from 1, x, y) for each vertex: the table."""
    return [(number, x, y) for number, ring in enumerate(rings, 1) for x, y in ring]


def rings_of_rows(rows: Sequence[tuple[int, float, float]]) -> Rings:
    """Outlines of a table that have three vertices or more."""
    numbers = dict.fromkeys(number for number, _, _ in rows)
    rings = [tuple((x, y) for n, x, y in rows if n == number) for number in numbers]
    return tuple(ring for ring in rings if len(ring) >= 3)


def with_vertex_at(rings: Rings, row: int, point: Point) -> Rings:
    """With the vertex of one row of the table at a point."""
    rows = rows_of_rings(rings)
    rows[row] = (rows[row][0], *point)
    return rings_of_rows(rows)


def with_vertex_after(rings: Rings, row: int) -> Rings:
    """With a new vertex in the middle of the edge that begins at one row of the table."""
    (ax, ay), (bx, by) = _edges(rings)[row]
    # 0.1, not 0.10000000000000009
    return _inserted(rings, row, (float(f"{(ax + bx) / 2:.12g}"), float(f"{(ay + by) / 2:.12g}")))


def with_vertex_near(rings: Rings, point: Point) -> Rings:
    """With a new vertex at a point, in the edge that is nearest to it."""
    edges = _edges(rings)
    if not edges:
        return rings
    distances = shapely.distance(shapely.linestrings(edges), shapely.Point(point))
    return _inserted(rings, int(np.argmin(distances)), point)


def _edges(rings: Rings) -> list[tuple[Point, Point]]:
    """The edges that begin at the rows of the table."""
    return [edge for ring in rings for edge in zip(ring, (*ring[1:], ring[0]), strict=True)]


def _inserted(rings: Rings, row: int, point: Point) -> Rings:
    rows = rows_of_rings(rings)
    rows.insert(row + 1, (rows[row][0], *point))
    return rings_of_rows(rows)


def without_vertex(rings: Rings, row: int) -> tuple[Rings, str]:
    """Without the vertex of one row of the table; further as :func:`without_lost`."""
    rows = rows_of_rings(rings)
    del rows[row]
    left = [tuple((x, y) for n, x, y in rows if n == k + 1) for k in range(len(rings))]
    return without_lost(rings, dict(enumerate(left)))


def without_lost(rings: Rings, left: Mapping[int, Ring]) -> tuple[Rings, str]:
    """Outlines with three vertices left, and a sentence about the others, if there are any.

    ``left`` of the outlines before, by their numbers from 0, none where one is gone altogether.
    What lies in an outline that goes would change from a hole to an aperture, or back: it goes too.
    """
    short = {k for k in range(len(rings)) if len(left.get(k, ())) < 3}
    gone = set(short)
    around = [_around(rings, k) for k in range(len(rings))] if short else []
    for k in sorted(range(len(around)), key=lambda k: len(around[k])):  # outer ones first
        if len(around[k] & gone) % 2:
            gone.add(k)
    kept = tuple(left[k] for k in range(len(rings)) if k not in gone)
    if not short:
        return kept, ""
    text = f"{_named(short)} had too few corners left, and went"
    if gone > short:
        text += f"; so did {_named(gone - short).lower()} in it, which would have changed sides"
    return kept, f"{text}. Undo brings back what went."


def _around(rings: Rings, k: int) -> set[int]:
    """Numbers of the outlines around one."""
    x, y = np.array(rings[k]).T
    others = (j for j in range(len(rings)) if j != k)
    return {j for j in others if shapely.contains_xy(shapely.Polygon(rings[j]), x, y).all()}


def _named(numbers: set[int]) -> str:
    return f"Outline{'s' * (len(numbers) > 1)} {', '.join(str(k + 1) for k in sorted(numbers))}"


# --- Sources


@lru_cache(maxsize=64)
def polygons_of(rings: Rings, per_metre: int) -> list[list[np.ndarray]]:
    """Polygons in metres, exteriors first, of outlines in units: those inside others are holes.

    Raises GeometryError for outlines that cross themselves or each other, with the place in units.
    """
    if not rings:
        raise GeometryError("expected an outline, got a blank sheet; draw one")
    try:
        polygons = nested([np.array(ring, dtype=np.float64).reshape(-1, 2) for ring in rings])
    except GeometryError as error:
        # outlines counted from 1, as the table does, and places with six digits
        text = re.sub(r"outline (\d+)", lambda found: f"outline {int(found[1]) + 1}", str(error))
        text = re.sub(r"-?\d+\.\d{6,}", lambda found: f"{float(found[0]):.6g}", text)
        raise GeometryError(without_advice(text)) from None
    return [[ring / per_metre for ring in polygon] for polygon in polygons]


@lru_cache(maxsize=64)
def aperture_of(rings: Rings, per_metre: int) -> pw.Aperture:
    """The aperture of outlines in units, in metres. Raises as :func:`polygons_of`."""
    polygons = polygons_of(rings, per_metre)
    return pw.Aperture([shapely.Polygon(rings[0], rings[1:]) for rings in polygons])


@lru_cache(maxsize=64)
def _source(
    rings: Rings, per_metre: int, feeding: tuple[tuple[str, str], ...], wavelength: float
) -> Source:
    source: Source = fed(aperture_of(rings, per_metre), dict(feeding), wavelength)
    if isinstance(source, pw.Array) and len(source) > MOST_ELEMENTS:
        raise ArgumentError(
            f"array: expected at most {MOST_ELEMENTS} elements in the page, got {len(source)}; use "
            "`polywigner transform` for such an array"
        )
    return source


def source_of(state: State) -> Source:
    """The aperture with its field, or the array of it.

    Raises PolywignerError for what is no polygon, or cannot be fed so.
    """
    return _source(state.rings, state.per_metre, feeding_of(state), state.wavelength)


def light_of(state: State) -> Source | pw.Wavefront:
    """The source, coherent over the chosen width.

    Raises ArgumentError for a width so small that a picture of W takes seconds.
    """
    source = source_of(state)
    if state.coherence == 0:
        return source
    width = state.metres(state.coherence)
    low, high = np.reshape(source.bounds, (2, 2))
    if not width >= _LEAST_COHERENCE * (high - low).max():
        raise ArgumentError(
            f"expected a width of coherence of at least a tenth of the source in the page, got "
            f"{state.coherence:g} {state.unit}; use polywigner.wigner for less"
        )
    return source.partially_coherent(width)


def feeding_of(state: State) -> tuple[tuple[str, str], ...]:
    """The texts of taper, array, window and steering that are not empty, by their names."""
    names = ("taper", "array", "window", "steering")
    return tuple((name, getattr(state, name)) for name in names if getattr(state, name).strip())
