"""Scene files looked through before Mitsuba reads them, since scenes may come from strangers.

Mitsuba reads elements by recursion in C++, loads plugins from a folder beside the scene, opens the
pipes and devices that a scene names, and decodes pictures of any size: docs/promises.md.
"""

from __future__ import annotations

import hashlib
import math
import re
import struct
import warnings
import zlib
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from functools import lru_cache, partial
from pathlib import Path
from typing import Any
from xml.parsers import expat

import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from polywigner.apart import ChildError, run_apart
from polywigner.errors import FileFormatError, SceneError
from polywigner.geometry.io.limits import (
    LARGEST_SCENE,
    MOST_NESTED,
    MOST_SCENE_ELEMENTS,
    bytes_of,
    check_bytes,
    check_regular,
)

# Scenes that include scenes; Mitsuba's own limit. In all: eight files of eight includes are 8^8.
_DEEPEST_INCLUDE, _MOST_INCLUDED = 15, 256
# Objects in each other: Mitsuba goes 2^n times through n that hold one another.
_BY_REFERENCES = "objects that hold each other by references"
_MOST_NESTED_OBJECTS, _DEEPEST_REFS, _MOST_REFERRED = 16, 64, 1 << 24
# Values of $parameters are texts such as a power; a default may hold others eight times.
_MOST_DEFAULTS, _LONGEST_VALUE = 1000, 1 << 14
_PLUGIN = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")
_LIBRARIES = (".so", ".dylib", ".dll")
# Takes addresses in the memory of the process from the scene.
_BY_ADDRESS = "blender"
_OWN_PLUGINS = Path(mi.__file__).parent / "plugins"


@contextmanager
def resolving(file: Path) -> Iterator[Callable[[str], Path]]:
    """Within, Mitsuba finds files that are named relative to this one; so does the function."""
    outer = mi.file_resolver()
    inner = mi.FileResolver(outer)
    inner.prepend(str(file.resolve().parent))
    mi.set_file_resolver(inner)
    try:
        yield lambda name: Path(str(inner.resolve(name)))
    finally:
        mi.set_file_resolver(outer)


def digests_of(file: Path, parameters: Mapping[str, Any]) -> dict[str, str]:
    """SHA-256 of a scene file, of its includes, and of all files that it names.

    By absolute path. Raises SceneError as :func:`check_scene_file` does.
    """
    with resolving(file) as resolve:
        files = check_scene_file(file, parameters, resolve)
    return {str(path): digest_of_file(path) for path in sorted(files)}


def digest_of_file(path: Path) -> str:
    with path.open("rb") as content:
        return hashlib.file_digest(content, "sha256").hexdigest()


def check_scene_file(
    file: Path, parameters: Mapping[str, Any], resolve: Callable[[str], Path]
) -> set[Path]:
    """Return the paths of a scene file, its includes and all files that it names, absolute.

    Raises SceneError for a scene, or one that it includes, that must not reach Mitsuba.
    `resolve` finds the files that it names; `parameters` are values of its ``$parameters``.
    """
    seen = _SceneCheck({name: str(value) for name, value in parameters.items()}, resolve)
    try:
        seen.look_through(file, 0)
        seen.check_references()
    except FileFormatError as error:
        raise SceneError(f"{file}: {error}") from None
    return seen.files | seen.named.keys()


