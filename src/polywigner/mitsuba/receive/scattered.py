"""Power that surfaces and fog scatter to a receiver, with its standard error from batches.

The contribution of a source is the difference between two renders with the same seed, with and
without the source. A fraction S of the samples is aimed at boxes around small shapes, in the
receiver's angles (alpha, psi), whose area element is a solid angle. The density of samples is

    S sum_k p_k [in box k]/Omega_k + (1 - S) p(alpha, psi),

where p is the density of the far-field pattern, and p_k and Omega_k are the probability and the
solid angle of box k. Source of the weights (balance heuristic): E. Veach and L. J. Guibas,
"Optimally combining sampling techniques for Monte Carlo rendering", SIGGRAPH 1995.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from functools import partial
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from polywigner.execution import Drjit, ops_for
from polywigner.mitsuba.plugins.films import changed, check_spp, mean_of_colours, seed_of
from polywigner.mitsuba.radar.range_film import sorted_by_range, transient_integrator
from polywigner.mitsuba.receive.ray_transmission import joined, point_batches
from polywigner.mitsuba.scenes.rendering import check_is_complete, exposed, illuminated_by
from polywigner.mitsuba.scenes.surfaces import (
    bounds_of,
    faces_of,
    is_receiver,
    pieces_of_mesh,
    sorted_shapes,
    vertices_of,
    wigner_emitters,
)
from polywigner.numerics import Floats

# Fraction S of the samples that are aimed at boxes. Errors in other directions grow by a factor of
# at most 1/(1 - S) = 1.14.
_AIMED = 1 / 8
# Fraction of the aimed samples that all boxes share equally, so that each box has samples in a
# range profile.
_EQUAL = 0.5
# Largest number of boxes per receiver, because each sample tests all boxes.
_MOST_BOXES = 64
# Largest number of pieces, and largest number of faces, for which each piece of a mesh has a
# separate box.
_MOST_PIECES, _MOST_FACES = 64, 1 << 17
# Samples are aimed at a box if less than this fraction of the unaimed samples is in the box.
_MOST_UNAIMED = 1 / 16
# Smallest width of a box [rad], limited by single precision.
_NARROWEST = 1e-5
# Relative margin around a box of angles. It is required because sides that are straight in space
# are curved in angle coordinates.
_MARGIN = 0.02
# Number of points along each side of a box, both for boxes in space and for boxes of angles.
_POINTS = 3
_PROBES = 5


def aimed(scene: Any) -> AbstractContextManager[None]:
    """Aim samples of receivers at small shapes within a ``with`` block."""
    sources = [emitter.get_shape() for emitter in wigner_emitters(scene)]
    shapes = [shape for shape in sorted_shapes(scene) if shape not in sources]
    boxes = np.reshape([box for shape in shapes for box in _boxes(shape)], (-1, 2, 3))
    changes = []
    for sensor in filter(is_receiver, scene.sensors()):
        rows = _boxes_of_angles(sensor, boxes)
        if len(rows):
            aimed_directions = AimedDirections(mi, sensor.directions, rows)
            changes.append((sensor, "directions", aimed_directions))
    return changed(changes)


def _boxes(shape: Any) -> list[Floats]:
    """Return the bounding boxes (2, 3) of a shape or of the pieces of a mesh."""
    shape_box = [bounds_of(shape)]
    if "faces" not in mi.traverse(shape) or not 1 < shape.face_count() <= _MOST_FACES:
        return shape_box
    pieces = pieces_of_mesh(vertices_of(shape), faces_of(shape))
    if not 1 < len(pieces) <= _MOST_PIECES:
        return shape_box
    return [np.array([points.min(axis=0), points.max(axis=0)]) for points, _ in pieces]


def _vectors_to_boxes(sensor: Any, boxes: Floats) -> Floats:
    """Return vectors (boxes, points, 3) from the corners of a receiver to points in boxes.

    The vectors are in the receiver's frame, in scene units. Boxes that are not entirely in front of
    the receiver are omitted.
    """
    grid = np.linspace(0.0, 1.0, _POINTS)
    inner = np.stack(np.meshgrid(grid, grid, grid), axis=-1).reshape(-1, 3)
    points = boxes[:, None, 0] + np.diff(boxes, axis=1) * inner
    spec = sensor.spec
    local = (points - spec.pose[:3, 3]) @ spec.pose[:3, :3] - np.append(spec.centre, 0.0)
    corners = np.reshape(spec.at_origin.bounds, (2, 2)) / spec.scene_unit
    starts = [[x, y, 0.0] for x in corners[:, 0] for y in corners[:, 1]]
    vectors = np.concatenate([local - start for start in starts], axis=1)
    return np.asarray(vectors[(vectors[..., 2] > 0.0).all(axis=1)])


def _boxes_of_angles(sensor: Any, boxes: Floats) -> Floats:
    """Return boxes of angles around small shapes as seen from a receiver, shape (n, 5).

    ``boxes`` (m, 2, 3) are bounding boxes in space. The columns are the lower alpha and psi, the
    upper alpha and psi, and the fraction of the aimed samples. alpha is the direction cosine along
    the receiver's x axis, and psi is atan2(y, z) in rad.
    """
    vectors = _vectors_to_boxes(sensor, boxes)
    if not len(vectors):
        return np.empty((0, 5))
    distance, (x, y, z) = np.linalg.norm(vectors, axis=-1), np.moveaxis(vectors, -1, 0)
    angles = np.stack([x / distance, np.arctan2(y, z)], axis=-1)
    low, high = angles.min(axis=1), angles.max(axis=1)
    added = np.maximum(_MARGIN * (high - low), _NARROWEST / 2)
    limit = np.array([1.0, np.pi / 2])
    low, high = np.maximum(low - added, -limit), np.minimum(high + added, limit)
    rows = np.concatenate([low, high], axis=1).astype(np.float32).astype(np.float64)
    fraction = _unaimed_fraction(sensor.directions, rows)
    rare = (fraction < _MOST_UNAIMED) & (fraction > 0.0)
    returned = (fraction / distance.mean(axis=1) ** 2)[rare]
    chosen = np.argsort(-returned, kind="stable")[:_MOST_BOXES]
    fractions = (
        _EQUAL / max(1, len(chosen)) + (1 - _EQUAL) * returned[chosen] / returned[chosen].sum()
    )
    return np.column_stack([rows[rare][chosen], fractions])


def _unaimed_fraction(directions: Any, rows: Floats) -> Floats:
    """Return the fraction of the unaimed samples in the boxes of `_boxes_of_angles`, shape (n,)."""
    steps = (np.arange(_PROBES) + 0.5) / _PROBES
    inner = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
    low, size = rows[:, None, :2], np.diff(rows.reshape(-1, 2, 2), axis=1)
    angles = (low + size * inner).reshape(-1, 2)
    density = joined(directions.density(points) for (points,) in point_batches(angles))
    means = density.reshape(len(rows), -1).mean(axis=1)
    return np.asarray(means * size.prod(axis=-1).ravel())


class AimedDirections:
    """Sampler that draws directions in boxes of angles, or from another sampler."""

    def __init__(self, m: Any, directions: Any, rows: Floats) -> None:
        self._m, self._others = m, directions
        self._ops = ops_for(m.Float)
        low, high, fractions = rows[:, :2], rows[:, 2:4], rows[:, 4]
        ends = np.cumsum(fractions)
        ends[-1] = 1.0
        starts = np.append(0.0, ends[:-1])
        density = fractions / (high - low).prod(axis=1)
        table = np.column_stack([low, high, starts, 1.0 / (ends - starts), ends, density])
        self._count: Any = len(table)
        # A constant length keeps kernels independent of the number of shapes.
        table = np.pad(table, ((0, _MOST_BOXES - len(table)), (0, 0)))
        self._table = self._ops.on_device(table)
        if dr.is_jit_v(m.Float):
            self._count = dr.opaque(m.UInt32, self._count)

    def sample(self, sample: Any) -> tuple[Drjit, Drjit]:
        """Map points of the unit square to angles (alpha, psi), and return their density.

        The angles are defined in `_boxes_of_angles`. The density is per solid angle.
        """
        m = self._m
        aims = sample.x < _AIMED
        unaimed = dr.select(aims, 0.5, (sample.x - _AIMED) * (1 / (1 - _AIMED)))
        others, density = self._others.sample(m.Point2f(unaimed, sample.y))
        u = dr.select(aims, sample.x * (1 / _AIMED), 0.0)
        number = self._ops.truncated(self._box_sum(lambda box: dr.select(u >= box[6], 1.0, 0.0)))
        box = self._ops.gather(self._table, number)
        alpha = _between(box[0], box[2], (u - box[4]) * box[5])
        psi = _between(box[1], box[3], sample.y)
        angles = m.Point2f(dr.select(aims, alpha, others.x), dr.select(aims, psi, others.y))
        density = dr.select(aims, self._others.density(angles), density)
        return angles, self._mixture_density(angles, density)

    def density(self, angles: Any) -> Drjit:
        """Return the density of samples per solid angle at angles (alpha, psi)."""
        return self._mixture_density(angles, self._others.density(angles))

    def _mixture_density(self, angles: Any, others: Any) -> Drjit:
        """Return the density of all samples; ``others`` is the density of the unaimed samples."""
        return _AIMED * self._box_sum(partial(_density_in, angles)) + (1 - _AIMED) * others

    def _box_sum(self, term: Callable[[Any], Any]) -> Drjit:
        """Return the sum of ``term(row)`` over all boxes; a row describes a box."""

        def add(number: Any, total: Drjit) -> tuple[Drjit]:
            """Add the term of a box."""
            return (total + term(self._ops.gather(self._table, number)),)

        return self._ops.fold(0, self._count, (0.0,), add)[0]


def _between(low: Drjit, high: Drjit, u: Drjit) -> Drjit:
    """Return ``low + (high - low) u``, limited to this interval despite rounding errors."""
    return dr.clip(low + (high - low) * u, low, high)


def _density_in(angles: Any, box: Sequence[Drjit]) -> Drjit:
    """Return the density per solid angle of the samples aimed at a box, at angles (alpha, psi)."""
    in_alpha, in_psi = (
        (angle >= low) & (angle <= high)
        for angle, low, high in zip((angles.x, angles.y), box[:2], box[2:4], strict=True)
    )
    return dr.select(in_alpha & in_psi, box[7], 0.0)


# Number of batches; the standard error is accurate to 18 %.
BATCHES = 16


def batch_spp(spp: int) -> int:
    """Return the number of samples of each of 16 batches for a total of at least ``spp``."""
    return -(-check_spp(spp) // BATCHES)


@dataclass(frozen=True)
class Scattering:
    """Settings for sampling the light scattered to a receiver."""

    sensor: int
    integrator: Any
    spp: int
    """Requested total number of samples."""
    seed: int
    edges: tuple[float, ...] | None = None
    """Edges of range bins, as path lengths in scene units, or None without bins."""

    @property
    def values(self) -> tuple[int, ...]:
        """Shape of the power of one light in a batch.

        The shape is () without range bins, and (bins + 2,) with range bins. The two additional
        values belong to shorter and longer paths.
        """
        return () if self.edges is None else (len(self.edges) + 1,)

    def batch(
        self, scene: Any, number: int, done: Callable[[], None] = lambda: None
    ) -> NDArray[np.float64]:
        """Render one batch; return powers in W, shape (lights, *values).

        The lights are in the order of `lights_of`. The power of a coherent source includes all
        incoherent lights, which `by_source` subtracts. ``done`` is called after each light.
        """
        seed, samples = seed_of(self.seed, number), batch_spp(self.spp)
        warn = self.edges is None or number == 0
        exposure = exposed(scene, self.integrator, samples, seed, self.sensor, warn)
        if self.edges is not None:
            camera, edges = exposure.camera, np.array(self.edges)
            integrator = transient_integrator(exposure.integrator, scene, camera)
        powers = []
        for light in lights_of(scene):
            with illuminated_by(wigner_emitters(scene), light):
                if self.edges is None:
                    image = exposure.full_image(lambda: None)
                    check_is_complete(exposure.integrator)
                    power = mean_of_colours(image).sum()
                else:
                    ranged = sorted_by_range(scene, camera, integrator, edges, samples, seed)
                    power = ranged.sum(axis=(0, 1))
            powers.append(power)
            done()
        return np.array(powers)


def lights_of(scene: Any) -> list[mi.Emitter | None]:
    """Return the lights to render separately: None (all incoherent lights), then each source."""
    sources = wigner_emitters(scene)
    return ([None] if len(sources) < len(scene.emitters()) else []) + sources


def by_source(scene: Any, powers: NDArray[np.float64]) -> tuple[Floats, Floats]:
    """Divide powers by light into the powers of coherent sources and of all other lights.

    ``powers`` (batches, lights, ...) follow the order of `lights_of`, and the power of a source
    includes all incoherent lights. The results have the shapes (sources, batches, ...) and
    (batches, ...).
    """
    if len(lights_of(scene)) == len(wigner_emitters(scene)):
        return np.moveaxis(powers, 1, 0), np.zeros_like(powers[:, 0])
    return np.moveaxis(powers[:, 1:] - powers[:, :1], 1, 0), powers[:, 0]


def standard_error(batches: Floats, axis: int = 0) -> Floats:
    """Return the standard error of a mean over batches of equal size."""
    return np.std(batches, ddof=1, axis=axis) / math.sqrt(batches.shape[axis])
