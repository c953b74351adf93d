"""The field of a point source at a soft or hard half-plane, in closed form.

With R the distance from the source (or its image) to the point and R_1 the shortest path over the
edge, each of the two waves exp(ikR)/R is replaced by

    i k integral from -m to infinity of H_1(kR + s^2)/sqrt(s^2 + 2kR) ds,   |m| = sqrt(k(R_1 - R)),

m > 0 on the illuminated side of the boundary of its shadow. H_1 is Hankel's function of the first
kind. Source: Macdonald (1915); Bowman, Senior and Uslenghi, Electromagnetic and acoustic scattering
by simple shapes, 8.
"""

from __future__ import annotations

import numpy as np
from scipy.special import hankel1e

Array = np.ndarray

K = 2 * np.pi
# Gauss nodes on an integration path along which exp(is^2) decays to exp(-49).
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(240)
_NODES, _WEIGHTS = 3.5 * (1 + _NODES), 3.5 * _WEIGHTS
_TURN = np.exp(0.25j * np.pi)


def field_of_half_plane(kind: str, source: Array, points: Array) -> Array:
    """Return the field at points (n, 3) of one source (3,) or of sources (n, 3) at a half-plane.

    The incident wave is exp(ikR)/R. The half-plane is z = 0, x < 0, and the source has z < 0.
    Lengths are in wavelengths.
    """
    (radius, angle), (from_edge, start) = (_polar(p) for p in (points, source))
    along = points[..., 1] - source[..., 1]
    lit = _wave(from_edge, radius, along, angle - start)
    image = _wave(from_edge, radius, along, angle + start)
    return lit - image if kind == "soft" else lit + image


def incident_shadow(source: Array, points: Array) -> Array:
    """Return the first of the two waves, divided by exp(ikR)/R."""
    (radius, angle), (from_edge, start) = (_polar(p) for p in (points, source))
    along, difference = points[..., 1] - source[..., 1], angle - start
    distance = np.linalg.norm(points - source, axis=-1)
    wave = _wave(from_edge, radius, along, difference)
    return wave * distance * np.exp(-1j * K * distance)


def _polar(points: Array) -> tuple[Array, Array]:
    """Return the distance from the edge, and the angle from the side that faces -z."""
    x, _, z = np.moveaxis(points, -1, 0)
    # Adding 0 makes the angle of points on the half-plane (z = 0) zero.
    return np.hypot(x, z), np.mod(np.arctan2(-z + 0.0, -x), 2 * np.pi)


def _wave(first: Array, last: Array, along: Array, angle: Array) -> Array:
    distance = np.sqrt(first**2 + last**2 - 2 * first * last * np.cos(angle) + along**2)
    path = np.sqrt((first + last) ** 2 + along**2)
    m = 2 * np.sqrt(K * first * last / (path + distance)) * np.cos(angle / 2)
    beyond = _beyond(K * distance, np.abs(m))
    phase = np.exp(1j * K * distance)
    return np.where(m < 0.0, 1j * K * beyond * phase, phase / distance - 1j * K * beyond * phase)


def _beyond(kr: Array, start: Array) -> Array:
    """Return the integral from ``start`` to infinity, divided by exp(ikR)."""
    squares = (start[..., None] + _TURN * _NODES) ** 2
    terms = hankel1e(1, kr[..., None] + squares) * np.exp(1j * squares)
    return _TURN * (_WEIGHTS * terms / np.sqrt(squares + 2 * kr[..., None])).sum(axis=-1)
