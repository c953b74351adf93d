"""Planned in the paper's comments: position and lag marginals of the autocorrelation."""

from __future__ import annotations

from typing import Any

import numpy as np

import polywigner as pw
from polywigner.figures.paper.sources import Made, Quality, geojson, number_samples, triangles
from polywigner.figures.style import (
    LEVEL_MAP,
    TYPOGRAPHY,
    colour_bar,
    draw_polygons,
    length_axes,
    length_unit,
    letter_panels,
    new_figure,
)

__all__ = ["make"]

_MARGIN = 0.5e-3  # so that outlines do not lie on the frame


def make(quality: Quality) -> Made:
    """R_x(x) with the automean's outline, and R_xi(xi): both areas of overlaps."""
    import matplotlib as mpl

    source = triangles()
    count = number_samples(quality, 241, 721)
    support = pw.automean(source)
    xmin, ymin, xmax, ymax = source.bounds
    x = np.linspace(xmin - _MARGIN, xmax + _MARGIN, count)
    y = np.linspace(ymin - _MARGIN, ymax + _MARGIN, count // 2 + 1)
    xi_x = np.linspace(xmin - xmax, xmax - xmin, count)
    xi_y = np.linspace(ymin - ymax, ymax - ymin, count // 2 + 1)
    of_position = pw.position_marginal(source, np.stack(np.meshgrid(x, y), axis=-1))
    of_lag = pw.lag_marginal(source, np.stack(np.meshgrid(xi_x, xi_y), axis=-1))
    unit = length_unit(source.diameter)
    with mpl.rc_context(TYPOGRAPHY):
        figure = new_figure(5.6, 4.2, spacing=0.04)
        figure.set_layout_engine("compressed")
        panels = figure.subplots(2, 1)
        for axes, across, up, values, symbol, name in (
            (panels[0], x, y, of_position, "x", r"$R_x$, area of the lag slice at $x$"),
            (
                panels[1],
                xi_x,
                xi_y,
                of_lag,
                r"\xi",
                r"$R_\xi$, area of the position slice at $\xi$",
            ),
        ):
            _draw(axes, across, up, values, symbol, unit)
            axes.set_title(name)
        for shape, ink in ((support.polygons, "0.75"), (source.polygons, "#5ec8ff")):
            draw_polygons(panels[0], shape, unit, facecolor="none", edgecolor=ink, lw=0.8)
        letter_panels(panels)
    return Made(
        {"": figure},
        {
            "x": x,
            "y": y,
            "position_marginal": of_position,
            "xi_x": xi_x,
            "xi_y": xi_y,
            "lag_marginal": of_lag,
            "aperture": geojson(source.polygons),
        },
        {
            **dict.fromkeys(("x", "y", "xi_x", "xi_y"), "m"),
            "position_marginal": "m^2, [j, i] at (x[i], y[j])",
            "lag_marginal": "m^2, [j, i] at (xi_x[i], xi_y[j])",
            "aperture": "GeoJSON, m",
        },
    )


def _draw(axes: Any, across: Any, up: Any, values: Any, symbol: str, unit: Any) -> None:
    shown = axes.pcolormesh(
        across / unit.metres,
        up / unit.metres,
        values / unit.metres**2,
        shading="nearest",
        cmap=LEVEL_MAP,
        vmin=0.0,
        rasterized=True,
    )
    colour_bar(axes, shown, f"{unit.name}²")
    length_axes(axes, symbol, unit)
    axes.set_aspect("equal", adjustable="box")
    axes.margins(0)
