"""Fields along a line or an arc, by several methods, with their differences in dB."""

from __future__ import annotations

from itertools import cycle
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from polywigner.errors import ArgumentError
from polywigner.figures import style
from polywigner.figures.fields import Comparison
from polywigner.figures.levels import COMPARED_DB, check_floor, difference_db
from polywigner.geometry.arguments import checked_choice, checked_flag
from polywigner.geometry.display import length_unit

if TYPE_CHECKING:
    from matplotlib.figure import Figure, SubFigure


Floats = NDArray[np.float64]

_COLOURS = (
    style.RED,
    style.BLUE,
    style.ORANGE,
    style.GREEN,
    style.VIOLET,
    "#8c510a",
    "#e377c2",
    "#666666",
)
_DASHES = ("-", "--", "-.", (0, (1, 1.2)), (0, (5, 1, 1, 1, 1, 1)))

_DECADES = 20.0
"""Ratio of the ends of an axis of lengths from which it is logarithmic."""

_LINEAR_DB = 0.01
"""Difference up to which the axis is linear, logarithmic beyond: differences of good methods fall
by three decades along a line."""


class _Curves(NamedTuple):
    """Curves of a column of panels: fields by method, and their places as they are printed."""

    fields: Comparison
    places: Floats
    along: str
    is_logarithmic: bool


@style.typeset
def draw_lines(
    found: Any,
    *,
    along: str | None = None,
    against: str | None = None,
    floor_db: float = -40.0,
    linear: bool = False,
    compared_db: float = COMPARED_DB,
    title: str = "",
    figure: Figure | SubFigure | None = None,
) -> Any:
    """Levels along a line by each method, and below them the differences from one of the methods.

    Parameters
    ----------
    found : xarray.Dataset with a variable for each method, as from :func:`polywigner.line` and, for
        a cut, :func:`polywigner.hemisphere`; complex values are squared. Or several, by the titles
        of the columns in which they are drawn beside each other, all of the same methods.
    along : the coordinate on the horizontal axis, in metres or radians; None: x, y or z if the
        line is parallel to it, else that of the dataset.
    against : the variable that the others are compared with; None: the last one.
    floor_db : lowest level shown, dB below the peak of that method. Curves have gaps where values
        are not above zero.
    linear : show values relative to that peak on a linear scale instead of levels in dB.
    compared_db : lowest level of that method at which differences are shown.
    title : above the panels.
    figure : matplotlib Figure or SubFigure to draw on, which is returned; None: a new figure.

    Raises
    ------
    ArgumentError : no such quantity, method or coordinate; values over more than one axis; what is
    no figure.
    """
    check_floor(floor_db)
    checked_flag(linear, "linear")
    columns = dict(found) if isinstance(found, dict) and found else {"": found}
    fields = [Comparison.of(one, against) for one in columns.values()]
    curves = [
        _Curves(each, *_axis(one, each.dims, along))
        for one, each in zip(columns.values(), fields, strict=True)
    ]
    is_compared, side_by_side = len(fields[0].powers) > 1, len(curves) > 1
    width = 1.0 + 3.0 * len(curves) if side_by_side else 6.4
    size = width, (5.6 if is_compared else 3.7) + 0.3 * side_by_side
    figure = style.figure_on(figure, *size, spacing=0.03)
    ratios = (3, 2) if is_compared else (1,)
    shape = len(ratios), len(curves)
    panels = figure.subplots(
        *shape, sharex="col", sharey="row", squeeze=False, height_ratios=ratios
    )
    for column, one, name in zip(panels.T, curves, columns, strict=True):
        _draw_column(column, one, name, compared_db, linear)
    if not linear:
        panels[0, 0].set_ylim(*_range(fields, floor_db))
    unit = "relative" if linear else "dB"
    panels[0, 0].set_ylabel(f"{fields[0].quantity} ({unit})")
    if is_compared:
        _difference_axis(panels[1], fields[0], compared_db)
        how: dict[str, Any] = {"frameon": False, "fontsize": 7.5, "handlelength": 2.6}
        if side_by_side:
            handles = panels[0, 0].get_legend_handles_labels()
            figure.legend(*handles, loc="outside lower center", ncols=len(handles[0]), **how)
        else:
            panels[0, 0].legend(**how)
    style.write_title(figure, title)
    return figure


