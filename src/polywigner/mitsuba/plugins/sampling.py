"""Sampling of positions in an aperture, in its own coordinates, inside a renderer."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import drjit as dr
import numpy as np
import numpy.typing as npt
import shapely

from polywigner.errors import SceneError
from polywigner.execution import ops_for
from polywigner.geometry.convex import Trapezoids, point_in_trapezoid, trapezoids
from polywigner.mitsuba.plugins.sources import CentredSource
from polywigner.source import Array
from polywigner.source.polarisation import Stokes
from polywigner.transforms import position_marginal
from polywigner.transforms.sampling import in_phase
from polywigner.transforms.wavefronts import flat_of

SAMPLINGS = ("uniform", "marginal", "root-marginal")

# Along the longer side of the region that radiates; between these the density is bilinear.
_TABLE = 256
# Of fields that are not uniform: most strips across an element, and pieces of all elements.
_STRIPS, _PIECES = 32, 1 << 16
# A share of the samples goes everywhere in it, so that no place is left out that the table missed.
_EVERYWHERE = 0.02


def opaque(m: Any, value: float) -> Any:
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

    def __init__(
        self, m: Any, cells: Trapezoids, weights: npt.NDArray[np.float64] | None = None
    ) -> None:
        self._m, self._ops = m, ops_for(m.Float)
        self._count = cells.left.size
        columns = cells.columns
        if dr.is_jit_v(m.Float):
            self._columns = [m.Float(column.tolist()) for column in columns]
        else:
            self._columns = [column.tolist() for column in columns]
        shares = cells.areas if weights is None else cells.areas * weights
        self._choice = m.DiscreteDistribution((shares / np.max(shares)).tolist())

    def sample(self, sample: Any) -> Any:
        """A point, uniform in each cell, for a uniform point of the unit square."""
        m, u, index = self._m, sample.x, 0
        if self._count > 1:
            index, u = self._choice.sample_reuse(sample.x)
            # what is left of a sample in a cell of small share is rounded, and may lie outside
            u = self._ops.minimum(self._ops.maximum(u, 0.0), 1.0)
        return m.Point2f(*point_in_trapezoid(self._ops, self._row(index), u, sample.y))

    def _row(self, index: Any) -> list[Any]:
        if dr.is_jit_v(self._m.Float):
            return [dr.gather(self._m.Float, column, index) for column in self._columns]
        return [column[index] for column in self._columns]


def positions_of(m: Any, centred: CentredSource, sampling: str, unit: float) -> Positions:
    """A sampler of an emitter's positions for the variant ``m``, in units of ``unit`` metres.

    ``"uniform"`` in the region that radiates; in proportion to the position marginal R_x, which
    bounds W, of the source with all its fields in phase (``"marginal"``); or to its square root
    (``"root-marginal"``). By Parseval's theorem that is the rms of W over all frequencies, where
    the field is uniform: of all densities that do not know the direction it has the least variance
    over all of them.
    """
    if sampling == "uniform":
        return Positions(m, [ring / unit for ring in centred.support.rings])
    low, high = np.reshape(centred.support.bounds, (2, 2))
    counts = np.maximum(2, np.ceil(_TABLE * (high - low) / (high - low).max()).astype(int))
    axes = [np.linspace(a, b, n + 1) for a, b, n in zip(low, high, counts, strict=True)]
    places = np.stack(np.meshgrid(*axes), axis=-1)
    values = np.zeros(places.shape[:-1])
    for *shift, weight in centred.shifts:
        shifted = position_marginal(in_phase(flat_of(centred.at_origin)), places + shift)
        values += weight * np.maximum(shifted, 0.0)
    density = np.sqrt(values) if sampling == "root-marginal" else values
    steps = (high - low) / counts
    near = shapely.dwithin(
        shapely.points(places), centred.support.polygons, float(np.hypot(*steps))
    )
    density = density / density[near].mean() + _EVERYWHERE * near
    return Tabulated(m, density, low / unit, (high - low) / unit)


class Positions:
    """Uniform in an outline; the density of other ways differs."""

    def __init__(self, m: Any, rings: Sequence[npt.NDArray[np.float64]]) -> None:
        cells = trapezoids(rings)
        self._cells = TrapezoidSampler(m, cells)
        self._density = 1.0 / float(cells.areas.sum())

    def sample(self, sample: Any) -> tuple[Any, Any]:
        """A point for a uniform point of the unit square, and the density there."""
        return self._cells.sample(sample), self._density

    def density(self, x: Any) -> Any:
        """Per area, at a point."""
        return self._density


class Tabulated(Positions):
    """A density known on the points of a grid, rows along y, and bilinear between them."""

    def __init__(self, m: Any, values: npt.NDArray[np.float64], low: Any, size: Any) -> None:
        self._m = m
        table = values.astype(np.float32)
        self._warp = m.MarginalContinuous2D0(m.TensorXf(table) if dr.is_jit_v(m.Float) else table)
        self._low, self._size = m.Vector2f(*low.tolist()), m.Vector2f(*size.tolist())
        self._inverse_area = 1.0 / float(np.prod(size))

    def sample(self, sample: Any) -> tuple[Any, Any]:
        place, density = self._warp.sample(sample)
        return self._m.Point2f(place * self._size + self._low), density * self._inverse_area

    def density(self, x: Any) -> Any:
        place = (x - self._low) / self._size
        inside = dr.all((place >= 0.0) & (place <= 1.0))
        density = self._warp.eval(dr.clip(place, 0.0, 1.0))
        return dr.select(inside, density * self._inverse_area, 0.0)


def spectrum(m: Any, value: Any, active: Any) -> Any:
    """A value of one narrow band: the same in every channel or at every sampled wavelength."""
    return m.depolarizer(m.UnpolarizedSpectrum(dr.select(active, value, 0.0)))


def four(m: Any, stokes: Stokes | None, value: Any) -> Any:
    """A field's value times its four Stokes numbers; the value where there are none."""
    return value if stokes is None else m.Vector4f(*stokes) * value
