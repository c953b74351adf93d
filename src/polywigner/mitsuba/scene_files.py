"""Scene files looked through before Mitsuba reads them: its parser ends the process on deep ones.

Mitsuba reads elements by recursion in C++, and opens pipes and devices that a scene names.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any
from xml.parsers import expat

import mitsuba as mi

from polywigner.errors import FileFormatError, SceneError
from polywigner.geometry.formats.limits import (
    LARGEST_SCENE,
    MOST_NESTED,
    MOST_SCENE_ELEMENTS,
    bytes_of,
    check_regular,
)

__all__ = ["check_scene_file", "digest_of_file", "digests_of", "resolving"]

# Scenes that include scenes; Mitsuba's own limit.
_DEEPEST_INCLUDE = 15


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
    """SHA-256 of a scene file, of those that it includes, and of all others that it names.

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
    """The scene file itself, those that it includes, and all others that it names, absolute.

    Raises SceneError for a scene, or one that it includes, that must not reach Mitsuba.
    `resolve` finds the files that it names; `parameters` are values of its ``$parameters``.
    """
    seen = _Seen({name: str(value) for name, value in parameters.items()}, resolve)
    try:
        seen.look_through(file, 0)
    except FileFormatError as error:
        raise SceneError(f"{file}: {error}") from None
    return seen.files | seen.named


class _Seen:
    """The scenes and elements that were looked through."""

    def __init__(self, values: dict[str, str], resolve: Callable[[str], Path]) -> None:
        self.values = values
        self.resolve = resolve
        self.files: set[Path] = set()
        self.named: set[Path] = set()
        self.elements = 0

    def look_through(self, file: Path, level: int) -> None:
        if level > _DEEPEST_INCLUDE:
            raise FileFormatError(f"expected scenes included {_DEEPEST_INCLUDE} deep, got more")
        self.files.add(file.resolve())
        depth = 0
        included: list[str] = []

        def start(tag: str, attributes: dict[str, str]) -> None:
            nonlocal depth
            depth += 1
            self.elements += 1
            _check("elements in each other", depth, MOST_NESTED)
            _check("elements", self.elements, MOST_SCENE_ELEMENTS)
            name = self._filled(attributes.get("filename", ""))
            if tag == "default":
                self.values.setdefault(attributes.get("name", ""), attributes.get("value", ""))
            elif tag == "include" and name:
                included.append(name)
            elif attributes.get("name") == "filename":
                self._check_file(self._filled(attributes.get("value", "")))
            if tag == "string":
                self._note_file(self._filled(attributes.get("value", "")))

        def end(tag: str) -> None:
            nonlocal depth
            depth -= 1

        parser = expat.ParserCreate()
        parser.StartElementHandler, parser.EndElementHandler = start, end
        parser.StartDoctypeDeclHandler = _refuse_declarations
        try:
            parser.Parse(bytes_of(file, LARGEST_SCENE), True)
        except expat.ExpatError as error:
            raise FileFormatError(
                f"expected a Mitsuba scene, got text that is not XML in line {error.lineno}, "
                f"column {error.offset}; correct it there"
            ) from None
        for name in included:
            path = self.resolve(name)
            if path.resolve() not in self.files and path.exists():
                self.look_through(path, level + 1)

    def _filled(self, text: str) -> str:
        for name in sorted(self.values, key=len, reverse=True) if "$" in text else ():
            text = text.replace(f"${name}", self.values[name])
        return text

    def _check_file(self, name: str) -> None:
        path = self.resolve(name)
        if name and path.exists() and not path.is_dir():
            check_regular(path)

    def _note_file(self, name: str) -> None:
        """Of texts that are no names of files, the system may refuse some: too long, for one."""
        with suppress(OSError, ValueError, RuntimeError):
            path = self.resolve(name)
            if name and path.is_file():
                self.named.add(path.resolve())


def _check(what: str, count: int, most: int) -> None:
    if count > most:
        raise FileFormatError(f"expected a scene of at most {most} {what}, got more; simplify it")


def _refuse_declarations(name: str, system: Any, public: Any, has_declarations: int) -> None:
    if has_declarations:
        raise FileFormatError("expected a scene without declarations of its own, got a DTD")