class _SceneCheck:
    """The scenes and elements that were looked through."""

    def __init__(self, values: dict[str, str], resolve: Callable[[str], Path]) -> None:
        self.values = values
        self.resolve = resolve
        self.files: set[Path] = set()
        self.named: dict[Path, set[str]] = {}
        """Files that are named, and kinds of objects that do."""
        self.known: set[str | tuple[str, str]] = set()
        """Types, and texts with kinds of objects, that are checked: the disk is asked once."""
        self.elements = self.included = self.size = 0
        self.objects: list[tuple[str, str] | None] = []
        """Type and id of the elements around, None of others than objects."""
        self.held: dict[str, list[str]] = {}
        """Ids in each object that has one, below others' or as references."""

    def look_through(self, file: Path, level: int) -> None:
        _check("scenes included in each other", level, _DEEPEST_INCLUDE)
        self.included += 1
        _check("scenes included, repetitions counted", self.included, _MOST_INCLUDED)
        self.files.add(file.resolve())
        content = bytes_of(file, LARGEST_SCENE)
        self._grow(len(content))

        def start(tag: str, attributes: dict[str, str]) -> None:
            filled = {name: self._filled(text) for name, text in attributes.items()}
            self._enter(tag, filled)
            if tag == "include" and filled.get("filename"):
                path = self.resolve(filled["filename"])
                if path.exists():  # where it stands: its defaults hold from there on
                    self.look_through(path, level + 1)

        def end(tag: str) -> None:
            self.objects.pop()

        parser = expat.ParserCreate()
        parser.StartElementHandler, parser.EndElementHandler = start, end
        parser.StartDoctypeDeclHandler = _refuse_declarations
        try:
            parser.Parse(content, True)
        except expat.ExpatError as error:
            raise FileFormatError(
                f"expected a Mitsuba scene, got text that is not XML in line {error.lineno}, "
                f"column {error.offset}; correct it there"
            ) from None
        except LookupError as error:
            raise FileFormatError(f"expected a scene in UTF-8, got an {error}") from None

    def _enter(self, tag: str, filled: dict[str, str]) -> None:
        """Count an element, and check its type and the files that it names."""
        kind = filled.get("type")
        self.objects.append(None if kind is None else (kind, filled.get("id", "")))
        self.elements += 1
        around = [own for own in self.objects if own is not None]
        _check("elements in each other", len(self.objects), MOST_NESTED)
        _check("objects in each other", len(around), _MOST_NESTED_OBJECTS)
        _check("elements", self.elements, MOST_SCENE_ELEMENTS)
        if kind is not None:
            self._check_type(kind)
        if tag == "path":
            raise FileFormatError(
                "expected a scene that names files relative to its own folder, got a search path "
                "of its own; leave the <path> out"
            )
        if tag == "default":
            self._define(filled.get("name", ""), filled.get("value", ""))
        own = filled.get("id", "")
        outer = around[:-1] if kind is not None else around
        for _, name in outer if own and (kind is not None or tag == "ref") else ():
            self.held.setdefault(name, []).append(own)
        for text in (filled.get("filename"), filled.get("value")):
            self._note_file(text, around[-1][0] if around else "")

    def check_references(self) -> None:
        """Refuse chains of objects that hold each other by their ids, and trees of them."""
        sizes: dict[str, tuple[int, int]] = {}
        for first in self.held:
            waiting = [first]
            while waiting:
                name = waiting[-1]
                missing = [own for own in self.held.get(name, ()) if own not in sizes]
                if name in sizes or not missing:
                    found = [sizes[own] for own in self.held.get(name, ())]
                    size = 1 + sum(count for count, _ in found)
                    depth = 1 + max((depth for _, depth in found), default=0)
                    if name:
                        _check(_BY_REFERENCES, depth, _DEEPEST_REFS)
                        _check("objects, references counted", size, _MOST_REFERRED)
                    sizes[name] = (size, depth) if name else (0, 0)
                    waiting.pop()
                    continue
                _check(_BY_REFERENCES, len(waiting), _DEEPEST_REFS + 1)  # also in a circle
                waiting.append(missing[0])

    def _filled(self, text: str) -> str:
        """The text with the values of its ``$parameters``, in Mitsuba's way."""
        for name in sorted(self.values, key=len, reverse=True) if "$" in text else ():
            value = self.values[name]
            length = len(text) + text.count(f"${name}") * len(value)
            _check("characters in a value, $parameters filled in", length, _LONGEST_VALUE)
            self._grow(length - len(text))
            text = text.replace(f"${name}", value)
        return text

    def _grow(self, size: int) -> None:
        self.size += max(0, size)
        check_bytes(self.size, LARGEST_SCENE, "scenes, with includes and $parameters filled in")

    def _define(self, name: str, value: str) -> None:
        self.values.setdefault(name, value)
        _check("$parameters", len(self.values), _MOST_DEFAULTS)

    def _check_type(self, name: str) -> None:
        """Refuse types that make Mitsuba load a library from anywhere but its own folder."""
        if name in self.known:
            return
        found = [self.resolve(f"plugins/{name}{suffix}") for suffix in _LIBRARIES]
        foreign = [p for p in found if p.exists() and p.resolve().parent != _OWN_PLUGINS.resolve()]
        if name == _BY_ADDRESS:
            raise FileFormatError(f"expected meshes of files, got one of type {name}; use PLY")
        if foreign or not _PLUGIN.fullmatch(name):
            raise FileFormatError(
                f"expected types that Mitsuba or polywigner bring, got {name[:60]!r}; a scene must "
                "not bring libraries of its own"
            )
        self.known.add(name)

    def _note_file(self, text: str | None, kind: str) -> None:
        """Check the file that a text of an object of some kind names, if it does.

        Of texts that are no names of files, the system may refuse some: too long, for one.
        """
        if not text or (text, kind) in self.known:
            return
        self.known.add((text, kind))
        path = None
        with suppress(OSError, ValueError, RuntimeError):
            found = self.resolve(text)
            path = found if found.exists() and not found.is_dir() else None
        if path is not None and kind not in self.named.setdefault(path.resolve(), set()):
            check_regular(path)
            try:
                _check_content(path, kind)
            except OSError as error:
                raise FileFormatError(
                    f"expected a readable file, got {path.name}: {error.strerror or error}"
                ) from None
            self.named[path.resolve()].add(kind)


