"""The aperture, an immutable set of polygons in a plane; its automean and its slices."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cached_property
from itertools import combinations_with_replacement
from typing import TYPE_CHECKING, Any, final

import numpy as np
import shapely
from numpy.typing import ArrayLike, NDArray

from polywigner.errors import GeometryError, IlluminationError
from polywigner.geometry.arguments import (
    Immutable,
    Outline,
    checked_length,
    checked_type,
    frozen,
    rigid_pose,
)
from polywigner.geometry.convex import convex_pieces, mean_polygon, triangulate_part
from polywigner.geometry.illumination import (
    Illumination,
    checked_field,
    checked_shift,
    turned_points,
)
from polywigner.geometry.parts import (
    combined_on_grid,
    merge_parts,
    parts_from,
    polygons_in,
    split_ring,
    union_on_grid,
)
from polywigner.geometry.rings import (
    Part,
    Ring,
    orientations,
    plot_rings,
    polygon_of_part,
    shoelace,
)
from polywigner.geometry.wavefront import TakesWaves

if TYPE_CHECKING:
    from matplotlib.axes import Axes


@final
class Aperture(TakesWaves):
    """A plane opening or radiating patch bounded by polygons, with an optional illumination.

    Without an illumination, the field on the aperture is 1.

    Parameters
    ----------
    vertices : array_like, shape (n, 2), list of such arrays, or shapely polygons
        One ring, a list of rings for separate parts, or a shapely Polygon or MultiPolygon, which
        may have holes. Coordinates are in metres; any other unit works if it is used consistently.

    Raises
    ------
    GeometryError
        If a coordinate is not finite, if a ring has fewer than three vertices, has zero area, or
        crosses or touches itself (see :meth:`from_ring`), if a hole is outside its polygon, or if
        parts overlap.

    Notes
    -----
    Orientation and starting vertex do not matter. Repeated vertices are dropped. Vertices nearer
    than 2^-48 area/diameter to the line between their neighbours are dropped too, which changes
    the area by less than 1e-14 of its value. Parts are merged if they touch within 64 units in the
    last place (ulp) of the largest coordinate.

    Examples
    --------
    >>> import polywigner as pw
    >>> frame = pw.Aperture([[(0, 0), (3, 0), (3, 2), (0, 2)], [(5, 0), (6, 0), (6, 1)]])
    >>> frame.area, len(frame.rings)
    (6.5, 2)
    """

    _parts: tuple[Part, ...]
    _segments: tuple[Part, ...] | None
    """Segments of a mirror, which may touch; None if the segments are the separate parts."""
    illumination: Illumination | None
    """Field on the aperture; None for the field 1."""

    def __init__(self, vertices: Outline) -> None:
        parts = tuple(merge_parts(parts_from(vertices)))
        self._set(_parts=parts, _segments=None, illumination=None)

    @classmethod
    def _of_parts(
        cls,
        parts: Sequence[Part],
        illumination: Illumination | None = None,
        segments: Sequence[Part] | None = None,
    ) -> Aperture:
        """Make an aperture from valid parts, without checks.

        ``segments``: segments of a mirror, see :attr:`segments`.
        """
        segments = segments and tuple(segments)
        return cls._of(_parts=tuple(parts), _segments=segments, illumination=illumination)

    @classmethod
    def _of_segments(cls, rings: Sequence[Ring]) -> Aperture:
        """Make a mirror from the counter-clockwise outlines of its segments, which may touch."""
        parts = cls(rings)._parts
        return cls._of_parts(
            parts, None, [(ring,) for ring in rings] if len(parts) < len(rings) else None
        )

    def _mapped(
        self, image: Callable[[Ring], Ring], image_of_field: Callable[[Illumination], Illumination]
    ) -> Aperture:
        """Return the aperture after a similarity transform of its outline, segments and field.

        ``image`` maps vertices (n, 2), and ``image_of_field`` maps the illumination, if any.
        """
        field = self.illumination
        parts, segments = (
            parts and [tuple(map(image, part)) for part in parts]
            for parts in (self._parts, self._segments)
        )
        return Aperture._of_parts(parts or (), field and image_of_field(field), segments)

    @classmethod
    def from_ring(cls, ring: ArrayLike, winding: str = "nonzero") -> Aperture:
        """Make an aperture from the region inside a ring that may cross itself.

        Parameters
        ----------
        ring : array_like, shape (n, 2)
            Vertices in metres. A bow tie becomes two triangles that touch in a point.
        winding : str, default "nonzero"
            "nonzero": points with a winding number other than zero are inside; "evenodd": points
            with an odd winding number are inside.

        Returns
        -------
        Aperture
            The region as separate simple polygons.

        Raises
        ------
        GeometryError
            If a coordinate is not finite, there are fewer than three vertices, or the area is zero.
        ArgumentError
            If the winding rule is unknown.
        """
        return cls._of_parts(split_ring(ring, winding))

    def with_illumination(self, illumination: Illumination | None) -> Aperture:
        """Return the aperture with a different field.

        Parameters
        ----------
        illumination : Illumination or None
            The field in two dimensions; None for the field 1.

        Returns
        -------
        Aperture
            An aperture with the same outline.

        Raises
        ------
        ArgumentError
            If the field is neither an Illumination nor None.
        IlluminationError
            If the field is defined on slits.
        """
        new = Aperture._of(illumination=checked_field(illumination, 2))
        # The rings are not checked again, because checking thousands of rings takes a millisecond.
        new.__dict__.update(_parts=self._parts, _segments=self._segments)
        return new

    def moved(self, shift: ArrayLike) -> Aperture:
        """Return the aperture and its field, translated.

        Parameters
        ----------
        shift : array_like, shape (2,)
            Translation in metres.

        Returns
        -------
        Aperture
            The translated aperture, with rounded vertices.

        Raises
        ------
        ArgumentError
            If the shift is not two finite numbers.
        """
        offset = checked_shift(shift, 2)
        return self._mapped(lambda ring: ring + offset, lambda field: field.moved(offset))

    def turned(self, angle: float) -> Aperture:
        """Return the aperture and its field, rotated counter-clockwise about the origin.

        Parameters
        ----------
        angle : float
            Angle in radians. Multiples of pi/2 are exact.

        Returns
        -------
        Aperture
            The rotated aperture.

        Raises
        ------
        ArgumentError
            If the angle is not a finite number.
        """
        return self._mapped(
            lambda ring: turned_points(ring, angle), lambda field: field.turned(angle)
        )

    @property
    def elements_in_plane(self) -> tuple[Aperture, ...]:
        """Tuple with this aperture as its only element; arrays have several elements."""
        return (self,)

    def scaled(self, factor: float) -> Aperture:
        """Return the aperture and its field, scaled about the origin.

        Parameters
        ----------
        factor : float
            Scale factor for all lengths, above zero.

        Returns
        -------
        Aperture
            The scaled aperture.

        Raises
        ------
        ArgumentError
            If the factor is not a finite number above zero.
        """
        size = checked_length(factor, "factor", meaning="a number above zero")
        return self._mapped(lambda ring: ring * size, lambda field: field.scaled(size))

    def __or__(self, other: Aperture) -> Aperture:
        """Return the union of two apertures; raise IlluminationError if their fields differ."""
        return self._combined(shapely.union, other)

    def __and__(self, other: Aperture) -> Aperture:
        """Return the intersection with another aperture, keeping this aperture's field.

        Raises IlluminationError unless the other aperture has the same field or no illumination,
        and GeometryError if the result is empty.
        """
        return self._combined(shapely.intersection, other)

    def __sub__(self, other: Aperture) -> Aperture:
        """Return the part of this aperture outside another one, keeping this aperture's field.

        Raises the same errors as ``&``.
        """
        return self._combined(shapely.difference, other)

    def _combined(self, operation: Callable[..., Any], other: object) -> Aperture:
        """Return the result of a set operation of shapely, with the field of this aperture.

        Raises IlluminationError if the fields differ, and GeometryError if the result is empty.
        Except in a union, the other aperture may also have no field.
        """
        if not isinstance(other, Aperture):
            return NotImplemented
        is_outline = other.illumination is None and operation is not shapely.union
        if not is_outline and other.illumination != self.illumination:
            raise IlluminationError(
                "expected two apertures with the same field, or a second aperture without a "
                "field, got different fields; remove one of them with "
                ".with_illumination(None)"
            )
        region = combined_on_grid(operation, self.polygons, other.polygons)
        if region.is_empty:
            raise GeometryError(
                "the result has zero area, because one aperture covers the other or they do not "
                "overlap; check the operands and their units"
            )
        return Aperture(region).with_illumination(self.illumination)

    def placed(self, to_world: ArrayLike) -> PlacedAperture:
        """Return this aperture at a pose in space, for three-dimensional spatial frequencies nu.

        Parameters
        ----------
        to_world : array_like, shape (4, 4)
            Rigid transformation from the frame of the aperture to the world.

        Returns
        -------
        PlacedAperture
            The aperture with its pose.

        Raises
        ------
        GeometryError
            If the matrix is not a rigid transformation (a rotation and a translation).
        """
        return PlacedAperture(self, rigid_pose(to_world))

    @cached_property
    def rings(self) -> tuple[Ring, ...]:
        """Boundary rings, shape (n, 2), read-only, without a repeated first vertex.

        Exteriors are counter-clockwise and come first; holes are clockwise.
        """
        outer = tuple(part[0] for part in self._parts)
        return outer + tuple(hole for part in self._parts for hole in part[1:])

    @cached_property
    def polygons(self) -> shapely.MultiPolygon:
        """Parts as a shapely MultiPolygon: exteriors counter-clockwise, holes clockwise."""
        return shapely.MultiPolygon([polygon_of_part(part) for part in self._parts])

    @property
    def segments(self) -> tuple[Aperture, ...]:
        """Segments of a segmented mirror, or the separate parts, as apertures with this field.

        Segments of ``polywigner.shapes.hexagonal_segments`` may touch; other parts do not.
        """
        return tuple(
            Aperture._of_parts([part], self.illumination) for part in self._segments or self._parts
        )

    @cached_property
    def area(self) -> float:
        """Area in m^2: the exact area of the polygons, rounded once."""
        return float(shoelace(self.rings))

    @cached_property
    def bounds(self) -> tuple[float, float, float, float]:
        """Bounds (xmin, ymin, xmax, ymax) in metres."""
        points = np.concatenate(self.rings)
        (xmin, ymin), (xmax, ymax) = points.min(axis=0).tolist(), points.max(axis=0).tolist()
        return xmin, ymin, xmax, ymax

    @cached_property
    def centre(self) -> Ring:
        """Centre of the bounds in metres, shape (2,), read-only."""
        xmin, ymin, xmax, ymax = self.bounds
        return frozen(np.array([xmin / 2 + xmax / 2, ymin / 2 + ymax / 2]))

    @cached_property
    def diameter(self) -> float:
        """Largest distance between two vertices in metres."""
        hull = shapely.get_coordinates(shapely.convex_hull(self.polygons))
        return max(float(np.hypot(*(hull - vertex).T).max()) for vertex in hull)

    @cached_property
    def convex_cover(self) -> tuple[Ring, ...]:
        """Convex counter-clockwise polygons that tile the aperture, shape (k, 2), read-only.

        All their vertices are vertices of the aperture. A convex part stays in one piece.
        """
        return tuple(frozen(piece) for part in self._parts for piece in convex_pieces(part))

    @cached_property
    def _key(self) -> tuple[Any, ...]:
        """Field and outline, independent of the order of parts and of each ring's first vertex."""
        return self.illumination, shapely.normalize(self.polygons).wkb

    def plot(self, ax: Axes | None = None, unit: str = "mm") -> Axes:
        """Plot the outline as a filled area.

        Parameters
        ----------
        ax : matplotlib.axes.Axes, optional
            Axes to draw on; by default new axes of pyplot.
        unit : str, default "mm"
            Unit of length of the axes, such as "mm" or "um".

        Returns
        -------
        matplotlib.axes.Axes
            The axes.

        Raises
        ------
        ArgumentError
            If ``ax`` is not matplotlib axes.
        QuantityError
            If the unit is unknown.
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
    """Return constrained Delaunay triangles of an aperture: vertices (n, 2) and indices (m, 3).

    The triangles are counter-clockwise. Triangles without area are omitted.
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
    """An aperture and its rigid pose in space, the result of :meth:`Aperture.placed`."""

    aperture: Aperture
    pose: NDArray[np.float64]
    """Rigid transformation (4, 4) from the plane of the aperture to the world, read-only."""

    def __init__(self, aperture: Aperture, pose: NDArray[np.float64]) -> None:
        self._set(aperture=aperture, pose=np.array(pose, dtype=np.float64))

    def __repr__(self) -> str:
        return f"PlacedAperture({self.aperture!r}, pose={self.pose.tolist()})"

    @property
    def normal(self) -> NDArray[np.float64]:
        """Unit normal in the world frame, shape (3,), on the side that the aperture radiates to."""
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
        """Aperture and pose, which are equal for equal placed apertures."""
        return self.aperture, self.pose.tobytes()


