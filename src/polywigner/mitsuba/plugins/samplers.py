"""Samplers of positions and directions on a source, and the frame of a source.

Directions have the coordinates (alpha, psi): alpha is the direction cosine along x, and psi the
angle in rad about the x axis, zero along the normal.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import drjit as dr
import mitsuba as mi
import numpy as np
import numpy.typing as npt

from polywigner.errors import SceneError
from polywigner.execution import Drjit, ops_for
from polywigner.geometry.arguments import finite_array
from polywigner.geometry.convex import Trapezoids, point_in_trapezoid, trapezoids
from polywigner.numerics import Floats
from polywigner.source.normal_form import normal_form
from polywigner.source.polarisation import Stokes
from polywigner.transforms import fourier

if TYPE_CHECKING:
    from polywigner.mitsuba.plugins.mixtures import SceneSource


# Largest number of strips per element, and largest total number of cells, for the sampling of
# non-uniform fields.
_STRIPS, _PIECES = 32, 1 << 16
# Number of points per lobe of the far field in the table of directions. A lobe has the width
# wavelength/size.
_POINTS_PER_LOBE = 4
# Smallest and largest number of points along each axis of the table of directions.
_FEWEST, _MOST = 32, 1024
# Largest number of samples along each side of a cell in the table of directions. The mean of these
# samples includes beams that are narrower than the cell.
_MOST_PER_CELL = 4
# Fractions of samples drawn from the far-field pattern (for distant surfaces), its square root (for
# the Wigner function and near surfaces), and a uniform density.
_FRACTIONS = (0.4, 0.4, 0.2)


def opaque(m: Any, value: float) -> Drjit:
    """Return a number that Dr.Jit does not compile into kernels as a literal."""
    return dr.opaque(m.Float, value) if dr.is_jit_v(m.Float) else value


def single_number(number: Any, name: str) -> float:
    """Return a value as a float; raise SceneError unless it is a single finite number."""
    values = np.asarray(dr.detach(number), dtype=np.float64).ravel()
    expected = f"expected {name} to be a single finite number"
    return float(finite_array(values, expected, (1,), error=SceneError)[0])


def cells_with_field(m: Any, source: SceneSource, unit: float) -> Positions:
    """Return a sampler of positions on a source, in units of ``unit`` m, with the density |u|^2."""
    elements = normal_form(source).in_plane.elements
    pieces = _PIECES // len(elements)
    tables, weights = [], []
    for element in elements:
        cells = trapezoids(element.rings)
        values = np.ones(1)
        if element.illumination is not None:
            cells = cells.divided(int(np.clip(np.sqrt(pieces / cells.left.size), 2, _STRIPS)))
            values = np.asarray(element.illumination(cells.midpoints))
        weights.append(np.broadcast_to(np.abs(element.weight * values) ** 2, cells.left.shape))
        tables.append(cells.rows)
    return Positions(m, Trapezoids(*(np.concatenate(tables) / unit).T), np.concatenate(weights))


class Positions:
    """Sampler of positions in trapezoids, with a constant density in each trapezoid."""

    def __init__(self, m: Any, cells: Trapezoids, weights: Floats | None = None) -> None:
        self._m, self._ops = m, ops_for(m.Float)
        self._table = self._ops.on_device(cells.rows)
        areas = cells.areas if weights is None else cells.areas * weights
        self._choice = m.DiscreteDistribution((areas / np.max(areas)).tolist())
        self.density = 1.0 / float(cells.areas.sum())
        """Density of uniform samples per area."""

    def sample(self, sample: mi.Point2f) -> mi.Point2f:
        """Map a point of the unit square to a position."""
        index, u = self._choice.sample_reuse(sample.x)
        # Rounding can move u out of [0, 1] in narrow trapezoids.
        u = self._ops.minimum(self._ops.maximum(u, 0.0), 1.0)
        row = self._ops.gather(self._table, index)
        return self._m.Point2f(*point_in_trapezoid(self._ops, row, u, sample.y))


class Directions:
    """Sampler of directions (alpha, psi) with a tabulated density."""

    def __init__(self, m: Any, values: Floats, sides: Floats) -> None:
        self._m = m
        table = values.astype(np.float32)
        self._warp = m.MarginalContinuous2D0(m.TensorXf(table) if dr.is_jit_v(m.Float) else table)
        self._low, self._size = m.Vector2f(*(-sides / 2).tolist()), m.Vector2f(*sides.tolist())
        self._inverse_area = 1.0 / float(np.prod(sides))

    def sample(self, sample: mi.Point2f) -> tuple[mi.Point2f, Drjit]:
        """Map points of the unit square to angles (alpha, psi), and return their density.

        The density is per solid angle.
        """
        point, density = self._warp.sample(sample)
        return self._m.Point2f(point * self._size + self._low), density * self._inverse_area

    def density(self, angles: mi.Point2f) -> Drjit:
        """Return the density of samples per solid angle at angles (alpha, psi)."""
        point = (angles - self._low) / self._size
        inside = dr.all((point >= 0.0) & (point <= 1.0))
        density = self._warp.eval(dr.clip(point, 0.0, 1.0))
        return dr.select(inside, density * self._inverse_area, 0.0)


def directions_of(
    m: Any, terms: Sequence[Any], bounds: Sequence[float], wavelength: float
) -> Directions:
    """Return a sampler of directions for a source.

    ``terms`` are the terms of `WignerRadiance`, and ``bounds`` is the source's bounding box in
    metres. The density is a mixture of the far-field pattern g |F|^2, the square root of this
    pattern, and a uniform density; g is the obliquity factor.
    """
    low, high = np.reshape(bounds, (2, 2))
    lobes = _POINTS_PER_LOBE * (high - low) / wavelength
    sides = np.array([2.0, math.pi])
    # Each new table size recompiles the render kernel, so sizes are powers of two.
    needed = 2.0 ** np.ceil(np.log2(lobes * sides))
    counts = np.clip(needed, _FEWEST, _MOST).astype(int)
    within = int(np.clip(np.ceil((needed / counts).max()), 1, _MOST_PER_CELL))
    pattern = _mean_pattern(terms, wavelength, counts, within)
    kinds = (pattern, np.sqrt(pattern), np.ones_like(pattern))
    density = sum(
        fraction * kind / kind.mean() for fraction, kind in zip(_FRACTIONS, kinds, strict=True)
    )
    return Directions(m, density, sides)


def _mean_pattern(
    terms: Sequence[Any], wavelength: float, counts: npt.NDArray[np.int_], within: int
) -> Floats:
    """Return the far-field pattern g |F|^2 on a grid of angles, averaged over each cell.

    ``counts`` is the number of cells along alpha and psi. The result has counts[1] + 1 rows for psi
    and counts[0] + 1 columns for alpha. ``within`` is the number of samples along each side of a
    cell.
    """
    steps = np.array([2.0, math.pi]) / counts
    shifts = (np.arange(within) + 0.5) / within - 0.5
    total = np.zeros(1)
    for shift in np.stack(np.meshgrid(shifts, shifts), axis=-1).reshape(-1, 2):
        axes = [
            (np.arange(n + 1) + offset) * step - n * step / 2
            for n, offset, step in zip(counts, shift, steps, strict=True)
        ]
        alpha, psi = np.clip(axes[0], -1.0, 1.0), axes[1][:, None]
        rho = np.sqrt(1.0 - alpha * alpha)
        cosine = np.maximum(rho * np.cos(psi), 0.0)
        nu = np.stack(np.broadcast_arrays(alpha, rho * np.sin(psi)), axis=-1) / wavelength
        for term in terms:
            total = total + np.abs(fourier(term.source, nu)) ** 2 * term.forms.irradiance(cosine)
    return np.maximum(total, 0.0)


class Frame:
    """Frame of a source, with the origin at the source's centre."""

    def __init__(self, m: Any, to_world: mi.Transform4f, centre: Floats) -> None:
        matrix = to_world.matrix
        columns = [m.Vector3f(*(matrix[row, col] for row in range(3))) for col in range(4)]
        cx, cy = centre.tolist()
        self._m = m
        self.axes = columns[:3]
        self.origin = m.Point3f(columns[0] * cx + columns[1] * cy + columns[3])
        # Each new literal value would recompile the render kernel.
        if dr.is_jit_v(m.Float):
            dr.make_opaque(self.axes, self.origin)

    def to_local(self, v: mi.Vector3f) -> mi.Vector3f:
        """Convert a vector in the scene, such as a point minus ``origin``, to this frame."""
        return self._m.Vector3f(*(dr.dot(axis, v) for axis in self.axes))

    def to_scene(self, v: mi.Vector3f) -> mi.Vector3f:
        """Convert a vector in this frame to the scene."""
        ex, ey, ez = self.axes
        return ex * v.x + ey * v.y + ez * v.z

    def point(self, x: mi.Point2f) -> mi.Point3f:
        """Convert a position in the source's plane to a point of the scene.

        The position is relative to the source's centre, in scene units.
        """
        ex, ey, _ = self.axes
        return self.origin + ex * x.x + ey * x.y


def spectrum(m: Any, value: Drjit, active: Drjit) -> Drjit:
    """Return an unpolarised spectrum of equal values, which is zero where ``active`` is false."""
    return m.depolarizer(m.UnpolarizedSpectrum(dr.select(active, value, 0.0)))


def times_stokes(m: Any, stokes: Stokes | None, value: Drjit) -> Drjit:
    """Multiply a value by a Stokes vector, if there is one."""
    return value if stokes is None else m.Vector4f(*stokes) * value
