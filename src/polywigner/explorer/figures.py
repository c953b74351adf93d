"""Figures of the page: the outline that is edited, pictures of values, lags and cuts."""

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
from polywigner.explorer.shown import Shown, power_of_ten, shown, written
from polywigner.explorer.state import State
from polywigner.figures.style import LEVEL_MAP, SIGNED_MAP

NEAR = ("rays", "exact", "difference")
"""The pictures of the near field."""
_SIDE = 256
"""Side of the square that is drawn into, in pixels, until the page has measured its window."""
_MAPS = {"level": LEVEL_MAP, "unit": LEVEL_MAP, "phase": "twilight", "difference": SIGNED_MAP}
_SIDES = {"level": "dB", "phase": "°", "difference": "dB"}
_NO_COLOUR = "#dddddd"  # of what is not a number
_INK, _TINT, _ACCENT, _GREY = "#2f6da8", "#8fb8dd", "#d4561f", "#8a939c"  # on white and on black
_HANDLES = ((60, 10), (150, 7), (math.inf, 4))  # vertices, and the pixels of each
_MOST_HANDLES = 200  # a page with more to paint and to look through answers a hand late
_OUTLINE_TITLE = "Aperture (full), support of W (pale)"
_SPAN = 40.0  # dB, of the polar plot
_TURN = np.linspace(0, 2 * np.pi, 181)


@cache
def palette(scale: str) -> list[str]:
    """257 colours; of signed values by their square roots, so that faint lobes are seen."""
    import matplotlib as mpl
    from matplotlib.colors import to_hex

    t = np.linspace(-1, 1, 257)  # odd: zero is white
    if scale == "signed":
        t = np.sign(t) * np.sqrt(np.abs(t))
    colours = mpl.colormaps[_MAPS.get(scale, SIGNED_MAP)]((t + 1) / 2)
    return [to_hex(colour) for colour in colours]


@cache
def _table(scale: str) -> NDArray[np.uint32]:
    """The palette as red, green, blue and opaque bytes, and at its end the colour of NaN."""
    colours = [*palette(scale), _NO_COLOUR]
    rows = [[*bytes.fromhex(colour[1:]), 255] for colour in colours]
    return np.array(rows, np.uint8).view(np.uint32)[:, 0]


def coloured(what: Shown) -> NDArray[np.uint32]:
    """The pixels of values, as Bokeh's mapper would colour them: in the browser that takes 5 ms."""
    table = _table(what.scale)
    last = len(table) - 2
    with np.errstate(invalid="ignore"):
        place = (what.values - what.low) * ((last + 1) / (what.high - what.low))
        number = np.clip(place, 0, last)
    number[np.isnan(number)] = last + 1
    return table[number.astype(np.intp)]


def _replace(source: ColumnDataSource, **data: Any) -> None:
    """New data of a source; the same once more is not sent."""
    if source.data != data:
        source.data = data


def _clear(*sources: ColumnDataSource) -> None:
    for source in sources:
        source.data = {name: [] for name in source.data}


def _columns(*names: str, **how: Any) -> ColumnDataSource:
    return ColumnDataSource({name: [] for name in names}, **how)


def _polygons(polygons: list[list[Any]], scale: float) -> dict[str, list[Any]]:
    """Columns of Bokeh's multi_polygons."""
    return {
        axis + "s": [[[(scale * ring[:, k]).tolist() for ring in rings]] for rings in polygons]
        for k, axis in enumerate("xy")
    }


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
    made.grid.visible = False
    return made


def _name_axes(made: Any, symbol: str, unit: str) -> None:
    for axis, component in ((made.xaxis, "x"), (made.yaxis, "y")):
        name = component if symbol == "x" else f"{symbol}_{component}"
        axis.axis_label = f"{name} ({unit})"


def _window(made: Any, x: float, y: float, half: float) -> None:
    made.x_range.update(start=x - half, end=x + half)
    made.y_range.update(start=y - half, end=y + half)


