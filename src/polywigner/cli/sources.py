"""Options of the source of a command: files, wavelengths, and bodies in the way."""

from __future__ import annotations

import json
import math
import os
import warnings
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import typer

from polywigner.errors import ArgumentError, FileFormatError, at_key, value_text
from polywigner.quantities import (
    SPEED_OF_LIGHT,
    parse_angle,
    parse_coordinate,
    parse_frequency,
    parse_length,
    parse_unit,
    wavelength_of,
)

_FREQUENCIES = (("THz", 1e12), ("GHz", 1e9), ("MHz", 1e6), ("kHz", 1e3), ("Hz", 1.0))
_LONGEST_NAME = 32
_MESHES = (".stl", ".ply", ".obj")
_SAME_WAVELENGTH = 1e-3  # relative: a wavelength is typed with a few digits
_ABSURD = 1e12  # ratio of wavelength and diameter: a slip, and no axes of a figure


@dataclass(frozen=True, kw_only=True)
class WaveOptions:
    """A frequency or a wavelength."""

    frequency: Annotated[str | None, "Frequency, such as '94 GHz'."] = None
    wavelength: Annotated[str | None, "Wavelength, such as '3.19 mm', instead of --frequency."] = (
        None
    )

    def length(self) -> float | None:
        """Return the wavelength in metres; None without both."""
        if self.frequency is not None and self.wavelength is not None:
            raise ArgumentError("expected --frequency or --wavelength, got both; drop one of them")
        if self.frequency is not None:
            return wavelength_of(parse_frequency(self.frequency))
        return None if self.wavelength is None else parse_length(self.wavelength)


def required_wavelength(wavelength: float | None) -> float:
    """Return a wavelength; raise ArgumentError if neither options nor a source file have one."""
    if wavelength is None:
        raise ArgumentError(
            'expected --frequency or --wavelength, got neither; give for example --frequency "94 '
            'GHz"'
        )
    return wavelength


@dataclass(frozen=True, kw_only=True)
class Reading:
    """Options for reading an aperture file."""

    unit: Annotated[
        str | None, "Unit of an aperture file, where it does not say (default: mm)."
    ] = None
    tolerance: Annotated[
        str | None, "Largest distance of chords from curves (SVG, DXF), such as '1 um'."
    ] = None
    layer: Annotated[
        list[str] | None, "Layer or group of a drawing to read alone; several times for more."
    ] = None
    union: Annotated[bool, "Join shapes of an aperture file that overlap."] = False

    def check_file(self, path: str) -> None:
        """Raise errors of the path and the tolerance before heavy imports."""
        self.reading_arguments()
        if not os.path.isfile(path):  # noqa: PTH113 (pathlib raises for a name too long)
            raise FileFormatError(
                f"expected an aperture file, got {path!r}, which is not a file; check its path"
            )

    def read_file(self, path: str) -> Any:
        """Return the source of an aperture file."""
        import polywigner as pw

        return pw.read_aperture(path, **self.reading_arguments())

    def read_body(self, path: str, as_plates: bool = False) -> Any:
        """Return the body of a mesh, or its faces as plates; or the outline of a drawing."""
        import polywigner as pw

        if Path(path).suffix.lower() not in _MESHES:
            if as_plates:
                raise ArgumentError(
                    "expected --open-mesh with a mesh (STL, PLY, OBJ), got a drawing"
                )
            return self.read_file(path)
        for name in ("tolerance", "layer", "union"):
            if getattr(self, name):
                raise ArgumentError(f"expected no --{name} with a mesh; it is for drawings")
        read = pw.read_sheets if as_plates else pw.read_polyhedron
        return read(path, unit=self.unit or "mm")

    def reading_arguments(self) -> dict[str, Any]:
        """Return the arguments of :func:`polywigner.read_aperture`."""
        tolerance = None if self.tolerance is None else parse_length(self.tolerance)
        unit = self.unit or "mm"
        return {"unit": unit, "tolerance": tolerance, "layer": self.layer, "union": self.union}


