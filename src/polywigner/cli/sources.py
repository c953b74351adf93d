"""Options for sources, wavelengths and obstacles, and functions that read their files."""

from __future__ import annotations

import json
import math
import os
import warnings
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from polywigner.cli.options import Text, Texts
from polywigner.errors import ArgumentError, FileFormatError, at_key, value_text
from polywigner.quantities import (
    SPEED_OF_LIGHT,
    parse_angle,
    parse_coordinate,
    parse_length,
    parse_unit,
    parse_wavelength,
)

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from polywigner import Aperture, Polyhedron
    from polywigner import Array as ApertureArray
    from polywigner.geometry import PlacedAperture

_FREQUENCIES = (("THz", 1e12), ("GHz", 1e9), ("MHz", 1e6), ("kHz", 1e3), ("Hz", 1.0))
_LONGEST_NAME = 32
_MESHES = (".stl", ".ply", ".obj")
# Relative difference up to which wavelengths count as equal, because users type few digits.
_SAME_WAVELENGTH = 1e-3


@dataclass(frozen=True, kw_only=True)
class WaveOptions:
    """The options --frequency and --wavelength; at most one may be specified."""

    frequency: Annotated[Text, "Frequency, such as '94 GHz'."] = None
    wavelength: Annotated[Text, "Wavelength, such as '3.19 mm'."] = None

    def length(self) -> float | None:
        """Return the wavelength in metres, or None if neither option is specified."""
        return parse_wavelength(self.frequency, self.wavelength)


def required_wavelength(wavelength: float | None) -> float:
    """Return the wavelength; raise ArgumentError if it is None."""
    if wavelength is None:
        raise ArgumentError(
            "expected --frequency or --wavelength, got neither; specify for example --frequency "
            '"94 GHz"'
        )
    return wavelength


@dataclass(frozen=True, kw_only=True)
class ReadingOptions:
    """Options for reading aperture files."""

    unit: Annotated[Text, "Unit of files that specify none (default: mm)."] = None
    tolerance: Annotated[Text, "Chord-to-curve distance: '1 um' (default: diagonal/2000)."] = None
    layer: Annotated[Texts, "Layer of a drawing to read (repeatable; default: all)."] = None
    union: Annotated[bool, "Join shapes of an aperture file that overlap."] = False

    def check_file(self, path: str) -> None:
        """Raise errors about a path and the tolerance before large libraries are imported."""
        self.reading_arguments()
        if not os.path.isfile(path):  # noqa: PTH113 (pathlib raises for a name too long)
            raise FileFormatError(
                f"expected an aperture file, got {path!r}, which does not exist or is not a file; "
                "check its path"
            )

    def check_unused(self, names: tuple[str, ...], kind: str) -> None:
        """Raise ArgumentError for options that do not apply to a kind of file."""
        for name in names:
            if getattr(self, name):
                raise ArgumentError(f"--{name} does not apply to {kind}")

    def read_file(self, path: str) -> Aperture:
        """Return the aperture in a file."""
        import polywigner as pw

        return pw.read_aperture(path, **self.reading_arguments())

    def read_body(
        self, path: str, as_plates: bool = False
    ) -> Aperture | Polyhedron | list[PlacedAperture]:
        """Read a mesh as a body or as separate plates, and a drawing as an aperture."""
        import polywigner as pw

        if Path(path).suffix.lower() not in _MESHES:
            return self.read_file(path)
        self.check_unused(("tolerance", "layer", "union"), "a mesh, only to drawings; omit it")
        unit = self.unit or "mm"
        return pw.read_sheets(path, unit) if as_plates else pw.read_polyhedron(path, unit)

    def reading_arguments(self) -> dict[str, Any]:
        """Return the keyword arguments of :func:`polywigner.read_aperture`."""
        tolerance = None if self.tolerance is None else parse_length(self.tolerance)
        unit = self.unit or "mm"
        return {"unit": unit, "tolerance": tolerance, "layer": self.layer, "union": self.union}


