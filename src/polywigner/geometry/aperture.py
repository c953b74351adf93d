"""The aperture, an immutable set of polygons in the plane, its automean and slices."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cached_property
from itertools import combinations_with_replacement
from typing import TYPE_CHECKING, Any, final

import numpy as np
import shapely
from numpy.typing import ArrayLike, NDArray

from polywigner.errors import ArgumentError, GeometryError, IlluminationError
from polywigner.geometry.arguments import Immutable, Outline, checked_length, rigid_pose
from polywigner.geometry.convex import convex_pieces, triangulate_part
from polywigner.geometry.display import plot_rings
from polywigner.geometry.parts import (
    combined_on_grid,
    merge_parts,
    parts_from,
    polygons_in,
    split_ring,
    union_on_grid,
)
from polywigner.geometry.rings import Part, Ring, orientations, polygon_of_part, shoelace
from polywigner.geometry.wavefront import (
    Field,
    TakesWaves,
    checked_field,
    checked_shift,
    turned_points,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes


def _frozen(array: NDArray[Any]) -> NDArray[Any]:
    if not array.flags.writeable and array.flags.owndata:
        return array
    copy = np.ascontiguousarray(array).copy()
    copy.setflags(write=False)
    return copy


def _frozen_parts(parts: Sequence[Part]) -> tuple[Part, ...]:
    return tuple(tuple(map(_frozen, part)) for part in parts)


@final
class Aperture(TakesWaves):
    """An opening (or radiating patch) bounded by polygons; uniform unless given an illumination.

    Parameters
    ----------
    vertices : one ring (n, 2); a list of rings for separate parts; or a shapely Polygon or
        MultiPolygon, which may have holes. In metres (any one consistent unit works).

    Raises
    ------
    GeometryError
        A coordinate is not finite, a ring has fewer than three vertices or zero area, crosses or
        touches itself (see :meth:`from_ring`), a hole is outside its polygon, or parts overlap.

    Notes
    -----
    Orientation and starting vertex do not matter. Repeated vertices, and vertices within 2^-48
    area/diameter of the line between their neighbours, are dropped; the relative change of the
    area is below 1e-14. Parts that touch, up to 64 ulp of the largest coordinate, are merged.

    >>> import polywigner as pw
    >>> frame = pw.Aperture([[(0, 0), (3, 0), (3, 2), (0, 2)], [(5, 0), (6, 0), (6, 1)]])
    >>> frame.area, len(frame.rings)
    (6.5, 2)
    """

    _parts: tuple[Part, ...]
    _segments: tuple[Part, ...] | None
    """Segments that may touch; None: the parts."""
    illumination: Field | None
    """The field on the aperture, an Illumination; None for the field 1."""

    def __init__(self, vertices: Outline) -> None:
        self._set(merge_parts(parts_from(vertices)))

    def _set(
        self,
        parts: Sequence[Part],
        illumination: Field | None = None,
        segments: Sequence[Part] | None = None,
    ) -> None:
        object.__setattr__(self, "_parts", _frozen_parts(parts))
        object.__setattr__(self, "_segments", segments and _frozen_parts(segments))
        object.__setattr__(self, "illumination", illumination)

    @classmethod
    def _of_parts(
        cls,
        parts: Sequence[Part],
        illumination: Field | None = None,
        segments: Sequence[Part] | None = None,
    ) -> Aperture:
        """Make an aperture of valid parts."""
        aperture = object.__new__(cls)
        aperture._set(parts, illumination, segments)
        return aperture

    @classmethod
    def _of_segments(cls, rings: Sequence[Ring]) -> Aperture:
        """Make an aperture of simple rings that may touch, its :attr:`segments`."""
        parts = cls(rings)._parts
        return cls._of_parts(
            parts, None, [(ring,) for ring in rings] if len(parts) < len(rings) else None
        )

    def _mapped(
        self, image: Callable[[Ring], Ring], image_of_field: Callable[[Field], Field]
    ) -> Aperture:
        """Map the vertices and the field by a similarity."""
        field = self.illumination
        parts, segments = (
            parts and [tuple(map(image, part)) for part in parts]
            for parts in (self._parts, self._segments)
        )
        return Aperture._of_parts(parts or (), field and image_of_field(field), segments)

    @classmethod
    def from_ring(cls, ring: ArrayLike, winding: str = "nonzero") -> Aperture:
        """Make an aperture of the region that a ring (n, 2), which may cross itself, encloses.

        Parameters
        ----------
        ring : (n, 2) vertices in m. A bow-tie becomes two triangles that touch in a point.
        winding : "nonzero" for points with a winding number other than zero, "evenodd" for points
            with an odd winding number.

        Raises
        ------
        GeometryError
            A coordinate is not finite, there are fewer than three vertices, or the area is zero.
        ArgumentError
            The winding rule is unknown.
        """
        return cls._of_parts(split_ring(ring, winding))

    def with_illumination(self, illumination: Field | None) -> Aperture:
        """Return the aperture with another field, an Illumination; None for the field 1.

        Raises ArgumentError for objects of another type, IlluminationError for a field of slits.
        """
        field = None if illumination is None else checked_field(illumination, 2)
        return Aperture._of_parts(self._parts, field, self._segments)

    def moved(self, shift: ArrayLike) -> Aperture:
        """Return the aperture and its field shifted by (2,) m; vertices are rounded.

        Raises ArgumentError for a shift that is not two finite numbers.
        """
        offset = checked_shift(shift, 2)
        return self._mapped(lambda ring: ring + offset, lambda field: field.moved(offset))

    def turned(self, angle: float) -> Aperture:
        """Return the aperture and its field rotated counter-clockwise about the origin, in rad.

        Quarter turns are exact. Raises ArgumentError for an angle that is not a finite number.
        """
        return self._mapped(
            lambda ring: turned_points(ring, angle), lambda field: field.turned(angle)
        )

    @property
    def elements_in_plane(self) -> tuple[Aperture, ...]:
        """The aperture itself; an Array has several elements."""
        return (self,)

    def scaled(self, factor: float) -> Aperture:
        """Return the aperture and its field scaled about the origin by a factor.

        Raises ArgumentError for a factor that is not a finite number above zero.
        """
        size = checked_length(factor, "factor", meaning="a number above zero")
        return self._mapped(lambda ring: ring * size, lambda field: field.scaled(size))

    def __or__(self, other: Aperture) -> Aperture:
        """Return the union of two apertures with equal fields."""
        return self._combined(shapely.union, other)

    def __and__(self, other: Aperture) -> Aperture:
        """Return the intersection with another aperture, with the field of this aperture."""
        return self._combined(shapely.intersection, other)

    def __sub__(self, other: Aperture) -> Aperture:
        """Return the difference from another aperture, with the field of this aperture."""
        return self._combined(shapely.difference, other)

    def _combined(self, operation: Callable[..., Any], other: object) -> Aperture:
        if not isinstance(other, Aperture):
            return NotImplemented
        is_outline = other.illumination is None and operation is not shapely.union
        if not is_outline and other.illumination != self.illumination:
            raise IlluminationError(
                "expected apertures with equal fields, or a second aperture without a field, got "
                "different fields; remove a field by with_illumination(None)"
            )
        region = combined_on_grid(operation, self.polygons, other.polygons)
        if region.is_empty:
            raise GeometryError(
                "expected apertures that overlap in part, got an empty result: one covers the "
                "other, or they have no area in common"
            )
        return Aperture(region).with_illumination(self.illumination)

    def placed(self, to_world: ArrayLike) -> PlacedAperture:
        """Return this aperture in a rigid pose (4, 4), for transforms with three-component nu.

        Raises GeometryError for a matrix that is not a rotation and a translation.
        """
        return PlacedAperture(self, rigid_pose(to_world))

    @cached_property
    def rings(self) -> tuple[Ring, ...]:
        """The boundary without closing vertices: counter-clockwise exteriors, clockwise holes.

        Read-only arrays of shape (n, 2).
        """
        outer = tuple(part[0] for part in self._parts)
        return outer + tuple(hole for part in self._parts for hole in part[1:])

    @cached_property
    def polygons(self) -> shapely.MultiPolygon:
        """The parts as a shapely MultiPolygon: exteriors counter-clockwise, holes clockwise."""
        return shapely.MultiPolygon([polygon_of_part(part) for part in self._parts])

    @property
    def segments(self) -> tuple[Aperture, ...]:
        """The segments of a mirror as apertures, which may touch; else the separate parts.

        Each has this aperture's field. Only ``polywigner.shapes.hexagonal_segments`` makes
        segments that touch.
        """
        return tuple(
            Aperture._of_parts([part], self.illumination) for part in self._segments or self._parts
        )

    @cached_property
    def area(self) -> float:
        """Area, the exact value rounded once."""
        return float(shoelace(self.rings))

    @cached_property
    def bounds(self) -> tuple[float, float, float, float]:
        """(xmin, ymin, xmax, ymax)."""
        points = np.concatenate(self.rings)
        (xmin, ymin), (xmax, ymax) = points.min(axis=0).tolist(), points.max(axis=0).tolist()
        return xmin, ymin, xmax, ymax

    @cached_property
    def centre(self) -> Ring:
        """Centre of the bounds, shape (2,), read-only."""
        xmin, ymin, xmax, ymax = self.bounds
        return _frozen(np.array([xmin / 2 + xmax / 2, ymin / 2 + ymax / 2]))

    @cached_property
    def diameter(self) -> float:
        """Largest distance between two vertices."""
        hull = shapely.get_coordinates(shapely.convex_hull(self.polygons))
        return max(float(np.hypot(*(hull - vertex).T).max()) for vertex in hull)

    @cached_property
    def convex_cover(self) -> tuple[Ring, ...]:
        """Few convex polygons (k, 2) that tile the aperture, counter-clockwise, read-only.

        Their vertices are vertices of the aperture. A convex part is one piece.
        """
        return tuple(_frozen(piece) for part in self._parts for piece in convex_pieces(part))

    @cached_property
    def _key(self) -> tuple[Any, ...]:
        """Content regardless of the order of parts and of each ring's first vertex."""
        return self.illumination, shapely.normalize(self.polygons).wkb

    def __reduce__(self) -> tuple[Any, ...]:
        return Aperture._of_parts, (self._parts, self.illumination, self._segments)

    def plot(self, ax: Axes | None = None, unit: str = "mm") -> Axes:
        """Plot the filled outline on axes of matplotlib, and return the axes.

        Parameters
        ----------
        ax : axes; None: new axes of pyplot.
        unit : unit of the axes, such as "mm" or "um".

        Raises
        ------
        ArgumentError
            The axes are not matplotlib axes.
        QuantityError
            The unit is unknown.
        """
        return plot_rings(self.rings, ax, unit)

    def __repr__(self) -> str:
        parts, holes = len(self._parts), len(self.rings) - len(self._parts)
        counts = [f"{sum(map(len, self.rings))} vertices"]
        counts += [f"{parts} parts"] if parts > 1 else []
        counts += [f"{holes} hole{'s' if holes > 1 else ''}"] if holes else []
        counts += [repr(self.illumination)] if self.illumination is not None else []
        return (
            f"Aperture({', '.join(counts)}, area {self.area:.6g}, "
            f"bounds ({', '.join(f'{bound:.6g}' for bound in self.bounds)}))"
        )