@dataclass(frozen=True, kw_only=True)
class SourceOptions(Reading, WaveOptions):
    """Options of the source of a command: its file, tapers, copies, steering, and wavelength."""

    source: Annotated[
        str,
        typer.Argument(
            help="Aperture file: GeoJSON, WKT, SVG, DXF, GDSII, or CSV with one ring; or a source "
            "file: TOML or JSON."
        ),
    ]
    allow_outside: Annotated[bool, "Read files that a source file names outside of its folder."] = (
        False
    )
    taper: Annotated[
        str | None, "Taper of the aperture: 'cosine', 'cosine 2 x', 'te10', 'taylor 30 dB 4'."
    ] = None
    array: Annotated[str | None, "Copies of the aperture, such as '12 x 16, 2 mm'."] = None
    window: Annotated[
        str | None, "Window of the array: 'taylor 25 dB', 'chebyshev 30 dB', 'hamming'."
    ] = None
    steering: Annotated[str | None, "A beam towards theta, phi, such as '20 deg, 90 deg'."] = None
    focus: Annotated[str | None, "Focal point of the array, such as '0 mm, 0 mm, 80 mm'."] = None
    curved: Annotated[
        str | None,
        "Radius of a curved wave, or one along x and one along y: '60 mm', '60 mm, inf'.",
    ] = None

    def check(self) -> None:
        """Raise the errors that need no heavy imports."""
        self.check_file(self.source)
        self.length()

    def read(self) -> tuple[Any, float | None]:
        """Return the source, and the wavelength in m of the options or else of the file."""
        from polywigner.figures import outline_of
        from polywigner.source.source_files import read_content
        from polywigner.source.source_tables import SOURCE_TEXTS, apply_texts

        wavelength = self.length()
        if _is_source_file(self.source):
            for name in ("unit", "tolerance", "layer", "union"):
                if getattr(self, name):
                    raise ArgumentError(
                        f"expected no --{name} with a source file; write it into the file"
                    )
            source, designed, _ = read_content(self.source, self.allow_outside)
            wavelength = self._compared(wavelength, designed)
        else:
            source = self.read_file(self.source)
        texts = ((name, getattr(self, name, None)) for name in SOURCE_TEXTS)
        given = {name: text for name, text in texts if text is not None}
        source = apply_texts(source, given, wavelength)
        if wavelength is not None:
            check_wavelength(wavelength, outline_of(source).diameter)
        return source, wavelength

    def _compared(self, wavelength: float | None, designed: float | None) -> float | None:
        """Return the wavelength to use; warn if it is not the one of a source file's phases."""
        if wavelength is None or designed is None:
            return designed if wavelength is None else wavelength
        if abs(wavelength - designed) > _SAME_WAVELENGTH * designed:
            warnings.warn(
                f"the phases in {Path(self.source).name} are set for its own wavelength of "
                f"{designed:.6g} m, and its beam is shown at {wavelength:.6g} m, where it squints; "
                "leave --frequency and --wavelength out to see it at its own",
                RuntimeWarning,
                stacklevel=2,
            )
        return wavelength

    def polarisation(self) -> Any:
        """Return the Jones vectors of a source file; None without."""
        from polywigner import read_polarisation

        is_source = _is_source_file(self.source)
        return read_polarisation(self.source, self.allow_outside) if is_source else None

    def read_with_wavelength(self) -> tuple[Any, float]:
        """Return the source and its wavelength in m; raise ArgumentError without one."""
        source, wavelength = self.read()
        return source, required_wavelength(wavelength)


def check_wavelength(wavelength: float, diameter: float) -> None:
    """Warn of a wavelength (m) that hardly belongs to an aperture; refuse an absurd one."""
    from polywigner.geometry.arguments import doubt_of_wavelength

    doubt = doubt_of_wavelength(wavelength, diameter)
    if doubt and not 1 / _ABSURD <= wavelength / diameter <= _ABSURD:
        raise ArgumentError(f"expected a wavelength that belongs to the aperture, got {doubt}")
    if doubt:
        warnings.warn(f"got {doubt}", RuntimeWarning, stacklevel=2)


def field_title(path: str, wavelength: float) -> str:
    """Return the title of a figure of a field: the source's file, frequency and wavelength."""
    from polywigner.geometry.display import length_text

    printed = length_text(wavelength)
    return f"{short_name(path)}, {frequency_text(wavelength)} (wavelength {printed})"


