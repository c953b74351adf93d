"""Near fields of curved waves: Fresnel's in closed form, exact ones as sums over places.

Edges do not do: the wave of a horn is no solution of Helmholtz's equation whose potential is known.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polywigner.errors import ArgumentError
from polywigner.geometry import Wavefront
from polywigner.geometry.aperture import triangulate
from polywigner.illumination.obliquities import CONDITIONS, direction_cosines
from polywigner.propagation.panels import Radiator, radiator_of
from polywigner.transforms.wavefronts import chirp_transform, principal_axes

__all__ = ["curved_field"]

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]

# So many Gauss nodes along each side of a cell have 13 digits of waves of four turns there, and of
# the static field of places half as far away as the cell is long.
_NODES, _TURNS = 20, 4.0
# Rounding of a sum, relative to the sum of the moduli.
_ROUNDING = 1e-13
# Pairs of a point and a cell: so many nodes at a time, points at a time, and the most in all.
_BLOCK, _POINTS, _MOST_PAIRS = 1 << 9, 1 << 9, 1 << 22


def curved_field(
    wave: Wavefront, points: Floats, wavelength: float, method: str
) -> tuple[Complex, Floats]:
    """The field at points (n, 3), and a bound on the rounding of it."""
    if method == "fresnel":
        return _fresnel(wave, points, wavelength)
    values, errors = np.empty(len(points), np.complex128), np.empty(len(points))
    radiator = radiator_of(wave.source)
    for start in range(0, len(points), _POINTS):
        mine = slice(start, start + _POINTS)
        values[mine], errors[mine] = _exact(wave, radiator, points[mine], wavelength, method)
    return values, errors


def _fresnel(wave: Wavefront, points: Floats, wavelength: float) -> tuple[Complex, Floats]:
    """(Q6): a parabola more in the transform's phase, that of the way to each point."""
    q, axes = principal_axes(wave.curvature)
    scale = 1.0 / (wavelength * points[:, 2])
    place, centre = points[:, :2], wave.centre
    nu = (place - centre) * scale[:, None]
    found = chirp_transform(wave.source, q + scale[:, None], axes, centre, nu)
    turns = points[:, 2] / wavelength
    turns = turns - np.round(turns) + scale / 2 * ((place**2).sum(axis=1) - centre @ centre)
    values = found * (scale / 1j) * np.exp(2j * math.pi * (turns - np.round(turns)))
    return values, _ROUNDING * scale * radiator_of(wave.source).content


class _Part:
    """A copy of an element: its triangles where it is, its waves, and its wave's centre."""

    def __init__(self, element: Any, shift: Floats, weight: complex) -> None:
        self.shift = shift
        self.amplitudes = weight * element.amplitudes
        self.frequencies = element.frequencies
        corners, numbers = triangulate(element.outline)
        self.triangles = corners[numbers] + shift


def _exact(
    wave: Wavefront, radiator: Radiator, points: Floats, wavelength: float, method: str
) -> tuple[Complex, Floats]:
    """The sum over cells so small that one rule does for all, and the moduli of its terms."""
    values, sizes = np.zeros(len(points), np.complex128), np.zeros(len(points))
    for element in radiator.elements:
        for shift, weight in zip(element.shifts, element.weights.tolist(), strict=True):
            part = _Part(element, shift, weight)
            for owners, cells in _cells(wave, part, points, wavelength):
                terms = _terms(wave, part, cells, points[owners], wavelength, method)
                np.add.at(values, owners, terms.sum(axis=1))
                np.add.at(sizes, owners, np.abs(terms).sum(axis=1))
    return values, _ROUNDING * sizes


