"""Sampling advice: numbers of samples from the bands of transforms and fields."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from polywigner.errors import ArgumentError, value_text
from polywigner.geometry import Aperture, Slits, Wavefront
from polywigner.geometry.arguments import (
    checked_choice,
    checked_length,
    checked_number,
    checked_wavelength,
    takes_frequency,
)  # fmt: skip
from polywigner.propagation.places import box_grid, line_grid, unit_vectors
from polywigner.radiometry.directions import PlaneSource, checked_source
from polywigner.source import Array
from polywigner.source.support import mutual_support
from polywigner.transforms import PhaseSpaceSource, fourier, sample_automean, wigner

# Where hemispheres end: fields are not computed in the plane z = 0.
_GRAZING = math.radians(89.5)

# Places at which local frequencies are looked at, along each axis: they vary slowly.
_PLACES = 17
_THETA, _PHI = 31, 24

Values = NDArray[np.float64]


Band = tuple[str, str, float, float, float, bool]
"""Name, unit, ends, and the largest step at which an axis may be sampled; if band-limited."""


def _bands_of_field(
    bounds: tuple[float, ...], wavelength: float, kind: str, place: Any, coherent: bool
) -> list[Band]:
    """Bands along the axes of a "box", a "line", or a hemisphere of a "radius" about the origin.

    ``bounds`` of the source. The hemisphere ends short of the plane of the source.
    """
    metres = 1.0  # for one unit of an axis
    if kind == "box":
        axes = [np.unique(axis.values) for axis in box_grid(place, 3 * (_PLACES,)).coords.values()]
        ends = [(n, "m", float(a[0]), float(a[-1])) for n, a in zip("xyz", axes, strict=True)]
        # Straight in front of the source most rays cross: those places must be among them.
        for k in (0, 1):
            middle = (bounds[k] + bounds[k + 2]) / 2
            axes[k] = np.unique(np.append(axes[k], np.clip(middle, axes[k][0], axes[k][-1])))
        points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
        tangents = list(np.eye(3))
    elif kind == "line":
        # Where it passes by the source, closely perhaps, directions change most.
        grid = line_grid(place, _PLACES**2)
        points, tangents = grid.points((0,), (_PLACES**2,)), [grid.directions]
        ends = [("distance", "m", 0.0, float(grid.coords["distance"].values[-1]))]
    else:
        metres = checked_length(place, "radius")
        theta, phi = np.linspace(0.0, _GRAZING, _THETA), 2 * math.pi * np.arange(_PHI) / _PHI
        points = metres * unit_vectors(theta, phi).reshape(-1, 3)
        around = (
            unit_vectors(np.full(1, math.pi / 2), phi + math.pi / 2) * np.sin(theta)[:, None, None]
        )
        tangents = [unit_vectors(theta + math.pi / 2, phi).reshape(-1, 3), around.reshape(-1, 3)]
        ends = [("theta", "rad", 0.0, _GRAZING), ("phi", "rad", 0.0, 2 * math.pi)]
    rays = _rays(points, bounds)
    steps = (_nyquist(rays, tangent, wavelength, coherent) / metres for tangent in tangents)
    return [(*end, step, False) for end, step in zip(ends, steps, strict=True)]


def _nyquist(rays: Values, tangents: Values, wavelength: float, coherent: bool) -> float:
    """The largest step along tangents (n, 3) at points with rays (n, 9, 3), in m."""
    cosines = np.einsum("nqc,nc->nq", rays, np.broadcast_to(tangents, (len(rays), 3)))
    largest = float(np.abs(cosines).max() if coherent else np.ptp(cosines, axis=1).max())
    return wavelength / (2 * largest) if largest > 0 else math.inf


def _rays(points: Values, bounds: tuple[float, ...]) -> Values:
    """Unit vectors (n, 9, 3) to points (n, 3) from nine points of the source's box."""
    x, y = (
        np.stack(np.broadcast_arrays(low, np.clip(points[:, k], low, high), high), axis=-1)
        for k, (low, high) in enumerate(zip(bounds[:2], bounds[2:], strict=True))
    )
    x, y = np.broadcast_arrays(x[:, :, None], y[:, None, :])
    from_source = np.stack([x, y, np.zeros_like(x)], axis=-1).reshape(len(points), 9, 3)
    rays = points[:, None, :] - from_source
    return np.asarray(rays / np.linalg.norm(rays, axis=-1, keepdims=True))