def _require_aperture(aperture: Aperture) -> None:
    """Raise ArgumentError if the argument is not an Aperture."""
    advice = "make one with polywigner.Aperture(vertices), or pass the support of an Array"
    checked_type(aperture, "an Aperture", Aperture, advice=advice)


def automean(aperture: Aperture) -> Aperture:
    """Return the automean of an aperture: the set of midpoints (a + b)/2 of its points.

    W(x, nu) is zero for x outside the automean, for any illumination, because x + xi/2 and x - xi/2
    are never both on the aperture. The automean of a convex aperture is the aperture; other
    apertures have a larger automean inside their convex hull.

    Parameters
    ----------
    aperture : Aperture
        The aperture; its illumination is ignored.

    Returns
    -------
    Aperture
        The automean, without illumination.

    Raises
    ------
    ArgumentError
        If the argument is not an Aperture.

    Notes
    -----
    The automean is the union of the means of all pairs of convex pieces, so the time grows with the
    square of the number of pieces. Vertices at crossings of outlines are rounded to 2^-44 of the
    aperture's size.

    Examples
    --------
    >>> import polywigner as pw
    >>> notch = pw.shapes.chevron(20e-3, 12e-3, 4e-3)
    >>> pw.automean(notch).area > notch.area
    True
    """
    _require_aperture(aperture)
    pieces = aperture.convex_cover
    if len(pieces) == 1:
        return aperture.with_illumination(None)
    means = [mean_polygon(a, b) for a, b in combinations_with_replacement(pieces, 2)]
    return Aperture(union_on_grid([shapely.Polygon(ring) for ring in means], np.concatenate(means)))


