"""Polyhedra: solid bodies bounded by planar faces, convex or not."""

from __future__ import annotations

import operator
from collections import Counter
from collections.abc import Iterable, Sequence
from fractions import Fraction
from functools import cached_property
from typing import Any, SupportsIndex, final

import numpy as np
import shapely
from numpy.typing import ArrayLike, NDArray

from polywigner.errors import GeometryError
from polywigner.geometry.arguments import real_numbers, unchangeable, warn_caller
from polywigner.geometry.display import length_text, shown_as_html
from polywigner.geometry.exact import whole_numbers
from polywigner.geometry.faces import closed_surfaces, nesting_of, triangulate_faces
from polywigner.geometry.rings import LARGEST_COORDINATE, SMALLEST_EXTENT

# How far a vertex of a face may lie off the face's plane, as a fraction of the body's diameter:
# coordinates printed with ten digits pass; the volume differs by less than 1e-9 of diameter^3.
_PLANAR = 1e-9

# Rounding of radii and distances, sums of a few terms; rows of distances at a time: 80 MB at
# 10,000 ends.
_ROUNDING = 1e-14
_ROWS = 1024

# Faces that a notebook draws.
_MOST_DRAWN = 2000

Vertices = NDArray[np.float64]


@final
class Polyhedron:
    """A uniform solid with planar polygonal faces.

    Parameters
    ----------
    vertices : (n, 3) in metres (any one consistent unit works).
    faces : one list of vertex numbers per face, three or more, counter-clockwise seen from outside;
        convex or not. Several closed surfaces may share one list: separate bodies, which may touch,
        and cavities. A surface inside another one is the wall of a cavity, and a surface inside a
        cavity is a body. A surface whose faces all run the wrong way round is reversed.

    Raises GeometryError for values that are not finite numbers, faces that are not planar or cross
    themselves, a surface that is not closed or not consistently oriented, and zero volume.

    >>> import polywigner as pw
    >>> corners = [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)]
    >>> body = pw.Polyhedron(corners, [(0, 2, 1), (0, 1, 3), (1, 2, 3), (0, 3, 2)])
    >>> round(body.volume, 6)
    0.166667
    """

    vertices: Vertices
    """(n, 3) float64, read-only."""
    faces: tuple[tuple[int, ...], ...]

    def __init__(self, vertices: ArrayLike, faces: Iterable[Iterable[SupportsIndex]]) -> None:
        points = _checked_vertices(vertices)
        numbers = _checked_faces(faces, len(points))
        _check_closed(numbers)
        _check_planar(points, numbers)
        numbers, volume = _oriented(points, numbers)
        if volume <= 1e-15 * float(np.max(np.ptp(points, axis=0))) ** 3:
            raise GeometryError("expected faces that enclose a volume, got zero volume")
        points.setflags(write=False)
        object.__setattr__(self, "vertices", points)
        object.__setattr__(self, "faces", numbers)

    @cached_property
    def volume(self) -> float:
        """Volume, rounded once from its exact value."""
        return float(_six_volumes(self.vertices, [self.faces])[0] / 6)

    @cached_property
    def bounds(self) -> tuple[float, ...]:
        """(xmin, ymin, zmin, xmax, ymax, zmax)."""
        return (*self.vertices.min(axis=0).tolist(), *self.vertices.max(axis=0).tolist())

    @cached_property
    def diameter(self) -> float:
        """Largest distance between two vertices."""
        return _largest_distance(self.vertices)

    @cached_property
    def triangles(self) -> NDArray[np.intp]:
        """(m, 3) vertex numbers of triangles that cover each face once, oriented as the faces."""
        result = triangulate_faces(self.vertices, self.faces)
        result.setflags(write=False)
        return result

    @property
    def _key(self) -> tuple[bytes, tuple[tuple[int, ...], ...]]:
        return self.vertices.tobytes(), self.faces

    def __eq__(self, other: object) -> bool:
        return self._key == other._key if isinstance(other, Polyhedron) else NotImplemented

    def __hash__(self) -> int:
        return hash(self._key)

    __setattr__ = __delattr__ = unchangeable

    def __reduce__(self) -> tuple[Any, ...]:
        return _restored, (self.vertices, self.faces)

    def _repr_html_(self) -> str:
        # seen along (1, 1, 1), z upwards
        x, y, z = (self.vertices - self.vertices.mean(axis=0)).T
        seen = np.stack([(y - x) / 2**0.5, (2 * z - x - y) / 6**0.5], axis=-1)
        lines = [seen[[*face, face[0]]] for face in self.faces[:_MOST_DRAWN]]
        rows = [
            ("size", length_text(*np.ptp(self.vertices, axis=0).tolist())),
            ("volume", f"{self.volume:.6g} m³"),
            ("vertices", str(len(self.vertices))),
            ("faces", str(len(self.faces))),
        ]
        return shown_as_html("Polyhedron", rows, lines=lines)

    def __repr__(self) -> str:
        return (
            f"Polyhedron({len(self.vertices)} vertices, {len(self.faces)} faces, "
            f"volume {self.volume:.6g})"
        )


