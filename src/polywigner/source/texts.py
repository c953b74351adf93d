"""Tapers, arrays and waves as short texts, as in scene files and on the command line.

docs/source_files.md has the table of all texts.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polywigner.errors import ArgumentError, QuantityError, at_key, value_text
from polywigner.geometry import Aperture, Wavefront
from polywigner.quantities import parse_angle, parse_length
from polywigner.source import tapers
from polywigner.source.array import Array, phased_array, repeated_element
from polywigner.source.source_functions import (
    FieldTable,
    LayoutTable,
    WeightTable,
    called,
    radius_of,
)
from polywigner.source.source_schema import converted

SOURCE_TEXTS = ("taper", "array", "window", "steering", "focus", "curved", "coherence")
"""Names of the texts of :func:`apply_texts`."""

_SIDELOBES = r"(?: +(?P<sll>[\d.]+) *dB(?: +(?P<nbar>\d{1,3}))?)?"
_AXIS = r"(?: +(?P<axis>[xy]))?"
_LATTICE = r"(?P<nx>\d{1,7}) *[x×] *(?P<ny>\d{1,7}) *,(?P<pitch_x>[^,]+)(?:,(?P<pitch_y>[^,]+))?"

# Pattern of each kind of table that a text may stand for; the groups are keys of the table.
_PATTERNS: dict[str, dict[str, str]] = {
    "taper": {
        "cosine_taper": r"cosine(?: *(?P<power>\d{1,2}))?" + _AXIS,
        "taylor_taper": "taylor" + _SIDELOBES + _AXIS,
        "te_mode": r"te(?P<m>\d)(?P<n>\d)",
    },
    "array": {"grid": _LATTICE, "triangular": "triangular +" + _LATTICE},
    "window": {"window": "(?P<window>[a-z]+)" + _SIDELOBES},
}
_EXPECTED = {
    "taper": 'a taper such as "cosine", "cosine 2 x", "te10", "taylor 30 dB"',
    "array": 'an array such as "12 x 16, 2 mm" or "triangular 12 x 16, 2 mm, 1.9 mm"',
    "window": 'a window such as "taylor 25 dB" or "hamming"',
}


def _table(name: str, text: str) -> dict[str, Any]:
    """The table of a source file that a text stands for."""
    if name == "steering":
        return {"kind": name, "direction": direction(text).tolist()}
    if name == "focus":
        return {"kind": "focusing", "point": [part.strip() for part in text.split(",")]}
    written = text.strip() if name == "array" else text.strip().lower()
    for kind, pattern in _PATTERNS[name].items():
        match = re.fullmatch(pattern, written, re.IGNORECASE)
        if match is not None:
            groups = match.groupdict().items()
            return {"kind": kind, **{key: value for key, value in groups if value is not None}}
    raise QuantityError(f"expected {_EXPECTED[name]}, got {value_text(text)}")


def apply_texts(source: Any, texts: Mapping[str, str], wavelength: float | None) -> Any:
    """Return a source with the field, the copies, the weights and the wave that texts describe.

    Lengths without a unit are in metres, angles in radians. Errors begin with the name of the text:
    QuantityError or FileFormatError for a text that cannot be read, ArgumentError for one that does
    not fit the source.

    Parameters
    ----------
    source
        An Aperture; with `steering`, `focus`, `curved` and `coherence` also a phased array.
    texts
        Texts by their names, :data:`SOURCE_TEXTS`; docs/source_files.md has their grammar.
    wavelength
        Wavelength in metres, for steering, focus and curved waves.
    """
    if "window" in texts and "array" not in texts:
        raise ArgumentError("window: expected an array for it, got none; give array as well")
    shape = None
    for name in SOURCE_TEXTS:
        if name not in texts:
            continue
        text = texts[name]
        with at_key(name):
            if name in ("taper", "array") and not isinstance(source, Aperture):
                got = type(source).__name__
                raise ArgumentError(
                    f"expected an aperture for it, got {got}; write it into the source file"
                )
            if name == "taper":
                source = _times(source, _taper(_table(name, text), source))
            elif name == "array":
                layout = converted(_table(name, text), LayoutTable, strict=False)
                source, shape = phased_array(source, called(layout)), (layout.nx, layout.ny)
            elif name == "curved":
                source = _curved(source, text, wavelength)
            elif name == "coherence":
                source = source.partially_coherent(parse_length(text))
            else:
                source = _weighted(source, _table(name, text), wavelength, shape)
    return source


def _times(aperture: Aperture, field: Any) -> Aperture:
    """An aperture whose field is multiplied by another."""
    own: Any = aperture.illumination
    return aperture.with_illumination(field if own is None else own * field)


def _taper(table: dict[str, Any], aperture: Aperture) -> Any:
    xmin, ymin, xmax, ymax = aperture.bounds
    sizes = {"width": xmax - xmin, "height": ymax - ymin}
    axis = table.pop("axis", None)
    if axis is not None:
        del sizes["height" if axis == "x" else "width"]
    if table.get("m") == "0":
        table["component"] = "x"
    field = called(converted(table | sizes, FieldTable, strict=False), dimension=2)
    return field.moved(aperture.centre)


def _weighted(source: Any, table: dict[str, Any], wavelength: float | None, shape: Any) -> Any:
    """An array with further weights, or an aperture that is steered by its field."""
    if isinstance(source, Aperture) and table["kind"] == "steering":
        steering = converted(table, FieldTable, strict=False)
        return _times(source, called(steering, wavelength, dimension=2))
    if not isinstance(source, Array) or source.repeated is None:
        kind = "curved wave" if isinstance(source, Wavefront) else type(source).__name__
        raise ArgumentError(
            f"expected an array of equal elements with a flat wave, got {kind}; give array as "
            "well, or write it into the source file"
        )
    element, positions = source.repeated
    weights = converted(table, WeightTable, strict=False)
    factor = called(weights, wavelength, positions=positions, shape=shape, dimension=2)
    return repeated_element(element, positions, source.weights * factor)


def _curved(source: Any, text: str, wavelength: float | None) -> Wavefront:
    radii = [radius_of(part.strip()) for part in text.split(",")]
    if len(radii) > 2 or not isinstance(source, Aperture | Array):
        raise QuantityError(
            'expected a radius, or two, of an aperture or array, such as "60 mm" or "60 mm, inf", '
            f"got {value_text(text)} of {type(source).__name__}"
        )
    if wavelength is None:
        raise ArgumentError("expected a frequency or a wavelength with it, got none")
    low, high = np.reshape(source.bounds, (2, -1))
    return source.curved(radii[0] if len(radii) == 1 else radii, wavelength, (low + high) / 2)


def direction(text: str) -> NDArray[np.float64]:
    """The unit vector of "20 deg" or "20 deg, 90 deg"; QuantityError for other texts."""
    theta, *phi = (parse_angle(part.strip()) for part in text.split(","))
    if len(phi) > 1 or not abs(theta) < math.pi / 2:  # perhaps degrees without a unit
        raise QuantityError(
            'expected a direction such as "20 deg" or "20 deg, 90 deg", within 90 deg of the '
            f"normal, got {value_text(text)}; write degrees with their unit"
        )
    return tapers.direction_of(theta, *phi)


def direction_angles(text: str) -> tuple[float, float]:
    """Theta, from 0, and phi in rad of the :func:`direction` of a text."""
    x, y, z = direction(text)
    theta = math.atan2(math.hypot(x, y), z)
    return theta, math.atan2(y, x) % (2 * math.pi) if theta > 0 else 0.0
