"""Parameters of sources and receivers in a scene, read from XML or from Python."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field, replace
from numbers import Real
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np

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
from polywigner.geometry.arguments import checked_choice, only_given
from polywigner.mitsuba.plugins.mixtures import (
    Mixture,
    SceneSource,
    mixture_of,
    norm_of,
    support_of,
)
from polywigner.mitsuba.plugins.registration import (
    is_key,
    register_source,
    registered_source,
    scene_errors,
)
from polywigner.mitsuba.scenes.surfaces import extent_near, matrix_of
from polywigner.numerics import Complex, Floats
from polywigner.quantities import (
    NOISE_PARSERS,
    parse_frequency,
    parse_length,
    parse_power,
    parse_unit,
    wavelength_of,
)
from polywigner.reception.couplings import NORMALISATIONS
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
from polywigner.source.source_tables import SOURCE_TEXTS, apply_texts

EMITTER, RECEIVER = "wigner", "wigner_receiver"
ESTIMATORS = ("wigner", "exact")
RECEIVER_ESTIMATOR = "exact"
UNPOLARISED = "unpolarised"
"""Value of ``polarisation`` for unpolarised light and for receivers of all polarisations."""


@dataclass(frozen=True, eq=False)
class SourceParameters:
    """Checked parameters of a ``wigner`` shape or a ``wigner_receiver`` sensor, in SI units."""

    source: Any
    """Coherent source: an Aperture, an Array, or a Wavefront with a curved wave."""
    wavelength: float
    norm: float
    """Power in W of the unscaled field, with |u|^2 in W/m^2."""
    pose: Floats
    """Read-only pose, shape (4, 4). The translation is in scene units."""
    obliquity: str
    estimator: str
    scene_unit: float
    """Length of one unit of the scene in metres."""
    support: Aperture
    """Region of the source plane where the Wigner function is not zero, in m."""
    mixture: Mixture
    normalise: str = NORMALISATIONS[0]
    """Definition of ``norm``, "radiated" or "aperture"."""
    power: float = 1.0
    """Radiated power in W; 1 for receivers."""
    diffraction: bool = False
    visible: bool = True
    """Whether rays can hit the surface of the source."""
    noise: Mapping[str, float | None] = field(default_factory=dict)
    """Bandwidth in Hz, temperature in K and noise figure in dB of a receiver, by name."""
    polarisation: Complex | None = None
    """Unit Jones vector along the source's x and y axes, or None for unpolarised light.

    The shape is (2,), or (n, 2) for n elements with different polarisations.
    """
    states_polarisation: bool = False
    """Whether the scene specifies ``polarisation``, including "unpolarised"."""

    @property
    def at_origin(self) -> SceneSource:
        """Source with its centre at the origin, where single precision is most accurate."""
        moved: SceneSource = normal_form(self.source).moved(-self.support.centre).public
        return moved

    @property
    def centre(self) -> Floats:
        """Centre of the radiating region in the source's frame, in scene units, shape (2,)."""
        return self.support.centre / self.scene_unit

    @property
    def outline(self) -> Aperture:
        """Radiating region relative to its centre, in scene units."""
        return self.support.moved(-self.support.centre).scaled(1 / self.scene_unit)

    @property
    def has_several(self) -> bool:
        """Whether elements have different polarisations."""
        return self.polarisation is not None and self.polarisation.ndim == 2

    def fields_of(self, source: SceneSource) -> list[tuple[SceneSource, Stokes | None]]:
        """Divide a polarised source into scalar sources, each with a Stokes vector.

        The sum of the Stokes vectors, weighted by the irradiances of the scalar sources, is the
        Stokes vector of the light. The vector is None unless elements have different polarisations.
        """
        if self.polarisation is None or not self.has_several:
            return [(source, None)]
        return list(stokes_fields(source, self.polarisation))

    def norm_at(self, wavelength: float, normalise: str | None = None) -> float:
        """Return the norm in W at a wavelength in m; None selects the source's ``normalise``."""
        return math.fsum(
            norm_of(part, wavelength, self.obliquity, self.mixture, normalise or self.normalise)
            for part, stokes in self.fields_of(self.source)
            if stokes is None or stokes[0] > 0
        )

    def with_source(self, source: SceneSource, wavelength: float) -> SourceParameters:
        """Return a copy with another source, whose support and norm are computed anew."""
        spec = replace(self, source=source, support=support_of(source, self.obliquity))
        return replace(spec, norm=spec.norm_at(wavelength))


_COMMON = (
    *("aperture", "unit", "tolerance", "layer", "union", "source", "frequency", "wavelength"),
    *SOURCE_TEXTS,
    *("polarisation", "to_world"),
)
PARAMETERS = (
    *_COMMON,
    *("power", "aperture_power", "obliquity", "estimator", "diffraction"),
    *("scene_unit", "visible", "bandwidth"),
)
RECEIVER_PARAMETERS = (
    *_COMMON,
    *("obliquity", "estimator", "diffraction", "scene_unit", "normalise"),
    *NOISE_PARSERS,
)


