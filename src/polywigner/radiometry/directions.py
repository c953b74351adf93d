"""Checks of sources and directions, and integrals over the hemisphere.

W and |F|^2 are sums of waves ``exp(i k rho sin(theta) cos(phi - phi0))``, where rho is at most the
diameter of the source. Gauss-Legendre nodes in theta and evenly spaced nodes in phi integrate such
waves to rounding errors.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import lru_cache
from typing import Any

import numpy as np
import shapely

from polywigner.errors import ArgumentError, IlluminationError
from polywigner.execution.progress import slow_bar
from polywigner.geometry import Aperture, Slits, Wavefront
from polywigner.geometry.arguments import check_most, checked_number, finite_array
from polywigner.numerics import Floats, Indices, blocks_by_size
from polywigner.numerics.nodes import uniform_rule
from polywigner.quantities import SPEED_OF_LIGHT
from polywigner.source import Array
from polywigner.source.normal_form import normal_form
from polywigner.source.obliquities import OBLIQUITIES
from polywigner.source.tapers import checked_unit_vectors
from polywigner.transforms import lag_marginal
from polywigner.transforms.traced_sources import check_no_drjit
from polywigner.transforms.wavefronts import checked_wavefront, flat_source

# Largest product of bandwidth and propagation time across the source. The mean over the band takes
# about this number of wavelengths.
_MOST_SPREAD = 500.0


def checked_bandwidth(bandwidth: Any, wavelength: float) -> float:
    """Return a bandwidth in Hz; raise ArgumentError unless it is below twice the frequency."""
    most = 2 * SPEED_OF_LIGHT / wavelength
    meaning = f"a number of Hz above zero and below {most:.4g} Hz, twice the frequency"
    return checked_number(bandwidth, "bandwidth", meaning, lambda x: 0 < x < most)


def wavelengths_of_band(
    wavelength: float, bandwidth: float, lag: float, error: float
) -> list[tuple[float, float]]:
    """Return wavelengths in m, and weights, for a mean over a band of frequencies.

    The band of ``bandwidth`` in Hz is centred at the frequency of ``wavelength``. ``lag``: size of
    the source in m. ``error``: allowed error of the mean. Raises ArgumentError for bands that are
    too wide.
    """
    spread = bandwidth * lag / SPEED_OF_LIGHT
    things = f"Hz of bandwidth for a source of {lag:.4g} m"
    most = _MOST_SPREAD * SPEED_OF_LIGHT / lag
    check_most(bandwidth, most, things, "check the unit, or divide the band")
    nodes, weights = uniform_rule(math.pi * spread, error)
    frequencies = SPEED_OF_LIGHT / wavelength + bandwidth / 2 * nodes
    return list(zip((SPEED_OF_LIGHT / frequencies).tolist(), weights.tolist(), strict=True))


PlaneSource = Aperture | Array


def checked_radiator(source: Any, partly: bool = False) -> PlaneSource | Wavefront:
    """Return the validated source: an aperture, an array in the plane z = 0, or a curved wave.

    Raises IlluminationError for partially coherent light unless ``partly`` is true.
    """
    if not isinstance(source, Wavefront):
        return checked_source(source)
    checked_source(source.source)
    return source if partly else checked_wavefront(source)


def checked_source(source: Any) -> PlaneSource:
    """Return the validated source: an aperture, or an array of apertures in the plane z = 0.

    Raises ArgumentError for other objects, and GeometryError for elements outside this plane.
    """
    if isinstance(source, Aperture):
        return source
    flat: Any = source
    if isinstance(source, Array):
        flat = source.repeated[0] if source.repeated is not None else source.elements_in_plane[0]
    if not isinstance(source, Array) or isinstance(flat, Slits):
        advice = {
            "Slits": "use rectangles instead, because power requires an area",
            "PlacedAperture": "use its .aperture, and directions relative to it",
            "Polyhedron": "only Fourier transforms are available for bodies",
            "Wavefront": "use its .source, whose wave is flat and coherent",
        }.get(type(flat).__name__, "create an Aperture from a ring or from shapely polygons")
        raise ArgumentError(
            "expected an Aperture, or an Array of apertures in the plane z = 0, got "
            f"{type(flat).__name__}; {advice}"
        )
    # Elements with their poses applied accept spatial frequencies with two components.
    return source if source.dimension == 2 else Array(source.elements_in_plane, source.weights)


def checked_directions(direction: Any) -> Floats:
    """Return unit vectors (..., 3) with z >= 0, or raise ArgumentError."""
    check_no_drjit(direction=direction)
    array = checked_unit_vectors("direction", direction)
    back = array[..., 2] < 0
    if back.any():
        raise ArgumentError(
            "expected directions with z >= 0, because sources radiate to +z, got "
            f"{array[back][0].tolist()}"
        )
    return array


def checked_plane_positions(x: Any) -> Floats:
    """Return finite positions (..., 2) in m, or raise ArgumentError."""
    check_no_drjit(x=x)
    return finite_array(x, "expected finite positions x of shape (..., 2)", (..., 2))


# Largest source size [wavelengths]. A square of this size requires 1.5e11 directions, which take
# half a day on two cores.
_MOST_WAVELENGTHS = 1e5
# Number of directions per block; a block takes a few MB.
_BLOCK = 1 << 17

# Source size [wavelengths] above which the integral over lags is used, because sums over directions
# would take seconds.
_WIDE = 600.0
# Largest accepted relative difference between the powers from the two cut-offs. If the difference
# is larger, the power is a sum over directions.
_SAME = 1e-6
# Largest spatial frequency of a field for the integral over lags, as a fraction of 1/wavelength.
_STEEP = 0.8
# Width of the cut-off [wavelengths] at normal incidence. Waves along the horizon contribute
# exp(-32).
_SOFT = 1.8
# Lags of the two cut-offs, in units of the cut-off width.
_ENDS = (4.5, 6.5)
# Distance from the larger cut-off lag to the end of the integral, in units of the cut-off width.
# Longer lags contribute 1e-14.
_BEYOND = 5.5
# Largest number of edge directions for which lag angles are divided into panels; otherwise, the
# angles are evenly spaced.
_MOST_KINKS = 48
# Smallest number of Gauss nodes per panel of angles, and number of nodes per wavelength of lag.
_ON_PANEL, _ON_PERIOD = 8, 12
# Largest phase [rad] per panel of theta, because computing n Gauss nodes takes a time of order n^3.
_PANEL = 400.0


def largest_lag(source: PlaneSource | Wavefront) -> float:
    """Return the diameter of a source in m, or an upper bound."""
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
    """Return an upper bound in m on path differences, including curved waves and feed networks."""
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
    """Raise ArgumentError if a source of size ``lag`` is wider than 100,000 wavelengths."""
    remedy = (
        "check the unit of the wavelength (wide sources radiate all power except the fraction "
        "perimeter * wavelength / area)"
    )
    things = "wavelengths across a source for integrals over directions"
    check_most(lag / wavelength, _MOST_WAVELENGTHS, things, remedy)


def directions_and_weights(lag: float, wavelength: float) -> Iterator[tuple[Floats, Floats]]:
    """Yield quadrature nodes on the hemisphere: unit vectors (n, 3) and solid angles (n,).

    For a source of size ``lag`` in m, the rule integrates W or |F|^2 with an error of 1e-14 of the
    largest value. The integrand may also contain polynomials in the vector components. The rule has
    about 15 (lag/wavelength)^2 nodes, at least a hundred. Raises ArgumentError for sources that are
    too large.
    """
    check_width(lag, wavelength)
    phase = 2 * math.pi * lag / wavelength
    theta, weight = _polar_nodes(phase)
    counts = _azimuth_counts(phase * np.sin(theta))
    with slow_bar("directions", int(counts.sum())) as advance:
        for rings in blocks_by_size(counts, _BLOCK):
            yield _directions_on_rings(theta[rings], weight[rings], counts[rings])
            advance(int(counts[rings].sum()))


def _directions_on_rings(theta: Floats, weight: Floats, counts: Indices) -> tuple[Floats, Floats]:
    """Return unit vectors (n, 3) and solid angles (n,) for the polar angles theta.

    ``weight``: weights of the nodes theta, without the factor sin(theta). ``counts``: number of
    azimuths for each polar angle.
    """
    polar = np.repeat(theta, counts)
    index = np.arange(len(polar)) - np.repeat(np.cumsum(counts) - counts, counts)
    phi = 2 * math.pi * index / np.repeat(counts, counts)
    sine = np.sin(polar)
    directions = np.stack([sine * np.cos(phi), sine * np.sin(phi), np.cos(polar)], axis=-1)
    return directions, np.repeat(2 * math.pi * weight * np.sin(theta) / counts, counts)


def _azimuth_counts(phase: Floats) -> Indices:
    """Return the numbers of azimuths for integrals of exp(i phase cos(phi)) cos(phi)^m, m <= 2."""
    # The error 2 J_n(phase) is 3e-15. The constants were fitted to phases from 0.1 to 3000.
    return np.ceil(phase + 11.0 * np.cbrt(phase) + 9.0).astype(np.intp)


@lru_cache(maxsize=8)
def _polar_nodes(phase: float) -> tuple[Floats, Floats]:
    """Return nodes theta from 0 to pi/2 and their weights, without the factor sin(theta).

    The rule is for waves with phases up to ``phase`` in rad.
    """
    # On half a panel, the phase changes by at most pi/4 of its largest value. The constants were
    # fitted as in `_azimuth_counts`.
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
    """Return the power of a wide source in W as an integral over lags, equation (E5).

    Returns None if a sum over directions is required.
    """
    # The obliquity factor is smooth except at the horizon. Long lags contribute only through
    # parallel sides: a fraction (wavelength/width)^(5/2) of the power, or (wavelength/width)^(3/2)
    # with a normal derivative. A smooth cut-off omits these lags.
    slope = largest_transverse_cosine(source, wavelength)
    soft = _SOFT / (1.0 - min(slope, _STEEP))
    longest_lag = (_ENDS[-1] + _BEYOND) * soft
    width = largest_lag(source) / wavelength
    if width < _WIDE or slope > _STEEP or 4.0 * longest_lag > width:
        return None
    phi, around = _lag_angles(source, 2.0 * math.pi * slope * longest_lag)
    node, weight = np.polynomial.legendre.leggauss(_ON_PERIOD)
    count = math.ceil(longest_lag)
    rho = ((np.arange(count)[:, None] + (node + 1) / 2) * (longest_lag / count)).ravel()
    ring = np.tile(weight * (longest_lag / count / 2), count) * rho
    cut_offs = [[0.5 * math.erfc((r - end * soft) / soft) for r in rho.tolist()] for end in _ENDS]
    lags = wavelength * rho[:, None, None] * np.stack([np.cos(phi), np.sin(phi)], axis=-1)
    powers = np.zeros(len(_ENDS))
    for flat, forms in OBLIQUITIES[obliquity].terms(flat_source(source), wavelength):
        part = source.on(flat) if isinstance(source, Wavefront) else flat
        mean = np.real(lag_marginal(part, lags)) @ around
        powers += np.array(cut_offs) @ (ring * mean * forms.at_lags(2.0 * math.pi * rho))
    return float(powers[1]) if abs(powers[1] - powers[0]) <= _SAME * abs(powers[1]) else None


def largest_transverse_cosine(source: PlaneSource | Wavefront, wavelength: float) -> float:
    """Return the largest transverse direction cosine of the local waves of a source.

    The value exceeds 1 for evanescent waves.
    """
    flat: Any = flat_source(source)
    highest = float(np.linalg.norm(normal_form(flat).frequencies, axis=1).max())
    if isinstance(source, Wavefront):
        box = np.array(flat.bounds).reshape(2, 2)
        corners = np.array([(x, y) for x in box[:, 0] for y in box[:, 1]]) - source.centre
        highest += float(np.linalg.norm(corners @ source.curvature, axis=1).max())
    return float(wavelength * highest)


def _lag_angles(source: PlaneSource | Wavefront, rate: float) -> tuple[Floats, Floats]:
    """Return angles of lags over a half circle, and weights for the full circle.

    ``rate``: bound on the phase derivative of the autocorrelation with respect to the angle.
    """
    # The autocorrelation has kinks at lags along edges, so panels of angles end at these lags.
    flat: Any = flat_source(source)
    rings = [ring for element in getattr(flat, "distinct", (flat,)) for ring in element.rings]
    along = np.concatenate([np.roll(ring, -1, axis=0) - ring for ring in rings])
    kinks = np.unique(np.round(np.arctan2(along[:, 1], along[:, 0]) % math.pi, 12) % math.pi)
    if len(kinks) > _MOST_KINKS:
        width = math.pi / math.ceil(128 + rate)
        centres = np.arange(0.5 * width, math.pi, width)
        return centres, np.full_like(centres, 2.0 * width)
    widths = np.diff(kinks, append=kinks[0] + math.pi)
    nodes, weights = [], []
    for start, width in zip(kinks.tolist(), widths.tolist(), strict=True):
        node, weight = np.polynomial.legendre.leggauss(_ON_PANEL + math.ceil(rate * width))
        nodes.append(start + width * (node + 1) / 2)
        weights.append(width * weight)
    return np.concatenate(nodes), np.concatenate(weights)


# Radiated fraction of the power below which a source counts as dark. Rounding errors are 1e-13 of
# the power.
_DARK = 1e-12


def checked_powers(power: float, energy: float, wavelength: float) -> tuple[float, float]:
    """Return the radiated power and the energy in W unchanged.

    Raises IlluminationError if hardly any power is radiated.
    """
    if not power > _DARK * max(0.0, energy):
        raise IlluminationError(
            f"the source radiates only {power:.3g} W at a wavelength of {wavelength:g} m; check "
            "the unit of the wavelength, and whether the waves of the source graze the aperture "
            "or cancel each other"
        )
    return power, energy
