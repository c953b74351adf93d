"""The figures of one visitor: the outline that is edited, pictures of values, lags, polar cuts."""

from __future__ import annotations

import math
from functools import cache
from itertools import chain
from typing import Any

import numpy as np
from bokeh.core.properties import value
from bokeh.models import (
    CDSView,
    ColorBar,
    ColumnDataSource,
    GroupFilter,
    HoverTool,
    LinearColorMapper,
    PointDrawTool,
    Range1d,
    Scatter,
)
from bokeh.plotting import figure
from numpy.typing import NDArray

from polywigner.errors import PolywignerError
from polywigner.explorer import views
from polywigner.explorer.state import State
from polywigner.explorer.views import Cuts, Outlines, Picture, Shown, power_of_ten, written

_SIDE = 256
"""Side of the square that is drawn into, in pixels, until the page has measured its window."""
_SIDES = {"level": "dB", "phase": "°", "difference": "dB"}
_NO_COLOUR = "#dddddd"  # of what is not a number
_INK, _TINT, _ACCENT, _GREY = "#2f6da8", "#8fb8dd", "#d4561f", "#8a939c"  # on white and on black
_HANDLES = ((60, 10), (150, 7), (math.inf, 4))  # vertices, and the pixels of each
_MOST_HANDLES = 200  # a page with more to paint and to look through answers a hand late
_TITLE = "Aperture (full), support of W (pale)"
_SPAN = 40.0  # dB, of the polar plot
_LINEAR = 100.0  # dB, of the axial ratio: the rest is rounding
_NEAR = ("rays", "exact", "difference")


def _source(*columns: str) -> ColumnDataSource:
    return ColumnDataSource({name: [] for name in columns})


def emptied(source: ColumnDataSource) -> None:
    """Take all rows out."""
    source.data = {name: [] for name in source.data}


def _replaced(source: ColumnDataSource, data: dict[str, Any]) -> None:
    """New data of a source; the same once more is not sent."""
    if source.data != data:
        source.data = data


def _plain_figure(title: str, name: str) -> Any:
    """A square figure without logo, with pan and zoom."""
    made = figure(
        title=title, name=name, frame_width=_SIDE, frame_height=_SIDE, match_aspect=True,
        tools="pan,wheel_zoom", active_scroll="wheel_zoom", toolbar_location=None,
        x_range=Range1d(-1, 1), y_range=Range1d(-1, 1), min_border_left=50, min_border_right=14,
        background_fill_color=None, border_fill_color=None, outline_line_color=_GREY,
        outline_line_alpha=0.4,
    )  # fmt: skip
    made.toolbar.logo = None
    made.title.text_font_size = "9.5pt"
    made.axis.axis_label_text_font_size = made.axis.major_label_text_font_size = "8.5pt"
    made.axis.axis_label_text_font_style = "normal"
    made.axis.axis_label_standoff = 2
    made.axis.minor_tick_line_color = None
    made.xgrid.visible = made.ygrid.visible = False
    return made


def _frame(made: Any, left: float, bottom: float, width: float, symbol: str, unit: str) -> None:
    """A window and labels of axes, where they have changed: a visitor's zoom stays."""
    window = [float(left), float(bottom), float(width), unit]
    if made.tags == window:
        return
    made.tags = window
    for axis, part in ((made.xaxis, "x"), (made.yaxis, "y")):
        axis.axis_label = f"{part if symbol == 'x' else f'{symbol}_{part}'} ({unit})"
    _reset(made)


def _reset(made: Any) -> None:
    """The whole window, after a visitor has zoomed or moved the figure."""
    if made.tags:
        left, bottom, width, _ = made.tags
        made.x_range.update(start=left, end=left + width)
        made.y_range.update(start=bottom, end=bottom + width)


@cache
def _palette(scale: views.Scale) -> list[str]:
    """257 colours; of signed values by their square roots, so that faint lobes are seen."""
    import matplotlib as mpl
    from matplotlib.colors import to_hex

    t = np.linspace(-1, 1, 257)  # odd: zero is white
    if scale == "signed":
        t = np.sign(t) * np.sqrt(np.abs(t))
    return [to_hex(colour) for colour in mpl.colormaps[views.COLOUR_MAPS[scale]]((t + 1) / 2)]


