"""Limits of files from elsewhere: size, counts, nesting, time and memory; one error for each."""

from __future__ import annotations

import json
import os
import re
import signal
import stat
import subprocess
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray

from polywigner.errors import FileFormatError
from polywigner.geometry.exact import Ring
from polywigner.geometry.io import library_process

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


_PLACE = re.compile(r"\bline (\d{1,9})(?:,? col(?:umn)? (\d{1,9}))?")
_NUMBER = re.compile(r"[-+.,;:\s0-9eE]{1,12}", re.ASCII)


def place_of(error: Exception) -> str:
    """ " in line 3, column 7" where the message of an error says so, else nothing."""
    found = _PLACE.search(str(error))
    if found is None:
        return ""
    return f" in line {found[1]}" + (f", column {found[2]}" if found[2] else "")


def token(text: str, known: tuple[str, ...] = ()) -> str:
    """A text as messages quote it: a short number, or a known word; of any other its length."""
    if text in known or _NUMBER.fullmatch(text):
        return repr(text)
    return f"{len(text)} characters of text" if text else "nothing"


def check_regular(path: Path) -> None:
    """Raise FileFormatError for anything but a file: missing, a directory, a device, a pipe."""
    try:
        mode = path.stat().st_mode
    except FileNotFoundError:
        raise FileFormatError("expected a file, got a path that does not exist") from None
    except (OSError, ValueError) as error:  # ValueError: a null character in the path
        raise FileFormatError(f"expected a readable file, got: {error}") from None
    _check_mode(mode)


def _check_mode(mode: int) -> None:
    if stat.S_ISDIR(mode):
        raise FileFormatError("expected a file, got a directory")
    if not stat.S_ISREG(mode):
        raise FileFormatError("expected a regular file, got a device or pipe")


def bytes_of(path: Path, largest: int = LARGEST_FILE) -> bytes:
    """The content of a regular file of sensible size.

    Raises FileFormatError for a missing, empty, unreadable or oversized file, a directory, a
    device and a pipe.
    """
    check_regular(path)
    try:
        # Should a pipe have taken the file's place meanwhile, opening it must not wait.
        flags = os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)
        with os.fdopen(os.open(path, flags), "rb") as file:
            found = os.fstat(file.fileno())
            _check_mode(found.st_mode)
            _check_size(found.st_size, largest)
            content = file.read(largest + 1)  # files of the system say a size of zero
    except (OSError, ValueError) as error:
        if isinstance(error, FileFormatError):
            raise
        raise FileFormatError(f"expected a readable file, got: {error}") from None
    _check_size(len(content), largest)
    if not content.strip():
        raise FileFormatError("expected content, got an empty file")
    return content


def _check_size(size: int, largest: int) -> None:
    if size > largest:
        raise FileFormatError(
            f"expected at most {largest >> 20} MiB, got {size / 2**20:.0f} MiB; "
            "simplify what it describes"
        )


def text_of(content: bytes) -> str:
    """The text, which must be UTF-8."""
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError:
        text = "\0"
    if "\0" in text:
        raise FileFormatError("expected text in UTF-8, got binary data; save it as text")
    if not text.strip():
        raise FileFormatError("expected content, got an empty file")
    return text


# Bounds the memory of one step.
_PAIRS_AT_ONCE = 4_000_000

Points = NDArray[np.float64]


class Work:
    """Budget of pairs that the shapes of one file may compare."""

    def __init__(self) -> None:
        self._edges = self._crossings = self._rings = self._vertices = 0

    def check_outlines(self, rings: Sequence[Ring]) -> None:
        """Raise for very many outlines upon or inside each other, which are compared in pairs."""
        if len(rings) < 2:
            return
        low = np.array([ring.min(axis=0) for ring in rings])
        high = np.array([ring.max(axis=0) for ring in rings])
        tree = shapely.STRtree(shapely.box(low[:, 0], low[:, 1], high[:, 0], high[:, 1]))
        sizes = np.array([len(ring) for ring in rings])
        for first, last in _steps(low, high):
            one, other = tree.query(tree.geometries[first:last])
            one += first
            later = one < other
            self._rings += int(later.sum())
            self._vertices += int(sizes[one[later]].sum() + sizes[other[later]].sum())
            if self._rings > MOST_NEAR_RINGS or self._vertices > MOST_NEAR_VERTICES:
                raise FileFormatError(
                    f"expected at most {MOST_NEAR_RINGS} pairs of outlines that are near or "
                    f"inside each other, and {MOST_NEAR_VERTICES} vertices of such pairs, got "
                    "more; use fewer"
                )

    def check_edges(self, rings: Sequence[Ring]) -> None:
        """Raise for outlines that cross themselves or each other in very many places, or nearly.

        Quick also where they do, while GEOS needs minutes to tell where 100 000 edges cross. What
        GEOS does grows with the pairs of edges whose bounding boxes meet, so these are counted.
        """
        start = np.concatenate(rings)
        end = np.concatenate([np.roll(ring, -1, axis=0) for ring in rings])
        tree = shapely.STRtree(shapely.linestrings(np.stack([start, end], axis=1)))
        for first, last in _steps(np.minimum(start, end), np.maximum(start, end)):
            one, other = tree.query(tree.geometries[first:last])
            one += first
            self._edges += int((one < other).sum())
            apart = (one < other) & ~(start[other] == end[one]).all(axis=1)
            apart &= ~(start[one] == end[other]).all(axis=1)
            one, other = one[apart], other[apart]
            self._crossings += _crossings(start[one], end[one], start[other], end[other])
            if self._edges > MOST_NEAR_EDGES:
                raise FileFormatError(
                    f"expected at most {MOST_NEAR_EDGES} pairs of edges near each other, got more; "
                    "simplify the outlines"
                )
            if self._crossings > MOST_CROSSINGS:
                raise FileFormatError(
                    f"expected outlines that cross in at most {MOST_CROSSINGS} places, got more; "
                    "simplify them"
                )


