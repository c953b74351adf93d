"""Pictures of rendered scenes: radiance in dB, frames by range, and the power of receivers."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from polywigner.errors import ArgumentError
from polywigner.figures.levels import PEAK_RULE, check_floor, level_db, picture_peak
from polywigner.figures.style import (
    LEVEL_MAP,
    TYPOGRAPHY,
    axes_on,
    checked_title,
    colour_bar,
    draw_circles,
    draw_levels,
    floor_text,
    number_text,
    quantity_text,
)
from polywigner.geometry.arguments import checked_array, checked_count, checked_path

if TYPE_CHECKING:
    from matplotlib.axes import Axes


def draw_scene(
    radiance: ArrayLike,
    reference: float | None,
    floor_db: float,
    unit: str = "W/(m² sr)",
    title: str = "",
    *,
    ax: Axes | None = None,
) -> Any:
    """A rendered picture in dB relative to ``reference``, with a colour bar that says so.

    Parameters
    ----------
    radiance : (height, width), signed, in ``unit``.
    reference : the 0 dB radiance, normally :func:`polywigner.figures.picture_peak`; None draws
        an empty picture (nothing lit).
    floor_db : lowest level, dB; everything at or below it, negative radiance included, gets its
        colour.
    unit : unit of ``radiance``, for the label.
    title : above the picture.
    ax : matplotlib axes to draw on, whose figure gets the colour bar; None: a new figure.

    Returns
    -------
    The axes that were given, or the new figure.

    Raises
    ------
    ArgumentError : what are no axes.
    """
    import matplotlib as mpl

    picture = checked_array(radiance, "radiance", 2)
    height, width = picture.shape
    levels = level_db(picture, reference, floor_db)
    with mpl.rc_context(TYPOGRAPHY):
        axes, drawn = axes_on(ax, *_size(width, height))
        shown = draw_levels(axes, levels, low=floor_db)
        axes.set_xticks([])
        axes.set_yticks([])
        extend = "max" if np.any(levels > 0) else "neither"
        axes.set_title(title, fontsize=8)
        colour_bar(axes, shown, _label(reference, floor_db, unit), extend)
    return drawn


def _size(width: int, height: int) -> tuple[float, float]:
    """Inches: the longer side of the picture is 5, with room for a colour bar and its label."""
    scale = 5.0 / max(width, height)
    return width * scale + 1.2, max(height * scale, 3.4)


def _label(reference: float | None, floor_db: float, unit: str) -> str:
    floor = floor_text(floor_db)
    if reference is None:
        return f"radiance; nothing positive to compare with\n{floor}"
    return (
        f"radiance, dB relative to {quantity_text(reference, unit)}\n"
        f"(peak: {PEAK_RULE}); {floor}:\n"
        "all below it, negative radiance included"
    )


# Colours of the picture and of text: one palette for all frames.
_LEVELS, _GREYS = 200, 50
# A GIF is in memory until its end: 1 GB, drawn in two minutes.
_MOST_FRAMES = 2**10


def write_range_animation(
    frames: Any,
    path: str | os.PathLike[str],
    *,
    floor_db: float = -40.0,
    title: str = "",
    milliseconds: int = 100,
) -> None:
    """Write an animated GIF of frames by range, in dB below the peak of all frames.

    Parameters
    ----------
    frames : as :func:`polywigner.mitsuba.range_frames` returns, up to 1024.
    path : the file, whatever its suffix; one that is there is replaced.
    floor_db : lowest level, dB.
    title : above each frame, before its range.
    milliseconds : of each frame, 10 or more.

    Raises
    ------
    ArgumentError : no frames or too many, a floor that is not below 0 dB, a time out of range.
    """
    from PIL import Image

    check_floor(floor_db)
    edges, radiance = _checked_frames(frames)
    checked_count(milliseconds, "milliseconds", 10, 60_000)
    checked_title(title)
    path = checked_path(path)
    peaks = [picture_peak(frame) or 0.0 for frame in radiance]
    peak = max(peaks) or None
    figure = draw_scene(radiance[0], peak, floor_db, title="")
    axes = figure.axes[0]
    palette, images = _palette(), []
    for number, frame in enumerate(radiance):
        axes.images[0].set_data(level_db(frame, peak, floor_db))
        first, last = (number_text(float(f"{edges[number + k]:.4g}")) for k in (0, 1))
        lines = [title, f"range {first} to {last} m"]
        axes.set_title("\n".join(line for line in lines if line), fontsize=8)
        figure.canvas.draw()
        drawn = Image.fromarray(np.asarray(figure.canvas.buffer_rgba())[..., :3].copy())
        images.append(drawn.quantize(palette=palette, dither=Image.Dither.NONE))
    images[0].save(
        path,
        format="GIF",
        save_all=True,
        append_images=images[1:],
        duration=milliseconds,
        loop=0,
        optimize=False,
    )


def _checked_frames(frames: Any) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Edges (n + 1,) and radiances (n, rows, columns)."""
    try:
        edges, radiance = (np.asarray(frames[name].values) for name in ("range_edge", "radiance"))
    except (TypeError, KeyError, AttributeError, IndexError):
        raise ArgumentError(
            f"expected frames of polywigner.mitsuba.range_frames, got {type(frames).__name__}"
        ) from None
    if radiance.ndim != 3 or not 1 <= len(radiance) <= _MOST_FRAMES:
        raise ArgumentError(
            f"expected from 1 to {_MOST_FRAMES} frames, got {len(radiance)}; use fewer, wider bins"
        )
    return edges, radiance


