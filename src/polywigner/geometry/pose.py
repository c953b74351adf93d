"""Rigid poses: where in space the plane of an aperture lies."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from polywigner.errors import GeometryError
from polywigner.geometry.numbers import real_numbers

__all__ = ["RIGID_TOLERANCE", "rigid_pose"]

# Scene files give angles in single precision: a product of a few such rotations departs from a
# rotation by some 1e-6. A scale that anybody wants differs by more than this.
RIGID_TOLERANCE = 1e-4


def rigid_pose(to_world: Any) -> NDArray[np.float64]:
    """A read-only (4, 4) pose: the nearest rotation, and the translation.

    Raises GeometryError for anything but rotations and translations: a scaled or sheared aperture
    would be another aperture, whose transforms this one's are not.
    """
    try:
        given = real_numbers(to_world)
    except ValueError as error:
        raise GeometryError(f"expected to_world as a (4, 4) matrix, got {error}") from None
    if given.shape != (4, 4):
        raise GeometryError(f"expected to_world of shape (4, 4), got {given.shape}")
    if not np.isfinite(given).all():
        raise GeometryError(f"expected a finite to_world, got {given.tolist()}")
    rotation = given[:3, :3]
    if not np.allclose(given[3], (0.0, 0.0, 0.0, 1.0)):
        raise GeometryError("expected a rigid to_world, got a perspective transformation")
    if float(np.abs(rotation.T @ rotation - np.eye(3)).max()) > RIGID_TOLERANCE:
        scales = ", ".join(f"{scale:.6g}" for scale in np.linalg.svd(rotation, compute_uv=False))
        raise GeometryError(
            "expected a to_world of rotations and translations only, got one that scales by "
            f"{scales}; scale the aperture itself, or set its unit"
        )
    if np.linalg.det(rotation) < 0:
        raise GeometryError(
            "expected a to_world of rotations and translations only, got a mirror image; "
            "mirror the aperture itself"
        )
    left, _, right = np.linalg.svd(rotation)
    given[:3, :3] = left @ right
    given[3] = (0.0, 0.0, 0.0, 1.0)
    given.flags.writeable = False
    return given
