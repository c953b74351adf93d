"""Derivatives of cross sections in the directions of receiver and transmitter. Source: (SC5)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from polywigner.errors import ArgumentError
from polywigner.scattering.facets import Facets
from polywigner.scattering.polarisations import spherical_axes
from polywigner.scattering.surface_sums import Pieces, surface_slopes, surface_sums
from polywigner.scattering.visibility import facing

__all__ = ["section_slopes"]

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]


def section_slopes(
    facets: Facets,
    s: Floats,
    t: Floats,
    lengths: Floats,
    polarisations: list[Complex],
    channel: str | None,
) -> tuple[Floats, Floats]:
    """Derivatives (n, 3) in s, towards the receiver, and in t, towards the transmitter (n, 3).

    Across these, which stay of length 1. ``polarisations``: of both (n, 3), or none;
    ``channel``: the name of those that turn with the directions.

    Raises ArgumentError for bodies that cast shadows on themselves.
    """
    if facets.casts_shadows:
        raise ArgumentError(
            "expected a convex body or one plate with derivatives in directions, got a body that "
            "may cast shadows on itself, whose edges move with the transmitter; pass "
            "drjit.detach(...) of the directions"
        )
    k = -t
    pieces = Pieces(facets.corner, facets.first, facets.second, facets.vector)
    nu = (s - k) / lengths[:, None]

    def signs(some: slice, part: slice) -> NDArray[np.int8]:
        return facing(facets, k[some], part)

    n = surface_sums(pieces, nu, signs)
    slopes = surface_slopes(pieces, nu, signs)
    if not polarisations:
        of_n, of_s, of_k = _total(n, s, k)
    else:
        q, p = polarisations
        of_n, of_s, of_k = _polarised(n, s, k, q, p, channel)
    shared = np.einsum("ni,nia->na", of_n, slopes).real / lengths[:, None]
    scale = 4 * np.pi / lengths[:, None] ** 2
    return _across(scale * (of_s + shared), s), _across(scale * (shared - of_k), t)


def _total(n: Complex, s: Floats, k: Floats) -> tuple[Complex, Floats, Floats]:
    """Of (|k.N|^2 + |s.N|^2 + |N.(k x s)|^2)/2: in N (n, 3), a factor of dN, in s and in k."""
    normal = np.cross(k, s)
    along_k, along_s, through = (_dot(n, v).conj() for v in (k, s, normal))
    of_n = along_k * k + along_s * s + through * normal
    of_s = along_s * n + through * np.cross(n, k)
    of_k = along_k * n + through * np.cross(s, n)
    return of_n, of_s.real, of_k.real


def _polarised(
    n: Complex, s: Floats, k: Floats, q: Complex, p: Complex, channel: str | None
) -> tuple[Complex, Floats, Floats]:
    """The same of |q.(N x (k x p))|^2."""
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
    """How v and h turn with their direction, (n, 3, 3); not a number along z."""
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


def _across(slopes: Floats, direction: Floats) -> Floats:
    along = (slopes * direction).sum(axis=1, keepdims=True)
    return np.asarray(slopes - along * direction)
