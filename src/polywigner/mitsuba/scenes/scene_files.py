"""Scene files: the XML, the plugin types and the named files are checked before Mitsuba loads them.

A scene may come from elsewhere, so it may use only known plugin types and only files below its own
folder: docs/safety.md. Mitsuba itself reads meshes and images, and reports damaged ones.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element, ParseError

import mitsuba as mi
from defusedxml.common import DefusedXmlException
from defusedxml.ElementTree import fromstring

from polywigner.errors import FileFormatError, SceneError
from polywigner.geometry.io.limits import (
    LARGEST_SCENE,
    bytes_of,
    check_bytes,
    check_regular,
    text_of,
)

_MITSUBA = Path(mi.__file__).parent
# The plugin "blender" reads memory at addresses that the scene contains.
_REFUSED = frozenset({"blender"})
# Integrators in Python, whose types Mitsuba's plugin manager does not report.
_INTEGRATORS = frozenset(
    {
        *("direct_projective", "prb", "prb_basic", "prb_projective", "prbvolpath"),
        *("volprim_rf_basic", "transient_path", "transient_prbvolpath", "transient_nlos_path"),
    }
)
# Bytes of a mesh or image that a scene names.
_LARGEST_NAMED = 1 << 30
_DEEPEST_INCLUDE = 15


@contextmanager
def resolving(file: Path) -> Iterator[None]:
    """Resolve relative file names from the folder of `file` while the block runs.

    Mitsuba loads libraries from a subfolder "plugins" of any of these folders, also those that a
    scene uses by default. Its own folder comes first, so that no library next to a scene is loaded.
    """
    outer = mi.file_resolver()
    inner = mi.FileResolver(outer)
    inner.prepend(str(file.resolve().parent))
    inner.prepend(str(_MITSUBA))
    mi.set_file_resolver(inner)
    try:
        yield
    finally:
        mi.set_file_resolver(outer)


def digests_of(file: Path, parameters: Mapping[str, Any]) -> dict[str, str]:
    """Return SHA-256 digests, by absolute path, of a scene file and all files that it uses.

    Raises SceneError as :func:`parse_scene_file` does.
    """
    with resolving(file):
        _, paths = parse_scene_file(mi.parser.ParserConfig(mi.variant()), file, parameters)
    return {str(path): digest_of_file(path) for path in sorted(paths)}


def digest_of_file(path: Path) -> str:
    """Return the SHA-256 digest of a file."""
    with path.open("rb") as content:
        return hashlib.file_digest(content, "sha256").hexdigest()


def parse_scene_file(
    config: Any, file: Path, parameters: Mapping[str, Any]
) -> tuple[mi.parser.ParserState, set[Path]]:
    """Parse a scene file that contains only permitted plugin types and files.

    Call it within :func:`resolving`.

    Parameters
    ----------
    config : ``mi.parser.ParserConfig``.
    file : Mitsuba XML.
    parameters : values of its ``$parameters``. Files and folders that they name are permitted.

    Returns
    -------
    The ``mi.parser.ParserState``, and the absolute paths of the scene file, its includes and the
    files that they name.

    Raises
    ------
    SceneError for a scene that is not permitted; Mitsuba's own errors.
    """
    texts = {name: str(value) for name, value in parameters.items()}
    checked = _CheckedFiles(file, texts)
    try:
        checked.add_xml(file)
        state = mi.parser.parse_file(config, str(file), **texts)
        for name in sorted({node.props.plugin_name() for node in state.nodes}):
            _check_type(name)
        for text in sorted({text for node in state.nodes for text in _texts_in(node.props)}):
            checked.add(text)
    except FileFormatError as error:
        raise SceneError(f"{file}: {error}") from None
    return state, checked.paths


def _check_type(name: str) -> None:
    if name in _REFUSED or not (name in _INTEGRATORS or _is_known(name)):
        raise FileFormatError(
            f"expected plugin types of Mitsuba or polywigner, got {name[:60]!r}; correct the type"
        )


def _is_known(name: str) -> bool:
    """Whether Mitsuba contains a plugin, or Python code has registered it."""
    if not re.fullmatch(r"\w+", name):
        return False
    outer, own = mi.file_resolver(), mi.FileResolver()
    own.clear()
    own.append(str(_MITSUBA))
    mi.set_file_resolver(own)  # the plugin manager may load the library to find out
    try:
        kind = mi.PluginManager.instance().plugin_type(name)
        return bool(kind != mi.ObjectType.Unknown)
    finally:
        mi.set_file_resolver(outer)


def _texts_in(props: Any) -> Iterable[str]:
    copy = mi.Properties(props)  # Mitsuba reports properties that nobody reads
    values = [copy[name] for name in copy.keys()]  # noqa: SIM118 (not a dict)
    return [value for value in values if isinstance(value, str)]


class _CheckedFiles:
    """The files of a scene; each lies in a permitted folder."""

    def __init__(self, file: Path, parameters: Mapping[str, str]) -> None:
        self.values = dict(parameters)
        self.paths: set[Path] = set()
        self.size = 0
        folders = [file.resolve().parent, *map(_resolved, parameters.values())]
        self.folders = [folder for folder in folders if folder is not None]

    def add(self, text: str) -> None:
        """Add the file with this name if it exists; raise FileFormatError unless permitted."""
        path = _resolved(text)
        if path is None or path.is_dir():
            return
        if not any(path.is_relative_to(folder) for folder in self.folders):
            raise FileFormatError(
                f"expected files in the folder of the scene or below, got {text[:200]!r}; copy the "
                "file there, or pass its path as a parameter of the scene"
            )
        check_regular(path)
        check_bytes(path.stat().st_size, _LARGEST_NAMED, path.name)
        self.paths.add(path)

    def add_xml(self, file: Path, level: int = 0) -> None:
        """Add a scene file, its includes, and the spectra that Mitsuba's parser reads."""
        if level > _DEEPEST_INCLUDE:
            raise FileFormatError("expected scenes that do not include each other in a circle")
        content = bytes_of(file, LARGEST_SCENE)
        self.size += len(content)  # each time that it is included
        check_bytes(self.size, LARGEST_SCENE, "scenes, includes counted")
        self.paths.add(file.resolve())
        for element in _root_of(text_of(content)).iter():
            attributes = {name: self._filled(text) for name, text in element.items()}
            name = attributes.get("filename")
            if element.tag == "path":
                raise FileFormatError(
                    "expected file names relative to the folder of the scene, got a <path>; leave "
                    "it out"
                )
            if element.tag == "default":
                self.values.setdefault(attributes.get("name", ""), attributes.get("value", ""))
            if name is not None:
                self.add(name)
                path = _resolved(name)
                if element.tag == "include" and path is not None:
                    self.add_xml(path, level + 1)

    def _filled(self, text: str) -> str:
        """Return the text with the values of its ``$parameters``, as Mitsuba fills them in."""
        for name in sorted(self.values, key=len, reverse=True) if "$" in text else ():
            text = text.replace(f"${name}", self.values[name])
            check_bytes(len(text), LARGEST_SCENE, "text, $parameters filled in")
        return text


def _resolved(name: str) -> Path | None:
    """Return the absolute path of an existing file or folder, links followed; else None."""
    with suppress(OSError, ValueError, RuntimeError):  # a text that cannot be a file name
        path = Path(str(mi.file_resolver().resolve(name)))
        return path.resolve() if name and path.exists() else None
    return None


def _root_of(text: str) -> Element:
    """Return the root element of XML without a DOCTYPE."""
    try:
        return fromstring(text, forbid_dtd=True)
    except DefusedXmlException:
        raise FileFormatError("expected a scene without DOCTYPE, got one; leave it out") from None
    except ParseError as error:
        line, column = error.position
        raise FileFormatError(
            f"expected a Mitsuba scene, got text that is not XML in line {line}, column {column}; "
            "correct it there"
        ) from None
