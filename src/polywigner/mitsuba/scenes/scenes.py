"""Loading of scenes from dictionaries and from checked files.

A scene file may be untrusted. Therefore a scene file may use only known plugin types, and only
files in or below its folder (docs/safety.md).
"""

from __future__ import annotations

import hashlib
import re
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element, ParseError

import drjit as dr
import mitsuba as mi
from defusedxml.common import DefusedXmlException
from defusedxml.ElementTree import fromstring

from polywigner import llvm
from polywigner.errors import (
    ArgumentError,
    EngineError,
    FileFormatError,
    PolywignerError,
    SceneError,
)
from polywigner.geometry.arguments import checked_flag, checked_path
from polywigner.geometry.io.limits import (
    LARGEST_SCENE,
    bytes_of,
    check_bytes,
    check_regular,
    text_of,
)
from polywigner.mitsuba.plugins.films import threads_for_openexr
from polywigner.mitsuba.plugins.polariser import is_polarised
from polywigner.mitsuba.plugins.registration import one_at_a_time, original_error, register
from polywigner.mitsuba.plugins.source_parameters import values_of
from polywigner.mitsuba.scenes.surfaces import is_source

# Variants without and with polarisation, in order of preference: LLVM, GPU, scalar.
_VARIANTS = {
    False: ("llvm_ad_mono", "cuda_ad_mono", "scalar_rgb"),
    True: ("llvm_ad_mono_polarized", "cuda_ad_mono_polarized", "scalar_spectral_polarized"),
}
_COHERENT = ("wigner", "wigner_receiver")
_LONGEST_MESSAGE = 600


def choose_variant(prefer: str | None = None, polarised: bool = False) -> str:
    """Return the name of a suitable Mitsuba variant, without setting this variant.

    Parameters
    ----------
    prefer : str, optional
        Name of the preferred variant, which is checked. Default: ``llvm_ad_mono`` (one channel,
        compiled) if a usable LLVM library exists, otherwise ``cuda_ad_mono`` if there is a GPU,
        otherwise ``scalar_rgb`` with a warning.
    polarised : bool, default False
        Whether to return a variant with polarised light, preferably ``llvm_ad_mono_polarized``.

    Returns
    -------
    str
        The name of the variant.

    Raises
    ------
    EngineError
        If Mitsuba has no variant ``prefer``, if the variant cannot run on this machine, or if it
        is unpolarised with ``polarised=True``.
    """
    status = llvm.prepare()
    fast, on_gpu, plain = _VARIANTS[checked_flag(polarised, "polarised")]
    has_gpu = dr.has_backend(dr.JitBackend.CUDA)
    if prefer is None:
        if not status.usable and not has_gpu:
            warnings.warn(
                f"{status.problem} Images are rendered with {plain}, which is hundreds of times "
                f"slower. {status.remedy}",
                RuntimeWarning,
                stacklevel=2,
            )
            return plain
        return fast if status.usable else on_gpu
    if not isinstance(prefer, str) or prefer not in mi.variants():
        raise EngineError(
            f"the installed Mitsuba has no variant {prefer!r}; use one of "
            f"{', '.join(mi.variants())}"
        )
    if prefer.startswith("cuda_") and not has_gpu:
        raise EngineError(
            f"the variant {prefer} requires an NVIDIA GPU and its driver, but Dr.Jit detects "
            f"none; use {fast if status.usable else plain}"
        )
    if prefer.startswith("llvm_") and not status.usable:
        raise EngineError(f"the variant {prefer} requires LLVM. {status.problem} {status.remedy}")
    if polarised and not is_polarised(prefer):
        raise EngineError(
            f"the variant {prefer!r} renders unpolarised light, but polarised=True was passed; use "
            f"{fast}"
        )
    return prefer


