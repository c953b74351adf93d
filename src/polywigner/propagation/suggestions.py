"""Suggested numbers of samples, from the bandwidths of transforms and fields."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from polywigner.errors import ArgumentError, value_text
from polywigner.geometry import Aperture, Slits, Wavefront
from polywigner.geometry.arguments import (
    check_most,
    checked_choice,
    checked_length,
    checked_number,
    checked_type,
    checked_wavelength,
    only_given,
    takes_frequency,
)
from polywigner.geometry.rings import sides_of
from polywigner.numerics import Floats
from polywigner.propagation.point_grids import box_grid, line_grid, unit_vectors
from polywigner.radiometry.directions import checked_source
from polywigner.source import Array
from polywigner.transforms import PhaseSpaceSource

Band = tuple[str, str, float, float, float, bool]
"""Name, unit, first value, last value, Nyquist step and ``band_limited`` of an axis."""

SampledQuantity = Literal[
    "fourier", "intensity", "wigner", "ambiguity", "pattern", "amplitude", "irradiance"
]
_PHASE_SPACE = ("fourier", "intensity", "wigner", "ambiguity")
_FIELDS = ("amplitude", "irradiance")

# Largest step of positions, as a fraction of the narrowest width of the source. Features of W along
# x are equally narrow.
_OF_WIDTH = 0.5
# Largest number of samples per axis. Larger numbers indicate wrong units.
_MOST_SAMPLES = 1 << 53
# Largest theta [rad], since fields are not computed in the plane z = 0.
_GRAZING = math.radians(89.5)
# Numbers of points along each axis of a box, along theta and along phi at which local frequencies
# are computed. Few points are enough, because local frequencies vary slowly.
_POINTS, _THETA, _PHI = 17, 31, 24


@dataclass(frozen=True)
class AxisSampling:
    """An evenly spaced axis of a grid.

    Examples
    --------
    >>> import polywigner as pw
    >>> axis = pw.suggest_sampling(pw.shapes.square(10e-3), 3.2e-3).axes[0]
    >>> axis.name, axis.unit, axis.count
    ('nu_x', '1/m', 27)
    """

    name: str
    """Name of the coordinate, as in :func:`projections`, :func:`plane` and :func:`hemisphere`."""
    unit: str
    """Unit of the coordinate: "m", "1/m" or "rad"."""
    low: float
    """First value of the coordinate."""
    high: float
    """Last value of the coordinate; equal to the first value if a box is flat along this axis."""
    count: int
    """Number of samples, both ends included.

    The number is odd if the axis is symmetric about 0, so that 0 is a sample.
    """
    nyquist: float
    """Largest step from which values between samples can be recovered; may be inf."""
    band_limited: bool
    """Whether the sampling theorem holds exactly.

    If the value is False, the quantity has weak detail beyond its band. The detail is due to kinks
    at edges, and to waves from points of the source without stationary phase.
    """

    @property
    def step(self) -> float:
        """Distance between values; 0 for a single value."""
        return (self.high - self.low) / (self.count - 1) if self.count > 1 else 0.0

    @property
    def values(self) -> NDArray[np.float64]:
        """Values (count,) of the axis."""
        return np.linspace(self.low, self.high, self.count)


@dataclass(frozen=True)
class Sampling:
    """Grid that :func:`suggest_sampling` suggests; ``sampling["nu_x"]`` is the axis ``nu_x``.

    Examples
    --------
    >>> import polywigner as pw
    >>> pw.suggest_sampling(pw.shapes.square(10e-3), 3.2e-3).samples
    729
    """

    quantity: SampledQuantity
    """Sampled quantity."""
    axes: tuple[AxisSampling, ...]
    """Axes in the order of the coordinates."""
    samples: int
    """Number of points of the grid."""

    def __getitem__(self, name: str) -> AxisSampling:
        """Return the axis with a given name; raise ArgumentError for other names."""
        for axis in self.axes:
            if axis.name == name:
                return axis
        names = ", ".join(axis.name for axis in self.axes)
        raise ArgumentError(f"the sampling has no axis {name!r}; its axes are {names}")


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
) -> Sampling:
    """Suggest a grid with enough samples for a transform or a field of a source.

    The Nyquist steps depend on the widths b of the source's bounding box, and on the largest
    spatial frequency N of the grid:

    ============  =======================  =========================================================
    quantity      axes                     Nyquist step
    ============  =======================  =========================================================
    "fourier"     nu                       1/b for F without the linear phase of the box centre
    "intensity"   nu                       1/(2 b) for \\|F\\|^2, the transform of lags up to b
    "wigner"      x, nu                    1/(2 b) along nu; 1/(4 (N + K)), at most w/2, along x
    "ambiguity"   upsilon, xi              1/b along upsilon; twice the step of x along xi
    "pattern"     theta, phi               wavelength/(2 D), D the diagonal of the box
    "amplitude"   x, y, z or theta, phi    1/(2 largest local frequency)
    "irradiance"  x, y, z or theta, phi    1/(2 largest difference of two local frequencies)
    ============  =======================  =========================================================

    K is the largest spatial frequency of the plane waves on the source, and w = 2 area/perimeter is
    the width of its narrowest part. D is the diagonal of the bounding box. Local frequencies are
    the direction cosines of the rays from the box to a point, divided by the wavelength. The steps
    are derived in docs/sampling.md, (N1) to (N6).

    Parameters
    ----------
    source : Aperture, Array, Slits or Wavefront
        Source in one plane. Slits allow only the first four quantities of the table. A Wavefront
        allows only the last three, which depend only on the bounding box.
    wavelength : float, optional
        Wavelength in m. The first four quantities require either the wavelength or ``reach``.
    quantity : str, default "intensity"
        Quantity to sample. "amplitude" and "irradiance" require ``box``, ``line`` or ``radius``.
    reach : float, default 1/wavelength
        Largest spatial frequency N in 1/m. Axes of nu extend from -N to N, and axes of upsilon from
        -2 N to 2 N. Waves at frequencies above the default are evanescent.
    box : array_like, shape (2, 3), optional
        Opposite corners in m, as in :func:`volume`. The box may be flat along an axis. At z below a
        wavelength, evanescent waves add detail finer than the Nyquist step.
    line : array_like, shape (2, 3), optional
        End points in m, as in :func:`line`. The axis is "distance".
    radius : float, optional
        Radius in m of a hemisphere about the origin, which ends at theta = 89.5 degrees.
    oversampling : float, default 2
        Nyquist step divided by the step of the grid, at least 1. Use 1 for sinc interpolation on an
        infinite grid, and 2 for images and for interpolation from a dozen neighbours.

    Returns
    -------
    Sampling
        Axes of the grid.

    Raises
    ------
    ArgumentError
        If an argument has the wrong type, shape or range, or if ``reach``, ``box``, ``line`` or
        ``radius`` does not apply to the quantity.
    GeometryError
        If elements of an Array do not lie in the plane z = 0.

    Examples
    --------
    >>> import polywigner as pw
    >>> axes = pw.suggest_sampling(pw.shapes.square(10e-3), 3.2e-3).axes
    >>> [axis.count for axis in axes]
    [27, 27]
    """
    checked_choice(quantity, "quantity", get_args(SampledQuantity))
    meaning = "a number of at least 1"
    finer = checked_number(oversampling, "oversampling", meaning, lambda x: x >= 1)
    regions = {"box": box, "line": line, "radius": radius}
    for name, value in {"reach": reach, **regions}.items():
        kinds = _PHASE_SPACE if name == "reach" else _FIELDS
        if value is not None and quantity not in kinds:
            raise ArgumentError(
                f'the quantity "{quantity}" does not use {name}, got {value_text(value)}; omit '
                f"{name}, or pass quantity as one of " + ", ".join(f'"{kind}"' for kind in kinds)
            )
    if isinstance(source, Wavefront):
        if quantity not in (*_FIELDS, "pattern"):
            raise ArgumentError(
                f'the quantity "{quantity}" requires a flat, coherent wave, got a Wavefront; pass '
                "its attribute .source, and use finer steps if the phase of the wave varies faster "
                "than the field of the source"
            )
        source = source.source
    if quantity in _PHASE_SPACE:
        bands = _phase_space_bands(source, wavelength, quantity, reach)
    else:
        plane, length = checked_source(source), checked_wavelength(wavelength)
        if quantity == "pattern":
            step = length / (2 * math.hypot(*sides_of(plane.bounds)))
            ends = (("theta", math.pi / 2), ("phi", 2 * math.pi))
            bands = [(name, "rad", 0.0, end, step, True) for name, end in ends]
        else:
            where = only_given(regions, purpose=" to specify the points of the field")
            is_amplitude = quantity == "amplitude"
            bands = _field_bands(plane.bounds, length, is_amplitude, where, regions[where])
    axes = tuple(_axis(band, finer) for band in bands)
    return Sampling(quantity, axes, math.prod(axis.count for axis in axes))


def _phase_space_bands(source: Any, wavelength: Any, quantity: str, reach: Any) -> list[Band]:
    """Return the axes of F, |F|^2, W or A."""
    expected = "an Aperture, Slits, or an Array of either in one plane"
    checked_type(source, expected, Aperture, Slits, Array)
    if reach is not None:
        most = checked_length(reach, "reach")
    elif wavelength is None:
        raise ArgumentError(
            "expected the argument wavelength (m) or the argument reach (1/m), got neither"
        )
    else:
        most = 1 / checked_wavelength(wavelength)
    elements = source.elements_in_plane
    fields = [e.illumination for e in elements if e.illumination is not None]
    waves = most + max((float(np.abs(field.frequencies).max()) for field in fields), default=0.0)
    narrow = _OF_WIDTH * min(map(_narrowest, elements))
    spans = np.reshape(source.bounds, (2, -1)).T.tolist()
    suffixes = ("_x", "_y") if len(spans) == 2 else ("",)
    first: list[Band] = []
    second: list[Band] = []
    for name, suffix, (low, high) in zip("xy", suffixes, spans, strict=False):
        width = high - low
        if quantity == "wigner":
            first.append((name, "m", low, high, min(1 / (4 * waves), narrow), False))
        if quantity == "ambiguity":
            first.append((f"upsilon{suffix}", "1/m", -2 * most, 2 * most, 1 / width, True))
            step = min(1 / (2 * waves), 2 * narrow)
            second.append((f"xi{suffix}", "m", -width, width, step, False))
        else:
            step = 1 / width if quantity == "fourier" else 1 / (2 * width)
            second.append((f"nu{suffix}", "1/m", -most, most, step, True))
    return first + second


def _narrowest(element: Aperture | Slits) -> float:
    """Return the width in m of the narrowest strip, ring or slit; for a square, half its side."""
    if isinstance(element, Slits):
        return float(np.diff(element.intervals, axis=1).min())
    return min(2 * part.area / part.length for part in element.polygons.geoms)


def _axis(band: Band, oversampling: float) -> AxisSampling:
    """Return the evenly spaced axis of a band; raise ArgumentError for too many samples."""
    name, unit, low, high, nyquist, band_limited = band
    steps = (high - low) / nyquist * oversampling if nyquist > 0 else math.inf
    remedy = "check the units of the wavelength and of the positions"
    check_most(steps, _MOST_SAMPLES, f"samples along the axis {name}", remedy)
    count = 1 if high == low else max(1, math.ceil(steps * (1 - 1e-12))) + 1
    if low == -high and count % 2 == 0:
        count += 1
    return AxisSampling(name, unit, low, high, count, nyquist, band_limited)


def _field_bands(
    bounds: tuple[float, ...], wavelength: float, coherent: bool, kind: str, region: Any
) -> list[Band]:
    """Return the axes for a field in a "box", on a "line" or on a hemisphere ("radius").

    ``coherent`` is true for the amplitude, and false for the irradiance.
    """
    metres = 1.0  # per unit of the axis
    if kind == "box":
        axes = [np.unique(axis.values) for axis in box_grid(region, 3 * (_POINTS,)).coords.values()]
        ends = [(n, "m", float(a[0]), float(a[-1])) for n, a in zip("xyz", axes, strict=True)]
        # The points include positions in front of the source, because rays from the source spread
        # most there.
        for k in (0, 1):
            centre = (bounds[k] + bounds[k + 2]) / 2
            axes[k] = np.unique(np.append(axes[k], np.clip(centre, axes[k][0], axes[k][-1])))
        points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
        tangents = list(np.eye(3))
    elif kind == "line":
        # A line requires many points, because ray directions change fast close to the source.
        grid = line_grid(region, _POINTS**2)
        points, length = grid.points((0,), grid.shape), float(grid.coords["distance"].values[-1])
        tangents = [(points[-1] - points[0]) / length]
        ends = [("distance", "m", 0.0, length)]
    else:
        metres = checked_length(region, "radius")
        theta, phi = np.linspace(0.0, _GRAZING, _THETA), 2 * math.pi * np.arange(_PHI) / _PHI
        points = metres * unit_vectors(theta, phi).reshape(-1, 3)
        around = (
            unit_vectors(np.full(1, math.pi / 2), phi + math.pi / 2) * np.sin(theta)[:, None, None]
        )
        tangents = [unit_vectors(theta + math.pi / 2, phi).reshape(-1, 3), around.reshape(-1, 3)]
        ends = [("theta", "rad", 0.0, _GRAZING), ("phi", "rad", 0.0, 2 * math.pi)]
    rays = _ray_directions(points, bounds)
    bands: list[Band] = []
    for end, tangent in zip(ends, tangents, strict=True):
        cosines = np.einsum("nqc,nc->nq", rays, np.broadcast_to(tangent, points.shape))
        largest = float(np.abs(cosines).max() if coherent else np.ptp(cosines, axis=1).max())
        step = wavelength / (2 * largest) / metres if largest > 0 else math.inf
        bands.append((*end, step, False))
    return bands


def _ray_directions(points: Floats, bounds: tuple[float, ...]) -> Floats:
    """Return unit vectors (n, 9, 3) from a rectangle to points (n, 3).

    Rays start at the corners, at the point of the rectangle closest to the target point, and on the
    sides.
    """
    x, y = (
        np.stack(np.broadcast_arrays(low, np.clip(points[:, k], low, high), high), axis=-1)
        for k, (low, high) in enumerate(zip(bounds[:2], bounds[2:], strict=True))
    )
    x, y = np.broadcast_arrays(x[:, :, None], y[:, None, :])
    from_source = np.stack([x, y, np.zeros_like(x)], axis=-1).reshape(len(points), 9, 3)
    rays = points[:, None, :] - from_source
    return np.asarray(rays / np.linalg.norm(rays, axis=-1, keepdims=True))
