"""The parameters of the ``wigner`` shape, read from a scene and checked.

Their meaning is the table in ``docs/plugin.md``. What single precision, in which Mitsuba computes,
cannot hold is refused here: the picture would be black or not a number.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from numbers import Real
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np
import numpy.typing as npt

from polywigner import geometry
from polywigner.errors import GeometryError, SceneError
from polywigner.geometry import Aperture, read_aperture
from polywigner.illumination import Array, read_source
from polywigner.illumination.texts import FEEDING, fed
from polywigner.mitsuba.exact import ESTIMATORS, check_estimator
from polywigner.mitsuba.obliquity import OBLIQUITIES, check_obliquity
from polywigner.mitsuba.radiator import Radiator, emitted_power, radiator_of
from polywigner.mitsuba.sampling import SAMPLINGS, check_sampling
from polywigner.mitsuba.sources import is_key, registered_source
from polywigner.quantities import parse_frequency, parse_length, parse_power, wavelength_of

__all__ = [
    "PARAMETERS",
    "EmitterSpec",
    "check_flag",
    "check_range",
    "check_sampling_weight",
    "read_parameters",
    "rigid_pose",
]

PARAMETERS = (
    "aperture",
    "unit",
    "tolerance",
    "layer",
    "union",
    "source",
    "frequency",
    "wavelength",
    *FEEDING,
    "to_world",
    "power",
    "radiated_power",
    "obliquity",
    "estimator",
    "antithetic",
    "sampling",
    "control_variate",
    "scene_unit",
    "sampling_weight",
    "visible",
)

# Decimal exponents of the normal numbers of single precision.
_SMALLEST = math.log10(np.finfo(np.float32).tiny)
_LARGEST = math.log10(np.finfo(np.float32).max)


@dataclass(frozen=True, eq=False)
class EmitterSpec:
    """All that the emitter of one ``wigner`` shape needs, in SI units."""

    radiator: Radiator
    wavelength: float
    power: float
    pose: npt.NDArray[np.float64]
    """(4, 4), read-only; the translation in scene units."""
    obliquity: str = OBLIQUITIES[0]
    estimator: str = ESTIMATORS[0]
    scene_unit: float = 1.0
    """Metres."""
    sampling_weight: float = 1.0
    sampling: str = SAMPLINGS[0]
    control_variate: bool = False
    visible: bool = True
    """Whether rays meet its surface."""

    @property
    def source(self) -> Aperture | Array:
        """The source that the scene asked for."""
        return self.radiator.source


def read_parameters(props: Any) -> EmitterSpec:
    """The checked parameters of a ``wigner`` shape from Mitsuba's ``Properties``.

    Raises
    ------
    SceneError for an unknown, missing, doubled or unusable parameter; the errors of
    :func:`polywigner.read_aperture` and :func:`polywigner.read_source` for a file, and those of
    tapers, steering and layouts for their texts.
    """
    values = {name: props[name] for name in props.keys()}  # noqa: SIM118 (not a dict)
    _reject_unknown(values)
    obliquity = check_obliquity(_text(values, "obliquity", OBLIQUITIES[0]))
    powers = [
        _number(values, name, parse_power) if name in values else None
        for name in ("power", "radiated_power")
    ]
    wavelength = _wavelength(values)
    scene_unit = _scene_unit(values.get("scene_unit", 1.0))
    texts = {name: _text(values, name, None) for name in FEEDING if name in values}
    antithetic = _flag(values, "antithetic", False)
    radiator = radiator_of(fed(_source(values), texts, wavelength), obliquity, antithetic)
    power = emitted_power(radiator, wavelength, obliquity, *powers)
    check_range(radiator, wavelength, power, scene_unit)
    varied = _flag(values, "control_variate", False)
    estimator = _text(values, "estimator", ESTIMATORS[0])
    check_estimator(estimator, radiator.source, wavelength, obliquity, antithetic, varied)
    return EmitterSpec(
        radiator=radiator,
        wavelength=wavelength,
        power=power,
        pose=rigid_pose(values["to_world"].matrix if "to_world" in values else np.eye(4)),
        obliquity=obliquity,
        estimator=estimator,
        scene_unit=scene_unit,
        sampling_weight=check_sampling_weight(values.get("sampling_weight", 1.0)),
        sampling=check_sampling(_text(values, "sampling", SAMPLINGS[0])),
        control_variate=varied,
        visible=_flag(values, "visible", True),
    )


def rigid_pose(matrix: Any) -> npt.NDArray[np.float64]:
    """A read-only (4, 4) pose from a matrix or from one of Mitsuba's, of any variant.

    Raises SceneError for anything but rotations and translations, and for what single precision
    cannot hold.
    """
    try:
        given = np.asarray(matrix, dtype=np.float64)
    except (TypeError, ValueError, RuntimeError):
        given = np.empty(0)
    if given.shape not in ((4, 4), (4, 4, 1)):  # with a last axis of 1 from compiled variants
        shown = f"one of shape {given.shape}" if given.size else type(matrix).__name__
        raise SceneError(
            f"expected a (4, 4) matrix as to_world, got {shown}; give one, or a transform such as "
            "mitsuba.ScalarTransform4f().translate([0, 0, 1])"
        )
    if not (np.abs(given) <= np.finfo(np.float32).max).all():
        raise SceneError(f"expected a finite to_world, got {given.tolist()}")
    try:
        return geometry.rigid_pose(given.reshape(4, 4))
    except GeometryError as error:
        raise SceneError(str(error)) from None


def check_range(
    radiator: Radiator, wavelength: float, power: float, scene_unit: float = 1.0
) -> None:
    """Raise SceneError where single precision cannot hold what the emitter computes.

    `wavelength` and `scene_unit` in metres, `power` in watts; none below zero.
    """
    # Logarithms, because the numbers themselves may leave double precision as well.
    energy, inverse_square = _exponent(radiator.energy), -2 * _exponent(wavelength)
    area_in_scene = _exponent(radiator.support.area) - 2 * _exponent(scene_unit)
    radiance = _exponent(power) + inverse_square
    _fits("wavelength", f"{wavelength:.6g} m", -inverse_square / 2, inverse_square)
    _fits("wavelength", f"{wavelength:.6g} m", inverse_square - energy)
    _fits("scene_unit", f"{scene_unit:.6g} m", area_in_scene)
    if power > 0:
        steps = (radiance, radiance - energy, radiance + area_in_scene)
        _fits("power", f"{power:.6g} W", _exponent(power), *steps)


def check_sampling_weight(value: Any) -> float:
    """The value as a float; SceneError unless it is a finite number of zero or more."""
    number = isinstance(value, Real) and not isinstance(value, bool)
    if not number or not (value >= 0 and _exponent(value) < _LARGEST):
        raise SceneError(
            f"expected a finite sampling_weight of zero or more, got {value!r}; 1 is the default"
        )
    return float(value)


def check_flag(name: str, value: Any) -> bool:
    """The value as True or False; SceneError for anything else, such as the text "false"."""
    if not isinstance(value, bool | np.bool_):
        raise SceneError(f"expected {name} to be True or False, got {value!r}; give one of them")
    return bool(value)


def _exponent(value: Any) -> float:
    return math.log10(value) if value > 0 else -math.inf


def _fits(name: str, shown: str, *exponents: float) -> None:
    for exponent in exponents:
        if not _SMALLEST < exponent < _LARGEST:
            raise SceneError(
                f"expected a {name} that single precision can compute with, got {shown}, which "
                f"leads to numbers of the order 1e{exponent:+.0f}; check its unit"
            )


def _reject_unknown(values: dict[str, Any]) -> None:
    for name, value in values.items():
        nested = isinstance(value, mi.Object)
        if nested and type(value).__name__ in ("Emitter", "Sensor"):
            raise SceneError(
                f"expected no {type(value).__name__.lower()} inside a wigner shape, got "
                f"{name!r}; the shape brings its own emitter"
            )
        if not nested and name not in PARAMETERS:
            raise SceneError(
                f"expected the parameters {', '.join(PARAMETERS)} of a wigner shape, got {name!r}"
            )


def _source(values: dict[str, Any]) -> Any:
    """The source from its file, or from memory, before its taper and copies."""
    given = [name for name in ("aperture", "source") if name in values]
    if len(given) == 2:
        raise SceneError(
            "expected an aperture or a source of the wigner shape, got both; a source file can "
            "take its outline from an aperture file"
        )
    name = _text(values, (given or ["aperture"])[0], None)
    in_file = given == ["aperture"] and not is_key(name)
    for key in ("unit", "tolerance", "layer", "union"):
        if key in values and not in_file:
            kind = "an aperture from memory" if is_key(name) else "a source file"
            raise SceneError(
                f"expected no {key} with {kind}, got {values[key]!r}; its coordinates are in "
                "metres already"
            )
    if is_key(name):
        return registered_source(name)
    path = Path(str(mi.file_resolver().resolve(name)))
    if not in_file:
        return read_source(path)
    tolerance = _number(values, "tolerance", parse_length) if "tolerance" in values else None
    layers = [name.strip() for name in _text(values, "layer", "").split(";") if name.strip()]
    joins = _flag(values, "union", False)
    return read_aperture(path, _text(values, "unit", "mm"), tolerance, layers, joins)


def _wavelength(values: dict[str, Any]) -> float:
    given = [name for name in ("frequency", "wavelength") if name in values]
    if len(given) != 1:
        got = "both" if given else "neither"
        raise SceneError(
            f"expected a frequency or a wavelength of the wigner shape, got {got}; give one, such "
            'as frequency "94 GHz"'
        )
    if given == ["frequency"]:
        return wavelength_of(_number(values, "frequency", parse_frequency))
    return _number(values, "wavelength", parse_length)


def _scene_unit(value: Any) -> float:
    if isinstance(value, str) and value.strip()[:1].isalpha():
        value = f"1 {value}"
    return _number({"scene_unit": value}, "scene_unit", parse_length)


def _number(values: dict[str, Any], name: str, parse: Any) -> float:
    value = values[name]
    if not isinstance(value, (str, int, float)) or isinstance(value, bool):
        raise SceneError(f"expected a number or a text as {name}, got {type(value).__name__}")
    try:
        return float(parse(value))
    except ValueError as error:
        raise SceneError(f"{name} of the wigner shape: {error}") from None


def _flag(values: dict[str, Any], name: str, default: bool) -> bool:
    value = values.get(name, default)
    if not isinstance(value, bool):
        raise SceneError(
            f'expected <boolean name="{name}" .../>, got a parameter of type {type(value).__name__}'
        )
    return value


def _text(values: dict[str, Any], name: str, default: str | None) -> str:
    value = values.get(name, default)
    if value is None:
        raise SceneError(
            f"expected the parameter {name!r} of a wigner shape, got none; give the file of an "
            "aperture (GeoJSON, WKT, CSV, SVG or DXF), or a source file (TOML or JSON) as source"
        )
    if not isinstance(value, str):
        raise SceneError(
            f'expected <string name="{name}" .../>, got a parameter of type {type(value).__name__}'
        )
    return value