def _palette() -> Any:
    import matplotlib as mpl
    from PIL import Image

    colours = mpl.colormaps[LEVEL_MAP](np.linspace(0, 1, _LEVELS))[:, :3]
    greys = np.repeat(np.linspace(0, 1, _GREYS)[:, None], 3, axis=1)
    palette = Image.new("P", (1, 1))
    table = (255 * np.concatenate([colours, greys])).round().astype(int)
    palette.putpalette(table.ravel().tolist())
    return palette


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
    edges, power, error, noise = _checked_profile(profile, receiver)
    peak = float(power.max())
    top = 10 * math.log10(peak / _MILLIWATT) if peak > 0 else 0.0
    low = top + floor_db
    noise_level = 10 * math.log10(noise / _MILLIWATT) if noise > 0 else None
    if noise_level is not None:
        low, top = min(low, noise_level - _ROOM), max(top, noise_level)
    with mpl.rc_context(TYPOGRAPHY):
        axes, drawn = axes_on(ax, 6.4, 3.6)
        band = [_dbm(power + sign * error, low) for sign in (-1, 1)]
        axes.stairs(band[1], edges, baseline=band[0], fill=True, color="C0", alpha=0.3, lw=0)
        axes.stairs(_dbm(power, low), edges, baseline=None, color="C0", lw=1.0)
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
    return drawn


def _checked_profile(profile: Any, receiver: int) -> tuple[Floats, Floats, Floats, float]:
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


def _dbm(power: Floats, low: float) -> Floats:
    """dBm, not below ``low``."""
    floor = _MILLIWATT * 10 ** (low / 10)
    return np.asarray(10 * np.log10(np.maximum(power, floor) / _MILLIWATT))


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

    values = checked_array(power, "power", 2)
    peak, rule = picture_peak(values), PEAK_RULE
    if peak is None:  # a target of a few pixels
        highest = float(np.max(values, initial=0.0, where=np.isfinite(values)))
        peak, rule = (highest, "largest pixel") if highest > 0 else (None, "")
    levels = level_db(values, peak, floor_db)
    top = 0.0 if peak is None else 10 * math.log10(peak / _MILLIWATT)
    with mpl.rc_context(TYPOGRAPHY):
        axes, drawn = axes_on(ax, 5.2, 4.6)
        shown = draw_levels(
            axes, levels + top, low=top + floor_db, high=top,
            origin="lower", extent=(-1, 1, -1, 1), interpolation="nearest",
        )  # fmt: skip
        shown.set_clip_path(Circle((0, 0), 1.0, transform=axes.transData))
        draw_circles(axes, above=False)
        _mark(axes, direct)
        axes.set_xlim(1.02, -1.02)
        axes.set_ylim(-1.02, 1.02)
        axes.set_xlabel(r"$s_x$")
        axes.set_ylabel(r"$s_y$")
        axes.set_title(title, fontsize=8)
        extend = "max" if np.any(levels > 0) else "neither"
        colour_bar(axes, shown, _map_label(rule, floor_db, values.shape), extend)
    return drawn


def _mark(axes: Any, direct: Sequence[DirectArrival]) -> None:
    if not isinstance(direct, Sequence) or not all(isinstance(d, DirectArrival) for d in direct):
        raise ArgumentError(f"expected direct as a sequence of DirectArrival, got {direct!r}")
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


def _map_label(rule: str, floor_db: float, shape: tuple[int, ...]) -> str:
    pixels = f"scattered power of a pixel ({shape[1]} x {shape[0]}), dBm"
    floor = floor_text(floor_db)
    if not rule:
        return f"{pixels}; nothing positive\n{floor}"
    return f"{pixels}\n(peak: {rule}); {floor}:\nall below it, negative power included"
