"""Diffraction by soft and hard plates in one plane (SB9).

The field of a conducting half-plane is the sum or difference of two black-screen fields: at the
point, and at its mirror image.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from polywigner.errors import ArgumentError
from polywigner.geometry.arguments import checked_choice
from polywigner.geometry.polyhedron import axes_across
from polywigner.geometry.silhouettes import ON, Obstacles, Silhouette
from polywigner.numerics import Complex, Floats
from polywigner.propagation.equivalent_points import RadiatingPoint

Edge = Literal["black", "soft", "hard"]
EDGES = ("black", "soft", "hard")

# Allowed distance of plates from their common plane, as a fraction of their extent. The limit
# allows for coordinates in single precision.
_UNEVEN = 1e-6
# Distance [wavelengths] from the source below which the field loses digits. A fourth-order mean
# over points at multiples of _STEP replaces the field there.
_CLOSE, _STEP = 1e-4, 1e-3
_WEIGHTS = {1: 4 / 6, -1: 4 / 6, 2: -1 / 6, -2: -1 / 6}


@dataclass(frozen=True)
class Sheet:
    """Plane that contains all plates, in wavelengths."""

    plane: Floats
    """Unit normal n and offset d, shape (4,). The height of x is ``n.x + d``."""

    @classmethod
    def of(cls, bodies: Obstacles) -> Sheet:
        """Fit the plane to all obstacles by least squares."""
        centre = bodies.vertices.mean(axis=0)
        normal = np.linalg.svd(bodies.vertices - centre, full_matrices=False)[2][2]
        return cls(np.append(normal, -normal @ centre))

    @property
    def direction(self) -> Floats:
        """Unit vector in the plane, shape (3,)."""
        return axes_across(self.plane[:3])[0]

    def heights(self, positions: Floats) -> Floats:
        """Return the signed heights (n,) of positions (n, 3) above the plane."""
        return np.asarray(positions @ self.plane[:3] + self.plane[3])

    def silhouettes(self, bodies: Obstacles, sources: Floats) -> list[Silhouette]:
        """Return the silhouette of the plates for each source position (n, 3)."""
        # The same edges are visible from all points on one side of the plane. A view from such a
        # point is also valid for a source in the plane.
        centre, extent = bodies.vertices.mean(axis=0), np.ptp(bodies.vertices, axis=0).max()
        views = []
        for side in (-1.0, 1.0):
            seen = bodies.silhouette(centre + side * extent * self.plane[:3])
            planes = np.tile(side * self.plane, (len(seen.edges), 1))
            views.append(replace(seen, planes=planes))
        return [views[int(height >= 0.0)] for height in self.heights(sources)]

    def with_images(self, positions: Floats, source: Floats, least: Floats) -> Floats:
        """Return positions (n, 3) followed by their mirror images, shape (2n, 3).

        Positions that are closer to the plane than ``least`` (n,) are moved to this distance, on
        the side of the source (3,).
        """
        height, side = self.heights(positions), np.sign(self.heights(source))
        moved = np.where(np.abs(height) < least, least * (side or 1.0), height)
        shifts = np.stack([moved - height, -moved - height])
        return np.asarray(positions + shifts[..., None] * self.plane[:3]).reshape(-1, 3)


def flattened(bodies: Obstacles) -> Obstacles:
    """Return plates moved into their common plane; raise ArgumentError for other obstacles."""
    sheet = Sheet.of(bodies)
    heights = sheet.heights(bodies.vertices)
    allowed = _UNEVEN * float(np.ptp(bodies.vertices, axis=0).max())
    allowed += ON * float(np.abs(bodies.vertices).max())
    if np.abs(heights).max() > allowed or any(body.is_solid for body in bodies.bodies):
        raise ArgumentError(
            "soft and hard edges require plates in one plane as obstacles, got bodies or "
            'plates in several planes; use edge="black", or pass only plates in one plane'
        )
    normal, plates = sheet.plane[:3], []
    for body in bodies.bodies:
        height = sheet.heights(body.vertices)
        normals = np.where(body.normals @ normal < 0.0, -1.0, 1.0)[:, None] * normal
        flat = body.vertices - height[:, None] * normal
        plates.append(replace(body, vertices=flat, normals=normals))
    return Obstacles(plates)


Fields = tuple[Complex, Complex, Floats]


def change_by_sheet(
    compute: Callable[[list[Silhouette], Floats], Fields],
    edge: Edge,
    bodies: Obstacles,
    sources: Sequence[RadiatingPoint],
    positions: Floats,
    least: Floats,
) -> Fields:
    """Return the change of the field due to soft or hard plates, the free field and the error.

    ``compute`` returns the same three results for black plates. Positions (n, 3) within ``least``
    (n,) of a plate are treated as lying on its illuminated side.
    """
    sheet, count = Sheet.of(bodies), len(positions)
    origins = np.array([point.position for point in sources])
    on_plate = np.min([body.distance(positions) for body in bodies.bodies], axis=0) < least
    # Edge waves are discontinuous across the plane, so points in the plane are moved off it. This
    # is not necessary next to a hard plate, where the difference of the edge waves vanishes.
    raised = np.where(on_plate | (edge == "soft"), least, 0.0)
    both = sheet.with_images(positions, origins.mean(axis=0), raised)
    seen = sheet.silhouettes(bodies, origins)
    changes, waves, error = _averaged(
        partial(compute, seen), both, _close_to(origins, both), _STEP * sheet.direction
    )
    (here, mirrored), wave = np.split(changes, 2), waves[:count]
    free = wave.copy()
    free[on_plate] = sum(point.wave(positions[on_plate].T) for point in sources)
    if edge == "soft":
        change = np.where(on_plate, -free, here + mirrored)
    else:
        change = here - mirrored + (wave - free)
    return change, free, error[:count] + error[count:]


def check_source(bodies: Obstacles, origins: Floats) -> None:
    """Raise ArgumentError if a point of the source lies on a plate."""
    least = ON * float(np.abs(bodies.vertices).max())
    if min(float(body.distance(origins).min()) for body in bodies.bodies) <= least:
        raise ArgumentError(
            "the source lies on a soft or hard plate, where its field is undefined; move the "
            "plate away from the source"
        )


def _close_to(origins: Floats, positions: Floats) -> NDArray[np.bool_]:
    """Return a mask of the positions (n, 3) within 1e-4 wavelengths of any point in ``origins``."""
    close = np.zeros(len(positions), bool)
    low, high = origins.min(axis=0) - _CLOSE, origins.max(axis=0) + _CLOSE
    rows = np.flatnonzero(((positions > low) & (positions < high)).all(axis=1))
    for origin in origins:
        close[rows] |= np.linalg.norm(positions[rows] - origin, axis=1) < _CLOSE
    return close


def _averaged(
    compute: Callable[[Floats], Fields], positions: Floats, close: NDArray[np.bool_], step: Floats
) -> Fields:
    """Return the results of ``compute``, averaged over neighbours of ``close`` positions.

    See `mean_of_neighbours` for ``step``.
    """
    moved = np.where(close[:, None], positions + step, positions)
    results = compute(moved)
    if close.any():
        means = mean_of_neighbours(compute, positions[close], step)
        for result, mean in zip(results, means, strict=True):
            result[close] = mean
    return results


def mean_of_neighbours(
    compute: Callable[[Floats], Fields], positions: Floats, step: Floats
) -> list[NDArray[Any]]:
    """Return fourth-order means of the results of ``compute`` over neighbours of positions (n, 3).

    The four neighbours lie at -2, -1, 1 and 2 times ``step``, which is one vector (3,) or n vectors
    (n, 3). The list contains the mean of each result of ``compute``.
    """
    near = [compute(positions + number * step) for number in _WEIGHTS]
    weights = list(_WEIGHTS.values())
    return [np.tensordot(weights, values, 1) for values in zip(*near, strict=True)]


def check_edge(edge: object, obstacles: object) -> None:
    """Raise ArgumentError for an unknown boundary condition, or a condition without obstacles."""
    checked_choice(edge, "edge", EDGES)
    if obstacles is None and edge != "black":
        raise ArgumentError(
            f'edge="{edge}" requires obstacles; pass plates as obstacles, or omit edge'
        )
