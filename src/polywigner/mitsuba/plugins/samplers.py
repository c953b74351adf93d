"""Samplers of positions and directions for one variant's arrays, and the frame of a source."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import drjit as dr
import numpy as np
import numpy.typing as npt
import shapely

from polywigner.errors import SceneError
from polywigner.execution import Drjit, ops_for
from polywigner.geometry.convex import Trapezoids, point_in_trapezoid, trapezoids
from polywigner.source import Array
from polywigner.source.obliquities import Forms
from polywigner.source.polarisation import Stokes
from polywigner.transforms import fourier, position_marginal
from polywigner.transforms.automean_samples import in_phase
from polywigner.transforms.wavefronts import flat_of

if TYPE_CHECKING:
    from polywigner.mitsuba.plugins.emissions import Region, SceneSource

Floats = npt.NDArray[np.float64]

# Points of the table of densities along the longer side of the region; bilinear between points.
_TABLE = 256
# Most strips across an element, and pieces of all elements, for fields that are not uniform.
_STRIPS, _PIECES = 32, 1 << 16
# Fraction of the samples that is uniform in the region, so that no position is missed.
_EVERYWHERE = 0.02
# Points of the table of directions in a lobe, which is wavelength/size wide in direction cosines.
_IN_LOBE = 4
_FEWEST, _MOST = 32, 1024
# Points averaged along each side of a cell of the table, so that no narrow beam is missed.
_MOST_WITHIN = 4
# Fractions of the samples in proportion to the far pattern, for far surfaces; to its root, for W
# and near surfaces; and uniform in front.
_SHARES = (0.4, 0.4, 0.2)


def opaque(m: Any, value: float) -> Drjit:
    """A number of the variant ``m``: as a literal, each new value would compile a new kernel."""
    return dr.opaque(m.Float, value) if dr.is_jit_v(m.Float) else value


def single(number: Any, name: str) -> float:
    """One finite number, or SceneError."""
    values = np.asarray(dr.detach(number), dtype=np.float64).ravel()
    if values.size != 1 or not np.isfinite(values).all():
        raise SceneError(f"expected one finite number as {name}, got {values.tolist()}")
    return float(values[0])


def cells_with_field(m: Any, source: Any, unit: float) -> TrapezoidSampler:
    """The sampler of positions in a source in proportion to |u|^2, in units of ``unit`` metres."""
    source = flat_of(source)  # a curved wave has the same modulus
    weights = source.weights if isinstance(source, Array) else np.ones(1)
    elements = source.elements_in_plane
    pieces = _PIECES // len(elements)
    tables, shares = [], []
    for element, weight in zip(elements, weights, strict=True):
        field = element.illumination
        cells = trapezoids(element.rings)
        if field is not None:
            cells = cells.divided(int(np.clip(np.sqrt(pieces / cells.left.size), 2, _STRIPS)))
        values = np.ones(1) if field is None else field(cells.middles)
        shares.append(np.broadcast_to(np.abs(weight * values) ** 2, cells.left.shape))
        tables.append(cells.rows)
    return TrapezoidSampler(
        m, Trapezoids(*(np.concatenate(tables) / unit).T), np.concatenate(shares)
    )


class TrapezoidSampler:
    """The trapezoids of an aperture as tables of one variant's arrays."""

    def __init__(self, m: Any, cells: Trapezoids, weights: Floats | None = None) -> None:
        self._m, self._ops = m, ops_for(m.Float)
        self._count = cells.left.size
        columns = cells.columns
        if dr.is_jit_v(m.Float):
            self._columns = [m.Float(column.tolist()) for column in columns]
        else:
            self._columns = [column.tolist() for column in columns]
        shares = cells.areas if weights is None else cells.areas * weights
        self._choice = m.DiscreteDistribution((shares / np.max(shares)).tolist())

    def sample(self, sample: Any) -> Drjit:
        """A point, uniform in each cell, for a uniform point of the unit square."""
        m, u, index = self._m, sample.x, 0
        if self._count > 1:
            index, u = self._choice.sample_reuse(sample.x)
            # what is left of a sample in a cell of small share is rounded, and may lie outside
            u = self._ops.minimum(self._ops.maximum(u, 0.0), 1.0)
        return m.Point2f(*point_in_trapezoid(self._ops, self._row(index), u, sample.y))

    def _row(self, index: Any) -> list[Drjit]:
        if dr.is_jit_v(self._m.Float):
            return [dr.gather(self._m.Float, column, index) for column in self._columns]
        return [column[index] for column in self._columns]