def _title(what: Shown, side: str, exponent: int) -> str:
    """The title of a picture: the quantity shown, and the unit of the colour bar."""
    if what.scale in ("signed", "phase"):
        return f"{what.title} ({written(exponent) + ' ' if exponent else ''}{side})"
    if what.scale == "unit":
        return what.title
    return f"{what.title}: {what.bar.replace('dB relative to', 'dB re')}"


class ImageFigure:
    """One array of a picture, a cross at the chosen point, a circle at |nu| = 1/wavelength."""

    def __init__(self, name: str, title: str, symbol: str) -> None:
        self.symbol = symbol
        self.figure = made = _plain_figure(title, name)
        self.source = _columns("image", "value", "x", "y", "dw", "dh")
        self.cross, self.circle = _columns("x", "y"), _columns("x", "y")
        self.mapper = LinearColorMapper(palette=palette("level"))  # of the colour bar alone
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
        self._seen: tuple[Any, ...] = ()
        self._scale = "level"

    def update(self, picture: views.Picture, what: Shown, state: State, cross: Any) -> None:
        """Show new values, and the cross at a point (x, y) in the axes' unit, None for none."""
        per = state.per_metre
        scale = 1 / per if picture.axis_unit == "1/m" else per
        # pixels lie on samples
        half = scale * picture.half * picture.samples / (picture.samples - 1)
        x, y = (scale * centre for centre in picture.centre)
        signed = what.scale == "signed"
        # squares of the page's unit: numbers without long exponents
        peak = what.peak * per**2 if signed else 1.0
        # the bar's own formatter would write exponents where there is no room for them
        exponent = power_of_ten(peak) if signed else 0
        top = peak / 10.0**exponent
        self.mapper.update(low=what.low * top, high=what.high * top)
        if what.scale != self._scale:  # so many colours take 5 ms to check
            self._scale = what.scale
            self.mapper.palette = palette(what.scale)
        side = f"{state.unit}²" if signed else _SIDES.get(what.scale, "")
        self.figure.title.text = _title(what, side, exponent)
        unit = f"1/{state.unit}" if picture.axis_unit == "1/m" else state.unit
        _name_axes(self.figure, self.symbol, unit)
        self.hover.tooltips = [
            ("at", f"$x{{%.5g}}, $y{{%.5g}} {unit}"), ("value", f"@value{{%.5g}} {side}")
        ]  # fmt: skip
        if self._seen != (x, y, half, unit):  # otherwise a visitor's zoom stays
            self._seen = (x, y, half, unit)
            self.reset()
        self.source.data = {
            "image": [coloured(what)], "value": [np.asarray(what.values * peak, dtype=np.float32)],
            "x": [x - half], "y": [y - half], "dw": [2 * half], "dh": [2 * half],
        }  # fmt: skip
        self.mark(cross)
        if picture.axis_unit == "1/m":
            radius = scale / state.wavelength
            _replace(self.circle, x=(radius * np.cos(_TURN)).tolist(),
                     y=(radius * np.sin(_TURN)).tolist())  # fmt: skip

    def clear(self) -> None:
        """Clear the picture, which belongs to another source."""
        _clear(self.source)

    def mark(self, cross: Any) -> None:
        """Move the cross."""
        _replace(self.cross, x=[] if cross is None else [cross[0]],
                 y=[] if cross is None else [cross[1]])  # fmt: skip

    def reset(self) -> None:
        """The whole picture, after a visitor has zoomed or moved it."""
        if self._seen:
            _window(self.figure, *self._seen[:3])


