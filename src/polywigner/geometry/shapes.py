"""Catalogue of apertures, in the plane and on a line.

Lengths are in metres; any other unit works if it is used consistently. The centre of the bounds is
the origin unless stated otherwise. All functions raise ArgumentError for lengths that are not
finite and above zero, and for inconsistent sizes.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from polywigner.errors import ArgumentError
from polywigner.geometry.aperture import Aperture
from polywigner.geometry.arguments import checked_count as _count
from polywigner.geometry.arguments import checked_flag, finite_array
from polywigner.geometry.arguments import checked_length as _length
from polywigner.geometry.arguments import checked_number as _number
from polywigner.geometry.parts import part_of_rings
from polywigner.geometry.rings import Ring
from polywigner.geometry.slits import Slits

__all__ = [
    "bow_tie",
    "chevron",
    "chevron_pair",
    "disc",
    "double_slit",
    "grating",
    "hexagonal_segments",
    "interferometer",
    "rectangle",
    "regular_polygon",
    "ring",
    "slit",
    "slit_pair",
    "square",
    "star",
    "triangle",
    "u_shape",
    "vee",
]


def _pair(values: Any, name: str) -> Ring:
    """Return two finite numbers as an array (2,); raise ArgumentError for other values."""
    return finite_array(values, f"expected {name} to be a pair of finite numbers", (2,))


def _require(fits: bool, expected: str, **got: Any) -> None:
    """Raise ArgumentError with the expected and the actual values, unless ``fits`` is true."""
    if not fits:
        values = ", ".join(f"{name}={value!r}" for name, value in got.items())
        raise ArgumentError(f"expected {expected}, got {values}")


def _circle(radius: float, n: int) -> Ring:
    """Return n equally spaced points (n, 2) on a circle, counter-clockwise from (radius, 0)."""
    angle = 2 * np.pi * np.arange(n) / n
    return radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)


def _equal_area_factor(n: int) -> float:
    """Return the circumradius of a regular n-gon with the area of the unit disc."""
    step = 2 * math.pi / n
    return math.sqrt(step / math.sin(step))


def _box(x: float, y: float, width: float, height: float) -> list[tuple[float, float]]:
    """Return the corners of a rectangle with its centre at (x, y), counter-clockwise."""
    left, right, bottom, top = x - width / 2, x + width / 2, y - height / 2, y + height / 2
    return [(left, bottom), (right, bottom), (right, top), (left, top)]


def rectangle(a: float, b: float) -> Aperture:
    """Return a rectangle centred at the origin.

    Parameters
    ----------
    a : float
        Width along x in metres.
    b : float
        Height along y in metres.

    Returns
    -------
    Aperture
        The rectangle.
    """
    return Aperture(_box(0.0, 0.0, _length(a, "a"), _length(b, "b")))


def square(a: float) -> Aperture:
    """Return a square centred at the origin, with sides along x and y.

    Parameters
    ----------
    a : float
        Side length in metres.

    Returns
    -------
    Aperture
        The square.
    """
    return rectangle(a, a)


def triangle(base: float, height: float) -> Aperture:
    """Return an isosceles triangle with its apex towards +y.

    Parameters
    ----------
    base : float
        Length of the side along x in metres.
    height : float
        Height along y in metres.

    Returns
    -------
    Aperture
        The triangle.
    """
    x, y = _length(base, "base") / 2, _length(height, "height") / 2
    return Aperture([(-x, -y), (x, -y), (0.0, y)])


def regular_polygon(n: int, radius: float) -> Aperture:
    """Return a regular polygon around the origin, with one vertex on the +x axis.

    Parameters
    ----------
    n : int
        Number of vertices, at least 3.
    radius : float
        Radius of the circumscribed circle in metres.

    Returns
    -------
    Aperture
        The polygon.
    """
    return Aperture(_circle(_length(radius, "radius"), _count(n, "n", 3)))


def disc(radius: float, n: int = 64) -> Aperture:
    """Return a regular polygon around the origin with the area of a disc.

    Parameters
    ----------
    radius : float
        Radius of the disc in metres.
    n : int, default 64
        Number of vertices, at least 3.

    Returns
    -------
    Aperture
        The polygon.

    Notes
    -----
    The vertices lie outside the disc by a factor of about 1 + pi^2/(3 n^2), 1.0008 for 64 vertices.
    Pass the radius of the disc as ``pupil_radius`` to :func:`polywigner.otf`, whose default is the
    radius of the vertices.
    """
    sides = _count(n, "n", 3)
    return Aperture(_circle(_length(radius, "radius") * _equal_area_factor(sides), sides))


def ring(outer: float, inner: float, n: int = 64) -> Aperture:
    """Return an annulus around the origin, between two polygons with the areas of discs.

    Parameters
    ----------
    outer : float
        Radius of the outer disc in metres.
    inner : float
        Radius of the inner disc in metres.
    n : int, default 64
        Number of vertices of each polygon, at least 3.

    Returns
    -------
    Aperture
        The annulus.
    """
    sides = _count(n, "n", 3)
    large, small = _length(outer, "outer"), _length(inner, "inner")
    _require(small < large, "inner to be smaller than outer", outer=outer, inner=inner)
    factor = _equal_area_factor(sides)
    circles = [_circle(radius * factor, sides) for radius in (large, small)]
    return Aperture._of_parts([part_of_rings(circles)])


def star(points: int, outer: float, inner: float) -> Aperture:
    """Return a star around the origin, with one tip on the +x axis.

    Parameters
    ----------
    points : int
        Number of tips, at least 2.
    outer : float
        Radius of the tips in metres.
    inner : float
        Radius of the inner corners in metres.

    Returns
    -------
    Aperture
        The star.
    """
    tips = _count(points, "points", 2)
    large, small = _length(outer, "outer"), _length(inner, "inner")
    _require(small < large, "inner to be smaller than outer", outer=outer, inner=inner)
    vertices = _circle(large, 2 * tips)
    vertices[1::2] *= small / large
    return Aperture(vertices)


def _chevron_vertices(width: Any, height: Any, thickness: Any) -> Ring:
    """Return vertices (6, 2) of a centred chevron; raise ArgumentError for inconsistent sizes."""
    x, y = _length(width, "width") / 2, _length(height, "height") / 2
    t = _length(thickness, "thickness")
    _require(t < 2 * y, "thickness to be smaller than height", thickness=thickness, height=height)
    return np.array([(-x, -y), (0.0, y - t), (x, -y), (x, t - y), (0.0, y), (-x, t - y)])


def chevron(width: float, height: float, thickness: float) -> Aperture:
    """Return an arrow head towards +y, made of two slanted bands.

    Parameters
    ----------
    width : float
        Overall width along x in metres.
    height : float
        Overall height along y in metres.
    thickness : float
        Thickness of the bands along y in metres.

    Returns
    -------
    Aperture
        The chevron.
    """
    return Aperture(_chevron_vertices(width, height, thickness))


def chevron_pair(
    width: float, height: float, thickness: float, offset: ArrayLike | None = None
) -> Aperture:
    """Return two equal chevrons, which may touch but not overlap.

    Parameters
    ----------
    width, height, thickness : float
        Sizes of each chevron in metres, as for :func:`chevron`.
    offset : array_like, shape (2,), optional
        Displacement of the second chevron from the first in metres. The default is 1.5 thicknesses
        along y, so that one chevron follows the other at a distance of half a thickness.

    Returns
    -------
    Aperture
        The pair, centred at the origin.

    Raises
    ------
    GeometryError
        If the chevrons overlap.
    """
    vertices = _chevron_vertices(width, height, thickness)
    shift = _pair((0.0, 1.5 * thickness) if offset is None else offset, "offset")
    return Aperture([vertices - shift / 2, vertices + shift / 2])


def vee(width: float, height: float, thickness: float) -> Aperture:
    """Return a letter V: two arms from the tip at the bottom to a flat top.

    Parameters
    ----------
    width : float
        Overall width along x in metres.
    height : float
        Overall height along y in metres.
    thickness : float
        Thickness of the arms in metres, measured across each arm.

    Returns
    -------
    Aperture
        The letter.
    """
    x, y = _length(width, "width") / 2, _length(height, "height") / 2
    t = _length(thickness, "thickness")
    length = math.hypot(x, 2 * y)
    # Extent of a slanted arm along x and along y.
    across, along = t * length / (2 * y), t * length / x
    _require(
        across < x,
        "a thickness that leaves a gap between the arms",
        thickness=thickness,
        width=width,
    )
    return Aperture(
        [(-x, y), (0.0, -y), (x, y), (x - across, y), (0.0, along - y), (across - x, y)]
    )


def u_shape(width: float, height: float, thickness: float) -> Aperture:
    """Return a letter U: a rectangle with a slot from the top.

    Parameters
    ----------
    width : float
        Overall width along x in metres.
    height : float
        Overall height along y in metres.
    thickness : float
        Thickness of the walls around the slot in metres.

    Returns
    -------
    Aperture
        The letter.
    """
    x, y = _length(width, "width") / 2, _length(height, "height") / 2
    t = _length(thickness, "thickness")
    fits = t < x and t < 2 * y
    _require(
        fits, "a thickness that leaves a slot", thickness=thickness, width=width, height=height
    )
    slot = [(x - t, y), (x - t, t - y), (t - x, t - y), (t - x, y)]
    return Aperture([(-x, y), (-x, -y), (x, -y), (x, y), *slot])


def bow_tie(width: float, height: float, gap: float = 0.0) -> Aperture:
    """Return two triangles whose tips face each other on the x axis.

    Parameters
    ----------
    width : float
        Overall width along x in metres.
    height : float
        Length of the outer sides along y in metres.
    gap : float, default 0.0
        Distance between the tips in metres; they touch if it is zero.

    Returns
    -------
    Aperture
        The bow tie.
    """
    x, y = _length(width, "width") / 2, _length(height, "height") / 2
    g = _length(gap, "gap", zero=True) / 2
    _require(g < x, "gap to be smaller than width", gap=gap, width=width)
    return Aperture([[(-x, -y), (-g, 0.0), (-x, y)], [(x, -y), (x, y), (g, 0.0)]])


def double_slit(widths: ArrayLike, height: float, offsets: ArrayLike) -> Aperture:
    """Return two slits along y in the plane, at given positions along x.

    Parameters
    ----------
    widths : float or array_like, shape (2,)
        Width of each slit along x in metres; one number for two equal slits.
    height : float
        Length of the slits along y in metres, centred at y = 0.
    offsets : array_like, shape (2,)
        Position of the centre of each slit along x in metres.

    Returns
    -------
    Aperture
        The slits.

    Raises
    ------
    GeometryError
        If the slits overlap.
    """
    y = _length(height, "height")
    return Aperture([_box(x, 0.0, width, y) for x, width in _two_slits(widths, offsets)])


def _two_slits(widths: ArrayLike, offsets: ArrayLike) -> list[tuple[float, float]]:
    """Return the centre and the width of each of two slits."""
    single = np.isscalar(widths) or getattr(widths, "ndim", None) == 0
    pair = _pair((widths, widths) if single else widths, "widths")
    centres = _pair(offsets, "offsets")
    return [(float(x), _length(float(w), "widths")) for x, w in zip(centres, pair, strict=True)]


def slit(width: float, offset: float = 0.0) -> Slits:
    """Return a one-dimensional slit.

    Parameters
    ----------
    width : float
        Width of the slit in metres.
    offset : float, default 0.0
        Position of the centre in metres.

    Returns
    -------
    Slits
        The slit.
    """
    half = _length(width, "width") / 2
    centre = _number(offset, "offset", "a finite number")
    return Slits([centre - half, centre + half])


def slit_pair(widths: ArrayLike, offsets: ArrayLike) -> Slits:
    """Return a one-dimensional double slit.

    Parameters
    ----------
    widths : float or array_like, shape (2,)
        Width of each slit in metres; one number for two equal slits.
    offsets : array_like, shape (2,)
        Position of the centre of each slit in metres.

    Returns
    -------
    Slits
        The slits.

    Raises
    ------
    GeometryError
        If the slits overlap.
    """
    return Slits([(x - width / 2, x + width / 2) for x, width in _two_slits(widths, offsets)])


def grating(count: int, width: float, pitch: float) -> Slits:
    """Return a one-dimensional grating of equal slits, centred at the origin.

    Parameters
    ----------
    count : int
        Number of slits.
    width : float
        Width of each slit in metres.
    pitch : float
        Distance between the centres of neighbouring slits in metres, at least the width.

    Returns
    -------
    Slits
        The grating.
    """
    number = _count(count, "count", 1)
    half, step = _length(width, "width") / 2, _length(pitch, "pitch")
    _require(step >= 2 * half, "pitch to be at least width", pitch=pitch, width=width)
    centres = (np.arange(number) - (number - 1) / 2) * step
    return Slits(np.column_stack([centres - half, centres + half]))


def _hexagon_centres(rings: int, centre: bool) -> list[tuple[int, int]]:
    """Return the centres of honeycomb cells.

    The units are 3/2 times the side of a cell along x, and half its height along y.

    ``rings``: number of rings around the central cell. ``centre``: whether to include that cell.
    """
    columns = range(-rings, rings + 1)
    cells = [(q, 2 * r + q) for q in columns for r in columns if abs(q + r) <= rings]
    return [cell for cell in cells if centre or cell != (0, 0)]


def hexagonal_segments(
    flat_to_flat: float, gap: float = 0.0, rings: int = 2, centre: bool = False
) -> Aperture:
    """Return a segmented mirror: hexagons in rings around a central cell.

    Parameters
    ----------
    flat_to_flat : float
        Height of each hexagon in metres; its flat sides face +y and -y.
    gap : float, default 0.0
        Distance between facing sides in metres.
    rings : int, default 2
        Number of rings. Two rings have 18 segments.
    centre : bool, default False
        Whether the central cell has a segment.

    Returns
    -------
    Aperture
        The mirror. If ``gap`` is zero, its outline is one polygon, but ``.segments`` are separate.

    Notes
    -----
    The segments are numbered by columns from the lowest to the highest x, and from the lowest to
    the highest y within a column. This numbering is the order of ``.segments``, and of the pistons
    and tilts of :func:`polywigner.segmented_pupil`.
    """
    flat, space = _length(flat_to_flat, "flat_to_flat"), _length(gap, "gap", zero=True)
    has_centre = checked_flag(centre, "centre")
    cells = _hexagon_centres(_count(rings, "rings", 0 if has_centre else 1), has_centre)
    corners = np.array([(2, 0), (1, 1), (-1, 1), (-2, 0), (-1, -1), (1, -1)], dtype=np.float64)
    # Units of the corner coordinates: half a side along x, and half the height along y.
    unit = np.array([flat / math.sqrt(12.0), flat / 2])
    extra = np.array([space / math.sqrt(12.0), space / 2])
    centres = np.array([(3 * q, m) for q, m in cells], dtype=np.float64)
    with np.errstate(over="ignore"):
        return Aperture._of_segments([(corners + at) * unit + at * extra for at in centres])


def interferometer(positions: ArrayLike, radius: float, n: int = 32) -> Aperture:
    """Return equal discs at given positions.

    Parameters
    ----------
    positions : array_like, shape (m, 2)
        Centres of the discs in metres.
    radius : float
        Radius of each disc in metres, see :func:`disc`.
    n : int, default 32
        Number of vertices of each disc.

    Returns
    -------
    Aperture
        The discs.

    Raises
    ------
    GeometryError
        If discs overlap.
    """
    shifts = finite_array(positions, "expected positions to be an (m, 2) array", (None, 2))
    circle = disc(radius, n).rings[0]
    return Aperture([circle + shift for shift in shifts])


def __dir__() -> list[str]:
    """Return the names of the shapes."""
    return sorted(__all__)
