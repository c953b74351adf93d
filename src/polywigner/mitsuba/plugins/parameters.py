"""Parameters of the ``wigner`` shape and the ``wigner_receiver`` sensor, read and checked once."""

from __future__ import annotations

import hashlib
import math
import threading
from collections import OrderedDict
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np
import numpy.typing as npt

from polywigner import geometry
from polywigner.errors import ArgumentError, GeometryError, SceneError
from polywigner.geometry import Aperture, Wavefront, read_aperture
from polywigner.mitsuba.plugins.exact import ExactEstimator
from polywigner.mitsuba.plugins.sampling import SAMPLINGS
from polywigner.mitsuba.plugins.sources import (
    Complexes,
    SourceSpec,
    centred_source,
    checked_name,
    mixture_of,
    unfit_source,
)
from polywigner.mitsuba.plugins.wigner import WignerEstimator
from polywigner.quantities import (
    NOISE_PARSERS,
    parse_frequency,
    parse_length,
    parse_power,
    wavelength_of,
)
from polywigner.reception.norms import NORMALISATIONS, checked_normalise
from polywigner.source import Array, read_source
from polywigner.source.obliquities import DEFAULT, OBLIQUITIES
from polywigner.source.polarisation import polarisation_of_text
from polywigner.source.source_files import json_of, table_of
from polywigner.source.texts import SOURCE_TEXTS, apply_texts

KEY_PREFIX = "memory:"

UNPOLARISED = "unpolarised"
"""Value of ``polarisation`` for unpolarised light, and for receivers of all polarisations."""

# Bounds what a long-lived process that makes a scene per aperture (an optimiser) keeps. A scene
# needs its key only while it is being loaded.
CAPACITY = 1024

_sources: OrderedDict[str, Aperture | Array | Wavefront] = OrderedDict()
_lock = threading.Lock()


def register_source(source: Aperture | Array | Wavefront) -> str:
    """The key under which scenes find this aperture or array, with its wave; equal ones share one.

    The last 1024 sources are kept. Use the key as the parameter ``source`` (or ``aperture``) of a
    ``wigner`` shape, in a dictionary or in XML.

    Raises
    ------
    SceneError for anything but an Aperture or an Array.
    """
    if not isinstance(source, Aperture | Array | Wavefront):
        raise unfit_source(source)
    content = json_of(table_of(source))  # all that makes it up, to the last digit
    key = KEY_PREFIX + hashlib.sha256(content.encode()).hexdigest()[:24]
    with _lock:
        _sources[key] = source
        _sources.move_to_end(key)
        while len(_sources) > CAPACITY:
            _sources.popitem(last=False)
    return key


def is_key(name: str) -> bool:
    """Whether the parameter ``aperture`` or ``source`` is a key rather than a file."""
    return name.startswith(KEY_PREFIX)


def registered_source(key: str) -> Aperture | Array | Wavefront:
    """The source of a key, or a SceneError."""
    with _lock:
        source = _sources.get(key)
    if source is None:
        raise SceneError(
            f"expected the key of a source in this process, got {key!r}; make the scene entry "
            "with polywigner.mitsuba.aperture(...) shortly before loading the scene"
        )
    return source


_COMMON = (
    "aperture",
    "unit",
    "tolerance",
    "layer",
    "union",
    "source",
    "frequency",
    "wavelength",
    *SOURCE_TEXTS,
    "polarisation",
    "to_world",
)

PARAMETERS = (
    *_COMMON,
    "power",
    "aperture_power",
    "obliquity",
    "estimator",
    "diffraction",
    "antithetic",
    "sampling",
    "control_variate",
    "scene_unit",
    "sampling_weight",
    "visible",
    "bandwidth",
)
"""Names of the ``wigner`` shape's parameters; ``docs/plugin.md`` explains them."""

RECEIVER_PARAMETERS = (
    *_COMMON,
    "obliquity",
    "estimator",
    "diffraction",
    "sampling",
    "scene_unit",
    "normalise",
    *NOISE_PARSERS,
)
"""Names of the ``wigner_receiver`` sensor's parameters; ``docs/receivers.md`` explains them."""

ESTIMATORS: dict[str, type[WignerEstimator | ExactEstimator]] = {
    "wigner": WignerEstimator,
    "exact": ExactEstimator,
}
RECEIVER_ESTIMATOR = "exact"

