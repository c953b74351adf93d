"""Other methods for the Fourier transform of a pupil: finufft, coxeter and the paper's edge sum."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import mpmath
import numpy as np

import polywigner as pw

EQUAL_ACCURACY = 1e-12  # of the area


def quadrilaterals(source: pw.Aperture) -> Iterator[np.ndarray]:
    """Yield corners (4, 2) of quadrilaterals that tile the convex parts of a pupil."""
    for ring in source.rings:
        for k in range(0, len(ring) - 2, 2):
            yield ring[[0, k + 1, k + 2, (k + 3) % len(ring)]]


def gauss_points(source: pw.Aperture, order: int) -> tuple[np.ndarray, np.ndarray]:
    """Return nodes (n, 2) and weights of product rules on bilinear quadrilaterals."""
    t, w = np.polynomial.legendre.leggauss(order)
    s, t = np.meshgrid((t + 1) / 2, (t + 1) / 2)
    weight = np.outer(w, w) / 4
    nodes, weights = [], []
    for a, b, c, d in quadrilaterals(source):
        by_s = (b - a) * (1 - t)[..., None] + (c - d) * t[..., None]
        by_t = (d - a) * (1 - s)[..., None] + (c - b) * s[..., None]
        point = (
            a
            + s[..., None] * (b - a) * (1 - t)[..., None]
            + t[..., None] * (d - a + s[..., None] * (c - d))
        )
        jacobian = by_s[..., 0] * by_t[..., 1] - by_s[..., 1] * by_t[..., 0]
        nodes.append(point.reshape(-1, 2))
        weights.append((weight * jacobian).ravel())
    return np.concatenate(nodes), np.concatenate(weights)


def by_finufft(
    source: pw.Aperture, axis: np.ndarray, order: int, eps: float, threads: int
) -> np.ndarray:
    """Return the grid by a type-1 transform, including its setup."""
    plan, strengths = finufft_plan(source, axis, order, eps, threads)
    return plan.execute(strengths)


def finufft_plan(
    source: pw.Aperture, axis: np.ndarray, order: int, eps: float, threads: int
) -> tuple[Any, Any]:
    """Return a plan with its points, and the strengths."""
    import finufft

    nodes, weights = gauss_points(source, order)
    x, y = (2 * np.pi * (axis[1] - axis[0]) * nodes.T).copy()
    plan = finufft.Plan(1, (len(axis), len(axis)), eps=eps, isign=-1, nthreads=threads)
    plan.setpts(x, y)
    return plan, weights.astype(complex)


def tuned(
    source: pw.Aperture, axis: np.ndarray, exact: np.ndarray, threads: int
) -> tuple[int, float]:
    """Return the lowest order, then the loosest tolerance, with errors below EQUAL_ACCURACY."""

    def good(order: int, eps: float) -> bool:
        error = np.abs(by_finufft(source, axis, order, eps, threads) - exact).max()
        return bool(error <= EQUAL_ACCURACY * source.area)

    order = next(order for order in range(4, 400, 2) if good(order, 1e-14))
    return order, next(
        eps for eps in (1e-11, 3e-12, 1e-12, 3e-13, 1e-13, 1e-14) if good(order, eps)
    )


def by_coxeter(source: pw.Aperture, nu: np.ndarray) -> np.ndarray:
    """Return the sum of coxeter's form factors over the parts."""
    from coxeter.shapes import Polygon

    q = 2 * np.pi * np.concatenate([nu, np.zeros((*nu.shape[:-1], 1))], axis=-1).reshape(-1, 3)
    parts = [Polygon(np.pad(ring, ((0, 0), (0, 1)))) for ring in source.rings]
    total = sum(part.compute_form_factor_amplitude(q) for part in parts)
    return np.asarray(total).reshape(nu.shape[:-1])


def by_edge_sum(source: pw.Aperture, nu: np.ndarray) -> np.ndarray:
    """Return the paper's sum over edges (F1), which fails at nu = 0 and is inaccurate near it."""
    total = np.zeros(nu.shape[:-1], complex)
    for ring in source.rings:
        for a, b in zip(ring, np.roll(ring, -1, axis=0), strict=True):
            e, middle = b - a, (a + b) / 2
            cross = nu[..., 0] * e[1] - nu[..., 1] * e[0]
            total += cross * np.sinc(nu @ e) * np.exp(-2j * np.pi * (nu @ middle))
    with np.errstate(invalid="ignore", divide="ignore"):
        value = total * 1j / (2 * np.pi * (nu**2).sum(axis=-1))
    return np.where((nu == 0).all(axis=-1), source.area, value)


def exact_value(source: pw.Aperture, nu: np.ndarray) -> complex:
    """Return (F1) with 40 digits."""
    with mpmath.workdps(40):
        x, y = (mpmath.mpf(float(v)) for v in nu)
        total = mpmath.mpc(0)
        for ring in source.rings:
            points = [(mpmath.mpf(float(p)), mpmath.mpf(float(q))) for p, q in ring]
            for (ax, ay), (bx, by) in zip(points, points[1:] + points[:1], strict=True):
                mean = mpmath.sincpi(x * (bx - ax) + y * (by - ay))
                wave = mpmath.expjpi(-(x * (ax + bx) + y * (ay + by)))
                total += (x * (by - ay) - y * (bx - ax)) * mean * wave
        return complex(total * mpmath.mpc(0, 1) / (2 * mpmath.pi * (x * x + y * y)))