def load_scene(
    scene: str | Path | Mapping[str, Any],
    variant: str | None = None,
    diffraction: bool = False,
    **parameters: Any,
) -> mi.Scene:
    """Load a Mitsuba scene from an XML file or a dictionary.

    In contrast to Mitsuba's loaders, this function does not merge meshes with equal BSDFs.
    Therefore shapes keep their ids and their order, so that results contain these ids and are the
    same in each run.

    Parameters
    ----------
    scene : str, path or mapping
        Path of a Mitsuba XML file, or a dictionary as for ``mi.load_dict``.
    variant : str, optional
        Mitsuba variant to set before loading. Default: the current variant. If no variant is set,
        the return value of :func:`choose_variant`.
    diffraction : bool, default False
        Whether to include diffraction at the edges of obstacles, for which all sources and
        receivers use the estimator ``exact`` (docs/shadows.md).
    **parameters : str or float
        Values of the ``$parameters`` in the file. Not allowed with a dictionary.

    Returns
    -------
    mi.Scene
        Scene, in which relative file names refer to the folder of the XML file.

    Raises
    ------
    EngineError
        If the variant cannot run.
    SceneError
        If the scene cannot be loaded. If a plugin of this package raises another error, that error
        is raised.
    ArgumentError
        If another argument is invalid.
    """
    if not isinstance(scene, Mapping):
        path = checked_path(scene)
        return SceneFile(path, variant, parameters, diffraction).load()
    if parameters:
        raise ArgumentError(
            f"a scene dictionary takes no parameters, got {', '.join(parameters)}; put the values "
            "into the dictionary"
        )
    return _load(SceneFile(None, variant, {}, diffraction), dict(scene))


@dataclass(frozen=True)
class SceneFile:
    """Scene file with its loading options."""

    path: Path | None
    variant: str | None
    parameters: Mapping[str, Any] = field(default_factory=dict)
    """Values of the ``$parameters`` in the file."""
    diffraction: bool = False
    polarisation: str | None = None

    def __post_init__(self) -> None:
        checked_flag(self.diffraction, "diffraction")

    def load(self) -> mi.Scene:
        """Load the scene; raise SceneError if the file does not exist."""
        if self.path is None or not self.path.is_file():
            raise SceneError(f"the scene file {str(self.path)!r} does not exist or is not a file")
        return _load(self, {})


@one_at_a_time
def _load(how: SceneFile, entries: dict[str, Any]) -> mi.Scene:
    """Load a scene from the file ``how.path``, or from ``entries`` if ``how.path`` is None."""
    if how.variant is not None or mi.variant() is None:
        mi.set_variant(choose_variant(how.variant))
    register()
    config = mi.parser.ParserConfig(mi.variant())
    state = None
    try:
        with threads_for_openexr(), _resolving(how.path):
            if how.path is None:
                state = mi.parser.parse_dict(config, entries)
            else:
                state, _ = _parsed(config, how.path, how.parameters)
            scene = _instantiate(config, state, how)
    except (RuntimeError, ValueError, TypeError) as error:
        raise _translated(error, state) from None
    if not isinstance(scene, mi.Scene):
        advice = 'add "type": "scene"' if how.path is None else "wrap it in <scene>"
        where = how.path or "the dictionary"
        raise SceneError(f"expected a <scene> in {where}, got another element; {advice}")
    return scene


def checked_scene(scene: mi.Scene) -> mi.Scene:
    """Return a scene; raise SceneError unless it belongs to the current variant."""
    if not isinstance(scene, mi.Scene):
        raise SceneError(
            f"expected a scene of the current variant {mi.variant()}, got a scene of another "
            f"variant or another object ({type(scene).__name__}); set that variant, or load the "
            "scene again"
        )
    return scene


def has_wigner_emitter(scene: Any) -> bool:
    """Return whether a scene contains a ``wigner`` shape.

    Parameters
    ----------
    scene : mi.Scene
        A scene of the current variant.

    Returns
    -------
    bool

    Raises
    ------
    SceneError
        If ``scene`` is not a scene of the current variant.
    """
    return any(map(is_source, checked_scene(scene).emitters()))


def translate_error(error: Exception) -> PolywignerError:
    """Convert an error of Mitsuba's scene loaders to an error with a one-line message.

    Parameters
    ----------
    error : Exception
        The error of ``mi.load_dict`` or ``mi.load_file``.

    Returns
    -------
    PolywignerError
        If the cause is an error of this package, the same error with its location in the scene.
        Otherwise a SceneError with Mitsuba's message.
    """
    return _translated(error, None)


