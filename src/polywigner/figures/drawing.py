"""Parts of pictures that several figures have: polygons, axes of lengths, letters of panels."""

from __future__ import annotations

from collections.abc import Iterable
from string import ascii_lowercase
from typing import TYPE_CHECKING, Any

import numpy as np

from polywigner.figures.style import LengthUnit
from polywigner.geometry.display import draw_rings

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["draw_polygons", "length_axes", "letter_panels", "number_panels"]


def draw_polygons(axes: Axes, shape: Any, unit: LengthUnit, **how: Any) -> None:
    """A shapely polygon or multipolygon in metres, holes cut out, in the unit that is printed."""
    polygons = [p for p in getattr(shape, "geoms", [shape]) if p.geom_type == "Polygon"]
    rings = [ring for p in polygons for ring in (p.exterior, *p.interiors)]
    if rings:
        draw_rings(axes, [np.asarray(ring.coords) for ring in rings], unit.metres, **how)


def length_axes(axes: Axes, symbol: str, unit: LengthUnit) -> None:
    """Both axes to one scale, around what is drawn, labelled with the components of ``symbol``."""
    axes.set_aspect("equal", adjustable="datalim")
    axes.margins(0.08)
    axes.autoscale_view()
    # A position is (x, y), a lag (xi_x, xi_y).
    across, up = ("x", "y") if symbol == "x" else (f"{symbol}_x", f"{symbol}_y")
    axes.set_xlabel(f"${across}$ ({unit.name})")
    axes.set_ylabel(f"${up}$ ({unit.name})")


def letter_panels(panels: Iterable[Axes]) -> None:
    """(a), (b), ... in the upper left corners."""
    for letter, axes in zip(ascii_lowercase, panels, strict=False):
        axes.set_title(f"({letter})", loc="left", fontweight="bold")


def number_panels(figure: Figure, letter: str) -> None:
    """(a1), (a2), ... in the upper left corners of a picture that is itself a part (a) of a figure.

    Before what stands there already. Panels are all axes that are shown, but for colour bars.
    """
    shown = [
        axes
        for axes in figure.axes
        if axes.get_label() != "<colorbar>" and axes.get_visible() and axes.axison
    ]
    for number, axes in enumerate(shown, start=1):
        beside = axes.get_title(loc="left")
        text = rf"$\mathbf{{({letter}{number})}}$  {beside}".rstrip()
        axes.set_title(text, loc="left", fontsize=8 if beside else 9)
