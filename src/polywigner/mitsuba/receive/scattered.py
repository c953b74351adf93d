"""The power that surfaces and fog scatter to a receiver, with its standard error.

Samples come in batches with seeds of their own, and the spread of the batches is the error. Paths
do not depend on the power of a source: with one seed, the render by one source and the other
lights, less the render by the other lights alone, is what that source gives, sample by sample.

The far pattern seldom leads to a shape that is small or off the beam. A share S of the samples goes
to boxes about such shapes, in the receiver's angles (alpha, psi), of which dalpha dpsi is a solid
angle; the rest goes as before. Samples of both weigh by the density of the mixture,

    S sum_k p_k [in box k]/Omega_k + (1 - S) p(alpha, psi),

the balance heuristic, so that means stay as they are. Source: E. Veach and L. J. Guibas,
"Optimally combining sampling techniques for Monte Carlo rendering", SIGGRAPH 1995.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from polywigner.execution import Drjit, ops_for
from polywigner.geometry.parts import connected
from polywigner.mitsuba.plugins.films import changed, check_spp, mean_of_colours, seed_of
from polywigner.mitsuba.radar.range_film import sorted_by_range, transient_integrator
from polywigner.mitsuba.receive.ray_transmission import joined, point_batches
from polywigner.mitsuba.scenes.rendering import check_is_whole, exposed, lit_by
from polywigner.mitsuba.scenes.surfaces import (
    bounds_of,
    faces_of,
    is_receiver,
    sorted_shapes,
    vertices_of,
    wigner_emitters,
)

Floats = NDArray[np.float64]
Complexes = NDArray[np.complex128]

# ---- rays towards small shapes ------------------------------------------------------------------

# Share S of the samples: what is in no box has errors larger by 1/(1 - S), 1.14, where samples in
# strata gain as their number, and by 1.07 where they gain as its root.
_SHARE = 1 / 8
# Of these, so much goes to all boxes alike, so that each has some in a profile of range.
_ALIKE = 0.5
# Boxes of one receiver: each sample is looked for in all. Pieces of a mesh that are told apart.
_MOST_BOXES, _MOST_PIECES, _MOST_FACES = 64, 64, 1 << 17
# A box that gets more of the samples without any aim needs none.
_OFTEN = 1 / 16
# Widths in angle below which single precision leaves too few directions; margin about a box, for
# its sides look bent from the receiver.
_NARROWEST, _MARGIN = 1e-5, 0.02
# Places along each side of boxes, and along each axis of angles.
_PLACES = 3
_LOOKS = 5


def aimed(scene: Any) -> AbstractContextManager[None]:
    """Within, receivers of one pixel look towards small shapes more often, with smaller weights."""
    sources = [emitter.get_shape() for emitter in wigner_emitters(scene)]
    shapes = [shape for shape in sorted_shapes(scene) if shape not in sources]
    boxes = np.reshape([box for shape in shapes for box in _boxes(shape)], (-1, 2, 3))
    changes = []
    for sensor in filter(is_receiver, scene.sensors()):
        rows = _targets(sensor, boxes)
        if len(rows):
            looks = AimedDirections(mi, sensor.directions, rows)
            changes.append((sensor, "directions", looks))
    return changed(changes)


def _boxes(shape: Any) -> list[Floats]:
    """Least and largest corners (2, 3) of a shape, or of the pieces of a mesh."""
    whole = [bounds_of(shape)]
    if not shape.is_mesh() or not 1 < shape.face_count() <= _MOST_FACES:
        return whole
    if "faces" not in mi.traverse(shape):  # a rectangle
        return whole
    faces, places = faces_of(shape), vertices_of(shape)
    # corners of one place are one, as of meshes with normals
    places, numbers = np.unique(places, axis=0, return_inverse=True)
    faces = numbers.ravel()[faces]
    first, second, third = faces.T
    labels = connected(len(places), np.append(first, first), np.append(second, third))
    pieces, owner = np.unique(labels[first], return_inverse=True)
    if not 1 < len(pieces) <= _MOST_PIECES:
        return whole
    corners = (places[faces[owner == k]].reshape(-1, 3) for k in range(len(pieces)))
    return [np.array([own.min(axis=0), own.max(axis=0)]) for own in corners]


def _seen(sensor: Any, boxes: Floats) -> Floats:
    """Ways (n, m, 3) in a receiver's frame to places in boxes, of those wholly in front of it."""
    grid = np.linspace(0.0, 1.0, _PLACES)
    inner = np.stack(np.meshgrid(grid, grid, grid), axis=-1).reshape(-1, 3)
    places = boxes[:, None, 0] + np.diff(boxes, axis=1) * inner
    spec = sensor.spec
    own = (places - spec.pose[:3, 3]) @ spec.pose[:3, :3] - np.append(spec.centre, 0.0)
    corners = np.reshape(spec.at_origin.bounds, (2, 2)) / spec.scene_unit
    starts = [[x, y, 0.0] for x in corners[:, 0] for y in corners[:, 1]]  # of rays
    ways = np.concatenate([own - start for start in starts], axis=1)
    return np.asarray(ways[(ways[..., 2] > 0.0).all(axis=1)])