def _restored(vertices: Vertices, faces: tuple[tuple[int, ...], ...]) -> Polyhedron:
    """A body that was checked before it was copied."""
    body = object.__new__(Polyhedron)
    vertices.setflags(write=False)
    object.__setattr__(body, "vertices", vertices)
    object.__setattr__(body, "faces", faces)
    return body


def _largest_distance(points: Vertices) -> float:
    """By all pairs of the points that may be an end of it, some at a time."""
    centre = (points.min(axis=0) + points.max(axis=0)) / 2
    offsets = points - centre
    radii = np.linalg.norm(offsets, axis=1)
    far = offsets[int(radii.argmax())]
    least = float(np.linalg.norm(offsets - far, axis=1).max())
    # An end at radius r is at most r + max(radii) away from the other.
    ends = offsets[radii >= (1 - _ROUNDING) * (least - radii.max())]
    squares = (ends**2).sum(axis=1)
    best, pair = -np.inf, (0, 0)
    for k in range(0, len(ends), _ROWS):
        apart = squares[k : k + _ROWS, None] + squares - 2 * ends[k : k + _ROWS] @ ends.T
        row, column = np.unravel_index(int(apart.argmax()), apart.shape)
        if apart[row, column] > best:
            best, pair = apart[row, column], (k + int(row), int(column))
    return max(least, float(np.linalg.norm(ends[pair[0]] - ends[pair[1]])))


def _checked_vertices(vertices: Any) -> Vertices:
    expected = "expected vertices as an (n, 3) array of numbers"
    try:
        points = real_numbers(vertices)
    except ValueError as error:
        raise GeometryError(f"{expected}, got {error}") from None
    if points.ndim != 2 or points.shape[1] != 3 or not len(points):
        raise GeometryError(f"{expected}, got shape {points.shape}")
    if not np.isfinite(points).all():
        k = int(np.argmin(np.isfinite(points).all(axis=1)))
        raise GeometryError(f"expected finite vertices, got {points[k].tolist()} at vertex {k}")
    largest, size = float(np.abs(points).max()), float(np.ptp(points, axis=0).max())
    if largest >= LARGEST_COORDINATE:
        raise GeometryError(
            f"expected coordinates below {LARGEST_COORDINATE:g}, got {largest:g}; choose a larger "
            "unit"
        )
    if size <= SMALLEST_EXTENT:
        raise GeometryError(
            f"expected a body larger than {SMALLEST_EXTENT:g}, got a size of {size:g}; "
            "choose a smaller unit"
        )
    return points + 0.0


def _checked_faces(faces: Any, count: int) -> tuple[tuple[int, ...], ...]:
    try:
        numbers = tuple(tuple(operator.index(k) for k in face) for face in faces)
    except (TypeError, ValueError, OverflowError):
        raise GeometryError("expected faces as lists of vertex numbers, which are whole") from None
    for n, face in enumerate(numbers):
        if len(face) < 3 or len(set(face)) != len(face):
            raise GeometryError(
                f"expected three or more different vertices per face, got {list(face)} at face {n}"
            )
        wrong = [k for k in face if not 0 <= k < count]
        if wrong:
            raise GeometryError(
                f"expected vertex numbers from 0 to {count - 1}, got {wrong[0]} at face {n}"
            )
    return numbers


