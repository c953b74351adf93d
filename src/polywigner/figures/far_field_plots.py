"""Figures of far fields: radiation patterns, tolerances of arrays, and radar cross sections."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence
from dataclasses import replace
from types import NoneType
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np

from polywigner.errors import ArgumentError
from polywigner.figures import style
from polywigner.figures.levels import check_floor
from polywigner.geometry.arguments import checked_choice, checked_length, checked_type
from polywigner.numerics import Floats
from polywigner.propagation.beams import BeamMetrics, beam_metrics, cut_metrics
from polywigner.propagation.patterns import (
    Cut,
    angle_between,
    checked_pattern,
    circles_through_beam,
    cuts_in,
    cuts_of,
    front_of,
)
from polywigner.transforms.xarray_arguments import arrays_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure, SubFigure


PatternPanel = Literal["cuts", "polar", "uv", "table"]
PatternCuts = Literal["beam", "principal"]

_COLOURS = (style.BLUE, style.RED, style.GREEN, style.ORANGE)
_DASHES = ("-", "--", "-.", ":")
_PANELS: dict[str, tuple[float, float]] = {
    "cuts": (4.6, 3.4), "polar": (3.6, 3.4), "uv": (3.8, 3.4), "table": (5.0, 3.4),
}  # fmt: skip
_LEAST_MERIDIANS = 8  # smallest number of phi angles for a map over u and v
_MOST_CUTS = 4  # largest number of cuts in a tolerance analysis


@style.typeset
def draw_pattern(
    pattern: Any,
    *,
    panels: Sequence[PatternPanel] | None = None,
    cuts: PatternCuts | Sequence[Any] | None = None,
    metrics: BeamMetrics | None = None,
    floor_db: float = -40.0,
    title: str = "",
    figure: Figure | SubFigure | None = None,
) -> Figure:
    """Draw the directivity of a pattern: cuts, a polar plot, a map over u and v, and a table.

    Parameters
    ----------
    pattern : xarray.Dataset
        Result of :func:`polywigner.radiation_pattern`.
    panels : sequence of {"cuts", "polar", "uv", "table"}, optional
        Panels to draw; "uv" is a map over direction cosines and requires at least eight phi angles.
        The default is all panels for which the pattern has enough angles.
    cuts : {"beam", "principal"} or sequence of xarray.Dataset, optional
        "beam": two orthogonal great circles through the beam, over the angle from the beam, as in
        :func:`polywigner.beam_cuts`. "principal": the meridians nearest to the x and the y axis. A
        sequence contains results of :func:`polywigner.beam_cuts`, or patterns whose meridians are
        drawn. The default is "beam" if the pattern has phi angles around the full circle, otherwise
        "principal".
    metrics : BeamMetrics, optional
        Metrics in the table, by default the result of :func:`polywigner.beam_metrics`. The table
        also contains the metrics of the cuts in the figure.
    floor_db : float, default -40
        Lowest level in dB relative to the largest directivity.
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
        If ``pattern`` is not a radiation pattern, a panel is unknown, there are too few angles, or
        ``figure`` has another type.
    """
    check_floor(floor_db)
    checked_type(metrics, "metrics to be the result of beam_metrics", BeamMetrics, NoneType)
    theta, phi, levels, _ = checked_pattern(pattern)
    chosen = _panel_names(panels, len(phi))
    lines, beam = _drawn_cuts(pattern, cuts, metrics)
    theta, levels = front_of(theta, levels)
    low, high = beam.directivity + floor_db, beam.directivity
    label = f"directivity (dBi), {style.floor_text(round(low, 1), 'dBi')}"
    columns = 3 if len(chosen) == 3 else min(2, len(chosen))
    rows = -(-len(chosen) // columns)
    width = sum(max(_PANELS[name][0] for name in chosen[k::columns]) for k in range(columns))
    figure = style.figure_on(figure, width, 3.4 * rows + 0.3, title, spacing=0.05)
    draw: dict[str, Callable[[Any], object]] = {
        "cuts": lambda axes: _draw_cuts(axes, beam, lines, low, high),
        "polar": lambda axes: _draw_polar(axes, lines, low, high),
        "uv": lambda axes: style.draw_disc(
            axes, theta, phi, np.maximum(levels, low), low, high, label, "uv"
        ),
        "table": lambda axes: _write_table(axes, beam),
    }
    for number, name in enumerate(chosen, start=1):
        projection = "polar" if name == "polar" else None
        draw[name](figure.add_subplot(rows, columns, number, projection=projection))
    return figure


def _panel_names(panels: Sequence[str] | None, meridians: int) -> list[str]:
    """Return the names of the panels to draw, without repetitions."""
    if panels is None:
        return [name for name in _PANELS if name != "uv" or meridians >= _LEAST_MERIDIANS]
    if isinstance(panels, str) or not isinstance(panels, Sequence):
        panels = [panels]
    names = [checked_choice(panel, "panels", get_args(PatternPanel)) for panel in panels]
    if "uv" in names and meridians < _LEAST_MERIDIANS:
        raise ArgumentError(
            f"the panel 'uv' requires at least {_LEAST_MERIDIANS} phi angles, got {meridians}; "
            "pass more phi angles to radiation_pattern, or omit this panel"
        )
    return list(dict.fromkeys(names))


def _drawn_cuts(
    pattern: Any, cuts: Any, metrics: BeamMetrics | None
) -> tuple[list[Cut], BeamMetrics]:
    """Return the cuts to draw, and the metrics of the beam in these cuts."""
    if not (cuts is None or isinstance(cuts, str)):
        if not isinstance(cuts, Sequence) or not cuts:
            raise ArgumentError(
                'expected cuts to be "beam", "principal", or a list of patterns or results of '
                f"beam_cuts, got {type(cuts).__name__}"
            )
        lines = [line for part in cuts for line in cuts_in(part)]
        if len({line.kind == "theta" for line in lines}) > 1:
            raise ArgumentError(
                "cuts must be either great circles from beam_cuts or meridians of patterns, got "
                "both; draw them in separate figures"
            )
        return lines, _with_drawn_cuts(beam_metrics(cuts[0]) if metrics is None else metrics, lines)
    if cuts is not None:
        checked_choice(cuts, "cuts", get_args(PatternCuts))
    beam = beam_metrics(pattern) if metrics is None else metrics
    circles = [] if cuts == "principal" else circles_through_beam(pattern)
    if circles:
        return circles, _with_drawn_cuts(beam, circles)
    if cuts == "beam":
        raise ArgumentError(
            "cuts through the beam require a pattern over phi around the full circle, got "
            f"{pattern.sizes['phi']} phi angles; pass cuts=[polywigner.beam_cuts(...)]"
        )
    meridians = cuts_in(pattern)
    first, second = (
        min(meridians, key=lambda cut: angle_between(cut.phi, angle)) for angle in (0, math.pi / 2)
    )
    lines = [first] if first is second else [first, second]
    return lines, _with_drawn_cuts(beam, lines)


def _with_drawn_cuts(metrics: BeamMetrics, lines: Sequence[Cut]) -> BeamMetrics:
    """Return the metrics of a beam with the metrics of the drawn cuts."""
    highest = max(float(line.levels.max()) for line in lines)
    cuts = tuple(cut_metrics(line, highest) for line in lines)
    return replace(metrics, cuts=cuts, beam_cuts=() if lines[0].kind == "theta" else cuts)


def _cut_name(cut: Cut) -> str:
    """Return the label of a cut for the legend."""
    return "across it" if cut.kind == "across" else f"$\\phi$ = {style.degrees_text(cut.phi)}"


def _draw_cuts(
    axes: Axes, metrics: BeamMetrics, cuts: Sequence[Cut], low: float, high: float
) -> None:
    """Draw the directivity along cuts in dBi over the angle in degrees."""
    from matplotlib.ticker import MultipleLocator

    for number, cut in enumerate(cuts):
        _plot_levels(
            axes, number, np.degrees(cut.angles), cut.levels, low - 100, label=_cut_name(cut)
        )
    for number, cut in enumerate(cuts):
        if cut.cross_levels is not None and cut.cross_levels.max() > low:
            angles = np.degrees(cut.angles)
            label = "its cross-polar part" if len(cuts) > 1 else "cross-polar part"
            _plot_levels(axes, number, angles, cut.cross_levels, low - 100, label=label, ls=":")
    reach = _largest_angle(cuts)
    axes.axhline(high - 10 * math.log10(2), color="0.6", lw=0.6, ls=":")
    entries = len(axes.get_legend_handles_labels()[0])
    axes.xaxis.set_major_locator(MultipleLocator(30 if reach > 45 else 10))
    angle = "the normal $\\theta$" if cuts[0].kind == "theta" else "the beam"
    style.format_line_axes(
        axes,
        xlim=(-reach, reach),
        ylim=(low, high + (0.05 + 0.08 * -(-entries // 2)) * (high - low)),
        xlabel=f"angle from {angle} (degrees)",
        ylabel="directivity (dBi)",
    )
    if cuts[0].kind == "theta":
        is_principal = all(abs(math.remainder(cut.phi, math.pi / 2)) < 1e-4 for cut in cuts)
        heading = "principal planes" if is_principal else "cuts along meridians"
    else:
        theta, phi = (style.degrees_text(angle) for angle in (metrics.theta, metrics.phi))
        heading = f"great circles through the beam at $\\theta$ = {theta}, $\\phi$ = {phi}"
    heading += f"\ndotted: half the peak; {style.floor_text(low - high)}"
    axes.set_title(heading, fontsize=8)
    axes.legend(frameon=False, fontsize=7, ncols=2, loc="upper center")


def _plot_levels(
    axes: Axes, number: int, angles: Floats, levels: Floats, low: float, **line: Any
) -> None:
    """Draw the levels of cut ``number``, clipped at ``low``, over angles in the axes' unit."""
    default: dict[str, Any] = {"color": _COLOURS[number % 4], "ls": _DASHES[number % 4], "lw": 1.2}
    axes.plot(angles, np.maximum(levels, low), **(default | line))


