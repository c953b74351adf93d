"""Isosurfaces as layers of normals on a raster, by casting rays or by pyvista, and their shading.

A layer holds, for each pixel, the outward normal of one isosurface where the ray of that pixel
first meets it. What is above a level is taken to end at the faces of the box that are turned to the
viewer, so that a ray meets every surface before those of higher levels, which it encloses, and
layers can be laid over each other in their order.
"""

from __future__ import annotations

import importlib.util
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from polywigner.errors import missing_extra
from polywigner.figures.style import LengthUnit, number_text
from polywigner.figures.transforms import outline_of

Floats = NDArray[np.float64]

_FLATTEST = 0.25
"""Smallest drawn side of a box in parts of its largest: thinner boxes are stretched to this."""


@dataclass(frozen=True)
class View:
    """Parallel projection of x, y, z (metres) along ``towards``, y upwards on the page.

    ``stretch`` (3,) multiplies lengths along x, y, z first; ``right``, ``up`` and ``towards`` (3,)
    are orthogonal unit vectors in stretched space, the last one pointing to the viewer.
    """

    stretch: Floats
    right: Floats
    up: Floats
    towards: Floats

    @staticmethod
    def of(lower: ArrayLike, upper: ArrayLike, towards: ArrayLike) -> View:
        """The view of a box between two corners from the direction ``towards`` (3,).

        Sides shorter than a quarter of the longest are stretched to that quarter.
        """
        extent = np.asarray(upper, dtype=np.float64) - np.asarray(lower, dtype=np.float64)
        stretch = np.maximum(extent, _FLATTEST * extent.max()) / extent
        direction = np.asarray(towards, dtype=np.float64)
        direction = direction / np.linalg.norm(direction)
        right = np.cross((0.0, 1.0, 0.0), direction)
        right = right / np.linalg.norm(right)
        return View(stretch, right, np.cross(direction, right), direction)

    def on_page(self, points: ArrayLike) -> Floats:
        """Points (..., 3) to page coordinates (..., 2)."""
        stretched = np.asarray(points, dtype=np.float64) * self.stretch
        return np.stack([stretched @ self.right, stretched @ self.up], axis=-1)

    def corners(self, lower: Floats, upper: Floats) -> Floats:
        """The eight corners of a box on the page, (8, 2)."""
        ends = np.array(list(product(*zip(lower, upper, strict=True))))
        return self.on_page(ends)


if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from polywigner import Aperture, Array


_INK = "0.25"
_APERTURE = "#101010"
_TICK = 0.012  # of the diagonal of the page
_LABEL = 0.035
_NAME = 0.105
_APART = 0.055
_MANY = 20  # outlines, as of arrays, which lines of the usual width would fill


class Edge(NamedTuple):
    """An edge of a box along ``axis``, from ``start`` to ``end`` (3,), and its outward side.

    ``outward`` (2,), a unit vector on the page, points away from the middle of the box; ``fronts``
    of the two faces that meet here show their front.
    """

    axis: int
    start: Floats
    end: Floats
    outward: Floats
    fronts: int


def _edges(view: View, lower: Floats, upper: Floats) -> Iterator[Edge]:
    """The twelve edges of a box."""
    middle = view.on_page((lower + upper) / 2)
    for axis, corner in product(range(3), product((False, True), repeat=3)):
        if corner[axis]:
            continue
        start = np.where(corner, upper, lower)
        end = start.copy()
        end[axis] = upper[axis]
        fronts = sum((view.towards[a] > 0) == corner[a] for a in range(3) if a != axis)
        first, last = view.on_page(start), view.on_page(end)
        along = (last - first) / np.linalg.norm(last - first)
        across = np.array([-along[1], along[0]])
        outward = across * np.sign(across @ ((first + last) / 2 - middle) or 1.0)
        yield Edge(axis, start, end, outward, fronts)


