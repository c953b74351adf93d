"""Curved and partly coherent waves in source files, the table ``[wavefront]``."""

from __future__ import annotations

import math
from typing import Any

from polywigner.errors import FileFormatError
from polywigner.geometry import Aperture, Slits, Wavefront
from polywigner.illumination.array import Array
from polywigner.illumination.files.values import (
    at,
    checked_table,
    coordinates,
    length,
    numbers,
    radius_of,
)

__all__ = ["table_of_wavefront", "wavefront_of"]


def wavefront_of(source: Any, table: Any, wavelength: float | None) -> Wavefront:
    """The source with the wave that a table describes; ``wavelength``: that of the file, in m."""
    keys = ("radius", "wavelength", "curvature", "centre", "coherence_width")
    checked_table(table, (), keys)
    if not isinstance(source, Aperture | Slits | Array):
        raise FileFormatError("expected it of an aperture without a pose, of slits or of an array")
    if "radius" in table and "curvature" in table:
        raise FileFormatError("expected the key radius or curvature, got both")
    with at("centre"):
        centre = coordinates(table["centre"]) if "centre" in table else None
    with at("curvature"):
        matrix = numbers(table["curvature"]) if "curvature" in table else None
    with at("coherence_width"):
        width = length(table["coherence_width"]) if "coherence_width" in table else math.inf
    wave = Wavefront(source, matrix, centre, width)
    if "radius" not in table:
        return wave
    with at("radius"):
        given = table["radius"]
        radii = [radius_of(r) for r in given] if isinstance(given, list) else radius_of(given)
        own = length(table["wavelength"]) if "wavelength" in table else wavelength
        if own is None:
            raise FileFormatError("expected a frequency or wavelength in the file, got none")
        return wave.curved(radii, own, centre)


def table_of_wavefront(wave: Wavefront) -> dict[str, Any]:
    """What :func:`wavefront_of` makes the same wave of."""
    table: dict[str, Any] = {"curvature": wave.curvature.tolist(), "centre": wave.centre.tolist()}
    return table if wave.is_coherent else {**table, "coherence_width": wave.coherence_width}