def _cells(
    wave: Wavefront, part: _Part, points: Floats, wavelength: float
) -> Iterator[tuple[NDArray[np.intp], Floats]]:
    """Numbers of points (k,) and triangles (k, 3, 2), in blocks: each point has all of the part."""
    count = len(part.triangles)
    owners = np.repeat(np.arange(len(points)), count)
    cells = np.tile(part.triangles, (len(points), 1, 1))
    while len(owners):
        small = _are_small(wave, part, cells, points[owners], wavelength)
        ready, done = owners[small], cells[small]
        for start in range(0, len(ready), _BLOCK):
            yield ready[start : start + _BLOCK], done[start : start + _BLOCK]
        owners, cells = np.repeat(owners[~small], 4), _quartered(cells[~small])
        if len(owners) > _MOST_PAIRS:
            raise ArgumentError(
                "expected points farther from a source with a curved wave, or a smaller source: "
                "its exact field is a sum over places; use method='fresnel' for large ones"
            )


def _are_small(
    wave: Wavefront, part: _Part, cells: Floats, points: Floats, wavelength: float
) -> NDArray[np.bool_]:
    """Whether phases turn four times at most across a cell, at most twice as long as far."""
    sides = cells - np.roll(cells, 1, axis=1)
    size = np.linalg.norm(sides, axis=2).max(axis=1)
    away = cells - points[:, None, :2]
    height = points[:, 2]
    reach = np.sqrt((away**2).sum(axis=2) + height[:, None] ** 2)
    centre = away.mean(axis=1)
    distance = np.sqrt((centre**2).sum(axis=1) + height**2)
    near = np.maximum(height, distance - size)
    slopes = away / (wavelength * reach[..., None]) + (cells - wave.centre) @ wave.curvature
    highest = np.zeros(len(cells))
    for kappa in part.frequencies:
        own = np.linalg.norm(slopes + kappa, axis=2).max(axis=1)
        highest = np.maximum(highest, own)
    rate = highest + np.minimum(size / near, 1.0) / wavelength
    return np.asarray((rate * size <= _TURNS) & (size <= 2 * near))


def _quartered(cells: Floats) -> Floats:
    a, b, c = cells[:, 0], cells[:, 1], cells[:, 2]
    ab, bc, ca = (a + b) / 2, (b + c) / 2, (c + a) / 2
    quarters = [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
    return np.stack([np.stack(q, axis=1) for q in quarters], axis=1).reshape(-1, 3, 2)


def _terms(
    wave: Wavefront, part: _Part, cells: Floats, points: Floats, wavelength: float, method: str
) -> Complex:
    """Values times weights (k, nodes) of the integrand of (Q7)."""
    shares, weights = _rule()
    nodes = np.einsum("nc,kcd->knd", shares, cells)
    first, second = cells[:, 1] - cells[:, 0], cells[:, 2] - cells[:, 0]
    area = np.abs(first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0])
    inner = nodes - wave.centre
    slope = inner @ wave.curvature
    turns = ((inner * slope).sum(axis=2)) / 2
    height = points[:, 2, None]
    reach = np.sqrt(((nodes - points[:, None, :2]) ** 2).sum(axis=2) + height**2)
    shifted = nodes - part.shift
    field, slopes = np.zeros(turns.shape, np.complex128), np.zeros(turns.shape, np.complex128)
    condition = CONDITIONS[method]
    for amplitude, kappa in zip(part.amplitudes.tolist(), part.frequencies, strict=True):
        here = amplitude * np.exp(2j * math.pi * (turns + shifted @ kappa))
        field += here
        if condition.takes_slopes:
            slopes += here * direction_cosines(slope + kappa, wavelength)
    k = 2 * math.pi / wavelength
    value = condition.slope * slopes
    value += condition.field * field * (height / reach) * (1 + 1j / (k * reach))
    way = np.exp(2j * math.pi * (reach / wavelength)) / (1j * wavelength * reach)
    return np.asarray(value * way * (area[:, None] * weights))


@lru_cache(maxsize=1)
def _rule() -> tuple[Floats, Floats]:
    """Shares of the corners (n, 3), and weights (n,) of twice a triangle's area."""
    x, w = np.polynomial.legendre.leggauss(_NODES)
    x, w = (x + 1) / 2, w / 2
    u, v = (a.ravel() for a in np.meshgrid(x, x, indexing="ij"))
    weights = np.outer(w * x, w).ravel()
    return np.stack([1 - u, u * (1 - v), u * v], axis=1), weights
