"""Sampling of positions in an aperture, in its own coordinates, inside a renderer.

And of the light of emitters, by one of the estimators: the classes that say how points of a scene
are lit by a source, and how the rays of a receiver weigh.

Positions come out relative to the aperture and keep single precision wherever the aperture stands
in the world.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from typing import Any, Protocol

import drjit as dr
import mitsuba as mi
import numpy as np
import numpy.typing as npt
import shapely

from polywigner.errors import SceneError
from polywigner.execution import ops_for
from polywigner.geometry.convex import Trapezoids, point_in_trapezoid, trapezoids
from polywigner.illumination import Array
from polywigner.illumination.polarisation import Stokes
from polywigner.mitsuba.sources import CentredSource, SourceSpec
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


def check_sampling(name: str) -> str:
    """Return ``name``, or raise a SceneError that lists the known names."""
    if name not in SAMPLINGS:
        raise SceneError(f"expected a sampling, got {name!r}; use one of {', '.join(SAMPLINGS)}")
    return name


def cells_of(m: Any, rings: Sequence[npt.NDArray[np.float64]]) -> TrapezoidSampler:
    """The sampler of positions inside boundary rings, for the variant ``m``."""
    return TrapezoidSampler(m, trapezoids(rings))


def cells_with_field(m: Any, source: Any, unit: float) -> TrapezoidSampler:
    """The sampler of positions in a source in proportion to |u|^2, in units of ``unit`` metres.

    Of fields that are not uniform, in proportion to |u|^2 in the middle of each of many pieces.
    Overlapping elements each count for themselves.
    """
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


# Stands for a density without bound; its square, and products with radiances, fit into float32.
_OVERWHELMING = 1e12


def spectrum(m: Any, value: Any, active: Any) -> Any:
    """A value of one narrow band: the same in every channel or at every sampled wavelength."""
    return m.depolarizer(m.UnpolarizedSpectrum(dr.select(active, value, 0.0)))


def four(m: Any, stokes: Stokes | None, value: Any) -> Any:
    """A field's value times its four Stokes numbers; the value where there are none."""
    return value if stokes is None else m.Vector4f(*stokes) * value


class Estimator(Protocol):
    """Weights of light samples at points of a scene, and of the rays of a receiver.

    Made of a variant, the parameters, a wavelength in m, and the radiance of the source.
    """

    needs_distance: bool
    """Whether a receiver must know the surface that its rays meet."""
    is_constant: bool
    """Whether wavelength and source are constants of the kernel, without derivatives."""

    def __init__(self, m: Any, spec: SourceSpec, wavelength: float, own: Any) -> None: ...

    @staticmethod
    def check(spec: SourceSpec) -> None:
        """Raise SceneError for a source that it cannot estimate."""

    def draw(self, sample: Any) -> tuple[Any, Any]:
        """A place (2D), and its density; None where a point sees all of the source at once."""

    def density(self, x: Any) -> Any:
        """Per area, at a place; or None."""

    def lit(self, light: Any, it: Any, x: Any, per_area: Any) -> Any:
        """The weight of the sample x of an emitter at the point ``it``, in W/m^2."""

    def received(
        self, x: Any, direction: Any, per_area: Any, point: Any = None, distance: Any = None
    ) -> Any:
        """The weight of a receiver's ray from x, per radiance and solid angle.

        ``point`` (3D, in its frame) and ``distance``: of the surface that the ray meets, for those
        that need it; in units of the scene.
        """