def read_parameters(values: Mapping[str, Any], plugin: str) -> SourceParameters:
    """Read and check the parameters of a ``wigner`` shape or a ``wigner_receiver`` sensor.

    ``plugin`` is the name of the plugin, and ``values`` are Mitsuba's properties or an entry made
    in Python. Raises SceneError for unknown parameters and invalid values.
    """
    is_emitter = plugin == EMITTER
    element = _SceneValues(values, f"{plugin} {'shape' if is_emitter else 'sensor'}")
    element.check_names(PARAMETERS if is_emitter else RECEIVER_PARAMETERS)
    default = None if is_emitter else RECEIVER_ESTIMATOR
    estimator = element.choice("estimator", ESTIMATORS, default)
    diffraction = element.flag("diffraction", False)
    if diffraction and estimator != "exact":
        raise SceneError(
            f'diffraction requires the estimator "exact", got {estimator!r}; with the estimator '
            '"wigner", obstacles do not change the Wigner function of the source'
        )
    obliquity = element.choice("obliquity", OBLIQUITIES, DEFAULT)
    wavelength = element.wavelength()
    bandwidth = element.number("bandwidth") if is_emitter else None
    # Errors in source files remain FileFormatErrors.
    with scene_errors(kind=ArgumentError):
        source, mixture = mixture_of(element.source(wavelength), wavelength, bandwidth)
    spec = SourceParameters(
        source=source,
        wavelength=wavelength,
        norm=math.nan,
        pose=element.pose(),
        obliquity=obliquity,
        estimator=estimator,
        scene_unit=element.number("scene_unit") or 1.0,
        support=support_of(source, obliquity),
        mixture=mixture,
        normalise=element.choice("normalise", NORMALISATIONS),
        diffraction=diffraction,
        visible=element.flag("visible", True),
        noise={} if is_emitter else {name: element.number(name) for name in NOISE_PARSERS},
        polarisation=element.polarisation(source),
        states_polarisation="polarisation" in element.values,
    )
    spec = replace(spec, norm=spec.norm_at(wavelength))
    return replace(spec, power=_power(element, spec)) if is_emitter else spec


def _power(element: _SceneValues, spec: SourceParameters) -> float:
    """Return the radiated power in W, from ``power`` or ``aperture_power``, by default the norm."""
    power, inside = element.number("power"), element.number("aperture_power")
    if power is not None and inside is not None:
        raise SceneError(
            "expected only one of power and aperture_power, got both; power is radiated into the "
            "hemisphere in front, and aperture_power is the integral of |u|^2 over the aperture: "
            "omit one of them"
        )
    if inside is not None:
        return spec.norm * (inside / spec.norm_at(spec.wavelength, "aperture"))
    return spec.norm if power is None else power


_PARSERS: dict[str, Callable[[Any], float]] = {
    "frequency": parse_frequency,
    "wavelength": parse_length,
    "tolerance": parse_length,
    "scene_unit": parse_unit,
    "power": parse_power,
    "aperture_power": parse_power,
    **NOISE_PARSERS,
}


def _number(name: str, value: Any, element: str) -> float:
    """Convert the parameter ``name`` of a plugin to SI units; raise SceneError for other values."""
    if not isinstance(value, str | Real) or isinstance(value, bool):
        raise SceneError(f"expected {name} to be a number or a string, got {type(value).__name__}")
    with scene_errors(f"{name} of the {element}: "):
        return float(_PARSERS[name](value))


