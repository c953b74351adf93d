"""Derivatives of radar cross sections in the directions of receiver and transmitter."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from polywigner.scattering.antennas import spherical_axes
from polywigner.scattering.beams import lit_sums
from polywigner.scattering.facets import Facets
from polywigner.scattering.surface_sums import surface_slopes

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]

# In rad: parts of faces in shadows are good to 1e-12 of their amplitude, and the square is left of
# the edges' motion in turns of phase.
_STEP = 1e-5


def section_slopes(
    facets: Facets,
    s: Floats,
    t: Floats,
    lengths: Floats,
    polarisations: list[Complex],
    channel: str | None,
    monostatic: bool,
) -> tuple[Floats, ...]:
    """Derivatives (n, 3) in s, towards the receiver, and in t, towards the transmitter (n, 3).

    Across these, which stay of length 1; of ``monostatic`` in both, which are one.
    ``polarisations``: of both (n, 3), or none; ``channel``: the name of those that turn with the
    directions.
    """
    k = -t
    nu = (s + t) / lengths[:, None]
    n = lit_sums(facets, k, s, nu, monostatic)
    by_nu = lit_sums(facets, k, s, nu, monostatic, surface_slopes) / lengths[:, None, None]
    if not polarisations:
        of_n, of_s, of_k = _total(n, s, k)
    else:
        q, p = polarisations
        of_n, of_s, of_k = _polarised(n, s, k, q, p, channel)

    def whole(explicit: Floats, moved: Complex | float, direction: Floats) -> Floats:
        slopes = explicit + np.einsum("ni,nia->na", of_n, by_nu + moved).real
        along = (slopes * direction).sum(axis=1, keepdims=True)
        return np.asarray(4 * np.pi / lengths[:, None] ** 2 * (slopes - along * direction))

    def moved(of_s: bool, of_t: bool) -> Complex | float:
        return _moved(facets, s, t, nu, of_s, of_t, monostatic) if facets.casts_shadows else 0.0

    if monostatic:
        return (whole(of_s, moved(True, True), s) + whole(-of_k, 0.0, t),)
    return whole(of_s, moved(True, False), s), whole(-of_k, moved(False, True), t)


def _moved(
    facets: Facets,
    s: Floats,
    t: Floats,
    nu: Floats,
    of_s: bool,
    of_t: bool,
    monostatic: bool,
) -> Complex:
    """dN_i/ds_a or dt_a (n, 3, 3) by edges of shadows that move, at the same nu.

    By differences of the lit polygons, which are exact: where edges move over faces in lines.
    """
    turned = s if of_s else t
    least = np.eye(3)[np.abs(turned).argmin(axis=1)]
    one = np.cross(turned, least)
    one /= np.linalg.norm(one, axis=1, keepdims=True)
    result = np.zeros((len(nu), 3, 3), np.complex128)
    for axis in (one, np.cross(turned, one)):
        ends = []
        for step in (_STEP, -_STEP):
            there = turned * math.cos(step) + axis * math.sin(step)
            own, other = there if of_s else s, there if of_t else t
            ends.append(lit_sums(facets, -other, own, nu, monostatic))
        result += ((ends[0] - ends[1]) / (2 * _STEP))[:, :, None] * axis[:, None, :]
    return result


def _total(n: Complex, s: Floats, k: Floats) -> tuple[Complex, Floats, Floats]:
    """Slopes of (|k.N|^2 + |s.N|^2 + |N.(k x s)|^2)/2 in N (n, 3), in s and in k."""
    normal = np.cross(k, s)
    along_k, along_s, through = (_dot(n, v).conj() for v in (k, s, normal))
    of_n = along_k * k + along_s * s + through * normal
    of_s = along_s * n + through * np.cross(n, k)
    of_k = along_k * n + through * np.cross(s, n)
    return of_n, of_s.real, of_k.real


def _polarised(
    n: Complex, s: Floats, k: Floats, q: Complex, p: Complex, channel: str | None
) -> tuple[Complex, Floats, Floats]:
    """Slopes of |q.(N x (k x p))|^2 in N, s and k."""
    h = np.cross(k, p)
    twice = 2 * _dot(q, np.cross(n, h)).conj()
    w = np.cross(q, n)
    of_n, of_k = twice * np.cross(h, q), twice * np.cross(p, w)
    of_s = np.zeros_like(of_k)
    if channel is not None:
        of_s = np.einsum("ni,nia->na", twice * np.cross(n, h), _turning(s)[channel[0]])
        of_k = of_k - np.einsum("ni,nia->na", twice * np.cross(w, k), _turning(-k)[channel[1]])
    return of_n, of_s.real, of_k.real


def _turning(towards: Floats) -> dict[str, Floats]:
    """Derivatives (n, 3, 3) of v and h in their direction; NaN along z."""
    axes = spherical_axes(towards)
    v, h = axes["v"], axes["h"]
    across = np.hypot(towards[:, 0], towards[:, 1])[:, None]
    with np.errstate(divide="ignore", invalid="ignore"):
        rate = h / np.where(across > 0, across, np.nan)  # of the azimuth
    outwards = np.cross(h, (0.0, 0.0, 1.0))
    return {
        "v": towards[:, 2, None, None] * h[:, :, None] * rate[:, None]
        - towards[:, :, None] * v[:, None],
        "h": -outwards[:, :, None] * rate[:, None],
    }


def _dot(a: Complex, b: Complex | Floats) -> Complex:
    return np.asarray((a * b).sum(axis=1, keepdims=True))
