"""Received power over the directions that it comes from."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from polywigner.figures.levels import PEAK_RULE, level_db, picture_peak
from polywigner.figures.style import (
    LEVEL_MAP,
    TYPOGRAPHY,
    checked_axes,
    colour_bar,
    new_figure,
    number_text,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["DirectArrival", "draw_arrivals"]

_MILLIWATT = 1e-3
_RINGS = (30, 60)  # degrees from the axis
_MARK = "#4dd2ff"


class DirectArrival(NamedTuple):
    """Light straight from a source, or from its image: a mark in the picture."""

    place: tuple[float, float]
    """Direction cosines."""
    power: float
    """W."""
    name: str


def draw_arrivals(
    power: ArrayLike,
    direct: Sequence[DirectArrival] = (),
    floor_db: float = -40.0,
    title: str = "",
    *,
    ax: Axes | None = None,
) -> Any:
    """A map of scattered power over direction cosines, in dBm, with marks for direct light.

    As the receiver sees it, along its +z with its +y upwards: its +x points to the left.

    Parameters
    ----------
    power : (n, m) W of each pixel, columns along s_x, rows along s_y, from -1 to 1.
    direct : light from single directions, which no map can show.
    floor_db : lowest level, dB below the peak (the largest 3x3 median; of targets smaller than that
        the largest pixel); all that is less, negative values included, has its colour.
    title : above the picture.
    ax : matplotlib axes to draw on, whose figure gets the colour bar; None: a new figure.

    Returns
    -------
    The axes that were given, or the new figure.

    Raises
    ------
    ArgumentError : what are no axes; a floor that is not below 0 dB.
    """
    import matplotlib as mpl
    from matplotlib.patches import Circle

    values = np.asarray(power, dtype=np.float64)
    peak, rule = picture_peak(values), PEAK_RULE
    if peak is None:  # a target of a few pixels
        highest = float(np.max(values, initial=0.0, where=np.isfinite(values)))
        peak, rule = (highest, "largest pixel") if highest > 0 else (None, "")
    levels = level_db(values, peak, floor_db)
    top = 0.0 if peak is None else 10 * math.log10(peak / _MILLIWATT)
    with mpl.rc_context(TYPOGRAPHY):
        figure = new_figure(5.2, 4.6) if ax is None else None
        axes = figure.add_subplot() if figure is not None else checked_axes(ax)
        shown = axes.imshow(
            levels + top,
            cmap=LEVEL_MAP,
            vmin=top + floor_db,
            vmax=top,
            origin="lower",
            extent=(-1, 1, -1, 1),
            interpolation="nearest",
        )
        rim = Circle((0, 0), 1.0, transform=axes.transData)
        shown.set_clip_path(rim)
        for degrees in (*_RINGS, 90):
            radius = math.sin(math.radians(degrees))
            is_rim = degrees == 90
            how: dict[str, Any] = {"edgecolor": "0.4" if is_rim else "white", "fill": False}
            axes.add_patch(Circle((0, 0), radius, lw=0.6, ls="-" if is_rim else ":", **how))
            if not is_rim:
                place = radius * math.sqrt(0.5)  # at the lower left
                axes.text(
                    place, -place, f"{degrees}°", color="white", fontsize=7, ha="right", va="top"
                )
        _mark(axes, direct)
        axes.set_xlim(1.02, -1.02)
        axes.set_ylim(-1.02, 1.02)
        axes.set_xlabel(r"$s_x$")
        axes.set_ylabel(r"$s_y$")
        axes.set_title(title, fontsize=8)
        extend = "max" if np.any(levels > 0) else "neither"
        colour_bar(axes, shown, _label(rule, floor_db, values.shape), extend)
    return figure if figure is not None else axes


def _mark(axes: Any, direct: Sequence[DirectArrival]) -> None:
    for number, arrival in enumerate(direct):
        axes.plot(*arrival.place, "o", mfc="none", mec=_MARK, ms=7, mew=1.2)
        level = f"{10 * math.log10(arrival.power / _MILLIWATT):.1f} dBm".replace("-", "−")
        # into the picture: places of s_x > 0 are at the left
        side, above = (1 if arrival.place[0] > 0 else -1), (1 if number % 2 == 0 else -1)
        axes.annotate(
            f"{arrival.name}\n{level}",
            arrival.place,
            xytext=(2 * side, 7 * above),
            textcoords="offset points",
            color=_MARK,
            fontsize=7,
            ha="left" if side > 0 else "right",
            va="bottom" if above > 0 else "top",
        )


def _label(rule: str, floor_db: float, shape: tuple[int, ...]) -> str:
    pixels = f"scattered power of a pixel ({shape[1]} x {shape[0]}), dBm"
    floor = f"floor {number_text(floor_db)} dB"
    if not rule:
        return f"{pixels}; nothing positive\n{floor}"
    return f"{pixels}\n(peak: {rule}); {floor}:\nall below it, negative power included"