class ApertureFigure:
    """The outline with its vertices to drag, the support of W, and the chosen position."""

    def __init__(self) -> None:
        self.figure = made = _plain_figure(_OUTLINE_TITLE, "aperture")
        self.support, self.filled = _columns("xs", "ys"), _columns("xs", "ys")
        self.outline = _columns("xs", "ys", "number", name="outline")
        self.vertices = _columns("x", "y", "ring", "handle", name="vertices")
        self.pending, self.cross = _columns("x", "y"), _columns("x", "y")
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
        self._seen: tuple[Any, ...] = ()

    def show(self, found: views.Outlines, state: State) -> None:
        """Show the computed shapes: the filled source and the support."""
        self.support.data = _polygons(found.support, state.per_metre)
        self.filled.data = _polygons(found.source, state.per_metre)

    def show_edges(self, state: State) -> None:
        """Outline and handles of the state, also of one that is no polygon."""
        xs, ys = ([[point[k] for point in ring] for ring in state.rings] for k in (0, 1))
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
        self.figure.title.text = _OUTLINE_TITLE if step == 1 else few
        self.handles.glyph.size = next(size for most, size in _HANDLES if count <= most)
        self._frame(state)

    def _frame(self, state: State) -> None:
        """Set the window around all outlines and the source."""
        points = np.array([p for ring in state.rings for p in ring] or [(-5.0, -5.0), (5.0, 5.0)])
        if state.array:
            try:
                x, y, half = (v * state.per_metre for v in views.position_window(state))
                points = np.array([(x - half, y - half), (x + half, y + half)])
            except PolywignerError:
                pass  # the source's error is told where it is computed
        low, high = points.min(axis=0), points.max(axis=0)
        middle, half = (low + high) / 2, 0.7 * max(*(high - low), 1e-9)
        seen = (float(middle[0]), float(middle[1]), float(half), state.unit)
        if seen != self._seen:
            self._seen = seen
            self.reset()
            _name_axes(self.figure, "x", state.unit)

    def reset(self) -> None:
        """All that is drawn, after a visitor has zoomed or moved the figure."""
        _window(self.figure, *self._seen[:3])

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
        _clear(self.support, self.filled)


class LagFigure:
    """The lag slice at the position under the pointer, or at the chosen one."""

    def __init__(self) -> None:
        self.figure = _plain_figure("Lag slice 2(Γ − x) ∩ 2(x − Γ)", "lags")
        self.source = _columns("xs", "ys")
        self.figure.multi_polygons(
            xs="xs", ys="ys", source=self.source, color=_ACCENT, fill_alpha=0.35
        )

    def show(self, lags: list[Any], state: State, at: tuple[float, float]) -> None:
        """Polygons of lags in m, at a position in units."""
        self.source.data = _polygons(lags, state.per_metre)
        _window(self.figure, 0.0, 0.0, views.lag_half(state) * state.per_metre)
        self.figure.title.text = f"Lag slice at x = ({at[0]:.4g}, {at[1]:.4g}) {state.unit}"
        _name_axes(self.figure, "ξ", state.unit)

    def clear(self) -> None:
        """No lags."""
        _clear(self.source)


