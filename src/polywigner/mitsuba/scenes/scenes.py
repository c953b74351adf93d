"""Loading scenes: dictionary entries, variants, overrides, and errors in one line."""

from __future__ import annotations

import math
import re
import warnings
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from polywigner.errors import ArgumentError, EngineError, PolywignerError, SceneError, value_text
from polywigner.geometry.arguments import checked_flag, checked_path
from polywigner.mitsuba.plugins.films import threads_for_openexr
from polywigner.mitsuba.plugins.polariser import is_polarised
from polywigner.mitsuba.plugins.registration import one_at_a_time, original_error, register
from polywigner.mitsuba.scenes.scene_files import parse_scene_file, resolving
from polywigner.mitsuba.scenes.surfaces import is_source
from polywigner.toolchain import llvm

# Of unpolarised light, and of polarised: compiled, on a GPU, and without a compiler.
_VARIANTS = {
    False: ("llvm_ad_mono", "cuda_ad_mono", "scalar_rgb"),
    True: ("llvm_ad_mono_polarized", "cuda_ad_mono_polarized", "scalar_spectral_polarized"),
}
_COHERENT = ("wigner", "wigner_receiver")
_FRACTIONS = ("reflectance", "transmittance", "albedo")
# A sampler of Mitsuba divides by none, and rounds larger numbers up without an end.
_MOST_SAMPLES = 1 << 24
_LONGEST_MESSAGE = 600


def choose_variant(prefer: str | None = None, polarised: bool = False) -> str:
    """The Mitsuba variant to render with; it is not set.

    ``prefer`` if given; else ``llvm_ad_mono`` (one channel, compiled) where a usable LLVM library
    exists, else ``cuda_ad_mono`` where there is a GPU, else ``scalar_rgb`` with one warning.
    ``polarised``: one of polarised light, ``llvm_ad_mono_polarized`` first.

    Raises
    ------
    EngineError when the preferred variant is unknown to this Mitsuba or cannot run here, or is not
    polarised where it must be.
    """
    status = llvm.prepare()
    fast, on_gpu, plain = _VARIANTS[checked_flag(polarised, "polarised")]
    if prefer is None:
        if status.usable:
            return fast
        if dr.has_backend(dr.JitBackend.CUDA):
            return on_gpu
        warnings.warn(
            f"{status.problem} Rendering with {plain}, hundreds of times slower. {status.remedy}",
            RuntimeWarning,
            stacklevel=2,
        )
        return plain
    if not isinstance(prefer, str) or prefer not in mi.variants():
        raise EngineError(
            f"expected a variant of the installed Mitsuba, got {prefer!r}; use one of "
            f"{', '.join(mi.variants())}"
        )
    if prefer.startswith("cuda_") and not dr.has_backend(dr.JitBackend.CUDA):
        raise EngineError(
            f"{prefer} needs an NVIDIA GPU and its driver, and Dr.Jit finds none; use "
            f"{fast if status.usable else plain}"
        )
    if prefer.startswith("llvm_") and not status.usable:
        raise EngineError(f"{prefer} needs LLVM. {status.problem} {status.remedy}")
    if polarised and not is_polarised(prefer):
        raise EngineError(f"expected a variant of polarised light, got {prefer!r}; use {fast}")
    return prefer


def load_scene(
    scene: str | Path | Mapping[str, Any],
    variant: str | None = None,
    sampler: str | None = None,
    merge: bool = False,
    diffraction: bool = False,
    **parameters: Any,
) -> mi.Scene:
    """Load a Mitsuba scene from an XML file or a dictionary.

    Shapes keep their ids and the order of the file or dictionary, so results name them and are
    the same in each run. Mitsuba's own loaders merge meshes with equal BSDFs by default.

    Parameters
    ----------
    scene : path of a Mitsuba XML file, or a dictionary as for ``mi.load_dict``.
    variant : Mitsuba variant to set first. Default: the variant that is set, else
        :func:`choose_variant`.
    sampler : plugin such as ``multijitter`` that replaces the sampler of every sensor.
    merge : True: merge meshes with equal BSDFs into one mesh without an id, as Mitsuba does.
    diffraction : True: all sources and receivers get the estimator ``exact`` and shadows that
        diffract (docs/shadows.md). False: as the scene specifies.
    parameters : values of the file's ``$parameters``; a dictionary takes none.

    Returns
    -------
    mi.Scene
        The scene. Relative file names start at the folder of the XML file.

    Raises
    ------
    EngineError for a variant that cannot run; SceneError, or the package's error behind it, for a
    scene that does not load; ArgumentError for other arguments.
    """
    if not isinstance(scene, Mapping):
        path = checked_path(scene)
        return SceneFile(path, variant, sampler, parameters, diffraction, None, merge).load()
    if parameters:
        raise ArgumentError(
            f"a scene dictionary takes no parameters, got {', '.join(parameters)}; put the values "
            "into the dictionary"
        )
    return _load(SceneFile(None, variant, sampler, {}, diffraction, None, merge), dict(scene))