_SEED = 20220202  # any: the same call gives the same number

# Frequencies tried, of which some are at the level; and of those, directions with their positions.
_TRIED, _DIRECTIONS, _POSITIONS = 1 << 14, 64, 1024
# Pixels count as being at the level within this factor.
_NEAR = 10**0.15
# Nulls within the band of levels are rare and need any number of samples.
_QUANTILE = 0.9


def _samples_for_error(source: PlaneSource, wavelength: float, error: float, level: float) -> int:
    """Independent uniform positions x in the support S that give I within an error in dB, rms (N7).

    The estimate of |F|^2 by n positions is area(S) times the mean of W(x, nu), and its relative
    variance (area(S) int W^2 dx/|F|^4 - 1)/n. The number is for nine of ten directions of the
    far field whose |F|^2 lies within 1.5 dB of the level.
    """
    rng = np.random.default_rng(_SEED)
    nu, intensity = _at_level(source, wavelength, 10 ** (level / 10), rng)
    support = mutual_support(source)
    x, _ = sample_automean(support, _POSITIONS, seed=rng)
    values = np.asarray(wigner(source, x, nu[:, None, :]))
    spread = support.area**2 * np.mean(values**2, axis=1) / intensity**2 - 1
    relative = 10 ** (error / 10) - 1
    needed = float(np.quantile(np.maximum(spread, 0.0), _QUANTILE)) / relative**2
    return max(1, math.ceil(needed))