class PolarFigure:
    """Directivity in two planes over the angle from the normal, radially in dB."""

    def __init__(self) -> None:
        self.figure = made = _plain_figure("Far field", "far")
        made.axis.visible = False
        self.rings, self.labels = _columns("xs", "ys"), _columns("x", "y", "text")
        self.cuts = [_columns("x", "y") for _ in range(2)]
        made.multi_line("xs", "ys", source=self.rings, color=_GREY, alpha=0.5)
        made.text("x", "y", "text", source=self.labels, text_font_size="8pt", text_align="center",
                  text_color="#55616c")  # fmt: skip
        for source, name, dash, colour in zip(
            self.cuts, ("φ = 0°", "φ = 90°"), ("solid", "dashed"), (_INK, _ACCENT), strict=True
        ):
            made.line("x", "y", source=source, legend_label=name, line_dash=dash, color=colour,
                      line_width=1.5)  # fmt: skip
        self._phi = (0.0, np.pi / 2)
        made.legend.location = "bottom_center"
        made.legend.orientation = "horizontal"
        made.legend.border_line_color = made.legend.background_fill_color = None
        self.reset()

    def reset(self) -> None:
        """The whole half circle."""
        _window(self.figure, 0.0, 0.25, 1.25)

    def clear(self) -> None:
        """Clear the cuts, which belong to another source."""
        _clear(*self.cuts)

    def show(self, cuts: views.Cuts) -> None:
        """New cuts; the outermost ring is the next multiple of 5 dB."""
        top = 5 * np.ceil(cuts.largest / 5)
        # a narrow beam is spread over the half circle, and the labels say so
        stretch = (np.pi / 2) / cuts.theta[-1]
        turn, angles = np.linspace(-np.pi / 2, np.pi / 2, 91), np.radians(range(-90, 91, 30))
        radii = (0.25, 0.5, 0.75, 1.0)
        self.rings.data = {
            "xs": [r * np.sin(turn) for r in radii] + [np.array([0, np.sin(a)]) for a in angles],
            "ys": [r * np.cos(turn) for r in radii] + [np.array([0, np.cos(a)]) for a in angles],
        }
        text = [f"{degrees:.3g}°" for degrees in np.degrees(angles / stretch)]
        levels = [f"{top - _SPAN * (1 - r):g}" for r in (0.0, *radii)]
        self.labels.data = {
            # those of the horizon below its ends: beside them they are cut off
            "x": [-1.0, *(1.12 * np.sin(angles[1:-1])), 1.0, 0.0, *radii],
            "y": [-0.26, *(1.1 * np.cos(angles[1:-1])), -0.26, *[-0.13] * 5],
            "text": text + levels,
        }
        if cuts.phi != self._phi:
            self._phi = cuts.phi
            for item, phi in zip(self.figure.legend.items, cuts.phi, strict=True):
                item.label = value(f"φ = {np.degrees(phi):.4g}°")
        for source, directivity in zip(self.cuts, cuts.directivity.T, strict=True):
            radius = np.clip(1 + (directivity - top) / _SPAN, 0, 1)
            angle = stretch * cuts.theta
            source.data = {"x": radius * np.sin(angle), "y": radius * np.cos(angle)}
        self.figure.title.text = f"Directivity in dBi, at most {cuts.largest:.2f}"


class Figures:
    """All figures of one visitor, by their names in the page."""

    def __init__(self) -> None:
        self.aperture, self.lags, self.polar = ApertureFigure(), LagFigure(), PolarFigure()
        self.images = {
            "fourier": ImageFigure("fourier", "F(ν)", "ν"),
            "wigner_nu": ImageFigure("wigner_nu", "W over ν", "ν"),
            "wigner_x": ImageFigure("wigner_x", "W over x", "x"),
            "otf": ImageFigure("otf", "OTF", "ξ"),
            **{f"{key}_near": ImageFigure(f"{key}_near", key, "x") for key in NEAR},
        }
        shown = ("fourier", "wigner_nu", "wigner_x", "otf")
        drawn: dict[str, Any] = {
            "aperture": self.aperture, **{name: self.images[name] for name in shown},
            "far": self.polar, "lags": self.lags, **self.images,
        }  # fmt: skip
        self.by_name = drawn
        self.all = {name: made.figure for name, made in drawn.items()}

    def of(self, view: str) -> list[Any]:
        """The figures of a view."""
        names = [f"{key}_near" for key in NEAR] if view == "near" else [view]
        return [self.by_name[name] for name in names if name in self.by_name]

    def reset(self) -> None:
        """All figures as they are before anybody zooms."""
        for made in self.by_name.values():
            if made is not self.lags:
                made.reset()

    def mark(self, state: State) -> None:
        """The crosses at the chosen point."""
        self.aperture.cross.data = {"x": [state.x[0]], "y": [state.x[1]]}
        self.images["wigner_x"].mark(state.x)
        for name in ("fourier", "wigner_nu"):
            self.images[name].mark(state.nu)

    def show(self, state: State, name: str, found: Any) -> None:
        """Show the value of a view."""
        if name == "source":
            self.aperture.show(found, state)
            self.lags.show(found.lags, state, state.x)
        elif name == "far":
            self.polar.show(found)
        elif name == "near":
            for key in NEAR:
                what = shown(found, key, unit=state.unit)
                self.images[f"{key}_near"].update(found, what, state, None)
        else:
            what = shown(found, next(iter(found.arrays)), state.part, state.unit)
            cross = {"fourier": state.nu, "wigner_nu": state.nu, "wigner_x": state.x}.get(name)
            self.images[name].update(found, what, state, cross)
