"""Where the autocorrelation of an aperture lives: its automean and the slices through it."""

from __future__ import annotations

from itertools import combinations_with_replacement

import shapely
from numpy.typing import ArrayLike

from polywigner.errors import ArgumentError
from polywigner.geometry.aperture import Aperture
from polywigner.geometry.exact import Ring
from polywigner.geometry.parts import polygons_in, union_on_grid
from polywigner.geometry.wavefront import checked_shift


def _require_aperture(aperture: Aperture) -> None:
    if not isinstance(aperture, Aperture):
        raise ArgumentError(
            f"expected an Aperture, got {type(aperture).__name__}; make one with "
            "polywigner.Aperture(vertices); the support of an Array is one"
        )


def _means(first: Ring, second: Ring) -> Ring:
    """Midpoints of all pairs of vertices; halving first is exact and cannot overflow."""
    return (first[:, None] / 2 + second[None, :] / 2).reshape(-1, 2)


def automean(aperture: Aperture) -> Aperture:
    """The mutual support {(a + b)/2 : a, b in the aperture} of u(x + xi/2) and u(x - xi/2).

    A set, whatever the illumination: W(x, nu) vanishes for x outside of it. A convex aperture is
    its own automean; any other has one larger than itself, inside its convex hull.

    The union of the convex hulls of the midpoints of all pairs of convex pieces. Midpoints keep
    their floats; vertices where outlines cross are rounded to 2^-44 of the size. Cost: pieces^2/2
    hulls and their union. Raises ArgumentError for anything but an Aperture.

    >>> import polywigner as pw
    >>> notch = pw.shapes.chevron(20e-3, 12e-3, 4e-3)
    >>> pw.automean(notch).area > notch.area
    True
    """
    _require_aperture(aperture)
    pieces = aperture.convex_cover
    if len(pieces) == 1:
        return aperture.with_illumination(None)
    midpoints = [_means(a, b) for a, b in combinations_with_replacement(pieces, 2)]
    hulls = shapely.convex_hull([shapely.MultiPoint(points) for points in midpoints])
    union = union_on_grid(list(hulls), shapely.get_coordinates(list(hulls)))
    return Aperture(union)


def _overlap(
    first: shapely.MultiPolygon, second: shapely.MultiPolygon
) -> shapely.Polygon | shapely.MultiPolygon:
    parts = polygons_in(shapely.intersection(first, second))
    return parts[0] if len(parts) == 1 else shapely.MultiPolygon(parts)


def lag_slice(aperture: Aperture, x: ArrayLike) -> shapely.Polygon | shapely.MultiPolygon:
    """The lags xi at which u(x + xi/2) u*(x - xi/2) is not zero: 2(G - x) and 2(x - G) both.

    `x`: a position, shape (2,), in the aperture's unit. An empty MultiPolygon if there is none.
    Differs from the paper, whose matrices translate by x: it must be 2x.

    Raises ArgumentError for anything but an Aperture, and for an `x` that is not two finite
    numbers.

    >>> import polywigner as pw
    >>> pw.lag_slice(pw.shapes.square(2.0), (0.5, 0.0)).area
    8.0
    """
    _require_aperture(aperture)
    position = checked_shift(x, 2, "a position x")
    shape = aperture.polygons
    return _overlap(
        shapely.transform(shape, lambda v: 2 * (v - position)),
        shapely.transform(shape, lambda v: 2 * (position - v)),
    )


def position_slice(aperture: Aperture, xi: ArrayLike) -> shapely.Polygon | shapely.MultiPolygon:
    """The positions x at which u(x + xi/2) u*(x - xi/2) is not zero: G shifted by -xi/2 and xi/2.

    `xi`: a lag, shape (2,), in the aperture's unit. An empty MultiPolygon if there is none.
    Differs from the paper, which shifts one copy only and so gets a wrong phase.

    Raises ArgumentError for anything but an Aperture, and for a `xi` that is not two finite
    numbers.

    >>> import polywigner as pw
    >>> pw.position_slice(pw.shapes.square(2.0), (0.5, 0.0)).area
    3.0
    """
    _require_aperture(aperture)
    half = checked_shift(xi, 2, "a lag xi") / 2
    shape = aperture.polygons
    return _overlap(
        shapely.transform(shape, lambda v: v - half), shapely.transform(shape, lambda v: v + half)
    )
