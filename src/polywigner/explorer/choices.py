"""Choices of the page: units, shapes to start from, parts of complex values."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Literal

from polywigner.geometry import Aperture, shapes

__all__ = ["CATALOGUE", "UNITS", "Part", "Unit"]

Unit = Literal["m", "cm", "mm", "µm", "nm"]
Part = Literal["level", "real", "phase"]

UNITS: Mapping[str, int] = {"m": 1, "cm": 100, "mm": 1000, "µm": 10**6, "nm": 10**9}
"""Number of each unit in a metre: dividing by it rounds a typed length correctly."""

CATALOGUE: Mapping[str, Callable[[], Aperture]] = {
    "square": lambda: shapes.square(10),
    "rectangle": lambda: shapes.rectangle(12, 8),
    "triangle": lambda: shapes.triangle(12, 10),
    "hexagon": lambda: shapes.regular_polygon(6, 6),
    "octagon": lambda: shapes.regular_polygon(8, 6),
    "disc": lambda: shapes.disc(5, 32),
    "ring": lambda: shapes.ring(6, 3, 24),
    "star": lambda: shapes.star(5, 7, 3),
    "chevron": lambda: shapes.chevron(20, 12, 4),
    "two chevrons": lambda: shapes.chevron_pair(20, 12, 4),
    "vee": lambda: shapes.vee(12, 10, 2),
    "u shape": lambda: shapes.u_shape(12, 10, 3),
    "bow-tie": lambda: shapes.bow_tie(14, 8, 1),
    "double slit": lambda: shapes.double_slit(2, 12, (-4, 4)),
    "18 hexagons": lambda: shapes.hexagonal_segments(2.5, 0.1),
}
"""Shapes of some ten units, whatever the unit."""
