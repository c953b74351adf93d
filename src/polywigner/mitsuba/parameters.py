"""The parameters of the ``wigner`` shape, read from a scene and checked.

==================  =============================================================================
``aperture``        file (beside the scene, or on Mitsuba's search path), or a key of
                    :func:`polywigner.mitsuba.register_source`
``unit``            of the file's coordinates; default ``mm``
``frequency``       text such as ``94 GHz``, or a number in hertz
``wavelength``      text such as ``3.19 mm``, or a number in metres, instead of ``frequency``
``to_world``        rigid pose; the aperture lies in its plane z = 0 and radiates to its +z
``power``           text such as ``10 mW`` or watts: the integral of |u|^2 over the aperture;
                    default: |u| = 1, so that the power is the aperture's area in m^2
``obliquity``       which diffraction integral a parallel floor receives, see ``obliquity.py``
``scene_unit``      length of one unit of the scene, such as ``mm`` or ``0.1 m``; default 1 m
``sampling_weight`` relative number of samples spent on this emitter; default 1
nested BSDF         of the surface that radiates; default ``null``, so that it casts no shadow
nested media        ``interior`` and ``exterior``, as for any Mitsuba shape
==================  =============================================================================

On ``scene_unit``: Mitsuba starts its rays about 1e-4 of a scene unit off the surfaces, a tenth of a
millimetre in a scene in metres. For receivers within some centimetres of the aperture, and for all
of optics, write the scene in a smaller unit and say so here.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np
import numpy.typing as npt

from polywigner.errors import SceneError
from polywigner.geometry import Aperture, read_aperture
from polywigner.mitsuba.obliquity import OBLIQUITIES, check_obliquity
from polywigner.mitsuba.sources import is_key, registered_source
from polywigner.quantities import parse_frequency, parse_length, parse_power, wavelength_of

__all__ = ["EmitterSpec", "read_parameters", "rigid_pose"]

_PARAMETERS = (
    "aperture",
    "unit",
    "frequency",
    "wavelength",
    "to_world",
    "power",
    "obliquity",
    "scene_unit",
    "sampling_weight",
)

# Scene files give angles in single precision: a product of a few such rotations departs from a
# rotation by some 1e-6. A scale that anybody wants differs by more than this.
_RIGID_TOLERANCE = 1e-4


@dataclass(frozen=True, eq=False)
class EmitterSpec:
    """What the emitter of one ``wigner`` shape needs, in SI units."""

    aperture: Aperture
    wavelength: float
    power: float
    pose: npt.NDArray[np.float64]
    """(4, 4), read-only; the translation in scene units."""
    obliquity: str = OBLIQUITIES[0]
    scene_unit: float = 1.0
    """Metres."""
    sampling_weight: float = 1.0


def read_parameters(props: Any) -> EmitterSpec:
    """The checked parameters of a ``wigner`` shape from Mitsuba's ``Properties``.

    Raises
    ------
    SceneError for an unknown, missing, doubled or unusable parameter; the errors of
    :func:`polywigner.read_aperture` for a file.
    """
    values = {name: props[name] for name in props.keys()}  # noqa: SIM118 (not a dict)
    _reject_unknown(values)
    aperture = _aperture(values)
    power = _number(values, "power", parse_power) if "power" in values else aperture.area
    return EmitterSpec(
        aperture=aperture,
        wavelength=_wavelength(values),
        power=power,
        pose=rigid_pose(values["to_world"].matrix if "to_world" in values else np.eye(4)),
        obliquity=check_obliquity(_text(values, "obliquity", OBLIQUITIES[0])),
        scene_unit=_scene_unit(values.get("scene_unit", 1.0)),
        sampling_weight=_sampling_weight(values.get("sampling_weight", 1.0)),
    )


def rigid_pose(matrix: Any) -> npt.NDArray[np.float64]:
    """A (4, 4) pose from a matrix that is a rotation and a translation up to rounding.

    Raises SceneError for anything else: a scaled or sheared aperture would be another aperture,
    whose transforms this one's are not.
    """
    given = np.asarray(matrix, dtype=np.float64).reshape(4, 4)
    if not np.isfinite(given).all():
        raise SceneError(f"expected a finite to_world, got {given.tolist()}")
    rotation = given[:3, :3]
    if not np.allclose(given[3], (0.0, 0.0, 0.0, 1.0)):
        raise SceneError("expected a rigid to_world, got a perspective transformation")
    excess = float(np.abs(rotation.T @ rotation - np.eye(3)).max())
    if excess > _RIGID_TOLERANCE:
        scales = ", ".join(f"{scale:.6g}" for scale in np.linalg.svd(rotation, compute_uv=False))
        raise SceneError(
            f"expected a to_world of rotations and translations only, got one that scales by "
            f"{scales}; scale the aperture itself, or set its unit"
        )
    if np.linalg.det(rotation) < 0:
        raise SceneError(
            "expected a to_world of rotations and translations only, got a mirror image; "
            "mirror the aperture itself"
        )
    pose = given.copy()
    left, _, right = np.linalg.svd(rotation)
    pose[:3, :3] = left @ right  # the nearest rotation
    pose.flags.writeable = False
    return pose


def _reject_unknown(values: dict[str, Any]) -> None:
    for name, value in values.items():
        nested = isinstance(value, mi.Object)
        if nested and type(value).__name__ in ("Emitter", "Sensor"):
            raise SceneError(
                f"expected no {type(value).__name__.lower()} inside a wigner shape, got "
                f"{name!r}; the shape brings its own emitter"
            )
        if not nested and name not in _PARAMETERS:
            raise SceneError(
                f"expected the parameters {', '.join(_PARAMETERS)} of a wigner shape, got {name!r}"
            )


def _aperture(values: dict[str, Any]) -> Aperture:
    name = _text(values, "aperture", None)
    if is_key(name):
        if "unit" in values:
            raise SceneError(
                f"expected no unit with an aperture from memory, got {values['unit']!r}; its "
                "coordinates are in metres already"
            )
        return registered_source(name)
    path = Path(str(mi.file_resolver().resolve(name)))
    return read_aperture(path, unit=_text(values, "unit", "mm"))


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


def _text(values: dict[str, Any], name: str, default: str | None) -> str:
    value = values.get(name, default)
    if value is None:
        raise SceneError(
            f"expected the parameter {name!r} of a wigner shape, got none; give the file of an "
            "aperture (GeoJSON, WKT or CSV)"
        )
    if not isinstance(value, str):
        raise SceneError(
            f'expected <string name="{name}" .../>, got a parameter of type {type(value).__name__}'
        )
    return value


def _sampling_weight(value: Any) -> float:
    number = isinstance(value, (int, float)) and not isinstance(value, bool)
    if not number or not (math.isfinite(value) and value >= 0):
        raise SceneError(f"expected a finite sampling_weight of zero or more, got {value!r}")
    return float(value)
