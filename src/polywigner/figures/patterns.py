"""Far fields as data sheets show them: radiation patterns, and radar cross sections over angles."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from polywigner.errors import ArgumentError
from polywigner.figures.levels import check_floor
from polywigner.figures.style import (
    BLUE,
    GREEN,
    ORANGE,
    RED,
    TYPOGRAPHY,
    colour_bar,
    draw_disc,
    draw_levels,
    figure_on,
    floor_text,
    number_text,
    write_title,
)
from polywigner.geometry.arguments import checked_choice
from polywigner.propagation.beams import BeamMetrics, beam_metrics
from polywigner.propagation.patterns import checked_pattern, cuts_of, front_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure, SubFigure


Floats = NDArray[np.float64]
Cut = tuple[str, Floats, Floats]
"""Label, theta in rad, directivity in dBi."""

PatternPanel = Literal["cuts", "polar", "uv", "table"]

_COLOURS = (BLUE, RED, GREEN, ORANGE)
_DASHES = ("-", "--", "-.", ":")
_PANELS: dict[str, tuple[float, float]] = {
    "cuts": (4.6, 3.4), "polar": (3.6, 3.4), "uv": (3.8, 3.4), "table": (4.4, 3.4),
}  # fmt: skip
# A map needs meridians; a few are cuts.
_LEAST_MERIDIANS = 8


def draw_pattern(
    pattern: Any,
    *,
    panels: Sequence[PatternPanel] | None = None,
    metrics: BeamMetrics | None = None,
    floor_db: float = -40.0,
    title: str = "",
    figure: Figure | SubFigure | None = None,
) -> Any:
    """The directivity of a pattern: cuts over theta, in polar coordinates, over u-v, and a table.

    Parameters
    ----------
    pattern : xarray.Dataset or the like, as :func:`polywigner.radiation_pattern` returns.
    panels : of "cuts", "polar", "uv" (direction cosines; needs eight angles phi or more) and
        "table"; None: all that the pattern has enough angles for.
    metrics : the numbers of the table; None: those of :func:`polywigner.beam_metrics`.
    floor_db : lowest level, dB below the largest directivity.
    title : above all panels.
    figure : matplotlib Figure or SubFigure to draw on; None: a new figure.

    Returns
    -------
    The figure or subfigure.

    Raises
    ------
    ArgumentError : no pattern, an unknown panel, too few angles; what is no figure.
    """
    import matplotlib as mpl

    check_floor(floor_db)
    if metrics is not None and not isinstance(metrics, BeamMetrics):
        raise ArgumentError(f"expected metrics of beam_metrics, got {type(metrics).__name__}")
    theta, phi, levels, _ = checked_pattern(pattern)
    found = beam_metrics(pattern) if metrics is None else metrics
    theta, levels = front_of(theta, levels)
    chosen = _chosen(panels, len(phi))
    cuts = _principal(theta, phi, levels, found)
    low, high = found.directivity + floor_db, found.directivity
    with mpl.rc_context(TYPOGRAPHY):
        columns = 3 if len(chosen) == 3 else min(2, len(chosen))
        rows = -(-len(chosen) // columns)
        width = sum(max(_PANELS[name][0] for name in chosen[k::columns]) for k in range(columns))
        figure = figure_on(figure, width, 3.4 * rows + 0.3, spacing=0.05)
        for place, name in enumerate(chosen, start=1):
            projection = "polar" if name == "polar" else None
            axes = figure.add_subplot(rows, columns, place, projection=projection)
            if name == "cuts":
                _draw_cuts(axes, cuts, low, high)
            elif name == "polar":
                _draw_polar(axes, cuts, low, high)
            elif name == "uv":
                _draw_map(axes, theta, phi, levels, low, high)
            else:
                _write_table(axes, found)
        write_title(figure, title)
    return figure


def _chosen(panels: Sequence[str] | None, meridians: int) -> list[str]:
    if panels is None:
        return [name for name in _PANELS if name != "uv" or meridians >= _LEAST_MERIDIANS]
    if isinstance(panels, str) or not isinstance(panels, Sequence):
        panels = [panels]
    names = [checked_choice(panel, "panels", get_args(PatternPanel)) for panel in panels]
    for name in names:
        if name not in get_args(PatternPanel):
            raise ArgumentError(
                f"expected panels of {', '.join(get_args(PatternPanel))}, got {name!r}"
            )
    if not names:
        raise ArgumentError("expected one panel or more, got none")
    if "uv" in names and meridians < _LEAST_MERIDIANS:
        raise ArgumentError(
            f"expected {_LEAST_MERIDIANS} angles phi or more for a u-v map, got {meridians}; give "
            "radiation_pattern more, or leave the map out"
        )
    return list(dict.fromkeys(names))


def _principal(theta: Floats, phi: Floats, levels: Floats, metrics: BeamMetrics) -> list[Cut]:
    """The cuts that the table names."""
    wanted = [cut.phi for cut in metrics.principal_cuts]
    return [
        (f"$\\phi$ = {number_text(round(math.degrees(angle), 2))}°", places, values)
        for angle, places, values in cuts_of(theta, phi, levels)
        if angle in wanted
    ]


def _draw_cuts(axes: Axes, cuts: Sequence[Cut], low: float, high: float) -> None:
    from matplotlib.ticker import MultipleLocator

    reach = 0.0
    for number, (label, theta, levels) in enumerate(cuts):
        style: dict[str, Any] = {"color": _COLOURS[number], "ls": _DASHES[number], "lw": 1.2}
        axes.plot(np.degrees(theta), np.maximum(levels, low - 100), label=label, **style)
        reach = max(reach, min(90.0, float(np.degrees(np.abs(theta).max()))))
    axes.axhline(high - 10 * math.log10(2), color="0.6", lw=0.6, ls=":")
    axes.set_xlim(-reach, reach)
    axes.set_ylim(low, high + 0.05 * (high - low))
    axes.xaxis.set_major_locator(MultipleLocator(30 if reach > 45 else 10))
    axes.set_xlabel("angle from the normal $\\theta$ (degrees)")
    axes.set_ylabel("directivity (dBi)")
    axes.set_title(f"dotted: half the peak; {floor_text(low - high)}", fontsize=8)
    axes.grid(alpha=0.3, lw=0.5)
    axes.legend(frameon=False, fontsize=8)


def _draw_polar(axes: Any, cuts: Sequence[Cut], low: float, high: float) -> None:
    for number, (label, theta, levels) in enumerate(cuts):
        style: dict[str, Any] = {"color": _COLOURS[number], "ls": _DASHES[number], "lw": 1.2}
        axes.plot(theta, np.maximum(levels, low), label=label, **style)
    axes.set_theta_zero_location("N")
    axes.set_theta_direction(-1)
    axes.set_thetamin(-90)
    axes.set_thetamax(90)
    axes.set_ylim(low, math.ceil(high))
    step = 10.0 if high - low > 25 else 5.0
    axes.set_yticks(np.arange(math.ceil(low / step) * step, high + 1e-9, step))
    axes.set_xticks(np.radians(np.arange(-90, 91, 30)))
    axes.tick_params(labelsize=7)
    axes.grid(alpha=0.4, lw=0.5)
    axes.set_title("directivity (dBi) over $\\theta$", fontsize=8)


def _draw_map(
    axes: Axes, theta: Floats, phi: Floats, levels: Floats, low: float, high: float
) -> None:
    shown = draw_disc(axes, theta, phi, np.maximum(levels, low), low, high)
    axes.set_xlabel("$u = \\sin\\theta\\,\\cos\\phi$")
    axes.set_ylabel("$v = \\sin\\theta\\,\\sin\\phi$")
    colour_bar(axes, shown, f"directivity (dBi), {floor_text(round(low, 1), 'dBi')}")


def _write_table(axes: Axes, metrics: BeamMetrics) -> None:
    axes.axis("off")
    text = str(metrics).replace("|u|^2", "|u|²").replace("-", "\N{MINUS SIGN}")
    text = text.replace(f"half{chr(0x2212)}power", "half-power")
    axes.text(
        0.0, 0.95, text, family="DejaVu Sans Mono", fontsize=7, va="top", linespacing=1.5,
        transform=axes.transAxes,
    )  # fmt: skip


def draw_rcs(
    pattern: Any,
    *,
    floor_db: float = -40.0,
    title: str = "",
    figure: Figure | SubFigure | None = None,
) -> Any:
    """Cross sections in dBsm: cuts around z and x-z in polar coordinates, and a map of all angles.

    Parameters
    ----------
    pattern : xarray.Dataset or the like, as :func:`polywigner.rcs_pattern` returns, of two angles
        each or more.
    floor_db : lowest level, dB below the largest cross section.
    title : above all panels.
    figure : matplotlib Figure or SubFigure to draw on; None: a new figure.

    Returns
    -------
    The figure or subfigure.

    Raises
    ------
    ArgumentError : no pattern, too few angles, a body that scatters nothing; what is no figure.
    """
    import matplotlib as mpl

    check_floor(floor_db)
    azimuth, elevation, levels = _checked_rcs(pattern)
    high = float(levels.max())
    low = high + floor_db
    label = f"RCS (dBsm), {floor_text(round(low, 1), 'dBsm')}"
    with mpl.rc_context(TYPOGRAPHY):
        drawn = figure_on(figure, 8.4, 3.8, spacing=0.05)
        polar = drawn.add_subplot(1, 2, 1, projection="polar")
        for (name, angles, cut), style in zip(
            _rcs_cuts(azimuth, elevation, levels), ("-", "--"), strict=True
        ):
            polar.plot(angles, np.maximum(cut, low), style, label=name, lw=1.2)
        polar.set_ylim(low, high)
        polar.tick_params(labelsize=7)
        polar.grid(alpha=0.4, lw=0.5)
        polar.set_title(label, fontsize=8)
        polar.legend(frameon=False, fontsize=7, loc="upper center", bbox_to_anchor=(0.5, -0.08))
        axes = drawn.add_subplot(1, 2, 2)
        places = np.degrees(azimuth), np.degrees(elevation)
        drawn_levels = np.maximum(levels, low).T
        shown = draw_levels(axes, drawn_levels, *places, low=low, high=high, shading="nearest")
        axes.set_xlabel("azimuth (degrees)")
        axes.set_ylabel("elevation (degrees)")
        colour_bar(axes, shown, label)
        write_title(drawn, title)
    return drawn


def _checked_rcs(pattern: Any) -> tuple[Floats, Floats, Floats]:
    """Azimuth (n,), elevation (m,), and levels (n, m) in dBsm, minus infinity for nothing."""
    try:
        azimuth, elevation, values = (
            np.asarray(pattern[name].values) for name in ("azimuth", "elevation", "rcs")
        )
    except (TypeError, KeyError, IndexError, AttributeError):
        raise ArgumentError(
            f"expected a pattern of polywigner.rcs_pattern, got {type(pattern).__name__}"
        ) from None
    if min(values.shape) < 2:
        raise ArgumentError(f"expected two angles each or more, got a table of {values.shape}")
    if not values.max() > 0:
        raise ArgumentError(
            "expected a body that scatters something on these angles, got zero everywhere"
        )
    with np.errstate(divide="ignore"):
        return azimuth, elevation, 10 * np.log10(values)


def _rcs_cuts(
    azimuth: Floats, elevation: Floats, levels: Floats
) -> list[tuple[str, Floats, Floats]]:
    """The cut nearest to the plane z = 0, over azimuth, and that nearest to x-z, over elevation."""
    flat = int(np.abs(elevation).argmin())
    turns = np.abs(np.exp(1j * azimuth)[:, None] - np.array([1.0, -1.0])).argmin(axis=0)
    front, back = (int(turn) for turn in turns)
    upright = np.concatenate([elevation, math.pi - elevation[::-1]])
    across = np.concatenate([levels[front], levels[back][::-1]])
    return [
        (
            f"over azimuth, elevation {number_text(round(math.degrees(elevation[flat]), 2))}°",
            azimuth,
            levels[:, flat],
        ),
        ("over elevation, in the x-z plane", upright, across),
    ]
