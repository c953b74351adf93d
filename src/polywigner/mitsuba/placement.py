"""Where the mesh of a source is: on its plane, in the pose of its emitter."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import numpy.typing as npt

from polywigner.errors import SceneError
from polywigner.geometry import Aperture, triangulate

__all__ = [
    "PLACE_ERROR",
    "Frame",
    "check_place",
    "cover",
    "hide",
    "matrix_of",
    "move",
    "world_positions",
]

# The pose is held in single precision: its rotation and translation round by 6e-8 of the largest
# coordinate each, the positions once more.
PLACE_ERROR = 5e-7


class Frame:
    """A rigid frame of one variant's arrays, its origin in the middle of a source."""

    def __init__(self, m: Any, to_world: Any, centre: npt.NDArray[np.float64]) -> None:
        matrix = to_world.matrix
        columns = [m.Vector3f(*(matrix[row, col] for row in range(3))) for col in range(4)]
        cx, cy = centre.tolist()
        self._m = m
        self.axes = columns[:3]
        self.origin = m.Point3f(columns[0] * cx + columns[1] * cy + columns[3])
        # as literals, every new pose would compile the render kernel again
        if dr.is_jit_v(m.Float):
            dr.make_opaque(self.axes, self.origin)

    def to_own(self, v: Any) -> Any:
        """A vector of the scene in this frame."""
        return self._m.Vector3f(*(dr.dot(axis, v) for axis in self.axes))

    def to_scene(self, v: Any) -> Any:
        """A vector of this frame in the scene."""
        ex, ey, ez = self.axes
        return ex * v.x + ey * v.y + ez * v.z

    def point(self, x: Any) -> Any:
        """The point of the scene at a position in the plane."""
        ex, ey, _ = self.axes
        return self.origin + ex * x.x + ey * x.y


def world_positions(
    points: npt.NDArray[np.float64],
    pose: npt.NDArray[np.float64],
    centre: npt.NDArray[np.float64],
) -> npt.NDArray[np.float32]:
    """Points (n, 2) of the source's plane relative to its centre (2,), in the scene (n, 3)."""
    return ((points + centre) @ pose[:3, :2].T + pose[:3, 3]).astype(np.float32)


def matrix_of(transform: Any) -> list[list[float]]:
    matrix = transform.matrix
    return [
        [float(np.asarray(dr.detach(matrix[row, column])).ravel()[0]) for column in range(4)]
        for row in range(4)
    ]


def move(shape: Any, pose: Any, centre: npt.NDArray[np.float64]) -> None:
    """Put the mesh where the emitter is; its texture coordinates are relative to the centre."""
    params = mi.traverse(shape)
    local = np.asarray(params["vertex_texcoords"], dtype=np.float64).reshape(-1, 2)
    params["vertex_positions"] = world_positions(local, pose, centre).ravel().tolist()
    params.update()


def cover(
    shape: Any,
    support: Aperture,
    pose: npt.NDArray[np.float64],
    centre: npt.NDArray[np.float64],
    unit: float,
) -> None:
    """Make the mesh that of a region in metres, relative to a centre in units of ``unit``."""
    points, triangles = triangulate(support)
    points = points / unit
    params = mi.traverse(shape)
    # Lists, in all variants: of NumPy's memory, whose alignment enters the kernels, Dr.Jit makes no
    # copy, and it ends the process if a scene with some is freed while a function is recorded.
    params["vertex_positions"] = world_positions(points, pose, centre).ravel().tolist()
    params["vertex_texcoords"] = points.ravel().tolist()
    params["faces"] = triangles.ravel().tolist()
    params.update()


def hide(shape: Any) -> None:
    """Leave no surface that a ray could meet: each triangle has a single corner."""
    params = mi.traverse(shape)
    params["faces"] = [0] * len(params["faces"])
    params.update()


def check_place(shape: Any, pose: Any, centre: npt.NDArray[np.float64]) -> None:
    """Raise SceneError where somebody has moved the mesh but not the emitter."""
    params = mi.traverse(shape)
    local, seen = (
        np.asarray(dr.detach(params[name]), dtype=np.float64).reshape(-1, count)
        for name, count in (("vertex_texcoords", 2), ("vertex_positions", 3))
    )
    expected = world_positions(local, np.asarray(pose), centre)
    allowed = PLACE_ERROR * max(np.abs(local).max(), np.abs(expected).max())
    if not np.abs(seen - expected).max() <= allowed:
        raise SceneError(
            "expected the mesh of a wigner shape to stay where its to_world puts it, got other "
            "vertex_positions; change emitter.to_world, which moves mesh and light"
        )
