"""Checks of sources and directions, and integrals over all directions in front of a source.

W(x, nu) and |F(nu)|^2 are sums of waves exp(i k rho sin(theta) cos(phi - phi0)) with rho up to the
source's diameter. Gauss-Legendre points in theta and equidistant points in phi integrate such waves
exactly, except for rounding, if there are a few more points than half periods of the wave.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import lru_cache
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray

from polywigner.errors import ArgumentError, IlluminationError
from polywigner.execution.progress import progress_bar
from polywigner.geometry import Aperture, Slits, Wavefront
from polywigner.geometry.arguments import checked_number, checked_vectors
from polywigner.numerics.nodes import flat_rule
from polywigner.quantities import SPEED_OF_LIGHT
from polywigner.source import Array
from polywigner.source.normal_form import normal_form
from polywigner.source.obliquities import OBLIQUITIES
from polywigner.source.tapers import checked_unit_vectors
from polywigner.transforms import lag_marginal
from polywigner.transforms.traced_sources import check_no_drjit
from polywigner.transforms.wavefronts import checked_wavefront, flat_source

Floats = NDArray[np.float64]

# Largest bandwidth times the propagation time across the source: about the number of wavelengths.
_MOST_SPREAD = 500.0
_MEANING = "a bandwidth in Hz above zero, and less than twice the frequency"


def checked_bandwidth(bandwidth: Any, wavelength: float) -> float:
    """Return a valid bandwidth in Hz about a wavelength in m. Raises ArgumentError."""
    width = checked_number(bandwidth, "bandwidth", _MEANING)
    carrier = SPEED_OF_LIGHT / wavelength
    if not 0 < width < 2 * carrier:
        raise ArgumentError(
            f"expected {_MEANING}, {2 * carrier:.4g} Hz, got {bandwidth!r}; leave it out for one "
            "wavelength"
        )
    return width


def wavelengths_of_band(
    wavelength: float, bandwidth: float, lag: float, error: float
) -> list[tuple[float, float]]:
    """Return (wavelength, weight) pairs for means over a band, for a source ``lag`` m across."""
    spread = bandwidth * lag / SPEED_OF_LIGHT
    if not spread <= _MOST_SPREAD:
        raise ArgumentError(
            f"expected a bandwidth of at most {_MOST_SPREAD * SPEED_OF_LIGHT / lag:.4g} Hz for a "
            f"source of {lag:.4g} m, got {bandwidth:g}, which requires about {spread:.3g} "
            "wavelengths; check its unit, or compute parts of the band"
        )
    nodes, weights = flat_rule(math.pi * spread, error)
    frequencies = SPEED_OF_LIGHT / wavelength + bandwidth / 2 * nodes
    return list(zip((SPEED_OF_LIGHT / frequencies).tolist(), weights.tolist(), strict=True))


PlaneSource = Aperture | Array


def checked_radiator(source: Any, partly: bool = False) -> PlaneSource | Wavefront:
    """Return a source of :func:`checked_source`, or one with a curved wave.

    Unless ``partly`` is true, a partly coherent source raises IlluminationError.
    """
    if not isinstance(source, Wavefront):
        return checked_source(source)
    checked_source(source.source)
    return source if partly else checked_wavefront(source)


def checked_source(source: Any) -> PlaneSource:
    """Return an aperture, or an array of apertures in the plane z = 0.

    Raises ArgumentError for other objects, GeometryError for elements outside of this plane.
    """
    if isinstance(source, Aperture):
        return source
    flat: Any = source
    if isinstance(source, Array):
        flat = source.repeated[0] if source.repeated is not None else source.elements_in_plane[0]
    if not isinstance(source, Array) or isinstance(flat, Slits):
        advice = {
            "Slits": "make rectangles of slits, power needs an area",
            "PlacedAperture": "use its .aperture, and directions relative to it",
            "Polyhedron": "a body has a Fourier transform only",
            "Wavefront": "use its .source, whose wave is flat and coherent",
        }.get(type(flat).__name__, "make one by Aperture(...) of a ring or of shapely polygons")
        raise ArgumentError(
            "expected an Aperture, or an Array of apertures in the plane z = 0, got "
            f"{type(flat).__name__}; {advice}"
        )
    # Poses in the plane are applied, so that spatial frequencies have two components.
    return source if source.dimension == 2 else Array(source.elements_in_plane, source.weights)


def checked_directions(direction: Any) -> Floats:
    """Return unit vectors (..., 3) with z >= 0. Raises ArgumentError for other vectors."""
    check_no_drjit(direction=direction)
    array = checked_unit_vectors("direction", direction)
    back = array[..., 2] < 0
    if back.any():
        raise ArgumentError(
            "expected a direction into z >= 0, to which the aperture radiates, got "
            f"{array[back][0].tolist()}"
        )
    return array


def checked_positions(x: Any) -> Floats:
    """Return finite positions (..., 2) on the aperture in m. Raises ArgumentError."""
    check_no_drjit(x=x)
    array = checked_vectors(x, "expected finite positions x of shape (..., 2)", (2,))
    if not np.isfinite(array).all():
        raise ArgumentError("expected finite positions x, got inf or nan; leave them out")
    return array


# ---- integrals over directions -------------------------------------------------------------------

# Largest width of a source in wavelengths: its power takes 1.5e11 directions, half a day for a
# square on two cores.
_MOST_WAVELENGTHS = 1e5
# Directions per block: a few MB.
_BLOCK = 1 << 17
# Number of values of F or W, a few seconds of work, above which a terminal shows progress.
_LONG = 1 << 25
# Integrals over lags: smallest width of the source in wavelengths, since smaller sources take
# seconds at most by directions; largest difference of the results for two cut-offs of the lags, as
# a fraction of the power; and largest frequency of the field, as a fraction of 1/wavelength.
_WIDE, _SAME, _STEEP = 600.0, 1e-6, 0.8
# Smooth cut-off of the lags: its width in wavelengths for waves along the normal, which reduces the
# contribution of the rim of the hemisphere to exp(-32); its two positions, and the end of the
# integral behind it, in units of this width. 1e-14 is left beyond the end.
_SOFT, _ENDS, _BEYOND = 1.8, (4.5, 6.5), 5.5
# Largest number of directions of edges that separate panels of the angle of the lag; Gauss nodes of
# a panel, and of one wavelength of lag.
_MOST_KINKS, _ON_PANEL, _ON_PERIOD = 48, 8, 12
# Largest phase of a wave on one panel of theta: the cost of Gauss nodes grows with their cube.
_PANEL = 400.0


def largest_lag(source: PlaneSource | Wavefront) -> float:
    """Return the largest distance of two points of the source in m, or an upper bound."""
    flat: Any = flat_source(source)
    if isinstance(flat, Aperture):
        return flat.diameter
    if flat.repeated is not None and isinstance(flat.repeated[0], Aperture):
        element, points = flat.repeated
        size = element.diameter
    else:
        points = np.concatenate([ring for e in flat.elements_in_plane for ring in e.rings])
        size = 0.0
    hull = shapely.get_coordinates(shapely.MultiPoint(points).convex_hull)
    return size + max(float(np.hypot(*(hull - point).T).max()) for point in hull)


def longest_path(source: PlaneSource | Wavefront) -> float:
    """Return a bound in m on the difference of two paths from the source to a point.

    The bound is the largest lag plus the largest difference of the path lengths on the source.
    """
    lag, flat = largest_lag(source), flat_source(source)
    paths = getattr(flat, "paths", None)
    if paths is not None:
        centres = np.array([element.centre for element in flat.elements_in_plane])
        steps = paths.cycles + (paths.slopes * centres).sum(axis=1)
        tilted = float(np.linalg.norm(paths.slopes, axis=1).max()) * lag
        lag += paths.wavelength * (float(np.ptp(steps)) + tilted)
    if isinstance(source, Wavefront) and source.wavelength is not None:
        low, high = np.reshape(source.bounds, (2, -1))
        away = np.maximum(abs(low - source.centre), abs(high - source.centre))
        lag += source.wavelength * float(np.linalg.norm(source.curvature, 2) * (away @ away)) / 2
    return lag


def check_width(lag: float, wavelength: float) -> None:
    """Raise ArgumentError for a source that is too large for integrals over directions."""
    if not lag / wavelength <= _MOST_WAVELENGTHS:
        raise ArgumentError(
            f"expected a source at most {_MOST_WAVELENGTHS:.0e} wavelengths across, for integrals "
            f"over directions, got one of {lag / wavelength:.3g}; check the unit of the "
            "wavelength (of wide sources, all but about perimeter wavelength/area is radiated)"
        )


def directions_and_weights(
    lag: float, wavelength: float, positions: int = 1
) -> Iterator[tuple[Floats, Floats]]:
    """Yield blocks of unit vectors (n, 3) with z > 0 and solid angles (n,).

    The sums integrate functions band-limited by ``lag`` in m, times polynomials of the direction's
    components, to 1e-14 of the largest value. They have about 15 (lag/wavelength)^2 points, at
    least a hundred. Terminals show a progress bar for long computations; ``positions`` is the
    number of positions at which the caller evaluates each direction. Raises ArgumentError for lags
    of too many wavelengths.
    """
    check_width(lag, wavelength)
    phase = 2 * math.pi * lag / wavelength
    theta, weight = _polar(phase)
    counts = _azimuths(phase * np.sin(theta))
    ends = np.cumsum(counts)
    first, all_directions = 0, int(ends[-1])
    show = None if positions * all_directions > _LONG else False
    with progress_bar("directions", all_directions, show=show) as advance:
        while first < len(theta):
            below = int(np.searchsorted(ends, ends[first] - counts[first] + _BLOCK, side="right"))
            last = max(below, first + 1)
            yield _rings(theta[first:last], weight[first:last], counts[first:last])
            advance(int(counts[first:last].sum()))
            first = last


def _rings(theta: Floats, weight: Floats, counts: NDArray[np.intp]) -> tuple[Floats, Floats]:
    polar = np.repeat(theta, counts)
    index = np.arange(len(polar)) - np.repeat(np.cumsum(counts) - counts, counts)
    phi = 2 * math.pi * index / np.repeat(counts, counts)
    sine = np.sin(polar)
    directions = np.stack([sine * np.cos(phi), sine * np.sin(phi), np.cos(polar)], axis=-1)
    return directions, np.repeat(2 * math.pi * weight * np.sin(theta) / counts, counts)


def _azimuths(phase: Floats) -> NDArray[np.intp]:
    """Return the numbers of azimuths that integrate exp(i phase cos(phi)) cos(phi)^m to 3e-15.

    m is 0, 1 or 2. The error of n azimuths is 2 J_n(phase), negligible if n exceeds the phase by a
    few phase^(1/3). The constants were determined with phases from 0.1 to 3000.
    """
    return np.ceil(phase + 11.0 * np.cbrt(phase) + 9.0).astype(np.intp)


@lru_cache(maxsize=8)
def _polar(phase: float) -> tuple[Floats, Floats]:
    """Return polar angles (n,) in (0, pi/2) and weights; constants as in `_azimuths`.

    On half a panel the phase of the wave changes by at most pi/4 of its amplitude, and n points
    integrate phases below 2 n minus a few cube roots of n.
    """
    panels = max(1, math.ceil(phase / _PANEL))
    along = phase / panels
    count = math.ceil(math.pi / 8 * along + 4.0 * math.cbrt(along) + 7.0)
    node, weight = np.polynomial.legendre.leggauss(count)
    width = math.pi / 2 / panels
    starts = width * np.arange(panels)
    theta = (starts[:, None] + width * (node + 1) / 2).ravel()
    return theta, np.tile(width * weight / 2, panels)


def power_by_lags(
    source: PlaneSource | Wavefront, wavelength: float, obliquity: str
) -> float | None:
    """Return the power of a wide source in W (E5); None if a sum over directions is required.

    The obliquity factor is smooth except at the horizon, so lags beyond some wavelengths contribute
    only through parallel sides: (wavelength/width)^(5/2) of the power, or the power 3/2 of this
    ratio for obliquities with a normal derivative. A smooth cut-off leaves these lags out.
    """
    slope = steepest(source, wavelength)
    soft = _SOFT / (1.0 - min(slope, _STEEP))
    reach = (_ENDS[-1] + _BEYOND) * soft
    width = largest_lag(source) / wavelength
    if width < _WIDE or slope > _STEEP or 4.0 * reach > width:
        return None
    phi, around = _lag_angles(source, 2.0 * math.pi * slope * reach)
    node, weight = np.polynomial.legendre.leggauss(_ON_PERIOD)
    count = math.ceil(reach)
    rho = ((np.arange(count)[:, None] + (node + 1) / 2) * (reach / count)).ravel()
    ring = np.tile(weight * (reach / count / 2), count) * rho
    ends = [[0.5 * math.erfc((r - off * soft) / soft) for r in rho.tolist()] for off in _ENDS]
    lags = wavelength * rho[:, None, None] * np.stack([np.cos(phi), np.sin(phi)], axis=-1)
    powers = np.zeros(len(_ENDS))
    for one, forms in OBLIQUITIES[obliquity].terms(flat_source(source), wavelength):
        part = source.on(one) if isinstance(source, Wavefront) else one
        mean = np.real(lag_marginal(part, lags)) @ around
        powers += np.array(ends) @ (ring * mean * forms.at_lags(2.0 * math.pi * rho))
    return float(powers[1]) if abs(powers[1] - powers[0]) <= _SAME * abs(powers[1]) else None


def steepest(source: PlaneSource | Wavefront, wavelength: float) -> float:
    """Return the largest spatial frequency of the field of a source, times the wavelength."""
    flat: Any = flat_source(source)
    result = float(np.linalg.norm(normal_form(flat).frequencies, axis=1).max())
    if isinstance(source, Wavefront):
        box = np.array(flat.bounds).reshape(2, 2)
        corners = np.array([(x, y) for x in box[:, 0] for y in box[:, 1]]) - source.centre
        result += float(np.linalg.norm(corners @ source.curvature, axis=1).max())
    return float(wavelength * result)


def _lag_angles(source: PlaneSource | Wavefront, turns: float) -> tuple[Floats, Floats]:
    """Return the angles (n,) of lags over half a circle, and weights for the whole circle.

    R_xi has kinks at lags along edges, which separate panels of angles. ``turns`` is a bound on the
    derivative of its phase in the angle.
    """
    flat: Any = flat_source(source)
    rings = [ring for element in getattr(flat, "distinct", (flat,)) for ring in element.rings]
    along = np.concatenate([np.roll(ring, -1, axis=0) - ring for ring in rings])
    kinks = np.unique(np.round(np.arctan2(along[:, 1], along[:, 0]) % math.pi, 12) % math.pi)
    if len(kinks) > _MOST_KINKS:
        width = math.pi / math.ceil(128 + turns)
        centres = np.arange(0.5 * width, math.pi, width)
        return centres, np.full_like(centres, 2.0 * width)
    widths = np.diff(kinks, append=kinks[0] + math.pi)
    nodes, weights = [], []
    for start, width in zip(kinks.tolist(), widths.tolist(), strict=True):
        node, weight = np.polynomial.legendre.leggauss(_ON_PANEL + math.ceil(turns * width))
        nodes.append(start + width * (node + 1) / 2)
        weights.append(width * weight)
    return np.concatenate(nodes), np.concatenate(weights)


# Smallest radiated fraction of the energy: rounding errors are 1e-13 of the energy, so the
# directivity of a source that radiates less has no correct digit.
_DARK = 1e-12


def checked_powers(power: float, energy: float, wavelength: float) -> tuple[float, float]:
    """Return power and energy. Raises IlluminationError for a source that radiates nothing."""
    if not power > _DARK * max(0.0, energy):
        raise IlluminationError(
            f"source radiates only {power:.3g} W at a wavelength of {wavelength:g} m; check the "
            "unit of the wavelength, and whether waves graze the aperture or cancel"
        )
    return power, energy
