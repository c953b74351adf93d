"""Radiation patterns as data sheets show them: cuts, a polar plot, a u-v map and the numbers."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from polywigner.errors import ArgumentError
from polywigner.figures.hemispheres import draw_disc
from polywigner.figures.levels import check_floor
from polywigner.figures.style import (
    TYPOGRAPHY,
    colour_bar,
    figure_on,
    number_text,
    write_title,
)
from polywigner.propagation.beams import BeamMetrics, beam_metrics
from polywigner.propagation.patterns import checked_pattern, cuts_of, front_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure, SubFigure

__all__ = ["PatternPanel", "draw_pattern"]

Floats = NDArray[np.float64]
Cut = tuple[str, Floats, Floats]
"""Label, theta in rad, directivity in dBi."""

PatternPanel = Literal["cuts", "polar", "uv", "table"]

_COLOURS = ("#2166ac", "#d7301f", "#1b9e77", "#e69f00")
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
    names = [panels] if isinstance(panels, str) or not isinstance(panels, Sequence) else [*panels]
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
    axes.set_title(f"dotted: half the peak; floor {number_text(low - high)} dB", fontsize=8)
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
    colour_bar(axes, shown, f"directivity (dBi), floor {number_text(round(low, 1))} dBi")


def _write_table(axes: Axes, metrics: BeamMetrics) -> None:
    axes.axis("off")
    text = str(metrics).replace("|u|^2", "|u|²").replace("-", "\N{MINUS SIGN}")
    text = text.replace(f"half{chr(0x2212)}power", "half-power")
    axes.text(
        0.0, 0.95, text, family="DejaVu Sans Mono", fontsize=7, va="top", linespacing=1.5,
        transform=axes.transAxes,
    )  # fmt: skip
