"""Figures of lines: the outline that is edited, the lag slice, the far field's cuts."""

from __future__ import annotations

import math
from itertools import chain
from typing import Any

import numpy as np
from bokeh.core.properties import value
from bokeh.models import CDSView, ColumnDataSource, GroupFilter, PointDrawTool, Scatter

from polywigner.explorer.page.pictures import plain_figure
from polywigner.explorer.state import State
from polywigner.explorer.views import Cuts, Outlines

_INK, _TINT, _ACCENT = "#2f6da8", "#8fb8dd", "#d4561f"  # seen on white and on black
_HANDLES = ((60, 10), (150, 7), (math.inf, 4))  # vertices, and the pixels of each
_MOST_HANDLES = 200  # a page with more to paint and to look through answers a hand late
_TITLE = "Aperture (full), support of W (pale)"
_SPAN = 40.0  # dB, of the polar plot
_LINEAR = 100.0  # dB, of the axial ratio: the rest is rounding


def _multi(polygons: list[list[Any]], scale: float) -> dict[str, list[Any]]:
    """Columns of Bokeh's multi_polygons."""
    return {
        "xs": [[[(scale * ring[:, 0]).tolist() for ring in rings]] for rings in polygons],
        "ys": [[[(scale * ring[:, 1]).tolist() for ring in rings]] for rings in polygons],
    }


def _empty() -> ColumnDataSource:
    return ColumnDataSource({"xs": [], "ys": []})


class ApertureFigure:
    """The outline with its vertices to drag, the support of W, and the chosen position."""

    def __init__(self) -> None:
        self.figure = made = plain_figure(_TITLE, "aperture")
        self.support, self.filled = _empty(), _empty()
        self.outline = ColumnDataSource({"xs": [], "ys": [], "number": []}, name="outline")
        columns: dict[str, list[Any]] = {"x": [], "y": [], "ring": [], "handle": []}
        self.vertices = ColumnDataSource(columns, name="vertices")
        self.pending = ColumnDataSource({"x": [], "y": []})
        self.cross = ColumnDataSource({"x": [], "y": []})
        both = {"xs": "xs", "ys": "ys"}
        made.multi_polygons(**both, source=self.support, color=_TINT, fill_alpha=0.35)
        made.multi_polygons(**both, source=self.filled, color=_INK, line_color=None)
        edges = made.patches(
            **both, source=self.outline, fill_alpha=0.0, line_color=_INK, line_width=2
        )
        edges.nonselection_glyph = None
        made.line("x", "y", source=self.pending, color=_ACCENT, line_width=2, line_dash="dashed")
        made.scatter("x", "y", source=self.pending, color=_ACCENT, size=7)
        self.handles = handles = made.scatter(
            "x", "y", source=self.vertices, size=10, color="white", line_color=_ACCENT,
            line_width=2, view=CDSView(filter=GroupFilter(column_name="handle", group="yes")),
        )  # fmt: skip
        handles.nonselection_glyph = None
        handles.selection_glyph = Scatter(
            x="x", y="y", size=13, fill_color=_ACCENT, line_color="white", line_width=2
        )
        made.scatter(
            "x", "y", source=self.cross, marker="cross", size=14, line_width=2, color="#ffb000"
        )
        self.tool = PointDrawTool(renderers=[handles], add=False, description="Move vertices")
        made.add_tools(self.tool)
        made.toolbar.active_drag = self.tool
        self._window: tuple[Any, ...] = ()

    def show_outlines(self, found: Outlines, state: State) -> None:
        """Shows the computed shapes: the filled source and the support."""
        self.support.data = _multi(found.support, state.per_metre)
        self.filled.data = _multi(found.source, state.per_metre)

    def show_edges(self, state: State) -> None:
        """Outline and handles of the state, also of one that is no polygon."""
        xs = [[x for x, _ in ring] for ring in state.rings]
        ys = [[y for _, y in ring] for ring in state.rings]
        self.outline.data = {"xs": xs, "ys": ys, "number": [*range(len(xs))]}
        numbers = [k for k, ring in enumerate(state.rings) for _ in ring]
        count = len(numbers)
        step = math.ceil(count / _MOST_HANDLES) or 1
        handles = ["yes" if k % step == 0 else "" for k in range(count)]
        self.vertices.data = {
            "x": [*chain(*xs)], "y": [*chain(*ys)], "ring": numbers, "handle": handles,
        }  # fmt: skip
        self.vertices.selected.indices = []
        few = f"Aperture; {handles.count('yes')} handles, {count} vertices"
        self.figure.title.text = _TITLE if step == 1 else few
        self.handles.glyph.size = next(s for most, s in _HANDLES if len(numbers) <= most)

    @property
    def chosen(self) -> int | None:
        """The number of the selected vertex, all outlines counted through."""
        indices = self.vertices.selected.indices
        return int(indices[0]) if indices and indices[0] < len(self.vertices.data["x"]) else None

    def choose(self, vertex: int | None) -> None:
        """Select a vertex, or none."""
        if vertex is not None and not self.vertices.data["handle"][vertex]:
            handles = [*self.vertices.data["handle"]]
            handles[vertex] = "yes"
            self.vertices.data = {**self.vertices.data, "handle": handles}
        self.vertices.selected.indices = [] if vertex is None else [vertex]

    def clear(self) -> None:
        """A blank sheet."""
        self.support.data, self.filled.data = {"xs": [], "ys": []}, {"xs": [], "ys": []}

    def frame(self, low: tuple[float, float], high: tuple[float, float], unit: str) -> None:
        """Set the window around the drawing."""
        window = (low, high, unit)
        if window != self._window:
            self._window = window
            self.reset()

    def reset(self) -> None:
        """All that is drawn, after a visitor has zoomed or moved the figure."""
        low, high, unit = self._window
        half = 0.7 * max(high[0] - low[0], high[1] - low[1], 1e-9)
        for axis, k in ((self.figure.x_range, 0), (self.figure.y_range, 1)):
            middle = (low[k] + high[k]) / 2
            axis.update(start=middle - half, end=middle + half)
        self.figure.xaxis.axis_label = f"x ({unit})"
        self.figure.yaxis.axis_label = f"y ({unit})"