@cache
def _table(scale: views.Scale) -> NDArray[np.uint32]:
    """The palette as red, green, blue and opaque bytes, and at its end the colour of NaN."""
    rows = [[*bytes.fromhex(colour[1:]), 255] for colour in (*_palette(scale), _NO_COLOUR)]
    return np.array(rows, np.uint8).view(np.uint32)[:, 0]


def _coloured(what: Shown) -> NDArray[np.uint32]:
    """The pixels of values, as Bokeh's mapper would colour them: in the browser that takes 5 ms."""
    table = _table(what.scale)
    last = len(table) - 2
    with np.errstate(invalid="ignore"):
        place = (what.values - what.low) * ((last + 1) / (what.high - what.low))
        number = np.clip(place, 0, last)
    number[np.isnan(number)] = last + 1
    return table[number.astype(np.intp)]


class ImageFigure:
    """One array of a picture, a cross at the chosen point, a circle at |nu| = 1/wavelength."""

    def __init__(self, name: str, title: str, symbol: str) -> None:
        self.symbol = symbol
        self.figure = made = _plain_figure(title, name)
        self.source = _source("image", "value", "x", "y", "dw", "dh")
        self.cross, self.circle = _source("x", "y"), _source("x", "y")
        self.mapper = LinearColorMapper(palette=_palette("level"))  # of the colour bar alone
        drawn = made.image_rgba(image="image", x="x", y="y", dw="dw", dh="dh", source=self.source)
        made.line("x", "y", source=self.circle, color="#808080", line_dash="dotted", line_width=1.5)
        for width, colour in ((6, "white"), (2.5, "black")):  # seen on every colour
            made.scatter("x", "y", source=self.cross, marker="cross", size=14, line_width=width,
                         color=colour)  # fmt: skip
        bar = ColorBar(
            color_mapper=self.mapper, height=8, padding=2, label_standoff=3,
            major_label_text_font_size="8.5pt", background_fill_color=None,
        )  # fmt: skip
        made.add_layout(bar, "below")
        self.hover = HoverTool(
            renderers=[drawn], formatters=dict.fromkeys(("$x", "$y", "@value"), "printf")
        )
        made.add_tools(self.hover)
        self._scale: views.Scale = "level"

    def update(self, picture: Picture, what: Shown, state: State, cross: Any) -> None:
        """Show new values, and the cross at a point (x, y) in the axes' unit, None for none."""
        factor, unit = picture.axis_in(state.unit)
        half = picture.half * picture.samples / (picture.samples - 1)  # pixels lie on samples
        left, bottom = (factor * (centre - half) for centre in picture.centre)
        width = 2 * half * factor
        _frame(self.figure, left, bottom, width, self.symbol, unit)
        signed = what.scale == "signed"
        # squares of the page's unit: numbers without long exponents
        peak = what.peak * state.per_metre**2 if signed else 1.0
        # the bar's own formatter would write exponents where there is no room for them
        exponent = power_of_ten(peak) if signed else 0
        top = peak / 10.0**exponent
        self.mapper.update(low=what.low * top, high=what.high * top)
        if what.scale != self._scale:  # so many colours take 5 ms to check
            self._scale = what.scale
            self.mapper.palette = _palette(what.scale)
        side = f"{state.unit}²" if signed else _SIDES.get(what.scale, "")
        if signed or what.scale == "phase":
            title = f"{what.title} ({written(exponent) + ' ' if exponent else ''}{side})"
        elif what.scale == "unit":
            title = what.title
        else:
            title = f"{what.title}: {what.bar.replace('dB relative to', 'dB re')}"
        self.figure.title.text = title
        self.hover.tooltips = [
            ("at", f"$x{{%.5g}}, $y{{%.5g}} {unit}"),
            ("value", f"@value{{%.5g}} {side}"),
        ]
        self.source.data = {
            "image": [_coloured(what)], "value": [np.asarray(what.values * peak, np.float32)],
            "x": [left], "y": [bottom], "dw": [width], "dh": [width],
        }  # fmt: skip
        self.mark(cross)
        if picture.axis_unit == "1/m":
            turn, radius = np.linspace(0, 2 * np.pi, 181), factor / state.wavelength
            around = {"x": radius * np.cos(turn), "y": radius * np.sin(turn)}
            _replaced(self.circle, {name: v.tolist() for name, v in around.items()})

    def clear(self) -> None:
        """Clear the picture, which belongs to another source."""
        emptied(self.source)

    def mark(self, cross: Any) -> None:
        """Move the cross."""
        x, y = ([], []) if cross is None else ([cross[0]], [cross[1]])
        _replaced(self.cross, {"x": x, "y": y})


