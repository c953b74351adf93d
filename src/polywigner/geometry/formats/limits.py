"""What is read at most: files may come from strangers.

A file within these limits is read or refused within some 10 s and 1 GiB on a machine of two cores
(docs/files.md). Counts are taken while a file is parsed, before anything is made from them.
"""

from __future__ import annotations

from polywigner.errors import FileFormatError

__all__ = [
    "DEEPEST_WKT",
    "LARGEST_DXF",
    "LARGEST_FILE",
    "LARGEST_GDS",
    "LARGEST_GERBER",
    "LARGEST_NUMBER",
    "LARGEST_PART",
    "LARGEST_SCENE",
    "LARGEST_TOML",
    "LONGEST_LINE",
    "MOST_COMBINED",
    "MOST_CROSSINGS",
    "MOST_CURVES",
    "MOST_ELEMENTS",
    "MOST_FACES",
    "MOST_JSON_VALUES",
    "MOST_LINES",
    "MOST_LISTED",
    "MOST_NEAR_EDGES",
    "MOST_NEAR_RINGS",
    "MOST_NEAR_VERTICES",
    "MOST_NESTED",
    "MOST_NESTED_BLOCKS",
    "MOST_RINGS",
    "MOST_RULES",
    "MOST_SCENE_ELEMENTS",
    "MOST_SOLIDS",
    "MOST_TEXT",
    "MOST_TRANSFORMS",
    "MOST_VERTICES",
    "MOST_WAVES",
    "check_number",
    "check_rings",
    "check_values",
    "check_vertices",
]

# Files, in bytes.

LARGEST_FILE = 64 * 2**20
"""Any file; an outline of a million vertices takes about 40 MB as text."""

LARGEST_DXF = 4 * 2**20
"""DXF, of which ezdxf makes forty times as much in memory, in up to 10 s."""

LARGEST_GDS = 16 * 2**20
"""GDSII; 16 MiB hold some 250 000 rectangles."""

LARGEST_GERBER = 4 * 2**20
"""Gerber, which gerbonara reads in Python; 4 MiB hold some 200 000 strokes."""

LARGEST_TOML = 8 * 2**20
"""TOML, which Python parses in Python, 1 MiB in up to a second. JSON is for larger files."""

LARGEST_SCENE = 8 * 2**20
"""Mitsuba XML; meshes and textures stand in files of their own."""

# Text.

LONGEST_LINE = 2**16
"""Characters in a line of a table: a line is in memory as its columns."""

MOST_JSON_VALUES = 6_000_000
"""Commas in JSON: three for each of a million positions, and as much again for properties."""

DEEPEST_WKT = 32
"""Brackets in each other; GEOS reads them by recursion in C++, where too deep ends the process."""

MOST_TEXT = 16 * 2**20
"""Characters in the attributes of SVG elements, what `use` repeats counted each time, and in one
element."""

# Outlines.

MOST_VERTICES = 1_000_000
"""Vertices of one aperture; a valid ring of that many takes about 10 s."""

MOST_RINGS = 10_000
"""Outlines of one aperture; so many rectangles take about 6 s."""

MOST_CROSSINGS = 20_000
"""Places where outlines cross: twice as many faces, some 0.1 ms each."""

MOST_NEAR_EDGES = 10_000_000
"""Pairs of edges whose bounding boxes meet: 0.3 us each to count, and for GEOS to compare them."""

MOST_NEAR_RINGS = 2_000_000
"""Pairs of outlines whose bounds overlap, as those of 2000 rings inside each other: 3 us each."""

MOST_NEAR_VERTICES = 200_000_000
"""Vertices of such pairs, which GEOS intersects where they touch: 20 ns each."""

LARGEST_NUMBER = 1e100
"""Coordinates beyond it are refused before anything is computed from them."""

# Drawings.

MOST_CURVES = 100_000
"""Lines and curves of a drawing, those of repeated parts counted each time."""

MOST_ELEMENTS = 50_000
"""Elements of an SVG file, and elements drawn (what `use` repeats counts each time)."""

MOST_NESTED = 64
"""Elements of XML inside each other, `use` included."""

MOST_TRANSFORMS = 100_000
"""Functions in the transforms of SVG elements, repetitions included."""

MOST_RULES = 1000
"""Rules of the style sheets of an SVG file."""

MOST_NESTED_BLOCKS = 16
"""DXF blocks inserted in blocks."""

MOST_COMBINED = 400_000
"""Vertices that the large unions and all cuts of a Gerber file handle together, some 10 s."""

# Bodies.

MOST_FACES = 200_000
"""Triangles of a body; checking so many takes about 10 s."""

MOST_SOLIDS = 1000
"""Solids of an STL file, of each of which trimesh makes a mesh."""

MOST_LINES = 2_000_000
"""Vertices, normals, faces and the rest of OBJ, and rows of PLY."""

# Scenes and source files.

MOST_SCENE_ELEMENTS = 200_000
"""Elements of a Mitsuba scene, with those of scenes that it includes."""

MOST_LISTED = 10_000
"""Elements that an array lists one by one; a millisecond each. A lattice counts as one."""

LARGEST_PART = 4096
"""Vertices, segments and so on of a shape by name: a slip of the keyboard must not fill memory."""

MOST_WAVES = 1_000_000
"""Plane waves of all fields of a file, products of tapers counted before they are multiplied."""


def check_values(text: str) -> None:
    """Raise for JSON of more values than are read."""
    count = text.count(",")
    if count > MOST_JSON_VALUES:
        raise FileFormatError(
            f"expected JSON of at most {MOST_JSON_VALUES} values, got {count}; simplify it"
        )


def check_vertices(count: int) -> None:
    """Raise where a file has more vertices than are read."""
    if count > MOST_VERTICES:
        raise FileFormatError(
            f"expected at most {MOST_VERTICES} vertices, got {count}; simplify the outline"
        )


def check_rings(count: int) -> None:
    """Raise where a file has more outlines than are read."""
    if count > MOST_RINGS:
        raise FileFormatError(
            f"expected at most {MOST_RINGS} outlines, got {count}; use fewer, such as one element "
            "of an array"
        )


def check_number(count: int) -> None:
    """Raise where a drawing has more lines and curves than are followed."""
    if count > MOST_CURVES:
        raise FileFormatError(
            f"expected at most {MOST_CURVES} lines and curves (repetitions included), got more; "
            "simplify the drawing"
        )