def _targets(sensor: Any, boxes: Floats) -> Floats:
    """(n, 5): least alpha and psi, largest alpha and psi, and share of the samples, of boxes."""
    seen = _seen(sensor, boxes)
    if not len(seen):
        return np.empty((0, 5))
    distance = np.linalg.norm(seen, axis=-1)
    angles = np.stack([seen[..., 0] / distance, np.arctan2(seen[..., 1], seen[..., 2])], axis=-1)
    low, high = angles.min(axis=1), angles.max(axis=1)
    added = np.maximum(_MARGIN * (high - low), _NARROWEST / 2)
    limit = np.array([1.0, np.pi / 2])
    low, high = np.maximum(low - added, -limit), np.minimum(high + added, limit)
    rows = np.concatenate([low, high], axis=1).astype(np.float32).astype(np.float64)
    often = _often(sensor.directions, rows)
    rare = (often < _OFTEN) & (often > 0.0)
    if not rare.any():
        return np.empty((0, 5))
    returned = (often / distance.mean(axis=1) ** 2)[rare]
    chosen = np.argsort(-returned, kind="stable")[:_MOST_BOXES]
    share = _ALIKE / max(1, len(chosen)) + (1 - _ALIKE) * returned[chosen] / returned[chosen].sum()
    return np.column_stack([rows[rare][chosen], share])


def _often(directions: Any, rows: Floats) -> Floats:
    """(n,): share of the samples of directions that boxes get without any aim."""
    steps = (np.arange(_LOOKS) + 0.5) / _LOOKS
    inner = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
    low, size = rows[:, None, :2], np.diff(rows.reshape(-1, 2, 2), axis=1)
    angles = (low + size * inner).reshape(-1, 2)
    density = joined(directions.density(points) for (points,) in point_batches(angles))
    means = density.reshape(len(rows), -1).mean(axis=1)
    return np.asarray(means * size.prod(axis=-1).ravel())


class AimedDirections:
    """Samples boxes of angles and other ``directions`` in turns, for one variant's arrays."""

    def __init__(self, m: Any, directions: Any, rows: Floats) -> None:
        """``rows`` (n, 5): least alpha and psi, largest, and share of each box."""
        self._m, self._jit, self._others = m, dr.is_jit_v(m.Float), directions
        self._ops = ops_for(m.Float)
        low, high, share = rows[:, :2], rows[:, 2:4], rows[:, 4]
        ends = np.cumsum(share)
        ends[-1] = 1.0
        starts = np.append(0.0, ends[:-1])
        density = share / (high - low).prod(axis=1)
        table = np.column_stack([low, high, starts, 1.0 / (ends - starts), ends, density])
        self._count: Any = len(table)
        # of one length, so that scenes with other shapes compile no other kernels
        table = np.pad(table, ((0, _MOST_BOXES - len(table)), (0, 0)))
        self._columns: Any = [column.tolist() for column in table.T]
        if self._jit:
            self._count = dr.opaque(m.UInt32, self._count)
            self._columns = [m.Float(column) for column in self._columns]

    def sample(self, sample: Any) -> tuple[Drjit, Drjit]:
        """Angles for a uniform point of the unit square, and their density."""
        m = self._m
        aims = sample.x < _SHARE
        rest = dr.select(aims, 0.5, (sample.x - _SHARE) * (1 / (1 - _SHARE)))
        others, density = self._others.sample(m.Point2f(rest, sample.y))
        place = dr.select(aims, sample.x * (1 / _SHARE), 0.0)
        number = self._sum(lambda k: dr.select(place >= self._at(6, k), 1.0, 0.0))
        number = m.UInt32(number) if self._jit else min(int(number), self._count - 1)
        place = (place - self._at(4, number)) * self._at(5, number)
        found = [
            dr.select(aims, self._between(number, axis, u), other)
            for axis, (u, other) in enumerate([(place, others.x), (sample.y, others.y)])
        ]
        angles = m.Point2f(*found)
        own = dr.select(aims, self._others.density(angles), density)
        return angles, self._mixed(angles, own)

    def density(self, angles: Any) -> Drjit:
        """Per solid angle."""
        return self._mixed(angles, self._others.density(angles))

    def _mixed(self, angles: Any, others: Any) -> Drjit:
        return _SHARE * self._sum(lambda k: self._inside(angles, k)) + (1 - _SHARE) * others

    def _between(self, number: Any, axis: int, share: Any) -> Drjit:
        """An angle in a box, on its bounds where rounding takes it out."""
        low, high = self._at(axis, number), self._at(axis + 2, number)
        return dr.clip(low + (high - low) * share, low, high)

    def _inside(self, angles: Any, number: Any) -> Drjit:
        """The density of a box at angles."""
        in_alpha, in_psi = (
            (angle >= self._at(axis, number)) & (angle <= self._at(axis + 2, number))
            for axis, angle in enumerate((angles.x, angles.y))
        )
        return dr.select(in_alpha & in_psi, self._at(7, number), 0.0)

    def _at(self, column: int, number: Any) -> Drjit:
        if self._jit:
            return dr.gather(self._m.Float, self._columns[column], number)
        return self._columns[column][number]

    def _sum(self, term: Callable[[Any], Any]) -> Drjit:
        """The sum over all boxes, whose number is data."""
        return self._ops.fold(0, self._count, (0.0,), lambda k, total: (total + term(k),))[0]


