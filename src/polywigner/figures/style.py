"""Common style of all figures: colour maps, axes, colour bars and layouts."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from functools import wraps
from string import ascii_lowercase
from typing import TYPE_CHECKING, Any, ParamSpec, TypeAlias, TypeVar

import numpy as np

from polywigner.geometry.arguments import checked_type
from polywigner.geometry.parts import polygons_in
from polywigner.geometry.rings import draw_rings, rings_of_polygon
from polywigner.quantities import LengthUnit
from polywigner.transforms.projection import is_frequency

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.collections import QuadMesh
    from matplotlib.colorbar import Colorbar
    from matplotlib.figure import Figure
    from matplotlib.image import AxesImage
    from matplotlib.text import Annotation

    Map: TypeAlias = AxesImage | QuadMesh

LEVEL_MAP = "inferno"  # colour map of levels: perceptually uniform, black at the floor
SIGNED_MAP = "RdBu_r"  # colour map of signed values: diverging, white at zero
PHASE_MAP = "twilight"  # colour map of phases: the same colour at -180 and 180 degrees

# colours of outlines, filled regions and marks
INK, TINT, ACCENT = "#1f3b57", "#c6d7e6", "#c1440e"
# colours of lines
RED, BLUE, ORANGE, GREEN, VIOLET = "#d7301f", "#2166ac", "#e69f00", "#1b9e77", "#7b3294"

TYPOGRAPHY: dict[Any, Any] = {
    # Matplotlib includes this font.
    "font.family": "DejaVu Sans",
    "font.size": 9,
    "axes.titlesize": 9,
    "axes.labelsize": 9,
    "xtick.labelsize": 8,
    "ytick.labelsize": 8,
    "axes.linewidth": 0.6,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
}

Arguments = ParamSpec("Arguments")
Result = TypeVar("Result")


def typeset(draw: Callable[Arguments, Result]) -> Callable[Arguments, Result]:
    """Decorate a drawing function to use TYPOGRAPHY."""

    @wraps(draw)
    def drawn(*values: Arguments.args, **options: Arguments.kwargs) -> Result:
        import matplotlib as mpl

        with mpl.rc_context(TYPOGRAPHY):
            return draw(*values, **options)

    return drawn


# Fraction of the peak up to which the colour scale of signed values is linear.
_LINEAR = 0.01


def draw_levels(
    axes: Axes, levels: Any, across: Any = None, up: Any = None, *, low: float,
    high: float | None = 0.0, label: str | None = None,
    **options: Any,
) -> Map:  # fmt: skip
    """Draw levels from ``low`` (black) to ``high``, by default the largest level.

    A ``label`` adds a colour bar. See :func:`draw_map` for ``across`` and ``up``.
    """
    shown = draw_map(axes, levels, across, up, cmap=LEVEL_MAP, vmin=low, vmax=high, **options)
    if label is not None:
        colour_bar(axes, shown, label)
    return shown


def draw_signed(
    axes: Axes, values: Any, across: Any = None, up: Any = None, *, bound: float | None = None,
    label: str | None = None, **options: Any,
) -> Map:  # fmt: skip
    """Draw signed values on a colour scale from ``-bound`` to ``bound``.

    Without a bound, the values are from -1 to 1, and the scale is linear up to 0.01 and logarithmic
    beyond. A ``label`` adds a colour bar. See :func:`draw_map` for ``across`` and ``up``.
    """
    if bound is None:
        from matplotlib.colors import SymLogNorm

        options["norm"] = SymLogNorm(_LINEAR, linscale=0.5, vmin=-1.0, vmax=1.0)
    else:
        options |= {"vmin": -bound, "vmax": bound}
    shown = draw_map(axes, values, across, up, cmap=SIGNED_MAP, **options)
    if label is not None:
        signed_bar(axes, shown, label)
    return shown


def draw_map(axes: Axes, values: Any, across: Any, up: Any, **options: Any) -> Map:
    """Draw values (rows, columns) as an image, or as a mesh if ``options`` specifies a shading.

    ``across`` and ``up`` are the ascending centres of columns and rows, evenly spaced for an image.
    Without positions, the first row is at the top.
    """
    if "shading" in options:
        return axes.pcolormesh(across, up, values, rasterized=True, **options)
    if across is None:
        return axes.imshow(values, **options)
    half = (across[1] - across[0]) / 2, (up[1] - up[0]) / 2
    extent = across[0] - half[0], across[-1] + half[0], up[0] - half[1], up[-1] + half[1]
    return axes.imshow(
        values, origin="lower", extent=extent, **({"interpolation": "nearest"} | options)
    )


def number_text(value: float) -> str:
    """Format a number with up to six significant digits and a typographic minus sign."""
    return f"{value:g}".replace("-", "−")


def quantity_text(value: float, unit: str) -> str:
    """Format a value with three significant digits and its unit: ``1.23e-05 W/m²/sr``."""
    return f"{value:.3g} {unit}".rstrip()


def floor_text(floor: float, unit: str = "dB") -> str:
    """Format the lowest level of a colour scale for its label, such as "floor −40 dB"."""
    return f"floor {number_text(floor)} {unit}"


def new_figure(
    width: float, height: float, spacing: float = 0.02, *, is_compressed: bool = False
) -> Figure:
    """Return an empty figure, sized in inches, that is not registered with pyplot.

    ``spacing`` is a fraction of the panel size. A compressed layout places panels with a fixed
    aspect ratio next to each other.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from matplotlib.layout_engine import ConstrainedLayoutEngine

    layout: Any = ConstrainedLayoutEngine(wspace=spacing, hspace=spacing, compress=is_compressed)
    figure = Figure(figsize=(width, height), dpi=150, layout=layout)
    FigureCanvasAgg(figure)
    return figure


