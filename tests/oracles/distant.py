"""Fields of rectangles with 40 digits; points, wavelengths and frequencies are exact floats."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

import polywigner as pw
from oracles.exact import mpmath

_DIGITS = 40
# Nodes along a side of up to two wavelengths.
_NODES = 12


def distant_fields(source: Any, point: Any, wavelength: float) -> dict[str, complex]:
    """Return U at a point (3,) by each method, where "fraunhofer" has each exact obliquity.

    ``source`` is a rectangle along the axes with any field, or an Array of such rectangles.
    """
    with mpmath.workdps(_DIGITS):
        result = {name: mpmath.mpc(0) for name in _names()}
        elements, weights = [source], [1.0]
        if isinstance(source, pw.Array):
            elements, weights = list(source.elements_in_plane), source.weights.tolist()
        corners = np.array([element.bounds for element in elements])
        low, high = corners[:, :2].min(axis=0), corners[:, 2:].max(axis=0)
        centre = [mpmath.mpf(float(c)) for c in low / 2 + high / 2]
        place = [mpmath.mpf(float(c)) for c in point]
        for element, weight in zip(elements, weights, strict=True):
            for x, y, share in _nodes(element):
                for amplitude, wave, pz in _waves(element, wavelength):
                    value = weight * share * amplitude * wave(x, y)
                    for name, kernel in _kernels(x, y, centre, place, wavelength, pz).items():
                        result[name] += value * kernel
        return {name: complex(value) for name, value in result.items()}


def _nodes(element: Any) -> Iterator[tuple[Any, Any, Any]]:
    west, south, east, north = (mpmath.mpf(float(b)) for b in element.bounds)
    node, weight = (list(map(float, a)) for a in np.polynomial.legendre.leggauss(_NODES))
    area = (east - west) * (north - south) / 4
    for t, u in zip(node, weight, strict=True):
        for s, v in zip(node, weight, strict=True):
            x, y = west + (east - west) * (1 + t) / 2, south + (north - south) * (1 + s) / 2
            yield x, y, area * u * v


def _waves(element: Any, wavelength: float) -> Iterator[tuple[Any, Any, Any]]:
    field = element.illumination or pw.uniform()
    for amplitude, kappa in zip(field.amplitudes, field.frequencies, strict=True):
        a, b = (mpmath.mpf(float(k)) for k in kappa)
        pz = mpmath.sqrt(1 - (wavelength * a) ** 2 - (wavelength * b) ** 2)

        def wave(x: Any, y: Any, a: Any = a, b: Any = b) -> Any:
            return mpmath.expjpi(2 * (a * x + b * y))

        yield mpmath.mpc(complex(amplitude)), wave, pz


def _names() -> tuple[str, ...]:
    exact = ("rayleigh-sommerfeld-1", "rayleigh-sommerfeld-2", "kirchhoff")
    return (*exact, "fresnel", *(f"fraunhofer {name}" for name in exact))


def _kernels(x: Any, y: Any, centre: Any, place: Any, wavelength: float, pz: Any) -> dict[str, Any]:
    """Return the contribution of a unit field at (x, y) by each method."""
    size = mpmath.mpf(wavelength)
    dx, dy, z = place[0] - x, place[1] - y, place[2]
    r = mpmath.sqrt(dx * dx + dy * dy + z * z)
    spherical = mpmath.expjpi(2 * r / size) / r
    dipole = z / r * (1 / r - 2j * mpmath.pi / size) * spherical / (2 * mpmath.pi)
    monopole = -1j * pz / size * spherical
    ahead, aside = place[0] - centre[0], place[1] - centre[1]
    whole = mpmath.sqrt(ahead * ahead + aside * aside + z * z)
    lag = (ahead * (x - centre[0]) + aside * (y - centre[1])) / whole
    far = mpmath.expjpi(2 * (whole - lag) / size) / (1j * size * whole)
    cosine = z / whole
    paraxial = z + (dx * dx + dy * dy) / (2 * z)
    return {
        "rayleigh-sommerfeld-1": dipole,
        "rayleigh-sommerfeld-2": monopole,
        "kirchhoff": (dipole + monopole) / 2,
        "fresnel": mpmath.expjpi(2 * paraxial / size) / (1j * size * z),
        "fraunhofer rayleigh-sommerfeld-1": cosine * far,
        "fraunhofer rayleigh-sommerfeld-2": pz * far,
        "fraunhofer kirchhoff": (cosine + pz) / 2 * far,
    }