def _largest_angle(cuts: Sequence[Cut]) -> float:
    """Return the largest absolute angle of the cuts in degrees."""
    return max(float(np.degrees(np.abs(cut.angles).max())) for cut in cuts)


def _draw_polar(axes: Any, cuts: Sequence[Cut], low: float, high: float) -> None:
    """Draw the directivity along cuts in dBi in polar axes."""
    for number, cut in enumerate(cuts):
        _plot_levels(axes, number, cut.angles, cut.levels, low)
    edge = min(180, max(90, 30 * math.ceil(_largest_angle(cuts) / 30 - 1e-9)))
    step = 10.0 if high - low > 25 else 5.0
    axes.set(
        theta_zero_location="N", theta_direction=-1, thetamin=-edge, thetamax=edge,
        ylim=(low, math.ceil(high)),
        yticks=np.arange(math.ceil(low / step) * step, high + 1e-9, step),
        xticks=np.radians(np.arange(-edge + (edge == 180) * 30, edge + 1, 30)),
    )  # fmt: skip
    axes.tick_params(labelsize=7)
    axes.grid(alpha=0.4, lw=0.5)
    over = "$\\theta$" if cuts[0].kind == "theta" else "the angle from the beam"
    planes = ", ".join(_cut_name(cut) for cut in cuts)
    axes.set_title(f"directivity (dBi) over {over}, {planes}", fontsize=8)


