"""Power density below an aperture by two independent integrals, for tests and benchmarks.

- ``wigner_intensity``: |U|^2 to leading order, (1/lambda^2) int W g/|r|^2 dx over the automean, by
  Gauss-Legendre quadrature on pieces on which W is analytic. ``wigner_floor`` is the same integral
  with the floor's cosine, which the renderer estimates.
- ``rayleigh_sommerfeld``: |U|^2 of the exact first Rayleigh-Sommerfeld integral, as a line integral
  over the aperture's edges, without code of the package.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import numpy.typing as npt
import shapely

import polywigner as pw

__all__ = [
    "convergence",
    "mean_over_pixels",
    "pixel_points",
    "rayleigh_sommerfeld",
    "wigner_floor",
    "wigner_intensity",
]

Array = npt.NDArray[np.float64]


def _edges(aperture: pw.Aperture) -> tuple[Array, Array]:
    start = np.concatenate(aperture.rings)
    end = np.concatenate([np.roll(ring, -1, axis=0) for ring in aperture.rings])
    return start, end


def rayleigh_sommerfeld(aperture: pw.Aperture, points: Array, wavelength: float) -> Array:
    """Return |U|^2 at points (..., 3) with z of 2 wavelengths or more, for a unit wave along +z.

    U = -(1/2 pi) closed-int ((z/R) e^{ikR} - e^{ikz}) dphi, with the difference divided by rho^2 in
    closed form, which is smooth at edges below the point.
    """
    k = 2 * np.pi / wavelength
    start, end = _edges(aperture)
    total = np.zeros(points.shape[:-1], dtype=complex)
    z = points[..., 2, None]
    for a, b in zip(start, end, strict=True):
        # Four times the nodes for an error of 1e-6 (docs/theory).
        count = 40 + int(10 * np.hypot(*(b - a)) / wavelength)
        t, weights = np.polynomial.legendre.leggauss(count)
        nodes = a + (b - a) * (t[:, None] + 1) / 2
        rho = nodes - points[..., None, :2]
        squared = (rho**2).sum(axis=-1)
        distance = np.sqrt(squared + z**2)
        farther = squared / (distance + z)  # R - z
        # (z/R) e^{ikR} - e^{ikz} = e^{ikz} (z/R (e^{ik(R-z)} - 1) - (R-z)/R), over rho^2:
        swing = 1j * k * np.exp(0.5j * k * farther) * np.sinc(k * farther / (2 * np.pi))
        integrand = (z * swing - 1) / (distance * (distance + z))
        sweep = rho[..., 0] * (b - a)[1] - rho[..., 1] * (b - a)[0]
        total += (integrand * sweep * weights / 2).sum(axis=-1) * np.exp(1j * k * z[..., 0])
    return np.abs(total / (2 * np.pi)) ** 2


def _cells(aperture: pw.Aperture) -> list[Array]:
    """Return triangles between the lines across which W(., nu) is not analytic."""
    start, end = _edges(aperture)
    lines = [
        shapely.LineString([(vertex + a) / 2, (vertex + b) / 2])
        for vertex in start
        for a, b in zip(start, end, strict=True)
        if not np.allclose(a, b)
    ]
    cells = shapely.polygonize([shapely.unary_union(lines, grid_size=1e-9 * aperture.diameter)])
    support = pw.automean(aperture).polygons
    triangles: list[Array] = []
    for cell in cells.geoms:
        if support.contains(cell.representative_point()):
            parts = shapely.constrained_delaunay_triangles(cell).geoms
            triangles += [shapely.get_coordinates(part)[:3] for part in parts]
    return triangles


def _nodes(triangles: list[Array], count: int) -> tuple[Array, Array]:
    """Return Gauss-Legendre nodes (n, 2) and weights (n,), count x count on each triangle."""
    t, w = np.polynomial.legendre.leggauss(count)
    u, v = np.meshgrid((t + 1) / 2, (t + 1) / 2, indexing="ij")
    weights = np.outer(w, w) / 4 * u
    a, b, c = np.stack(triangles, axis=1)[:, :, None, None, :]
    nodes = a + u[..., None] * ((b - a) + v[..., None] * (c - b))
    sides = np.stack([b - a, c - a], axis=-1)[:, 0, 0]
    return nodes.reshape(-1, 2), (weights * np.abs(np.linalg.det(sides))[:, None, None]).ravel()


def wigner_intensity(aperture: pw.Aperture, points: Array, wavelength: float) -> Array:
    """Return (1/lambda^2) int W g/|r|^2 dx at points (..., 3), g = cos^2."""
    return _wigner_integral(aperture, points, wavelength, None, 2)


def wigner_floor(
    aperture: pw.Aperture, points: Array, wavelength: float, count: int | None = None
) -> Array:
    """Return ``wigner_intensity`` with the cosine at points of a floor below the aperture."""
    return _wigner_integral(aperture, points, wavelength, count, 3)


def _wigner_integral(
    aperture: pw.Aperture, points: Array, wavelength: float, count: int | None, cosines: int
) -> Array:
    triangles = _cells(aperture)
    if count is None:
        side = max(np.ptp(triangle, axis=0).max() for triangle in triangles)
        count = 8 + int(np.ceil(5 * side / wavelength))
    nodes, weights = _nodes(triangles, count)
    flat = points.reshape(-1, 3)
    result = np.empty(len(flat))
    step = max(1, 2_000_000 // len(nodes))
    for first, last in pairwise([*range(0, len(flat), step), len(flat)]):
        r = flat[first:last, None, :] - np.pad(nodes, ((0, 0), (0, 1)))
        distance = np.linalg.norm(r, axis=-1)
        nu = r[..., :2] / distance[..., None] / wavelength
        density = pw.wigner(aperture, np.broadcast_to(nodes, nu.shape), nu)
        factor = (r[..., 2] / distance) ** cosines
        result[first:last] = (density * factor / distance**2 * weights).sum(axis=-1)
    return result.reshape(points.shape[:-1]) / wavelength**2


def convergence(aperture: pw.Aperture, points: Array, wavelength: float, values: Array) -> float:
    """Return the relative change of ``values`` of ``wigner_floor`` with more nodes."""
    triangles = _cells(aperture)
    side = max(np.ptp(triangle, axis=0).max() for triangle in triangles)
    finer = wigner_floor(aperture, points, wavelength, 14 + int(np.ceil(7 * side / wavelength)))
    return float(np.abs(finer - values).max() / np.abs(values).max())


def pixel_points(columns: int, half_width: float, z: float, per_side: int = 4) -> Array:
    """Return Gauss nodes (columns, per_side, per_side, 3) in the pixels of a centred line."""
    pitch = 2 * half_width / columns
    centres = (np.arange(columns) + 0.5) * pitch - half_width
    offsets = np.polynomial.legendre.leggauss(per_side)[0] * pitch / 2
    x = (centres[:, None] + offsets)[:, :, None]
    grid = np.broadcast_arrays(x, offsets, z)
    return np.stack(grid, axis=-1)


def mean_over_pixels(values: Array) -> Array:
    """Return means (columns,) of values at ``pixel_points``."""
    weights = np.polynomial.legendre.leggauss(values.shape[-1])[1] / 2
    return np.einsum("cij,i,j->c", values, weights, weights)