def triangulate(aperture: Aperture) -> tuple[Ring, NDArray[np.intp]]:
    """Split the aperture into constrained Delaunay triangles, for meshes.

    Returns
    -------
    Vertices (n, 2) of the aperture, and counter-clockwise vertex numbers (m, 3) of the triangles
    with an area above zero.
    """
    vertices: list[Ring] = []
    triangles: list[NDArray[np.intp]] = []
    count = 0
    for part in aperture._parts:
        points, indices = triangulate_part(part)
        a, b, c = (points[indices[:, k]] for k in range(3))
        vertices.append(points)
        triangles.append(indices[orientations(a, b, c) > 0] + count)
        count += len(points)
    return np.concatenate(vertices), np.concatenate(triangles)


@final
class PlacedAperture(Immutable):
    """An aperture and its rigid pose in space; made by :meth:`Aperture.placed`."""

    aperture: Aperture
    pose: NDArray[np.float64]
    """(4, 4) read-only: from the aperture's frame, with the aperture at z = 0, to the world."""

    def __init__(self, aperture: Aperture, pose: NDArray[np.float64]) -> None:
        fixed = np.array(pose, dtype=np.float64)
        fixed.setflags(write=False)
        object.__setattr__(self, "aperture", aperture)
        object.__setattr__(self, "pose", fixed)

    def __reduce__(self) -> tuple[Any, ...]:
        return PlacedAperture, (self.aperture, self.pose)

    def __repr__(self) -> str:
        return f"PlacedAperture({self.aperture!r}, pose={self.pose.tolist()})"

    @property
    def normal(self) -> NDArray[np.float64]:
        """Unit normal (3,) towards the side to which the aperture radiates."""
        return self.pose[:3, 2]

    @property
    def area(self) -> float:
        """Area in m^2."""
        return self.aperture.area

    def plot(self, ax: Axes | None = None, unit: str = "mm") -> Axes:
        """Plot the outline in the plane of the aperture, see :meth:`Aperture.plot`."""
        return self.aperture.plot(ax, unit)

    @property
    def _key(self) -> tuple[Aperture, bytes]:
        return self.aperture, self.pose.tobytes()