def _write_table(axes: Axes, metrics: BeamMetrics) -> None:
    """Write the metrics of a beam as a table."""
    axes.axis("off")
    text = re.sub(r"-(?=\d|inf)", "\N{MINUS SIGN}", str(metrics).replace("^2", "²"))
    axes.text(
        0.0, 0.95, text, family="DejaVu Sans Mono", fontsize=7, va="top", linespacing=1.5,
        transform=axes.transAxes,
    )  # fmt: skip


@style.typeset
def draw_tolerance(
    tolerance: Any,
    *,
    floor_db: float = -50.0,
    title: str = "",
    figure: Figure | SubFigure | None = None,
) -> Figure:
    """Draw the mean pattern of an array with errors over theta, and its 5 to 95 % band.

    Parameters
    ----------
    tolerance : xarray.Dataset
        Result of :func:`polywigner.array_tolerance` with one to four cuts. Opposite meridians are
        joined into one cut.
    floor_db : float, default -50
        Lowest level in dB relative to the largest directivity without errors.
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
        If ``tolerance`` is not a result of array_tolerance, there are too many cuts or fewer than
        two theta angles, or ``figure`` has another type.
    """
    check_floor(floor_db)
    axes_of = {"theta": "theta", "phi": "phi"}
    axes_of |= dict.fromkeys(("nominal", "expected", "low", "high"), "theta phi")
    theta, phi, *levels = arrays_of(tolerance, axes_of, "polywigner.array_tolerance")
    fronts = (front_of(theta, part) for part in levels)
    cuts = list(zip(*(cuts_of(angles, phi, part) for angles, part in fronts), strict=True))
    if len(theta) < 2 or not 1 <= len(cuts) <= _MOST_CUTS:
        raise ArgumentError(
            f"expected one to {_MOST_CUTS} cuts with at least two theta angles, got {len(cuts)} "
            f"cuts with {len(theta)} theta angles; change the angles of array_tolerance"
        )
    high = float(levels[0].max())
    drawn = style.figure_on(figure, 5.4 * len(cuts), 3.9, title, spacing=0.05)
    for axes, parts in zip(drawn.subplots(1, len(cuts), squeeze=False)[0], cuts, strict=True):
        azimuth, degrees = parts[0][0], np.degrees(parts[0][1])
        nominal, mean, lower, upper = (levels for _, _, levels in parts)
        axes.fill_between(
            degrees, lower, upper, color=style.ORANGE, alpha=0.4, lw=0,
            label=f"5 to 95 % of {tolerance.attrs.get('count', '')} samples",
        )  # fmt: skip
        axes.plot(degrees, mean, color=style.RED, lw=1.2, ls="--", label="mean, closed form")
        axes.plot(degrees, nominal, color=style.BLUE, lw=0.9, label="without errors")
        style.format_line_axes(
            axes, legend=8,
            xlim=(degrees.min(), degrees.max()), ylim=(high + floor_db, high + 3),
            xlabel="angle from the normal $\\theta$ (degrees)", ylabel="directivity (dBi)",
        )  # fmt: skip
        heading = f"$\\phi$ = {style.degrees_text(azimuth)}; {style.floor_text(floor_db)}"
        axes.set_title(heading, fontsize=8)
    return drawn


