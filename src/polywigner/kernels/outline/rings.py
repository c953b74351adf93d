"""An outline as rings of vertices on a grid, in its frame.

On the grid sums and differences of an offset and two vertices are exact, so that the side of an
edge on which a vertex lies is decided as in exact arithmetic (docs/theory/edges.md, (K2)).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
import numpy.typing as npt

from polywigner.geometry import Aperture
from polywigner.kernels.outline.frame import Frame, frame_of, power_of_two
from polywigner.kernels.outline.waves import UNIFORM, Waves, carrier_of, waves_in_frame
from polywigner.numerics.exact import RoundingGrid

__all__ = ["Outline", "outline_of"]

Floats = npt.NDArray[np.float64]
Numbers = npt.NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class Outline:
    """Rings of vertices, the polygon to their left."""

    frame: Frame
    step: float
    """The spacing of the grid, a power of two."""
    vertices: Floats
    """(n, 2) of all rings, one after the other; edge k begins at vertex k."""
    starts: Numbers
    """(rings + 1,) where each ring begins, and n."""
    waves: Waves = UNIFORM
    """The field on it."""

    @property
    def following(self) -> Numbers:
        """(n,) the vertex at which each edge ends."""
        found = np.arange(1, len(self.vertices) + 1)
        found[self.starts[1:] - 1] = self.starts[:-1]
        return found

    @property
    def edges(self) -> Floats:
        """(n, 4) both ends of each edge."""
        return np.hstack([self.vertices, self.vertices[self.following]])

    def turned(self) -> Outline:
        """The outline turned by half a turn about the centre of its frame."""
        return replace(self, vertices=-self.vertices)


@lru_cache(maxsize=64)
def outline_of(source: Aperture, double: bool) -> Outline:
    """The outline of an aperture for float64 or float32 kernels."""
    frame = frame_of(np.concatenate(source.rings))
    frame = replace(frame, carrier=carrier_of([source.illumination], 2))
    # offsets of up to twice the reach, less two vertices, have to be whole numbers of steps
    reach = power_of_two(4.0 * max(frame.reach))
    step = math.ldexp(reach, -53 if double else -24)
    grid = RoundingGrid(step)
    rings = [grid.rounded(frame.vertices(ring)) for ring in source.rings]
    rings = [ring for ring in rings if len(ring) > 2]
    starts = np.cumsum([0, *map(len, rings)])
    vertices = np.concatenate(rings) if rings else np.zeros((0, 2))
    waves = waves_in_frame(source.illumination, frame)
    return Outline(frame, step, vertices, starts, waves)