def _common_region(
    aperture: Aperture, *images: Callable[[Ring], Ring]
) -> shapely.Polygon | shapely.MultiPolygon:
    """Return the intersection of the images of an aperture under two maps of vertices (n, 2).

    If the images do not overlap, the result is an empty MultiPolygon.
    """
    _require_aperture(aperture)
    first, second = (shapely.transform(aperture.polygons, image) for image in images)
    parts = polygons_in(shapely.intersection(first, second))
    return parts[0] if len(parts) == 1 else shapely.MultiPolygon(parts)


def lag_slice(aperture: Aperture, x: ArrayLike) -> shapely.Polygon | shapely.MultiPolygon:
    """Return the lags xi for which x + xi/2 and x - xi/2 are both on the aperture.

    Parameters
    ----------
    aperture : Aperture
        The aperture G.
    x : array_like, shape (2,)
        Position in the unit of the aperture.

    Returns
    -------
    shapely.Polygon or shapely.MultiPolygon
        The intersection of 2(G - x) and 2(x - G); an empty MultiPolygon if there is no such lag.

    Raises
    ------
    ArgumentError
        If the argument is not an Aperture, or the position is not two finite numbers.

    Notes
    -----
    The matrices in the paper translate the copies by x, not by 2x.

    Examples
    --------
    >>> import polywigner as pw
    >>> pw.lag_slice(pw.shapes.square(2.0), (0.5, 0.0)).area
    8.0
    """
    position = checked_shift(x, 2, "a position x")
    return _common_region(aperture, lambda v: 2 * (v - position), lambda v: 2 * (position - v))


def position_slice(aperture: Aperture, xi: ArrayLike) -> shapely.Polygon | shapely.MultiPolygon:
    """Return the positions x for which x + xi/2 and x - xi/2 are both on the aperture.

    Parameters
    ----------
    aperture : Aperture
        The aperture G.
    xi : array_like, shape (2,)
        Lag in the unit of the aperture.

    Returns
    -------
    shapely.Polygon or shapely.MultiPolygon
        The intersection of G - xi/2 and G + xi/2; an empty MultiPolygon if there is no position.

    Raises
    ------
    ArgumentError
        If the argument is not an Aperture, or the lag is not two finite numbers.

    Notes
    -----
    The paper shifts only one of the two copies, which results in a wrong phase.

    Examples
    --------
    >>> import polywigner as pw
    >>> pw.position_slice(pw.shapes.square(2.0), (0.5, 0.0)).area
    3.0
    """
    half = checked_shift(xi, 2, "a lag xi") / 2
    return _common_region(aperture, lambda v: v - half, lambda v: v + half)