@style.typeset
def draw_rcs(
    pattern: Any,
    *,
    cuts: Sequence[Any] | None = None,
    smooth: float | None = None,
    floor_db: float = -60.0,
    title: str = "",
    figure: Figure | SubFigure | None = None,
) -> Figure:
    """Draw radar cross sections in dBsm: cuts over azimuth and elevation, and a map.

    Parameters
    ----------
    pattern : xarray.Dataset
        Result of :func:`polywigner.rcs_pattern` with at least two azimuths and two elevations.
    cuts : sequence of two xarray.Dataset, optional
        Patterns in finer steps for the two cuts: one of a single elevation, and one of two opposite
        azimuths. The default is the cuts of ``pattern`` nearest to the planes z = 0 and y = 0.
    smooth : float, default no median
        Width in rad of a running median, which is drawn in addition to the cuts.
    floor_db : float, default -60
        Lowest level in dB relative to the largest cross section.
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
        If ``pattern`` is not a result of rcs_pattern, there are too few angles, all cross sections
        are zero, or ``figure`` has another type.
    """
    check_floor(floor_db)
    if smooth is not None:
        smooth = checked_length(smooth, "smooth", meaning="an angle in rad above zero")
        smooth = min(smooth, 2 * math.pi)
    azimuth, elevation, levels = _checked_rcs(pattern)
    shown_cuts = _rcs_cuts((azimuth, elevation, levels), cuts)
    parts = [part[np.isfinite(part)] for part in (levels, *(cut for _, _, cut in shown_cuts))]
    high = max(float(part.max(initial=-math.inf)) for part in parts)
    if high == -math.inf:
        raise ArgumentError(
            "the cross sections are zero at all angles, so there is nothing to draw in dB"
        )
    low = high + floor_db
    drawn = style.figure_on(figure, 11.6, 3.9, title, spacing=0.05)
    for number, (name, angles, cut) in enumerate(shown_cuts, start=1):
        polar = drawn.add_subplot(1, 3, number, projection="polar")
        _draw_rcs_cut(polar, angles, np.maximum(cut, low), smooth)
        polar.set_ylim(low, high)
        polar.set_title(name, fontsize=8)
    axes = drawn.add_subplot(1, 3, 3)
    label = f"RCS (dBsm), {style.floor_text(round(low, 1), 'dBsm')}"
    style.draw_levels(
        axes, np.maximum(levels, low).T, np.degrees(azimuth), np.degrees(elevation), low=low,
        high=high, label=label, shading="nearest",
    )  # fmt: skip
    axes.set(xlabel="azimuth (degrees)", ylabel="elevation (degrees)")
    return drawn


