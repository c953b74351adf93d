"""Diffraction integrals over the opening itself, by quadrature on triangles graded to the point.

The integrands are those of Rayleigh and Sommerfeld, with no step in common with integrals along
edges. Triangles are halved until each is smaller than its distance from the point and than a
wavelength or so of its phase; then Gauss-Legendre nodes see analytic functions.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

import polywigner as pw
from oracles.quadrature import graded_in_plane, triangle_nodes

_ORDER = 18
# Nodes at a time.
_MANY = 2000


def surface_fields(source: Any, point: Any, wavelength: float) -> np.ndarray:
    """U of an aperture or an array at one point (3,): Rayleigh-Sommerfeld I, II, and Kirchhoff."""
    if isinstance(source, pw.Array):
        terms = zip(source.elements_in_plane, source.weights, strict=True)
        return np.sum([w * surface_fields(e, point, wavelength) for e, w in terms], axis=0)
    place = np.asarray(point, float)
    field = source.illumination or pw.Illumination([1.0], [(0.0, 0.0)])
    k = 2 * math.pi / wavelength
    dirichlet = neumann = 0j
    triangles = graded_in_plane(source, place, 0.6 * wavelength)
    for first in range(0, len(triangles), _MANY):
        nodes, weights = triangle_nodes(triangles[first : first + _MANY], _ORDER)
        r = np.sqrt(((nodes - place[:2]) ** 2).sum(axis=1) + place[2] ** 2)
        wave = weights * np.exp(1j * k * r) / r
        slope = place[2] / r * (1 / r - 1j * k)
        for amplitude, kappa in zip(field.amplitudes, field.frequencies, strict=True):
            u = amplitude * np.exp(2j * math.pi * (nodes @ kappa)) * wave
            p = np.sqrt(complex(1 - wavelength**2 * kappa @ kappa))
            dirichlet += (u @ slope) / (2 * math.pi)
            neumann -= 1j * k * p * u.sum() / (2 * math.pi)
    return np.array([dirichlet, neumann, (dirichlet + neumann) / 2])


def field_by_quadrature(source: Any, points: Any, wavelength: float, condition: str) -> np.ndarray:
    """U at points (n, 3) by one boundary condition."""
    number = ("rayleigh-sommerfeld-1", "rayleigh-sommerfeld-2", "kirchhoff").index(condition)
    rows = np.reshape(points, (-1, 3))
    return np.array([surface_fields(source, row, wavelength)[number] for row in rows])
