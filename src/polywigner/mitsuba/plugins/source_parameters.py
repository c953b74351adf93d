"""Parameters of a source or a receiver in a scene, read from XML and from Python by one reader.

A `SourceParameters` contains the checked numbers of a ``wigner`` shape or of a ``wigner_receiver``
sensor, in SI units. `read_parameters` makes one from Mitsuba's properties or from a dictionary
entry; `scene_entry` makes the entry from the arguments of a Python call.
"""

from __future__ import annotations

import hashlib
import math
import threading
from collections import OrderedDict
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np
import numpy.typing as npt

from polywigner import geometry
from polywigner.errors import ArgumentError, GeometryError, SceneError
from polywigner.geometry import (
    Aperture,
    PlacedAperture,
    Polyhedron,
    Slits,
    Wavefront,
    read_aperture,
)
from polywigner.mitsuba.plugins.emissions import (
    PLAIN,
    UNPOLARISED,
    Mixture,
    Region,
    SceneSource,
    checked_name,
    mixture_of,
    norm_of,
    region_of,
    unfit_source,
)
from polywigner.mitsuba.scenes.surfaces import matrix_of, reach_at
from polywigner.quantities import (
    NOISE_PARSERS,
    parse_frequency,
    parse_length,
    parse_power,
    wavelength_of,
)
from polywigner.reception.norms import NORMALISATIONS, checked_normalise
from polywigner.source import Array, read_source
from polywigner.source.normal_form import PublicSource, normal_form
from polywigner.source.obliquities import DEFAULT, OBLIQUITIES
from polywigner.source.polarisation import (
    Stokes,
    checked_polarisation,
    polarisation_of_text,
    polarisation_text,
    stokes_fields,
)
from polywigner.source.source_files import source_json
from polywigner.source.source_tables import SOURCE_TEXTS, apply_texts

Floats = npt.NDArray[np.float64]
Complexes = npt.NDArray[np.complex128]

EMITTER, RECEIVER = "wigner", "wigner_receiver"
"""Names of the shape and of the sensor."""
SAMPLINGS = ("uniform", "marginal", "root-marginal")
ESTIMATORS = ("wigner", "exact")
RECEIVER_ESTIMATOR = "exact"


@dataclass(frozen=True, eq=False)
class SourceParameters:
    """Checked parameters of a ``wigner`` shape or a ``wigner_receiver`` sensor, in SI units."""

    source: Any
    """An Aperture, an Array, or one with a curved wave, in coherent light."""
    wavelength: float
    norm: float
    """Power in W of the unscaled field: radiated, or int |u|^2."""
    pose: Floats
    """(4, 4), read-only; the translation in scene units."""
    obliquity: str
    estimator: str
    sampling: str
    scene_unit: float
    """Metres."""
    region: Region
    mixture: Mixture = PLAIN
    """Mixture of the light that the source sends, or would send."""
    normalise: str = NORMALISATIONS[0]
    """Power that ``norm`` stands for: one of `NORMALISATIONS`."""
    power: float = 1.0
    """Radiated power in W; 1 for a receiver, whose power comes from the scene."""
    diffraction: bool = False
    """Whether shadows of the scene's surfaces diffract."""
    antithetic: bool = False
    control_variate: bool = False
    sampling_weight: float = 1.0
    visible: bool = True
    """Whether rays meet the surface of the source."""
    noise: Mapping[str, float | None] = field(default_factory=dict)
    """Noise of a receiver, by the names of ``NOISE_PARSERS``."""
    polarisation: Complexes | None = None
    """Unit Jones vector (2,) in the source's x and y, or (n, 2) of elements; None: unpolarised."""
    states_polarisation: bool = False
    """Whether the scene specifies ``polarisation``, "unpolarised" included."""

    @property
    def at_origin(self) -> SceneSource:
        """The source relative to its centre: single precision resolves 6e-8 of a position."""
        return normal_form(self.source).moved(-self.region.centre).public

    @property
    def centre(self) -> Floats:
        """(2,): centre of the region that radiates, in units of the scene."""
        return self.region.centre / self.scene_unit

    @property
    def has_several(self) -> bool:
        """Whether elements have different polarisations."""
        return self.polarisation is not None and self.polarisation.ndim == 2

    def fields_of(self, source: Any) -> list[tuple[SceneSource, Stokes | None]]:
        """Return scalar sources, and the Stokes numbers by which their light adds up."""
        if self.polarisation is None or self.polarisation.ndim == 1:
            return [(source, None)]
        return list(stokes_fields(source, self.polarisation))

    def norm_at(self, wavelength: float, normalise: str | None = None) -> float:
        """Return the power in W of the source's field at a wavelength, as ``normalise`` counts."""
        return math.fsum(
            norm_of(part, wavelength, self.obliquity, self.mixture, normalise or self.normalise)
            for part, stokes in self.fields_of(self.source)
            if stokes is None or stokes[0] > 0
        )

    def reach_in(self, scene: Any, pose: Floats) -> float:
        """Return the largest coordinate of the source and of the flat surfaces that touch it.

        In units of the scene; the translation of ``pose`` is in metres.
        """
        low, high = np.reshape(self.source.bounds, (2, 2))
        corners = np.array([[x, y] for x in (low[0], high[0]) for y in (low[1], high[1])])
        return reach_at(scene, (corners @ pose[:3, :2].T + pose[:3, 3]) / self.scene_unit)

    def with_source(self, source: Any, wavelength: float) -> SourceParameters:
        """Return the parameters with another source."""
        region = region_of(source, self.obliquity, self.antithetic)
        norm = norm_of(source, wavelength, self.obliquity, self.mixture)
        return replace(self, source=source, region=region, norm=norm)


