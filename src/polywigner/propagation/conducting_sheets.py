"""Fields behind and in front of soft and hard plates in one plane. Source: (SB9).

The field near a conducting half-plane is the sum or difference of two fields with a shadow: the
incident field at the point, and the incident field at the mirror image of the point. Both shadows
have edge waves of the same form. The field at one point therefore requires the edge waves at two
points.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from polywigner.errors import ArgumentError
from polywigner.geometry.arguments import checked_choice
from polywigner.geometry.silhouettes import ON, Obstacles, Silhouette

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]

Edge = Literal["black", "soft", "hard"]
EDGES = ("black", "soft", "hard")


@dataclass(frozen=True)
class Sheet:
    """Plane that contains all plates. Lengths are in wavelengths."""

    plane: Floats
    """Unit normal n and offset d of the plane, shape (4,).

    The height of a position x above the plane is ``n.x + d``.
    """

    @classmethod
    def of(cls, bodies: Obstacles) -> Sheet:
        """Return the plane of all plates; raise ArgumentError for bodies or for several planes."""
        normal = bodies.bodies[0].normals[0]
        normal = normal / np.linalg.norm(normal)
        heights = bodies.vertices @ normal
        uneven = float(np.ptp(heights)) > ON * float(np.abs(bodies.vertices).max())
        if uneven or any(body.is_solid for body in bodies.bodies):
            raise ArgumentError(
                "soft and hard edges require plates in one plane as obstacles, got bodies or "
                'several planes; use edge="black", or pass only plates in one plane'
            )
        return cls(np.append(normal, -heights.mean()))

    def heights(self, positions: Floats) -> Floats:
        return np.asarray(positions @ self.plane[:3] + self.plane[3])

    def silhouettes(self, bodies: Obstacles, sources: Floats) -> list[Silhouette]:
        """Return the silhouette of the plates for each source position (n, 3)."""
        # The edges do not depend on the position of the source. They are found from a point in
        # front of the plane, because sources may lie in the plane.
        centre, extent = bodies.vertices.mean(axis=0), np.ptp(bodies.vertices, axis=0).max()
        views = []
        for side in (-1.0, 1.0):
            seen = bodies.silhouette(centre + side * extent * self.plane[:3])
            planes = np.tile(side * self.plane, (len(seen.edges), 1))
            views.append(replace(seen, planes=planes))
        return [views[int(height >= 0.0)] for height in self.heights(sources)]

    def with_images(self, positions: Floats, source: Floats, least: Floats) -> Floats:
        """Return positions (n, 3) followed by their mirror images, as one array (2n, 3).

        Positions whose height above the plane is below ``least`` (n,) are first moved to this
        height on the side of the source.
        """
        height, side = self.heights(positions), np.sign(self.heights(source))
        moved = np.where(np.abs(height) < least, least * (side or 1.0), height)
        shifts = np.stack([moved - height, -moved - height])
        return np.asarray(positions + shifts[..., None] * self.plane[:3]).reshape(-1, 3)


def change_by_sheet(
    compute: Callable[[list[Silhouette], Floats], tuple[Complex, Complex, Floats]],
    edge: Edge,
    bodies: Obstacles,
    sources: Floats,
    positions: Floats,
    least: Floats,
) -> tuple[Complex, Complex, Floats]:
    """Return the change of the field that soft or hard plates cause at positions (n, 3).

    Returns the change, the field without plates, and the error of the change. ``compute`` returns
    the same three arrays for black plates. Positions closer to a plate than ``least`` (n,) count as
    points on its illuminated side.
    """
    sheet, count = Sheet.of(bodies), len(positions)
    on_plate = np.min([body.distance(positions) for body in bodies.bodies], axis=0) < least
    raised = np.where(on_plate, least, 0.0)
    both = sheet.with_images(positions, sources.mean(axis=0), raised)
    changes, waves, error = compute(sheet.silhouettes(bodies, sources), both)
    (here, mirrored), (wave, image) = np.split(changes, 2), np.split(waves, 2)
    # Positions on a plate were moved off it. The field without plates at the original position is
    # the mean of the fields at the moved position and at its image.
    free = np.where(on_plate, 0.5 * (wave + image), wave)
    if edge == "soft":
        change = np.where(on_plate, -free, here + mirrored)
    else:
        change = here - mirrored + (wave - free)
    return change, free, error[:count] + error[count:]


def check_edge(edge: object, obstacles: object) -> None:
    """Raise ArgumentError for an unknown boundary condition, or if its obstacles are missing."""
    checked_choice(edge, "edge", EDGES)
    if obstacles is None and edge != "black":
        raise ArgumentError(
            f'edge="{edge}" requires obstacles; pass plates as obstacles, or omit edge'
        )
