"""Sums along the edges of an opening lit by a point source, to a tolerance."""

from __future__ import annotations

import math
from functools import partial

import numpy as np
from numpy.typing import NDArray

from polywigner import execution
from polywigner.errors import ArgumentError
from polywigner.geometry import Aperture
from polywigner.kernels.boundary.spherical import spherical_edge

__all__ = ["incident_of_point", "wave_at", "waves_through"]

Floats = NDArray[np.float64]
Place = tuple[float, float, float]

_OPS = execution.NumpyOperations(double=True)
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(16)
# Turns of the detour along a panel that the rule resolves well enough to be judged by halves.
_TURNS = 2.0
# Rows of panels at a time: temporary arrays of some MB.
_ROWS = 1 << 12
# Most wavelengths of edges, about a panel each, of one point and of a block of points.
_MOST = 1 << 22
_POINTS = 1 << 8


def wave_at(
    direction: tuple[float, float, float], points: Floats, wavelength: float
) -> NDArray[np.complex128]:
    """exp(ik s.x) at points (n, 3)."""
    turns = (points / wavelength) @ np.array(direction)
    return np.asarray(np.exp(2j * math.pi * (turns - np.round(turns))))


def incident_of_point(source: Place, points: Floats, wavelength: float) -> NDArray[np.complex128]:
    """exp(ikR)/R at points (n, 3), R the distance from the source (3,)."""
    distance = np.linalg.norm(points - source, axis=1)
    turns = distance / wavelength
    return np.asarray(np.exp(2j * math.pi * (turns - np.round(turns))) / distance)


def waves_through(
    opening: Aperture,
    source: Place,
    points: Floats,
    wavelength: float,
    mirrored: float,
    tolerance: float,
) -> tuple[NDArray[np.complex128], Floats]:
    """The field behind an opening over the incident one at points (n, 3), z > 0, and its error.

    Kirchhoff's at a point, and ``mirrored`` times that at its mirror image.
    """
    edges = np.concatenate([np.hstack([ring, np.roll(ring, -1, axis=0)]) for ring in opening.rings])
    edges = edges / wavelength
    around = float(np.hypot(*(edges[:, 2:] - edges[:, :2]).T).sum())
    if not around <= _MOST:
        raise ArgumentError(
            f"expected a screen with edges of at most {_MOST:.2g} wavelengths in all, got "
            f"{around:.3g}; check the unit of the wavelength, or cut off what is far from the path"
        )
    step = max(1, min(_POINTS, int(_MOST / around)))
    found = np.zeros(len(points), np.complex128)
    errors = np.zeros(len(points))
    place, allowed = np.array(source) / wavelength, 2 * math.pi * tolerance
    for some in (slice(low, low + step) for low in range(0, len(points), step)):
        found[some], errors[some] = _sums(
            edges, place, points[some] / wavelength, mirrored, allowed
        )
    return found / (2 * math.pi), errors / (2 * math.pi)


def _sums(
    edges: Floats, source: Floats, points: Floats, mirrored: float, allowed: float
) -> tuple[NDArray[np.complex128], Floats]:
    """The integrals over all edges, by halving panels until halves agree with the whole."""
    n, total, errors = len(points), np.zeros(len(points), np.complex128), np.zeros(len(points))
    point = np.repeat(np.arange(n), len(edges))
    edge = np.tile(np.arange(len(edges)), n)
    low, high = np.zeros(len(point)), np.ones(len(point))
    panels = partial(_panels, edges, source, points, mirrored)
    whole, _ = panels(point, edge, low, high)
    while len(point):
        middle = 0.5 * (low + high)
        left, swing_left = panels(point, edge, low, middle)
        right, swing_right = panels(point, edge, middle, high)
        off = abs(left + right - whole)
        resolved = np.maximum(swing_left, swing_right) <= _TURNS
        # a panel of the share 2^-m of an edge may be so much off as its share of the tolerance
        share = np.maximum(high - low, 2.0**-10) / 4.0
        ends = (middle <= low) | (middle >= high)
        good = (resolved & (off <= allowed * share)) | ends
        np.add.at(total, point[good], (left + right)[good])
        np.add.at(errors, point[good], off[good])
        bad = ~good
        point, edge = np.repeat(point[bad], 2), np.repeat(edge[bad], 2)
        whole = np.stack([left[bad], right[bad]], axis=1).ravel()
        low, high = (
            np.stack([low[bad], middle[bad]], axis=1).ravel(),
            np.stack([middle[bad], high[bad]], axis=1).ravel(),
        )
    return total, errors


def _panels(
    edges: Floats, source: Floats, points: Floats, mirrored: float,
    point: NDArray[np.intp], edge: NDArray[np.intp], low: Floats, high: Floats,
) -> tuple[NDArray[np.complex128], Floats]:  # fmt: skip
    """The integral over panels, shares low to high of edges, and the turns of the detour there."""
    values, swings = np.empty(len(point), np.complex128), np.empty(len(point))
    for start in range(0, len(point), _ROWS):
        some = slice(start, start + _ROWS)
        row, where = edges[edge[some]], points[point[some]]
        span = row[:, 2:] - row[:, :2]
        length = np.hypot(*span.T)
        along = (span.T / length)[:, :, None]
        half = 0.5 * (high[some] - low[some])
        at = (low[some] + half)[:, None] + half[:, None] * _NODES
        place = (row[:, :1] + span[:, :1] * at, row[:, 1:2] + span[:, 1:] * at)
        p = tuple(where[:, k : k + 1] for k in range(3))
        s = (float(source[0]), float(source[1]), float(source[2]))
        real, imag, detour = spherical_edge(_OPS, s, p, place, tuple(along), mirrored)
        values[some] = (real @ _WEIGHTS + 1j * (imag @ _WEIGHTS)) * half * length
        swings[some] = np.ptp(detour, axis=1)
    return values, swings
