"""Emitters, sensors and shapes of a scene, and the end points of rays.

Objects are sorted by id, because Mitsuba's order changes if it merges meshes. Mitsuba also shortens
shadow rays by 9e-4 of their length. The rays of this package instead end at a height above the
surface that just exceeds the rounding error of single precision.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from functools import partial
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from polywigner.errors import ArgumentError, SceneError
from polywigner.execution import Drjit
from polywigner.geometry.arguments import check_most
from polywigner.geometry.polyhedron import normals_of
from polywigner.geometry.silhouettes import Obstacle, Silhouette, connected_parts, is_convex
from polywigner.numerics import Floats, Indices


def sorted_emitters(scene: mi.Scene) -> list[mi.Emitter]:
    """Return the emitters of a scene, sorted by the ids of their shapes."""
    return sorted(scene.emitters(), key=_emitter_key)


def sorted_shapes(scene: mi.Scene) -> list[mi.Shape]:
    """Return the shapes of a scene, sorted by id."""
    return sorted(scene.shapes(), key=_shape_key)


_Key = tuple[str, list[float], str]


def _emitter_key(emitter: mi.Emitter) -> _Key:
    """Return the key that sorts an emitter."""
    shape = emitter.get_shape()
    if shape is None:
        return emitter.id(), [], str(emitter)
    return _shape_key(shape)


def _shape_key(shape: mi.Shape) -> _Key:
    """Return the key that sorts a shape: its id, then its pose or bounds."""
    emitter = shape.emitter()
    # `hide_emitters` changes the bounds of source meshes, but not the poses of the sources.
    if hasattr(emitter, "spec"):
        return shape.id(), np.ravel(emitter.spec.pose).tolist(), ""
    return shape.id(), bounds_of(shape).ravel().tolist(), ""


def is_source(emitter: mi.Emitter) -> bool:
    """Return whether an emitter belongs to a ``wigner`` shape."""
    return getattr(type(emitter), "is_wigner", False)


def wigner_emitters(scene: mi.Scene) -> list[mi.Emitter]:
    """Return the emitters of the ``wigner`` shapes of a scene, sorted by shape id."""
    return list(filter(is_source, sorted_emitters(scene)))


def is_receiver(sensor: mi.Sensor) -> bool:
    """Return whether a sensor is a ``wigner_receiver``."""
    return getattr(type(sensor), "is_wigner_receiver", False)


def sensors_of(scene: Any) -> list[mi.Sensor]:
    """Return the sensors of a scene; raise ArgumentError for other objects."""
    if not hasattr(scene, "sensors"):
        raise ArgumentError(
            f"expected scene to be a mi.Scene, got {type(scene).__name__}; create one with "
            "polywigner.mitsuba.load_scene or mi.load_dict"
        )
    return list(scene.sensors())


def receivers_of(scene: mi.Scene) -> list[tuple[int, mi.Sensor]]:
    """Return sensor indices and receivers, sorted by id; raise SceneError if there are none."""
    receivers = [(k, sensor) for k, sensor in enumerate(sensors_of(scene)) if is_receiver(sensor)]
    if not receivers:
        raise SceneError(
            'the scene has no receiver; add a <sensor type="wigner_receiver">, or '
            "polywigner.mitsuba.receiver(...)"
        )
    return sorted(receivers, key=lambda item: (item[1].id(), item[0]))


def children_of(node: mi.Object) -> list[mi.Object]:
    """Return the objects that are nested directly in an object of Mitsuba."""
    children: list[mi.Object] = []

    class Callback(mi.TraversalCallback):  # The base class depends on the current variant.
        def put(self, name: str, value: Any, *_: Any) -> None:
            if isinstance(value, mi.Object):
                children.append(value)

    node.traverse(Callback())
    return children


def matrix_of(transform: mi.Transform4f) -> list[list[float]]:
    """Return the matrix of a transform of any variant, shape (4, 4)."""
    matrix = transform.matrix
    return [
        [float(np.asarray(dr.detach(matrix[row, column])).ravel()[0]) for column in range(4)]
        for row in range(4)
    ]


def vertices_of(mesh: mi.Mesh) -> Floats:
    """Return the vertices of a mesh in scene units, shape (n, 3)."""
    points = dr.detach(mi.traverse(mesh)["vertex_positions"])
    return np.array(points, np.float64).reshape(-1, 3)


def faces_of(mesh: mi.Mesh) -> Indices:
    """Return the triangles of a mesh as vertex indices, shape (t, 3)."""
    return np.array(mi.traverse(mesh)["faces"], np.intp).reshape(-1, 3)


ROUNDING = 2.0**-20
"""Height above a surface at which rays start and end, relative to the coordinates."""

# Error of positions in single precision, relative to the largest coordinate.
PLACE_ERROR = 5e-7


# Flat shapes and instances, whose bounds determine rounding errors; curved shapes touch a plane at
# one point only.
_FLAT = ("Rectangle", "Disk", "Instance")


def extent_near(scene: mi.Scene, corners: Floats) -> float:
    """Return the largest absolute coordinate of a source and of flat surfaces near it.

    Surfaces are near if they touch the bounding box of the source. ``corners`` (n, 3) are the
    corners of the source in scene units.
    """
    low, high = corners.min(axis=0), corners.max(axis=0)
    result = float(np.abs(corners).max())
    for shape in scene.shapes():
        box = bounds_of(shape)
        size = np.abs(box).max()
        slack = ROUNDING * (size + result)
        if (box[0] > high + slack).any() or (box[1] < low - slack).any():
            continue
        if shape.class_name() in _FLAT:
            result = max(result, float(size))
        elif shape.is_mesh():
            result = max(result, _largest_coordinate_in_box(shape, low - slack, high + slack))
    return result


def _largest_coordinate_in_box(mesh: mi.Mesh, low: Floats, high: Floats) -> float:
    """Return the largest absolute coordinate of the triangles whose bounds meet a box."""
    corners = vertices_of(mesh)[faces_of(mesh)]
    meets = (corners.min(axis=1) <= high) & (corners.max(axis=1) >= low)
    return float(np.abs(corners[meets.all(axis=1)]).max(initial=0.0))


def bounds_of(shape: mi.Shape) -> Floats:
    """Return the bounding box (2, 3) of a shape, even if Mitsuba has merged its mesh.

    The rows are the lower and the upper corner in scene units, or zeros if the shape is empty.
    """
    box = shape.bbox()
    if not box.valid() and shape.is_mesh():
        points = vertices_of(shape)
        return np.array([points.min(axis=0), points.max(axis=0)])
    return np.array([box.min, box.max], np.float64) if box.valid() else np.zeros((2, 3))


def largest_coordinate(point: Drjit) -> Drjit:
    """Return the largest modulus of the coordinates of a point."""
    return dr.max(dr.abs(point))


def shadow_end(it: mi.Interaction3f, end: Drjit, normal: Drjit, extent: Drjit) -> Drjit:
    """Return the target for ``spawn_ray_to`` with which a shadow ray ends just before ``end``.

    ``extent`` is the largest coordinate of the source and of adjacent surfaces, and ``normal`` the
    unit normal of the source.
    """
    p = dr.detach(it.p)
    short = end + normal * (ROUNDING * (largest_coordinate(p) + extent))
    # Without a normal, Mitsuba does not offset the start of the ray.
    start = it.spawn_ray_to(short).o if dr.width(it.n) else p
    longer = 1.0 / (1.0 - float(mi.math.ShadowEpsilon))
    # Only the end point has derivatives.
    return end + dr.detach(start + (short - start) * longer - end)


def number_of(kind: str, thing: Any) -> Drjit:
    """Return the registry number of a "Shape" or an "Emitter", or 0 for None."""
    if not dr.is_jit_v(mi.Float):
        return 0 if thing is None else id(thing)
    return dr.reinterpret_array(mi.UInt32, getattr(mi, f"{kind}Ptr")(thing))


class ShapeExtents:
    """Largest coordinates of the shapes of a scene, which limit the precision of hits."""

    def __init__(self, scene: mi.Scene) -> None:
        shapes = scene.shapes()
        sizes = [float(np.abs(bounds_of(shape)).max()) for shape in shapes]
        if not dr.is_jit_v(mi.Float):
            self._sizes = {id(shape): size for shape, size in zip(shapes, sizes, strict=True)}
            return
        numbers = [int(number_of("Shape", shape)[0]) for shape in shapes]
        self._last = max(numbers, default=0)
        table = np.zeros(self._last + 1)
        table[numbers] = sizes
        self._table = mi.Float(table.tolist())

    def at(self, si: mi.SurfaceInteraction3f) -> Drjit:
        """Return the largest absolute coordinate of an intersection point and of its shape."""
        result = largest_coordinate(si.p)
        if not dr.is_jit_v(mi.Float):
            return max(result, self._sizes.get(id(si.shape), 0.0))
        number = number_of("Shape", si.shape)
        # The registry numbers of shapes in instances are higher than all numbers in the table.
        size = dr.gather(mi.Float, self._table, number, number <= self._last)
        return dr.select(size > result, size, result)

    def ray_from(self, si: mi.SurfaceInteraction3f, direction: Drjit) -> mi.Ray3f:
        """Return a ray that starts just off a surface, on the side of ``direction``.

        The distance from the surface exceeds the rounding error of the intersection.
        """
        height = ROUNDING * self.at(si)
        side = dr.mulsign(mi.Vector3f(si.n), dr.dot(si.n, direction))
        return mi.Ray3f(si.p + side * height, direction, si.time, si.wavelengths)


# Largest distance between a curved shape and its chords [wavelengths].
_SAGITTA = 0.01
# Radius of the largest sphere with the accuracy _SAGITTA [wavelengths], and largest number of
# chords around a circle.
_LARGEST_SPHERE, _MOST_CHORDS = 170.0, 1024
# Largest total number of faces; these faces take about 1 GB.
_MOST_FACES = 1 << 21
# Largest distance between a plane and the vertices that count as lying in it, relative to the size
# of the body.
_FLATNESS = 1e-6
_TRANSPARENT = int(mi.BSDFFlags.Null) | int(mi.BSDFFlags.Transmission)


def meshes_in(scene: mi.Scene, wavelength: float) -> Iterator[tuple[Floats, Indices]]:
    """Yield vertices (n, 3) and faces (t, 3) of the opaque shapes of a scene, in scene units.

    Curved shapes are divided into triangles with errors of 0.01 ``wavelength``, also in scene
    units. Raises SceneError for too many faces and for shapes that cannot be converted to meshes.
    """
    groups = {
        shape.id(): children_of(shape)
        for shape in children_of(scene)
        if shape.class_name() == "ShapeGroupPlugin"
    }
    count = 0
    for shape in sorted_shapes(scene):
        for points, faces in _triangles(shape, groups, wavelength):
            count += len(faces)
            things = "faces in a scene with diffraction, including instances and spheres"
            check_most(count, _MOST_FACES, things, "simplify the meshes", SceneError)
            yield points, faces


def _triangles(
    shape: mi.Shape, groups: dict[str, list[Any]], wavelength: float
) -> Iterator[tuple[Floats, Indices]]:
    """Yield vertices (n, 3) and faces (t, 3) of an opaque shape, or of the shapes of an instance.

    ``groups`` contains the members of shape groups by id.
    """
    params = mi.traverse(shape)
    if shape.class_name() == "Instance":
        name = str(shape).split('name = "', 1)[1].rsplit('",\n    prim_count', 1)[0]
        pose = np.array(matrix_of(params["to_world"]))
        for member in groups[name]:
            for points, faces in _triangles(member, groups, wavelength):
                yield points @ pose[:3, :3].T + pose[:3, 3], faces
        return
    bsdf = shape.bsdf()
    if bsdf is None or bsdf.flags() & _TRANSPARENT or shape.class_name() == "ShapeGroupPlugin":
        return
    if "faces" in params:
        yield vertices_of(shape), faces_of(shape)
        return
    kind = shape.class_name()
    if kind not in _SHAPES:
        raise SceneError(
            "diffraction supports meshes, rectangles, disks, spheres and cylinders, got the "
            f"{kind} {shape.id()!r}; convert it to a mesh"
        )
    pose = np.array(matrix_of(params["to_world"]))
    size = float(np.linalg.norm(pose[:3, :3], axis=0)[:2].max())
    points, faces = _SHAPES[kind](size / wavelength)
    yield points @ pose[:3, :3].T + pose[:3, 3], faces


def _rectangle(_: float) -> tuple[Floats, Indices]:
    """Return vertices and faces of the square from -1 to 1."""
    corners = np.array([[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [1.0, 1.0, 0.0], [-1.0, 1.0, 0.0]])
    return corners, np.array([[0, 1, 2], [0, 2, 3]])


def _chords(radius: float) -> int:
    """Return the number of chords, 32 to 1024, that approximate a circle to 0.01 wavelengths.

    ``radius`` is in wavelengths.
    """
    return int(np.clip(math.pi * math.sqrt(0.5 * radius / _SAGITTA), 32, _MOST_CHORDS))


def _revolved(profile: Any, radius: float) -> tuple[Floats, Indices]:
    """Return vertices and faces of a profile that is rotated about the z axis.

    ``profile`` contains pairs of a radius and a height. ``radius`` in wavelengths determines the
    number of chords.
    """
    count = _chords(radius)
    angles = np.linspace(0.0, 2.0 * math.pi, count, endpoint=False)
    rim = np.column_stack([np.cos(angles), np.sin(angles), np.ones(count)])
    points = np.concatenate([rim * [size, size, height] for size, height in profile])
    k = np.arange((len(profile) - 1) * count)
    following = k - k % count + (k + 1) % count
    lower = np.column_stack([k, following, following + count])
    return points, np.concatenate([lower, np.column_stack([k, following + count, k + count])])


def _sphere(radius: float) -> tuple[Floats, Indices]:
    """Return a unit sphere with the resolution for a sphere of ``radius`` wavelengths."""
    radius = min(radius, _LARGEST_SPHERE)
    latitudes = np.linspace(-math.pi / 2, math.pi / 2, _chords(radius) // 2 + 1)
    sizes = np.cos(latitudes)
    sizes[[0, -1]] = 0.0
    return _revolved(np.column_stack([sizes, np.sin(latitudes)]), radius)


_SHAPES: dict[str, Callable[[float], tuple[Floats, Indices]]] = {
    "Rectangle": _rectangle,
    "Disk": partial(_revolved, [(1.0, 0.0), (0.0, 0.0)]),
    "Cylinder": partial(_revolved, [(1.0, 0.0), (1.0, 1.0)]),
    "Sphere": _sphere,
}


def pieces_of_mesh(points: Floats, faces: Indices) -> list[tuple[Floats, Indices]]:
    """Return the distinct vertices and the faces (t, 3) of each connected part of a mesh.

    Faces without an area are omitted.
    """
    # Meshes with normals contain the same vertex several times.
    points, number = np.unique(points, axis=0, return_inverse=True)
    faces = number.reshape(-1)[faces]
    faces = faces[np.linalg.norm(normals_of(points[faces]), axis=1) > 0.0]
    return [(vertices, part) for vertices, part, _ in connected_parts(points, faces)]


def bodies_of(meshes: Iterable[tuple[Floats, Indices]]) -> list[Obstacle]:
    """Return the connected parts of several meshes as obstacles."""
    return [_body(*piece) for mesh in meshes for piece in pieces_of_mesh(*mesh)]


def _body(points: Floats, faces: Indices) -> Obstacle:
    """Return a connected mesh as an obstacle, with outward normals if it is closed."""
    count, normals = len(points), normals_of(points[faces])
    directed = np.concatenate([faces[:, [k, (k + 1) % 3]] for k in range(3)])
    forth, back = directed @ [count, 1], directed @ [1, count]
    is_solid = len(np.unique(forth)) == len(forth) and np.array_equal(np.sort(forth), np.sort(back))
    size = float(np.ptp(points, axis=0).max())
    units = normals / np.linalg.norm(normals, axis=1)[:, None]
    height = np.einsum("tk,tk->t", units, points[faces[:, 0]] - points[0]) / size
    planes = np.column_stack([units, height]).round(5) + 0.0
    _, first, owner = np.unique(planes, axis=0, return_index=True, return_inverse=True)
    owner = owner.ravel()
    if not is_solid:
        flat = np.abs((points - points[0]) @ units[0]).max() <= _FLATNESS * size
        return Obstacle(points, faces, owner, normals[first], False, bool(flat))
    inner = points - points.mean(axis=0)
    # The normals of a body point inwards if its signed volume is negative.
    if np.einsum("tk,tk->", inner[faces[:, 0]], normals) < 0.0:
        return _body(points, faces[:, ::-1])
    convex = is_convex(points, faces, normals, _FLATNESS)
    return Obstacle(points, faces, owner, normals[first], True, convex)


# Height above the plane of a source below which edges are ignored [wavelengths].
BEHIND = 1e-3


def in_frame(body: Obstacle, pose: Floats, scale: float) -> Obstacle:
    """Return an obstacle in the frame of a pose, scaled by a factor.

    The translation of the pose is in the unit of the obstacle before scaling.
    """
    vertices = (body.vertices - pose[:3, 3]) @ pose[:3, :3] * scale
    return replace(body, vertices=vertices, normals=body.normals @ pose[:3, :3])


def before_plane(silhouette: Silhouette) -> Silhouette:
    """Return the edges of a silhouette in front of the plane z = 0 of the source.

    Lengths are in wavelengths. Edges that cross the plane are cut just in front of it.
    """
    start, end = np.moveaxis(silhouette.edges, 1, 0)
    low, high = start[:, 2] - BEHIND, end[:, 2] - BEHIND
    with np.errstate(divide="ignore", invalid="ignore"):
        cut = start + np.where(low == high, 0.0, low / (low - high))[:, None] * (end - start)
    first = np.where(low[:, None] < 0.0, cut, start)
    last = np.where(high[:, None] < 0.0, cut, end)
    rows = (np.maximum(low, high) > 0.0) & (np.linalg.norm(last - first, axis=1) > 0.0)
    return silhouette.subset(rows, np.stack([first, last], axis=1))
