"""Fig. xforms: how the slices of the autocorrelation are cut out of an element's outline."""

from __future__ import annotations

from typing import Any

import numpy as np

import polywigner as pw
from polywigner.figures.paper.sources import Made, Quality, geojson, triangle
from polywigner.figures.style import (
    TYPOGRAPHY,
    draw_polygons,
    length_axes,
    length_unit,
    letter_panels,
    new_figure,
    number_text,
)

__all__ = ["make"]

POSITION = (1.2e-3, -0.6e-3)
LAG = (4e-3, 2.5e-3)

_ELEMENT, _FIRST, _SECOND, _SLICE = "0.82", "#1f3b57", "#8a5a00", "#c1440e"


def make(quality: Quality) -> Made:
    """(a) 2(G - x) & 2(x - G), over lags; (b) (G - xi/2) & (G + xi/2), over positions."""
    import matplotlib as mpl
    from shapely.affinity import affine_transform, translate

    source = triangle()
    outline = source.polygons
    (x, y), (across, up) = POSITION, LAG
    shapes = {
        "element": outline,
        "doubled": affine_transform(outline, (2, 0, 0, 2, -2 * x, -2 * y)),
        "mirrored": affine_transform(outline, (-2, 0, 0, -2, 2 * x, 2 * y)),
        "lag_slice": pw.lag_slice(source, POSITION),
        "behind": translate(outline, -across / 2, -up / 2),
        "ahead": translate(outline, across / 2, up / 2),
        "position_slice": pw.position_slice(source, LAG),
    }
    with mpl.rc_context(TYPOGRAPHY):
        figure = new_figure(8.2, 4.2, spacing=0.04)
        left, right = figure.subplots(1, 2)
        _draw(left, shapes, ("doubled", "2(Γ − x)"), ("mirrored", "2(x − Γ)"), "lag_slice")
        _draw(right, shapes, ("behind", "Γ − ξ/2"), ("ahead", "Γ + ξ/2"), "position_slice")
        left.plot(x * 1e3, y * 1e3, "o", color="black", ms=4, label="x", zorder=5)
        arrow = {"arrowstyle": "-|>", "color": "black", "shrinkA": 0, "shrinkB": 0}
        tip = np.array(LAG) * 1e3
        right.annotate("", tip, (0, 0), arrowprops=arrow, zorder=5)
        right.annotate("ξ", tip, xytext=(4, 2), textcoords="offset points")
        right.plot(*np.outer(tip, (-0.5, 0.5)), "o", color="black", ms=4, label="±ξ/2", zorder=5)
        left.set_title(f"lag slice at x = {_pair(POSITION)} mm")
        right.set_title(f"position slice at ξ = {_pair(LAG)} mm")
        unit = length_unit(source.diameter)
        length_axes(left, r"\xi", unit)
        length_axes(right, "x", unit)
        for axes in (left, right):
            axes.legend(
                loc="upper center", bbox_to_anchor=(0.5, -0.14), ncols=3, frameon=False, fontsize=8
            )
        letter_panels((left, right))
    return Made(
        {"": figure},
        {
            **{name: geojson(shape) for name, shape in shapes.items()},
            "x": np.array(POSITION),
            "xi": np.array(LAG),
        },
        {**dict.fromkeys(shapes, "GeoJSON, m"), "x": "m", "xi": "m"},
    )


def _pair(metres: tuple[float, float]) -> str:
    return "({}, {})".format(*(number_text(value * 1e3) for value in metres))


def _draw(
    axes: Any, shapes: Any, first: tuple[str, str], second: tuple[str, str], slice_name: str
) -> None:
    unit = length_unit(1e-2)
    draw_polygons(
        axes, shapes["element"], unit, facecolor=_ELEMENT, edgecolor="none", label="element Γ"
    )
    draw_polygons(
        axes,
        shapes[slice_name],
        unit,
        facecolor=_SLICE,
        edgecolor="none",
        alpha=0.45,
        label="slice Γ′",
    )
    for (name, label), ink, dash in ((first, _FIRST, "-"), (second, _SECOND, "--")):
        draw_polygons(
            axes, shapes[name], unit, facecolor="none", edgecolor=ink, ls=dash, lw=1.2, label=label
        )
    axes.axhline(0, color="0.6", lw=0.5, zorder=0)
    axes.axvline(0, color="0.6", lw=0.5, zorder=0)