def short_name(path: str) -> str:
    """Return the name of a file for a title, shortened if long.

    A file named ``scene.xml`` is named after its folder.
    """
    file = Path(path)
    name = file.resolve().parent.name if file.stem == "scene" else file.name
    if len(name) > _LONGEST_NAME:
        name = f"{name[:20]}…{name[-11:]}"
    return name.replace("$", r"\$")  # no formula of Matplotlib


def frequency_text(wavelength: float) -> str:
    """Return the frequency of a wavelength in metres as text."""
    frequency = SPEED_OF_LIGHT / wavelength
    named = [(name, size) for name, size in _FREQUENCIES if frequency >= 0.9995 * size]
    name, size = named[0] if named else _FREQUENCIES[-1]
    return f"{frequency / size:.4g} {name}"


def _is_source_file(path: str) -> bool:
    """Return whether a file is TOML, or JSON with a kind at its top, which GeoJSON lacks."""
    from polywigner.geometry.io.limits import bytes_of

    suffix = Path(path).suffix.lower()
    if suffix == ".json":
        with suppress(ValueError, RecursionError, OSError):  # the reader of apertures reports it
            content = json.loads(bytes_of(Path(path)))
            return isinstance(content, dict) and "kind" in content and "type" not in content
    return suffix == ".toml"


@dataclass(frozen=True, kw_only=True)
class FieldSourceOptions(SourceOptions):
    """Options of a source that may be partly coherent, and of bodies and plates in the way."""

    coherence: Annotated[
        str | None, "Width over which the source is coherent, such as '0.5 mm'."
    ] = None
    obstacle: Annotated[
        list[str] | None,
        "Body or plate in the way, whose shadow diffracts: a mesh (STL, PLY, OBJ) or an "
        "aperture file, and its place: 'box.stl', 'plate.svg at 0 mm, 10 mm, 150 mm', "
        "'plate.svg at 0 mm, 0 mm, 150 mm towards 30 deg, 90 deg' with theta and phi of the "
        "direction into which its z axis is turned; several times for more.",
    ] = None
    obstacle_unit: Annotated[
        str | None, "Unit of the files of obstacles, where they do not say (default: mm)."
    ] = None

    def check(self) -> None:
        """Raise the errors that need no heavy imports."""
        super().check()
        for text in self.obstacle or ():
            Reading().check_file(_placed_file(text)[0])
        if self.obstacle_unit is not None:
            parse_unit(self.obstacle_unit)
            if not self.obstacle:
                raise ArgumentError("expected --obstacle-unit with --obstacle, got it alone")

    def read_obstacles(self) -> list[Any]:
        """Return the bodies and placed plates."""
        with at_key("--obstacle"):
            return [self._placed(*_placed_file(text)) for text in self.obstacle or ()]

    def _placed(self, path: str, place: tuple[float, ...], angles: tuple[float, ...]) -> Any:
        """Return a body whose z axis is turned by the smallest angle, and its origin moved."""
        import numpy as np

        from polywigner import Polyhedron

        theta, phi = angles
        axis = np.array([-math.sin(phi), math.cos(phi), 0.0])
        cross = np.cross(np.eye(3), axis)  # of axis with v, as a matrix
        pose = np.eye(4)
        pose[:3, :3] += math.sin(theta) * cross + (1.0 - math.cos(theta)) * cross @ cross
        pose[:3, 3] = place
        body = Reading(unit=self.obstacle_unit).read_body(path)
        if isinstance(body, Polyhedron):
            return Polyhedron(body.vertices @ pose[:3, :3].T + pose[:3, 3], body.faces)
        return body.placed(pose)


def _placed_file(text: str) -> tuple[str, tuple[float, ...], tuple[float, ...]]:
    """Return the file, the position of its origin in m, and theta and phi of its z axis in rad."""
    path, at, where = text.rpartition(" at ")
    if not at:
        return text, (0.0, 0.0, 0.0), (0.0, 0.0)
    place, _, direction = where.partition(" towards ")
    with at_key("--obstacle"):
        point = tuple(parse_coordinate(part) for part in place.split(","))
        angles = tuple(parse_angle(part) for part in direction.split(",")) if direction else (0, 0)
        if len(point) != 3 or len(angles) != 2:
            raise ArgumentError(
                'expected a file, a point and perhaps a direction, such as "plate.svg at 0 mm, '
                f'0 mm, 150 mm towards 30 deg, 90 deg", got {value_text(text)}'
            )
    return path.strip(), point, angles