def _translated(error: Exception, state: mi.parser.ParserState | None) -> PolywignerError:
    """Convert an error of Mitsuba; the parser's ``state`` adds the name of the damaged file."""
    if isinstance(error, PolywignerError):
        return error
    text = str(error)
    # Mitsuba's message may contain bytes of a damaged file.
    if isinstance(error, UnicodeDecodeError):
        text = error.object.decode(errors="replace")
    text = re.sub(r"^\[\w+\.cpp:\d+\] ", "", text)
    at = re.match(r"(?:At|While loading) (.*?(?:\(line \d+, col \d+\)|node \"[^\"]*\")):", text)
    cause = original_error(error)
    if cause is not None:
        return type(cause)(_printable(f"{at[1]}: {cause}" if at else str(cause)))
    head, _, traceback = text.partition("Traceback (most recent call last)")
    last = traceback.strip().splitlines()[-1:]
    line = _printable(" ".join(" ".join([head, *last]).split()))
    names = [] if state is None or at is None else _file_names_at(state, at[1])
    about = f" (file {_printable(names[0])})" if names and names[0] not in line else ""
    return SceneError(f"Mitsuba cannot load the scene: {line}{about}")


def _file_names_at(state: mi.parser.ParserState, location: str) -> list[str]:
    """Return the values of ``filename`` at a location in the parser's description."""
    nodes = [node for node in state.nodes if mi.parser.file_location(state, node) == location]
    copies = [mi.Properties(node.props) for node in nodes]
    return [str(props["filename"]) for props in copies if "filename" in props]


def _printable(text: str) -> str:
    """Return a text shortened to 600 characters, with unprintable characters replaced."""
    short = text[:_LONGEST_MESSAGE] + ("..." if text[_LONGEST_MESSAGE:] else "")
    return "".join(c if c.isprintable() else "\N{REPLACEMENT CHARACTER}" for c in short)


def _instantiate(
    config: mi.parser.ParserConfig, state: mi.parser.ParserState, how: SceneFile
) -> mi.Object:
    """Apply the options of a scene file to parsed nodes, and create the scene."""
    mi.parser.transform_upgrade(config, state)
    mi.parser.transform_resolve(config, state)
    for node in state.nodes:
        if node.props.plugin_name() not in _COHERENT:
            continue
        if how.diffraction:
            node.props["estimator"] = "exact"
            node.props["diffraction"] = True
        if how.polarisation is not None and "polarisation" not in node.props:
            node.props["polarisation"] = how.polarisation
    mi.parser.transform_merge_equivalent(config, state)
    return mi.parser.instantiate(config, state)


_MITSUBA = Path(mi.__file__).parent
# The plugin "blender" reads memory at addresses from the scene file.
_REFUSED = frozenset({"blender"})
# Integrators written in Python, which Mitsuba's plugin manager does not list.
_INTEGRATORS = frozenset(
    {
        *("direct_projective", "prb", "prb_basic", "prb_projective", "prbvolpath"),
        *("volprim_rf_basic", "transient_path", "transient_prbvolpath", "transient_nlos_path"),
    }
)
# Largest size of a mesh or image file [bytes].
_LARGEST_NAMED = 1 << 30
_DEEPEST_INCLUDE = 15


@contextmanager
def _resolver(resolver: mi.FileResolver) -> Iterator[None]:
    """Replace Mitsuba's file resolver within a ``with`` block."""
    outer = mi.file_resolver()
    mi.set_file_resolver(resolver)
    try:
        yield
    finally:
        mi.set_file_resolver(outer)


@contextmanager
def _resolving(file: Path | None) -> Iterator[None]:
    """Resolve relative file names in the folder of a scene file, if ``file`` is not None.

    Mitsuba loads plugin libraries from the resolver's folders. Mitsuba's own folder is the first
    one, so that no library next to a scene is loaded.
    """
    resolver = mi.FileResolver(mi.file_resolver())
    if file is not None:
        resolver.prepend(str(file.resolve().parent))
        resolver.prepend(str(_MITSUBA))
    with _resolver(resolver):
        yield


def digests_of(file: Path, parameters: Mapping[str, Any]) -> dict[str, str]:
    """Return the SHA-256 digests of a scene file and all files that it uses, by absolute path."""
    with _resolving(file):
        _, paths = _parsed(mi.parser.ParserConfig(mi.variant()), file, parameters)
    digests = {}
    for path in sorted(paths):
        with path.open("rb") as content:
            digests[str(path)] = hashlib.file_digest(content, "sha256").hexdigest()
    return digests