def check_polygons(polygons: Sequence[Sequence[Any]]) -> int:
    """The number of vertices of polygons, each a list of rings; raises for more work than is done.

    What is no ring is refused by those who make parts of them.
    """
    check_rings(sum(map(len, polygons)))
    vertices = sum(len(ring) for rings in polygons for ring in rings)
    check_vertices(vertices)
    try:
        arrays = [[np.asarray(ring, dtype=np.float64) for ring in rings] for rings in polygons]
    except (TypeError, ValueError):
        return vertices
    rings = [ring for part in arrays for ring in part]
    pairs = all(ring.ndim == 2 and ring.shape[1] == 2 and len(ring) for ring in rings)
    if pairs and np.isfinite(np.concatenate(rings)).all():
        work = Work()
        work.check_outlines([part[0] for part in arrays])
        work.check_edges(rings)
    return vertices


def _steps(low: Points, high: Points) -> Iterator[tuple[int, int]]:
    """Ranges of boxes (low and high corners (n, 2)) that meet few enough others for memory."""
    most = np.full(len(low), len(low))
    for k in range(2):  # those that meet along one axis are more than those that meet
        begun = np.searchsorted(np.sort(low[:, k]), high[:, k], side="right")
        ended = np.searchsorted(np.sort(high[:, k]), low[:, k], side="left")
        most = np.minimum(most, begun - ended)
    total = np.concatenate([[0], np.cumsum(most)])
    first = 0
    while first < len(low):
        last = int(np.searchsorted(total, total[first] + _PAIRS_AT_ONCE, side="right")) - 1
        last = min(max(last, first + 1), len(low))
        yield first, last
        first = last


def _crossings(a: Points, b: Points, c: Points, d: Points) -> int:
    """Number of segments a-b that cross c-d, up to rounding."""
    apart = _side(a, b, c) * _side(a, b, d) < 0
    a, b, c, d = a[apart], b[apart], c[apart], d[apart]
    return int((_side(c, d, a) * _side(c, d, b) < 0).sum())


def _side(a: Points, b: Points, c: Points) -> Points:
    along, across = (b - a).T, (c - a).T
    return np.sign(along[0] * across[1] - along[1] * across[0])


_SECONDS = 10
"""Of the processor; a machine that does other work may take as many times as long."""
_PATIENCE = 60
_OUT_OF_TIME = getattr(signal, "SIGXCPU", signal.SIGTERM)
_MEMORY = 1 << 30


def in_process(
    program: ModuleType, asked: dict[str, Any], kind: str, library: str, remedies: tuple[str, str]
) -> dict[str, Any]:
    """Return ``program.answer(asked)``, called in a process of its own.

    `remedies` end the messages about a file that takes too long, and about one that `library` does
    not read. Raises FileFormatError for these, and with the text of a LookupError of ``answer``.
    """
    slow, damaged = remedies
    command = [sys.executable, "-P", library_process.__file__]
    text = json.dumps(
        {"program": program.__file__, "memory": _MEMORY, "seconds": _SECONDS, **asked}
    )
    try:
        done = subprocess.run(
            command, input=text.encode(), capture_output=True, timeout=_PATIENCE, check=False
        )
        if -done.returncode in (_OUT_OF_TIME, getattr(signal, "SIGKILL", signal.SIGTERM)):
            raise subprocess.TimeoutExpired(command, _SECONDS)
        found = json.loads(done.stdout) if done.returncode == 0 else None
    except subprocess.TimeoutExpired:
        raise FileFormatError(
            f"expected {kind} that {library} reads within {_SECONDS} s, got a larger layout; {slow}"
        ) from None
    except (ValueError, OSError):
        found = None
    if not isinstance(found, dict):
        raise FileFormatError(
            f"expected {kind}, got a file that {library} does not read; {damaged}"
        )
    if "error" in found:
        raise FileFormatError(str(found["error"]))
    return found
