"""Field around a soft or hard sphere that a point source illuminates, by partial waves.

With the source at distance d from the centre of a sphere of radius a, and the point at r and at the
angle g from the direction of the source, exp(ikR)/R is

    i k sum over n of (2n + 1) j_n(k r<) h_n(k r>) P_n(cos g),

where r< and r> are the smaller and the larger of r and d. In the scattered field, -c_n h_n(k d)
h_n(k r) replaces j_n(k r<) h_n(k r>), with c_n = j_n(ka)/h_n(ka) if u = 0 on the sphere (soft), and
with the ratio of the derivatives if du/dr = 0 (hard). Source: Bowman, Senior and Uslenghi,
Electromagnetic and acoustic scattering by simple shapes, 10.
"""

from __future__ import annotations

import numpy as np
from scipy.special import eval_legendre, spherical_jn, spherical_yn

Array = np.ndarray


def field_of_sphere(kind: str, radius: float, distance: float, points: Array) -> Array:
    """Return u at points (n, 3) outside a sphere at the origin, divided by the incident field.

    The incident field is exp(ikR)/R. The source is on the z axis at -distance. Lengths are in
    wavelengths.
    """
    k = 2 * np.pi
    r = np.linalg.norm(points, axis=1)
    cosine = -points[:, 2] / r
    total = np.zeros(len(points), complex)
    # Partial waves with n above ka miss the sphere. The terms beyond 8 widths of the transition sum
    # to less than 1e-10.
    for n in range(int(k * radius + 8 * (k * radius) ** (1 / 3)) + 10):
        slope = kind == "hard"
        own = spherical_jn(n, k * radius, slope)
        share = own / (own + 1j * spherical_yn(n, k * radius, slope))
        total -= (
            (2 * n + 1)
            * share
            * _hankel(n, k * distance)
            * _hankel(n, k * r)
            * eval_legendre(n, cosine)
        )
    ahead = np.linalg.norm(points + np.array([0.0, 0.0, distance]), axis=1)
    return 1 + 1j * k * total * ahead * np.exp(-1j * k * ahead)


def _hankel(n: int, x: Array | float) -> Array:
    return np.asarray(spherical_jn(n, x) + 1j * spherical_yn(n, x))