def _check(what: str, count: int, most: int) -> None:
    if count > most:
        raise FileFormatError(f"expected a scene of at most {most} {what}, got more; simplify it")


def _refuse_declarations(name: str, system: Any, public: Any, has_declarations: int) -> None:
    if has_declarations:
        raise FileFormatError("expected a scene without declarations of its own, got a DTD")


# ---- meshes and pictures: sizes and corners as they announce them --------------------------------

_MOST_PIXELS = 1 << 26  # a gigabyte as four floats each
_LARGEST_MESH, _MOST_CORNERS, _MOST_MESHES = 1 << 30, 1 << 28, 1000
_LONGEST_HEADER = 1 << 20
_EXR = b"\x76\x2f\x31\x01"
_PLY_NUMBERS = {
    "char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4",
    "float": "f4", "double": "f8", "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2",
    "int32": "i4", "uint32": "u4", "float32": "f4", "float64": "f8",
}  # fmt: skip


def _check_content(path: Path, kind: str) -> None:
    """Refuse pictures that are too large, and meshes whose faces have corners not among theirs."""
    if kind in ("ply", "serialized"):
        content = bytes_of(path, _LARGEST_MESH)
        for corners, count in [_ply(content)] if kind == "ply" else _serialized(content):
            least, most = (int(f(initial=0)) for f in (corners.min, corners.max))
            if least < 0 or (corners.size and most >= count):
                raise FileFormatError(
                    f"expected corners of faces among the {count} vertices of {path.name}, got "
                    f"number {least if least < 0 else most}"
                )
    else:
        pixels = _pixels(path)
        if pixels > _MOST_PIXELS:
            raise FileFormatError(
                f"expected a picture of at most {_MOST_PIXELS} pixels, got {pixels} in {path.name}"
            )
        _check_decodes(path)


_CORNERS = ("vertex_indices", "vertex_index")
Property = list[str]
"""Type and name of a PLY element's property; or "list", types of length and entries, and name."""


def _ply(content: bytes) -> tuple[NDArray[Any], int]:
    """The numbers of all corners of faces, and the number of vertices."""
    end = re.search(rb"(?:^|\n)end_header[ \t\r]*\n", content[:_LONGEST_HEADER])
    head = content[: end.start() if end else 0].decode("ascii", "replace")
    lines = [line.split() for line in head.split("\n")]
    if end is None or lines[0] != ["ply"]:
        raise FileFormatError("expected a PLY mesh, got a file without its header")
    body = content[end.end() :]
    form = next((line[1] for line in lines if line[:1] == ["format"] and len(line) > 1), "")
    elements: list[tuple[str, int, list[Property]]] = []
    for line in lines:
        if line[:1] == ["element"] and len(line) == 3 and line[2].isdecimal():
            elements.append((line[1], int(line[2]), []))
        elif line[:1] == ["property"] and elements:
            elements[-1][2].append(line[1:])
    count = next((n for name, n, _ in elements if name == "vertex"), 0)
    _check_announced(body, form, elements)
    number = next((k for k, (name, _, _) in enumerate(elements) if name == "face"), None)
    if number is None or not elements[number][1]:
        return np.empty(0, np.int64), count
    before, (_, total, properties) = elements[:number], elements[number]
    if any(own[0] == "list" for _, _, others in before for own in others):
        raise FileFormatError("expected a PLY mesh whose faces come before other lists")
    try:
        if form == "ascii":
            rows = [line for line in body.splitlines() if line.strip()]
            return _of_text(rows[sum(n for _, n, _ in before) :][:total], properties), count
        order = {"binary_little_endian": "<", "binary_big_endian": ">"}[form]
        sizes = (n * sum(_number(own[0]).itemsize for own in others) for _, n, others in before)
        return _of_bytes(body[sum(sizes) :], order, properties, total), count
    except (ValueError, KeyError, IndexError, OverflowError):
        raise FileFormatError("expected a whole PLY mesh, got one that ends early") from None


