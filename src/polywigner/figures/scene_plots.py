"""Figures of scenes: radiance in dB, frames by range, and the power and channels of receivers."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from polywigner.errors import ArgumentError, value_text
from polywigner.figures import style
from polywigner.figures.levels import arrays_of, check_floor, level_db, picture_peak
from polywigner.geometry.arguments import checked_array, checked_count, checked_path
from polywigner.propagation.stores import in_place

if TYPE_CHECKING:
    from matplotlib.axes import Axes


@style.typeset
def draw_scene(
    radiance: ArrayLike,
    reference: float | None,
    floor_db: float,
    unit: str = "W/(m² sr)",
    title: str = "",
    *,
    ax: Axes | None = None,
) -> Any:
    """Draw a rendered image in dB relative to ``reference``, with a colour bar.

    Parameters
    ----------
    radiance : (height, width), signed, in ``unit``.
    reference : the 0 dB radiance, normally :func:`polywigner.figures.picture_peak`; None draws
        an image at the floor.
    floor_db : lowest level, dB; everything at or below it, negative radiance included, gets its
        colour.
    unit : unit of ``radiance``, for the label.
    title : above the image.
    ax : matplotlib axes to draw on, whose figure gets the colour bar; None: a new figure. The axes
        or the new figure are returned.

    Raises
    ------
    ArgumentError : ``ax`` of another type.
    """
    picture = checked_array(radiance, "radiance", 2)
    height, width = picture.shape
    levels = level_db(picture, reference, floor_db)
    reference = None if reference is None else float(reference)
    # Inches: the longer side of the image is 5, with room for a colour bar and its label.
    scale = 5.0 / max(width, height)
    axes, drawn = style.axes_on(ax, width * scale + 1.2, max(height * scale, 3.4))
    shown = style.draw_levels(axes, levels, low=floor_db)
    axes.set(xticks=[], yticks=[])
    axes.set_title(title, fontsize=8)
    zero = "nothing positive" if reference is None else style.quantity_text(reference, unit)
    label = f"radiance, dB relative to {zero}\n{style.floor_text(floor_db)}"
    style.colour_bar(axes, shown, label, "max" if np.any(levels > 0) else "neither")
    return drawn


_STOKES = ("S₀", "S₁: horizontal − vertical", "S₂: 45° − (−45°)", "S₃: left − right (IEEE)")


@style.typeset
def draw_stokes(stokes: ArrayLike, title: str = "") -> Any:
    """Draw the four Stokes parameters of a rendered image, signed, relative to its peak.

    Parameters
    ----------
    stokes : (4, height, width), as :func:`polywigner.mitsuba.stokes_of` returns.
    title : above the panels.

    Returns the figure.

    Raises
    ------
    ArgumentError : numbers of another shape; a title that is no text.
    """
    numbers, figure, panels = _stokes_panels(stokes, 2, title)
    peak = picture_peak(numbers[0])
    for axes, name, values in zip(panels, _STOKES, numbers, strict=True):
        shown = style.draw_signed(axes, values / (peak or 1.0))
        axes.set_title(name, fontsize=8)
    unit = style.quantity_text(peak, "W/(m² sr)") if peak else "nothing"
    style.signed_bar(panels, shown, f"relative to {unit}, the peak of S₀")
    return figure


# Degree of linear polarisation below which an angle is noise.
_LEAST_LINEAR = 0.05


@style.typeset
def draw_polarisation(stokes: ArrayLike, floor_db: float = -40.0, title: str = "") -> Any:
    """Draw the degree of polarisation of a rendered image and the angle of its linear part.

    Parameters
    ----------
    stokes : (4, height, width), as :func:`polywigner.mitsuba.stokes_of` returns.
    floor_db : level of S0 below its peak, in dB, below which pixels are grey.
    title : above the panels.

    The angle is from the image's right upwards, from -90 to 90 degrees, and grey if less than 5 %
    of the radiance is linearly polarised. Returns the figure.

    Raises
    ------
    ArgumentError : another shape; a floor that is not below 0 dB; a title that is no text.
    """
    check_floor(floor_db)
    numbers, figure, panels = _stokes_panels(stokes, 1, title)
    peak = picture_peak(numbers[0])
    lit = numbers[0] > (peak or math.inf) * 10 ** (floor_db / 10)
    whole = np.where(lit, numbers[0], 1.0)
    linear = np.hypot(numbers[1], numbers[2]) / whole
    degree = np.minimum(np.hypot(linear, numbers[3] / whole), 1.0)
    angle = np.degrees(np.arctan2(numbers[2], numbers[1])) / 2
    shown = style.draw_map(
        panels[0], np.where(lit, degree, np.nan), None, None, cmap="viridis", vmin=0, vmax=1
    )
    style.colour_bar(panels[0], shown, "degree of polarisation")
    angle = np.where(lit & (linear > _LEAST_LINEAR), angle, np.nan)
    shown = style.draw_map(panels[1], angle, None, None, cmap=style.PHASE_MAP, vmin=-90, vmax=90)
    style.colour_bar(panels[1], shown, "angle from the right upwards, degrees")
    for axes in panels:
        axes.set_facecolor("0.6")
    return figure


def _stokes_panels(stokes: ArrayLike, rows: int, title: str) -> tuple[Any, Any, Any]:
    """The numbers, and a figure with two columns of panels of the image's shape."""
    numbers = checked_array(stokes, "stokes", 3)
    if len(numbers) != 4:
        raise ArgumentError(
            f"expected stokes (4, height, width), got shape {numbers.shape}; see "
            "polywigner.mitsuba.stokes_of"
        )
    height, width = numbers.shape[1:]
    scale = 4.0 / max(height, width)
    size = 2 * width * scale + 1.6, max(rows * (height * scale + 0.3), 2.6) + 0.4
    figure = style.new_figure(*size, is_compressed=True)
    panels = figure.subplots(rows, 2).ravel()
    for axes in panels:
        axes.set(xticks=[], yticks=[])
    style.write_title(figure, title)
    return numbers, figure, panels


