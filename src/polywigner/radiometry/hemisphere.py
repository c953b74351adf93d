"""Integrals over the far hemisphere of functions that are band-limited in the direction.

W(x, nu) and |F(nu)|^2 are Fourier transforms over lags xi, none of which is longer than the
source's diameter D. As functions of direction they are sums of waves exp(i k rho sin(theta)
cos(phi - phi0)) with rho <= D. Gauss-Legendre points in theta and equidistant ones in phi integrate
these to rounding as soon as there are some more of them than such a wave has half periods, and
nothing is gained by fewer: the error falls faster than any exponential.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import lru_cache
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray

from polywigner.errors import ArgumentError
from polywigner.geometry import Aperture, Wavefront
from polywigner.radiometry.directions import PlaneSource
from polywigner.radiometry.progress import progress_bar
from polywigner.transforms.wavefronts import flat_of

Array = NDArray[np.float64]

# Largest width of a source: 1.5e11 directions, half a day of two cores for the power of a square.
_MOST_WAVELENGTHS = 1e5
# Directions at a time: some megabytes.
_BLOCK = 1 << 17
# Values of F or W, a few seconds' work, from which on a terminal shows how far it is.
_LONG = 1 << 25
# Largest phase of a wave on one panel of theta: points of long panels cost their cube to find.
_PANEL = 400.0


def largest_lag(source: PlaneSource | Wavefront) -> float:
    """Largest distance of two points of the source, in m; of many elements a little more."""
    flat: Any = flat_of(source)
    if isinstance(flat, Aperture):
        return flat.diameter
    if flat.repeated is not None and isinstance(flat.repeated[0], Aperture):
        element, sites = flat.repeated
        return element.diameter + _diameter(sites)
    corners = [np.concatenate(element.rings) for element in flat.elements_in_plane]
    return _diameter(np.concatenate(corners))


def _diameter(points: Array) -> float:
    """Largest distance of two of a set of points (n, 2)."""
    hull = shapely.get_coordinates(shapely.MultiPoint(points).convex_hull)
    return max(float(np.hypot(*(hull - point).T).max()) for point in hull)


def check_width(lag: float, wavelength: float) -> None:
    """Raise ArgumentError for a source of so many wavelengths that nobody would wait for it."""
    if not lag / wavelength <= _MOST_WAVELENGTHS:
        raise ArgumentError(
            f"expected a source at most {_MOST_WAVELENGTHS:.0e} wavelengths across, for integrals "
            f"over directions, got one of {lag / wavelength:.3g}; check the unit of the "
            "wavelength (of wide sources, all but about perimeter wavelength/area is radiated)"
        )


def directions_and_weights(
    lag: float, wavelength: float, places: int = 1
) -> Iterator[tuple[Array, Array]]:
    """Unit vectors (n, 3) of z > 0 and solid angles (n,), in blocks.

    Draws a bar on a terminal if there is much to do in all ``places`` that a block is for.

    Integrals over the hemisphere of functions that are band-limited as above by ``lag``, times
    polynomials of the direction's components, come out with an error of 1e-14 of the largest
    value. Some 15 (lag/wavelength)^2 points, and a hundred at least.

    Raises ArgumentError for a lag of so many wavelengths that nobody would wait for the sum.
    """
    check_width(lag, wavelength)
    phase = 2 * math.pi * lag / wavelength
    theta, weight = _polar(phase)
    counts = _azimuths(phase * np.sin(theta))
    ends = np.cumsum(counts)
    first, all_directions = 0, int(ends[-1])
    show = None if places * all_directions > _LONG else False
    with progress_bar("directions", all_directions, show=show) as advance:
        while first < len(theta):
            below = int(np.searchsorted(ends, ends[first] - counts[first] + _BLOCK, side="right"))
            last = max(below, first + 1)
            yield _rings(theta[first:last], weight[first:last], counts[first:last])
            advance(int(counts[first:last].sum()))
            first = last


def _rings(theta: Array, weight: Array, counts: NDArray[np.intp]) -> tuple[Array, Array]:
    polar = np.repeat(theta, counts)
    index = np.arange(len(polar)) - np.repeat(np.cumsum(counts) - counts, counts)
    phi = 2 * math.pi * index / np.repeat(counts, counts)
    sine = np.sin(polar)
    directions = np.stack([sine * np.cos(phi), sine * np.sin(phi), np.cos(polar)], axis=-1)
    return directions, np.repeat(2 * math.pi * weight * np.sin(theta) / counts, counts)


def _azimuths(phase: Array) -> NDArray[np.intp]:
    """Number of azimuths that integrate exp(i phase cos(phi)) cos(phi)^m, m = 0, 1, 2, to 3e-15.

    What n of them leave is 2 J_n(phase), negligible from a few phase^(1/3) beyond n = phase on. The
    numbers were found by trying phases from 0.1 to 3000.
    """
    return np.ceil(phase + 11.0 * np.cbrt(phase) + 9.0).astype(np.intp)


@lru_cache(maxsize=8)
def _polar(phase: float) -> tuple[Array, Array]:
    """Angles (n,) in (0, pi/2) and weights; numbers found as for azimuths.

    On half a panel the wave turns by at most pi/4 of its phase, and n points integrate what turns
    by less than 2 n and a few cube roots of it.
    """
    panels = max(1, math.ceil(phase / _PANEL))
    along = phase / panels
    count = math.ceil(math.pi / 8 * along + 4.0 * math.cbrt(along) + 7.0)
    node, weight = np.polynomial.legendre.leggauss(count)
    width = math.pi / 2 / panels
    starts = width * np.arange(panels)
    theta = (starts[:, None] + width * (node + 1) / 2).ravel()
    return theta, np.tile(width * weight / 2, panels)