def _draw_rcs_cut(polar: Any, angles: Floats, levels: Floats, smooth: float | None) -> None:
    """Draw levels in dBsm in polar axes; ``smooth`` is the width of a median in rad."""
    fine = smooth is not None or len(angles) > 1000
    polar.plot(
        angles, levels, color=style.BLUE, lw=0.5 if fine else 1.2, alpha=0.5 if smooth else 1.0
    )
    if smooth is not None:
        polar.plot(angles, _running_median(angles, levels, smooth), color=style.RED, lw=1.2)
        text = f"running median over {style.degrees_text(smooth)}"
        polar.set_xlabel(text, fontsize=7, color=style.RED)
    polar.tick_params(labelsize=7)
    polar.grid(alpha=0.4, lw=0.5)
    polar.set_rlabel_position(_label_angle(angles, levels))
    for label in polar.get_yticklabels():
        label.set_bbox({"facecolor": "w", "edgecolor": "none", "alpha": 0.7, "pad": 0.5})


def _label_angle(angles: Floats, levels: Floats) -> float:
    """Return the angle in degrees, midway between two angle labels, near which a cut is lowest.

    ``angles`` are in rad.
    """
    candidates = np.radians(np.arange(22.5, 360.0, 45.0))
    distance = np.abs(np.angle(np.exp(1j * (angles - candidates[:, None]))))
    near = np.where(distance < math.radians(10.0), levels, -np.inf).max(axis=1)
    return float(np.degrees(candidates[near.argmin()]))


def _running_median(angles: Floats, levels: Floats, width: float) -> Floats:
    """Return the running median of levels at evenly spaced angles; angles and width are in rad.

    The windows are shorter at both ends.
    """
    import xarray

    half = min(int(width / (2 * abs(angles[1] - angles[0]))), (len(levels) - 1) // 2)
    windows = xarray.DataArray(levels, dims="angle").rolling(
        angle=2 * half + 1, center=True, min_periods=1
    )
    return np.asarray(windows.median())


def _checked_rcs(pattern: Any, least: tuple[int, int] = (2, 2)) -> tuple[Floats, Floats, Floats]:
    """Return azimuths (n,) and elevations (m,) in rad, and levels (n, m) in dBsm.

    ``least``: smallest allowed numbers of azimuths and of elevations.
    """
    names = dict.fromkeys(("azimuth", "elevation", "rcs"), "")
    azimuth, elevation, values = arrays_of(pattern, names, "polywigner.rcs_pattern")
    if values.ndim != 2 or values.shape[0] < least[0] or values.shape[1] < least[1]:
        raise ArgumentError(
            f"expected a pattern with at least {least[0]} azimuths and {least[1]} elevations, got "
            f"shape {values.shape}"
        )
    with np.errstate(divide="ignore"):
        return azimuth, elevation, 10 * np.log10(values)


def _rcs_cuts(
    pattern: tuple[Floats, Floats, Floats], cuts: Sequence[Any] | None
) -> list[tuple[str, Floats, Floats]]:
    """Return the title, angles and levels of each cut, first over azimuth, then over elevation.

    Angles are in rad, and levels in dBsm. The second cut continues over the zenith to the azimuth
    behind.
    """
    if cuts is None:
        flat = upright = pattern
        nearest = int(np.abs(pattern[1]).argmin())
        distance = np.abs(np.exp(1j * pattern[0])[:, None] - np.array([1.0, -1.0]))
        front, back = distance.argmin(axis=0).tolist()
    elif isinstance(cuts, Sequence) and len(cuts) == 2:
        flat, upright = _checked_rcs(cuts[0], (2, 1)), _checked_rcs(cuts[1])
        nearest, front, back = 0, 0, 1
    else:
        raise ArgumentError(
            "expected cuts to be a list of two patterns, the first over azimuth and the second "
            f"over elevation, got {type(cuts).__name__}"
        )
    azimuth, elevation, levels = upright
    around = np.concatenate([elevation, math.pi - elevation[::-1]])
    over_elevation = np.concatenate([levels[front], levels[back][::-1]])
    vertical = f"over elevation, at azimuth {style.degrees_text(azimuth[front])} and behind"
    horizontal = f"over azimuth, at elevation {style.degrees_text(flat[1][nearest])}"
    return [(horizontal, flat[0], flat[2][:, nearest]), (vertical, around, over_elevation)]