# ---- batches ------------------------------------------------------------------------------------

# Their spread tells the standard error to 18 %.
BATCHES = 16


def batches_of(spp: int) -> int:
    """Samples in each of 16 batches, for ``spp`` or a few more in all."""
    return -(-check_spp(spp) // BATCHES)


@dataclass(frozen=True)
class Scattering:
    """Sampling of the light scattered to one receiver, in a scene whose sources are unseen."""

    sensor: int
    integrator: Any
    spp: int
    """Samples of all batches, as asked."""
    seed: int

    edges: tuple[float, ...] | None = None
    """Edges of bins of range: lengths of paths in units of the scene; None: all in one number."""

    @property
    def values(self) -> tuple[int, ...]:
        """Shape of a batch's power of each light: (), or nearer than all bins, in each, farther."""
        return () if self.edges is None else (len(self.edges) + 1,)

    def batch(
        self, scene: Any, number: int, done: Callable[[], None] = lambda: None
    ) -> NDArray[np.float64]:
        """W (lights, values) that one batch finds of each of :func:`lights_of`."""
        own, samples = seed_of(self.seed, number), batches_of(self.spp)
        exposure = exposed(
            scene, self.integrator, samples, own, self.sensor, self.edges is None or number == 0
        )
        if self.edges is not None:
            camera, edges = exposure.camera, np.array(self.edges)
            integrator = transient_integrator(exposure.integrator, scene, camera)
        found = []
        for light in lights_of(scene):
            with lit_by(wigner_emitters(scene), light):
                if self.edges is None:
                    image = exposure.picture(lambda: None)
                    check_is_whole(exposure.integrator)
                    power = mean_of_colours(image).sum()
                else:
                    ranged = sorted_by_range(scene, camera, integrator, edges, samples, own)
                    power = ranged.sum(axis=(0, 1))
            found.append(power)
            done()
        return np.array(found)


def lights_of(scene: Any) -> list[mi.Emitter | None]:
    """Lights that shine in turns: None for all incoherent ones, then each coherent source."""
    sources = wigner_emitters(scene)
    return ([None] if len(sources) < len(scene.emitters()) else []) + sources


def shares_of(scene: Any, found: NDArray[np.float64]) -> tuple[Floats, Floats]:
    """W of each coherent source (emitters, batches), and of other lights (batches,)."""
    if len(lights_of(scene)) == len(wigner_emitters(scene)):
        return np.moveaxis(found, 1, 0), np.zeros_like(found[:, 0])
    return np.moveaxis(found[:, 1:] - found[:, :1], 1, 0), found[:, 0]


def standard_error(batches: Floats, axis: int = 0) -> Floats:
    """Standard error of the mean of equal batches."""
    return np.std(batches, ddof=1, axis=axis) / math.sqrt(batches.shape[axis])