@cache
def sampled_emitter_class(variant: str) -> Any:
    """The base of the emitter's class for one variant, which has no radiance yet.

    What it is built on has its ``frame``, ``_own`` radiance, ``estimator``, ``polariser``,
    ``wave``, ``radiance`` and ``intensity``.
    """
    m = getattr(mi, variant)
    jit = dr.is_jit_v(m.Float)

    base: Any = m.Emitter

    class SampledEmitter(base):
        """Not a plugin of its own."""

        # ---- sampling for receivers ----------------------------------------------------------

        def sample_direction(self, it: Any, sample: Any, active: Any = True) -> Any:
            x, per_area = self.estimator.draw(sample)
            direction, distance = self.seen_from(it, x)
            ds = m.DirectionSample3f()
            self._place(ds, x, it.time)
            ds.d = -self.frame.to_scene(direction)
            ds.dist = distance
            ds.pdf = self._density(direction.z, distance, per_area)
            if self.spec.diffraction:  # what is in the way is in the weight
                away = (1.0 + dr.max(dr.abs(it.p))) * (2.0 * m.math.RayEpsilon)
                ds.p = it.p + ds.d * away
            ds.emitter = m.EmitterPtr(self) if jit else self
            found = self.estimator.lit(self, it, x, per_area)
            return ds, self.polariser.sent(found, direction, self.frame, active)

        def pdf_direction(self, it: Any, ds: Any, active: Any = True) -> Any:
            cosine = -dr.dot(ds.d, self.frame.axes[2])
            return self._density(cosine, ds.dist, self.estimator.density(ds.uv))

        def eval_direction(self, it: Any, ds: Any, active: Any = True) -> Any:
            direction, distance = self.seen_from(it, ds.uv)
            per_area = self.estimator.density(ds.uv)
            density = self._density(direction.z, distance, per_area)
            found = self.estimator.lit(self, it, ds.uv, per_area) * density
            return self.polariser.sent(found, direction, self.frame, active)

        def _density(self, cosine: Any, distance: Any, per_area: Any) -> Any:
            """Per solid angle; overwhelming where no light comes by rays that meet the source.

            Integrators weigh samples of a light against such rays by the squares of densities. A
            light that has no surface is met by none. Exact light must not be counted twice; mirrors
            take no samples of lights, and show the radiance. As a `delta` light, for which there is
            no weighing, it would be too bright in ``direct`` with several samples of lights.
            """
            front = cosine > 0.0
            density = m.Float(_OVERWHELMING)
            if per_area is not None and self.spec.visible:
                density = per_area * (distance * distance) / dr.select(front, cosine, 1.0)
            return dr.select(front, density, 0.0)

        def seen_from(self, it: Any, x: Any) -> tuple[Any, Any]:
            """Unit vector, in the frame, from x to the point ``it``; and the distance."""
            r = self.frame.to_own(it.p - self.frame.origin) - m.Vector3f(x.x, x.y, 0.0)
            distance = dr.norm(r)
            return r / distance, distance

        def _place(self, sample: Any, x: Any, time: Any) -> None:
            """Fill in the numbers that all samples of the position x share."""
            sample.p = self.frame.point(x)
            sample.n = m.Normal3f(self.frame.axes[2])
            sample.uv = x
            sample.time = m.Float(time)
            sample.delta = m.Bool(False)

        # ---- sampling of the emitted field ---------------------------------------------------

        def sample_position(self, time: Any, sample: Any, active: Any = True) -> Any:
            ps = m.PositionSample3f()
            x, per_area = self._own.positions.sample(sample)
            self._place(ps, x, time)
            ps.pdf = m.Float(per_area)
            return ps, dr.select(active, m.Float(1.0 / per_area), 0.0)

        def pdf_position(self, ps: Any, active: Any = True) -> Any:
            return dr.select(active, m.Float(self._own.positions.density(ps.uv)), 0.0)

        def sample_ray(
            self, time: Any, sample1: Any, sample2: Any, sample3: Any, active: Any = True
        ) -> Any:
            """Position as for receivers, direction by cosine: the weight's mean is the power."""
            ps, share = self.sample_position(time, sample2, active)
            direction = m.warp.square_to_cosine_hemisphere(sample3)
            wavelengths, density = _optical_wavelengths(m, sample1)
            si = m.SurfaceInteraction3f(ps, wavelengths)
            si.time = time
            found = self.radiance(ps.uv, direction, self.wave(ps.uv, direction))
            weight = self.polariser.sent(found * share * dr.pi, direction, self.frame, active)
            return si.spawn_ray(self.frame.to_scene(direction)), weight * density

        def sample_wavelengths(self, si: Any, sample: Any, active: Any = True) -> Any:
            """For the particle tracer alone, which passes the direction in scene coordinates."""
            wavelengths, density = _optical_wavelengths(m, sample)
            direction = self.frame.to_own(si.wi)
            radiance = self.radiance(si.uv, direction, self.wave(si.uv, direction))
            return wavelengths, self.polariser.sent(
                radiance, direction, self.frame, active
            ) * density

    return SampledEmitter


def _optical_wavelengths(m: Any, sample: Any) -> tuple[Any, Any]:
    """Wavelengths of the renderer's own colour spectrum and their inverse density.

    Only spectral variants have any. They stand for colours, not for the wave of the aperture,
    whose radiance is the same at each.
    """
    zero = dr.zeros(m.Ray3f).wavelengths
    if dr.size_v(type(zero)) == 0:
        return zero, 1.0
    shifts = [sample + i / len(zero) for i in range(len(zero))]
    return m.sample_uniform_spectrum(type(zero)(*(shift - dr.floor(shift) for shift in shifts)))
