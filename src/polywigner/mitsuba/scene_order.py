"""Emitters, sensors and shapes of a scene, sorted by their ids.

Mitsuba's order changes from one load to the next when it merges meshes. Results, coordinates and
names follow the sorted order. Objects with equal or empty ids are sorted by their position.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from polywigner.mitsuba.visibility import bounds_of


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
