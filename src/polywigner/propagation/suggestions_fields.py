"""Bands of fields in front of a source, from the directions in which its points are seen.

The field at P is a sum of waves from points Q of the source, mostly from its edges and, within its
beam, from the place whose ray leads to P. Along a unit tangent t the wave from Q has the local
frequency t.(P - Q)/|P - Q|/wavelength (N5), and the irradiance differences of two such (N6).
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from polywigner.errors import ArgumentError
from polywigner.geometry.arguments import real_numbers
from polywigner.propagation.places import unit_vectors

GRAZING = math.radians(89.5)
"""Where hemispheres end: fields are not asked for in the plane z = 0."""

# Places at which local frequencies are looked at, along each axis: they vary slowly.
_PLACES = 17
_THETA, _PHI = 31, 24

Values = NDArray[np.float64]


class Band(NamedTuple):
    """An axis with the largest step at which it may be sampled."""

    name: str
    unit: str
    low: float
    high: float
    nyquist: float
    band_limited: bool


def bands_in_box(
    bounds: tuple[float, ...], wavelength: float, box: Any, coherent: bool
) -> list[Band]:
    """Bands along x, y and z of a box ((x0, y0, z0), (x1, y1, z1)); `bounds` of the source.

    Raises
    ------
    ArgumentError for anything but a box with z0 > 0.
    """
    low, high = _checked_box(box)
    axes = [
        np.linspace(a, b, _PLACES) if b > a else np.array([a])
        for a, b in zip(low, high, strict=True)
    ]
    # Straight in front of the source most rays cross: those places must be among them.
    for k in (0, 1):
        middle = (bounds[k] + bounds[k + 2]) / 2
        axes[k] = np.unique(np.append(axes[k], np.clip(middle, low[k], high[k])))
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    steps = [
        _nyquist(points, np.broadcast_to(tangent, points.shape), bounds, wavelength, coherent)
        for tangent in np.eye(3)
    ]
    return [
        Band(name, "m", low[k], high[k], steps[k], False) for k, name in enumerate(("x", "y", "z"))
    ]


def bands_on_line(
    bounds: tuple[float, ...], wavelength: float, line: Any, coherent: bool
) -> list[Band]:
    """Along the distance from the first to the second of two points ((x, y, z), (x, y, z)).

    Raises
    ------
    ArgumentError for anything but two different points with z > 0.
    """
    start, end = _checked_corners("line", line)
    _check_in_front("line", min(start[2], end[2]))
    length = math.dist(start, end)
    if length == 0:
        raise ArgumentError(
            f"expected a line between two points that differ, got {line!r}; move one"
        )
    # Where it passes by the source, closely perhaps, directions change most.
    share = np.linspace(0.0, 1.0, _PLACES**2)[:, None]
    points = (1 - share) * np.array(start) + share * np.array(end)
    tangents = np.broadcast_to((np.array(end) - np.array(start)) / length, points.shape)
    step = _nyquist(points, tangents, bounds, wavelength, coherent)
    return [Band("distance", "m", 0.0, length, step, False)]


def bands_on_sphere(
    bounds: tuple[float, ...], wavelength: float, radius: float, coherent: bool
) -> list[Band]:
    """Along theta and phi of a hemisphere around the origin, as far as it is in front."""
    theta = np.linspace(0.0, GRAZING, _THETA)
    phi = 2 * math.pi * np.arange(_PHI) / _PHI
    points = radius * unit_vectors(theta, phi).reshape(-1, 3)
    down = unit_vectors(theta + math.pi / 2, phi).reshape(-1, 3)
    around = unit_vectors(np.full(1, math.pi / 2), phi + math.pi / 2)
    along = np.broadcast_to(around, (_THETA, _PHI, 3)) * np.sin(theta)[:, None, None]
    return [
        Band(name, "rad", 0.0, end, step / radius, False)
        for name, end, step in (
            ("theta", GRAZING, _nyquist(points, down, bounds, wavelength, coherent)),
            (
                "phi",
                2 * math.pi,
                _nyquist(points, along.reshape(-1, 3), bounds, wavelength, coherent),
            ),
        )
    ]


def _nyquist(
    points: Values,
    tangents: Values,
    bounds: tuple[float, ...],
    wavelength: float,
    coherent: bool,
) -> float:
    """The largest step along tangents (n, 3) at points (n, 3), in m."""
    cosines = np.einsum("nqc,nc->nq", _rays(points, bounds), tangents)
    if coherent:
        largest = float(np.abs(cosines).max())
    else:
        largest = float((cosines.max(axis=1) - cosines.min(axis=1)).max())
    return wavelength / (2 * largest) if largest > 0 else math.inf


def _rays(points: Values, bounds: tuple[float, ...]) -> Values:
    """Unit vectors (n, 9, 3) to points (n, 3) from nine points of the source's box.

    A direction cosine along x is largest from the lower end of the box and, along y, from the
    nearest or the farthest place, by its sign; that along z from the nearest or farthest of all.
    """
    candidates = [
        np.stack(np.broadcast_arrays(low, np.clip(points[:, k], low, high), high), axis=-1)
        for k, (low, high) in enumerate(zip(bounds[:2], bounds[2:], strict=True))
    ]
    x, y = candidates[0][:, :, None], candidates[1][:, None, :]
    x, y = np.broadcast_arrays(x, y)
    from_source = np.stack([x, y, np.zeros_like(x)], axis=-1).reshape(len(points), 9, 3)
    rays = points[:, None, :] - from_source
    rays /= np.abs(rays).max(axis=-1, keepdims=True)  # squares of what is left are floats
    return np.asarray(rays / np.linalg.norm(rays, axis=-1, keepdims=True))


def _checked_box(box: Any) -> tuple[list[float], list[float]]:
    low, high = _checked_corners("box", box)
    if any(a > b for a, b in zip(low, high, strict=True)):
        raise ArgumentError(
            f"expected a box with the lowest corner first, got {box!r}; exchange coordinates"
        )
    _check_in_front("box", low[2])
    return low, high


def _checked_corners(name: str, value: Any) -> tuple[list[float], list[float]]:
    expected = f"expected {name} as ((x0, y0, z0), (x1, y1, z1)) in m"
    try:
        corners = real_numbers(value)
    except ValueError as error:
        raise ArgumentError(f"{expected}, got {error}") from None
    if corners.shape != (2, 3) or not np.isfinite(corners).all():
        raise ArgumentError(f"{expected}, got {value!r}")
    first, second = corners.tolist()
    return first, second


def _check_in_front(name: str, lowest: float) -> None:
    if lowest <= 0:
        raise ArgumentError(
            f"expected a {name} in front of the source, z > 0, got z = {lowest:g} m; move it"
        )
