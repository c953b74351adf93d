"""Loading scenes: dictionary entries, variants, overrides, and errors in one line."""

from __future__ import annotations

import math
import re
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from polywigner.errors import ArgumentError, EngineError, PolywignerError, SceneError, value_text
from polywigner.geometry.arguments import checked_flag, checked_path
from polywigner.mitsuba.plugins.films import threads_for_openexr
from polywigner.mitsuba.plugins.placement import is_source
from polywigner.mitsuba.plugins.polarisation import is_polarised
from polywigner.mitsuba.plugins.registration import one_at_a_time, original_error, register
from polywigner.mitsuba.scenes.scene_files import parse_scene_file, resolving
from polywigner.toolchain import llvm

# Of unpolarised light, and of polarised: compiled, on a GPU, and without a compiler.
_VARIANTS = {
    False: ("llvm_ad_mono", "cuda_ad_mono", "scalar_rgb"),
    True: ("llvm_ad_mono_polarized", "cuda_ad_mono_polarized", "scalar_spectral_polarized"),
}
_COHERENT = ("wigner", "wigner_receiver")
# More make a sampler of Mitsuba round up without an end.
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
) -> Any:
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
        return load_file(scene, variant, sampler, merge, diffraction, parameters)
    if parameters:
        raise ArgumentError(
            f"a scene dictionary takes no parameters, got {', '.join(parameters)}; put the values "
            "into the dictionary"
        )
    how = _checked_how(sampler, merge, diffraction, None)
    return _load(None, dict(scene), variant, how, {})


def load_file(
    path: str | Path,
    variant: str | None,
    sampler: str | None,
    merge: bool,
    diffraction: bool,
    parameters: Mapping[str, Any],
    polarisation: str | None = None,
) -> Any:
    """Load a scene file as :func:`load_scene` does; its parameters may have any names.

    ``polarisation``: of sources and receivers for which the file specifies none.
    """
    file = checked_path(path)
    how = _checked_how(sampler, merge, diffraction, polarisation)
    for name, value in parameters.items():
        if value is not None and not isinstance(value, (str, int, float)):
            raise ArgumentError(f"expected {name} as a text or a number, got {value!r}")
    if not file.is_file():
        raise SceneError(f"expected a Mitsuba scene file, got {str(path)!r}, which is not a file")
    return _load(file, {}, variant, how, parameters)


_How = tuple[str | None, bool, bool, str | None]
"""Arguments ``sampler``, ``merge``, ``diffraction`` and ``polarisation`` of :func:`load_file`."""


def _checked_how(sampler: Any, merge: Any, diffraction: Any, polarisation: str | None) -> _How:
    if not isinstance(sampler, str | None):
        raise ArgumentError(f"expected sampler as the name of a plugin, got {value_text(sampler)}")
    checked_flag(merge, "merge")
    checked_flag(diffraction, "diffraction")
    return sampler, merge, diffraction, polarisation


@one_at_a_time
def _load(
    file: Path | None,
    entries: dict[str, Any],
    variant: str | None,
    how: _How,
    parameters: Mapping[str, Any],
) -> Any:
    """Load the scene of a file, or of the entries of a dictionary if there is no file."""
    if variant is not None or mi.variant() is None:
        mi.set_variant(choose_variant(variant))
    register()
    config = mi.parser.ParserConfig(mi.variant())
    state = None
    try:
        with threads_for_openexr():
            if file is None:
                state = mi.parser.parse_dict(config, entries)
                scene = _instantiate(config, state, how)
            else:
                with resolving(file):
                    state, _ = parse_scene_file(config, file, parameters)
                    scene = _instantiate(config, state, how)
    except (RuntimeError, ValueError, TypeError) as error:
        raise _translated(error, state) from None
    if not isinstance(scene, mi.Scene):
        where, advice = (
            ("the dictionary", 'add "type": "scene"')
            if file is None
            else (file, "wrap it in <scene>")
        )
        raise SceneError(f"expected a <scene> in {where}, got something else; {advice}")
    return scene


def checked_scene(scene: Any) -> Any:
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


def _instantiate(config: Any, state: Any, how: _How) -> Any:
    """Check a parsed scene, change it as requested and build it."""
    sampler, merge, diffraction, polarisation = how
    mi.parser.transform_upgrade(config, state)
    mi.parser.transform_resolve(config, state)
    _check_samplers(state)
    _check_numbers(state)
    if sampler is not None:
        _replace_samplers(state, sampler)
    for node in state.nodes:
        if node.props.plugin_name() not in _COHERENT:
            continue
        if diffraction:
            node.props["estimator"] = "exact"
            node.props["diffraction"] = True
        if polarisation is not None and "polarisation" not in node.props:
            node.props["polarisation"] = polarisation
    mi.parser.transform_merge_equivalent(config, state)
    if merge:
        mi.parser.transform_merge_meshes(config, state)
    return mi.parser.instantiate(config, state)


def _check_samplers(state: Any) -> None:
    """SceneError for a sampler of no samples, by which Mitsuba's ``multijitter`` divides."""
    for node in state.nodes:
        if node.type == mi.ObjectType.Sampler and "sample_count" in node.props:
            samples = node.props["sample_count"]
            if isinstance(samples, int) and not 1 <= samples <= _MOST_SAMPLES:
                raise SceneError(
                    f"expected a sample_count of at least 1 and at most {_MOST_SAMPLES} in a "
                    f"sampler, got {samples}; the number of samples per pixel"
                )


def _check_numbers(state: Any) -> None:
    """SceneError for a number that is none, and for shares of light that are not from 0 to 1."""
    for node in state.nodes:
        props = mi.Properties(node.props)  # a copy: Mitsuba tells of properties that nobody reads
        for name in props.keys():  # noqa: SIM118 (not a dict)
            values = _numbers_in(props[name])
            is_share = name.endswith(("reflectance", "transmittance", "albedo"))
            if node.type == mi.ObjectType.BSDF and is_share:
                wanted, is_right = "from 0 to 1", all(0.0 <= value <= 1.0 for value in values)
            else:
                wanted, is_right = "in numbers", not any(map(math.isnan, values))
            if not is_right:
                raise SceneError(
                    f"expected the {name} of a {props.plugin_name()} {wanted}, got "
                    f"{', '.join(f'{value:g}' for value in values[:3])}"
                )


def _numbers_in(value: Any) -> list[float]:
    """The numbers of a property, of a pose too; none of texts and references to textures."""
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
