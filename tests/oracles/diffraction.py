"""Rayleigh-Sommerfeld and Kirchhoff fields by plain two-dimensional quadrature."""

from __future__ import annotations

from typing import Any

import numpy as np

import polywigner as pw
from oracles.quadrature import triangle_nodes
from polywigner.geometry.aperture import triangulate

_PER_WAVELENGTH = 5.0  # nodes along a side, of a phase of up to 2 cycles per wavelength
_BEYOND = 16


def irradiance_by_quadrature(source: Any, points: Any, wavelength: float, condition: str) -> Any:
    return np.abs(field_by_quadrature(source, points, wavelength, condition)) ** 2


def field_by_quadrature(source: Any, points: Any, wavelength: float, condition: str) -> Any:
    """U at points (n, 3): the field and its normal derivative integrated over the source."""
    elements, weights = [source], [1.0]
    if isinstance(source, pw.Array):
        elements, weights = list(source.elements_in_plane), list(source.weights)
    pairs = zip(elements, weights, strict=True)
    return sum(w * _of_element(e, points, wavelength, condition) for e, w in pairs)


def _of_element(element: Any, points: Any, wavelength: float, condition: str) -> Any:
    vertices, triangles = triangulate(element)
    corners = vertices[triangles]
    order = int(_BEYOND + _PER_WAVELENGTH * element.diameter / wavelength)
    nodes, weights = triangle_nodes(corners, order)
    k = 2 * np.pi / wavelength
    field = element.illumination or pw.uniform()
    cosine = np.sqrt((1 - (wavelength * field.frequencies**2 * wavelength).sum(-1)).astype(complex))
    waves = np.exp(2j * np.pi * nodes @ field.frequencies.T)
    value = weights * (waves @ field.amplitudes)
    slope = weights * (waves @ (field.amplitudes * 1j * k * cosine))
    result = []
    for point in np.reshape(points, (-1, 3)):
        r = np.sqrt(((point[:2] - nodes) ** 2).sum(-1) + point[2] ** 2)
        spherical = np.exp(1j * k * r) / (2 * np.pi * r)
        dipole = ((1 / r - 1j * k) * point[2] / r * spherical) @ value
        monopole = -(spherical @ slope)
        result.append(
            {
                "rayleigh-sommerfeld-1": dipole,
                "rayleigh-sommerfeld-2": monopole,
                "kirchhoff": (dipole + monopole) / 2,
            }[condition]
        )
    return np.array(result)