@dataclass(frozen=True, kw_only=True)
class SourceOptions(ReadingOptions, WaveOptions):
    """Options for a source: file, taper, array, steering and wavelength."""

    source: Annotated[str, typer.Argument(help="Aperture file, or source file (TOML, JSON).")]
    allow_outside: Annotated[bool, "Read files outside of the folder of a source file."] = False
    taper: Annotated[Text, "Taper: 'cosine', 'cosine 2 x', 'te10', 'taylor 30 dB 4'."] = None
    array: Annotated[Text, "Copies of the aperture, such as '12 x 16, 2 mm'."] = None
    window: Annotated[Text, "Window: 'taylor 25 dB', 'chebyshev 30 dB', 'hamming'."] = None
    steering: Annotated[Text, "Beam direction theta, phi, such as '20 deg, 90 deg'."] = None
    focus: Annotated[Text, "Focal point of the array, such as '0 mm, 0 mm, 80 mm'."] = None
    curved: Annotated[Text, "Radii of a curved wave: '60 mm', or '60 mm, inf' (x, y)."] = None

    def check(self) -> None:
        """Raise all errors that can be detected before large libraries are imported."""
        self.check_file(self.source)
        self.length()

    def read(self) -> tuple[Aperture | ApertureArray, float | None]:
        """Return the source and its wavelength in metres, from the options or else from the file.

        The wavelength is None if neither the options nor the file specify it.
        """
        from polywigner.geometry.arguments import warn_of_wavelength
        from polywigner.source.source_files import read_content
        from polywigner.source.source_tables import SOURCE_TEXTS, apply_texts

        wavelength = self.length()
        if _is_source_file(self.source):
            names = "unit", "tolerance", "layer", "union"
            self.check_unused(names, "a source file; specify it in the file")
            source, designed, _ = read_content(self.source, self.allow_outside)
            if wavelength is not None and designed is not None:
                self._warn_of_design_wavelength(wavelength, designed)
            wavelength = designed if wavelength is None else wavelength
        else:
            source = self.read_file(self.source)
        texts = {name: getattr(self, name, None) for name in SOURCE_TEXTS}
        options = {name: text for name, text in texts.items() if text is not None}
        source = apply_texts(source, options, wavelength)
        if wavelength is not None:
            warn_of_wavelength(source, wavelength)
        return source, wavelength

    def _warn_of_design_wavelength(self, wavelength: float, designed: float) -> None:
        """Warn if the wavelength differs from the design wavelength of a source file."""
        if abs(wavelength - designed) > _SAME_WAVELENGTH * designed:
            warnings.warn(
                f"the phases in {Path(self.source).name} were designed for a wavelength of "
                f"{designed:.6g} m; at {wavelength:.6g} m the beam squints; omit --frequency and "
                "--wavelength to use the wavelength of the file",
                RuntimeWarning,
                stacklevel=3,
            )

    def polarisation(self) -> NDArray[np.complex128] | None:
        """Return the Jones vectors (2,) or (n, 2) in a source file, or None if it has none."""
        from polywigner import read_polarisation

        is_source = _is_source_file(self.source)
        return read_polarisation(self.source, self.allow_outside) if is_source else None

    def read_with_wavelength(self) -> tuple[Aperture | ApertureArray, float]:
        """Return the source and its wavelength in metres; raise ArgumentError without one."""
        source, wavelength = self.read()
        return source, required_wavelength(wavelength)


def field_title(path: str, wavelength: float) -> str:
    """Return the title of a figure: file name, frequency and wavelength."""
    from polywigner.quantities import length_text

    printed = length_text(wavelength)
    return f"{short_name(path)}, {frequency_text(wavelength)} (wavelength {printed})"


def short_name(path: str) -> str:
    """Return the name of a file, or of the folder of ``scene.xml``, shortened to 32 characters."""
    file = Path(path)
    name = file.resolve().parent.name if file.stem == "scene" else file.name
    if len(name) > _LONGEST_NAME:
        name = f"{name[:20]}…{name[-11:]}"
    return name.replace("$", r"\$")  # Matplotlib treats $ as the start of a formula.