def _require_aperture(aperture: Aperture) -> None:
    if not isinstance(aperture, Aperture):
        raise ArgumentError(
            f"expected an Aperture, got {type(aperture).__name__}; make one with "
            "polywigner.Aperture(vertices); the support of an Array is one"
        )


def _mean_polygon(first: Ring, second: Ring) -> Ring:
    """Return the convex polygon {(a + b)/2} of two convex rings, counter-clockwise.

    The sides of both rings are sorted by direction. GEOS' hull of the midpoints is wrong if they
    lie nearly on a line.
    """
    rings, angles = [], []
    for ring in (first, second):
        lowest = np.roll(ring, -int(np.lexsort(ring.T)[0]), axis=0)
        side = np.roll(lowest, -1, axis=0) - lowest
        turned = np.arctan2(side[:, 1], side[:, 0]) % (2 * np.pi)
        rings.append(lowest)
        angles.append(np.maximum.accumulate(turned))  # rounding may bend a side
    of_second = np.argsort(np.concatenate(angles), kind="stable") >= len(first)
    passed: NDArray[np.intp] = np.cumsum(of_second) - of_second
    index = np.arange(len(of_second)) - passed
    a, b = rings
    return np.asarray(a[index % len(a)] / 2 + b[passed % len(b)] / 2)