def _parsed(
    config: mi.parser.ParserConfig, file: Path, parameters: Mapping[str, Any]
) -> tuple[mi.parser.ParserState, set[Path]]:
    """Parse a scene file with only permitted plugins and files, and return the paths of all files.

    Values of ``$parameters`` may name any file. Call this function within `_resolving`.
    """
    texts = {name: str(value) for name, value in parameters.items()}
    checked = _CheckedFiles(file, texts)
    try:
        checked.add_xml(file)
        state = mi.parser.parse_file(config, str(file), **texts)
        for name in sorted({node.props.plugin_name() for node in state.nodes}):
            _check_type(name)
        # Reading the properties themselves would hide errors about unused properties.
        copies = [values_of(mi.Properties(node.props)) for node in state.nodes]
        texts_in = {value for props in copies for value in props.values() if isinstance(value, str)}
        for text in sorted(texts_in):
            checked.add(text)
    except FileFormatError as error:
        raise SceneError(f"{file}: {error}") from None
    return state, checked.paths


def _check_type(name: str) -> None:
    """Raise FileFormatError unless a plugin type is known and permitted."""
    is_known = name in _INTEGRATORS
    if not is_known and re.fullmatch(r"\w+", name):
        resolver = mi.FileResolver()
        resolver.clear()
        resolver.append(str(_MITSUBA))
        # The plugin manager may load a library, so its search is limited to Mitsuba's folder.
        with _resolver(resolver):
            kind = mi.PluginManager.instance().plugin_type(name)
        is_known = kind != mi.ObjectType.Unknown
    if name in _REFUSED or not is_known:
        raise FileFormatError(
            f"the scene uses the plugin type {name[:60]!r}, which is unknown or not permitted; "
            "use a plugin of Mitsuba or polywigner"
        )


class _CheckedFiles:
    """Files that a scene uses, restricted to permitted folders."""

    def __init__(self, file: Path, parameters: Mapping[str, str]) -> None:
        self.values = dict(parameters)
        self.paths: set[Path] = set()
        folders = [file.resolve().parent, *map(_resolved, parameters.values())]
        self.folders = [folder for folder in folders if folder is not None]

    def add(self, text: str) -> None:
        """Add the file named ``text`` if it exists; raise FileFormatError if it is forbidden."""
        path = _resolved(text)
        if path is None or path.is_dir():
            return
        if not any(path.is_relative_to(folder) for folder in self.folders):
            raise FileFormatError(
                f"the scene uses the file {text[:200]!r} outside its folder; copy the file into "
                "the folder of the scene, or pass its path as a parameter of the scene"
            )
        check_regular(path)
        check_bytes(path.stat().st_size, _LARGEST_NAMED, path.name)
        self.paths.add(path)

    def add_xml(self, file: Path, level: int = 0) -> None:
        """Add a scene file, its includes, and the files that it names."""
        if level > _DEEPEST_INCLUDE:
            raise FileFormatError("scene files include each other in a cycle; remove one <include>")
        content = bytes_of(file, LARGEST_SCENE)
        self.paths.add(file.resolve())
        for element in _root_of(text_of(content)).iter():
            attributes = {name: self._with_parameters(text) for name, text in element.items()}
            name = attributes.get("filename")
            if element.tag == "path":
                raise FileFormatError(
                    "<path> is not supported, because file names are relative to the folder of "
                    "the scene; remove the <path> element"
                )
            if element.tag == "default":
                self.values.setdefault(attributes.get("name", ""), attributes.get("value", ""))
            if name is not None:
                self.add(name)
                path = _resolved(name)
                if element.tag == "include" and path is not None:
                    self.add_xml(path, level + 1)

    def _with_parameters(self, text: str) -> str:
        """Return a text in which the ``$parameters`` are replaced by their values."""
        for name in sorted(self.values, key=len, reverse=True) if "$" in text else ():
            text = text.replace(f"${name}", self.values[name])
            check_bytes(len(text), LARGEST_SCENE, "text after substitution of $parameters")
        return text


def _resolved(name: str) -> Path | None:
    """Return the resolved path of an existing file or folder, or None."""
    with suppress(OSError, ValueError, RuntimeError):
        path = Path(str(mi.file_resolver().resolve(name)))
        return path.resolve() if name and path.exists() else None
    return None


def _root_of(text: str) -> Element:
    """Return the root element of XML; raise FileFormatError for invalid or unsafe XML."""
    try:
        return fromstring(text, forbid_dtd=True)
    except DefusedXmlException:
        raise FileFormatError(
            "scene files with a DOCTYPE are not supported; remove the DOCTYPE"
        ) from None
    except ParseError as error:
        line, column = error.position
        raise FileFormatError(
            f"the file is not a valid Mitsuba scene: XML error in line {line}, column {column}; "
            "correct the XML"
        ) from None
