"""Numbers that are probably in another unit: one warning, at the line that gave them."""

from __future__ import annotations

import math
import re
import sys
import warnings
from numbers import Real
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polywigner.errors import PolywignerError, PolywignerWarning

__all__ = [
    "doubt_of_wavelength",
    "is_called_by_user",
    "warn_caller",
    "warn_of_degrees",
    "warn_of_distance",
    "warn_of_lens",
    "warn_of_wavelength",
]

_PACKAGE = __name__.partition(".")[0]

# Metres: no wave of an antenna is so long, and frequencies in Hz are such numbers.
_LIKE_A_FREQUENCY = 1e6, 1e17
# A source that is a point, in effect.
_LONGEST = 1e4
# A slip between mm and m is a factor of a thousand: beyond so many wavelengths a source may be one
# that has one. Of radio waves few sources are that large, of light nearly all; there up to a metre.
_MOST_OF_RADIO, _MOST_OF_LIGHT = 1e3, 1e6
_SHORTEST_RADIO = 1e-4
# Lenses are wider than so many wavelengths, and their images within so many pupils: pinholes are at
# f/300, and mm for m would make f/1000 of f/1.
_NARROWEST_LENS, _LONGEST_FOCUS = 10.0, 500.0
# A link over so many sizes and wavelengths: a hundred times that of a radar on the road.
_LONGEST_LINK = 1e5
_asked: set[tuple[str, int, str]] = set()

# Radians: a turn, and a coarse step beyond it.
_A_TURN = 7.0


def doubt_of_wavelength(wavelength: float, diameter: float) -> str | None:
    """What is odd about a wavelength for a source of this size, both in m; None for nothing."""
    ratio = diameter / wavelength
    most = _MOST_OF_RADIO if wavelength >= _SHORTEST_RADIO else _MOST_OF_LIGHT
    if 1 / _LONGEST <= ratio <= most:
        return None
    size = f"a source of {diameter:.3g} m at a wavelength of {wavelength:.3g} m"
    if ratio < 1:
        return f"{size}, {1 / ratio:.3g} times as long: did you mean GHz for the frequency?"
    return f"{size}, {ratio:.3g} wavelengths across: is a unit wrong, mm for m?"


def warn_of_wavelength(source: Any, wavelength: Any) -> None:
    """Ask about a wavelength like a frequency, or one that hardly belongs to the source."""
    try:
        length = float(wavelength) if isinstance(wavelength, Real) else 0.0
    except OverflowError:  # of a large int
        return
    if not 0 < length < math.inf:
        return  # the function says what it expects
    if _LIKE_A_FREQUENCY[0] < length < _LIKE_A_FREQUENCY[1]:
        warn_caller(
            f"got a wavelength of {length:g} m: a frequency? Then write frequency={length:g} in "
            "its place"
        )
        return
    diameter = _diameter(source)
    doubt = None if diameter is None else doubt_of_wavelength(length, diameter)
    if doubt is not None:
        warn_caller(f"got {doubt}")


def warn_of_lens(pupil: Any, wavelength: float, focal_length: float) -> None:
    """Ask about a lens of a few wavelengths, or one whose focus is hundreds of pupils away."""
    diameter = _diameter(pupil)
    if diameter is None:
        return
    if diameter < _NARROWEST_LENS * wavelength:
        warn_caller(
            f"got a pupil of {diameter:.3g} m at a wavelength of {wavelength:.3g} m: micrometres "
            "for m? Then write 0.55e-6 for 0.55 micrometres"
        )
    elif focal_length > _LONGEST_FOCUS * diameter:
        warn_caller(
            f"got a focal length of {focal_length:.3g} m, {focal_length / diameter:.3g} times the "
            f"pupil of {diameter:.3g} m: is a unit wrong, mm for m?"
        )


def warn_of_distance(sources: Any, places: NDArray[np.float64], wavelength: float) -> None:
    """Ask about links to places (n, 3) that are farther than links of such sources are."""
    distance = float(np.linalg.norm(places, axis=-1).max(initial=0.0))
    size = max(_diameter(source) or 0.0 for source in sources)
    if distance > _LONGEST_LINK * max(size, wavelength):
        warn_caller(
            f"got a link of {distance:.6g} m, {distance / size:.3g} times the size of its sources: "
            "is a unit wrong, mm for m?"
        )


def _diameter(source: Any) -> float | None:
    """Diagonal of the bounds of a source, in m; None for anything else."""
    outline = getattr(source, "source", source)  # of a differentiable one
    try:
        bounds = getattr(getattr(outline, "aperture", outline), "bounds", None)
    except PolywignerError:
        return None
    if bounds is None:
        return None
    middle = len(bounds) // 2
    return math.dist(bounds[:middle], bounds[middle:])


def warn_of_degrees(name: str, radians: NDArray[np.float64]) -> None:
    """Ask about angles beyond a turn, or whole numbers of which some are behind the source."""
    largest = float(np.abs(radians).max(initial=0.0))
    behind = name == "theta" and largest > math.pi / 2 and bool((radians % 1 == 0).all())
    if largest > _A_TURN or behind:
        warn_caller(f"got {name} up to {largest:g} rad: degrees? Then write numpy.radians({name})")


def is_called_by_user(depth: int = 1) -> bool:
    """Whether the function that asks was called from outside of the package."""
    return not _is_ours(sys._getframe(depth + 1))


def warn_caller(message: str) -> None:
    """A :class:`PolywignerWarning` at the line outside of the package that called into it.

    Once for a line, whatever the numbers in it, as a sweep would change them; always where filters
    say so.
    """
    level, frame = 2, sys._getframe(1)
    while frame.f_back is not None and _is_ours(frame):
        level, frame = level + 1, frame.f_back
    # Python's own memory of lines is lost with every catch_warnings, also one in a library.
    place = frame.f_code.co_filename, frame.f_lineno, re.sub(r"\d[\d.e+-]*", "", message)
    if place not in _asked or not _is_once():
        _asked.add(place)
        warnings.warn(message, PolywignerWarning, stacklevel=level)


def _is_once() -> bool:
    """Whether filters leave it at one warning for a line."""
    for action, text, category, module, _ in warnings.filters:
        if text is None and module is None and issubclass(PolywignerWarning, category):
            return action not in ("always", "error")
    return True


def _is_ours(frame: Any) -> bool:
    name = str(frame.f_globals.get("__name__", ""))
    return name.partition(".")[0] == _PACKAGE
