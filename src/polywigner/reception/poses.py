"""Poses of a receiver in front of a transmitter, checked once at the public edge."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from polywigner.errors import GeometryError
from polywigner.geometry.arguments import RIGID_TOLERANCE, checked_vectors

Floats = NDArray[np.float64]

# Distances, in wavelengths too, have finite squares and inverse squares.
_FARTHEST = 1e100


def checked_poses(to_transmitter: Any, name: str = "to_transmitter") -> Floats:
    """Rigid poses (..., 4, 4): the nearest rotations, and the translations.

    Raises GeometryError for anything else.
    """
    expected = f"expected {name} as rigid poses (..., 4, 4)"
    poses = checked_vectors(to_transmitter, expected, (4, 4), GeometryError)
    rotation = poses[..., :3, :3]
    with np.errstate(all="ignore"):
        gram = np.swapaxes(rotation, -1, -2) @ rotation
        faults = {
            "numbers that are not finite": ~np.isfinite(poses).all(axis=(-2, -1)),
            "a translation in m whose square is no number; check its units": (
                np.abs(poses[..., :3, 3]) > _FARTHEST
            ).any(axis=-1),
            "a last row other than (0, 0, 0, 1); a pose is not multiplied by a scale": ~np.isclose(
                poses[..., 3, :], (0.0, 0.0, 0.0, 1.0)
            ).all(axis=-1),
            "a matrix that is no rotation; scale the source itself": (
                np.abs(gram - np.eye(3)) > RIGID_TOLERANCE
            ).any(axis=(-2, -1)),
            "a mirror image; mirror the source itself": np.linalg.det(rotation) < 0,
        }
    for fault, at in faults.items():
        if at.any():
            raise GeometryError(f"{expected}, got {fault}: {poses[at][0].tolist()}")
    left, _, right = np.linalg.svd(rotation)
    poses[..., :3, :3] = left @ right
    return poses


def check_facing(poses: Floats, transmitter: Floats, receiver: Floats) -> None:
    """That all of each source lies in front of the other's plane, from hulls (k, 2) of both.

    Then all lines between them leave the transmitter and reach the receiver on their front sides.
    Raises GeometryError with the pose and the point otherwise.
    """
    turned = poses[:, :3, :3]
    faces = turned[:, 2, 2] < 0.0
    there = np.einsum("nj,kj->nk", turned[:, 2, :2], receiver) + poses[:, 2, 3, None]
    _check_heights(there, faces, receiver, "receiver", "transmitter")
    beside = np.einsum("nij,ni->nj", turned, poses[:, :3, 3])
    here = np.einsum("nj,kj->nk", turned[:, :2, 2], transmitter) - beside[:, 2, None]
    _check_heights(here, faces, transmitter, "transmitter", "receiver")


def _check_heights(
    heights: Floats, faces: NDArray[np.bool_], corners: Floats, one: str, other: str
) -> None:
    """Check heights (n, k) of corners above the other's plane; ``faces``: axes are opposed."""
    behind = ~(heights > 0)
    if not behind.any():
        return
    pose = int(behind.any(axis=1).argmax())
    lowest = int(heights[pose].argmin())
    x, y = corners[lowest].tolist()
    z = float(heights[pose, lowest])
    if not behind[pose].all():
        advice = "move it forwards, or cut off the part behind the plane"
    elif not heights[pose].any() and faces[pose]:
        advice = "both lie in one plane; add a distance along z to the pose"
    elif faces[pose]:
        advice = "the axes are opposed already; change the sign of the distance along z"
    else:
        advice = (
            "both radiate along their own +z; rotate one of them by 180 degrees about its x or y "
            "axis"
        )
    number = f" in pose {pose}" if len(heights) > 1 else ""
    raise GeometryError(
        f"expected all of the {one} in front of the {other}'s plane, got its point ({x:.6g}, "
        f"{y:.6g}) at z = {z:.6g} m of the {other}'s frame{number}; {advice}"
    )