def _multi(polygons: list[list[Any]], scale: float) -> dict[str, list[Any]]:
    """Columns of Bokeh's multi_polygons."""
    return {
        "xs": [[[(scale * ring[:, 0]).tolist() for ring in rings]] for rings in polygons],
        "ys": [[[(scale * ring[:, 1]).tolist() for ring in rings]] for rings in polygons],
    }


class ApertureFigure:
    """The outline with its vertices to drag, the support of W, and the chosen position."""

    def __init__(self) -> None:
        self.figure = made = _plain_figure(_TITLE, "aperture")
        self.support, self.filled = _source("xs", "ys"), _source("xs", "ys")
        self.outline = _source("xs", "ys", "number")
        self.vertices = _source("x", "y", "ring", "handle")
        self.outline.name, self.vertices.name = "outline", "vertices"
        self.pending, self.cross = _source("x", "y"), _source("x", "y")
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
        tool = PointDrawTool(renderers=[handles], add=False, description="Move vertices")
        made.add_tools(tool)
        made.toolbar.active_drag = tool

    def show_outlines(self, found: Outlines, state: State) -> None:
        """Shows the computed shapes: the filled source and the support."""
        self.support.data = _multi(found.support, state.per_metre)
        self.filled.data = _multi(found.source, state.per_metre)

    def show_edges(self, state: State) -> None:
        """Outline and handles of the state, also of one that is no polygon, and their window."""
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
        self.handles.glyph.size = next(s for most, s in _HANDLES if count <= most)
        points = np.array([p for ring in state.rings for p in ring] or [(-5.0, -5.0), (5.0, 5.0)])
        if state.array:
            try:
                x, y, half = (v * state.per_metre for v in views.position_window(state))
                points = np.array([(x - half, y - half), (x + half, y + half)])
            except PolywignerError:
                pass  # the source's error is told where it is computed
        low, high = points.min(axis=0), points.max(axis=0)
        half = 0.7 * max(*(high - low), 1e-9)
        left, bottom = (low + high) / 2 - half
        _frame(self.figure, left, bottom, 2 * half, "x", state.unit)

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
        emptied(self.support)
        emptied(self.filled)


class LagFigure:
    """The lag slice at the position under the pointer, or at the chosen one."""

    def __init__(self) -> None:
        self.figure = _plain_figure("Lag slice 2(Γ − x) ∩ 2(x − Γ)", "lags")
        self.source = _source("xs", "ys")
        self.figure.multi_polygons(
            xs="xs", ys="ys", source=self.source, color=_ACCENT, fill_alpha=0.35
        )

    def show(self, lags: list[Any], state: State) -> None:
        """Polygons of lags in m at the state's position."""
        self.source.data = _multi(lags, state.per_metre)
        half, (x, y) = views.lag_half(state) * state.per_metre, state.x
        _frame(self.figure, -half, -half, 2 * half, "ξ", state.unit)
        self.figure.title.text = f"Lag slice at x = ({x:.4g}, {y:.4g}) {state.unit}"

    def clear(self) -> None:
        """No lags."""
        emptied(self.source)