class LagFigure:
    """The lag slice at the position under the pointer, or at the chosen one."""

    def __init__(self) -> None:
        self.figure = plain_figure("Lag slice 2(Γ − x) ∩ 2(x − Γ)", "lags")
        self.source = _empty()
        self.figure.multi_polygons(
            xs="xs", ys="ys", source=self.source, color=_ACCENT, fill_alpha=0.35
        )

    def show(self, lags: list[Any], state: State, half: float, at: tuple[float, float]) -> None:
        """Polygons of lags in m, in a window of this half width in m."""
        self.source.data = _multi(lags, state.per_metre)
        end = half * state.per_metre
        self.figure.x_range.update(start=-end, end=end)
        self.figure.y_range.update(start=-end, end=end)
        self.figure.title.text = f"Lag slice at x = ({at[0]:.4g}, {at[1]:.4g}) {state.unit}"
        self.figure.xaxis.axis_label = f"ξ_x ({state.unit})"
        self.figure.yaxis.axis_label = f"ξ_y ({state.unit})"

    def clear(self) -> None:
        """No lags."""
        self.source.data = {"xs": [], "ys": []}


class PolarFigure:
    """Directivity in two planes over the angle from the normal, radially in dB."""

    def __init__(self) -> None:
        self.figure = made = plain_figure("Far field", "far")
        made.axis.visible = False
        self.rings = ColumnDataSource({"xs": [], "ys": []})
        self.labels = ColumnDataSource({"x": [], "y": [], "text": []})
        self.cuts = [ColumnDataSource({"x": [], "y": []}) for _ in range(4)]
        made.multi_line("xs", "ys", source=self.rings, color="#8a939c", alpha=0.5)
        made.text("x", "y", "text", source=self.labels, text_font_size="8pt", text_align="center",
                  text_color="#55616c")  # fmt: skip
        names = ("φ = 0°", "φ = 90°", "cross, φ = 0°", "cross, φ = 90°")
        for k, source in enumerate(self.cuts):
            line = made.line("x", "y", source=source, legend_label=names[k], line_width=1.5,
                             line_dash=("solid", "dashed", "dotted", "dashdot")[k],
                             color=(_INK, _ACCENT)[k % 2])  # fmt: skip
            line.visible = k < 2
        self._names: tuple[str, ...] = names[:2]
        made.legend.location = "bottom_center"
        made.legend.ncols = 2
        made.legend.border_line_color = made.legend.background_fill_color = None
        self.reset()

    def reset(self) -> None:
        """The whole half circle."""
        self.figure.x_range.update(start=-1.25, end=1.25)
        self.figure.y_range.update(start=-1.0, end=1.5)

    def clear(self) -> None:
        """Clear the cuts, which belong to another source."""
        for source in self.cuts:
            source.data = {"x": [], "y": []}

    def show(self, cuts: Cuts) -> None:
        """New cuts; the outermost ring is the next multiple of 5 dB."""
        top = 5 * np.ceil(cuts.largest / 5)
        # a narrow beam is spread over the half circle, and the labels say so
        stretch = (np.pi / 2) / cuts.theta[-1]
        turn = np.linspace(-np.pi / 2, np.pi / 2, 91)
        xs = [r * np.sin(turn) for r in (0.25, 0.5, 0.75, 1.0)]
        ys = [r * np.cos(turn) for r in (0.25, 0.5, 0.75, 1.0)]
        angles = np.radians([-90, -60, -30, 0, 30, 60, 90])
        xs += [np.array([0, np.sin(a)]) for a in angles]
        ys += [np.array([0, np.cos(a)]) for a in angles]
        self.rings.data = {"xs": xs, "ys": ys}
        degrees = np.degrees(angles / stretch)
        text = [f"{d:.3g}°" for d in degrees]
        text += [f"{top - _SPAN * (1 - r):g}" for r in (0.25, 0.5, 0.75)]
        self.labels.data = {
            # those of the horizon below its ends: beside them they are cut off
            "x": [-1.0, *(1.12 * np.sin(angles[1:-1])), 1.0, 0.25, 0.5, 0.75],
            "y": [-0.26, *(1.1 * np.cos(angles[1:-1])), -0.26, -0.13, -0.13, -0.13],
            "text": text,
        }
        names = tuple(name for name, _ in cuts.lines)
        if names != self._names:
            self._names = names
            for k, item in enumerate(self.figure.legend.items):
                item.visible = item.renderers[0].visible = k < len(names)
                item.label = value(names[k] if k < len(names) else "")
        for source, (_, levels) in zip(self.cuts, cuts.lines, strict=False):
            radius = np.clip(1 + (levels - top) / _SPAN, 0, 1)
            angle = stretch * cuts.theta
            source.data = {"x": radius * np.sin(angle), "y": radius * np.cos(angle)}
        title = f"Directivity in dBi, at most {cuts.largest:.2f}"
        if cuts.cross is not None:
            ratio = f"{cuts.axial_ratio:.1f} dB" if cuts.axial_ratio < _LINEAR else "∞"
            title = f"At most {cuts.largest:.2f} dBi; axial ratio {ratio}"
        self.figure.title.text = title
