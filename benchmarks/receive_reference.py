"""Received power in diffuse scenes by quadrature, for tests and benchmarks.

A surface element dA at y with the reflectance rho, illuminated by |U_t|^2 of the transmitter's
exact field, sends rho/pi E towards the receiver. By reciprocity the received power is

    P = (lambda^2/N_r) int rho/pi E |U_r|^2 cos(y -> receiver) dA,    E = |U_t|^2 cos(y -> source),

with means of cosines over the squares, and the radiated power N_r of the receiver's field. Fog
scatters |U_t|^2 isotropically. U_t and U_r are :func:`polywigner.irradiance` with the method
``rayleigh-sommerfeld-1``; lengths in metres.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
import numpy.typing as npt

import polywigner as pw
from polywigner.quantities import wavelength_of

__all__ = ["WAVELENGTH", "End", "grid", "of_ball", "of_fog", "of_surface", "radiated"]

WAVELENGTH = wavelength_of(94e9)
METHOD = "rayleigh-sommerfeld-1"
_BLOCK = 1 << 16

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class End:
    """A square source and its pose (4, 4): a transmitter or a receiver."""

    side: float
    pose: Any

    @property
    def source(self) -> pw.Aperture:
        """Return the square of unit field, centred at the origin."""
        return pw.shapes.square(self.side)

    def irradiance(self, points: Array, method: str = METHOD) -> Array:
        """Return |U|^2 at points (..., 3) of the scene; zero behind the source."""
        own = (points.reshape(-1, 3) - self.pose[:3, 3]) @ self.pose[:3, :3]
        front = own[:, 2] > 0
        values = np.zeros(len(own))
        seen = own[front]
        values[front] = np.concatenate(
            [
                pw.irradiance(self.source, seen[k : k + _BLOCK], WAVELENGTH, method=method)
                for k in range(0, len(seen), _BLOCK)
            ]
        )
        return values.reshape(points.shape[:-1])

    def places(self) -> tuple[Array, Array]:
        """Return Gauss points (9, 3) of the source in the scene, and weights whose sum is 1."""
        nodes, weights = np.polynomial.legendre.leggauss(3)
        a, b = (axis.ravel() for axis in np.meshgrid(nodes, nodes))
        flat = self.side / 2 * np.stack([a, b, 0 * a], axis=-1)
        return flat @ self.pose[:3, :3].T + self.pose[:3, 3], np.outer(weights, weights).ravel() / 4

    def mean(self, points: Array, of: Any) -> Array:
        """Return the mean over the source of a function of unit vectors to points and positions."""
        total = np.zeros(points.shape[:-1])
        for place, weight in zip(*self.places(), strict=True):
            away = points - place
            total += weight * of(away / np.linalg.norm(away, axis=-1)[..., None], place)
        return total


def of_surface(
    transmitter: End,
    receiver: End,
    points: Array,
    normals: Array,
    areas: Array,
    reflectance: float = 1.0,
    passes: Any = None,
) -> float:
    """Return the power from a diffuse surface; ``passes(place, points)``: the visible fraction."""

    def of(direction: Array, place: Array) -> Array:
        cosine = np.maximum(-(direction * normals).sum(axis=-1), 0.0)
        return np.asarray(cosine if passes is None else cosine * passes(place, points))

    both = [end.mean(points, of) * end.irradiance(points) for end in (transmitter, receiver)]
    power = reflectance / np.pi * (areas * both[0] * both[1]).sum()
    return float(WAVELENGTH**2 / radiated(receiver.side) * power)


def of_fog(
    transmitter: End,
    receiver: End,
    points: Array,
    volumes: Array,
    scattering: float,
    passes: Any,
) -> float:
    """Return the power of single isotropic scattering in fog, in 1/m."""

    def of(direction: Array, place: Array) -> Array:
        return np.asarray(passes(place, points))

    both = [end.mean(points, of) * end.irradiance(points) for end in (transmitter, receiver)]
    power = scattering / (4 * np.pi) * (volumes * both[0] * both[1]).sum()
    return float(WAVELENGTH**2 / radiated(receiver.side) * power)


def _hemisphere(count: int) -> tuple[Array, Array]:
    """Return unit vectors (n, n, 3) with z > 0, and their solid angles."""
    t, w = np.polynomial.legendre.leggauss(count)
    alpha, psi = np.meshgrid(t, t * np.pi / 2, indexing="ij")
    rho = np.sqrt(1 - alpha**2)
    directions = np.stack([alpha, rho * np.sin(psi), rho * np.cos(psi)], axis=-1)
    return directions, np.outer(w, w * np.pi / 2)


def of_ball(receiver: End, obliquity: str, radius: float) -> float:
    """Return the power of a ball of radiance 1 around a receiver at the origin."""
    directions, solid_angles = _hemisphere(160)
    points = radius * directions

    def of(direction: Array, place: Array) -> Array:
        return np.asarray((direction * directions).sum(axis=-1))

    seen = receiver.mean(points, of) * receiver.irradiance(points, obliquity)
    total = (solid_angles * radius**2 * seen).sum()
    return float(WAVELENGTH**2 / radiated(receiver.side, obliquity) * total)


@lru_cache
def radiated(side: float, obliquity: str = METHOD) -> float:
    """Return the radiated power in W of a square of unit field: the integral of g |F|^2."""
    directions, solid_angles = _hemisphere(200)
    cosine = directions[..., 2]
    nu = directions[..., :2] / WAVELENGTH
    g = {
        "rayleigh-sommerfeld-1": cosine**2,
        "kirchhoff": ((1 + cosine) / 2) ** 2,
        "rayleigh-sommerfeld-2": np.ones_like(cosine),
    }[obliquity]
    pattern = np.abs(pw.fourier(pw.shapes.square(side), nu)) ** 2 * g
    return float((solid_angles * pattern).sum() / WAVELENGTH**2)


def grid(low: Any, high: Any, panels: Any) -> tuple[Array, Array]:
    """Return points (n, m, 2) of a rectangle and weights: Gauss rules in panels of 8 points."""
    t, w = np.polynomial.legendre.leggauss(8)
    axes = []
    for a, b, count in zip(low, high, panels, strict=True):
        edges = np.linspace(a, b, count + 1)
        middles, halves = (edges[1:] + edges[:-1]) / 2, np.diff(edges) / 2
        axes.append(
            ((middles[:, None] + halves[:, None] * t).ravel(), (halves[:, None] * w).ravel())
        )
    (x, wx), (y, wy) = axes
    return np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1), np.outer(wx, wy)
