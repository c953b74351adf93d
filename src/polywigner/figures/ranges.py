"""Received power over range, with its errors and the noise."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from polywigner.errors import ArgumentError
from polywigner.figures.levels import PEAK_RULE, check_floor, level_db, picture_peak
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


Floats = NDArray[np.float64]

_MILLIWATT = 1e-3
# Room below the noise and above the peak, dB.
_ROOM = 5.0


def draw_range_profile(
    profile: Any,
    receiver: int = 0,
    *,
    floor_db: float = -60.0,
    title: str = "",
    ax: Axes | None = None,
) -> Any:
    """Scattered power of each bin in dBm over range in m, with the noise of the receiver.

    Parameters
    ----------
    profile : as :func:`polywigner.mitsuba.range_profile` returns.
    receiver : which one of several, from 0.
    floor_db : lowest level, dB below the largest bin, or 5 dB below the noise if that is lower;
        what is less, or not positive, has no line.
    title : above the picture.
    ax : matplotlib axes to draw on; None: a new figure.

    Returns
    -------
    The axes that were given, or the new figure.

    Raises
    ------
    ArgumentError : no profile, or not that receiver; what are no axes; a floor that is not below
        0 dB.
    """
    import matplotlib as mpl

    check_floor(floor_db)
    edges, power, error, noise = _checked(profile, receiver)
    peak = float(power.max())
    top = 10 * math.log10(peak / _MILLIWATT) if peak > 0 else 0.0
    low = top + floor_db
    noise_level = 10 * math.log10(noise / _MILLIWATT) if noise > 0 else None
    if noise_level is not None:
        low, top = min(low, noise_level - _ROOM), max(top, noise_level)
    with mpl.rc_context(TYPOGRAPHY):
        figure = new_figure(6.4, 3.6) if ax is None else None
        axes = figure.add_subplot() if figure is not None else checked_axes(ax)
        band = [_levels(power + sign * error, low) for sign in (-1, 1)]
        axes.stairs(band[1], edges, baseline=band[0], fill=True, color="C0", alpha=0.3, lw=0)
        axes.stairs(_levels(power, low), edges, baseline=None, color="C0", lw=1.0)
        if noise_level is not None:
            label = f"noise kTBF, {number_text(round(noise_level, 1))} dBm"
            axes.axhline(noise_level, color="C3", ls="--", lw=1.0, label=label)
            axes.legend(frameon=False, fontsize=7, loc="upper right")
        axes.set_xlim(edges[0], edges[-1])
        axes.set_ylim(low, top + _ROOM)
        width = np.diff(edges)
        bins = f"{number_text(float(f'{width.max():.4g}'))} m"
        if width.max() > width.min() * (1 + 1e-6):
            bins = f"up to {bins}"
        axes.set_xlabel("range, half the length of the path (m)")
        axes.set_ylabel(f"scattered power of a bin of {bins} (dBm)\n± its standard error")
        axes.grid(alpha=0.4, lw=0.5)
        axes.set_title(title, fontsize=8)
    return figure if figure is not None else axes


def _checked(profile: Any, receiver: int) -> tuple[Floats, Floats, Floats, float]:
    """Edges, powers, errors, and the noise or zero, of one receiver."""
    try:
        edges = np.asarray(profile["range_edge"].values)
        power, error, noise = (
            np.asarray(profile[name].values) for name in ("power", "standard_error", "noise_power")
        )
        if power.ndim == 1:
            power, error, noise = power[None], error[None], noise[None]
        own = power[receiver], error[receiver], float(np.nan_to_num(noise[receiver]))
    except (TypeError, KeyError, IndexError, AttributeError):
        raise ArgumentError(
            "expected a profile of polywigner.mitsuba.range_profile and the number of one of its "
            f"receivers, got {type(profile).__name__} and {receiver!r}"
        ) from None
    return edges, *own


def _levels(power: Floats, low: float) -> Floats:
    """dBm, not below ``low``."""
    floor = _MILLIWATT * 10 ** (low / 10)
    return np.asarray(10 * np.log10(np.maximum(power, floor) / _MILLIWATT))


if TYPE_CHECKING:
    from matplotlib.axes import Axes


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