_BOTH_POWERS = (
    "expected power or aperture_power, got both; power leaves through the hemisphere in front, "
    "aperture_power is the integral of |u|^2 over the aperture: give one"
)


def read_emitter(values: Mapping[str, Any]) -> SourceSpec:
    """The checked parameters of a ``wigner`` shape, from Mitsuba or from an entry in Python."""
    given = SceneParameters(values, "wigner shape")
    given.check_names(PARAMETERS)
    spec = _spec(given, "wigner", given.optional("bandwidth", parse_frequency))
    power, aperture_power = (given.optional(n, parse_power) for n in ("power", "aperture_power"))
    if power is not None and aperture_power is not None:
        raise SceneError(_BOTH_POWERS)
    if aperture_power is not None:
        power = spec.norm * (aperture_power / spec.norm_at(spec.wavelength, "aperture"))
    return _checked(
        replace(
            spec,
            power=spec.norm if power is None else power,
            control_variate=given.flag("control_variate", False),
            sampling_weight=given.number("sampling_weight", float, 1.0),
            visible=given.flag("visible", True),
        )
    )


def read_receiver(values: Mapping[str, Any]) -> SourceSpec:
    """The checked parameters of a ``wigner_receiver`` sensor; raises as :func:`read_emitter`."""
    given = SceneParameters(values, "wigner_receiver sensor")
    given.check_names(RECEIVER_PARAMETERS)
    spec = _spec(given, RECEIVER_ESTIMATOR, None)
    noise = {name: given.optional(name, parse) for name, parse in NOISE_PARSERS.items()}
    return _checked(replace(spec, noise=noise))


def _spec(given: SceneParameters, estimator: str, bandwidth: float | None) -> SourceSpec:
    """The parameters that emitters and receivers share."""
    obliquity = checked_name("an obliquity", given.text("obliquity", DEFAULT), OBLIQUITIES)
    estimator = checked_name("an estimator", given.text("estimator", estimator), ESTIMATORS)
    sampling = checked_name("a sampling", given.text("sampling", SAMPLINGS[0]), SAMPLINGS)
    normalise = checked_normalise(given.text("normalise", NORMALISATIONS[0]), SceneError)
    antithetic = given.flag("antithetic", False)
    diffraction = given.flag("diffraction", False)
    if diffraction and estimator != "exact":
        raise SceneError(
            f'expected the estimator "exact" with diffraction, got {estimator!r}; W knows nothing '
            "of edges in the way"
        )
    wavelength = given.wavelength()
    source, mixture = mixture_of(given.source(wavelength), wavelength, bandwidth)
    spec = SourceSpec(
        centred=centred_source(source, obliquity, antithetic),
        wavelength=wavelength,
        norm=math.nan,
        pose=given.pose(),
        obliquity=obliquity,
        estimator=estimator,
        sampling=sampling,
        scene_unit=given.scene_unit(),
        mixture=mixture,
        normalise=normalise,
        diffraction=diffraction,
        antithetic=antithetic,
        polarisation=given.polarisation(source),
        states_polarisation="polarisation" in given.values,
    )
    return replace(spec, norm=spec.norm_at(wavelength))


def _checked(spec: SourceSpec) -> SourceSpec:
    ESTIMATORS[spec.estimator].check(spec)
    return spec


def values_of(props: Any) -> dict[str, Any]:
    """The parameters of Mitsuba's ``Properties``."""
    return {name: props[name] for name in props.keys()}  # noqa: SIM118 (no dict)