def positions_of(m: Any, source: Any, region: Region, sampling: str, unit: float) -> Positions:
    """Return a sampler of positions for the variant ``m``, in units of ``unit`` metres.

    ``source`` and the support of its region are relative to the region's centre.

    ``"uniform"`` in the region that radiates; in proportion to the position marginal R_x, which
    bounds W, of the source with all its fields in phase (``"marginal"``); or to its square root
    (``"root-marginal"``). By Parseval's theorem the square root is the rms of W over all
    frequencies for uniform fields: it has the least variance over all directions of all densities
    that do not depend on the direction.
    """
    support = region.support
    if sampling == "uniform":
        return Positions(m, [ring / unit for ring in support.rings])
    low, high = np.reshape(support.bounds, (2, 2))
    counts = np.maximum(2, np.ceil(_TABLE * (high - low) / (high - low).max()).astype(int))
    axes = [np.linspace(a, b, n + 1) for a, b, n in zip(low, high, counts, strict=True)]
    points = np.stack(np.meshgrid(*axes), axis=-1)
    values = np.zeros(points.shape[:-1])
    for *shift, weight in region.shifts:
        shifted = position_marginal(in_phase(flat_of(source)), points + shift)
        values += weight * np.maximum(shifted, 0.0)
    density = np.sqrt(values) if sampling == "root-marginal" else values
    steps = (high - low) / counts
    near = shapely.dwithin(shapely.points(points), support.polygons, float(np.hypot(*steps)))
    density = density / density[near].mean() + _EVERYWHERE * near
    return Tabulated(m, density, low / unit, (high - low) / unit)


class Positions:
    """Uniform in an outline; the density of other ways differs."""

    def __init__(self, m: Any, rings: Sequence[Floats]) -> None:
        cells = trapezoids(rings)
        self._cells = TrapezoidSampler(m, cells)
        self._density = 1.0 / float(cells.areas.sum())

    def sample(self, sample: Any) -> tuple[Drjit, Drjit]:
        """A point for a uniform point of the unit square, and the density there."""
        return self._cells.sample(sample), self._density

    def density(self, x: Any) -> Drjit:
        """Per area, at a point."""
        return self._density


class Tabulated(Positions):
    """A density known on the points of a grid, rows along y, and bilinear between them."""

    def __init__(self, m: Any, values: Floats, low: Any, size: Any) -> None:
        self._m = m
        table = values.astype(np.float32)
        self._warp = m.MarginalContinuous2D0(m.TensorXf(table) if dr.is_jit_v(m.Float) else table)
        self._low, self._size = m.Vector2f(*low.tolist()), m.Vector2f(*size.tolist())
        self._inverse_area = 1.0 / float(np.prod(size))

    def sample(self, sample: Any) -> tuple[Drjit, Drjit]:
        place, density = self._warp.sample(sample)
        return self._m.Point2f(place * self._size + self._low), density * self._inverse_area

    def density(self, x: Any) -> Drjit:
        place = (x - self._low) / self._size
        inside = dr.all((place >= 0.0) & (place <= 1.0))
        density = self._warp.eval(dr.clip(place, 0.0, 1.0))
        return dr.select(inside, density * self._inverse_area, 0.0)


