"""The common style of all pictures: maps, type, units a person reads, and colour bars."""

from __future__ import annotations

from collections.abc import Iterable
from string import ascii_lowercase
from typing import TYPE_CHECKING, Any

import numpy as np

from polywigner.errors import ArgumentError
from polywigner.geometry.display import LengthUnit, draw_rings

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure, SubFigure


LEVEL_MAP = "inferno"  # perceptually uniform, black at the floor
SIGNED_MAP = "RdBu_r"  # diverging, white at zero

TYPOGRAPHY: dict[Any, Any] = {
    "font.family": "DejaVu Sans",  # comes with matplotlib: the same on every machine
    "font.size": 9,
    "axes.titlesize": 9,
    "axes.labelsize": 9,
    "xtick.labelsize": 8,
    "ytick.labelsize": 8,
    "axes.linewidth": 0.6,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
}


def number_text(value: float) -> str:
    """A number as it is printed, with the minus sign that matplotlib's axes have."""
    return f"{value:g}".replace("-", "−")


def quantity_text(value: float, unit: str) -> str:
    """A value with three significant digits and an SI prefix-free unit: ``1.23e-05 W/m²/sr``."""
    return f"{value:.3g} {unit}"


def new_figure(width: float, height: float, spacing: float = 0.02) -> Figure:
    """An empty figure, in inches, that no window shows and pyplot does not keep.

    ``spacing`` between panels, as a part of their size.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from matplotlib.layout_engine import ConstrainedLayoutEngine

    layout = ConstrainedLayoutEngine(wspace=spacing, hspace=spacing)
    figure = Figure(figsize=(width, height), dpi=150, layout=layout)
    FigureCanvasAgg(figure)
    return figure


def figure_on(
    figure: Any, width: float, height: float, *, spacing: float = 0.02, is_compressed: bool = False
) -> Any:
    """The figure or subfigure of a caller, ready to be drawn on; for None a :func:`new_figure`.

    ``is_compressed``: panels of one shape lie next to each other on a new one. An empty figure
    without a layout gets that of :func:`new_figure`, or colour bars would overlap. Raises
    ArgumentError for anything else.
    """
    if figure is None:
        made = new_figure(width, height, spacing)
        if is_compressed:
            made.set_layout_engine("compressed")
        return made
    from matplotlib.figure import Figure, FigureBase
    from matplotlib.layout_engine import ConstrainedLayoutEngine

    if not isinstance(figure, FigureBase):
        raise ArgumentError(
            "expected figure as a matplotlib Figure or SubFigure, got "
            f"{type(figure).__name__}; several panels are drawn, for which axes are not enough"
        )
    if isinstance(figure, Figure) and figure.get_layout_engine() is None and not figure.axes:
        figure.set_layout_engine(ConstrainedLayoutEngine())
    return figure


def checked_axes(axes: Any) -> Any:
    """The axes of a caller; ArgumentError for anything else."""
    from matplotlib.axes import Axes

    if not isinstance(axes, Axes):
        raise ArgumentError(
            f"expected ax as matplotlib Axes, got {type(axes).__name__}; make them by "
            "matplotlib.pyplot.subplots()"
        )
    return axes


def write_title(figure: Figure | SubFigure, title: str) -> None:
    """Write the title above all panels; without one the caller's stays."""
    if title or not figure.get_suptitle():
        figure.suptitle(title)


def colour_bar(axes: Axes, mappable: Any, label: str, extend: str = "neither") -> Any:
    """A labelled colour bar as high as its picture."""
    bar = axes.figure.colorbar(mappable, ax=axes, extend=extend, fraction=0.046, pad=0.03)
    bar.set_label(label)
    bar.outline.set_linewidth(0.6)
    return bar


def row_bar(panels: Any, mappable: Any, label: str, extend: str = "neither") -> Any:
    """A labelled colour bar at the right of a row of panels that share it."""
    row = list(panels)
    bar = row[0].figure.colorbar(
        mappable, ax=row, extend=extend, fraction=0.046 / len(row), pad=0.03 / len(row), aspect=18
    )
    bar.set_label(label)
    bar.outline.set_linewidth(0.6)
    return bar


_LINEAR = 0.01
"""Signed panels are linear within this part of their peak and logarithmic beyond it."""


def signed_norm() -> Any:
    """Colour norm for values from -1 to 1 that shows faint ones as well."""
    from matplotlib.colors import SymLogNorm

    return SymLogNorm(_LINEAR, linscale=0.5, vmin=-1.0, vmax=1.0)


def signed_ticks(bar: Any) -> None:
    """The decades of :func:`signed_norm` at its colour bar."""
    from matplotlib.ticker import FixedLocator, FuncFormatter

    bar.ax.yaxis.set_major_locator(FixedLocator([-1, -0.1, -0.01, 0, 0.01, 0.1, 1]))
    bar.ax.yaxis.set_major_formatter(FuncFormatter(lambda value, _: number_text(value)))
    bar.ax.yaxis.set_minor_locator(FixedLocator([]))


if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


def draw_polygons(axes: Axes, shape: Any, unit: LengthUnit, **how: Any) -> None:
    """A shapely polygon or multipolygon in metres, holes cut out, in the unit that is printed."""
    polygons = [p for p in getattr(shape, "geoms", [shape]) if p.geom_type == "Polygon"]
    rings = [ring for p in polygons for ring in (p.exterior, *p.interiors)]
    if rings:
        draw_rings(axes, [np.asarray(ring.coords) for ring in rings], unit.metres, **how)


def length_axes(axes: Axes, symbol: str, unit: LengthUnit) -> None:
    """Set both axes to one scale around the drawing, labelled with components of ``symbol``."""
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