def _check_closed(faces: Sequence[tuple[int, ...]]) -> None:
    """Every directed edge must occur as often as its reverse: twice where bodies touch along it."""
    starts = [face.index(min(face)) for face in faces]
    turned = Counter(f[k:] + f[:k] for f, k in zip(faces, starts, strict=True))
    repeated, times = next(iter(turned.most_common(1)), ((), 0))
    if times > 1:
        raise GeometryError(
            f"expected consistently oriented faces, each once, got {list(repeated)[:20]} "
            f"{times} times; remove the repetitions"
        )
    edges = Counter((f[k - 1], f[k]) for f in faces for k in range(len(f)))
    for (a, b), times in edges.items():
        if times > max(1, edges[b, a]):
            raise GeometryError(
                f"expected consistently oriented faces, got two that run from vertex {a} to {b}; "
                "reverse one of them"
            )
        if edges[b, a] < times:
            raise GeometryError(
                f"expected a closed surface, got an edge from vertex {a} to {b} with a face on one "
                "side only; add the missing face, or read an open mesh with polywigner.read_sheets"
            )


def _check_planar(points: Vertices, faces: Sequence[tuple[int, ...]]) -> None:
    diameter = float(np.linalg.norm(np.ptp(points, axis=0)))
    for n, face in enumerate(faces):
        if len(face) == 3:
            continue  # always plane, and cannot cross itself
        corners = points[list(face)]
        relative = corners - corners.mean(axis=0)
        _, _, axes = np.linalg.svd(relative, full_matrices=False)
        off = float(np.abs(relative @ axes[2]).max())
        if off > _PLANAR * diameter:
            raise GeometryError(
                f"expected planar faces, got face {n} with a vertex {off:.3g} off its plane; split "
                "it into triangles"
            )
        outline = shapely.Polygon(relative @ axes[:2].T)
        if not outline.is_valid:
            raise GeometryError(
                f"expected faces that do not cross themselves, got face {n} "
                f"({shapely.is_valid_reason(outline)} in its plane)"
            )


def _oriented(
    points: Vertices, faces: tuple[tuple[int, ...], ...]
) -> tuple[tuple[tuple[int, ...], ...], Fraction]:
    """Faces that are counter-clockwise seen from outside the solid, and six times its volume."""
    surfaces = closed_surfaces(faces)
    members = [[faces[k] for k in surface] for surface in surfaces]
    volumes = _six_volumes(points, members)
    around = np.zeros((len(surfaces),) * 2, dtype=bool)
    if len(surfaces) > 1:
        around = nesting_of([points[triangulate_faces(points, some)] for some in members])
    depths = around.sum(axis=0)
    total, oriented = Fraction(0), list(faces)
    for n, (surface, volume) in enumerate(zip(surfaces, volumes, strict=True)):
        sign = -1 if depths[n] % 2 else 1
        total += sign * abs(volume)
        if volume * sign < 0:
            for k in surface:
                oriented[k] = faces[k][::-1]
        outermost = np.flatnonzero(around[:, n] & (depths == 0))
        if sign < 0 and len(outermost) and volume * volumes[outermost[0]] > 0:
            warn_caller(
                f"the surface with face {surface[0]} lies inside another surface and faces the "
                "same way: it is read as a cavity; leave it out if it is a body in the body"
            )
    return tuple(oriented), total


def _six_volumes(points: Vertices, surfaces: Sequence[Sequence[tuple[int, ...]]]) -> list[Fraction]:
    """Six times the volume that each closed surface encloses, exactly."""
    whole, exponent = whole_numbers(points)
    exact = (whole - whole[0]).tolist()
    volumes = []
    for faces in surfaces:
        total = 0
        for face in faces:
            a = exact[face[0]]
            for k in range(1, len(face) - 1):
                b, c = exact[face[k]], exact[face[k + 1]]
                total += a[0] * (b[1] * c[2] - b[2] * c[1])
                total -= a[1] * (b[0] * c[2] - b[2] * c[0])
                total += a[2] * (b[0] * c[1] - b[1] * c[0])
        volumes.append(Fraction(total) * Fraction(2) ** (3 * exponent))
    return volumes
