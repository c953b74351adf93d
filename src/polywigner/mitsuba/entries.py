"""What entries of scene dictionaries are made of: a source, and its pose."""

from __future__ import annotations

from typing import Any

import mitsuba as mi

from polywigner.geometry import Aperture, PlacedAperture, Polyhedron, Slits, Wavefront
from polywigner.illumination import Array
from polywigner.mitsuba.given import rigid_pose

__all__ = ["as_source", "pose_entry"]


def as_source(given: Any) -> Any:
    """A source as it is; an Aperture of anything else. GeometryError for no outline."""
    kinds = Aperture | Array | Wavefront | PlacedAperture | Slits | Polyhedron
    return given if isinstance(given, kinds) else Aperture(given)


def pose_entry(to_world: Any) -> dict[str, Any]:
    """The key ``to_world`` for a matrix or a transform of any variant; nothing for None.

    Raises SceneError for a pose that is not rigid.
    """
    if to_world is None:
        return {}
    pose = rigid_pose(getattr(to_world, "matrix", to_world))
    return {"to_world": mi.scalar_rgb.ScalarTransform4f(pose)}
