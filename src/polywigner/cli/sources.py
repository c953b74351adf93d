"""Sources, bodies in the way and wavelengths as commands are given them."""

from __future__ import annotations

import json
import math
import os
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import typer

from polywigner.cli import options
from polywigner.cli.output import check_text
from polywigner.errors import (
    ArgumentError,
    FileFormatError,
    IlluminationError,
    PolywignerError,
    QuantityError,
)
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

# A frequency and the wavelength typed for it, with a few digits.
_SAME_WAVELENGTH = 1e-3
# Wavelengths to a diameter: nothing but a slip; and pictures cannot have axes of 1e-300.
_ABSURD = 1e12


@dataclass(frozen=True)
class Reading:
    """Options for reading an aperture file."""

    unit: options.Unit = None
    tolerance: options.Tolerance = None
    layer: options.Layer = None
    union: options.Union = False

    def check(self, path: str) -> None:
        """Raise the errors of a path and a tolerance before anything heavy is imported."""
        self._arguments()
        check_text("the aperture file", path)
        if not os.path.isfile(path):  # noqa: PTH113 (pathlib raises for a name too long)
            raise FileFormatError(
                f"expected an aperture file, got {path!r}, which is not a file; check its path"
            )

    def read(self, path: str) -> Any:
        """The source of an aperture file."""
        import polywigner as pw

        return pw.read_aperture(path, **self._arguments())

    def read_body(self, path: str, as_plates: bool = False) -> Any:
        """The body of a mesh, or its faces as plates; or the outline of an aperture file."""
        import polywigner as pw

        if Path(path).suffix.lower() not in _MESHES:
            if as_plates:
                raise ArgumentError(
                    "expected --open-mesh with a mesh (STL, PLY, OBJ), got a drawing"
                )
            return self.read(path)
        for name in ("tolerance", "layer", "union"):
            if getattr(self, name):
                raise ArgumentError(f"expected no --{name} with a mesh; it is for drawings")
        read = pw.read_sheets if as_plates else pw.read_polyhedron
        return read(path, unit=self.unit or "mm")

    def _arguments(self) -> dict[str, Any]:
        tolerance = None if self.tolerance is None else parse_length(self.tolerance)
        unit = self.unit or "mm"
        return {"unit": unit, "tolerance": tolerance, "layer": self.layer, "union": self.union}


@dataclass(frozen=True)
class SourceOptions:
    """Options of the source of a command: its file, tapers, copies, steering, and wavelength."""

    source: Annotated[
        str,
        typer.Argument(
            help="Aperture file: GeoJSON, WKT, SVG, DXF, GDSII, or CSV with one ring; or a source "
            "file: TOML or JSON."
        ),
    ]
    frequency: options.Frequency = None
    wavelength: options.Wavelength = None
    unit: options.Unit = None
    tolerance: options.Tolerance = None
    layer: options.Layer = None
    union: options.Union = False
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
        """Raise the errors that can be known before anything heavy is imported."""
        self._reading.check(self.source)
        wavelength_from(self.frequency, self.wavelength)

    @property
    def _reading(self) -> Reading:
        return Reading(self.unit, self.tolerance, self.layer, self.union)

    def read(self) -> tuple[Any, float | None]:
        """The source, and the wavelength in m, None where neither options nor file say one."""
        from polywigner.figures import outline_of
        from polywigner.source.texts import SOURCE_TEXTS, apply_texts

        wavelength = wavelength_from(self.frequency, self.wavelength)
        if _is_source_file(self.source):
            for name, given in vars(self._reading).items():
                if given:
                    raise ArgumentError(
                        f"expected no --{name} with a source file, got {given!r}; write it into "
                        "the file"
                    )
            source, wavelength = self._read_source_file(wavelength)
        else:
            source = self._reading.read(self.source)
        texts = ((name, getattr(self, name, None)) for name in SOURCE_TEXTS)
        given = {name: text for name, text in texts if text is not None}
        source = apply_texts(source, given, wavelength)
        if wavelength is not None:
            check_wavelength(wavelength, outline_of(source).diameter)
        return source, wavelength

    def _read_source_file(self, wavelength: float | None) -> tuple[Any, float | None]:
        """The source, and the wavelength that was asked for, or else its own."""
        from polywigner.source.source_files import read_content

        source, own, _ = read_content(self.source, self.allow_outside)
        if wavelength is None or own is None:
            return source, own if wavelength is None else wavelength
        if abs(wavelength - own) > _SAME_WAVELENGTH * own:
            warnings.warn(
                f"the phases in {Path(self.source).name} are set for its own wavelength of "
                f"{own:.6g} m, and its beam is shown at {wavelength:.6g} m, where it squints; "
                "leave --frequency and --wavelength out to see it at its own",
                RuntimeWarning,
                stacklevel=2,
            )
        return source, wavelength

    def polarisation(self) -> Any:
        """Jones vectors that a source file says; None without."""
        from polywigner import read_polarisation

        is_said = _is_source_file(self.source)
        return read_polarisation(self.source, self.allow_outside) if is_said else None

    def read_with_wavelength(self, coherent_for: str | None = None) -> tuple[Any, float]:
        """The source and its wavelength in m, ArgumentError without one.

        ``coherent_for`` names a command that cannot draw partly coherent sources.
        """
        source, wavelength = self.read()
        wavelength = required_wavelength(wavelength)
        if coherent_for is not None:
            check_is_coherent(source, coherent_for)
        return source, wavelength


