"""Fields along a line or an arc, by several methods, with their differences in dB."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from polywigner.errors import ArgumentError
from polywigner.figures.differences import COMPARED_DB, difference_db
from polywigner.figures.fields import (
    chosen_method,
    dims_of,
    fields_of,
    first_of,
    label_of,
    peak_of,
    printed_unit,
    quantity_of,
)
from polywigner.figures.levels import check_floor
from polywigner.figures.style import TYPOGRAPHY, length_unit, new_figure, quantity_text

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["draw_lines"]

Floats = NDArray[np.float64]

_COLOURS = ("#d7301f", "#2166ac", "#e69f00", "#1b9e77", "#7b3294", "#8c510a", "#e377c2", "#666666")
_DASHES = ("-", "--", "-.", (0, (1, 1.2)), (0, (5, 1, 1, 1, 1, 1)))

_DECADES = 20.0
"""Ratio of the ends of an axis of lengths from which it is logarithmic."""

_LINEAR_DB = 0.01
"""Differences are drawn linearly up to here and logarithmically beyond: those of good methods fall
by three decades along a line."""


def draw_lines(
    found: Any,
    *,
    along: str | None = None,
    against: str | None = None,
    floor_db: float = -40.0,
    compared_db: float = COMPARED_DB,
    title: str = "",
) -> Figure:
    """Levels along a line by each method, and below them the differences from one of the methods.

    Parameters
    ----------
    found : xarray.Dataset with a variable for each method, as from :func:`polywigner.line` and, for
        a cut, :func:`polywigner.hemisphere`; of power-like values.
    along : the coordinate on the horizontal axis, in metres or radians; None: x, y or z if the
        line is parallel to it, else that of the dataset.
    against : the variable that the others are compared with; None: the last one.
    floor_db : lowest level shown, dB below the peak of that method. Curves have gaps where values
        are not above zero.
    compared_db : lowest level of that method at which differences are shown.

    Raises
    ------
    ArgumentError : no such quantity, method or coordinate; values over more than one axis.
    """
    import matplotlib as mpl

    check_floor(floor_db)
    curves = fields_of(found)
    against = chosen_method(curves, against)
    first = first_of(found)
    name, unit = quantity_of(first), printed_unit(first)
    x, label, logarithmic = _axis(found, along)
    zero = peak_of(curves[against], name)
    labels = {method: label_of(found[method], method) for method in curves}
    with mpl.rc_context(TYPOGRAPHY):
        several = len(curves) > 1
        figure = new_figure(6.4, 5.6 if several else 3.7, spacing=0.03)
        rows = figure.subplots(
            2 if several else 1, 1, sharex=True, squeeze=False,
            height_ratios=(3, 2) if several else (1,),
        )[:, 0]  # fmt: skip
        styles = _styles(list(curves), against)
        for method, values in curves.items():
            levels = np.full(values.shape, np.nan)
            levels[values > 0] = 10 * np.log10(values[values > 0] / zero)
            rows[0].plot(x, levels, label=labels[method], **styles[method])
        rows[0].set_ylim(*_range(list(curves.values()), zero, floor_db))
        rows[0].set_ylabel(f"{name} (dB)")
        zero_text = quantity_text(zero, unit).rstrip()
        rows[0].set_title(
            f"0 dB: {zero_text}" + (f", the peak of {labels[against]}" if several else ""),
            loc="left",
            fontsize=8,
        )
        if several:
            rows[0].legend(frameon=False, fontsize=7.5, handlelength=2.6)
            for method, values in curves.items():
                if method != against:
                    difference = difference_db(values, curves[against], compared_db)
                    rows[1].plot(x, difference, **styles[method])
            _difference_axis(rows[1], labels[against], compared_db)
        for axes in rows:
            axes.grid(alpha=0.3, lw=0.5)
            axes.margins(x=0)
            if logarithmic:
                axes.set_xscale("log")
        rows[-1].set_xlabel(label)
        if logarithmic:
            _plain_ticks(rows[-1])
        figure.suptitle(title)
    return figure


def _axis(found: Any, along: str | None) -> tuple[Floats, str, bool]:
    """Places as they are printed, the label of their axis, and whether it is logarithmic."""
    dims = dims_of(found)
    if len(dims) != 1:
        raise ArgumentError(f"expected fields along one axis, got them over {', '.join(dims)}")
    if along is None:
        along = _parallel(found, dims[0])
    if along not in found.coords:
        names = ", ".join(map(str, found.coords))
        raise ArgumentError(f"expected one of the coordinates {names}, got {along!r}")
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
    """The reference is a broad grey band behind the others: what lies on it is still seen."""
    others = [method for method in methods if method != against]
    styles: dict[str, dict[str, Any]] = {
        against: {"color": "0.72", "lw": 4.0, "zorder": 1.5, "solid_capstyle": "butt"}
    }
    if not others:
        styles[against] = {"color": _COLOURS[1], "lw": 1.2}
    for k, method in enumerate(others):
        dash = _DASHES[k % len(_DASHES)]
        styles[method] = {"color": _COLOURS[k % len(_COLOURS)], "lw": 1.2, "ls": dash}
    return styles


def _range(curves: list[Floats], zero: float, floor_db: float) -> tuple[float, float]:
    """From the floor, or just below all curves, to above them. They may pass the peak of the
    reference (0 dB), but not by so much that nothing else is seen."""
    positive = np.concatenate([values[values > 0] for values in curves])
    low, high = (10 * np.log10(end / zero) for end in (positive.min(), positive.max()))
    top = min(high, -floor_db / 4)
    bottom = max(low, floor_db)
    margin = 0.04 * (top - bottom) + 0.1
    return (bottom if low < floor_db else bottom - margin), top + margin


def _difference_axis(axes: Axes, against: str, compared_db: float) -> None:
    from matplotlib.ticker import FixedLocator, FuncFormatter

    largest = max(
        (float(np.nanmax(np.abs(line.get_ydata()), initial=0.0)) for line in axes.lines),
        default=0.0,
    )
    bound = min(max(largest * 1.3, 3 * _LINEAR_DB), 30.0)
    axes.set_yscale("symlog", linthresh=_LINEAR_DB, linscale=0.6)
    axes.set_ylim(-bound, bound)
    decades = [10.0**k for k in range(-2, 2) if 10.0**k <= bound]
    axes.yaxis.set_major_locator(FixedLocator([-d for d in decades[::-1]] + [0.0, *decades]))
    axes.yaxis.set_major_formatter(FuncFormatter(lambda v, _: f"{v:g}".replace("-", "−")))
    axes.yaxis.set_minor_locator(FixedLocator([]))
    axes.axhline(0, color="0.5", lw=0.6)
    axes.set_ylabel("difference (dB)")
    text = f"less {against}, where that is above {compared_db:g} dB of its peak"
    axes.set_title(text, loc="left", fontsize=8)


def _plain_ticks(axes: Axes) -> None:
    from matplotlib.ticker import LogFormatter, LogLocator

    axes.xaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
    axes.xaxis.set_major_formatter(LogFormatter(labelOnlyBase=False, minor_thresholds=(9, 9)))
    axes.xaxis.set_minor_formatter(lambda *_: "")