def _at_level(
    source: PlaneSource, wavelength: float, level: float, rng: np.random.Generator
) -> tuple[Values, Values]:
    """Frequencies (k, 2) of propagating waves at a level of |F|^2 below its peak, and |F|^2."""
    radius, angle = rng.random(_TRIED), 2 * math.pi * rng.random(_TRIED)
    # Equally many per octave of distance from the beam, which may be narrow and point anywhere.
    centre = _brightest(source, wavelength, rng)
    distance = 2 / wavelength * 10 ** (-4 * radius)
    nu = centre + distance[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    nu = np.concatenate([centre[None], nu[np.linalg.norm(nu, axis=-1) < 1 / wavelength]])
    found = np.square(np.abs(np.asarray(fourier(source, _lifted(source, nu)))))
    levels = found / found.max()
    chosen = np.flatnonzero((levels > level / _NEAR) & (levels < level * _NEAR))
    if not len(chosen):  # nothing so weak is radiated: the weakest there is
        chosen = np.argsort(np.abs(np.log(levels / level)))[:_DIRECTIONS]
    chosen = rng.permutation(chosen)[:_DIRECTIONS]
    return nu[chosen], found[chosen]


def _brightest(source: PlaneSource, wavelength: float, rng: np.random.Generator) -> Values:
    """About where |F|^2 is largest, (2,): the best of random frequencies, then of ever nearer."""
    best, reach = np.zeros(2), 1 / wavelength
    while reach > 1e-4 / wavelength:
        nu = best + reach * (2 * rng.random((_TRIED // 4, 2)) - 1)
        nu = np.concatenate([best[None], nu[np.linalg.norm(nu, axis=-1) < 1 / wavelength]])
        best = nu[int(np.argmax(np.abs(np.asarray(fourier(source, _lifted(source, nu))))))]
        reach /= 4
    return np.asarray(best)


def _lifted(source: Any, nu: Values) -> Values:
    """nu with a third component, which placed elements ask for."""
    return np.concatenate([nu, np.zeros((len(nu), 1))], axis=-1)


SampledQuantity = Literal[
    "fourier", "intensity", "wigner", "ambiguity", "pattern", "amplitude", "irradiance", "render"
]

_PHASE_SPACE = ("fourier", "intensity", "wigner", "ambiguity")
_AT_PLACES = ("amplitude", "irradiance")

# Nyquist's step over the width of the narrowest part, along positions: what W is over a strip, a
# triangle of that width, is then seen at several samples, wherever the grid begins.
_OF_WIDTH = 0.5

# No grid that anybody could hold; a slip of units rather than a wish.
_MOST_SAMPLES = 1 << 53


@dataclass(frozen=True)
class AxisSampling:
    """An evenly spaced axis of a grid.

    >>> import polywigner as pw
    >>> axis = pw.suggest_sampling(pw.shapes.square(10e-3), 3.2e-3).axes[0]
    >>> axis.name, axis.unit, axis.count
    ('nu_x', '1/m', 27)
    """

    name: str
    """Name of the coordinate, as in :func:`projections`, :func:`plane` and :func:`hemisphere`."""
    unit: str
    """"m", "1/m" or "rad"."""
    low: float
    """First value."""
    high: float
    """Last value; a flat box has the first value here too."""
    count: int
    """Number of samples, both ends included; odd where the axis is symmetric, so that 0 is one."""
    nyquist: float
    """The largest step from which the values between follow (infinite: any)."""
    band_limited: bool
    """Whether they follow exactly (a sampling theorem holds); else detail beyond the band is
    there, weaker the farther beyond: kinks at edges, waves that are not stationary."""

    @property
    def step(self) -> float:
        """Distance between values, 0 for a single one."""
        return (self.high - self.low) / (self.count - 1) if self.count > 1 else 0.0

    @property
    def values(self) -> NDArray[np.float64]:
        """(count,) the values."""
        return np.linspace(self.low, self.high, self.count)


@dataclass(frozen=True)
class Sampling:
    """The result of :func:`suggest_sampling`; ``sampling["nu_x"]`` is the axis of that name.

    >>> import polywigner as pw
    >>> pw.suggest_sampling(pw.shapes.square(10e-3), 3.2e-3).samples
    729
    """

    quantity: SampledQuantity
    """The quantity that is sampled."""
    axes: tuple[AxisSampling, ...]
    """In the order of the coordinates; none for "render"."""
    samples: int
    """Points of the whole grid; of "render", independent samples per pixel."""

    def __getitem__(self, name: str) -> AxisSampling:
        for axis in self.axes:
            if axis.name == name:
                return axis
        names = ", ".join(axis.name for axis in self.axes) or "none at all"
        raise ArgumentError(f"expected an axis among {names}, got {name!r}")


@takes_frequency
def suggest_sampling(
    source: PhaseSpaceSource,
    wavelength: float | None = None,
    quantity: SampledQuantity = "intensity",
    *,
    reach: float | None = None,
    box: ArrayLike | None = None,
    line: ArrayLike | None = None,
    radius: float | None = None,
    oversampling: float = 2.0,
    error_db: float = 1.0,
    level_db: float = -20.0,
) -> Sampling:
    """The grid that a source needs at a wavelength, or the samples per pixel of a render.

    The widths b of the source's box and the largest frequency N shown bound the bands:

    ============  =======================  =========================================================
    quantity      axes                     largest step
    ============  =======================  =========================================================
    "fourier"     nu                       1/b for F, but for the wave of the box's centre
    "intensity"   nu                       1/(2 b) for \\|F\\|^2, the transform of lags up to b
    "wigner"      x, nu                    1/(2 b) along nu; 1/(4 (N + K)), at most w/2, along x
    "ambiguity"   upsilon, xi              1/b along upsilon, as for F; twice that of x along xi
    "pattern"     theta, phi               wavelength/(2 D), D the diagonal of the box
    "amplitude"   x, y, z or theta, phi    1/(2 largest local frequency)
    "irradiance"  x, y, z or theta, phi    1/(2 largest difference of two of them at a point)
    "render"      none                     samples per pixel
    ============  =======================  =========================================================

    K is the largest frequency of the waves on the source, w the width of its narrowest part, 2
    area/perimeter. Local frequencies are direction cosines of the rays from the source's box, over
    the wavelength. Source: docs/sampling.md, (N1) to (N7).

    Parameters
    ----------
    source : Aperture or Array of one plane; of the first four quantities Slits as well; of
        "pattern", "amplitude" and "irradiance", which depend on its box alone, a Wavefront.
    wavelength : in m. The first four quantities need it or ``reach``.
    quantity : what is to be sampled; "amplitude" and "irradiance" need a place:
        ``box``, ``line`` or ``radius``.
    reach : N in 1/m, half of the axes of nu, and a quarter of those of upsilon. None:
        1/wavelength, beyond which waves are evanescent.
    box : ((x0, y0, z0), (x1, y1, z1)) in m, z0 > 0, as of :func:`volume`; flat along an axis
        where both are equal. At z below a wavelength, evanescent waves add finer detail.
    line : ((x0, y0, z0), (x1, y1, z1)) in m, its ends, as of :func:`line`; the axis: distance.
    radius : in m, of a hemisphere around the origin, which ends half a degree before z = 0.
    oversampling : Nyquist's step over the step, at least 1. 1 is for sinc interpolation over an
        endless grid; 2 for pictures, and for interpolation from a dozen neighbours.
    error_db, level_db : of "render": rms error in dB, from light paths of one bounce, at pixels
        that lie level_db above (negative: below) the brightest. See docs/sampling.md, (N7).

    Returns
    -------
    Sampling

    Raises
    ------
    ArgumentError for arguments of the wrong type, shape or range, and for a reach or a place where
    the quantity has none; GeometryError for an Array whose elements do not lie in the plane z = 0.

    >>> import polywigner as pw
    >>> axes = pw.suggest_sampling(pw.shapes.square(10e-3), 3.2e-3).axes
    >>> [axis.count for axis in axes]
    [27, 27]
    """
    checked_choice(quantity, "quantity", get_args(SampledQuantity))
    finer = checked_number(oversampling, "oversampling", "a number of at least 1")
    if not finer >= 1:
        raise ArgumentError(f"expected oversampling as a number of at least 1, got {oversampling}")
    error = checked_length(error_db, "error_db", meaning="decibels above zero")
    level = checked_number(level_db, "level_db", "decibels of at most zero")
    if not level <= 0:
        raise ArgumentError(
            f"expected level_db as decibels of at most zero, got {value_text(level_db)}"
        )
    _check_used(quantity, {"reach": reach, "box": box, "line": line, "radius": radius})
    if isinstance(source, Wavefront):
        if quantity not in (*_AT_PLACES, "pattern"):
            raise ArgumentError(
                f'expected a flat, coherent wave to suggest samples for "{quantity}", got a '
                "Wavefront; use its .source, and finer steps where its wave turns faster"
            )
        source = source.source
    if quantity in _PHASE_SPACE:
        axes = _phase_space_axes(source, wavelength, quantity, reach, finer)
        return Sampling(quantity, axes, math.prod(axis.count for axis in axes))
    plane = checked_source(source)
    length = checked_wavelength(wavelength)
    if quantity == "render":
        return Sampling(quantity, (), _samples_for_error(plane, length, error, level))
    bounds = plane.bounds
    if quantity == "pattern":
        step = length / (2 * math.hypot(*np.subtract(bounds[2:], bounds[:2])))
        ends = (("theta", math.pi / 2), ("phi", 2 * math.pi))
        bands: list[Band] = [(name, "rad", 0.0, end, step, True) for name, end in ends]
    else:
        places = {"box": box, "line": line, "radius": radius}
        given = [name for name, place in places.items() if place is not None]
        if len(given) != 1:
            raise ArgumentError(
                f"expected one of {', '.join(places)}, got {' and '.join(given) or 'none'}; say "
                "where the field is wanted"
            )
        kind, coherent = given[0], quantity == "amplitude"
        bands = _bands_of_field(bounds, length, kind, places[kind], coherent)
    axes = tuple(_axis(*band, finer) for band in bands)
    return Sampling(quantity, axes, math.prod(axis.count for axis in axes))


def _check_used(quantity: str, given: dict[str, Any]) -> None:
    """Refuses options that do not belong to a quantity, rather than pass them over."""
    for name, value in given.items():
        kinds = _PHASE_SPACE if name == "reach" else _AT_PLACES
        if value is not None and quantity not in kinds:
            raise ArgumentError(
                f'expected no {name} for "{quantity}", '
                f"got {value_text(value)}; give quantity as one of "
                + ", ".join(f'"{kind}"' for kind in kinds)
            )


def _phase_space_axes(
    source: Any, wavelength: Any, quantity: str, reach: Any, oversampling: float
) -> tuple[AxisSampling, ...]:
    if not isinstance(source, Aperture | Slits | Array):
        raise ArgumentError(
            "expected an Aperture, Slits, or an Array of either in one plane, got "
            f"{type(source).__name__}"
        )
    most = _largest_frequency(wavelength, reach)
    bounds, waves = source.bounds, most + _largest_wave(source)
    half = len(bounds) // 2
    narrow = _OF_WIDTH * min(map(_narrowest, source.elements_in_plane))
    bands: list[Band] = []
    for k, suffix in enumerate(("",) if half == 1 else ("_x", "_y")):
        low, high = bounds[k], bounds[k + half]
        width = high - low
        position = "xy"[k] if half == 2 else "x"
        nu = (f"nu{suffix}", "1/m", -most, most)
        kinds: dict[str, list[Band]] = {
            "fourier": [(*nu, 1 / width, True)],
            "intensity": [(*nu, 1 / (2 * width), True)],
            "wigner": [
                (position, "m", low, high, min(1 / (4 * waves), narrow), False),
                (*nu, 1 / (2 * width), True),
            ],
            "ambiguity": [
                (f"upsilon{suffix}", "1/m", -2 * most, 2 * most, 1 / width, True),
                (f"xi{suffix}", "m", -width, width, min(1 / (2 * waves), 2 * narrow), False),
            ],
        }
        bands += kinds[quantity]
    count = len(bands) // half
    ordered = [bands[k * count + kind] for kind in range(count) for k in range(half)]
    return tuple(_axis(*band, oversampling) for band in ordered)


def _largest_frequency(wavelength: Any, reach: Any) -> float:
    if reach is not None:
        return checked_length(reach, "reach")  # a number above zero, of cycles per metre
    if wavelength is None:
        raise ArgumentError("expected a wavelength or a reach, got neither; give one in m or 1/m")
    return 1 / checked_wavelength(wavelength)


def _narrowest(element: Any) -> float:
    """The width of the narrowest part: of a strip, a ring, a slit; half the side of a square."""
    if isinstance(element, Slits):
        return float(np.diff(element.intervals, axis=1).min())
    return min(2 * part.area / part.length for part in element.polygons.geoms)


def _largest_wave(source: Any) -> float:
    """The largest component of a frequency of the waves on the elements, 1/m."""
    fields = [element.illumination for element in source.elements_in_plane]
    return max((float(np.abs(f.frequencies).max()) for f in fields if f is not None), default=0.0)


def _axis(
    name: str,
    unit: str,
    low: float,
    high: float,
    nyquist: float,
    band_limited: bool,
    oversampling: float,
) -> AxisSampling:
    extent = high - low
    steps = extent / nyquist * oversampling if nyquist > 0 else math.inf
    if not steps < _MOST_SAMPLES:
        raise ArgumentError(
            f"expected an axis {name} of fewer than {_MOST_SAMPLES} samples, got one of "
            f"{steps:.3g}; check the units of the wavelength and of the places"
        )
    count = 1 if extent == 0 else max(1, math.ceil(steps * (1 - 1e-12))) + 1
    if low == -high and count % 2 == 0:
        count += 1
    return AxisSampling(name, unit, low, high, count, nyquist, band_limited)
