"""Spots and transfer functions of lenses, one panel or one style for each defocus."""

from __future__ import annotations

from itertools import cycle
from typing import Any

import numpy as np

from polywigner.errors import ArgumentError
from polywigner.figures import style
from polywigner.figures.levels import check_floor, checked_dataset, level_db
from polywigner.geometry.display import length_unit

_DASHES = ("-", "--", "-.", ":")
# Curves that are no further apart are one line.
_ALIKE = 2e-3


@style.typeset
def draw_psf(found: Any, floor_db: float = -40.0, title: str = "", *, figure: Any = None) -> Any:
    """Draw point spread functions, a panel for each defocus.

    Parameters
    ----------
    found : xarray.Dataset with ``psf`` (defocus, y, x) in 1/m^2, x and y in m.
    floor_db : lowest level, dB below the largest value of all panels.
    title : above the panels.
    figure : matplotlib Figure or SubFigure to draw on, which is returned; None: a new figure.

    Raises
    ------
    ArgumentError : a floor that is not below zero, what is no figure, and no dataset.
    """
    check_floor(floor_db)
    spots = _checked(found, "psf", ("defocus", "y", "x"))
    unit = length_unit(float(np.ptp(found["x"].values)))
    peak = float(spots.max())
    count = spots.sizes["defocus"]
    figure = style.figure_on(figure, 2.4 + 2.6 * count, 3.5)
    panels = figure.subplots(1, count, sharey=True, squeeze=False)[0]
    across, up = (found[name].values / unit.metres for name in ("x", "y"))
    for axes, spot in zip(panels, spots, strict=True):
        levels = level_db(spot.values, peak, floor_db)
        shown = style.draw_levels(axes, levels, across, up, low=floor_db)
        axes.set_title(_of_focus(spot))
        style.length_axes(axes, "x", unit)
        axes.set_adjustable("box")
        axes.label_outer()
    style.colour_bar(panels, shown, f"dB relative to {peak:.3g} /m², {style.floor_text(floor_db)}")
    style.write_title(figure, title)
    return figure


@style.typeset
def draw_mtf(found: Any, title: str = "", *, figure: Any = None) -> Any:
    """Draw modulation transfer functions along x and y, a style of lines for each defocus.

    Parameters
    ----------
    found : xarray.Dataset with ``mtf`` (defocus, direction, frequency), frequency in cycles/mm.
    title : above the panel.
    figure : matplotlib Figure or SubFigure to draw on, which is returned; None: a new figure.

    Raises
    ------
    ArgumentError : what is no figure, and no dataset.
    """
    curves = _checked(found, "mtf", ("defocus", "direction", "frequency"))
    figure = style.figure_on(figure, 6.4, 3.8)
    axes = figure.subplots()
    frequency = found["frequency"].values
    for part, dashes in zip(curves, cycle(_DASHES), strict=False):
        lines = dict(zip(("along x", "along y"), part.values, strict=True))
        if np.ptp(part.values, axis=0).max() <= _ALIKE:
            lines = {"along x and y": part.values[0]}
        state = f", {_of_focus(part)}" if len(curves) > 1 or float(part["defocus"]) else ""
        for (name, line), colour in zip(lines.items(), (style.RED, style.BLUE), strict=False):
            axes.plot(frequency, line, color=colour, ls=dashes, label=name + state)
    axes.set(
        xlim=(0.0, frequency.max()),
        ylim=(0.0, 1.05),
        xlabel="frequency (cycles/mm)",
        ylabel="modulation transfer function",
    )
    axes.grid(alpha=0.3, lw=0.5)
    axes.legend(frameon=False)
    style.write_title(figure, title)
    return figure


def _of_focus(part: Any) -> str:
    waves = float(part["defocus"])
    return f"{waves:g} waves of defocus" if waves else "in focus"


def _checked(found: Any, name: str, dims: tuple[str, ...]) -> Any:
    values = checked_dataset(found, "found").get(name)
    if values is None or values.dims != dims or not all(dim in found.coords for dim in dims):
        raise ArgumentError(
            f"expected found with {name} over {', '.join(dims)}, got a dataset without; give one "
            f"that polywigner {name} writes"
        )
    return values