def scene_entry(
    plugin: str, source: Any, to_world: Any, polarisation: Any, **values: Any
) -> dict[str, Any]:
    """Create a dictionary entry for ``mi.load_dict``; arguments that are None are omitted."""
    kinds = Aperture | Array | Wavefront | PlacedAperture | Slits | Polyhedron
    source = source if isinstance(source, kinds) else Aperture(source)
    entry: dict[str, Any] = {"type": plugin, "source": register_source(source)}
    entry |= {
        name: _number(name, value, plugin) if name in _PARSERS else value
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


def values_of(props: mi.Properties) -> dict[str, Any]:
    """Return the parameters in Mitsuba's ``Properties`` as a dictionary."""
    return {name: props[name] for name in props.keys()}  # noqa: SIM118 (not a dict)


@dataclass(frozen=True)
class _SceneValues:
    values: Mapping[str, Any]
    element: str

    def check_names(self, known: tuple[str, ...]) -> None:
        """Raise SceneError for a parameter that is not in ``known``."""
        for name, value in self.values.items():
            is_nested = isinstance(value, mi.Object | Mapping) or name == "type"
            if not is_nested and name not in known:
                raise SceneError(
                    f"the {self.element} has no parameter {name!r}; its parameters are "
                    f"{', '.join(known)}"
                )

    def choice(self, name: str, known: Collection[str], default: str | None = None) -> str:
        """Return a parameter that is one of ``known``, by default ``default`` or the first."""
        with scene_errors():
            return checked_choice(self.text(name, default or next(iter(known))), name, known)

    def source(self, wavelength: float) -> PublicSource | Polyhedron:
        """Return the source with its taper, copies and steering."""
        texts = {name: self.text(name, "") for name in SOURCE_TEXTS if name in self.values}
        return apply_texts(self._outline(), texts, wavelength)

    def _outline(self) -> PublicSource | Polyhedron:
        """Return the source of ``aperture`` or ``source``, without taper, copies or steering."""
        given = {key: self.values.get(key) for key in ("aperture", "source")}
        kinds = " (an aperture file such as GeoJSON or DXF, or a source file)"
        parameter = only_given(given, SceneError, f"{kinds} of the {self.element}")
        name = self.text(parameter, "")
        in_file = parameter == "aperture" and not is_key(name)
        for key in ("unit", "tolerance", "layer", "union"):
            if key in self.values and not in_file:
                kind = "an aperture from memory" if is_key(name) else "a source file"
                raise SceneError(
                    f"the parameter {key}={self.values[key]!r} cannot be combined with {kind}, "
                    f"whose coordinates are already in metres; omit {key}"
                )
        if is_key(name):
            return registered_source(name)
        path = Path(str(mi.file_resolver().resolve(name)))
        if not in_file:
            return read_source(path)
        layers = [name.strip() for name in self.text("layer", "").split(";") if name.strip()]
        joins = self.flag("union", False)
        return read_aperture(path, self.text("unit", "mm"), self.number("tolerance"), layers, joins)

    def wavelength(self) -> float:
        """Return the wavelength in m, from exactly one of ``wavelength`` and ``frequency``."""
        given = {name: self.number(name) for name in ("frequency", "wavelength")}
        name = only_given(given, SceneError, f" of the {self.element}")
        number = given[name] or 0.0
        return wavelength_of(number) if name == "frequency" else number

    def polarisation(self, source: SceneSource) -> Complex | None:
        """Return the Jones vectors (2,) or (n, 2) of a source, or None for unpolarised light."""
        text = self.text("polarisation", UNPOLARISED)
        if text.strip().lower() == UNPOLARISED:
            return None
        with scene_errors():
            return polarisation_of_text(text, source)

    def pose(self) -> Floats:
        """Return the pose ``to_world`` in scene units, shape (4, 4), by default the identity."""
        transform = self.values.get("to_world")
        return rigid_pose(np.eye(4) if transform is None else transform.matrix)

    def number(self, name: str) -> float | None:
        """Return a numeric parameter in SI units, or None if it is missing."""
        if name not in self.values:
            return None
        return _number(name, self.values[name], self.element)

    def flag(self, name: str, default: bool) -> bool:
        """Return a parameter that is True or False."""
        value = self.values.get(name, default)
        if not isinstance(value, bool | np.bool_):
            raise self._wrong_type(name, "True or False", "boolean")
        return bool(value)

    def text(self, name: str, default: str) -> str:
        """Return a text parameter."""
        value = self.values.get(name, default)
        if not isinstance(value, str):
            raise self._wrong_type(name, "a string", "string")
        return value

    def _wrong_type(self, name: str, expected: str, tag: str) -> SceneError:
        """Return the error for a parameter of a wrong type; ``tag`` is the required XML tag."""
        value = self.values[name]
        return SceneError(
            f'expected {name} to be {expected}, <{tag} name="{name}" .../> in a scene file, got '
            f"{value!r} of type {type(value).__name__}"
        )


def rigid_pose(matrix: Any) -> Floats:
    """Convert a matrix of NumPy or of any variant of Mitsuba to a read-only pose, shape (4, 4).

    Raises SceneError unless the matrix is a rigid motion.
    """
    try:
        values = np.array(matrix)
        # Matrices of compiled variants have a last axis of length 1.
        return geometry.rigid_pose(values[..., 0] if values.shape == (4, 4, 1) else values)
    except (GeometryError, RuntimeError, ValueError) as error:
        raise SceneError(str(error)) from None


def pose_of(plugin: Any) -> Floats:
    """Return the pose of a source or receiver in its scene, with the translation in metres."""
    spec = plugin.spec
    matrix = np.array(matrix_of(plugin.to_world))
    # Transforms in Mitsuba are in single precision.
    same = np.array_equal(matrix.astype(np.float32), spec.pose.astype(np.float32))
    pose = np.array(spec.pose if same else rigid_pose(matrix))
    pose[:3, 3] *= spec.scene_unit
    return pose


def reach_of(scene: mi.Scene, plugin: Any) -> float:
    """Return the largest absolute coordinate of a source or receiver and of adjacent flat surfaces.

    The coordinates refer to the scene, in scene units.
    """
    pose, (left, bottom, right, top) = pose_of(plugin), plugin.spec.source.bounds
    corners = np.array([[x, y] for x in (left, right) for y in (bottom, top)])
    return extent_near(scene, (corners @ pose[:3, :2].T + pose[:3, 3]) / plugin.spec.scene_unit)