_COMMON = (
    *("aperture", "unit", "tolerance", "layer", "union", "source", "frequency", "wavelength"),
    *SOURCE_TEXTS,
    *("polarisation", "to_world"),
)
PARAMETERS = (
    *_COMMON,
    *("power", "aperture_power", "obliquity", "estimator", "diffraction", "antithetic"),
    *("sampling", "control_variate", "scene_unit", "sampling_weight", "visible", "bandwidth"),
)
"""Names of the ``wigner`` shape's parameters; ``docs/plugin.md`` explains them."""
RECEIVER_PARAMETERS = (
    *_COMMON,
    *("obliquity", "estimator", "diffraction", "sampling", "scene_unit", "normalise"),
    *NOISE_PARSERS,
)
"""Names of the ``wigner_receiver`` sensor's parameters; ``docs/received_power.md`` explains them."""


def read_parameters(values: Mapping[str, Any], plugin: str) -> SourceParameters:
    """Return the checked parameters of a ``wigner`` shape or of a ``wigner_receiver`` sensor.

    Parameters
    ----------
    values : Mitsuba's properties as a dictionary, or an entry made in Python.
    plugin : `EMITTER` or `RECEIVER`.

    Raises
    ------
    SceneError for unknown names and unusable values; errors of the readers of source files.
    """
    sends = plugin == EMITTER
    given = SceneValues(values, f"{plugin} {'shape' if sends else 'sensor'}")
    given.check_names(PARAMETERS if sends else RECEIVER_PARAMETERS)
    estimator = given.choice("an estimator", ESTIMATORS, None if sends else RECEIVER_ESTIMATOR)
    diffraction = given.flag("diffraction", False)
    if diffraction and estimator != "exact":
        raise SceneError(
            f'expected the estimator "exact" with diffraction, got {estimator!r}; W knows nothing '
            "of edges in the way"
        )
    obliquity = given.choice("an obliquity", OBLIQUITIES, DEFAULT)
    antithetic, wavelength = given.flag("antithetic", False), given.wavelength()
    source, mixture = mixture_of(
        given.source(wavelength),
        wavelength,
        given.optional("bandwidth", parse_frequency) if sends else None,
    )
    parsers: Mapping[str, Any] = {} if sends else NOISE_PARSERS
    spec = SourceParameters(
        source=source,
        wavelength=wavelength,
        norm=math.nan,
        pose=given.pose(),
        obliquity=obliquity,
        estimator=estimator,
        sampling=given.choice("a sampling", SAMPLINGS),
        scene_unit=given.scene_unit(),
        region=region_of(source, obliquity, antithetic),
        mixture=mixture,
        normalise=checked_normalise(given.text("normalise", NORMALISATIONS[0]), SceneError),
        diffraction=diffraction,
        antithetic=antithetic,
        control_variate=given.flag("control_variate", False),
        sampling_weight=given.number("sampling_weight", float, 1.0),
        visible=given.flag("visible", True),
        noise={name: given.optional(name, parse) for name, parse in parsers.items()},
        polarisation=given.polarisation(source),
        states_polarisation="polarisation" in given.values,
    )
    spec = replace(spec, norm=spec.norm_at(wavelength))
    return replace(spec, power=_power(given, spec)) if sends else spec


