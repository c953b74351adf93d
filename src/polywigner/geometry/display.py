"""Display of sources: HTML with a drawing in notebooks, and axes of matplotlib."""

from __future__ import annotations

import html
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from polywigner.errors import ArgumentError
from polywigner.quantities import parse_unit

if TYPE_CHECKING:
    from matplotlib.axes import Axes


Points = NDArray[np.float64]

_PIXELS = 160.0
_MARGIN = 6.0
_FILL = "#9ecae1"
_LINE = "#2166ac"


class LengthUnit(NamedTuple):
    """A unit of length to print: its name and its size in metres."""

    name: str
    metres: float


_UNITS = (LengthUnit("nm", 1e-9), LengthUnit("µm", 1e-6), LengthUnit("mm", 1e-3))


def length_unit(length: float) -> LengthUnit:
    """Return the unit that expresses a length (m) as a number from 1 to 1000, or metres."""
    for unit in _UNITS:
        if length < 1000 * unit.metres:
            return unit
    return LengthUnit("m", 1.0)


def length_text(*lengths: float) -> str:
    """Return lengths (m) in the unit of the largest one, such as ``20 x 12 mm``."""
    unit = length_unit(max(lengths))
    return f"{' x '.join(f'{length / unit.metres:.4g}' for length in lengths)} {unit.name}"


def shown_as_html(
    title: str,
    rows: Iterable[tuple[str, str]],
    rings: Sequence[Points] = (),
    lines: Sequence[Points] = (),
) -> str:
    """Return a drawing of filled rings and lines, y upwards, next to a table of properties."""
    cells = "".join(
        f"<tr><td style='text-align:left'>{html.escape(name)}</td>"
        f"<td style='text-align:left'>{html.escape(value)}</td></tr>"
        for name, value in rows
    )
    drawing = _svg(rings, lines)
    return (
        f"<div><div style='display:inline-block;vertical-align:top'>{drawing}</div>"
        "<div style='display:inline-block;vertical-align:top;margin-left:1em'>"
        f"<b>{html.escape(title)}</b><table>{cells}</table></div></div>"
    )


def _svg(rings: Sequence[Points], lines: Sequence[Points]) -> str:
    if not rings and not lines:
        return ""
    points = np.concatenate([*rings, *lines])
    low, high = points.min(axis=0), points.max(axis=0)
    scale = _PIXELS / float((high - low).max())
    width, height = (high - low) * scale + 2 * _MARGIN

    def path(ring: Points) -> str:
        x, y = (ring - low).T * scale + _MARGIN
        return "M" + "L".join(f"{a:.2f} {height - b:.2f}" for a, b in zip(x, y, strict=True))

    filled = "".join(path(ring) + "Z" for ring in rings)
    drawn = "".join(path(line) for line in lines)
    return (
        f"<svg xmlns='http://www.w3.org/2000/svg' width='{width:.0f}' height='{height:.0f}'>"
        f"<path d='{filled}' fill='{_FILL}' fill-rule='evenodd' stroke='{_LINE}'/>"
        f"<path d='{drawn}' fill='none' stroke='{_LINE}'/></svg>"
    )


def plot_rings(rings: Sequence[Points], ax: Axes | None, unit: str) -> Axes:
    """Plot filled rings on ``ax``, or on new axes of pyplot, in a unit of length.

    Raises ArgumentError for other objects than axes, QuantityError for an unknown unit.
    """
    scale = parse_unit(unit)
    if ax is None:
        from matplotlib import pyplot

        ax = pyplot.subplots()[1]
    if not hasattr(ax, "add_patch"):
        raise ArgumentError(f"expected axes of matplotlib, got {type(ax).__name__}")
    closed = [np.append(ring, ring[:1], axis=0) for ring in rings]
    draw_rings(ax, closed, scale, facecolor=_FILL, edgecolor=_LINE)
    ax.set_aspect("equal")
    ax.autoscale_view()
    ax.set_xlabel(f"x ({unit})")
    ax.set_ylabel(f"y ({unit})")
    return ax


def draw_rings(ax: Axes, rings: Sequence[Points], metres: float, **how: Any) -> None:
    """Draw closed rings (m) with holes as one patch; the axes have a unit of ``metres``."""
    from matplotlib.patches import PathPatch
    from matplotlib.path import Path

    paths: list[Any] = [Path(ring / metres, closed=True) for ring in rings]
    path = Path.make_compound_path(*paths)
    ax.add_patch(PathPatch(path, **how))
    ax.update_datalim(path.vertices)