def draw_picture(
    axes: Axes, picture: NDArray[Any], origin: Floats, along: Floats, down: Floats, **how: Any
) -> Any:
    """A raster of values or RGBA, pixel (row, column) centred at origin + column*along + row*down
    on the page."""
    from matplotlib.transforms import Affine2D

    rows, columns = picture.shape[:2]
    return axes.imshow(
        picture,
        origin="lower",
        extent=(-0.5, columns - 0.5, -0.5, rows - 0.5),
        transform=Affine2D.from_values(*along, *down, *origin) + axes.transData,
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
    from matplotlib.patches import Polygon

    lower, upper = corners
    corner = lower.copy()
    corner[axis] = (lower if view.towards[axis] > 0 else upper)[axis]
    sides = [np.where(np.arange(3) == a, upper - lower, 0.0) for a in range(3) if a != axis]
    steps = [view.on_page(s / (n - 1)) for s, n in zip(sides, wall.shape, strict=True)]
    origin = view.on_page(corner)
    shown = draw_picture(axes, wall, origin, steps[1], steps[0], interpolation="bilinear", **how)
    # Samples lie on the faces' borders, so that half of each outer pixel stands over.
    around = np.array([0 * corner, sides[0], sides[0] + sides[1], sides[1]])
    face = Polygon(view.on_page(corner + around), fill=False, lw=0, transform=axes.transData)
    shown.set_clip_path(axes.add_patch(face))
    shown.set_clip_on(True)
    rows, columns = np.indices(wall.shape)
    x, y = (rows * steps[0][k] + columns * steps[1][k] + origin[k] for k in range(2))
    if wall.min() < max(contours) and wall.max() > min(contours):
        axes.contour(x, y, wall, contours, colors=colours, linewidths=0.7, linestyles="solid")
    return shown


def draw_box(axes: Axes, view: View, lower: Floats, upper: Floats, unit: LengthUnit) -> None:
    """The edges of the back walls, and ticks and names of the three axes at the outline."""
    axes.set_aspect("equal")
    axes.set_axis_off()
    page = view.corners(lower, upper)
    (left, below), (right, above) = page.min(axis=0), page.max(axis=0)
    axes.set(xlim=(left, right), ylim=(below, above))
    edges = list(_edges(view, lower, upper))
    for edge in edges:
        if edge.fronts < 2:
            axes.plot(*view.on_page([edge.start, edge.end]).T, color=_INK, lw=0.7, zorder=2)
    size = float(np.ptp(page, axis=0).max())
    for axis in (2, 1, 0):
        # On the outline, low, for y at the left.
        height = 0 if axis == 1 else 1
        outline = (edge for edge in edges if edge.axis == axis and edge.fronts == 1)
        ticked = min(outline, key=lambda edge: view.on_page(edge.start + edge.end)[height])
        _label(axes, view, ticked, "xyz"[axis], size, unit)


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
        others = [text.get_position() for text in axes.texts]
        if all(np.hypot(x - a, y - b) > _APART * size for a, b in others):
            axes.text(x, y, number_text(value), ha="center", va="center", fontsize=8)
    middle = (first + last) / 2 + _NAME * size * edge.outward
    along = last - first if last[0] >= first[0] else first - last
    angle = np.degrees(np.arctan2(along[1], along[0]))
    axes.text(
        middle[0], middle[1], f"${name}$ ({unit.name})", ha="center", va="center", rotation=angle,
        rotation_mode="anchor",
    )  # fmt: skip


def draw_outline(axes: Axes, view: View, source: Aperture | Array) -> None:
    """The outline of a source in the plane z = 0, holes cut out."""
    from matplotlib.patches import PathPatch
    from matplotlib.path import Path

    shape = outline_of(source).polygons
    rings = [ring for p in shape.geoms for ring in (p.exterior, *p.interiors)]
    width = 1.0 if len(rings) <= _MANY else 0.3
    corners = (np.pad(np.asarray(ring.coords)[:, :2], ((0, 0), (0, 1))) for ring in rings)
    path = Path.make_compound_path(*(Path(view.on_page(c), closed=True) for c in corners))
    axes.add_patch(PathPatch(path, facecolor=_APERTURE, alpha=0.35, edgecolor="none", zorder=4))
    axes.add_patch(PathPatch(path, fill=False, edgecolor=_APERTURE, lw=width, zorder=4))


_BELOW = 20.0
"""dB under the lowest isosurface at which values are cut off: nulls go down to minus infinity, and
a surface between a null and its neighbour would be drawn beside its place."""

_STEPS = 320
"""Places along a ray, at least, at which it is looked: a ray that enters a surface and leaves it
between two of them misses it. One place on each plane leaves steps along every outline."""

_AMBIENT, _DIFFUSE, _SPECULAR, _SHININESS = 0.6, 0.5, 0.22, 24
_RIM = 0.7
"""Gain in opacity of surfaces that are seen edgeways, as of glass."""


@dataclass(frozen=True)
class Layers:
    """Normals of isosurfaces on a raster, and where its pixels lie on the page.

    ``normals`` (n, rows, columns, 3), unit vectors in stretched space, 0 where a ray misses. The
    pixel (i, j) is centred at ``origin + i*down + j*along`` (each (2,), page coordinates).
    """

    normals: NDArray[np.float32]
    origin: Floats
    down: Floats
    along: Floats


def closed(
    levels: NDArray[np.floating], lowest: float, view: View
) -> tuple[NDArray[np.float32], NDArray[np.int64]]:
    """dB values with one more layer of low ones on the three faces turned to the viewer."""
    bottom = lowest - _BELOW
    kept = np.maximum(np.where(np.isnan(levels), bottom, levels), bottom)
    before = (view.towards < 0).astype(np.int64)
    widths = [(int(b), int(1 - b)) for b in before]
    return np.pad(kept, widths, constant_values=bottom).astype(np.float32), before


def cast_layers(
    levels: NDArray[np.float32],
    lower: Floats,
    spacing: Floats,
    surfaces: tuple[float, ...],
    view: View,
    pixel: float,
) -> Layers:
    """First crossings of rays with isosurfaces, plane by plane from the viewer's side.

    All rays are parallel, so that each plane of the volume is met on a raster that is only shifted
    against those of the planes before: interpolation in it is a product along its two axes."""
    deep = int(np.argmax(np.abs(view.towards)))
    flat = tuple(a for a in range(3) if a != deep)
    step = spacing * view.stretch
    planes = np.moveaxis(levels, deep, 0)
    shear = [view.towards[a] / view.towards[deep] * step[deep] / step[a] for a in flat]
    axes = np.eye(3) @ np.stack([view.right, view.up], axis=-1)  # of the page, per unit of length
    rasters = []
    for a, slope in zip(flat, shear, strict=True):
        drift = -slope * (len(planes) - 1)
        count = levels.shape[a] - 1
        fine = pixel / (np.linalg.norm(axes[a]) * step[a])
        rasters.append(np.arange(min(0.0, drift), count + max(0.0, drift) + fine, fine))
    depths = np.full((len(surfaces), *(len(r) for r in rasters)), np.nan, dtype=np.float32)
    misses = np.ones(depths.shape, dtype=bool)
    before = np.full(depths.shape[1:], levels.min(), dtype=np.float32)
    near, far = (0, len(planes) - 1) if view.towards[deep] < 0 else (len(planes) - 1, 0)
    between = -(-_STEPS // (len(planes) - 1))
    back = (near - far) / (abs(near - far) * between)
    for s in np.linspace(near, far, between * (len(planes) - 1) + 1):
        whole = min(int(s), len(planes) - 2)
        plane = planes[whole] + np.float32(s - whole) * (planes[whole + 1] - planes[whole])
        rows, columns = (r + k * s for r, k in zip(rasters, shear, strict=True))
        part = _within(rows, plane.shape[0]), _within(columns, plane.shape[1])
        now = _sheared(plane, rows[part[0]], columns[part[1]])
        for depth, missed, surface in zip(depths, misses, surfaces, strict=True):
            new = np.nonzero(missed[part] & (now >= surface))
            first, last = before[part][new], now[new]
            depth[part][new] = s + back * (last - surface) / (last - first)
            missed[part][new] = False
        before[part] = now
    normals = _normals(levels, depths, rasters, shear, deep, step)
    origin = view.on_page(lower) + sum(
        r[0] * step[a] * axes[a] for a, r in zip(flat, rasters, strict=True)
    )
    down, along = ((r[1] - r[0]) * step[a] * axes[a] for a, r in zip(flat, rasters, strict=True))
    return Layers(normals, origin, down, along)


def _within(places: Floats, count: int) -> slice:
    """The range of rising indices that lie in 0 ... count - 1."""
    return slice(*np.searchsorted(places, (0.0, count - 1), side="left"))


def _sheared(plane: NDArray[np.float32], rows: Floats, columns: Floats) -> NDArray[np.float32]:
    """A plane (m, n) at real indices along both axes, linear between samples."""
    (i, fi), (j, fj) = (_index(k, n) for k, n in zip((rows, columns), plane.shape, strict=True))
    bands = plane[i] * (1 - fi)[:, None] + plane[i + 1] * fi[:, None]
    return np.asarray(bands[:, j] * (1 - fj) + bands[:, j + 1] * fj, dtype=np.float32)


def _index(places: Floats, count: int) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
    """Whole and fractional parts of indices, kept inside 0 ... count - 1."""
    inside = np.clip(places, 0, count - 1)
    whole = np.minimum(inside.astype(np.int64), count - 2)
    return whole, (inside - whole).astype(np.float32)


def _normals(
    levels: NDArray[np.float32],
    depths: NDArray[np.float32],
    rasters: list[Floats],
    shear: list[float],
    deep: int,
    step: Floats,
) -> NDArray[np.float32]:
    """Unit vectors down the gradient of the levels, which is interpolated like the levels."""
    slopes = [np.gradient(levels, axis=a) / step[a] for a in range(3)]
    gradient = np.stack(slopes, axis=-1).astype(np.float32)
    normals = np.zeros((*depths.shape, 3), dtype=np.float32)
    hit = np.isfinite(depths)
    _, i, j = np.nonzero(hit)
    s = depths[hit].astype(np.float64)
    places = [rasters[0][i] + shear[0] * s, rasters[1][j] + shear[1] * s]
    places.insert(deep, s)
    found = _interpolated(gradient, places)
    size = np.linalg.norm(found, axis=-1, keepdims=True)
    normals[hit] = -found / np.where(size > 0, size, 1)
    return normals


def _interpolated(values: NDArray[np.float32], places: list[Floats]) -> NDArray[np.float32]:
    """Trilinear values (m, 3) of (nx, ny, nz, 3) at m places given by real indices."""
    parts = [_index(p, n) for p, n in zip(places, values.shape, strict=False)]
    total = np.zeros((len(places[0]), values.shape[-1]), dtype=np.float32)
    for corner in range(8):
        bits = [(corner >> a) & 1 for a in range(3)]
        weight = np.ones(len(places[0]), dtype=np.float32)
        for (_, fraction), bit in zip(parts, bits, strict=True):
            weight *= fraction if bit else 1 - fraction
        index = tuple(whole + bit for (whole, _), bit in zip(parts, bits, strict=True))
        total += weight[:, None] * values[index]
    return total


def pyvista_layers(
    levels: NDArray[np.float32],
    lower: Floats,
    spacing: Floats,
    surfaces: tuple[float, ...],
    view: View,
    pixel: float,
) -> Layers:
    """The layers of :func:`cast_layers`, from contoured meshes."""
    if importlib.util.find_spec("pyvista") is None:
        raise missing_extra("pyvista", "volume", "draws isosurfaces")
    upper = lower + spacing * (np.array(levels.shape) - 1)
    page = view.corners(lower, upper)
    middle = (page.min(axis=0) + page.max(axis=0)) / 2
    columns, rows = np.ceil(np.ptp(page, axis=0) / pixel).astype(int) + 2
    settings = {
        "levels": levels,
        "origin": lower * view.stretch,
        "spacing": spacing * view.stretch,
        "surfaces": surfaces,
        "towards": view.towards,
        "up": view.up,
        "middle": middle[0] * view.right + middle[1] * view.up,
        "size": (int(columns), int(rows)),
        "height": rows * pixel,
        "far": float(np.linalg.norm((upper - lower) * view.stretch)),
    }
    normals = _drawn(settings)
    origin = middle + pixel * np.array([-(columns - 1) / 2, (rows - 1) / 2])
    return Layers(normals, origin, np.array([0.0, -pixel]), np.array([pixel, 0.0]))


def _drawn(settings: dict[str, Any]) -> NDArray[np.float32]:
    """The normals of each surface (n, rows, columns, 3)."""
    import pyvista

    levels = settings["levels"]
    grid = pyvista.ImageData(
        dimensions=levels.shape, spacing=settings["spacing"], origin=settings["origin"]
    )
    grid["level"] = levels.ravel(order="F")
    plotter = pyvista.Plotter(off_screen=True, window_size=settings["size"], lighting="none")
    plotter.enable_parallel_projection()
    camera = plotter.camera
    camera.focal_point = settings["middle"]
    camera.position = settings["middle"] + 4 * settings["far"] * settings["towards"]
    camera.up = settings["up"]
    layers = []
    for surface in settings["surfaces"]:
        mesh = grid.contour([surface], "level", compute_normals=True)
        layers.append(_normals_of(plotter, mesh, settings))
    return np.stack(layers)


def _normals_of(plotter: Any, mesh: Any, settings: dict[str, Any]) -> NDArray[np.float32]:
    """The normals of a mesh as the plotter's camera sees them: drawn as unlit colours."""
    normals = np.zeros((*settings["size"][::-1], 3), dtype=np.float32)
    if mesh.n_points == 0:
        return normals
    # VTK's normals of contours follow the gradient downwards: out of what is enclosed.
    out = np.asarray(mesh.point_data["Normals"])
    colours = np.round((out + 1) * 127.5).astype(np.uint8)
    actor = plotter.add_mesh(mesh, scalars=colours, rgb=True, lighting=False, reset_camera=False)
    camera = plotter.camera
    camera.parallel_scale = settings["height"] / 2
    camera.clipping_range = (settings["far"], 8 * settings["far"])
    picture = plotter.screenshot(None, return_img=True, transparent_background=True)
    plotter.remove_actor(actor)
    seen = picture[..., 3] == 255
    found = picture[seen][:, :3].astype(np.float32) / 127.5 - 1
    normals[seen] = found / np.linalg.norm(found, axis=-1, keepdims=True)
    return normals


def shaded(layers: Layers, colours: Floats, opacities: Floats, view: View) -> Floats:
    """One picture (rows, columns, 4), RGBA from 0 to 1, of all layers over each other."""
    light = view.towards + 0.9 * view.up - 0.6 * view.right
    light = light / np.linalg.norm(light)
    half = (light + view.towards) / np.linalg.norm(light + view.towards)
    rows, columns = layers.normals.shape[1:3]
    picture = np.zeros((rows, columns, 4))
    for normals, colour, opacity in zip(
        layers.normals[::-1], colours[::-1], opacities[::-1], strict=True
    ):
        facing = np.abs(normals @ view.towards.astype(np.float32))
        lit = _AMBIENT + _DIFFUSE * np.clip(normals @ light.astype(np.float32), 0, 1)
        shine = _SPECULAR * np.clip(normals @ half.astype(np.float32), 0, 1) ** _SHININESS
        seen = np.clip(lit[..., None] * colour + shine[..., None], 0, 1)
        alpha = opacity + (1 - opacity) * _RIM * (1 - facing) ** 3
        alpha = np.where(np.any(normals != 0, axis=-1), alpha, 0.0)[..., None]
        # `over` of premultiplied colours
        picture[..., :3] = alpha * seen + (1 - alpha) * picture[..., :3]
        picture[..., 3:] = alpha + (1 - alpha) * picture[..., 3:]
    opaque = np.where(picture[..., 3:] > 0, picture[..., 3:], 1)
    picture[..., :3] /= opaque
    return np.clip(picture, 0, 1)