def _check_announced(
    body: bytes, form: str, elements: list[tuple[str, int, list[Property]]]
) -> None:
    """Refuse more vertices, faces and the like than the file holds: room is made for all first."""
    if form == "ascii":
        least = 2 * sum(n for _, n, _ in elements)  # a digit and the end of the line
    else:
        own = {"list": 1, **{name: np.dtype(kind).itemsize for name, kind in _PLY_NUMBERS.items()}}
        least = sum(n * sum(own.get(p[0], 1) for p in others) for _, n, others in elements)
    if least > len(body) + 1:
        raise FileFormatError("expected a whole PLY mesh, got one that ends early")


def _number(name: str, order: str = "<") -> np.dtype[Any]:
    return np.dtype(order + _PLY_NUMBERS[name])


def _of_text(rows: list[bytes], properties: list[Property]) -> NDArray[Any]:
    """Corners of faces from lines of text, one for each face."""
    found = []
    for row in rows:
        words, place = row.split(), 0
        for own in properties:
            length = int(words[place]) if own[0] == "list" else 0
            if own[-1] in _CORNERS:
                found += [int(word) for word in words[place + 1 : place + 1 + length]]
            place += 1 + length
        if place > len(words):
            raise ValueError
    return np.array(found, dtype=np.int64)


def _of_bytes(body: bytes, order: str, properties: list[Property], total: int) -> NDArray[Any]:
    """Corners of faces from bytes: most meshes have triangles alone, or rectangles."""
    others = [own for own in properties if own[0] == "list" and own[-1] not in _CORNERS]
    for length in (3, 4) if not others else ():
        fields: list[Any] = []
        for k, own in enumerate(properties):
            if own[0] == "list":
                fields.append(("length", _number(own[1], order)))
                fields.append(("corners", _number(own[2], order), (length,)))
            else:
                fields.append((f"other {k}", _number(own[0], order)))
        row = np.dtype(fields)
        if row.names and "corners" in row.names and row["corners"].base.kind == "f":
            raise ValueError
        if "corners" in (row.names or ()) and len(body) >= row.itemsize * total:
            table = np.frombuffer(body, row, total)
            if (table["length"] == length).all():
                return np.asarray(table["corners"]).ravel()
    if total > len(body):  # an entry takes a byte at least
        raise ValueError
    found, place = [np.empty(0, np.int64)], 0
    for _ in range(total):
        for own in properties:
            if own[0] != "list":
                place += _number(own[0]).itemsize
                continue
            counts, entries = (_number(name, order) for name in own[1:3])
            length = int(np.frombuffer(body, counts, 1, place)[0])
            place += counts.itemsize
            if length < 0 or counts.kind == "f" or (own[-1] in _CORNERS and entries.kind == "f"):
                raise ValueError
            values = np.frombuffer(body, entries, length, place)
            place += entries.itemsize * length
            if own[-1] in _CORNERS:
                found.append(values.astype(np.int64))
    return np.concatenate(found)


def _serialized(content: bytes) -> list[tuple[NDArray[Any], int]]:
    """The corners of faces and the number of vertices of all meshes in Mitsuba's own format."""
    refused = FileFormatError("expected a mesh in Mitsuba's format, got another file; use PLY")
    try:
        mark, version = struct.unpack_from("<HH", content)
        (meshes,) = struct.unpack_from("<I", content, len(content) - 4)
        if mark != 0x041C or version not in (3, 4) or not 0 < meshes <= _MOST_MESHES:
            raise refused
        kind, size = ("<Q", 8) if version == 4 else ("<I", 4)
        end = len(content) - 4 - meshes * size
        places = [struct.unpack_from(kind, content, end + k * size)[0] for k in range(meshes)]
        return [_one_serialized(content[place:end], version) for place in places]
    except (struct.error, ValueError, IndexError, zlib.error):
        raise refused from None