def automean(aperture: Aperture) -> Aperture:
    """Return the mutual support {(a + b)/2 : a, b in the aperture} of u(x+xi/2) and u(x-xi/2).

    W(x, nu) is zero for x outside the automean, for any illumination. The automean of a convex
    aperture is the aperture; others have a larger automean inside their convex hull. It is the
    union of the means of all pairs of convex pieces. Its vertices at crossings of outlines are
    rounded to 2^-44 of the size. The cost is pieces^2/2 means and their union.

    Raises ArgumentError for objects of another type.

    >>> import polywigner as pw
    >>> notch = pw.shapes.chevron(20e-3, 12e-3, 4e-3)
    >>> pw.automean(notch).area > notch.area
    True
    """
    _require_aperture(aperture)
    pieces = aperture.convex_cover
    if len(pieces) == 1:
        return aperture.with_illumination(None)
    means = [_mean_polygon(a, b) for a, b in combinations_with_replacement(pieces, 2)]
    return Aperture(union_on_grid([shapely.Polygon(ring) for ring in means], np.concatenate(means)))


def _overlap(
    first: shapely.MultiPolygon, second: shapely.MultiPolygon
) -> shapely.Polygon | shapely.MultiPolygon:
    parts = polygons_in(shapely.intersection(first, second))
    return parts[0] if len(parts) == 1 else shapely.MultiPolygon(parts)


def lag_slice(aperture: Aperture, x: ArrayLike) -> shapely.Polygon | shapely.MultiPolygon:
    """Return the lags xi with u(x + xi/2) u*(x - xi/2) != 0: 2(G - x) and 2(x - G) intersected.

    `x` is a position (2,) in the unit of the aperture. The result may be an empty MultiPolygon.
    The matrices of the paper translate by x instead of 2x.

    Raises ArgumentError for objects other than an Aperture, and unless `x` is two finite numbers.

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
    """Return the positions x with u(x + xi/2) u*(x - xi/2) != 0, an intersection of shifted G.

    G is shifted by -xi/2 and xi/2. `xi` is a lag (2,) in the unit of the aperture. The result may
    be an empty MultiPolygon. The paper shifts one copy only, which gives a wrong phase.

    Raises ArgumentError for objects other than an Aperture, and unless `xi` is two finite numbers.

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
