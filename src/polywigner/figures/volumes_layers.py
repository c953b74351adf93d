"""Isosurfaces as layers of normals on a raster, by casting rays in NumPy, and their shading.

A layer holds, for each pixel, the outward normal of one isosurface where the ray of that pixel
first meets it. What is above a level is taken to end at the faces of the box that are turned to the
viewer, so that a ray meets every surface before those of higher levels, which it encloses, and
layers can be laid over each other in their order.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from polywigner.figures.volumes_view import View

__all__ = ["Layers", "cast_layers", "closed", "shaded"]

Floats = NDArray[np.float64]

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
    """dB values with one more layer of low ones on the three faces turned to the viewer.

    Parameters
    ----------
    levels : (nx, ny, nz) dB; minus infinity and nan count as low.
    lowest : of the isosurfaces, dB.

    Returns
    -------
    The values, none lower than is of use, and (3,) how many were put before the first of each axis.
    """
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
    against those of the planes before: interpolation in it is a product along its two axes.

    Parameters
    ----------
    levels : (nx, ny, nz) dB, evenly spaced, low on faces turned to the viewer (:func:`closed`).
    lower, spacing : (3,) m: place of ``levels[0, 0, 0]``, distances of neighbours.
    surfaces : levels of the surfaces, dB.
    pixel : size of a pixel, page coordinates.
    """
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
    """Which of rising indices lie in 0 ... count - 1."""
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


def shaded(layers: Layers, colours: Floats, opacities: Floats, view: View) -> Floats:
    """One picture (rows, columns, 4), RGBA from 0 to 1, of all layers over each other.

    Parameters
    ----------
    layers : from the lowest level, the outermost surface, to the highest.
    colours, opacities : (n, 3) and (n,), from 0 to 1, of the layers.
    """
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
