"""Scene files looked through before Mitsuba reads them, since scenes may come from strangers."""

from __future__ import annotations

import hashlib
import math
import re
import struct
import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from functools import lru_cache, partial
from pathlib import Path
from typing import Any, NamedTuple
from xml.parsers import expat

import mitsuba as mi
import numpy as np

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
    """SHA-256 of a scene file, of its includes, and of all files that it names."""
    with resolving(file) as resolve:
        files = check_scene_file(file, parameters, resolve)
    return {str(path): digest_of_file(path) for path in sorted(files)}


def digest_of_file(path: Path) -> str:
    with path.open("rb") as content:
        return hashlib.file_digest(content, "sha256").hexdigest()


def check_scene_file(
    file: Path, parameters: Mapping[str, Any], resolve: Callable[[str], Path]
) -> set[Path]:
    """Return the paths of a scene file, its includes and all files that it names, absolute."""
    seen = _SceneCheck({name: str(value) for name, value in parameters.items()}, resolve)
    try:
        seen.look_through(file, 0)
        seen.check_references()
        _check_loads(tuple(seen.loaded))
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
        self.loaded: list[_Loaded] = []
        """Meshes and OpenEXR pictures among them, which have to be loaded to be known."""
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
        """Check the file that a text of an object of some kind names, if it does."""
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
                self.loaded += _check_content(path, kind)
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
_LARGEST_MESH = 1 << 30
_LONGEST_HEADER = 1 << 20
_EXR = b"\x76\x2f\x31\x01"


# Of the processor, and of address space: 2^26 pixels of four floats take a gigabyte twice.
_DECODING, _DECODED = 20.0, 6 << 30


class _Loaded(NamedTuple):
    """A mesh of a kind, or a picture with none; size and time tell it from later ones."""

    path: str
    kind: str
    changed: int
    size: int


def _check_content(path: Path, kind: str) -> list[_Loaded]:
    """Refuse large pictures and meshes by their sizes; return what has to be loaded as well."""
    is_mesh = kind in ("ply", "serialized")
    found = path.stat()
    if is_mesh:
        check_bytes(found.st_size, _LARGEST_MESH, f"the mesh {path.name}")
    elif (pixels := _pixels(path)) > _MOST_PIXELS:
        raise FileFormatError(
            f"expected a picture of at most {_MOST_PIXELS} pixels, got {pixels} in {path.name}"
        )
    elif not _is_exr(path):
        return []
    kind = kind if is_mesh else ""
    return [_Loaded(str(path.resolve()), kind, found.st_mtime_ns, found.st_size)]


def _is_exr(path: Path) -> bool:
    with path.open("rb") as file:
        return file.read(4) == _EXR


def _check_loads(files: tuple[_Loaded, ...]) -> None:
    """Refuse meshes and OpenEXR pictures that end a process that loads them.

    Mitsuba itself does not look whether faces of meshes have corners among their vertices.
    """
    try:
        if files:
            _loaded_apart(files)
    except ChildError:
        if len(files) > 1:  # which one?
            half = len(files) // 2
            _check_loads(files[:half])
            _check_loads(files[half:])
            return
        path, kind, *_ = files[0]
        wanted = "mesh whose faces have corners among its vertices" if kind else "OpenEXR picture"
        raise FileFormatError(
            f"expected a whole {wanted}, got a bad one in {Path(path).name}"
        ) from None


@lru_cache(maxsize=256)
def _loaded_apart(files: tuple[_Loaded, ...]) -> None:
    """Load files in a process of its own."""
    seconds = _DECODING + sum(file.size for file in files) / 1e7
    run_apart(partial(_load, files), seconds, _DECODED, modules=[__name__])


def _load(files: tuple[_Loaded, ...]) -> None:
    from polywigner.mitsuba.films import threads_for_openexr

    variant = mi.variant()
    mi.set_variant("scalar_rgb")
    try:
        for file in files:
            if file.kind:
                _load_meshes(file.path, file.kind)
            else:
                with threads_for_openexr():
                    mi.Bitmap(file.path)
    finally:  # in processes that are limited themselves it is called where it is
        if variant is not None:
            mi.set_variant(variant)


def _load_meshes(path: str, kind: str) -> None:
    shapes: list[dict[str, int]] = [{}]
    if kind == "serialized":  # of several meshes, whose number is at the end
        (count,) = struct.unpack("<I", Path(path).read_bytes()[-4:])
        shapes = [{"shape_index": k} for k in range(count)]
    for shape in shapes:
        mesh = mi.load_dict({"type": kind, "filename": path, "face_normals": True, **shape})
        faces = np.array(mi.traverse(mesh)["faces"], np.int64)
        if faces.max(initial=0) >= max(mesh.vertex_count(), 1):
            raise ValueError


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