def figure_on(figure: Any, width: float, height: float, title: str, **layout: Any) -> Figure:
    """Return the caller's figure or subfigure, or a :func:`new_figure` for None, with a title.

    An empty figure without a layout engine gets the constrained layout, in which colour bars do not
    overlap panels. An empty title keeps the caller's title. Raises ArgumentError for other types.
    """
    from matplotlib.figure import Figure, FigureBase

    if figure is None:
        figure = new_figure(width, height, **layout)
    advice = "pass a figure instead of axes, because several panels are drawn"
    expected = "figure to be a matplotlib Figure or SubFigure"
    checked_type(figure, expected, FigureBase, advice=advice)
    if isinstance(figure, Figure) and figure.get_layout_engine() is None and not figure.axes:
        figure.set_layout_engine("constrained")
    if title or not figure.get_suptitle():
        figure.suptitle(title)
    result: Any = figure
    return result


def axes_on(ax: Any, width: float, height: float) -> tuple[Axes, Axes | Figure]:
    """Return the axes to draw on, and the return value of a drawing function.

    The return value is ``ax``, or a new figure if ``ax`` is None. Raises ArgumentError for other
    types.
    """
    from matplotlib.axes import Axes

    if ax is None:
        figure = new_figure(width, height)
        return figure.add_subplot(), figure
    advice = "create axes with matplotlib.pyplot.subplots()"
    checked_type(ax, "ax to be matplotlib Axes", Axes, advice=advice)
    return ax, ax


def format_line_axes(axes: Axes, *, legend: float = 0.0, **labels: Any) -> None:
    """Set labels and limits of axes, and add a grid; ``legend`` is the font size of a legend."""
    axes.set(**labels)
    axes.grid(alpha=0.3, lw=0.5)
    if legend:
        axes.legend(frameon=False, fontsize=legend)


def degrees_text(angle: float) -> str:
    """Format an angle in radians as degrees with at most two decimals, such as "12.5°"."""
    return f"{number_text(round(float(np.degrees(angle)), 2))}°"


