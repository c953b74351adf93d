"""Bokeh figures of the page: the outline editor, and one figure for each view."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import Any

import matplotlib as mpl
import numpy as np
from bokeh import models
from bokeh.events import DoubleTap, PointEvent, Tap
from bokeh.plotting import figure as Figure

from polywigner.explorer.state import Point, Rings, State, rings_of_rows, with_vertex
from polywigner.explorer.views import Name, Polygon, View, polygon_columns
from polywigner.figures.style import ACCENT, BLUE, INK, ORANGE

PALE = "#c6d7e6"
_DRAG_JS = """
const {x, y, ring} = vertices.data
const rings = new Map()
for (let i = 0; i < x.length; i++) {
  if (!rings.has(ring[i])) rings.set(ring[i], [[], []])
  rings.get(ring[i])[0].push(x[i])
  rings.get(ring[i])[1].push(y[i])
}
drawn.data.xs = [[[...rings.values()].map((r) => r[0])]]
drawn.data.ys = [[[...rings.values()].map((r) => r[1])]]
drawn.change.emit()  // in this browser only
const now = Date.now()
if (now - (relay.tags[0] ?? 0) > 60) {
  relay.tags[0] = now
  relay.data = {x: [...x], y: [...y], ring: [...ring]}
}
"""


class Editor:
    """Outline editor, which reports edits to ``on_rings`` and clicks to ``on_position``."""

    def __init__(
        self, on_rings: Callable[[Rings, bool], None], on_position: Callable[[Point], None]
    ) -> None:
        self._on_rings, self._on_position = on_rings, on_position
        self._rings: Rings = ()
        self.sketch: list[Point] | None = None  # corners of a new outline; None in edit mode
        self.vertices = models.ColumnDataSource({"x": [], "y": [], "ring": []}, name="vertices")
        self._drawn = models.ColumnDataSource({"xs": [], "ys": []})
        self._support = models.ColumnDataSource({"xs": [], "ys": []})
        self._position = models.ColumnDataSource({"x": [0.0], "y": [0.0]})
        self._sketch = models.ColumnDataSource({"x": [], "y": []})
        self._relay = models.ColumnDataSource({"x": [], "y": [], "ring": []}, tags=[0])
        plot = _new_figure(
            "editor", tools="pan,wheel_zoom,reset", active_drag=None, active_scroll=None,
            min_border_left=58, min_border_right=22, min_border_top=34, min_border_bottom=46,
            output_backend="canvas",
        )  # fmt: skip
        # `add_glyph` adds one glyph; methods such as plot.scatter would create four.
        plot.add_glyph(self._support, models.MultiPolygons(fill_color=PALE, line_color=None))
        plot.add_glyph(
            self._drawn, models.MultiPolygons(fill_color=BLUE, fill_alpha=0.75, line_color=INK)
        )
        cross = models.Scatter(marker="cross", size=16, line_width=3, line_color=ORANGE)
        plot.add_glyph(self._position, cross)
        plot.add_glyph(self._sketch, models.Line(line_color=ACCENT, line_width=2))
        plot.add_glyph(self._sketch, models.Scatter(size=8, fill_color=ACCENT, line_color="white"))
        handle = models.Scatter(size=11, fill_color="white", line_color=ACCENT, line_width=2)
        chosen = models.Scatter(size=11, fill_color=ACCENT, line_color=ACCENT)
        handles = plot.add_glyph(
            self.vertices, handle, selection_glyph=chosen, nonselection_glyph=handle
        )
        drag = models.PointDrawTool(renderers=[handles], add=False)
        plot.add_tools(drag)
        plot.toolbar.active_multi = drag
        sources = {"vertices": self.vertices, "drawn": self._drawn, "relay": self._relay}
        plot.js_on_event("pan", models.CustomJS(args=sources, code=_DRAG_JS))
        self._relay.on_change("data", lambda attr, old, new: self._edited(self._relay, False))
        self.vertices.on_change("data", lambda attr, old, new: self._edited(self.vertices, True))
        plot.on_event(Tap, self._tapped)
        # Bokeh does not report a double tap as a Tap.
        plot.on_event(DoubleTap, self._tapped)
        self.plot = plot

    def show(self, state: State, keep_handles: bool = False) -> None:
        """Draw outlines, vertices and the selected position; keep the vertices during a drag."""
        if not keep_handles:
            self._rings = state.rings
            points = [(x, y, k) for k, ring in enumerate(state.rings) for x, y in ring]
            columns = zip(*points, strict=True) if points else ([], [], [])
            self.vertices.data = dict(zip(("x", "y", "ring"), map(list, columns), strict=True))
            # The canvas fills a row by the even-odd rule, so inner rings are holes.
            rings = [np.array(ring) for ring in state.rings]
            self._drawn.data = polygon_columns([rings] if rings else [])
            self._fit(state)
        self._position.data = {"x": [state.x[0]], "y": [state.x[1]]}
        for axis, label in zip(self.plot.axis, ("x", "y"), strict=True):
            axis.axis_label = f"{label} ({state.unit})"

    def show_support(self, polygons: Sequence[Polygon]) -> None:
        """Draw the region outside which W is zero."""
        self._support.data = polygon_columns(polygons)

    def delete_selected(self) -> None:
        """Delete the selected vertices, and outlines with fewer than three vertices."""
        selected = set(self.vertices.selected.indices)
        self.vertices.selected.indices = []
        rows = [row for k, row in enumerate(self._rounded_rows(self.vertices)) if k not in selected]
        self._on_rings(rings_of_rows(rows), True)

    def start_sketch(self) -> None:
        """Start a new outline, to which clicks add corners."""
        self.sketch = []
        self._show_sketch()

    def finish_sketch(self) -> None:
        """Add the new outline to the others if it has three or more corners."""
        ring, self.sketch = tuple(self.sketch or ()), None
        self._show_sketch()
        if len(ring) >= 3:
            self._on_rings((*self._rings, ring), True)

    def _show_sketch(self) -> None:
        """Draw the corners of the new outline."""
        x, y = zip(*self.sketch, strict=True) if self.sketch else ((), ())
        self._sketch.data = {"x": list(x), "y": list(y)}

    def _visible_width(self) -> float:
        """Return the width of the visible region in units of the page."""
        return float(self.plot.x_range.end - self.plot.x_range.start)

    def _rounded_rows(self, source: models.ColumnDataSource) -> list[tuple[int, float, float]]:
        """Return vertices as rows (outline index, x, y); moved vertices are rounded."""
        data, exact = source.data, {p for ring in self._rings for p in ring}
        points = [(float(x), float(y)) for x, y in zip(data["x"], data["y"], strict=True)]
        points = [p if p in exact else rounded(self.plot, *p) for p in points]
        return [(int(k), *p) for k, p in zip(data["ring"], points, strict=True)]

    def _edited(self, source: models.ColumnDataSource, is_final: bool) -> None:
        """Report the edited outlines; ``is_final`` is False during a drag."""
        rings = rings_of_rows(self._rounded_rows(source))
        if not is_final or rings != self._rings:
            self._on_rings(rings, is_final)

    def _tapped(self, event: PointEvent) -> None:
        """Select a position, insert a vertex, or add a corner to a new outline."""
        if event.x is None:
            return
        point = rounded(self.plot, event.x, event.y)
        if self.sketch is None:
            if isinstance(event, DoubleTap):
                self._on_rings(with_vertex(self._rings, point), True)
            elif self._distance_to_nearest([p for ring in self._rings for p in ring], point) > 0.03:
                self._on_position(point)
        elif len(self.sketch) >= 3 and self._distance_to_nearest(self.sketch[:1], point) <= 0.03:
            self.finish_sketch()
        elif self._distance_to_nearest(self.sketch[-1:], point) > 0.01:
            self.sketch.append(point)
            self._show_sketch()

    def _distance_to_nearest(self, points: Sequence[Point], point: Point) -> float:
        """Return the distance to the nearest point as a fraction of the figure width."""
        return min((math.dist(p, point) / self._visible_width() for p in points), default=math.inf)

    def _fit(self, state: State) -> None:
        """Fit the axes to outlines that extend beyond the axes or fill less than 40 % of them."""
        x0, y0, x1, y1 = state.box
        size = max(x1 - x0, y1 - y0)
        if size == 0:
            return
        xr, yr = self.plot.x_range, self.plot.y_range
        inside = xr.start <= x0 and x1 <= xr.end and yr.start <= y0 and y1 <= yr.end
        if inside and size > 0.4 * self._visible_width():
            return
        half = 0.7 * size
        for axis, centre in ((xr, (x0 + x1) / 2), (yr, (y0 + y1) / 2)):
            axis.start, axis.end = centre - half, centre + half
            axis.reset_start, axis.reset_end = axis.start, axis.end


class Plot:
    """Figure of a view; ``on_tap`` is called with a clicked point."""

    def __init__(self, name: Name, on_tap: Callable[[Point], None] | None = None) -> None:
        plot = _new_figure(
            name, title=" ", tools="",
            # The left and right margins have the same sum as the top and bottom margins, so that
            # the axes are square.
            min_border_left=52, min_border_right=50, min_border_top=54, min_border_bottom=48,
        )  # fmt: skip
        plot.add_tools(models.SaveTool(filename=name))
        plot.title.text_font_size = "13px"
        self._quantity = models.Title(text=" ", text_font_size="11px", text_font_style="normal",
                               text_color="#55606b")  # fmt: skip
        plot.add_layout(self._quantity, "above")
        self._source = models.ColumnDataSource({})
        self._mark = models.ColumnDataSource({"x": [], "y": []})
        self._horizon = models.ColumnDataSource({"d": []})
        self.plot, self._on_tap, self._mapper = plot, on_tap, None
        if name == "far":
            self._source.data = {"xs": [], "ys": [], "label": [], "colour": [], "dash": []}
            plot.multi_line(
                "xs", "ys", source=self._source, line_color="colour", line_dash="dash",
                line_width=1.6, legend_field="label",
            )  # fmt: skip
            plot.legend.update(
                label_text_font_size="10px", padding=3, spacing=0, background_fill_alpha=0.8
            )
        elif name == "lags":
            self._source.data = {"xs": [], "ys": []}
            plot.add_glyph(self._source, models.MultiPolygons(fill_color=PALE, line_color=INK))
        else:
            self._source.data = {"image": [], "x": [], "y": [], "dw": [], "dh": []}
            self._mapper = models.LinearColorMapper(palette=_palette("inferno"), low=0, high=1)
            plot.add_glyph(self._source, models.Image(color_mapper=self._mapper))
            bar = models.ColorBar(color_mapper=self._mapper, width=10, padding=4, label_standoff=4)
            plot.add_layout(bar, "right")
            tips = [("x, y", "$x{0.000}, $y{0.000}"), ("value", "@image{0.000}")]
            plot.add_tools(models.HoverTool(tooltips=tips))
        if on_tap:
            horizon = models.Ellipse(
                x=0, y=0, width="d", height="d", fill_color=None, line_color="#808080",
                line_dash="dotted", line_width=1.5,
            )  # fmt: skip
            plot.add_glyph(self._horizon, horizon)
            for colour, width in (("white", 5), ("black", 2)):
                cross = models.Scatter(marker="cross", size=16, line_width=width, line_color=colour)
                plot.add_glyph(self._mark, cross)
            plot.on_event(Tap, self._tapped)

    def show(self, view: View) -> None:
        """Draw the image, the curves or the outlines of a view."""
        plot = self.plot
        plot.title.text, self._quantity.text = view.title, view.quantity or " "
        plot.xaxis.axis_label, plot.yaxis.axis_label = view.x_label, view.y_label
        if self._mapper is not None:
            low, high = view.limits
            self._mapper.update(palette=_palette(view.colours), low=low, high=high)
        self._source.data = dict(view.columns)
        for axis, (start, end) in zip((plot.x_range, plot.y_range), view.edges, strict=True):
            axis.update(start=start, end=end)

    def show_mark(self, point: Point, horizon: float = 0.0) -> None:
        """Draw the selected point, and the circle |nu| = 1/wavelength with radius ``horizon``."""
        self._mark.data = {"x": [point[0]], "y": [point[1]]}
        self._horizon.data = {"d": [2 * horizon]}

    def show_error(self, text: str) -> None:
        """Clear the figure, and show an error as its title."""
        self._source.data = {key: [] for key in self._source.data}
        self.plot.title.text, self._quantity.text = text, " "

    def _tapped(self, event: PointEvent) -> None:
        """Report a clicked point."""
        if self._on_tap and event.x is not None:
            self._on_tap(rounded(self.plot, event.x, event.y))


def rounded(plot: Figure, x: float, y: float) -> Point:
    """Round a point to a thousandth of the figure width, which is less than a pixel."""
    digits = max(0, 3 - math.floor(math.log10(plot.x_range.end - plot.x_range.start)))
    return round(x, digits) + 0.0, round(y, digits) + 0.0


def _new_figure(name: str, **settings: Any) -> Figure:
    """Return an empty square Bokeh figure in the style of the page."""
    plot = Figure(
        name=name, toolbar_location="above", sizing_mode="scale_width", aspect_ratio=1,
        x_range=models.Range1d(-1, 1), y_range=models.Range1d(-1, 1), **settings,
    )  # fmt: skip
    plot.toolbar.logo = None
    for axis in plot.axis:
        axis.update(
            axis_label_text_font_style="normal", minor_tick_line_color=None, axis_label_standoff=2,
            axis_label_text_font_size="12px",
        )  # fmt: skip
        axis.ticker.desired_num_ticks = 5
    return plot


@lru_cache(maxsize=8)
def _palette(name: str) -> list[str]:
    """Return the 256 colours of a matplotlib colour map as texts such as "#000004"."""
    return [mpl.colors.to_hex(colour) for colour in mpl.colormaps[name](np.linspace(0, 1, 256))]
