"""Loading scenes: dictionary entries, variants, overrides, and errors in one line."""

from __future__ import annotations

import re
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from polywigner.errors import (
    ArgumentError,
    EngineError,
    PolywignerError,
    SceneError,
)
from polywigner.geometry.arguments import checked_flag, checked_path
from polywigner.mitsuba.films import threads_for_openexr
from polywigner.mitsuba.plugins import (
    one_at_a_time,
    original_error,
    register,
)
from polywigner.mitsuba.scene_files import check_scene_file, resolving
from polywigner.toolchain import llvm

_FAST_VARIANT = "llvm_ad_mono"
_GPU_VARIANT = "cuda_ad_mono"
_PLAIN_VARIANT = "scalar_rgb"
# More make a sampler of Mitsuba round up without an end.
_MOST_SAMPLES = 1 << 24


def choose_variant(prefer: str | None = None) -> str:
    """The Mitsuba variant to render with; it is not set.

    ``prefer`` if given; else ``llvm_ad_mono`` (one channel, compiled) where a usable LLVM library
    exists, else ``cuda_ad_mono`` where there is a GPU, else ``scalar_rgb`` with one warning.

    Raises
    ------
    EngineError when the preferred variant is unknown to this Mitsuba or cannot run here.
    """
    status = llvm.prepare()
    if prefer is None:
        if status.usable:
            return _FAST_VARIANT
        if dr.has_backend(dr.JitBackend.CUDA):
            return _GPU_VARIANT
        warnings.warn(
            f"{status.problem} Rendering with {_PLAIN_VARIANT}, hundreds of times slower. "
            f"{status.remedy}",
            RuntimeWarning,
            stacklevel=2,
        )
        return _PLAIN_VARIANT
    if not isinstance(prefer, str) or prefer not in mi.variants():
        raise EngineError(
            f"expected a variant of the installed Mitsuba, got {prefer!r}; use one of "
            f"{', '.join(mi.variants())}"
        )
    if prefer.startswith("cuda_") and not dr.has_backend(dr.JitBackend.CUDA):
        raise EngineError(
            f"{prefer} needs an NVIDIA GPU and its driver, and Dr.Jit finds none; use "
            f"{_FAST_VARIANT if status.usable else _PLAIN_VARIANT}"
        )
    if prefer.startswith("llvm_") and not status.usable:
        raise EngineError(f"{prefer} needs LLVM. {status.problem} {status.remedy}")
    return prefer


@one_at_a_time
def load_scene(
    path: str | Path,
    variant: str | None = None,
    sampler: str | None = None,
    merge: bool = True,
    **parameters: Any,
) -> Any:
    """A Mitsuba scene from its XML file, ready to render.

    Parameters
    ----------
    path: Mitsuba XML.
    variant: set first, if given; default: the variant that is set, or :func:`choose_variant`.
    sampler: plugin such as ``multijitter``, in place of the one of every sensor.
    merge: make one mesh of all that have one BSDF; it has no id then.
    parameters: values of the file's ``$parameters``.

    Returns the ``mi.Scene``; its folder serves to find the files it names.

    Raises
    ------
    EngineError for a variant that cannot run; SceneError, or the package's own error behind it,
    for a scene that does not load.
    """
    file = checked_path(path)
    for name, value in (("sampler", sampler), *parameters.items()):
        if value is not None and not isinstance(value, (str, int, float)):
            raise ArgumentError(f"expected {name} as a text or a number, got {value!r}")
    checked_flag(merge, "merge")
    if not file.is_file():
        raise SceneError(f"expected a Mitsuba scene file, got {str(path)!r}, which is not a file")
    if variant is not None or mi.variant() is None:
        mi.set_variant(choose_variant(variant))
    register()
    try:
        with resolving(file) as resolve, threads_for_openexr():
            check_scene_file(file, parameters, resolve)
            scene = _instantiate(file, sampler, merge, parameters)
    except (RuntimeError, ValueError) as error:
        raise translate_error(error) from None
    if not isinstance(scene, mi.Scene):
        raise SceneError(f"expected a <scene> in {file}, got something else; wrap it in <scene>")
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
    emitters = checked_scene(scene).emitters()
    return any(getattr(type(emitter), "is_wigner", False) for emitter in emitters)


def translate_error(error: Exception) -> PolywignerError:
    """An error that Mitsuba raised while loading, as one line.

    If an error of this package is behind it, that error with the place in the scene before it;
    else a SceneError with what Mitsuba says.
    """
    if isinstance(error, PolywignerError):
        return error
    text = re.sub(r"^\[\w+\.cpp:\d+\] ", "", str(error))
    place = re.match(r"(?:At|While loading) (.*?(?:\(line \d+, col \d+\)|node \"[^\"]*\")):", text)
    own = original_error(error)
    if own is not None:
        return type(own)(f"{place[1]}: {own}" if place else str(own))
    head, _, traceback = text.partition("Traceback (most recent call last)")
    cause = traceback.strip().splitlines()[-1:]  # what a plugin written in Python has raised
    line = " ".join(" ".join([head, *cause]).split())
    return SceneError(f"expected a scene that Mitsuba can load: {line}")


def _instantiate(
    file: Path, sampler: str | None, merge: bool, parameters: Mapping[str, Any]
) -> Any:
    """``mi.load_file``, with a look at the parsed scene before it is built."""
    config = mi.parser.ParserConfig(mi.variant())
    texts = {name: str(value) for name, value in parameters.items()}
    state = mi.parser.parse_file(config, str(file), **texts)
    mi.parser.transform_upgrade(config, state)
    mi.parser.transform_resolve(config, state)
    _check_samplers(state)
    _check_reflectances(state)
    if sampler is not None:
        _replace_samplers(state, sampler)
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


def _check_reflectances(state: Any) -> None:
    """SceneError for shares of light that are not finite, or not from 0 to 1."""
    for node in state.nodes:
        for name in node.props.keys() if node.type == mi.ObjectType.BSDF else ():
            if name.endswith(("reflectance", "transmittance", "albedo")):
                values = _numbers_in(node.props[name])
                if not all(0.0 <= value <= 1.0 for value in values):
                    raise SceneError(
                        f"expected the {name} of a {node.props.plugin_name()} from 0 to 1, got "
                        f"{', '.join(f'{value:g}' for value in values[:3])}"
                    )


def _numbers_in(value: Any) -> list[float]:
    """The numbers of a property; none of references to textures."""
    if isinstance(value, mi.Properties.ResolvedReference):
        return []
    value = getattr(value, "values", value)  # of a spectrum
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
