"""Figures of scenes: radiance, polarisation, and power and channels of receivers."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from polywigner.errors import ArgumentError
from polywigner.figures import style
from polywigner.figures.levels import check_floor, dbm, image_peak, level_db
from polywigner.geometry.arguments import checked_array, checked_count, checked_type
from polywigner.numerics import Floats
from polywigner.transforms.xarray_arguments import arrays_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure, SubFigure
    from matplotlib.text import Annotation


_MARGIN_DB = 5.0  # margin of level axes below the noise and above the peak [dB]
# Degree of linear polarisation below which no angle is drawn, because the angle would be noise.
_LEAST_LINEAR = 0.05
_MARK = "#4dd2ff"  # colour of the marks for direct paths
_LABEL: dict[str, Any] = {
    "textcoords": "offset points", "ha": "center", "va": "center", "fontsize": 7,
    "parse_math": False,
}  # fmt: skip


@style.typeset
def draw_scene(
    radiance: ArrayLike,
    reference: float | None,
    floor_db: float,
    unit: str = "W/(m² sr)",
    title: str = "",
    *,
    ax: Axes | None = None,
) -> Axes | Figure:
    """Draw a rendered image in dB relative to a reference radiance, with a colour bar.

    Parameters
    ----------
    radiance : array_like, shape (height, width)
        Signed radiance.
    reference : float or None
        Radiance of 0 dB, normally :func:`polywigner.figures.image_peak`. If None, the entire
        image is at the floor.
    floor_db : float
        Lowest level in dB. Lower and negative radiance is drawn at the floor.
    unit : str, default "W/(m² sr)"
        Unit of the radiance, for the label.
    title : str, optional
        Title of the image.
    ax : matplotlib.axes.Axes, default new axes
        Axes to draw on, whose figure gets the colour bar.

    Returns
    -------
    matplotlib.axes.Axes or matplotlib.figure.Figure
        The axes, or the new figure if ``ax`` is None.

    Raises
    ------
    ArgumentError
        If ``ax`` has another type.
    """
    image = checked_array(radiance, "radiance", 2)
    height, width = image.shape
    levels = level_db(image, reference, floor_db)
    scale = 5.0 / max(width, height)  # inches per pixel
    axes, drawn = style.axes_on(ax, width * scale + 1.2, max(height * scale, 3.4))
    shown = style.draw_levels(axes, levels, low=floor_db)
    axes.set(xticks=[], yticks=[])
    axes.set_title(title, fontsize=8)
    zero = "nothing positive" if reference is None else style.quantity_text(float(reference), unit)
    label = f"radiance, dB relative to {zero}\n{style.floor_text(floor_db)}"
    style.colour_bar(axes, shown, label, "max" if np.any(levels > 0) else "neither")
    return drawn


_STOKES = ("S₀", "S₁: horizontal − vertical", "S₂: 45° − (−45°)", "S₃: left − right (IEEE)")


@style.typeset
def draw_stokes(stokes: ArrayLike, title: str = "") -> Figure:
    """Draw the four signed Stokes parameters of a rendered image, relative to its peak.

    Parameters
    ----------
    stokes : array_like, shape (4, height, width)
        Result of :func:`polywigner.mitsuba.stokes_of`.
    title : str, optional
        Title of the figure.

    Returns
    -------
    matplotlib.figure.Figure
        The figure.

    Raises
    ------
    ArgumentError
        If the array has another shape.
    """
    numbers, figure, panels = _stokes_panels(stokes, 2, title)
    peak = image_peak(numbers[0])
    for axes, name, values in zip(panels, _STOKES, numbers, strict=True):
        shown = style.draw_signed(axes, values / (peak or 1.0))
        axes.set_title(name, fontsize=8)
    unit = style.quantity_text(peak, "W/(m² sr)") if peak else "nothing"
    style.signed_bar(panels, shown, f"relative to {unit}, the peak of S₀")
    return figure


@style.typeset
def draw_polarisation(stokes: ArrayLike, floor_db: float = -40.0, title: str = "") -> Figure:
    """Draw the degree of polarisation of a rendered image and the angle of its linear part.

    The angle, from -90 to 90 degrees, is measured from the image's right towards its top. Pixels
    are grey if less than 5 % of their radiance is linearly polarised.

    Parameters
    ----------
    stokes : array_like, shape (4, height, width)
        Result of :func:`polywigner.mitsuba.stokes_of`.
    floor_db : float, default -40
        Lowest level of S0 in dB relative to its peak. Darker pixels are grey.
    title : str, optional
        Title of the figure.

    Returns
    -------
    matplotlib.figure.Figure
        The figure.

    Raises
    ------
    ArgumentError
        If the array has another shape, or the floor is not below 0 dB.
    """
    check_floor(floor_db)
    numbers, figure, panels = _stokes_panels(stokes, 1, title)
    peak = image_peak(numbers[0])
    bright = numbers[0] > (peak or math.inf) * 10 ** (floor_db / 10)
    total = np.where(bright, numbers[0], 1.0)
    linear = np.hypot(numbers[1], numbers[2]) / total
    degree = np.minimum(np.hypot(linear, numbers[3] / total), 1.0)
    angle = np.degrees(np.arctan2(numbers[2], numbers[1])) / 2
    degree = np.where(bright, degree, np.nan)
    shown = style.draw_map(panels[0], degree, None, None, cmap="viridis", vmin=0, vmax=1)
    style.colour_bar(panels[0], shown, "degree of polarisation")
    angle = np.where(bright & (linear > _LEAST_LINEAR), angle, np.nan)
    shown = style.draw_map(panels[1], angle, None, None, cmap=style.PHASE_MAP, vmin=-90, vmax=90)
    style.colour_bar(panels[1], shown, "angle from the right upwards, degrees")
    for axes in panels:
        axes.set_facecolor("0.6")
    return figure


def _stokes_panels(
    stokes: ArrayLike, rows: int, title: str
) -> tuple[Floats, Figure, NDArray[np.object_]]:
    """Return the Stokes parameters, a figure with two columns of panels, and the panels (n,)."""
    numbers = checked_array(stokes, "stokes", 3)
    if len(numbers) != 4:
        raise ArgumentError(
            f"expected stokes of shape (4, height, width), got shape {numbers.shape}; pass the "
            "result of polywigner.mitsuba.stokes_of"
        )
    height, width = numbers.shape[1:]
    scale = 4.0 / max(height, width)
    size = 2 * width * scale + 1.6, max(rows * (height * scale + 0.3), 2.6) + 0.4
    figure = style.figure_on(None, *size, title, is_compressed=True)
    panels = figure.subplots(rows, 2).ravel()
    for axes in panels:
        axes.set(xticks=[], yticks=[])
    return numbers, figure, panels


@style.typeset
def draw_range_profile(
    profile: Any,
    receiver: int = 0,
    *,
    floor_db: float = -60.0,
    title: str = "",
    ax: Axes | None = None,
) -> Axes | Figure:
    """Draw the power of each bin in dBm over range in m, with the receiver's noise.

    Circles mark line-of-sight paths and specular paths.

    Parameters
    ----------
    profile : xarray.Dataset
        Result of :func:`polywigner.mitsuba.range_profile`.
    receiver : int, default 0
        Index of the receiver.
    floor_db : float, default -60
        Lowest level in dB relative to the largest bin. The axis extends to 5 dB below the noise if
        this level is lower. Bins below the floor have no line.
    title : str, optional
        Title of the panel.
    ax : matplotlib.axes.Axes, default new axes
        Axes to draw on.

    Returns
    -------
    matplotlib.axes.Axes or matplotlib.figure.Figure
        The axes, or the new figure if ``ax`` is None.

    Raises
    ------
    ArgumentError
        If ``profile`` is not a range profile, the receiver does not exist, ``ax`` has another type,
        or the floor is not below 0 dB.
    """
    check_floor(floor_db)
    if "receiver" in getattr(profile, "dims", ()):
        checked_count(receiver, "receiver", 0, profile.sizes["receiver"] - 1)
        profile = profile.isel(receiver=receiver)
    elif receiver != 0:
        raise ArgumentError(
            f"receiver must be 0 for a profile with a single receiver, got {receiver!r}"
        )
    names = dict.fromkeys(
        ("range_edge", "power", "standard_error", "noise_power", "path_range", "path_power"), ""
    )
    maker = "polywigner.mitsuba.radar.range_profile"
    edges, power, error, noise, lengths, strengths = arrays_of(profile, names, maker)
    peak, has_noise = float(power.max()), float(np.nan_to_num(noise)) > 0
    top = float(dbm(peak)) if peak > 0 else 0.0
    low, noise_level = top + floor_db, float(dbm(noise))
    if has_noise:
        low, top = min(low, noise_level - _MARGIN_DB), max(top, noise_level)
    axes, drawn = style.axes_on(ax, 6.4, 3.6)
    lower, upper = dbm(power - error, low), dbm(power + error, low)
    axes.stairs(upper, edges, baseline=lower, fill=True, color="C0", alpha=0.3, lw=0)
    axes.stairs(dbm(power, low), edges, baseline=None, color="C0", lw=1.0)
    visible = (lengths >= edges[0]) & (lengths <= edges[-1])
    if visible.any():
        label = "line-of-sight or specular path"
        levels = dbm(strengths[visible], low)
        axes.plot(lengths[visible], levels, "o", mfc="none", color="C1", ms=6, label=label)
    if has_noise:
        label = f"noise kTBF, {style.number_text(round(noise_level, 1))} dBm"
        axes.axhline(noise_level, color="C3", ls="--", lw=1.0, label=label)
    width = np.diff(edges)
    bins = f"{style.number_text(float(f'{width.max():.4g}'))} m"
    if width.max() > width.min() * (1 + 1e-6):
        bins = f"up to {bins}"
    style.format_line_axes(
        axes,
        legend=7 if has_noise or visible.any() else 0,
        xlim=(edges[0], edges[-1]),
        ylim=(low, top + _MARGIN_DB),
        xlabel="range, half the length of the path (m)",
        ylabel=f"power of a bin of {bins} (dBm)\n± standard error",
    )
    axes.set_title(title, fontsize=8)
    return drawn


class DirectArrival(NamedTuple):
    """Line-of-sight or specular path for :func:`draw_arrivals`."""

    direction_cosines: tuple[float, float]
    """Direction cosines s_x and s_y of the direction of arrival."""
    power: float
    """Received power in W."""
    name: str
    """Name of the source."""


@style.typeset
def draw_arrivals(
    power: ArrayLike,
    direct: Sequence[DirectArrival] = (),
    floor_db: float = -40.0,
    title: str = "",
    *,
    names: Mapping[str, tuple[float, float]] | None = None,
    ax: Axes | None = None,
) -> Axes | Figure:
    """Draw scattered power in dBm over direction cosines, with marks for direct paths.

    The receiver looks along its +z axis with its +y axis upwards, so its +x axis points to the
    left. The axes show the directions from which power above the floor arrives.

    Parameters
    ----------
    power : array_like, shape (rows, columns)
        Power of each pixel in W. Columns are evenly spaced in s_x, and rows in s_y, from -1 to 1.
    direct : sequence of DirectArrival, default none
        Paths from single directions, which are marked and labelled with their power.
    floor_db : float, default -40
        Lowest level in dB relative to the strongest pixel. Weaker and negative pixels get the
        colour of the floor.
    title : str, optional
        Title of the panel.
    names : mapping of str to (float, float), optional
        Labels, such as names of shapes, with the direction cosines at which they are written.
    ax : matplotlib.axes.Axes, default new axes
        Axes to draw on, whose figure gets the colour bar.

    Returns
    -------
    matplotlib.axes.Axes or matplotlib.figure.Figure
        The axes, or the new figure if ``ax`` is None.

    Raises
    ------
    ArgumentError
        If ``ax`` has another type, or the floor is not below 0 dB.
    """
    from matplotlib.patches import Circle
    from matplotlib.patheffects import withStroke

    values = checked_array(power, "power", 2)
    peak = float(np.max(values, initial=0.0, where=np.isfinite(values))) or None
    levels = level_db(values, peak, floor_db)
    top = 0.0 if peak is None else float(dbm(peak))
    axes, drawn = style.axes_on(ax, 5.2, 4.6)
    shown = style.draw_levels(
        axes, levels + top, low=top + floor_db, high=top,
        origin="lower", extent=(-1, 1, -1, 1), interpolation="nearest",
    )  # fmt: skip
    shown.set_clip_path(Circle((0, 0), 1.0, transform=axes.transData))
    style.draw_circles(axes, above=False)
    labels = _mark_paths(axes, direct)
    for name, cosines in (names or {}).items():
        label = axes.annotate(name, cosines, (0, 0), color="w", annotation_clip=True, **_LABEL)
        label.set_path_effects([withStroke(linewidth=1.5, foreground="k")])
        labels.append(label)
    low, high = _view_limits(levels > floor_db, [arrival.direction_cosines for arrival in direct])
    axes.set(xlim=(high[0], low[0]), ylim=(low[1], high[1]), xlabel=r"$s_x$", ylabel=r"$s_y$")
    axes.set_title(title, fontsize=8)
    rows, columns = values.shape
    floor = style.floor_text(round(top + floor_db, 1), "dBm") if peak else "nothing positive"
    text = f"scattered power per pixel ({columns} × {rows} pixels), dBm\n{floor}"
    style.colour_bar(axes, shown, text)
    style.separate_labels(axes, labels)
    return drawn


# Margin around bright pixels, and smallest half width of the view, in direction cosines.
_MARGIN, _LEAST_HALF = 0.05, 0.1


def _view_limits(
    bright: NDArray[np.bool_], directions: Sequence[tuple[float, float]]
) -> tuple[Floats, Floats]:
    """Return the lower and the upper corner of a square around bright pixels and directions."""
    points = np.asarray(directions, np.float64).reshape(-1, 2)
    if bright.any():
        pixels = np.argwhere(bright)[:, ::-1]
        ends = np.array([pixels.min(axis=0), pixels.max(axis=0) + 1])
        points = np.concatenate([points, ends * 2 / bright.shape[::-1] - 1])
    if not len(points):
        return np.full(2, -1.02), np.full(2, 1.02)
    low, high = points.min(axis=0), points.max(axis=0)
    half = min(max(float((high - low).max()) / 2 + _MARGIN, _LEAST_HALF), 1.02)
    centre = np.clip((low + high) / 2, half - 1.02, 1.02 - half)
    return centre - half, centre + half


def _mark_paths(axes: Any, direct: Sequence[DirectArrival]) -> list[Annotation]:
    """Draw a circle and a label for each path, and return the labels."""
    labels = []
    expected = "direct to be a sequence of DirectArrival objects"
    for arrival in checked_type(direct, expected, Sequence):
        checked_type(arrival, expected, DirectArrival)
        axes.plot(*arrival.direction_cosines, "o", mfc="none", mec=_MARK, ms=7, mew=1.2)
        level = f"{dbm(arrival.power):.1f} dBm".replace("-", "−")
        text, position = f"{arrival.name}\n{level}", arrival.direction_cosines
        labels.append(axes.annotate(text, position, (0, 12), color=_MARK, **_LABEL))
    return labels


_MOST_PAIRS = 6  # largest number of emitter-receiver pairs in a figure
_DELAYS = 2001  # number of samples of an impulse response
_BEYOND = 6.0  # extent of a response before the first and after the last path [1/bandwidth]
_HERTZ = ((1e12, "THz"), (1e9, "GHz"), (1e6, "MHz"), (1.0, "Hz"))


@style.typeset
def draw_channel(
    channel: Any,
    *,
    floor_db: float = -60.0,
    title: str = "",
    figure: Figure | SubFigure | None = None,
) -> Figure:
    """Draw channels over frequency and their impulse responses over delay.

    Each pair of emitter and receiver has a row; the first six pairs are drawn. The impulse response
    is the mean of h exp(-2 pi i f t) over evenly spaced frequencies with a Hann window, so the
    response of a single path peaks at the level of the path. Stems mark the paths at the centre
    frequency.

    Parameters
    ----------
    channel : xarray.Dataset
        Result of :func:`polywigner.mitsuba.channel`.
    floor_db : float, default -60
        Lowest level in dB relative to the peak of a panel.
    title : str, optional
        Title of the figure.
    figure : matplotlib.figure.Figure or SubFigure, default a new figure
        Figure to draw on.

    Returns
    -------
    matplotlib.figure.Figure
        The figure.

    Raises
    ------
    ArgumentError
        If ``channel`` is not a channel, the floor is not below 0 dB, or ``figure`` has another
        type.
    """
    check_floor(floor_db)
    ends = "receiver emitter"
    names = {
        "h": f"frequency {ends}",
        "amplitude": f"frequency {ends} path",
        "delay": f"{ends} path",
    }
    names |= {"frequency": "frequency", "receiver": "receiver", "emitter": "emitter"}
    h, amplitude, delay, frequencies, receivers, emitters, mirrors = arrays_of(
        channel, names | {"mirrors": "path"}, "polywigner.mitsuba.channel"
    )
    pairs = list(np.ndindex(delay.shape[:2]))[:_MOST_PAIRS]
    scale, unit = next(pair for pair in _HERTZ if frequencies.max() >= pair[0] or pair[0] == 1.0)
    drawn = style.figure_on(figure, 9.6, 0.5 + 2.7 * len(pairs), title, spacing=0.05)
    panels = drawn.subplots(len(pairs), 2, squeeze=False)
    line = "-" if len(frequencies) > 1 else "o"
    for (left, right), (k, j) in zip(panels, pairs, strict=True):
        response, paths = h[:, k, j], amplitude[:, k, j]
        left.plot(frequencies / scale, _decibels(response), line, lw=1.0)
        left.set(xlabel=f"frequency ({unit})", ylabel="|h|², received over sent (dB)")
        left.set_title(f"{receivers[k]} from {emitters[j]}", fontsize=8)
        _draw_response(right, frequencies, response, paths[len(frequencies) // 2], delay[k, j],
                       [str(name) or "direct" for name in mirrors])  # fmt: skip
        for axes, values in ((left, response), (right, paths)):
            top = float(_decibels(np.abs(values).max(initial=0.0)))
            low = float(_decibels(values).min()) - _MARGIN_DB if axes is left else -math.inf
            style.format_line_axes(axes, ylim=(max(low, top + floor_db), top + _MARGIN_DB))
    return drawn


def _decibels(amplitudes: Any) -> Floats:
    """Convert amplitudes to dB; zero becomes -3000 dB, below any floor."""
    return np.asarray(20 * np.log10(np.maximum(np.abs(amplitudes), 1e-150)))


def _draw_response(
    axes: Axes, frequencies: Floats, h: Any, amplitudes: Any, delays: Floats, names: list[str]
) -> None:
    """Draw the impulse response of a channel in dB over the delay, and mark its paths.

    ``frequencies`` are in Hz. ``delays`` are in s, and NaN for paths that do not exist.
    """
    exists = np.isfinite(delays)
    steps = np.diff(frequencies)
    axes.set(xlabel="delay (ns)", ylabel="level (dB)")
    if not exists.any():
        return
    if len(steps) > 1 and np.ptp(steps) <= 1e-6 * abs(steps[0]):
        beyond = min(_BEYOND / float(np.ptp(frequencies)), 0.5 / steps[0])
        first, last = delays[exists].min() - beyond, delays[exists].max() + beyond
        times = np.linspace(max(0.0, first), last, _DELAYS)
        window = np.hanning(len(frequencies) + 2)[1:-1]
        cycles = np.outer(times, frequencies) % 1.0
        response = np.exp(-2j * np.pi * cycles) @ (window * h) / window.sum()
        axes.plot(1e9 * times, _decibels(response), lw=1.0, label="impulse response")
    for number in np.flatnonzero(exists):
        delay, level, ink = 1e9 * delays[number], _decibels(amplitudes[number]), f"C{number + 1}"
        axes.plot(delay, level, "o", ms=4, color=ink, label=names[number])
        axes.vlines(delay, level - 1e3, level, color=ink, lw=1.0)
    axes.legend(frameon=False, fontsize=7, loc="upper right")


_MAP_LABELS = {
    "range": "range (m)",
    "range_rate": "range rate (m/s)",
    "direction_cosine": "direction cosine",
}


@style.typeset
def draw_radar_map(
    image: Any, *, floor_db: float = -60.0, title: str = "", ax: Axes | None = None
) -> Axes | Figure:
    """Draw a map of power in dBm over range and range rate, or range and direction cosine.

    Parameters
    ----------
    image : xarray.DataArray
        Result of :func:`polywigner.radar.range_doppler` or :func:`polywigner.radar.range_angle`.
        Power is averaged over draws, receivers and emitters.
    floor_db : float, default -60
        Lowest level in dB relative to the largest value.
    title : str, optional
        Title of the panel.
    ax : matplotlib.axes.Axes, optional
        Axes to draw on. Default: new axes.

    Returns
    -------
    matplotlib.axes.Axes or matplotlib.figure.Figure
        The axes, or the new figure if ``ax`` is None.

    Raises
    ------
    ArgumentError
        If ``image`` is not a radar map, or the floor is not below 0 dB.
    """
    check_floor(floor_db)
    dims = tuple(getattr(image, "dims", ()))
    if len(dims) < 2 or dims[-1] != "range" or dims[-2] not in _MAP_LABELS:
        raise ArgumentError(
            "expected a map returned by polywigner.radar.range_doppler or range_angle, got "
            f"{type(image).__name__}"
        )
    power = image.mean(dims[:-2]) if len(dims) > 2 else image
    peak = float(dbm(power.values).max())
    axes, drawn = style.axes_on(ax, 6.4, 4.2)
    noise = float(np.mean(image.attrs["noise_floor"]))
    label = f"received power (dBm), {style.floor_text(floor_db)}"
    if noise > 0:
        label += f"; noise {style.number_text(round(float(dbm(noise)), 1))} dBm"
    style.draw_levels(
        axes, dbm(power.values), power["range"].values, power[dims[-2]].values,
        low=peak + floor_db, high=peak, label=label, aspect="auto",
    )  # fmt: skip
    axes.set(xlabel=_MAP_LABELS["range"], ylabel=_MAP_LABELS[dims[-2]], title=title)
    return drawn
