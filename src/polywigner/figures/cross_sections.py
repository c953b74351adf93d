"""Radar cross sections over the angles of the radar: principal cuts, and a map."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from polywigner.errors import ArgumentError
from polywigner.figures.levels import check_floor
from polywigner.figures.style import (
    LEVEL_MAP,
    TYPOGRAPHY,
    colour_bar,
    figure_on,
    number_text,
    write_title,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure, SubFigure


Floats = NDArray[np.float64]


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
    azimuth, elevation, levels = _checked(pattern)
    high = float(levels.max())
    low = high + floor_db
    with mpl.rc_context(TYPOGRAPHY):
        drawn = figure_on(figure, 8.4, 3.8, spacing=0.05)
        polar = drawn.add_subplot(1, 2, 1, projection="polar")
        for (label, angles, cut), style in zip(
            _cuts(azimuth, elevation, levels), ("-", "--"), strict=True
        ):
            polar.plot(angles, np.maximum(cut, low), style, label=label, lw=1.2)
        polar.set_ylim(low, high)
        polar.tick_params(labelsize=7)
        polar.grid(alpha=0.4, lw=0.5)
        polar.set_title(f"RCS (dBsm), floor {number_text(round(low, 1))} dBsm", fontsize=8)
        polar.legend(frameon=False, fontsize=7, loc="upper center", bbox_to_anchor=(0.5, -0.08))
        axes = drawn.add_subplot(1, 2, 2)
        shown = axes.pcolormesh(
            np.degrees(azimuth),
            np.degrees(elevation),
            np.maximum(levels, low).T,
            cmap=LEVEL_MAP,
            vmin=low,
            vmax=high,
            shading="nearest",
            rasterized=True,
        )
        axes.set_xlabel("azimuth (degrees)")
        axes.set_ylabel("elevation (degrees)")
        colour_bar(axes, shown, f"RCS (dBsm), floor {number_text(round(low, 1))} dBsm")
        write_title(drawn, title)
    return drawn


def _checked(pattern: Any) -> tuple[Floats, Floats, Floats]:
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


def _cuts(azimuth: Floats, elevation: Floats, levels: Floats) -> list[tuple[str, Floats, Floats]]:
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
