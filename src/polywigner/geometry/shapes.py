"""Catalogue of apertures, in the plane and on a line.

Lengths are in metres (any one consistent unit works). The centre of the bounds is the origin
unless stated otherwise. ``slit``, ``slit_pair`` and ``grating`` return :class:`polywigner.Slits`,
the other functions a :class:`polywigner.Aperture`. All raise ArgumentError for lengths that are
not finite and above zero, and for inconsistent sizes.
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
    return finite_array(values, f"expected {name} as a pair of finite numbers", (2,))


def _require(fits: bool, expected: str, **got: Any) -> None:
    if not fits:
        values = ", ".join(f"{name}={value!r}" for name, value in got.items())
        raise ArgumentError(f"expected {expected}, got {values}")


def _circle(radius: float, n: int) -> Ring:
    angle = 2 * np.pi * np.arange(n) / n
    return radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)


def _equal_area_factor(n: int) -> float:
    """Circumradius of the regular n-gon that has the area of the unit disc."""
    step = 2 * math.pi / n
    return math.sqrt(step / math.sin(step))


def _box(x: float, y: float, width: float, height: float) -> list[tuple[float, float]]:
    """Rectangle around (x, y)."""
    left, right, bottom, top = x - width / 2, x + width / 2, y - height / 2, y + height / 2
    return [(left, bottom), (right, bottom), (right, top), (left, top)]


def rectangle(a: float, b: float) -> Aperture:
    """Rectangle of width a along x and height b along y."""
    return Aperture(_box(0.0, 0.0, _length(a, "a"), _length(b, "b")))


def square(a: float) -> Aperture:
    """Square of side a."""
    return rectangle(a, a)


def triangle(base: float, height: float) -> Aperture:
    """Isosceles triangle, base below and apex towards +y."""
    x, y = _length(base, "base") / 2, _length(height, "height") / 2
    return Aperture([(-x, -y), (x, -y), (0.0, y)])


def regular_polygon(n: int, radius: float) -> Aperture:
    """Regular n-gon around the origin; radius of the circumscribed circle, first vertex on +x."""
    return Aperture(_circle(_length(radius, "radius"), _count(n, "n", 3)))


def disc(radius: float, n: int = 64) -> Aperture:
    """Regular n-gon around the origin with the area of a disc of the given radius.

    The vertices lie outside the disc by a factor of 1 + pi^2/(3 n^2), 1.0008 for 64. Pass the
    radius of the disc as ``pupil_radius`` to :func:`polywigner.otf`, whose default is the radius of
    the vertices.
    """
    sides = _count(n, "n", 3)
    return Aperture(_circle(_length(radius, "radius") * _equal_area_factor(sides), sides))


def ring(outer: float, inner: float, n: int = 64) -> Aperture:
    """Annulus of the given radii around the origin; both circles as n-gons of equal area."""
    sides = _count(n, "n", 3)
    large, small = _length(outer, "outer"), _length(inner, "inner")
    _require(small < large, "inner below outer", outer=outer, inner=inner)
    factor = _equal_area_factor(sides)
    circles = [_circle(radius * factor, sides) for radius in (large, small)]
    return Aperture._of_parts([part_of_rings(circles)])


def star(points: int, outer: float, inner: float) -> Aperture:
    """Star around the origin: tips at radius outer, the first on +x, dents at radius inner."""
    tips = _count(points, "points", 2)
    large, small = _length(outer, "outer"), _length(inner, "inner")
    _require(small < large, "inner below outer", outer=outer, inner=inner)
    vertices = _circle(large, 2 * tips)
    vertices[1::2] *= small / large
    return Aperture(vertices)


def _chevron_vertices(width: Any, height: Any, thickness: Any) -> Ring:
    x, y = _length(width, "width") / 2, _length(height, "height") / 2
    t = _length(thickness, "thickness")
    _require(t < 2 * y, "thickness below height", thickness=thickness, height=height)
    return np.array([(-x, -y), (0.0, y - t), (x, -y), (x, t - y), (0.0, y), (-x, t - y)])


def chevron(width: float, height: float, thickness: float) -> Aperture:
    """Arrow head towards +y: two slanted bands of the given thickness along y."""
    return Aperture(_chevron_vertices(width, height, thickness))


def chevron_pair(
    width: float, height: float, thickness: float, offset: ArrayLike | None = None
) -> Aperture:
    """Two equal chevrons, the second displaced from the first by offset (dx, dy).

    The default offset is 1.5 thicknesses along y: one chevron behind the other, half a thickness
    apart. They may touch but not overlap (GeometryError).
    """
    vertices = _chevron_vertices(width, height, thickness)
    shift = _pair((0.0, 1.5 * thickness) if offset is None else offset, "offset")
    return Aperture([vertices - shift / 2, vertices + shift / 2])


def vee(width: float, height: float, thickness: float) -> Aperture:
    """Letter V: two arms of the given thickness (across the arm) from the tip up to a flat top."""
    x, y = _length(width, "width") / 2, _length(height, "height") / 2
    t = _length(thickness, "thickness")
    length = math.hypot(x, 2 * y)
    across, along = t * length / (2 * y), t * length / x  # the arm's extent along x and along y
    _require(across < x, "thickness to leave a gap", thickness=thickness, width=width)
    return Aperture(
        [(-x, y), (0.0, -y), (x, y), (x - across, y), (0.0, along - y), (across - x, y)]
    )


def u_shape(width: float, height: float, thickness: float) -> Aperture:
    """Letter U: a rectangle with a slot from the top that leaves walls of the given thickness."""
    x, y = _length(width, "width") / 2, _length(height, "height") / 2
    t = _length(thickness, "thickness")
    fits = t < x and t < 2 * y
    _require(fits, "thickness to leave a slot", thickness=thickness, width=width, height=height)
    slot = [(x - t, y), (x - t, t - y), (t - x, t - y), (t - x, y)]
    return Aperture([(-x, y), (-x, -y), (x, -y), (x, y), *slot])


def bow_tie(width: float, height: float, gap: float = 0.0) -> Aperture:
    """Two triangles, tips facing each other on the x axis at a distance gap (0: they touch).

    `width` overall along x, `height` of the outer edges along y.
    """
    x, y = _length(width, "width") / 2, _length(height, "height") / 2
    g = _length(gap, "gap", zero=True) / 2
    _require(g < x, "gap below width", gap=gap, width=width)
    return Aperture([[(-x, -y), (-g, 0.0), (-x, y)], [(x, -y), (x, y), (g, 0.0)]])


def double_slit(widths: ArrayLike, height: float, offsets: ArrayLike) -> Aperture:
    """Two slits along y, of the widths (w1, w2), centred at x = offsets (x1, x2) and y = 0.

    One number for `widths` means two equal slits. The slits are not centred.
    """
    y = _length(height, "height")
    return Aperture([_box(x, 0.0, width, y) for x, width in _two_slits(widths, offsets)])


def _two_slits(widths: ArrayLike, offsets: ArrayLike) -> list[tuple[float, float]]:
    """(centre, width) of two slits; one number for `widths` means two equal ones."""
    single = np.isscalar(widths) or getattr(widths, "ndim", None) == 0
    pair = _pair((widths, widths) if single else widths, "widths")
    centres = _pair(offsets, "offsets")
    return [(float(x), _length(float(w), "widths")) for x, w in zip(centres, pair, strict=True)]


def slit(width: float, offset: float = 0.0) -> Slits:
    """One-dimensional slit, centred at x = offset."""
    half = _length(width, "width") / 2
    centre = _number(offset, "offset", "a finite number")
    return Slits([centre - half, centre + half])


def slit_pair(widths: ArrayLike, offsets: ArrayLike) -> Slits:
    """One-dimensional double slit of the widths (w1, w2), centred at x = offsets (x1, x2).

    One number for `widths` means two equal slits. The slits are not centred. Slits
    that overlap raise GeometryError.
    """
    return Slits([(x - width / 2, x + width / 2) for x, width in _two_slits(widths, offsets)])


def grating(count: int, width: float, pitch: float) -> Slits:
    """One-dimensional grating: equal slits, the pitch apart from centre to centre."""
    number = _count(count, "count", 1)
    half, step = _length(width, "width") / 2, _length(pitch, "pitch")
    _require(step >= 2 * half, "pitch of at least width", pitch=pitch, width=width)
    centres = (np.arange(number) - (number - 1) / 2) * step
    return Slits(np.column_stack([centres - half, centres + half]))


def _hexagon_centres(rings: int, centre: bool) -> list[tuple[int, int]]:
    """Honeycomb cells out to a ring number, as multiples of (3/2 side, half the pitch)."""
    cells = []
    for q in range(-rings, rings + 1):
        for r in range(max(-rings, -rings - q), min(rings, rings - q) + 1):
            if centre or (q, r) != (0, 0):
                cells.append((q, 2 * r + q))
    return cells


def hexagonal_segments(
    flat_to_flat: float, gap: float = 0.0, rings: int = 2, centre: bool = False
) -> Aperture:
    """Return a segmented mirror: hexagons in rings around a centre cell, left out by default.

    `flat_to_flat` is the height of one hexagon (flat sides towards +y and -y), `gap` the distance
    between facing sides. Two rings make 18 segments.

    The segments are numbered column by column from the lowest x to the highest, and from the lowest
    y to the highest within a column. This is the order of `.segments`, and of the pistons and tilts
    of :func:`polywigner.segmented_pupil`. With gap 0 the outline is one polygon, but the segments
    stay apart in `.segments`.
    """
    flat, space = _length(flat_to_flat, "flat_to_flat"), _length(gap, "gap", zero=True)
    has_centre = checked_flag(centre, "centre")
    cells = _hexagon_centres(_count(rings, "rings", 0 if has_centre else 1), has_centre)
    corners = np.array([(2, 0), (1, 1), (-1, 1), (-2, 0), (-1, -1), (1, -1)], dtype=np.float64)
    # All corners are multiples of half a side along x and half a flat-to-flat along y.
    unit = np.array([flat / math.sqrt(12.0), flat / 2])
    extra = np.array([space / math.sqrt(12.0), space / 2])
    centres = np.array([(3 * q, m) for q, m in cells], dtype=np.float64)
    with np.errstate(over="ignore"):  # an Aperture raises the error
        return Aperture._of_segments([(corners + at) * unit + at * extra for at in centres])


def interferometer(positions: ArrayLike, radius: float, n: int = 32) -> Aperture:
    """Equal discs (n-gons of equal area) at the positions (m, 2), not centred."""
    shifts = finite_array(positions, "expected positions as an (m, 2) array", (None, 2))
    circle = disc(radius, n).rings[0]
    return Aperture([circle + shift for shift in shifts])


def __dir__() -> list[str]:
    return sorted(__all__)