# A frame takes up to 2 MB of memory until the file is written.
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
    path : the file, with the suffix .gif; an existing file is replaced.
    floor_db : lowest level, dB.
    title : above each frame, before its range.
    milliseconds : of each frame, 10 or more.

    Raises
    ------
    ArgumentError : no frames or too many, a floor that is not below 0 dB, a time out of range, a
        place that cannot be written to.
    """
    from matplotlib.animation import PillowWriter

    check_floor(floor_db)
    names = {"range_edge": "", "radiance": ""}
    edges, radiance = arrays_of(frames, names, "polywigner.mitsuba.range_frames")
    if radiance.ndim != 3 or not 1 <= len(radiance) <= _MOST_FRAMES:
        raise ArgumentError(
            f"expected from 1 to {_MOST_FRAMES} frames, got {len(radiance)}; use fewer, wider bins"
        )
    checked_count(milliseconds, "milliseconds", 10, 60_000)
    path = checked_path(path)
    if path.suffix.lower() != ".gif":
        raise ArgumentError(f"expected a path with the suffix .gif, got {path.name!r}")
    peak = max(picture_peak(frame) or 0.0 for frame in radiance) or None
    figure = draw_scene(radiance[0], peak, floor_db)
    axes = figure.axes[0]
    writer = PillowWriter(fps=1000 / milliseconds)  # type: ignore[arg-type]
    with in_place(path) as scratch, writer.saving(figure, scratch, figure.dpi):
        for frame, first, last in zip(radiance, edges[:-1], edges[1:], strict=True):
            axes.images[0].set_data(level_db(frame, peak, floor_db))
            text = f"range {_rounded(first)} to {_rounded(last)} m"
            axes.set_title(f"{title}\n{text}" if title else text, fontsize=8)
            writer.grab_frame()


def _rounded(value: float) -> str:
    """A number with up to four significant digits."""
    return style.number_text(float(f"{value:.4g}"))


Floats = NDArray[np.float64]

_MILLIWATT = 1e-3
# Room below the noise and above the peak, dB.
_ROOM = 5.0


@style.typeset
def draw_range_profile(
    profile: Any,
    receiver: int = 0,
    *,
    floor_db: float = -60.0,
    title: str = "",
    ax: Axes | None = None,
) -> Any:
    """Draw the power of each bin in dBm over range in m, with the noise of the receiver.

    Circles are paths of direct light, line of sight and by flat mirrors.

    Parameters
    ----------
    profile : as :func:`polywigner.mitsuba.range_profile` returns.
    receiver : which one of several, from 0.
    floor_db : lowest level, dB below the largest bin, or 5 dB below the noise if that is lower;
        bins below it, and bins that are not positive, have no line.
    title : above the figure.
    ax : matplotlib axes to draw on, which are returned; None: a new figure, which is.

    Raises
    ------
    ArgumentError : no profile, or not that receiver; ``ax`` of another type; a floor that is not
        below 0 dB.
    """
    check_floor(floor_db)
    edges, power, error, noise, *paths = _checked_profile(profile, receiver)
    peak = float(power.max())
    top = 10 * math.log10(peak / _MILLIWATT) if peak > 0 else 0.0
    low = top + floor_db
    noise_level = 10 * math.log10(noise / _MILLIWATT) if noise > 0 else None
    if noise_level is not None:
        low, top = min(low, noise_level - _ROOM), max(top, noise_level)
    axes, drawn = style.axes_on(ax, 6.4, 3.6)
    band = [_dbm(power + sign * error, low) for sign in (-1, 1)]
    axes.stairs(band[1], edges, baseline=band[0], fill=True, color="C0", alpha=0.3, lw=0)
    axes.stairs(_dbm(power, low), edges, baseline=None, color="C0", lw=1.0)
    here = (paths[0] >= edges[0]) & (paths[0] <= edges[-1])
    if here.any():
        level = _dbm(paths[1][here], low)
        label = "direct path, or by flat mirrors"
        axes.plot(paths[0][here], level, "o", mfc="none", color="C1", ms=6, label=label)
    if noise_level is not None:
        label = f"noise kTBF, {style.number_text(round(noise_level, 1))} dBm"
        axes.axhline(noise_level, color="C3", ls="--", lw=1.0, label=label)
    width = np.diff(edges)
    bins = f"{_rounded(width.max())} m"
    if width.max() > width.min() * (1 + 1e-6):
        bins = f"up to {bins}"
    style.finish_lines(
        axes,
        legend=7 if noise_level is not None or here.any() else 0,
        xlim=(edges[0], edges[-1]),
        ylim=(low, top + _ROOM),
        xlabel="range, half the length of the path (m)",
        ylabel=f"power of a bin of {bins} (dBm)\n± its standard error",
    )
    axes.set_title(title, fontsize=8)
    return drawn


def _checked_profile(profile: Any, receiver: int) -> tuple[Floats, Floats, Floats, float, Any, Any]:
    """Edges, powers, errors, and the noise or zero, of one receiver; ranges, powers of paths."""
    if "receiver" in getattr(profile, "dims", ()):
        checked_count(receiver, "receiver", 0, profile.sizes["receiver"] - 1)
        profile = profile.isel(receiver=receiver)
    elif receiver != 0:
        raise ArgumentError(f"expected a profile of several receivers, got one and {receiver!r}")
    names = dict.fromkeys(
        ("range_edge", "power", "standard_error", "noise_power", "path_range", "path_power"), ""
    )
    maker = "polywigner.mitsuba.radar.range_profile"
    edges, power, error, noise, *paths = arrays_of(profile, names, maker)
    return edges, power, error, float(np.nan_to_num(noise)), paths[0].ravel(), paths[1].ravel()


def _dbm(power: Floats, low: float) -> Floats:
    """dBm, not below ``low``."""
    floor = _MILLIWATT * 10 ** (low / 10)
    return np.asarray(10 * np.log10(np.maximum(power, floor) / _MILLIWATT))


_MARK = "#4dd2ff"


class DirectArrival(NamedTuple):
    """A line-of-sight path from a source, or from its mirror image: a mark in the figure."""

    place: tuple[float, float]
    """Direction cosines."""
    power: float
    """W."""
    name: str


@style.typeset
def draw_arrivals(
    power: ArrayLike,
    direct: Sequence[DirectArrival] = (),
    floor_db: float = -40.0,
    title: str = "",
    *,
    names: Mapping[str, tuple[float, float]] | None = None,
    ax: Axes | None = None,
) -> Any:
    """Draw scattered power over direction cosines in dBm, with marks for direct paths.

    The view is the receiver's, along its +z axis with its +y axis upwards, so its +x axis points
    to the left. The axes show the directions from which power above the floor arrives.

    Parameters
    ----------
    power : (n, m) power of each pixel in W, columns along s_x, rows along s_y, from -1 to 1.
    direct : paths from single directions, which are marked with their power.
    floor_db : lowest level in dB below the strongest pixel. Weaker and negative pixels get the
        colour of the floor.
    title : title of the panel.
    names : labels and the direction cosines at which they are written, such as names of shapes.
    ax : matplotlib axes to draw on, whose figure gets the colour bar, or None for a new figure.

    Returns
    -------
    The axes, or the new figure.

    Raises
    ------
    ArgumentError : ``ax`` is not axes, or the floor is not below 0 dB.
    """
    from matplotlib.patches import Circle
    from matplotlib.patheffects import withStroke

    values = checked_array(power, "power", 2)
    peak = float(np.max(values, initial=0.0, where=np.isfinite(values))) or None
    levels = level_db(values, peak, floor_db)
    top = 0.0 if peak is None else 10 * math.log10(peak / _MILLIWATT)
    axes, drawn = style.axes_on(ax, 5.2, 4.6)
    shown = style.draw_levels(
        axes, levels + top, low=top + floor_db, high=top,
        origin="lower", extent=(-1, 1, -1, 1), interpolation="nearest",
    )  # fmt: skip
    shown.set_clip_path(Circle((0, 0), 1.0, transform=axes.transData))
    style.draw_circles(axes, above=False)
    labels = _mark(axes, direct)
    for name, place in (names or {}).items():
        label = axes.annotate(
            name, place, (0, 0), textcoords="offset points", ha="center", va="center", color="w",
            fontsize=7, parse_math=False, annotation_clip=True,
        )  # fmt: skip
        label.set_path_effects([withStroke(linewidth=1.5, foreground="k")])
        labels.append(label)
    low, high = _view(levels > floor_db, [arrival.place for arrival in direct])
    axes.set(xlim=(high[0], low[0]), ylim=(low[1], high[1]), xlabel=r"$s_x$", ylabel=r"$s_y$")
    axes.set_title(title, fontsize=8)
    rows, columns = values.shape
    text = f"scattered power per pixel ({columns} × {rows} pixels), dBm\n"
    text += (
        "nothing positive" if peak is None else style.floor_text(round(top + floor_db, 1), "dBm")
    )
    style.colour_bar(axes, shown, text)
    style.separate_labels(axes, labels)
    return drawn


# Margin about the directions shown, and the smallest half width, in direction cosines.
_MARGIN, _LEAST_HALF = 0.05, 0.1


def _view(
    bright: NDArray[np.bool_], places: Sequence[tuple[float, float]]
) -> tuple[Floats, Floats]:
    """Return the lower and upper corner of the square that contains pixels and directions."""
    rows, columns = bright.shape
    corners = [np.asarray(places, np.float64).reshape(-1, 2)]
    for axis, count in ((1, columns), (0, rows)):
        at = np.flatnonzero(bright.any(axis=1 - axis))
        if len(at):
            ends = np.full((2, 2), np.nan)
            ends[:, 1 - axis] = np.array([at[0], at[-1] + 1]) * (2 / count) - 1
            corners.append(ends)
    points = np.concatenate(corners)
    if not len(points):
        return np.full(2, -1.02), np.full(2, 1.02)
    low, high = np.nanmin(points, axis=0), np.nanmax(points, axis=0)
    half = min(max(float((high - low).max()) / 2 + _MARGIN, _LEAST_HALF), 1.02)
    centre = np.clip((low + high) / 2, half - 1.02, 1.02 - half)
    return centre - half, centre + half


def _mark(axes: Any, direct: Sequence[DirectArrival]) -> list[Any]:
    """Mark direct paths, and return their labels."""
    if not isinstance(direct, Sequence) or not all(isinstance(d, DirectArrival) for d in direct):
        raise ArgumentError(
            f"expected direct as a sequence of DirectArrival, got {value_text(direct)}"
        )
    labels = []
    for arrival in direct:
        axes.plot(*arrival.place, "o", mfc="none", mec=_MARK, ms=7, mew=1.2)
        level = f"{10 * math.log10(arrival.power / _MILLIWATT):.1f} dBm".replace("-", "−")
        label = axes.annotate(
            f"{arrival.name}\n{level}", arrival.place, (0, 12), textcoords="offset points",
            color=_MARK, fontsize=7, parse_math=False, ha="center", va="center",
        )  # fmt: skip
        labels.append(label)
    return labels


# Pairs of ends in one figure; delays at which impulse responses are drawn, and inverse bandwidths
# before the first path and after the last.
_MOST_PAIRS, _DELAYS, _BEYOND = 6, 2001, 6.0
_HERTZ = ((1e12, "THz"), (1e9, "GHz"), (1e6, "MHz"), (0.0, "Hz"))


@style.typeset
def draw_channel(
    channel: Any, *, floor_db: float = -60.0, title: str = "", figure: Any = None
) -> Any:
    """Channels in dB over frequency, and their impulse responses over delay, a row for each pair.

    The impulse response is the mean of h exp(-2 pi i f t) over evenly spaced frequencies, with a
    Hann window: a single path peaks at its level. Stems are the paths at the centre frequency.

    Parameters
    ----------
    channel : as :func:`polywigner.mitsuba.channel` returns; the first 6 pairs are drawn.
    floor_db : lowest level, dB below the largest of a panel.
    title : above the figure.
    figure : matplotlib Figure or SubFigure to draw on, which is returned; None: a new figure.

    Raises
    ------
    ArgumentError : no channel; a ``figure`` of another type; a floor that is not below 0 dB.
    """
    check_floor(floor_db)
    pairs = _checked_channel(channel)[:_MOST_PAIRS]
    frequencies = channel["frequency"].values
    scale, unit = next(each for each in _HERTZ if frequencies.max() >= each[0])
    drawn = style.figure_on(figure, 9.6, 0.5 + 2.7 * len(pairs), spacing=0.05)
    panels = drawn.subplots(len(pairs), 2, squeeze=False)
    line = "-" if len(frequencies) > 1 else "o"
    for (left, right), pair in zip(panels, pairs, strict=True):
        left.plot(frequencies / (scale or 1.0), _levels(pair.h), line, lw=1.0)
        left.set(xlabel=f"frequency ({unit})", ylabel="|h|², received over sent (dB)")
        left.set_title(pair.title, fontsize=8)
        _draw_response(right, frequencies, pair)
        for axes, values in ((left, pair.h), (right, pair.amplitude)):
            top = float(_levels(np.abs(values).max(initial=0.0)))
            low = float(_levels(values).min()) - _ROOM if axes is left else -math.inf
            style.finish_lines(axes, ylim=(max(low, top + floor_db), top + _ROOM))
    style.write_title(drawn, title)
    return drawn


class _Pair(NamedTuple):
    """The channel of one receiver and one emitter."""

    title: str
    h: NDArray[np.complex128]
    amplitude: NDArray[np.complex128]
    """(n, paths)."""
    delays: Floats
    names: list[str]


def _levels(values: Any) -> Floats:
    """dB of amplitudes, far below any floor for zero."""
    return np.asarray(20 * np.log10(np.maximum(np.abs(values), 1e-150)))


def _draw_response(axes: Axes, frequencies: Floats, pair: _Pair) -> None:
    there = np.isfinite(pair.delays)
    band = float(np.ptp(frequencies))
    steps = np.diff(frequencies)
    if there.any() and len(steps) > 1 and np.ptp(steps) <= 1e-6 * abs(steps[0]):
        beyond = min(_BEYOND / band, 0.5 / steps[0])
        times = np.linspace(
            max(0.0, pair.delays[there].min() - beyond), pair.delays[there].max() + beyond, _DELAYS
        )
        window = np.hanning(len(frequencies) + 2)[1:-1]
        turns = np.outer(times, frequencies)
        response = np.exp(-2j * np.pi * (turns % 1.0)) @ (window * pair.h) / window.sum()
        axes.plot(1e9 * times, _levels(response), lw=1.0, label="impulse response")
    middle = np.abs(pair.amplitude[len(frequencies) // 2])
    for number in np.flatnonzero(there):
        delay, level = 1e9 * pair.delays[number], float(_levels(middle[number]))
        ink = f"C{number + 1}"
        axes.plot(delay, level, "o", ms=4, color=ink, label=pair.names[number] or "direct")
        axes.vlines(delay, level - 1e3, level, color=ink, lw=1.0)
    axes.set(xlabel="delay (ns)", ylabel="level (dB)")
    if there.any():
        axes.legend(frameon=False, fontsize=7, loc="upper right")


def _checked_channel(channel: Any) -> list[_Pair]:
    ends = "receiver emitter"
    names = {"h": f"frequency {ends}", "amplitude": f"frequency {ends} way", "delay": f"{ends} way"}
    names |= {"receiver": "receiver", "emitter": "emitter", "mirrors": "way"}
    h, amplitude, delay, receivers, emitters, mirrors = arrays_of(
        channel, names, "polywigner.mitsuba.channel"
    )
    return [
        _Pair(
            f"{receivers[k]} from {emitters[j]}", h[:, k, j], amplitude[:, k, j], delay[k, j],
            list(map(str, mirrors)),
        )
        for k, j in np.ndindex(delay.shape[:2])
    ]  # fmt: skip
