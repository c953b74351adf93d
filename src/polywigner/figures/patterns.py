"""Radiation patterns as data sheets show them: cuts, a polar plot, a u-v map and the numbers."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from polywigner.errors import ArgumentError
from polywigner.figures.fields import (
    chosen_method,
    dims_of,
    fields_of,
    first_of,
    label_of,
    peak_of,
    printed_unit,
    quantity_of,
    squared_unit,
)
from polywigner.figures.levels import check_floor, level_db
from polywigner.figures.style import (
    LEVEL_MAP,
    TYPOGRAPHY,
    colour_bar,
    figure_on,
    number_text,
    quantity_text,
    row_bar,
    write_title,
)
from polywigner.propagation.beams import BeamMetrics, beam_metrics
from polywigner.propagation.patterns import checked_pattern, cuts_of, front_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure, SubFigure


_INCHES = 3.3
_RINGS = (30, 60)  # degrees from the axis


def draw_hemispheres(
    found: Any,
    *,
    against: str | None = None,
    floor_db: float = -40.0,
    title: str = "",
    figure: Figure | SubFigure | None = None,
) -> Any:
    """Levels over all directions of a half space, in the plane of the direction cosines s_x, s_y.

    Parameters
    ----------
    found : xarray.Dataset with a variable for each method, as from :func:`polywigner.hemisphere`,
        over ``theta`` (from the axis) and ``phi`` (around it, from x) in radians. Complex values
        are squared.
    against : the variable whose peak is 0 dB; None: the last one.
    floor_db : lowest level, dB; all that is less has its colour.
    title : above the panels.
    figure : matplotlib Figure or SubFigure to draw on; None: a new figure.

    Returns
    -------
    The figure or subfigure.

    Raises
    ------
    ArgumentError : no such quantity or method; other axes; what is no figure.
    """
    import matplotlib as mpl

    check_floor(floor_db)
    if "directivity" in found:
        raise ArgumentError(
            "expected fields on a hemisphere, got a radiation pattern, whose directivity is in dBi "
            "already; use draw_pattern"
        )
    fields = fields_of(found)
    against = chosen_method(fields, against)
    dims = dims_of(found)
    if sorted(dims) != ["phi", "theta"]:
        raise ArgumentError(f"expected fields over theta and phi, got them over {', '.join(dims)}")
    first = first_of(found)
    name, unit = quantity_of(first), printed_unit(first)
    theta, phi = (np.asarray(found[d].values, dtype=np.float64) for d in ("theta", "phi"))
    is_field = np.iscomplexobj(fields[against])
    powers = {
        m: (np.abs(v) ** 2 if is_field else v).transpose([dims.index("theta"), dims.index("phi")])
        for m, v in fields.items()
    }
    zero = peak_of(powers[against], name)
    with mpl.rc_context(TYPOGRAPHY):
        size = _INCHES * len(powers) + 1.2, _INCHES + 0.6
        figure = figure_on(figure, *size, is_compressed=True)
        panels = figure.subplots(1, len(powers), squeeze=False, sharey=True)[0]
        for axes, (method, power) in zip(panels, powers.items(), strict=True):
            levels = level_db(power, zero, floor_db)
            shown = draw_disc(axes, theta, phi, levels, floor_db, 0.0)
            axes.set_xlabel("$s_x$")
            axes.set_title(label_of(found[method], method))
        panels[0].set_ylabel("$s_y$")
        unit = squared_unit(first) if is_field else unit
        what = f"|{name}|²" if is_field else name
        text = (
            f"{what}, dB relative to {quantity_text(zero, unit)}\nfloor {number_text(floor_db)} dB"
        )
        row_bar(panels, shown, text)
        write_title(figure, title)
    return figure


def draw_disc(
    axes: Axes,
    theta: NDArray[np.float64],
    phi: NDArray[np.float64],
    levels: NDArray[np.float64],
    low: float,
    high: float,
) -> Any:
    """Levels (n, m) over theta and phi, in the plane of the direction cosines, with its circles."""
    from matplotlib.patches import Circle

    phi, levels = _once_around(phi, levels)
    sine = np.sin(theta)[:, None]
    shown = axes.pcolormesh(
        sine * np.cos(phi),
        sine * np.sin(phi),
        levels,
        shading="gouraud",
        cmap=LEVEL_MAP,
        vmin=low,
        vmax=high,
        rasterized=True,
    )
    for degrees in (*_RINGS, 90):
        radius = np.sin(np.radians(degrees))
        how: dict[str, Any] = {"edgecolor": "0.4" if degrees == 90 else "white", "fill": False}
        axes.add_patch(Circle((0, 0), radius, lw=0.6, ls="-" if degrees == 90 else ":", **how))
        if degrees != 90:
            place = radius * np.cos(np.pi / 4), radius * np.sin(np.pi / 4)
            axes.text(*place, f"{degrees}°", color="white", fontsize=7, ha="left", va="bottom")
    axes.set_aspect("equal")
    axes.set_xlim(-1.02, 1.02)
    axes.set_ylim(-1.02, 1.02)
    return shown


def _once_around(
    phi: NDArray[np.float64], levels: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """With the first meridian again at the end, where the circle is left open by one step."""
    step = phi[1] - phi[0] if len(phi) > 1 else 0.0
    if abs(phi[-1] + step - phi[0] - 2 * np.pi) > 1e-6 * max(step, 1e-6):
        return phi, levels
    return np.append(phi, phi[0] + 2 * np.pi), np.concatenate([levels, levels[:, :1]], axis=1)


if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure, SubFigure


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
