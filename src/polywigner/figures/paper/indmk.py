"""Fig. indmk: two elements and their automean, the support of their mutual power."""

from __future__ import annotations

import numpy as np

import polywigner as pw
from polywigner.figures.paper.sources import Made, Quality, geojson, triangles
from polywigner.figures.style import TYPOGRAPHY, draw_polygons, length_axes, length_unit, new_figure

__all__ = ["make"]

_ELEMENTS, _SUPPORT, _HULL = "#c8372d", "#9dbfe0", "0.45"  # red and blue, as in the paper


def make(quality: Quality) -> Made:
    """Elements (red), automean (red and blue) and its convex hull, with their areas."""
    import matplotlib as mpl

    source = triangles()
    support = pw.automean(source)
    hull = source.polygons.convex_hull
    unit = length_unit(source.diameter)
    mm2 = unit.metres**2
    with mpl.rc_context(TYPOGRAPHY):
        figure = new_figure(6.2, 3.3)  # as wide as the legend
        axes = figure.add_subplot()
        parts = (
            (hull, "none", _HULL, f"convex hull, {hull.area / mm2:.0f} mm²"),
            (
                support.polygons,
                _SUPPORT,
                "none",
                f"automean (blue and red), {support.area / mm2:.0f} mm²",
            ),
            (source.polygons, _ELEMENTS, "none", f"elements, {source.area / mm2:.0f} mm²"),
        )
        for shape, face, edge, label in parts:
            dashed = "--" if face == "none" else "-"
            draw_polygons(
                axes, shape, unit, facecolor=face, edgecolor=edge, ls=dashed, lw=0.9, label=label
            )
        length_axes(axes, "x", unit)
        figure.legend(loc="outside lower center", ncols=3, frameon=False, fontsize=8)
    shapes = {"elements": source.polygons, "automean": support.polygons, "hull": hull}
    areas = np.array([shape.area for shape in shapes.values()])
    return Made(
        {"": figure},
        {**{name: geojson(shape) for name, shape in shapes.items()}, "areas": areas},
        {**dict.fromkeys(shapes, "GeoJSON, m"), "areas": "m^2, of elements, automean and hull"},
    )
