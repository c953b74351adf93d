"""Loading of scenes from dictionaries and from checked files.

A scene file may come from an untrusted source. Therefore it may use only known plugin types, and
only files in or below its folder (docs/safety.md). The XML is checked before Mitsuba loads it.
Mitsuba reads meshes and images, and reports damaged files. Errors are reported in one line.
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

# Variants for unpolarised light and for polarised light, in order of preference: compiled with
# LLVM, on a GPU, and without a compiler.
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
            f"the variant {prefer!r} renders unpolarised light, but polarised=True; use {fast}"
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
    """A scene file, with the options for loading the scene in this process or in a worker."""

    path: Path | None
    """Path of the file, or None for a scene from a dictionary."""
    variant: str | None
    parameters: Mapping[str, Any] = field(default_factory=dict)
    """Values of the ``$parameters`` in the file."""
    diffraction: bool = False
    polarisation: str | None = None
    """Polarisation of sources and receivers whose polarisation the file does not specify."""

    def __post_init__(self) -> None:
        checked_flag(self.diffraction, "diffraction")

    def load(self) -> mi.Scene:
        """Return the loaded ``mi.Scene``, or raise the errors of :func:`load_scene`."""
        if self.path is None or not self.path.is_file():
            raise SceneError(f"the scene file {str(self.path)!r} does not exist or is not a file")
        return _load(self, {})


@one_at_a_time
def _load(how: SceneFile, entries: dict[str, Any]) -> mi.Scene:
    """Load a scene from a file, or from the entries of a dictionary."""
    if how.variant is not None or mi.variant() is None:
        mi.set_variant(choose_variant(how.variant))
    register()
    config = mi.parser.ParserConfig(mi.variant())
    state = None
    try:
        with threads_for_openexr():
            if how.path is None:
                state = mi.parser.parse_dict(config, entries)
                scene = _instantiate(config, state, how)
            else:
                with _resolving(how.path):
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
    """Return ``scene`` unchanged; raise SceneError unless it is a scene of the current variant."""
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
    """Convert an error of Mitsuba's scene loaders to an error with a message of one line.

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
    """Convert an error of Mitsuba to an error of this package.

    If the state of Mitsuba's parser is given, the message contains the name of the damaged file.
    """
    if isinstance(error, PolywignerError):
        return error
    text = str(error)
    # Mitsuba's message may quote bytes of a file that are not valid text.
    if isinstance(error, UnicodeDecodeError):
        text = error.object.decode(errors="replace")
    text = re.sub(r"^\[\w+\.cpp:\d+\] ", "", text)
    at = re.match(r"(?:At|While loading) (.*?(?:\(line \d+, col \d+\)|node \"[^\"]*\")):", text)
    cause = original_error(error)
    if cause is not None:
        return type(cause)(_printable(f"{at[1]}: {cause}" if at else str(cause)))
    head, _, traceback = text.partition("Traceback (most recent call last)")
    # The last line of the traceback is the error of a plugin written in Python.
    last = traceback.strip().splitlines()[-1:]
    line = _printable(" ".join(" ".join([head, *last]).split()))
    names = [] if state is None or at is None else _file_names_at(state, at[1])
    about = f" (file {_printable(names[0])})" if names and names[0] not in line else ""
    return SceneError(f"Mitsuba cannot load the scene: {line}{about}")


def _file_names_at(state: mi.parser.ParserState, location: str) -> list[str]:
    """Return the file names that the objects at a location in a scene contain."""
    nodes = [node for node in state.nodes if mi.parser.file_location(state, node) == location]
    copies = [mi.Properties(node.props) for node in nodes]
    return [str(props["filename"]) for props in copies if "filename" in props]


def _printable(text: str) -> str:
    """Shorten a string, and replace control characters."""
    short = text[:_LONGEST_MESSAGE] + ("..." if text[_LONGEST_MESSAGE:] else "")
    return "".join(c if c.isprintable() else "\N{REPLACEMENT CHARACTER}" for c in short)


# ---- parsed scenes ------------------------------------------------------------------------------


def _instantiate(
    config: mi.parser.ParserConfig, state: mi.parser.ParserState, how: SceneFile
) -> mi.Object:
    """Check a parsed scene, apply the options, and create the scene."""
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


# ---- scene files --------------------------------------------------------------------------------

_MITSUBA = Path(mi.__file__).parent
# The plugin "blender" reads memory at addresses that the scene file specifies.
_REFUSED = frozenset({"blender"})
# Mitsuba's integrators that are written in Python, which its plugin manager does not list.
_INTEGRATORS = frozenset(
    {
        *("direct_projective", "prb", "prb_basic", "prb_projective", "prbvolpath"),
        *("volprim_rf_basic", "transient_path", "transient_prbvolpath", "transient_nlos_path"),
    }
)
# Largest size in bytes of a mesh file or image file that a scene uses.
_LARGEST_NAMED = 1 << 30
_DEEPEST_INCLUDE = 15


