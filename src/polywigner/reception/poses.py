"""Poses of a receiver in front of a transmitter, checked once at the public edge."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from polywigner.errors import GeometryError
from polywigner.geometry.arguments import RIGID_TOLERANCE, real_numbers, shape_of

Floats = NDArray[np.float64]

# Distances, in wavelengths too, have finite squares and inverse squares.
_FARTHEST = 1e100


def checked_poses(to_transmitter: Any, name: str = "to_transmitter") -> Floats:
    """Rigid poses (..., 4, 4): the nearest rotations, and the translations.

    Raises GeometryError for anything else.
    """
    expected = f"expected {name} as rigid poses (..., 4, 4)"
    try:
        poses = real_numbers(to_transmitter)
    except ValueError as error:
        raise GeometryError(f"{expected}, got {error}") from None
    if poses.shape[-2:] != (4, 4):
        raise GeometryError(f"{expected}, got shape {shape_of(to_transmitter)}")
    if not np.isfinite(poses).all():
        bad = poses[~np.isfinite(poses).all(axis=(-2, -1))][0]
        raise GeometryError(f"{expected}, got one that is not finite, {bad.tolist()}")
    farthest = float(np.abs(poses[..., :3, 3]).max(initial=0.0))
    if farthest > _FARTHEST:
        raise GeometryError(
            f"{expected}, got one {farthest:.3g} m away, whose square is no number; check its units"
        )
    if not np.allclose(poses[..., 3, :], (0.0, 0.0, 0.0, 1.0)):
        raise GeometryError(
            f"{expected}, got a last row other than (0, 0, 0, 1); the translation is the last "
            "column, and a pose is not multiplied by a scale"
        )
    rotation = poses[..., :3, :3]
    gram = np.swapaxes(rotation, -1, -2) @ rotation
    off = np.abs(gram - np.eye(3)).max(axis=(-2, -1))
    if (off > RIGID_TOLERANCE).any():
        raise GeometryError(
            f"{expected}, got one whose matrix departs from a rotation by {off.max():.3g}; scale "
            "the source itself"
        )
    if (np.linalg.det(rotation) < 0).any():
        raise GeometryError(f"{expected}, got a mirror image; mirror the source itself")
    left, _, right = np.linalg.svd(rotation)
    poses[..., :3, :3] = left @ right
    return poses


def check_facing(poses: Floats, transmitter: Floats, receiver: Floats) -> None:
    """That all of each source lies in front of the other's plane, from hulls (k, 2) of both.

    Then all lines between them leave the transmitter and reach the receiver on their front sides.
    Raises GeometryError that names the pose and the place otherwise.
    """
    turned = poses[:, :3, :3]
    there = np.einsum("nj,kj->nk", turned[:, 2, :2], receiver) + poses[:, 2, 3, None]
    _check_heights(there, receiver, "receiver", "transmitter")
    beside = np.einsum("nij,ni->nj", turned, poses[:, :3, 3])
    here = np.einsum("nj,kj->nk", turned[:, :2, 2], transmitter) - beside[:, 2, None]
    _check_heights(here, transmitter, "transmitter", "receiver")


def _check_heights(heights: Floats, corners: Floats, one: str, other: str) -> None:
    behind = ~(heights > 0)
    if not behind.any():
        return
    pose = int(behind.any(axis=1).argmax())
    lowest = int(heights[pose].argmin())
    x, y = corners[lowest].tolist()
    z = float(heights[pose, lowest])
    whole = bool(behind[pose].all())
    advice = (
        f"the {other} looks away from it: both radiate along their own +z, so turn one of them by "
        "half a turn about x or y"
        if whole
        else "move it forwards, or cut off what lies behind"
    )
    number = f" in pose {pose}" if len(heights) > 1 else ""
    raise GeometryError(
        f"expected all of the {one} in front of the {other}'s plane, got its point ({x:.6g}, "
        f"{y:.6g}) at z = {z:.6g} m of the {other}'s frame{number}; {advice}"
    )