@dataclass(frozen=True)
class SceneFile:
    """A scene file and how it is loaded, by this process or by a worker."""

    path: Path | None
    """None for a scene that is a dictionary."""
    variant: str | None
    sampler: str | None = None
    parameters: Mapping[str, Any] = field(default_factory=dict)
    """Values of the file's ``$parameters``, with any names."""
    diffraction: bool = False
    polarisation: str | None = None
    """Polarisation of ends for which the file specifies none; None: the default."""
    merge: bool = False

    def __post_init__(self) -> None:
        if not isinstance(self.sampler, str | None):
            got = value_text(self.sampler)
            raise ArgumentError(f"expected sampler as the name of a plugin, got {got}")
        checked_flag(self.merge, "merge")
        checked_flag(self.diffraction, "diffraction")

    def load(self) -> mi.Scene:
        """Load the ``mi.Scene``; raises as :func:`load_scene` does."""
        for name, value in self.parameters.items():
            if value is not None and not isinstance(value, (str, int, float)):
                raise ArgumentError(f"expected {name} as a text or a number, got {value!r}")
        if self.path is None or not self.path.is_file():
            raise SceneError(
                f"expected a Mitsuba scene file, got {str(self.path)!r}, which is not a file"
            )
        return _load(self, {})


@one_at_a_time
def _load(how: SceneFile, entries: dict[str, Any]) -> mi.Scene:
    """Load the scene of a file, or of the entries of a dictionary if there is no file."""
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
                with resolving(how.path):
                    state, _ = parse_scene_file(config, how.path, how.parameters)
                    scene = _instantiate(config, state, how)
    except (RuntimeError, ValueError, TypeError) as error:
        raise _translated(error, state) from None
    if not isinstance(scene, mi.Scene):
        advice = 'add "type": "scene"' if how.path is None else "wrap it in <scene>"
        where = how.path or "the dictionary"
        raise SceneError(f"expected a <scene> in {where}, got something else; {advice}")
    return scene


def checked_scene(scene: Any) -> mi.Scene:
    """A scene of the variant that is set, or SceneError."""
    if not isinstance(scene, mi.Scene):
        raise SceneError(
            f"expected a scene of the variant that is set, {mi.variant()}, got one of another or "
            f"no scene ({type(scene).__name__}); set that one, or load the scene anew"
        )
    return scene


def has_wigner_emitter(scene: Any) -> bool:
    """Whether a ``wigner`` shape lights this scene."""
    return any(map(is_source, checked_scene(scene).emitters()))


def translate_error(error: Exception) -> PolywignerError:
    """Return an error that Mitsuba raised while loading as an error of one line.

    If an error of this package caused it: that error, after its location in the scene. Otherwise: a
    SceneError with Mitsuba's message.
    """
    return _translated(error, None)


def _translated(error: Exception, state: Any) -> PolywignerError:
    """Return the error of :func:`translate_error`, with the file that the object reads.

    ``state``: ``mi.parser.ParserState`` of the scene, or None.
    """
    if isinstance(error, PolywignerError):
        return error
    text = str(error)
    if isinstance(error, UnicodeDecodeError):  # Mitsuba's message quotes a binary file
        text = error.object.decode(errors="replace")
    text = re.sub(r"^\[\w+\.cpp:\d+\] ", "", text)
    place = re.match(r"(?:At|While loading) (.*?(?:\(line \d+, col \d+\)|node \"[^\"]*\")):", text)
    own = original_error(error)
    if own is not None:
        return type(own)(_printable(f"{place[1]}: {own}" if place else str(own)))
    head, _, traceback = text.partition("Traceback (most recent call last)")
    cause = traceback.strip().splitlines()[-1:]  # what a plugin written in Python has raised
    names = [] if state is None or place is None else _file_names_at(state, place[1])
    line = _printable(" ".join(" ".join([head, *cause]).split()))
    unnamed = [name for name in names if name not in line]
    about = f" (file {_printable(unnamed[0])})" if unnamed else ""
    return SceneError(f"expected a scene that Mitsuba can load: {line}{about}")


