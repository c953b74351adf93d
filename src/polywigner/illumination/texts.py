"""Tapers, steering and layouts as scenes and the command line write them: in a few words."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polywigner.errors import ArgumentError, QuantityError
from polywigner.geometry import Aperture, Wavefront
from polywigner.illumination import arrays, tapers
from polywigner.illumination.array import Array, phased_array, repeated_element
from polywigner.illumination.arrays import focusing_weights, steering_weights, window_weights
from polywigner.illumination.source_values import at, radius_of, shown
from polywigner.illumination.waves import Illumination
from polywigner.quantities import parse_angle, parse_coordinate, parse_length

FEEDING = ("taper", "array", "window", "steering", "focus", "curved", "coherence")
"""Names that :func:`fed` knows."""

_LONGEST = 100
_DECIBELS = r"(?:\s+(?P<sll>\d+(?:\.\d*)?)\s*dB(?:\s+(?P<nbar>\d{1,3}))?)?"
_TAPER = re.compile(
    r"(?:(?P<cosine>cosine)(?:\s*(?P<power>\d{1,2}))?|te(?P<m>\d)(?P<n>\d)|(?P<taylor>taylor)"
    rf"{_DECIBELS})(?:\s+(?P<axis>[xy]))?",
    re.IGNORECASE,
)
_LAYOUT = re.compile(r"(triangular\s+)?(\d{1,7})\s*[x×]\s*(\d{1,7})", re.IGNORECASE)
_WINDOW = re.compile(rf"(?P<name>[a-z]+){_DECIBELS}", re.IGNORECASE)


def fed(source: Any, texts: Mapping[str, str], wavelength: float | None) -> Any:
    """A source with the field, the copies and the weights that texts describe.

    Lengths without a unit are in metres, angles without one in radians. Errors begin with the key:
    QuantityError for a text that is none of these, ArgumentError where it does not fit the source.

    Parameters
    ----------
    source
        An Aperture; for `steering` and `focus` alone also a phased array.
    texts
        Any of these:

        - `taper`: the field of an aperture, over its bounds: "cosine", "cosine 2" (squared),
          "te10" (TE_mn by its digits, E_y if it has one), "taylor 30 dB", "taylor 40 dB 7" (with
          n-bar); the first and the last may end in " x" or " y": along this axis only
        - `array`: so many copies: "12 x 16, 2 mm", "12 x 16, 2 mm, 1.9 mm" (pitch along y),
          "triangular 12 x 16, 2 mm"; centred where the aperture is
        - `window`: amplitudes of the copies: "taylor 25 dB", "chebyshev 30 dB", "hamming"
        - `steering`: a beam towards (theta, phi): "20 deg", "20 deg, 90 deg"; of an array by the
          weights of its elements, of an aperture by its field
        - `focus`: a point (x, y, z) at which the waves of all elements are in phase
        - `curved`: the radius of a curved wave about the middle of the source, or one along x and
          one along y: "60 mm", "60 mm, inf", "-80 mm" (towards a focus)
        - `coherence`: the width over which the source is coherent: "0.5 mm"
    wavelength
        In metres, for steering, focus and curved waves.
    """
    aperture_only = [name for name in ("taper", "array") if name in texts]
    if aperture_only and not isinstance(source, Aperture):
        raise ArgumentError(
            f"{aperture_only[0]}: expected an aperture for it, got {type(source).__name__}; write "
            "it into the source file"
        )
    if "window" in texts and "array" not in texts:
        raise ArgumentError("window: expected an array for it, got none; give array as well")
    if "taper" in texts:
        with at("taper"):
            source = _times(source, _taper(texts["taper"], source))
    if "array" in texts:
        source = _array(source, texts)
    for name in ("steering", "focus", "curved"):
        if name in texts:
            with at(name):
                if wavelength is None:
                    raise ArgumentError("expected a frequency or a wavelength with it, got none")
                if name == "curved":
                    source = _curved(source, texts[name], wavelength)
                else:
                    source = _turned(source, name, texts[name], wavelength)
    if "coherence" in texts:
        with at("coherence"):
            source = source.partially_coherent(parse_length(texts["coherence"]))
    return source


def _curved(source: Any, text: str, wavelength: float) -> Wavefront:
    radii = [radius_of(part) for part in _parts(text)]
    if len(radii) not in (1, 2) or not isinstance(source, Aperture | Array):
        raise QuantityError(
            'expected a radius, or two, of an aperture or array, such as "60 mm" or "60 mm, inf", '
            f"got {shown(text)} of {type(source).__name__}"
        )
    low, high = np.reshape(source.bounds, (2, -1))
    return source.curved(radii[0] if len(radii) == 1 else radii, wavelength, (low + high) / 2)


def _taper(text: str, aperture: Aperture) -> Illumination:
    match = _matched(_TAPER, text, "a taper", "cosine", "cosine 2", "te10", "taylor 30 dB")
    xmin, ymin, xmax, ymax = aperture.bounds
    width, height = xmax - xmin, ymax - ymin
    axis = (match["axis"] or "").lower()
    sizes = (None if axis == "y" else width), (None if axis == "x" else height)
    if match["m"]:
        if axis:
            raise QuantityError(f"expected a mode without an axis, got {shown(text)}")
        m, n = int(match["m"]), int(match["n"])
        field = tapers.te_mode(width, height, m, n, "y" if m else "x")
    elif match["cosine"]:
        field = tapers.cosine_taper(*sizes, int(match["power"] or 1))
    else:
        field = tapers.taylor_taper(*sizes, **_sidelobes(match))
    return field.moved(aperture.centre)


def _sidelobes(match: re.Match[str]) -> dict[str, Any]:
    kinds = {"sll": float, "nbar": int}
    return {key: kind(match[key]) for key, kind in kinds.items() if match[key]}


def _array(aperture: Aperture, texts: Mapping[str, str]) -> Array:
    with at("array"):
        positions, shape = _layout(texts["array"])
    weights = None
    if "window" in texts:
        with at("window"):
            match = _matched(_WINDOW, texts["window"], "a window", "taylor 25 dB", "hamming")
            weights = window_weights(shape, match["name"].lower(), **_sidelobes(match))
    return phased_array(aperture, positions, weights)


def _layout(text: str) -> tuple[NDArray[np.float64], tuple[int, int]]:
    count, *pitches = _parts(text)
    match = _LAYOUT.fullmatch(count)
    if match is None or len(pitches) not in (1, 2):
        raise QuantityError(
            f'expected an array such as "12 x 16, 2 mm" or "12 x 16, 2 mm, 1.9 mm", got '
            f"{shown(text)}; give the elements along x and y, and their distances"
        )
    layout = arrays.triangular_positions if match[1] else arrays.grid_positions
    shape = int(match[2]), int(match[3])
    return layout(*shape, *(parse_length(pitch) for pitch in pitches)), shape


def _turned(source: Any, name: str, text: str, wavelength: float) -> Any:
    array = isinstance(source, Array)
    if isinstance(source, Wavefront):
        raise ArgumentError("expected a source with a flat wave, got a curved one; steer it before")
    if array and source.repeated is None:
        raise ArgumentError(
            "expected an aperture or a phased array of equal elements, got an array of any "
            "elements; give their weights in the source file"
        )
    if not array and name == "focus":
        raise ArgumentError("expected an array to focus, got an aperture; give array as well")
    if name == "focus":
        return _times(source, focusing_weights(source.repeated[1], _point(text), wavelength))
    towards = direction(text)
    if array:
        return _times(source, steering_weights(source.repeated[1], towards, wavelength))
    return _times(source, tapers.steering(towards, wavelength))


def _times(source: Any, factor: Any) -> Any:
    """The source with its field times an Illumination, or its weights times others."""
    if isinstance(source, Array):
        assert source.repeated is not None
        return repeated_element(*source.repeated, source.weights * factor)
    own = source.illumination
    return source.with_illumination(factor if own is None else own * factor)


def direction(text: str) -> NDArray[np.float64]:
    """The unit vector of "20 deg" or "20 deg, 90 deg". Raises QuantityError for other texts."""
    angles = _parts(text)
    if len(angles) not in (1, 2):
        raise QuantityError(
            'expected a direction such as "20 deg" or "20 deg, 90 deg" (from the normal, and '
            f"around it from x), got {shown(text)}"
        )
    theta, phi = (parse_angle(angle) for angle in (*angles, "0 deg")[:2])
    if not abs(theta) < math.pi / 2:  # a number of degrees, perhaps, without its unit
        raise QuantityError(
            f"expected a direction within 90 deg of the normal, got {shown(text)}; write degrees "
            'with their unit, such as "20 deg"'
        )
    return tapers.direction_of(theta, phi)


def direction_angles(text: str) -> tuple[float, float]:
    """Theta and phi in rad of the :func:`direction` of a text, theta from 0."""
    x, y, z = direction(text)
    theta = math.atan2(math.hypot(x, y), z)
    return theta, math.atan2(y, x) % (2 * math.pi) if theta > 0 else 0.0


def _point(text: str) -> list[float]:
    lengths = _parts(text)
    if len(lengths) != 3:
        raise QuantityError(
            f'expected three lengths such as "0 mm, 0 mm, 80 mm", got {shown(text)}'
        )
    return [parse_coordinate(length) for length in lengths]


def _parts(text: str) -> list[str]:
    if len(text) > _LONGEST:
        raise QuantityError(f"expected up to {_LONGEST} characters, got {shown(text)}")
    return [part.strip() for part in text.split(",")]


def _matched(pattern: re.Pattern[str], text: str, what: str, *examples: str) -> re.Match[str]:
    match = pattern.fullmatch(text.strip()) if len(text) <= _LONGEST else None
    if match is None:
        listed = ", ".join(f'"{example}"' for example in examples)
        raise QuantityError(f"expected {what} such as {listed}, got {shown(text)}")
    return match