def colour_bar(panels: Any, mappable: Any, label: str, extend: str = "neither") -> Colorbar:
    """Draw a labelled colour bar next to axes, or to the right of a row of panels."""
    row = [panels] if hasattr(panels, "figure") else list(panels)
    options = {"aspect": 18} if len(row) > 1 or row[0] is not panels else {}
    bar: Colorbar = row[0].figure.colorbar(
        mappable, ax=row, extend=extend, fraction=0.046 / len(row), pad=0.03 / len(row), **options
    )
    bar.set_label(label)
    bar.outline.set_linewidth(0.6)
    return bar


def signed_bar(axes: Any, mappable: Any, label: str) -> None:
    """Draw a colour bar for signed values on a logarithmic scale from -1 to 1."""
    set_ticks(colour_bar(axes, mappable, label).ax.yaxis, [-1, -0.1, -0.01, 0, 0.01, 0.1, 1])


def set_ticks(axis: Any, values: Any) -> None:
    """Set the major ticks of a signed logarithmic axis, and remove the minor ticks."""
    axis.set_ticks(values, [number_text(value) for value in values])
    axis.set_ticks([], minor=True)


def draw_polygons(axes: Axes, shape: Any, unit: LengthUnit, **options: Any) -> None:
    """Draw the polygons of a shapely geometry, converted from metres to a unit."""
    rings = [ring for polygon in polygons_in(shape) for ring in rings_of_polygon(polygon)]
    if rings:
        draw_rings(axes, rings, unit.metres, **options)


def draw_outlines(axes: Any, lines: Any, inks: Sequence[str], zorder: float = 2) -> None:
    """Draw lines (n, points, 2 or 3) in two colours that make them visible on any background.

    ``inks`` are the colours of a wide line and of a narrow line on top of it. The limits of the
    axes do not change.
    """
    from matplotlib.collections import LineCollection
    from mpl_toolkits.mplot3d.art3d import Line3DCollection

    flat = np.shape(lines)[-1] == 2
    for ink, width in zip(inks, (2.2, 1.0), strict=True):
        options: dict[str, Any] = {"colors": ink, "linewidths": width, "zorder": zorder}
        options["capstyle"] = "round"
        drawn: Any = (LineCollection if flat else Line3DCollection)(list(lines), **options)
        add = axes.add_collection if flat else axes.add_collection3d
        add(drawn, autolim=False)


def draw_disc(
    axes: Axes, theta: Any, phi: Any, levels: Any, low: float, high: float,
    label: str | None = None, names: str = "",
) -> Map:  # fmt: skip
    """Draw levels (theta, phi) over direction cosines; theta and phi are in rad.

    ``names`` contains the letters of the two cosines, for labels of the axes. If phi ends one step
    before the full circle, the disc is closed.
    """
    step = phi[1] - phi[0] if len(phi) > 1 else 0.0
    if abs(phi[-1] + step - phi[0] - 2 * np.pi) <= 1e-6 * max(step, 1e-6):
        phi = np.append(phi, phi[0] + 2 * np.pi)
        levels = np.concatenate([levels, levels[:, :1]], axis=1)
    sine = np.sin(theta)[:, None]
    x, y = sine * np.cos(phi), sine * np.sin(phi)
    shown = draw_levels(axes, levels, x, y, low=low, high=high, shading="gouraud")
    draw_circles(axes, above=True)
    axes.set(aspect="equal", xlim=(-1.02, 1.02), ylim=(-1.02, 1.02))
    for name, axis, function in zip(names, "xy", ("cos", "sin"), strict=False):
        axes.set(**{f"{axis}label": rf"${name} = \sin\theta\,\{function}\phi$"})
    if label is not None:
        colour_bar(axes, shown, label)
    return shown