def _one_serialized(content: bytes, version: int) -> tuple[NDArray[Any], int]:
    """Corners and vertices of one mesh, unpacked as far as it announces."""
    stream = zlib.decompressobj()
    body = stream.decompress(content[4:], _LONGEST_HEADER)
    (flags,) = struct.unpack_from("<I", body)
    place = 4 + (body.index(b"\0", 4) - 3 if version == 4 else 0)
    count, faces = struct.unpack_from("<QQ", body, place)
    numbers = 3 + 3 * bool(flags & 0x1) + 2 * bool(flags & 0x2) + 3 * bool(flags & 0x8)
    start = place + 16 + count * numbers * (8 if flags & 0x2000 else 4)
    needed = start + 12 * faces
    if faces > _MOST_CORNERS or needed > _LARGEST_MESH:
        raise ValueError
    if needed > len(body):
        body += stream.decompress(stream.unconsumed_tail, needed - len(body))
    return np.frombuffer(body, "<u4", 3 * faces, start), count  # fewer than 2^32 vertices


# Of the processor, and of address space: 2^26 pixels of four floats take a gigabyte twice.
_DECODING, _DECODED = 20.0, 6 << 30


def _check_decodes(path: Path) -> None:
    """Refuse an OpenEXR picture that ends a process in which Mitsuba decodes it."""
    with path.open("rb") as file:
        if file.read(4) != _EXR:
            return
    try:
        found = path.stat()
        _decoded_apart(str(path.resolve()), found.st_mtime_ns, found.st_size)
    except ChildError:
        raise FileFormatError(
            f"expected a whole OpenEXR picture, got a damaged one in {path.name}"
        ) from None


@lru_cache(maxsize=256)
def _decoded_apart(path: str, changed: int, size: int) -> None:
    """Decode a picture in a process of its own; `changed` and `size` tell it from later ones."""
    run_apart(partial(_decode, path), _DECODING, _DECODED)


def _decode(path: str) -> None:
    from polywigner.mitsuba.films import threads_for_openexr

    mi.set_variant("scalar_rgb")
    with threads_for_openexr():
        mi.Bitmap(path)


def _pixels(path: Path) -> int:
    """The pixels that a picture announces; 0 for other files."""
    from PIL import Image

    with path.open("rb") as file:
        head = file.read(1 << 12)
    if head[:8] == b"\x89PNG\r\n\x1a\n":
        return math.prod(struct.unpack_from(">2I", head.ljust(24, b"\0"), 16))
    if head[:4] == _EXR:
        return _pixels_of_exr(path)
    if sizes := re.match(rb"P[Ff]\s+(\d{1,12})\s+(\d{1,12})\s|VOL", head):
        if sizes[1] is not None:
            return int(sizes[1]) * int(sizes[2])
        return math.prod(struct.unpack_from("<4I", head.ljust(24, b"\0"), 8))  # with channels
    if sizes := re.search(rb"\A#\?.*?\n[-+]Y (\d{1,12}) [-+]X (\d{1,12})\n", head, re.DOTALL):
        return int(sizes[1]) * int(sizes[2])
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # it has an opinion of its own, of larger ones
            with Image.open(path) as picture:
                return math.prod(picture.size)
    except Image.DecompressionBombError:
        return _MOST_PIXELS + 1
    except (OSError, ValueError, SyntaxError):
        return 0  # no picture


def _pixels_of_exr(path: Path) -> int:
    """The pixels of the data window of an OpenEXR picture, of the largest of several parts."""
    with path.open("rb") as file:
        head = file.read(_LONGEST_HEADER)
    place, largest = 8, 0
    while (name_end := head.find(b"\0", place)) > place:
        kind_end = head.find(b"\0", name_end + 1)
        if kind_end < 0 or kind_end + 5 > len(head):
            break
        (size,) = struct.unpack_from("<I", head, kind_end + 1)
        value = head[kind_end + 5 : kind_end + 5 + size]
        if head[place:name_end] == b"dataWindow" and len(value) == 16:
            x0, y0, x1, y1 = struct.unpack("<4i", value)
            largest = max(largest, max(0, x1 - x0 + 1) * max(0, y1 - y0 + 1))
        place = kind_end + 5 + size
        if place < len(head) and not head[place]:  # the end of a part
            place += 1
    if not largest:
        raise FileFormatError(f"expected an OpenEXR picture with its size, got none in {path.name}")
    return largest
