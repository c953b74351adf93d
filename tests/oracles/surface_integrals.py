"""Diffraction integrals over the opening, by quadrature on graded triangles.

The integrands are those of Rayleigh and Sommerfeld, independent of the integrals along edges.
Triangles are halved until each is smaller than its distance from the point and than about a
wavelength of its phase, so that Gauss-Legendre rules converge.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

import polywigner as pw
from oracles.quadrature import graded_in_plane, triangle_nodes

_ORDER = 18
# Number of nodes per block.
_MANY = 2000


def surface_fields(source: Any, point: Any, wavelength: float) -> np.ndarray:
    """Return U of a source at a point (3,): Rayleigh-Sommerfeld I, II and Kirchhoff."""
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
    """Return U at points (n, 3) for one boundary condition."""
    number = ("rayleigh-sommerfeld-1", "rayleigh-sommerfeld-2", "kirchhoff").index(condition)
    rows = np.reshape(points, (-1, 3))
    return np.array([surface_fields(source, row, wavelength)[number] for row in rows])