def draw_circles(axes: Axes, *, above: bool) -> None:
    """Draw circles of radius sin(theta) for theta of 30, 60 and 90 degrees.

    ``above``: whether the labels are above the centre instead of below.
    """
    from matplotlib.patches import Circle

    for degrees in (30, 60):
        radius = float(np.sin(np.radians(degrees)))
        axes.add_patch(Circle((0, 0), radius, lw=0.6, ls=":", edgecolor="white", fill=False))
        offset, side = radius * np.sqrt(0.5), 1 if above else -1
        axes.text(
            offset, side * offset, f"{degrees}°", color="white", fontsize=7,
            ha="left" if above else "right", va="bottom" if above else "top", clip_on=True,
        )  # fmt: skip
    axes.add_patch(Circle((0, 0), 1.0, lw=0.6, edgecolor="0.4", fill=False))


def separate_labels(axes: Axes, labels: Iterable[Annotation]) -> None:
    """Move annotations so that they neither overlap nor leave the axes."""
    from matplotlib.transforms import Bbox

    figure: Any = axes.get_figure(root=True)
    figure.draw_without_rendering()  # Compute the sizes of labels.
    frame = axes.get_window_extent()
    occupied: list[Bbox] = []
    directions = ((0, 1), (0, -1), (1, 0), (-1, 0), (1, 1), (-1, 1), (1, -1), (-1, -1))
    for label in labels:
        first, size = label.get_position(), label.get_window_extent()
        gap = float(np.hypot(*first))  # in points
        width, height = (72 / figure.dpi * n + gap for n in (size.width / 2, size.height))
        rings = [(n * x * width, n * y * height) for n in (1, 2, 3) for x, y in directions]
        for offset in (first, *rings):
            label.set_position(offset)
            box = label.get_window_extent()
            inside = frame.x0 <= box.x0 and box.x1 <= frame.x1
            inside &= frame.y0 <= box.y0 and box.y1 <= frame.y1
            if inside and not any(box.overlaps(other) for other in occupied):
                break
        else:
            label.set_position(first)
        occupied.append(label.get_window_extent())


def mark_evanescent(axes: Axes, wavelength: float, unit: LengthUnit, ink: str) -> None:
    """Draw the dotted circle |nu| = 1/wavelength, outside which waves are evanescent.

    The wavelength is in m, and the axes are in 1/unit.
    """
    from matplotlib.patches import Circle

    radius = unit.metres / wavelength
    axes.add_patch(Circle((0, 0), radius, fill=False, edgecolor=ink, lw=0.8, ls=":"))


def latex(name: str) -> str:
    """Return the LaTeX code of a coordinate such as "nu_x", without dollar signs."""
    return f"\\{name}" if name.startswith(("xi", "nu", "upsilon")) else name


def axis_label(name: str, unit: LengthUnit) -> str:
    """Return the label of a coordinate with its unit, such as ``nu_x (1/mm)``."""
    return f"${latex(name)}$ ({'1/' if is_frequency(name) else ''}{unit.name})"


def label_axes(axes: Axes, symbol: str, unit: LengthUnit) -> None:
    """Label axes with the components of a symbol, such as xi_x and xi_y."""
    across, up = ("x", "y") if symbol == "x" else (f"{symbol}_x", f"{symbol}_y")
    axes.set(xlabel=axis_label(across, unit), ylabel=axis_label(up, unit))


def length_axes(axes: Axes, symbol: str, unit: LengthUnit) -> None:
    """Label axes of lengths, with equal scales and limits around the drawing."""
    axes.set_aspect("equal", adjustable="datalim")
    axes.margins(0.08)
    axes.autoscale_view()
    label_axes(axes, symbol, unit)


def letter_panels(panels: Iterable[Axes]) -> None:
    """Write (a), (b), ... above the panels."""
    for letter, axes in zip(ascii_lowercase, panels, strict=False):
        axes.set_title(f"({letter})", loc="left", fontweight="bold")
