"""Figures of values: images with axes in units, colour bars and values under the pointer."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
from bokeh.models import ColorBar, ColumnDataSource, HoverTool, LinearColorMapper, Range1d
from bokeh.plotting import figure
from numpy.typing import NDArray

from polywigner.explorer.shown import Shown, power_of_ten, written
from polywigner.explorer.state import State
from polywigner.explorer.views import Picture
from polywigner.figures.style import LEVEL_MAP, PHASE_MAP, SIGNED_MAP

_SIDE = 256
"""Side of the square that is drawn into, in pixels, until the page has measured its window."""
_MAPS = {"level": LEVEL_MAP, "unit": LEVEL_MAP, "phase": PHASE_MAP, "difference": SIGNED_MAP}
_SIDES = {"level": "dB", "phase": "°", "difference": "dB"}
_NO_COLOUR = "#dddddd"  # of what is not a number


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


def replaced(source: ColumnDataSource, data: dict[str, Any]) -> None:
    """New data of a source; the same once more is not sent."""
    if source.data != data:
        source.data = data


def plain_figure(title: str, name: str, **how: Any) -> Any:
    """A square figure without logo, with pan and zoom."""
    made = figure(
        title=title, name=name, frame_width=_SIDE, frame_height=_SIDE, match_aspect=True,
        tools="pan,wheel_zoom", active_scroll="wheel_zoom", toolbar_location=None,
        x_range=Range1d(-1, 1), y_range=Range1d(-1, 1), min_border_left=50, min_border_right=14,
        background_fill_color=None, border_fill_color=None, outline_line_color="#8a939c",
        outline_line_alpha=0.4, **how,
    )  # fmt: skip
    made.toolbar.logo = None
    made.title.text_font_size = "9.5pt"
    made.axis.axis_label_text_font_size = made.axis.major_label_text_font_size = "8.5pt"
    made.axis.axis_label_text_font_style = "normal"
    made.axis.axis_label_standoff = 2
    made.axis.minor_tick_line_color = None
    made.xgrid.visible = made.ygrid.visible = False
    return made


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
        self.figure = plain_figure(title, name)
        columns = ("image", "value", "x", "y", "dw", "dh")
        self.source = ColumnDataSource({name: [] for name in columns})
        self.cross = ColumnDataSource({"x": [], "y": []})
        self.circle = ColumnDataSource({"x": [], "y": []})
        self.mapper = LinearColorMapper(palette=palette("level"))  # of the colour bar alone
        drawn = self.figure.image_rgba(
            image="image", x="x", y="y", dw="dw", dh="dh", source=self.source
        )
        self.figure.line(
            "x", "y", source=self.circle, color="#808080", line_dash="dotted", line_width=1.5
        )
        for width, colour in ((6, "white"), (2.5, "black")):  # seen on every colour
            self.figure.scatter(
                "x", "y", source=self.cross, marker="cross", size=14, line_width=width,
                color=colour,
            )  # fmt: skip
        self.bar = ColorBar(
            color_mapper=self.mapper, height=8, padding=2, label_standoff=3,
            major_label_text_font_size="8.5pt", background_fill_color=None,
        )  # fmt: skip
        self.figure.add_layout(self.bar, "below")
        self.hover = HoverTool(
            renderers=[drawn], formatters=dict.fromkeys(("$x", "$y", "@value"), "printf")
        )
        self.figure.add_tools(self.hover)
        self._window: tuple[Any, ...] = ()
        self._scale = "level"

    def update(self, picture: Picture, what: Shown, state: State, cross: Any) -> None:
        """Show new values, and the cross at a point (x, y) in the axes' unit, None for none."""
        per = state.per_metre
        scale = 1 / per if picture.axis_unit == "1/m" else per
        half = picture.half * picture.samples / (picture.samples - 1)  # pixels lie on samples
        left, bottom = (scale * (centre - half) for centre in picture.centre)
        width = 2 * half * scale
        signed = what.scale == "signed"
        # squares of the page's unit: numbers without long exponents
        peak = what.peak * per**2 if signed else 1.0
        values = np.asarray(what.values * peak, dtype=np.float32)
        self._frame((left, bottom, width, state.unit))
        # the bar's own formatter would write exponents where there is no room for them
        exponent = power_of_ten(peak) if signed else 0
        top = peak / 10.0**exponent
        self.mapper.update(low=what.low * top, high=what.high * top)
        if what.scale != self._scale:  # so many colours take 5 ms to check
            self._scale = what.scale
            self.mapper.palette = palette(what.scale)
        side = f"{state.unit}²" if signed else _SIDES.get(what.scale, "")
        self.figure.title.text = _title(what, side, exponent)
        self.hover.tooltips = self._tooltips(picture, state.unit, side)
        self.source.data = {
            "image": [coloured(what)], "value": [values],
            "x": [left], "y": [bottom], "dw": [width], "dh": [width],
        }  # fmt: skip
        self.mark(cross)
        if picture.axis_unit == "1/m":
            turn, radius = np.linspace(0, 2 * np.pi, 181), scale / state.wavelength
            around = {"x": radius * np.cos(turn), "y": radius * np.sin(turn)}
            replaced(self.circle, {name: v.tolist() for name, v in around.items()})

    def clear(self) -> None:
        """Clear the picture, which belongs to another source."""
        self.source.data = {name: [] for name in self.source.data}

    def mark(self, cross: Any) -> None:
        """Move the cross."""
        x, y = ([], []) if cross is None else ([cross[0]], [cross[1]])
        replaced(self.cross, {"x": x, "y": y})

    def _tooltips(self, picture: Picture, unit: str, side: str) -> list[tuple[str, str]]:
        unit = f"1/{unit}" if picture.axis_unit == "1/m" else unit
        for axis, mark, plain in (
            (self.figure.xaxis, "_x", "x"),
            (self.figure.yaxis, "_y", "y"),
        ):
            axis.axis_label = f"{plain if self.symbol == 'x' else self.symbol + mark} ({unit})"
        return [
            ("at", f"$x{{%.5g}}, $y{{%.5g}} {unit}"),
            ("value", f"@value{{%.5g}} {side}"),
        ]

    def _frame(self, window: tuple[Any, ...]) -> None:
        """Ranges only where the window has changed: a visitor's zoom stays."""
        if window == self._window:
            return
        self._window = window
        self.reset()

    def reset(self) -> None:
        """The whole picture, after a visitor has zoomed or moved it."""
        if not self._window:
            return
        left, bottom, width, _ = self._window
        self.figure.x_range.update(start=left, end=left + width)
        self.figure.y_range.update(start=bottom, end=bottom + width)