def _power(given: SceneValues, spec: SourceParameters) -> float:
    """Return the radiated power in W of the parameters of a shape."""
    power, inside = (given.optional(name, parse_power) for name in ("power", "aperture_power"))
    if power is not None and inside is not None:
        raise SceneError(
            "expected power or aperture_power, got both; power leaves through the hemisphere in "
            "front, aperture_power is the integral of |u|^2 over the aperture: give one"
        )
    if inside is not None:
        return spec.norm * (inside / spec.norm_at(spec.wavelength, "aperture"))
    return spec.norm if power is None else power


# Numbers of an entry, and how their texts are read.
_PARSERS: dict[str, Callable[[Any], float]] = {
    "wavelength": parse_length,
    "scene_unit": parse_length,
    "power": parse_power,
    "aperture_power": parse_power,
}


def scene_entry(
    plugin: str, source: Any, to_world: Any, polarisation: Any, **values: Any
) -> dict[str, Any]:
    """Return the arguments of a Python call as an entry of a dictionary for ``mi.load_dict``.

    Values that are None are left out.
    """
    kinds = Aperture | Array | Wavefront | PlacedAperture | Slits | Polyhedron
    source = source if isinstance(source, kinds) else Aperture(source)
    entry: dict[str, Any] = {"type": plugin, "source": register_source(source)}
    entry |= {
        name: _PARSERS[name](value) if name in _PARSERS else value
        for name, value in values.items()
        if value is not None
    }
    if to_world is not None:
        pose = rigid_pose(getattr(to_world, "matrix", to_world))
        entry["to_world"] = mi.scalar_rgb.ScalarTransform4f(pose)
    if isinstance(polarisation, str) and polarisation.strip().lower() == UNPOLARISED:
        entry["polarisation"] = UNPOLARISED
    elif polarisation is not None:
        entry["polarisation"] = polarisation_text(checked_polarisation(polarisation, source))
    return entry


# ---- sources in memory --------------------------------------------------------------------------

KEY_PREFIX = "memory:"

# Bounds the memory of a process that makes a scene for each of many apertures, such as an
# optimiser. A scene needs its key only while it is being loaded.
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
    content = source_json(source)  # all that makes it up, to the last digit
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


def values_of(props: Any) -> dict[str, Any]:
    """Return the parameters of Mitsuba's ``Properties``."""
    return {name: props[name] for name in props.keys()}  # noqa: SIM118 (no dict)


@dataclass(frozen=True)
class SceneValues:
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

    def choice(self, kind: str, known: Iterable[str], default: str | None = None) -> str:
        """Return one of the known names; ``kind`` is "a sampling" for the parameter ``sampling``.

        The default is the first of the known names.
        """
        known = tuple(known)
        return checked_name(kind, self.text(kind.split()[1], default or known[0]), known)

    def source(self, wavelength: float) -> PublicSource | Polyhedron:
        """The source with its taper and copies, steered."""
        texts = {name: self.text(name, None) for name in SOURCE_TEXTS if name in self.values}
        return apply_texts(self._outline(), texts, wavelength)

    def _outline(self) -> PublicSource | Polyhedron:
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


def pose_of(plugin: Any) -> Floats:
    """Return the pose (4, 4) of a source or receiver in its scene; the translation is in metres."""
    spec = plugin.spec
    matrix = np.array(matrix_of(plugin.to_world))
    # in double precision, unless a user has changed it
    same = np.array_equal(matrix.astype(np.float32), spec.pose.astype(np.float32))
    pose = np.array(spec.pose if same else rigid_pose(matrix))
    pose[:3, 3] *= spec.scene_unit
    return pose


def reach_of(scene: Any, plugin: Any) -> float:
    """Return the ``reach`` of a source or receiver in its scene; see module `surfaces`."""
    return float(plugin.spec.reach_in(scene, pose_of(plugin)))