@dataclass(frozen=True)
class SceneParameters:
    """The parameters of one element of a scene."""

    values: Mapping[str, Any]
    element: str
    """Such as "wigner shape", for messages."""

    def check_names(self, known: tuple[str, ...]) -> None:
        """Raise SceneError for a parameter of another name; nested objects have any."""
        for name, value in self.values.items():
            is_nested = isinstance(value, mi.Object | Mapping) or name == "type"
            if not is_nested and name not in known:
                raise SceneError(
                    f"expected the parameters {', '.join(known)} of a {self.element}, got {name!r}"
                )

    def source(self, wavelength: float) -> Any:
        """The source with its taper and copies, steered."""
        texts = {name: self.text(name, None) for name in SOURCE_TEXTS if name in self.values}
        return apply_texts(self._outline(), texts, wavelength)

    def _outline(self) -> Any:
        """The source from its file, or from memory, before its taper and copies."""
        given = [name for name in ("aperture", "source") if name in self.values]
        if len(given) == 2:
            raise SceneError(
                f"expected an aperture or a source of the {self.element}, got both; a source file "
                "can take its outline from an aperture file"
            )
        name = self.text((given or ["aperture"])[0], None)
        in_file = given == ["aperture"] and not is_key(name)
        for key in ("unit", "tolerance", "layer", "union"):
            if key in self.values and not in_file:
                kind = "an aperture from memory" if is_key(name) else "a source file"
                raise SceneError(
                    f"expected no {key} with {kind}, got {self.values[key]!r}; its coordinates are "
                    "in metres already"
                )
        if is_key(name):
            return registered_source(name)
        path = Path(str(mi.file_resolver().resolve(name)))
        if not in_file:
            return read_source(path)
        tolerance = self.optional("tolerance", parse_length)
        layers = [name.strip() for name in self.text("layer", "").split(";") if name.strip()]
        joins = self.flag("union", False)
        return read_aperture(path, self.text("unit", "mm"), tolerance, layers, joins)

    def wavelength(self) -> float:
        """In metres, from either parameter."""
        given = [name for name in ("frequency", "wavelength") if name in self.values]
        if len(given) != 1:
            got = "both" if given else "neither"
            raise SceneError(
                f"expected a frequency or a wavelength of the {self.element}, got {got}; give one, "
                'such as frequency "94 GHz"'
            )
        if given == ["frequency"]:
            return wavelength_of(self.number("frequency", parse_frequency))
        return self.number("wavelength", parse_length)

    def polarisation(self, source: Any) -> Complexes | None:
        """Return a unit Jones vector (2,), or (n, 2) of an array; None if there is none."""
        text = self.text("polarisation", UNPOLARISED)
        if text.strip().lower() == UNPOLARISED:
            return None
        try:
            return polarisation_of_text(text, source)
        except ArgumentError as error:
            raise SceneError(str(error)) from None

    def scene_unit(self) -> float:
        """In metres."""
        value = self.values.get("scene_unit", 1.0)
        if isinstance(value, str) and value.strip()[:1].isalpha():
            value = f"1 {value}"
        return replace(self, values={"scene_unit": value}).number("scene_unit", parse_length)

    def pose(self) -> npt.NDArray[np.float64]:
        """A read-only (4, 4) matrix."""
        given = self.values.get("to_world")
        return rigid_pose(np.eye(4) if given is None else given.matrix)

    def optional(self, name: str, parse: Callable[[Any], float]) -> float | None:
        """A number, or None where there is none."""
        return self.number(name, parse) if name in self.values else None

    def number(self, name: str, parse: Callable[[Any], float], default: float = math.nan) -> float:
        """A number, or the text of one."""
        value = self.values.get(name, default)
        if not isinstance(value, (str, int, float)) or isinstance(value, bool):
            raise SceneError(f"expected a number or a text as {name}, got {type(value).__name__}")
        try:
            return float(parse(value))
        except ValueError as error:
            raise SceneError(f"{name} of the {self.element}: {error}") from None

    def flag(self, name: str, default: bool) -> bool:
        """True or false."""
        value = self.values.get(name, default)
        if not isinstance(value, bool | np.bool_):
            raise SceneError(
                f'expected {name} as True or False, <boolean name="{name}" .../> in a scene file, '
                f"got {value!r} of type {type(value).__name__}"
            )
        return bool(value)

    def text(self, name: str, default: str | None) -> str:
        """A text; without a default it must be there."""
        value = self.values.get(name, default)
        if value is None and name not in self.values:
            raise SceneError(
                f"expected the parameter {name!r} of a {self.element}, got none; give the file of "
                "an aperture, such as GeoJSON or DXF, or a source file (TOML or JSON) as source"
            )
        if not isinstance(value, str):
            raise SceneError(
                f'expected {name} as a text, <string name="{name}" .../> in a scene file, got '
                f"{value!r} of type {type(value).__name__}"
            )
        return value


def rigid_pose(matrix: Any) -> npt.NDArray[np.float64]:
    """A read-only (4, 4) pose from a matrix or from one of Mitsuba's, of any variant."""
    try:
        given = np.array(matrix)
        # compiled variants have a last axis of 1
        return geometry.rigid_pose(given[..., 0] if given.shape == (4, 4, 1) else given)
    except (GeometryError, RuntimeError, ValueError) as error:
        raise SceneError(str(error)) from None
