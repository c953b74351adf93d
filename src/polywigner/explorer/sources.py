"""From a state to the source that the package computes with, and from files to states."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from functools import lru_cache
from pathlib import Path

import numpy as np
import shapely

import polywigner as pw
from polywigner.errors import ArgumentError, FileFormatError, GeometryError
from polywigner.explorer.editing import rings_of_aperture
from polywigner.explorer.state import Ring, State
from polywigner.geometry.io.outlines import nested
from polywigner.illumination.texts import fed

Source = pw.Aperture | pw.Array

LARGEST_UPLOAD = 1 << 20
"""Bytes of a file that a visitor sends: ten thousand vertices as text; the page edits a tenth."""

MOST_ELEMENTS = 256
"""Most elements of an array: one visitor's picture must not keep the others waiting for long."""

# Of the source's longer side: W of less is a sum over more than a thousand tilts.
_LEAST_COHERENCE = 0.1

_SUFFIXES = (".geojson", ".json", ".wkt", ".csv", ".svg", ".dxf", ".txt")


@lru_cache(maxsize=64)
def polygons_of(rings: tuple[Ring, ...], per_metre: int) -> list[list[np.ndarray]]:
    """Polygons in metres, exteriors first, of outlines in units: those inside others are holes.

    Raises
    ------
    GeometryError for outlines that cross themselves or each other, with the place in units.
    """
    if not rings:
        raise GeometryError("expected an outline, got a blank sheet; draw one")

    def built(scale: int) -> list[list[np.ndarray]]:
        return nested([np.array(ring, dtype=np.float64).reshape(-1, 2) / scale for ring in rings])

    try:
        return built(per_metre)
    except GeometryError as error:
        raise GeometryError(_for_page(_in_units(built, error))) from None


def _in_units(built: Callable[[int], object], error: GeometryError) -> str:
    """The error of an outline with its places in the page's unit."""
    try:
        built(1)
    except GeometryError as same:
        return str(same)
    return str(error)


def _for_page(text: str) -> str:
    """With outlines counted from 1, as the table does, and places with six digits."""
    counted = re.sub(r"outline (\d+)", lambda found: f"outline {int(found[1]) + 1}", text)
    short = re.sub(r"-?\d+\.\d{6,}", lambda found: f"{float(found[0]):.6g}", counted)
    return without_advice(short)


def without_advice(text: str) -> str:
    """Text of an error without advice that needs Python."""
    return text.split("; split it with")[0]


@lru_cache(maxsize=64)
def aperture_of(rings: tuple[Ring, ...], per_metre: int) -> pw.Aperture:
    """The aperture of outlines in units, in metres. Raises as :func:`polygons_of`."""
    polygons = polygons_of(rings, per_metre)
    return pw.Aperture([shapely.Polygon(rings[0], rings[1:]) for rings in polygons])


@lru_cache(maxsize=64)
def _source(
    rings: tuple[Ring, ...], per_metre: int, feeding: tuple[tuple[str, str], ...], wavelength: float
) -> Source:
    source: Source = fed(aperture_of(rings, per_metre), dict(feeding), wavelength)
    if isinstance(source, pw.Array) and len(source) > MOST_ELEMENTS:
        raise ArgumentError(
            f"array: expected at most {MOST_ELEMENTS} elements in the page, got {len(source)}; use "
            "`polywigner transform` for such an array"
        )
    return source


def source_of(state: State) -> Source:
    """The aperture with its field, or the array of it.

    Raises
    ------
    PolywignerError for what is no polygon, or cannot be fed so.
    """
    return _source(state.rings, state.per_metre, feeding_of(state), state.wavelength)


def light_of(state: State) -> Source | pw.Wavefront:
    """The source, coherent over the chosen width.

    Raises
    ------
    ArgumentError for a width so small that a picture of W takes seconds.
    """
    source = source_of(state)
    if state.coherence == 0:
        return source
    width = state.metres(state.coherence)
    low, high = np.reshape(source.bounds, (2, 2))
    if not width >= _LEAST_COHERENCE * (high - low).max():
        raise ArgumentError(
            f"expected a width of coherence of at least a tenth of the source in the page, got "
            f"{state.coherence:g} {state.unit}; use polywigner.wigner for less"
        )
    return source.partially_coherent(width)


def feeding_of(state: State) -> tuple[tuple[str, str], ...]:
    """The texts of taper, array, window and steering that are not empty, by their names."""
    names = ("taper", "array", "window", "steering")
    return tuple((name, getattr(state, name)) for name in names if getattr(state, name).strip())


def state_of_file(
    path: str,
    unit: str,
    state: State,
    layer: Sequence[str] | None = None,
    union: bool = False,
) -> State:
    """A state with the outline of a file, read as ``unit``, in the state's own unit.

    Raises
    ------
    PolywignerError for what cannot be read, or has too many vertices.
    """
    aperture = pw.read_aperture(path, unit=unit, layer=layer, union=union)
    return state.moved(rings=rings_of_aperture(aperture, state.per_metre))


def _shown(name: str) -> str:
    return "".join(c if c.isprintable() else "?" for c in name[-60:]) or "the file"


def check_size(name: str, size: int) -> None:
    """Raises FileFormatError for a file of more than 1 MiB."""
    if size > LARGEST_UPLOAD:
        raise FileFormatError(
            f"{_shown(name)}: expected at most {LARGEST_UPLOAD >> 20} MiB, got "
            f"{size / 2**20:.1f} MiB; simplify what it describes"
        )


def check_upload(name: str, size: int) -> tuple[str, str]:
    """The name of a file that a visitor sends, as it is shown, and its suffix.

    Raises
    ------
    FileFormatError for more than 1 MiB, and for a suffix that the page does not read.
    """
    shown = _shown(name)
    check_size(name, size)
    suffix = Path(shown).suffix.lower()
    if suffix not in _SUFFIXES:
        raise FileFormatError(
            f"{shown}: expected GeoJSON, WKT, CSV, SVG or DXF, got {suffix or 'no suffix'}"
        )
    return shown, suffix