def _draw_column(column: Any, curves: _Curves, name: str, compared_db: float, linear: bool) -> None:
    """Draw levels, and below them differences where there are any."""
    fields = curves.fields
    styles = _styles(list(fields.powers), fields.against)
    for method, values in fields.powers.items():
        levels = values / fields.zero
        if not linear:
            levels[values <= 0] = np.nan
            levels = 10 * np.log10(levels)
        column[0].plot(curves.places, levels, label=fields.labels[method], **styles[method])
        if method != fields.against:
            difference = difference_db(values, fields.powers[fields.against], compared_db)
            column[1].plot(curves.places, difference, **styles[method])
    text = f"{'1' if linear else '0 dB'}: {fields.zero_text}"
    if name:
        text = f"{name}; {text}"
    elif len(styles) > 1:
        text += f", the peak of {fields.labels[fields.against]}"
    column[0].set_title(text, loc="left", fontsize=8)
    for axes in column:
        axes.grid(alpha=0.3, lw=0.5)
        axes.margins(x=0)
        if curves.is_logarithmic:
            axes.set_xscale("log")
    column[-1].set_xlabel(curves.along)
    if curves.is_logarithmic:
        from matplotlib.ticker import LogFormatter, LogLocator

        axis = column[-1].xaxis
        axis.set_major_locator(LogLocator(subs=(1, 2, 5)))
        axis.set_major_formatter(LogFormatter(labelOnlyBase=False, minor_thresholds=(9, 9)))
        axis.set_minor_formatter(lambda *_: "")


def _axis(found: Any, dims: tuple[str, ...], along: str | None) -> tuple[Floats, str, bool]:
    """Places as they are printed, the label of their axis, and whether it is logarithmic."""
    if len(dims) != 1:
        raise ArgumentError(f"expected fields along one axis, got them over {', '.join(dims)}")
    if along is None:
        along = _parallel(found, dims[0])
    checked_choice(along, "along", [str(name) for name in found.coords])
    places = np.asarray(found[along].squeeze().values, dtype=np.float64)
    kind = found[along].attrs.get("units", "")
    called = str(found[along].attrs.get("long_name", f"${along}$" if len(along) == 1 else along))
    if kind == "rad":
        return np.degrees(places), f"{called} (degrees)", False
    if kind != "m":
        return places, f"{called} ({kind})" if kind else called, False
    unit = length_unit(float(np.abs(places).max()))
    logarithmic = bool(places.min() > 0 and places.max() > _DECADES * places.min())
    return places / unit.metres, f"{called} ({unit.name})", logarithmic


def _parallel(found: Any, dim: str) -> str:
    """The one of x, y and z that changes along a line, where the others do not."""
    if found[dim].attrs.get("units") != "m":
        return dim
    changing = [k for k in "xyz" if k in found.coords and np.ptp(found[k].values) > 0]
    return changing[0] if len(changing) == 1 else dim


def _styles(methods: list[str], against: str) -> dict[str, dict[str, Any]]:
    """Line styles: the reference is a broad grey band, on which other lines are still seen."""
    if len(methods) == 1:
        return {against: {"color": _COLOURS[1], "lw": 1.2}}
    dressed = zip(cycle(_COLOURS), cycle(_DASHES), strict=False)
    styles: dict[str, dict[str, Any]] = {
        method: {"color": colour, "lw": 1.2, "ls": dash}
        for method, (colour, dash) in zip(
            (method for method in methods if method != against), dressed, strict=False
        )
    }
    broad = {"color": "0.72", "lw": 4.0, "zorder": 1.5, "solid_capstyle": "butt"}
    return styles | {against: broad}


def _range(columns: list[Comparison], floor_db: float) -> tuple[float, float]:
    """From the floor, or just below all curves, to above them. They may pass the peak of the
    reference (0 dB), but not by so much that nothing else is seen."""
    levels = np.concatenate(
        [v[v > 0] / fields.zero for fields in columns for v in fields.powers.values()]
    )
    low, high = 10 * np.log10([levels.min(), levels.max()])
    top, bottom = min(high, -floor_db / 4), max(low, floor_db)
    margin = 0.04 * (top - bottom) + 0.1
    return float(bottom if low < floor_db else bottom - margin), float(top + margin)


def _difference_axis(panels: Any, fields: Comparison, compared_db: float) -> None:
    from matplotlib.ticker import FixedLocator, FuncFormatter

    largest = max(
        float(np.nanmax(np.abs(line.get_ydata()), initial=0.0))
        for axes in panels
        for line in axes.lines
    )
    bound = min(max(largest * 1.3, 3 * _LINEAR_DB), 30.0)
    decades = [10.0**k for k in range(-2, 2) if 10.0**k <= bound]
    called = fields.labels[fields.against]
    panels[0].set_ylabel("difference (dB)")
    text = f"minus {called}, where above {style.number_text(compared_db)} dB of its peak"
    panels[0].set_title(text, loc="left", fontsize=8)
    for axes in panels:
        axes.set_yscale("symlog", linthresh=_LINEAR_DB, linscale=0.6)
        axes.set_ylim(-bound, bound)
        axes.yaxis.set_major_locator(FixedLocator([-d for d in decades[::-1]] + [0.0, *decades]))
        axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: style.number_text(value)))
        axes.yaxis.set_minor_locator(FixedLocator([]))
        axes.axhline(0, color="0.5", lw=0.6)
