"""Emitters, sensors and shapes of a scene, sorted by their ids.

Mitsuba's order changes from one load to the next when it merges meshes. Results, coordinates and
names follow the sorted order. Objects with equal or empty ids are sorted by their position.
"""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


def sorted_emitters(scene: Any) -> list[Any]:
    """Return the emitters of a scene, sorted by the ids of their shapes or their own."""
    return sorted(scene.emitters(), key=_emitter_key)


def sorted_sensors(scene: Any) -> list[tuple[int, Any]]:
    """Return the sensors of a scene with their Mitsuba indices, sorted by id."""
    return sorted(enumerate(scene.sensors()), key=lambda item: (item[1].id(), item[0]))


def sorted_shapes(scene: Any) -> list[Any]:
    """Return the shapes of a scene, sorted by id."""
    return sorted(scene.shapes(), key=_shape_key)


_Key = tuple[str, list[float], str]


def _emitter_key(emitter: Any) -> _Key:
    shape = emitter.get_shape()
    if shape is None:
        return emitter.id(), [], str(emitter)
    return _shape_key(shape)


def _shape_key(shape: Any) -> _Key:
    emitter = shape.emitter()
    # `unseen` shrinks the meshes of sources, so their poses serve instead of their bounding boxes
    if hasattr(emitter, "spec"):
        return shape.id(), np.ravel(emitter.spec.pose).tolist(), ""
    return shape.id(), bounds_of(shape).ravel().tolist(), ""


def bounds_of(shape: Any) -> Floats:
    """Return the lowest and highest coordinates (2, 3) of a shape, in scene units.

    Mitsuba computes no bounding box for rectangles that it merges: theirs holds infinities.
    """
    box = shape.bbox()
    bounds = np.array([box.min, box.max], np.float64).reshape(2, 3)
    if np.isfinite(bounds).all() or not shape.is_mesh():
        return bounds
    positions = np.array(dr.detach(mi.traverse(shape)["vertex_positions"]), np.float64)
    positions = positions.reshape(-1, 3)
    return np.array([positions.min(axis=0), positions.max(axis=0)])
