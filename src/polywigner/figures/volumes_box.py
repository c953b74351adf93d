"""The box around a volume on the page: walls with pictures on them, edges, ticks, the aperture."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from polywigner.figures.slices import outline_of
from polywigner.figures.style import LengthUnit, number_text
from polywigner.figures.volumes_view import Edge, View, back_edges, back_wall, label_edge

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.transforms import Affine2D

    from polywigner import Aperture, Array

__all__ = ["draw_box", "draw_outline", "draw_picture", "draw_wall"]

Floats = NDArray[np.float64]

_INK = "0.25"
_APERTURE = "#101010"
_TICK = 0.012  # of the diagonal of the page
_LABEL = 0.035
_NAME = 0.105
_APART = 0.055
_MANY = 20  # outlines, as of arrays, which lines of the usual width would fill


def _affine(origin: Floats, along: Floats, down: Floats) -> Affine2D:
    """Takes (column, row) of a raster to the page; each argument (2,)."""
    from matplotlib.transforms import Affine2D

    return Affine2D(
        np.array([[along[0], down[0], origin[0]], [along[1], down[1], origin[1]], [0, 0, 1]])
    )


def draw_picture(
    axes: Axes, picture: NDArray[Any], origin: Floats, along: Floats, down: Floats, **how: Any
) -> Any:
    """A raster of values or RGBA, pixel (row, column) centred at origin + column*along + row*down
    on the page."""
    rows, columns = picture.shape[:2]
    return axes.imshow(
        picture,
        origin="lower",
        extent=(-0.5, columns - 0.5, -0.5, rows - 0.5),
        transform=_affine(origin, along, down) + axes.transData,
        clip_on=False,
        **how,
    )


def draw_wall(
    axes: Axes,
    view: View,
    axis: int,
    wall: Floats,
    corners: tuple[Floats, Floats],
    contours: tuple[float, ...],
    colours: Floats,
    **how: Any,
) -> Any:
    """Samples (m, n) over the back wall across an axis of the box between two corners, (3,) each.

    The samples reach from edge to edge along the two other axes, in their order; contours are drawn
    at some of their values, in ``colours`` (k, 3); ``how`` is for the picture of all others.
    """
    lower, upper = corners
    corner = lower.copy()
    corner[axis] = back_wall(view, axis, lower, upper)
    first, second = (a for a in range(3) if a != axis)
    steps = []
    for a, count in zip((first, second), wall.shape, strict=True):
        step = np.zeros(3)
        step[a] = (upper[a] - lower[a]) / (count - 1)
        steps.append(view.on_page(step))
    origin = view.on_page(corner)
    shown = draw_picture(axes, wall, origin, steps[1], steps[0], interpolation="bilinear", **how)
    # Samples lie on the faces' borders, so that half of each outer pixel stands over.
    shown.set_clip_path(_face(axes, view, axis, lower, upper))
    shown.set_clip_on(True)
    rows, columns = np.indices(wall.shape)
    x, y = (rows * steps[0][k] + columns * steps[1][k] + origin[k] for k in range(2))
    if wall.min() < max(contours) and wall.max() > min(contours):
        axes.contour(x, y, wall, contours, colors=colours, linewidths=0.7, linestyles="solid")
    return shown


def _face(axes: Axes, view: View, axis: int, lower: Floats, upper: Floats) -> Any:
    from matplotlib.patches import Polygon

    corners = []
    first, second = (a for a in range(3) if a != axis)
    for ends in ((lower, lower), (upper, lower), (upper, upper), (lower, upper)):
        corner = lower.copy()
        corner[axis] = back_wall(view, axis, lower, upper)
        corner[first], corner[second] = ends[0][first], ends[1][second]
        corners.append(view.on_page(corner))
    patch = Polygon(np.array(corners), closed=True, fill=False, lw=0, transform=axes.transData)
    axes.add_patch(patch)
    return patch


def draw_box(axes: Axes, view: View, lower: Floats, upper: Floats, unit: LengthUnit) -> None:
    """The edges of the back walls, and ticks and names of the three axes at the outline."""
    axes.set_aspect("equal")
    axes.set_axis_off()
    page = view.corners(lower, upper)
    (left, below), (right, above) = page.min(axis=0), page.max(axis=0)
    axes.set_xlim(left, right)
    axes.set_ylim(below, above)
    for edge in back_edges(view, lower, upper):
        axes.plot(*view.on_page([edge.start, edge.end]).T, color=_INK, lw=0.7, zorder=2)
    size = float(np.ptp(view.corners(lower, upper), axis=0).max())
    for axis in (2, 1, 0):
        _label(axes, view, label_edge(view, axis, lower, upper), "xyz"[axis], size, unit)


def _label(axes: Axes, view: View, edge: Edge, name: str, size: float, unit: LengthUnit) -> None:
    from matplotlib.ticker import MaxNLocator

    first, last = view.on_page(edge.start), view.on_page(edge.end)
    low, high = edge.start[edge.axis] / unit.metres, edge.end[edge.axis] / unit.metres
    count = max(2, min(6, int(9 * float(np.linalg.norm(last - first)) / size)))
    for value in MaxNLocator(count).tick_values(low, high):
        part = (value - low) / (high - low)
        if not -1e-9 <= part <= 1 + 1e-9:
            continue
        place = first + part * (last - first)
        end = place + _TICK * size * edge.outward
        axes.plot(*np.stack([place, end]).T, color=_INK, lw=0.7, zorder=2)
        x, y = place + _LABEL * size * edge.outward
        # Two axes may end at one corner of the outline, each with a number.
        if all(np.hypot(x - a, y - b) > _APART * size for a, b in _places_of_texts(axes)):
            axes.text(x, y, number_text(value), ha="center", va="center", fontsize=8)
    middle = (first + last) / 2 + _NAME * size * edge.outward
    along = last - first if last[0] >= first[0] else first - last
    angle = np.degrees(np.arctan2(along[1], along[0]))
    axes.text(
        middle[0], middle[1], f"${name}$ ({unit.name})", ha="center", va="center", rotation=angle,
        rotation_mode="anchor",
    )  # fmt: skip


def _places_of_texts(axes: Axes) -> list[tuple[float, float]]:
    return [text.get_position() for text in axes.texts]


def draw_outline(axes: Axes, view: View, source: Aperture | Array) -> None:
    """The outline of a source in the plane z = 0, holes cut out."""
    from matplotlib.patches import PathPatch
    from matplotlib.path import Path

    shape = outline_of(source).polygons
    rings = [ring for p in shape.geoms for ring in (p.exterior, *p.interiors)]
    width = 1.0 if len(rings) <= _MANY else 0.3
    path = Path.make_compound_path(
        *(Path(_on_aperture(view, np.asarray(ring.coords)), closed=True) for ring in rings)
    )
    axes.add_patch(PathPatch(path, facecolor=_APERTURE, alpha=0.35, edgecolor="none", zorder=4))
    axes.add_patch(PathPatch(path, fill=False, edgecolor=_APERTURE, lw=width, zorder=4))


def _on_aperture(view: View, points: ArrayLike) -> Floats:
    flat = np.asarray(points, dtype=np.float64)[:, :2]
    return view.on_page(np.column_stack([flat, np.zeros(len(flat))]))
