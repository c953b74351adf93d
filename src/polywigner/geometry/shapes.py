"""Catalogue of apertures. Lengths in metres (any one consistent unit); centred at the origin."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from polywigner.errors import ArgumentError
from polywigner.geometry.aperture import Aperture

__all__ = ["chevron", "disc", "rectangle", "regular_polygon", "square", "triangle"]


def _length(value: Any, name: str) -> float:
    try:
        number = float(value)
    except (TypeError, ValueError):
        number = math.nan
    if isinstance(value, (str, bytes, bool)) or not (math.isfinite(number) and number > 0):
        raise ArgumentError(f"expected {name} as a length above zero, got {value!r}")
    return number


def _count(value: Any, name: str, least: int) -> int:
    if isinstance(value, bool) or not isinstance(value, (int, np.integer)) or value < least:
        raise ArgumentError(f"expected {name} as a whole number of at least {least}, got {value!r}")
    return int(value)


def _circle(radius: float, n: int) -> np.ndarray:
    angle = 2 * np.pi * np.arange(n) / n
    return radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)


def rectangle(a: float, b: float) -> Aperture:
    """Rectangle of width a along x and height b along y."""
    x, y = _length(a, "a") / 2, _length(b, "b") / 2
    return Aperture([[-x, -y], [x, -y], [x, y], [-x, y]])


def square(a: float) -> Aperture:
    """Square of side a."""
    return rectangle(a, a)


def triangle(base: float, height: float) -> Aperture:
    """Isosceles triangle, base at the bottom; the centre of its bounds is the origin."""
    x, y = _length(base, "base") / 2, _length(height, "height") / 2
    return Aperture([[-x, -y], [x, -y], [0.0, y]])


def regular_polygon(n: int, radius: float) -> Aperture:
    """Regular n-gon; its circumscribed circle has the given radius, a vertex is on +x."""
    return Aperture(_circle(_length(radius, "radius"), _count(n, "n", 3)))


def disc(radius: float, n: int = 64) -> Aperture:
    """Regular n-gon with the area of a disc of the given radius."""
    sides = _count(n, "n", 3)
    step = 2 * np.pi / sides
    return regular_polygon(sides, _length(radius, "radius") * math.sqrt(step / math.sin(step)))


def chevron(width: float, height: float, thickness: float) -> Aperture:
    """An arrow pointing to +y: two arms of the given vertical thickness, below height overall."""
    x, y = _length(width, "width") / 2, _length(height, "height") / 2
    t = _length(thickness, "thickness")
    if not t < 2 * y:
        raise ArgumentError(f"expected thickness below height {height!r}, got {thickness!r}")
    return Aperture([[-x, -y], [0.0, y - t], [x, -y], [x, t - y], [0.0, y], [-x, t - y]])