@dataclass(frozen=True)
class MixedSourceOptions(SourceOptions):
    """Options of a source whose light may be partly coherent."""

    coherence: Annotated[
        str | None, "Width over which the source is coherent, such as '0.5 mm'."
    ] = None


def check_wavelength(wavelength: float, diameter: float) -> None:
    """Warn of a wavelength (m) that hardly belongs to an aperture; refuse an absurd one."""
    from polywigner.geometry.arguments import doubt_of_wavelength

    doubt = doubt_of_wavelength(wavelength, diameter)
    if doubt is None:
        return
    if not 1 / _ABSURD <= wavelength / diameter <= _ABSURD:
        raise ArgumentError(f"expected a wavelength that belongs to the aperture, got {doubt}")
    warnings.warn(f"got {doubt}", RuntimeWarning, stacklevel=2)


def check_is_coherent(source: Any, command: str) -> None:
    """Raise IlluminationError for a partly coherent source, where a command cannot draw one."""
    width = getattr(source, "coherence_width", math.inf)
    if width < math.inf:
        raise IlluminationError(
            f"expected a coherent source for {command}, got one that is coherent over {width:g} m; "
            "propagate, volume and rays take it"
        )


def wavelength_from(frequency: str | None, wavelength: str | None) -> float | None:
    """Metres, from the text of either option; None without both."""
    if frequency is not None and wavelength is not None:
        raise ArgumentError("expected --frequency or --wavelength, got both; drop one of them")
    if frequency is not None:
        return wavelength_of(parse_frequency(frequency))
    return None if wavelength is None else parse_length(wavelength)


def required_wavelength(wavelength: float | None) -> float:
    """The wavelength itself; ArgumentError where neither the options nor the file say one."""
    if wavelength is None:
        raise ArgumentError(
            'expected --frequency or --wavelength, got neither; give for example --frequency "94 '
            'GHz"'
        )
    return wavelength


def field_title(path: str, wavelength: float) -> str:
    """Title of the figure of a field: the source's file, frequency and wavelength."""
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
    """The frequency of a wavelength in metres, as it is printed."""
    frequency = SPEED_OF_LIGHT / wavelength
    named = [(name, size) for name, size in _FREQUENCIES if frequency >= 0.9995 * size]
    name, size = named[0] if named else _FREQUENCIES[-1]
    return f"{frequency / size:.4g} {name}"


def _is_source_file(path: str) -> bool:
    """Whether a file is TOML, or JSON with a kind at its top, which GeoJSON does not have."""
    from polywigner.geometry.io.limits import bytes_of

    suffix = Path(path).suffix.lower()
    if suffix != ".json":
        return suffix == ".toml"
    try:
        content = json.loads(bytes_of(Path(path)))
    except (ValueError, RecursionError, OSError):
        return False  # the reader of apertures reports the error
    return isinstance(content, dict) and "kind" in content and "type" not in content


@dataclass(frozen=True)
class ObstacleOptions:
    """Options of bodies and plates in the way."""

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
        """Raise the errors that can be known before anything heavy is imported."""
        for text in self.obstacle or ():
            path, _, _ = _placed_file(text)
            Reading(self.obstacle_unit).check(path)
        if self.obstacle_unit is not None:
            parse_unit(self.obstacle_unit)
            if not self.obstacle:
                raise ArgumentError("expected --obstacle-unit with --obstacle, got it alone")

    def read(self) -> list[Any]:
        """The bodies and placed plates."""
        return [self._placed(*_placed_file(text)) for text in self.obstacle or ()]

    def _placed(self, path: str, place: tuple[float, ...], angles: tuple[float, ...]) -> Any:
        """A body whose z axis is turned the shortest way into a direction, and its origin moved."""
        import numpy as np

        from polywigner import Polyhedron

        theta, phi = angles
        axis = np.array([-math.sin(phi), math.cos(phi), 0.0])
        cross = np.cross(np.eye(3), axis)  # of axis with v, as a matrix
        pose = np.eye(4)
        pose[:3, :3] += math.sin(theta) * cross + (1.0 - math.cos(theta)) * cross @ cross
        pose[:3, 3] = place
        try:
            body = Reading(self.obstacle_unit).read_body(path)
            if isinstance(body, Polyhedron):
                return Polyhedron(body.vertices @ pose[:3, :3].T + pose[:3, 3], body.faces)
            return body.placed(pose)
        except PolywignerError as error:
            raise type(error)(f"--obstacle: {error}") from None


def _placed_file(text: str) -> tuple[str, tuple[float, ...], tuple[float, ...]]:
    """The file, the place of its origin in m, and theta and phi of its z axis in rad."""
    check_text("--obstacle", text)
    path, at, where = text.rpartition(" at ")
    if not at:
        return text, (0.0, 0.0, 0.0), (0.0, 0.0)
    place, _, direction = where.partition(" towards ")
    try:
        point = tuple(parse_coordinate(part) for part in place.split(","))
        angles = tuple(parse_angle(part) for part in direction.split(",")) if direction else (0, 0)
    except QuantityError as error:
        raise QuantityError(f"--obstacle: {error}") from None
    if len(point) != 3 or len(angles) != 2:
        raise ArgumentError(
            "--obstacle: expected a file, a point and perhaps a direction, such as "
            f'"plate.svg at 0 mm, 0 mm, 150 mm towards 30 deg, 90 deg", got {text!r}'
        )
    return path.strip(), point, angles