class PolarFigure:
    """Directivity in two planes over the angle from the normal, radially in dB."""

    def __init__(self) -> None:
        self.figure = made = _plain_figure("Far field", "far")
        made.axis.visible = False
        self.labels = _source("x", "y", "text")
        self.cuts = [_source("x", "y") for _ in range(4)]
        # half circles, and rays every 30 degrees
        turn, self.angles = np.linspace(-np.pi / 2, np.pi / 2, 91), np.radians(range(-90, 91, 30))
        self.rings = ColumnDataSource(
            {
                name: [
                    *(r * part(turn) for r in (0.25, 0.5, 0.75, 1.0)),
                    *(np.array([0, part(angle)]) for angle in self.angles),
                ]
                for name, part in (("xs", np.sin), ("ys", np.cos))
            }
        )
        made.multi_line("xs", "ys", source=self.rings, color=_GREY, alpha=0.5)
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
        _frame(made, -1.25, -1.0, 2.5, "", "")

    def clear(self) -> None:
        """Clear the cuts, which belong to another source."""
        for source in self.cuts:
            emptied(source)

    def show(self, cuts: Cuts) -> None:
        """New cuts; the outermost ring is the next multiple of 5 dB."""
        top = 5 * np.ceil(cuts.largest / 5)
        # a narrow beam is spread over the half circle, and the labels say so
        stretch = (np.pi / 2) / cuts.theta[-1]
        text = [f"{d:.3g}°" for d in np.degrees(self.angles / stretch)]
        text += [f"{top - _SPAN * (1 - r):g}" for r in (0.25, 0.5, 0.75)]
        inner = self.angles[1:-1]
        self.labels.data = {
            # those of the horizon below its ends: beside them they are cut off
            "x": [-1.0, *(1.12 * np.sin(inner)), 1.0, 0.25, 0.5, 0.75],
            "y": [-0.26, *(1.1 * np.cos(inner)), -0.26, -0.13, -0.13, -0.13],
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


class Figures:
    """All figures of one visitor."""

    def __init__(self) -> None:
        self.aperture, self.lags, self.polar = ApertureFigure(), LagFigure(), PolarFigure()
        self.images = {
            "fourier": ImageFigure("fourier", "F(ν)", "ν"),
            "wigner_nu": ImageFigure("wigner_nu", "W over ν", "ν"),
            "wigner_x": ImageFigure("wigner_x", "W over x", "x"),
            "otf": ImageFigure("otf", "OTF", "ξ"),
            **{f"{key}_near": ImageFigure(f"{key}_near", key, "x") for key in _NEAR},
        }
        near = {name: image for name, image in self.images.items() if name.endswith("_near")}
        others = {name: image for name, image in self.images.items() if name not in near}
        self._by_name: dict[str, Any] = {
            "aperture": self.aperture, **others, "far": self.polar, "lags": self.lags, **near,
        }  # fmt: skip
        self.all = [drawn.figure for drawn in self._by_name.values()]

    def by_name(self, name: str) -> Any:
        """A Bokeh figure by its own name."""
        return self._by_name[name].figure

    def clear(self, view: str) -> None:
        """Empty the figures of a view that cannot be computed for this source."""
        for name in figures_of(view):
            self._by_name[name].clear()

    def reset(self) -> None:
        """All figures as they are before anybody zooms."""
        for made in self.all:
            _reset(made)

    def set_visible(self, names: tuple[str, ...]) -> None:
        """Show these views and hide the others."""
        for view in (*views.PICTURES, "far"):
            for name in figures_of(view):
                self.by_name(name).visible = view in names

    def mark(self, state: State) -> None:
        """The crosses at the chosen point."""
        _replaced(self.aperture.cross, {"x": [state.x[0]], "y": [state.x[1]]})
        self.images["wigner_x"].mark(state.x)
        for name in ("fourier", "wigner_nu"):
            self.images[name].mark(state.nu)

    def show(self, state: State, name: str, found: Any) -> None:
        """Show the computed value of a view, or of "source"."""
        if name == "source":
            self.aperture.show_outlines(found, state)
            self.lags.show(found.lags, state)
        elif name == "far":
            self.polar.show(found)
        else:
            cross = {"fourier": state.nu, "wigner_nu": state.nu, "wigner_x": state.x}.get(name)
            for drawn, key in zip(figures_of(name), found.arrays, strict=True):
                what = views.shown(found, key, state.part, state.unit)
                self.images[drawn].update(found, what, state, cross)


def figures_of(view: str) -> list[str]:
    """Names of the figures of a view."""
    return [f"{key}_near" for key in _NEAR] if view == "near" else [view]