def directions_of(
    m: Any,
    terms: Sequence[tuple[SceneSource, Forms]],
    bounds: Sequence[float],
    wavelength: float,
    coherence_width: float,
) -> Tabulated:
    """Return a sampler of (alpha, psi) in proportion to the far pattern g |F|^2, and uniform.

    ``terms``: scalar sources with the forms of g, as of `emissions`; ``bounds``: of the source.
    """
    low, high = np.reshape(bounds, (2, 2))
    lobes = _IN_LOBE * (high - low) / wavelength
    sides = np.array([2.0, math.pi])
    # powers of two: as a literal, every new size would compile the render kernel again
    wanted = 2.0 ** np.ceil(np.log2(lobes * sides))
    counts = np.clip(wanted, _FEWEST, _MOST).astype(int)
    within = int(np.clip(np.ceil((wanted / counts).max()), 1, _MOST_WITHIN))
    pattern = _mean_pattern(terms, wavelength, counts, within)
    spread = wavelength / (2 * math.pi * coherence_width)
    if spread > 0:
        pattern = _blurred(pattern, spread * counts / sides)
    kinds = (pattern, np.sqrt(pattern), np.ones_like(pattern))
    density = sum(share * kind / kind.mean() for share, kind in zip(_SHARES, kinds, strict=True))
    return Tabulated(m, density, -sides / 2, sides)


def _mean_pattern(
    terms: Sequence[tuple[SceneSource, Forms]], wavelength: float, counts: Any, within: int
) -> Floats:
    """g |F|^2 at the points of a grid, the mean over so many places a side around each."""
    steps = np.array([2.0, math.pi]) / counts
    shifts = (np.arange(within) + 0.5) / within - 0.5
    total: Any = 0.0
    for shift_x in shifts:
        for shift_y in shifts:
            axes = [
                (np.arange(n + 1) + shift) * step - n * step / 2
                for n, shift, step in zip(counts, (shift_x, shift_y), steps, strict=True)
            ]
            alpha, psi = np.clip(axes[0], -1.0, 1.0), axes[1][:, None]
            rho = np.sqrt(1.0 - alpha * alpha)
            cosine = np.maximum(rho * np.cos(psi), 0.0)
            nu = np.stack(np.broadcast_arrays(alpha, rho * np.sin(psi)), axis=-1) / wavelength
            for field, forms in terms:
                factor = forms.irradiance(cosine)
                total = total + np.abs(fourier(field, nu)) ** 2 * factor
    return np.maximum(np.asarray(total), 0.0)


def _blurred(values: Floats, steps: Any) -> Floats:
    """Values, rows along y, blurred by a normal density of so many steps along x and y."""
    for axis, width in ((1, steps[0]), (0, steps[1])):
        half = min(values.shape[axis] - 1, math.ceil(4 * width))
        weights = np.exp(-0.5 * (np.arange(-half, half + 1) / width) ** 2)
        moved = np.moveaxis(values, axis, -1)
        rows = [np.convolve(row, weights / weights.sum(), mode="same") for row in moved]
        values = np.moveaxis(np.array(rows)[..., : moved.shape[-1]], -1, axis)
    return values


class Frame:
    """A rigid frame of one variant's arrays, its origin in the middle of a source."""

    def __init__(self, m: Any, to_world: Any, centre: Floats) -> None:
        matrix = to_world.matrix
        columns = [m.Vector3f(*(matrix[row, col] for row in range(3))) for col in range(4)]
        cx, cy = centre.tolist()
        self._m = m
        self.axes = columns[:3]
        self.origin = m.Point3f(columns[0] * cx + columns[1] * cy + columns[3])
        # as literals, every new pose would compile the render kernel again
        if dr.is_jit_v(m.Float):
            dr.make_opaque(self.axes, self.origin)

    def to_own(self, v: Any) -> Drjit:
        """A vector of the scene in this frame."""
        return self._m.Vector3f(*(dr.dot(axis, v) for axis in self.axes))

    def to_scene(self, v: Any) -> Drjit:
        """A vector of this frame in the scene."""
        ex, ey, ez = self.axes
        return ex * v.x + ey * v.y + ez * v.z

    def point(self, x: Any) -> Drjit:
        """The point of the scene at a position in the plane."""
        ex, ey, _ = self.axes
        return self.origin + ex * x.x + ey * x.y


def spectrum(m: Any, value: Any, active: Any) -> Drjit:
    """A value of one narrow band: the same in every channel or at every sampled wavelength."""
    return m.depolarizer(m.UnpolarizedSpectrum(dr.select(active, value, 0.0)))


def four(m: Any, stokes: Stokes | None, value: Any) -> Drjit:
    """A field's value times its four Stokes numbers; the value where there are none."""
    return value if stokes is None else m.Vector4f(*stokes) * value
