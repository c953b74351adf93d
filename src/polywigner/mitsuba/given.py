"""Parameters of a scene's element, read one by one, and checked.

The parts that the ``wigner`` shape and the ``wigner_receiver`` sensor have in common.
"""

from __future__ import annotations

import hashlib
import threading
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np
import numpy.typing as npt

from polywigner import geometry
from polywigner.errors import GeometryError, SceneError
from polywigner.geometry import (
    Aperture,
    PlacedAperture,
    Polyhedron,
    Slits,
    Wavefront,
    read_aperture,
)
from polywigner.illumination import Array, read_source
from polywigner.illumination.source_files import json_of, table_of
from polywigner.illumination.texts import FEEDING, fed
from polywigner.quantities import parse_frequency, parse_length, wavelength_of

KEY_PREFIX = "memory:"

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
        raise SceneError(
            f"expected an Aperture or an Array, got {type(source).__name__}; make one with "
            "polywigner.Aperture(vertices)"
        )
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


SOURCE_PARAMETERS = (
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
)
"""Of the source, its field and its pose."""


@dataclass(frozen=True)
class Given:
    """The parameters of one element of a scene.

    Its methods raise SceneError for a missing, doubled or unusable parameter.
    """

    values: dict[str, Any]
    element: str
    """Such as "wigner shape", for messages."""

    @classmethod
    def of(cls, props: Any, element: str) -> Given:
        """Parameters of Mitsuba's ``Properties``."""
        return cls({name: props[name] for name in props.keys()}, element)  # noqa: SIM118 (no dict)

    def check_names(self, known: tuple[str, ...]) -> None:
        """Raise SceneError for a parameter of another name; nested objects have any."""
        for name, value in self.values.items():
            if not isinstance(value, mi.Object) and name not in known:
                raise SceneError(
                    f"expected the parameters {', '.join(known)} of a {self.element}, got {name!r}"
                )

    def source(self, wavelength: float) -> Any:
        """The source with its taper and copies, steered."""
        texts = {name: self.text(name, None) for name in FEEDING if name in self.values}
        return fed(self._outline(), texts, wavelength)

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

    def scene_unit(self) -> float:
        """In metres."""
        value = self.values.get("scene_unit", 1.0)
        if isinstance(value, str) and value.strip()[:1].isalpha():
            value = f"1 {value}"
        return Given({"scene_unit": value}, self.element).number("scene_unit", parse_length)

    def pose(self) -> npt.NDArray[np.float64]:
        """A read-only (4, 4) matrix."""
        given = self.values.get("to_world")
        return rigid_pose(np.eye(4) if given is None else given.matrix)

    def optional(self, name: str, parse: Callable[[Any], float]) -> float | None:
        """A number, or None where there is none."""
        return self.number(name, parse) if name in self.values else None

    def number(self, name: str, parse: Callable[[Any], float]) -> float:
        """A number, or the text of one."""
        value = self.values[name]
        if not isinstance(value, (str, int, float)) or isinstance(value, bool):
            raise SceneError(f"expected a number or a text as {name}, got {type(value).__name__}")
        try:
            return float(parse(value))
        except ValueError as error:
            raise SceneError(f"{name} of the {self.element}: {error}") from None

    def flag(self, name: str, default: bool) -> bool:
        """True or false."""
        value = self.values.get(name, default)
        if not isinstance(value, bool):
            raise SceneError(
                f'expected <boolean name="{name}" .../>, got a parameter of type '
                f"{type(value).__name__}"
            )
        return value

    def text(self, name: str, default: str | None) -> str:
        """A text; without a default it must be there."""
        value = self.values.get(name, default)
        if value is None:
            raise SceneError(
                f"expected the parameter {name!r} of a {self.element}, got none; give the file of "
                "an aperture (GeoJSON, WKT, CSV, SVG or DXF), or a source file (TOML or JSON) as "
                "source"
            )
        if not isinstance(value, str):
            raise SceneError(
                f'expected <string name="{name}" .../>, got a parameter of type '
                f"{type(value).__name__}"
            )
        return value


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


def as_source(given: Any) -> Any:
    """A source as it is; an Aperture of anything else. GeometryError for no outline."""
    kinds = Aperture | Array | Wavefront | PlacedAperture | Slits | Polyhedron
    return given if isinstance(given, kinds) else Aperture(given)


def pose_entry(to_world: Any) -> dict[str, Any]:
    """The key ``to_world`` for a matrix or a transform of any variant; nothing for None.

    Raises SceneError for a pose that is not rigid.
    """
    if to_world is None:
        return {}
    pose = rigid_pose(getattr(to_world, "matrix", to_world))
    return {"to_world": mi.scalar_rgb.ScalarTransform4f(pose)}