def _file_names_at(state: Any, place: str) -> list[str]:
    """Return the file names of the objects at a location of a scene, as in Mitsuba's messages."""
    nodes = [node for node in state.nodes if mi.parser.file_location(state, node) == place]
    copies = [mi.Properties(node.props) for node in nodes]
    return [str(props["filename"]) for props in copies if "filename" in props]


def _printable(text: str) -> str:
    """A text of some lines at most, without characters that a terminal would obey."""
    short = text[:_LONGEST_MESSAGE] + ("..." if text[_LONGEST_MESSAGE:] else "")
    return "".join(c if c.isprintable() else "\N{REPLACEMENT CHARACTER}" for c in short)


def _instantiate(config: Any, state: Any, how: SceneFile) -> mi.Object:
    """Check a parsed scene, change it as requested and build it."""
    mi.parser.transform_upgrade(config, state)
    mi.parser.transform_resolve(config, state)
    _check_numbers(state)
    if how.sampler is not None:
        _replace_samplers(state, how.sampler)
    for node in state.nodes:
        if node.props.plugin_name() not in _COHERENT:
            continue
        if how.diffraction:
            node.props["estimator"] = "exact"
            node.props["diffraction"] = True
        if how.polarisation is not None and "polarisation" not in node.props:
            node.props["polarisation"] = how.polarisation
    mi.parser.transform_merge_equivalent(config, state)
    if how.merge:
        mi.parser.transform_merge_meshes(config, state)
    return mi.parser.instantiate(config, state)


def _check_numbers(state: Any) -> None:
    """Raise SceneError for NaN, fractions of light outside 0 to 1, and numbers of samples."""
    for node in state.nodes:
        props = mi.Properties(node.props)  # a copy: Mitsuba reports properties that nobody reads
        for name in props.keys():  # noqa: SIM118 (not a dict)
            values = _numbers_in(props[name])
            lowest, highest = -math.inf, math.inf
            if node.type == mi.ObjectType.BSDF and name.endswith(_FRACTIONS):
                lowest, highest = 0.0, 1.0
            elif node.type == mi.ObjectType.Sampler and name == "sample_count":
                lowest, highest = 1, _MOST_SAMPLES
            if not all(lowest <= value <= highest for value in values):
                limits = "" if highest == math.inf else f" from {lowest:g} to {highest}"
                raise SceneError(
                    f"expected the {name} of a {props.plugin_name()} in numbers{limits}, got "
                    f"{', '.join(f'{value:g}' for value in values[:3])}"
                )


def _numbers_in(value: Any) -> list[float]:
    """Return the numbers of a property or of a pose; none for texts and references to textures."""
    if isinstance(value, (str, mi.Properties.ResolvedReference)):
        return []
    value = getattr(value, "values", value)  # of a spectrum
    value = value if hasattr(value, "shape") else getattr(value, "matrix", value)
    try:
        return [float(number) for number in np.ravel(np.array(value, np.float64))]
    except (TypeError, ValueError):
        return []


def _replace_samplers(state: Any, name: str) -> None:
    for node in state.nodes:
        if node.type == mi.ObjectType.Sampler:
            props = mi.Properties(name)
            props.set_id(node.props.id())
            for kept in ("sample_count", "seed"):
                if kept in node.props:
                    props[kept] = node.props[kept]
            node.props = props
    for node in state.nodes:
        if node.type == mi.ObjectType.Sensor and not _has_sampler(state, node):
            props = mi.Properties(node.props)
            props["sampler"] = mi.load_dict({"type": name})
            node.props = props


def _has_sampler(state: Any, sensor: Any) -> bool:
    values = (sensor.props[name] for name in sensor.props.keys())  # noqa: SIM118 (not a dict)
    references = [value for value in values if isinstance(value, mi.Properties.ResolvedReference)]
    return any(state.nodes[r.index()].type == mi.ObjectType.Sampler for r in references)