def frequency_text(wavelength: float) -> str:
    """Return the frequency for a wavelength in m as text, such as "94 GHz"."""
    frequency = SPEED_OF_LIGHT / wavelength
    units = [unit for unit in _FREQUENCIES if frequency >= 0.9995 * unit[1]]
    name, size = units[0] if units else _FREQUENCIES[-1]
    return f"{frequency / size:.4g} {name}"


def _is_source_file(path: str) -> bool:
    """Return whether a file is TOML, or JSON with a top-level "kind", which GeoJSON lacks."""
    from polywigner.geometry.io.limits import bytes_of

    suffix = Path(path).suffix.lower()
    if suffix == ".json":
        # Errors in the file are ignored here, because read_aperture reports them.
        with suppress(ValueError, RecursionError, OSError):
            content = json.loads(bytes_of(Path(path)))
            return isinstance(content, dict) and "kind" in content and "type" not in content
    return suffix == ".toml"


@dataclass(frozen=True, kw_only=True)
class FieldSourceOptions(SourceOptions):
    """Options for a source that may be partially coherent, and for obstacles."""

    coherence: Annotated[Text, "Coherence width of the source, such as '0.5 mm'."] = None
    obstacle: Annotated[
        Texts,
        "Body or plate (repeatable), its position and direction theta, phi: 'box.stl', "
        "'plate.svg at 0 mm, 0 mm, 150 mm towards 30 deg, 90 deg'.",
    ] = None
    obstacle_unit: Annotated[Text, "Unit of obstacle files that specify none (default: mm)."] = None

    def check(self) -> None:
        """Raise errors in the source and obstacle options before the slow imports."""
        super().check()
        for text in self.obstacle or ():
            ReadingOptions().check_file(_parse_obstacle(text)[0])
        if self.obstacle_unit is not None:
            parse_unit(self.obstacle_unit)

    def read_obstacles(self) -> list[Polyhedron | PlacedAperture]:
        """Return all obstacles at their specified positions."""
        with at_key("--obstacle"):
            return [self._placed_obstacle(*_parse_obstacle(text)) for text in self.obstacle or ()]

    def _placed_obstacle(
        self, path: str, origin: tuple[float, ...], angles: tuple[float, ...]
    ) -> Polyhedron | PlacedAperture:
        """Return an obstacle whose z axis is rotated to (theta, phi), and which is then translated.

        ``origin`` is in m, and ``angles`` are theta and phi in rad. The axis of the rotation is
        normal to z.
        """
        import numpy as np

        from polywigner import Polyhedron

        theta, phi = angles
        axis = np.array([-math.sin(phi), math.cos(phi), 0.0])
        cross = np.cross(np.eye(3), axis)  # cross @ v equals axis × v.
        pose = np.eye(4)
        pose[:3, :3] += math.sin(theta) * cross + (1.0 - math.cos(theta)) * cross @ cross
        pose[:3, 3] = origin
        body: Any = ReadingOptions(unit=self.obstacle_unit).read_body(path)
        if isinstance(body, Polyhedron):
            return Polyhedron(body.vertices @ pose[:3, :3].T + pose[:3, 3], body.faces)
        placed: PlacedAperture = body.placed(pose)
        return placed


def _parse_obstacle(text: str) -> tuple[str, tuple[float, ...], tuple[float, ...]]:
    """Parse "FILE at X, Y, Z towards THETA, PHI" into the file, a point in m and angles in rad.

    The point and the angles are 0 by default.
    """
    path, at, placement = text.rpartition(" at ")
    if not at:
        return text, (0.0, 0.0, 0.0), (0.0, 0.0)
    position, _, direction = placement.partition(" towards ")
    with at_key("--obstacle"):
        point = tuple(parse_coordinate(part) for part in position.split(","))
        angles = tuple(parse_angle(part) for part in direction.split(",")) if direction else (0, 0)
        if len(point) != 3 or len(angles) != 2:
            raise ArgumentError(
                'expected a file, a point and optionally a direction, such as "plate.svg at 0 '
                f'mm, 0 mm, 150 mm towards 30 deg, 90 deg", got {value_text(text)}'
            )
    return path.strip(), point, angles
