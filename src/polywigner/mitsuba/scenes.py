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
import numpy.typing as npt

from polywigner.errors import EngineError, PolywignerError, SceneError
from polywigner.geometry import Aperture
from polywigner.geometry.arguments import takes_frequency
from polywigner.illumination import Array
from polywigner.illumination.obliquities import DEFAULT
from polywigner.mitsuba.exact import ESTIMATORS, check_estimator
from polywigner.mitsuba.given import as_source, pose_entry, register_source
from polywigner.mitsuba.images import threads_for_openexr
from polywigner.mitsuba.parameters import check_flag, check_range, check_sampling_weight
from polywigner.mitsuba.plugins import (
    PLUGIN_NAME,
    check_nested,
    one_at_a_time,
    original_error,
    register,
)
from polywigner.mitsuba.radiance import check_mixture, mixture_of
from polywigner.mitsuba.radiator import emitted_power, norm_of, radiator_of
from polywigner.mitsuba.sampling import SAMPLINGS, check_sampling
from polywigner.mitsuba.scene_files import check_scene_file, resolving
from polywigner.quantities import parse_frequency, parse_length, parse_power
from polywigner.toolchain import llvm

_FAST_VARIANT = "llvm_ad_mono"
_GPU_VARIANT = "cuda_ad_mono"
_PLAIN_VARIANT = "scalar_rgb"
# More make a sampler of Mitsuba round up without an end.
_MOST_SAMPLES = 1 << 24


@takes_frequency
def aperture(
    source: Aperture | Array | npt.ArrayLike,
    wavelength: float,
    to_world: Any = None,
    obliquity: str = DEFAULT,
    power: float | str | None = None,
    bsdf: Mapping[str, Any] | None = None,
    scene_unit: float = 1.0,
    sampling_weight: float = 1.0,
    antithetic: bool = False,
    sampling: str = SAMPLINGS[0],
    control_variate: bool = False,
    visible: bool = True,
    radiated_power: float | str | None = None,
    estimator: str = ESTIMATORS[0],
    bandwidth: float | str | None = None,
    aperture_power: float | str | None = None,
) -> dict[str, Any]:
    """A coherent aperture or array as an entry of a dictionary for ``mi.load_dict``.

    Parameters
    ----------
    source: an Aperture with its field, or what makes one; or an Array of apertures in the plane
        z = 0. Coordinates in metres.
    wavelength: metres.
    to_world: rigid pose, as a (4, 4) matrix or a Mitsuba transform; the aperture lies in the plane
        z = 0 of its own frame and radiates to +z. Default: none.
    obliquity: the diffraction integral whose |U|^2, times its own cosine, a surface receives:
        ``rayleigh-sommerfeld-1``, ``kirchhoff``, ``rayleigh-sommerfeld-2``; or ``paper``, the
        paper's radiance W/lambda^2.
    power: watts or a text such as "10 dBm", radiated through the hemisphere in front, as
        :func:`polywigner.radiated_power` counts it for this obliquity. Default: the power that the
        field radiates as it is, with |u|^2 in W/m^2.
    bsdf: entry of the surface that radiates. Default: ``null``, which light passes through, though
        ``direct``, ``path`` and ``prb`` do not know it when they sample a light behind:
        docs/plugin.md.
    scene_unit: metres in one unit of the scene, which is that of ``to_world``'s translation. Use
        1e-3 and a scene in millimetres when receivers stand within centimetres of the aperture.
    sampling_weight: relative number of samples spent on this source.
    antithetic: a sample of an array on a lattice stands for nine midpoints of elements, which
        cancel off its beams; clears noise beside steered beams, docs/plugin.md.
    sampling: density of samples in the region that radiates: ``uniform``; ``marginal``, in
        proportion to the position marginal; or ``root-marginal``, to its root. Unbiased all.
    control_variate: of each sample, take off the radiance in the direction from the middle of the
        source, and put its exact mean back: far less noise on diffuse surfaces that see all of the
        source, bias where they see a part of it or gloss: docs/plugin.md.
    visible: False leaves the surface out. It lights the scene as before and stands in no other
        light, but is not seen: by no camera, in no mirror, by no irradiance meter.
    aperture_power: in place of power, watts or a text: the integral of |u|^2 over the source, of
        which small sources radiate little; the rest is evanescent.
    radiated_power: the former name of power; deprecated.
    estimator: how a point of the scene is lit. ``wigner``: by signed radiance from a random place
        of the source. ``exact``: by the exact irradiance |U|^2 of the point, to 1e-4 of its peak at
        any distance, with no noise where all of the source is seen; docs/plugin.md.
    bandwidth: of the light, in Hz or a text such as "4 GHz", around the frequency of the
        wavelength. Each sample is light of one frequency of this band, docs/coherence.md; it is no
        bandwidth of noise. Default: one wavelength.

    The entry holds a key, see :func:`register_source`: load it in the process that made it.

    Raises
    ------
    GeometryError, QuantityError, SceneError for an unusable argument.
    """
    given = as_source(source)
    antithetic = check_flag("antithetic", antithetic)
    control_variate = check_flag("control_variate", control_variate)
    length = parse_length(wavelength)
    band = None if bandwidth is None else parse_frequency(bandwidth)
    coherent, mixture = mixture_of(given, length, band)
    radiator = radiator_of(coherent, obliquity, antithetic)
    check_mixture(mixture, coherent, length, obliquity, estimator)
    check_estimator(estimator, radiator.source, length, obliquity, antithetic, control_variate)
    entry: dict[str, Any] = {
        "type": PLUGIN_NAME,
        "source": register_source(given),
        "wavelength": length,
        "obliquity": obliquity,
        "estimator": estimator,
        "antithetic": antithetic,
        "sampling": check_sampling(sampling),
        "control_variate": control_variate,
        "scene_unit": parse_length(scene_unit),
        "sampling_weight": check_sampling_weight(sampling_weight),
        "visible": check_flag("visible", visible),
    }
    check_nested([] if bsdf is None else ["bsdf"], entry["visible"])
    if radiated_power is not None:
        warnings.warn(
            "radiated_power is deprecated: power is the radiated power now; write power=",
            DeprecationWarning,
            stacklevel=2,
        )
        if power is not None:
            raise SceneError("expected power, got radiated_power as well; both are one number")
        power = radiated_power
    powers = [None if given is None else parse_power(given) for given in (power, aperture_power)]
    norm = norm_of(coherent, length, obliquity, mixture)
    watts = emitted_power(radiator, norm, *powers)
    check_range(radiator, length, watts, norm, entry["scene_unit"])
    entry |= pose_entry(to_world)
    if power is not None or aperture_power is not None:
        entry["power"] = watts
    if band is not None:
        entry["bandwidth"] = band
    if bsdf is not None:
        entry["bsdf"] = _bsdf_entry(bsdf)
    return entry


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
    if prefer not in mi.variants():
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
    file = Path(path)
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


def has_wigner_emitter(scene: Any) -> bool:
    """Whether a ``wigner`` shape lights this scene."""
    return any(getattr(type(emitter), "is_wigner", False) for emitter in scene.emitters())


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


def _bsdf_entry(bsdf: Any) -> dict[str, Any]:
    if not isinstance(bsdf, Mapping) or not isinstance(bsdf.get("type"), str):
        raise SceneError(
            f"expected the bsdf as a dictionary with its type, got {bsdf!r}; give one such as "
            '{"type": "diffuse"}'
        )
    return dict(bsdf)


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