@contextmanager
def _resolver(resolver: mi.FileResolver) -> Iterator[None]:
    """Use another file resolver of Mitsuba within a ``with`` block."""
    outer = mi.file_resolver()
    mi.set_file_resolver(resolver)
    try:
        yield
    finally:
        mi.set_file_resolver(outer)


@contextmanager
def _resolving(file: Path) -> Iterator[None]:
    """Resolve relative file names in the folder of `file` within a ``with`` block.

    Mitsuba loads libraries from a subfolder "plugins" of the resolver's folders. Mitsuba's folder
    is the first of these folders, so that no library next to a scene is loaded.
    """
    resolver = mi.FileResolver(mi.file_resolver())
    resolver.prepend(str(file.resolve().parent))
    resolver.prepend(str(_MITSUBA))
    with _resolver(resolver):
        yield


def digests_of(file: Path, parameters: Mapping[str, Any]) -> dict[str, str]:
    """Return the SHA-256 digests of a scene file and of all files that it uses.

    The digests are stored by absolute path. Raises SceneError for a scene that is not permitted.
    """
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
    """Parse a scene file, and check that it contains only permitted plugin types and files.

    Call this function within `_resolving`. The caller's values of ``$parameters`` may contain the
    names of any files and folders. The second return value contains the absolute paths of the scene
    file, of the XML files that it includes, and of all files that they use.
    """
    texts = {name: str(value) for name, value in parameters.items()}
    checked = _CheckedFiles(file, texts)
    try:
        checked.add_xml(file)
        state = mi.parser.parse_file(config, str(file), **texts)
        for name in sorted({node.props.plugin_name() for node in state.nodes}):
            _check_type(name)
        # Properties are read from copies, so that Mitsuba still reports properties that no plugin
        # reads.
        copies = [values_of(mi.Properties(node.props)) for node in state.nodes]
        texts_in = {value for props in copies for value in props.values() if isinstance(value, str)}
        for text in sorted(texts_in):
            checked.add(text)
    except FileFormatError as error:
        raise SceneError(f"{file}: {error}") from None
    return state, checked.paths


def _check_type(name: str) -> None:
    """Raise FileFormatError unless a plugin type belongs to Mitsuba or is registered in Python."""
    is_known = name in _INTEGRATORS
    if not is_known and re.fullmatch(r"\w+", name):
        resolver = mi.FileResolver()
        resolver.clear()
        resolver.append(str(_MITSUBA))
        # The plugin manager may load the library of the plugin, so the search is limited to
        # Mitsuba's folder.
        with _resolver(resolver):
            kind = mi.PluginManager.instance().plugin_type(name)
        is_known = kind != mi.ObjectType.Unknown
    if name in _REFUSED or not is_known:
        raise FileFormatError(
            f"the scene uses the plugin type {name[:60]!r}, which is unknown or not permitted; "
            "use a plugin of Mitsuba or polywigner"
        )


class _CheckedFiles:
    """Set of the files that a scene uses. Files outside permitted folders are rejected."""

    def __init__(self, file: Path, parameters: Mapping[str, str]) -> None:
        self.values = dict(parameters)
        self.paths: set[Path] = set()
        folders = [file.resolve().parent, *map(_resolved, parameters.values())]
        self.folders = [folder for folder in folders if folder is not None]

    def add(self, text: str) -> None:
        """Add the file named ``text`` if it exists.

        Raises FileFormatError if the file is not in a permitted folder.
        """
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
        """Add a scene file, its includes, and the spectra that Mitsuba's parser reads."""
        if level > _DEEPEST_INCLUDE:
            raise FileFormatError(
                "scene files include each other in a circle; remove one <include>"
            )
        content = bytes_of(file, LARGEST_SCENE)
        self.paths.add(file.resolve())
        for element in _root_of(text_of(content)).iter():
            attributes = {name: self._filled(text) for name, text in element.items()}
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

    def _filled(self, text: str) -> str:
        """Replace the ``$parameters`` in a string by their values, as Mitsuba does."""
        for name in sorted(self.values, key=len, reverse=True) if "$" in text else ():
            text = text.replace(f"${name}", self.values[name])
            check_bytes(len(text), LARGEST_SCENE, "text, $parameters filled in")
        return text


def _resolved(name: str) -> Path | None:
    """Return the absolute path of an existing file or folder without symbolic links, or None."""
    with suppress(OSError, ValueError, RuntimeError):  # The name may be invalid.
        path = Path(str(mi.file_resolver().resolve(name)))
        return path.resolve() if name and path.exists() else None
    return None


def _root_of(text: str) -> Element:
    """Parse XML and return its root element; raise an error if the XML contains a DOCTYPE."""
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
