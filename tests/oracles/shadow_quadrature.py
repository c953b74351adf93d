"""Shadows of black bodies by Kirchhoff's integral over their surfaces. Lengths in wavelengths.

The incident field acts on the surface parts that the source illuminates, and nothing acts behind
them. Let m be the normal that points away from the source, and G = exp(ikR)/R. An illuminated
region removes the field K:

    K(P) = 1/(4 pi) integral (U dG/dm - G dU/dm) dA,    U(P) = U_inc(P) - sum of K over all regions.

A surface element is therefore a monopole and a dipole, and its field can illuminate a second body
(sequential Kirchhoff method). Regions are clipped as polygons, triangle against triangle, without
silhouettes and line integrals.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import shapely

import polywigner as pw
from oracles.quadrature import graded, graded_in_plane, triangle_nodes, triangles_of

K = 2.0 * math.pi
Floats = np.ndarray
# Number of pairs of a radiator and a point per block.
_PAIRS = 1 << 19
# Relative area below which a visible region is a rounding error.
_SLIVER = 1e-12


@dataclass(frozen=True)
class Radiators:
    """Monopoles a and dipoles d at positions: U(P) = sum a G + d.grad_P G, G = exp(ikR)/R."""

    positions: Floats
    """(m, 3)."""
    monopoles: Floats
    """(m,) complex."""
    dipoles: Floats
    """(m, 3) complex."""

    def __add__(self, other: Radiators) -> Radiators:
        return Radiators(
            np.concatenate([self.positions, other.positions]),
            np.concatenate([self.monopoles, other.monopoles]),
            np.concatenate([self.dipoles, other.dipoles]),
        )

    def __neg__(self) -> Radiators:
        return Radiators(self.positions, -self.monopoles, -self.dipoles)

    def field(self, points: Any, with_gradient: bool = False) -> Any:
        """Return U at points (n, 3), and its gradient (n, 3) if requested."""
        points = np.asarray(points, float)
        values = np.zeros(len(points), complex)
        gradients = np.zeros((len(points), 3), complex)
        step = max(1, _PAIRS // max(1, len(self.positions)))
        for low in range(0, len(points), step):
            some = slice(low, low + step)
            away = points[some, None] - self.positions
            distance = np.sqrt(np.einsum("pmk,pmk->pm", away, away))
            inverse = 1.0 / distance
            # The wave is G. With first = G'/R, the gradient of G is first (P - Q).
            wave = np.exp(1j * K * distance) * inverse
            first = wave * (1j * K - inverse) * inverse
            along = np.einsum("pmk,mk->pm", away, self.dipoles)
            values[some] = wave @ self.monopoles + (first * along).sum(axis=1)
            if with_gradient:
                # The factor of the second derivatives is (G'' - G'/R)/R^2.
                second = wave * (3.0 * inverse**2 - 3j * K * inverse - K * K) * inverse**2
                radial = first * self.monopoles + second * along
                gradients[some] = np.einsum("pm,pmk->pk", radial, away) + first @ self.dipoles
        return (values, gradients) if with_gradient else values


def point_radiator(position: Any, amplitude: complex = 1.0) -> Radiators:
    """Return a point source, ``amplitude`` exp(ikR)/R."""
    place = np.asarray(position, float).reshape(1, 3)
    return Radiators(place, np.array([complex(amplitude)]), np.zeros((1, 3), complex))


def aperture_radiators(
    outline: pw.Aperture,
    condition: str,
    order: int = 8,
    longest: float = 1.0,
    field: Callable[[Floats], Floats] | None = None,
) -> Radiators:
    """Return Huygens sources of an aperture in the plane z = 0 with phases from ``field``.

    The field of a surface element is -(1/2 pi) u dG/dz for RS-I, (1/i lambda) u G for RS-II at
    normal incidence, and the mean of both for Kirchhoff.
    """
    nodes, weights = triangle_nodes(graded_in_plane(outline, (), 0.58 * longest), order)
    u = weights * (1.0 if field is None else field(nodes))
    share = {"rayleigh-sommerfeld-1": 1.0, "rayleigh-sommerfeld-2": 0.0, "kirchhoff": 0.5}[
        condition
    ]
    dipoles = np.zeros((len(u), 3), complex)
    dipoles[:, 2] = -share * u / (2.0 * math.pi)
    return Radiators(
        np.column_stack([nodes, np.zeros(len(nodes))]), (1.0 - share) * u / 1j, dipoles
    )


@dataclass(frozen=True)
class Surface:
    """Triangles of a body or of a plate."""

    triangles: Floats
    """(t, 3, 3)."""
    normals: Floats
    """(t, 3), unit vectors; outwards on a body."""
    is_solid: bool


def surface_of(body: Any, wavelength: float = 1.0) -> Surface:
    """Return the triangles of a Polyhedron or of a placed aperture."""
    if isinstance(body, pw.Polyhedron):
        parts = [_triangulated(body.vertices[list(face)] / wavelength) for face in body.faces]
        triangles = np.concatenate(parts)
        normals = np.concatenate(
            [
                np.tile(_area_vector(body.vertices[list(face)]), (len(part), 1))
                for face, part in zip(body.faces, parts, strict=True)
            ]
        )
        return Surface(triangles, _units(normals), True)
    triangles = (
        triangles_of(body.aperture.polygons) @ body.pose[:3, :2].T + body.pose[:3, 3]
    ) / wavelength
    return Surface(triangles, np.tile(body.pose[:3, 2], (len(triangles), 1)), False)


def _area_vector(corners: Floats) -> Floats:
    around = corners - corners[0]
    return np.cross(around, np.roll(around, -1, axis=0)).sum(axis=0)


def _units(vectors: Floats) -> Floats:
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def _triangulated(corners: Floats) -> Floats:
    normal = _units(_area_vector(corners))
    across = _units(corners[1] - corners[0])
    frame = np.stack([across, np.cross(normal, across)])
    flat = (corners - corners[0]) @ frame.T
    return corners[0] + triangles_of(shapely.Polygon(flat)) @ frame


def lit_regions(surfaces: Sequence[Surface], source: Any) -> tuple[Floats, Floats]:
    """Return triangles (t, 3, 3) visible from a point, and their normals (t, 3) away from it.

    Faces of bodies are visible from one side, and plates from both sides.
    """
    source = np.asarray(source, float)
    everything = np.concatenate([surface.triangles for surface in surfaces]) - source
    regions, normals = [], []
    for surface in surfaces:
        for corners, normal in zip(surface.triangles - source, surface.normals, strict=True):
            height = normal @ corners[0]
            size = np.linalg.norm(corners - corners[0], axis=1).max()
            if abs(height) <= 1e-12 * size or (surface.is_solid and height > 0.0):
                continue
            forward = math.copysign(1.0, height) * normal
            for piece in _visible(corners, forward, everything):
                regions.append(piece + source)
                normals.append(forward)
    if not regions:
        return np.empty((0, 3, 3)), np.empty((0, 3))
    return np.array(regions), np.array(normals)


def _visible(corners: Floats, forward: Floats, others: Floats) -> Floats:
    """Return the parts (t, 3, 3) of a triangle that no other triangle hides from the origin."""
    depth = forward @ corners[0]
    middle = corners.mean(axis=0)
    sides = _units(np.cross(corners, np.roll(corners, -1, axis=0)))
    sides *= np.sign(sides @ middle)[:, None]
    e1 = _units(corners[1] - corners[0])
    frame = np.stack([e1, np.cross(forward, e1)])
    size = np.linalg.norm(corners - corners[0], axis=1).max()
    blocked = []
    # The other triangle intersects the pyramid from the origin to this triangle.
    near = (others @ forward < depth - 1e-9 * size).any(axis=1)
    near &= ((others @ sides.T) > 1e-12 * size).any(axis=1).all(axis=1)
    for other in others[near]:
        shape = _clipped(other, -forward, -depth + 1e-12 * size)
        for side in sides:
            shape = _clipped(shape, side, 0.0)
        shape = shape[shape @ forward > 1e-12 * size]
        if len(shape) >= 3:
            seen = shape * (depth / (shape @ forward))[:, None]
            blocked.append(shapely.Polygon((seen - corners[0]) @ frame.T / size).buffer(0.0))
    whole = shapely.Polygon((corners - corners[0]) @ frame.T / size)
    rest = shapely.difference(whole, shapely.union_all(blocked)) if blocked else whole
    parts = [p for p in shapely.get_parts(rest) if p.area > _SLIVER]
    if not parts:
        return np.empty((0, 3, 3))
    return corners[0] + size * triangles_of(parts) @ frame


def _clipped(shape: Floats, normal: Floats, least: float) -> Floats:
    """Return the part of a polygon (n, 3) with normal.x >= least."""
    if not len(shape):
        return shape
    height = shape @ normal - least
    corners = []
    for k in range(len(shape)):
        a, b = height[k - 1], height[k]
        if (a >= 0.0) != (b >= 0.0):
            corners.append(shape[k - 1] + a / (a - b) * (shape[k] - shape[k - 1]))
        if b >= 0.0:
            corners.append(shape[k])
    return np.array(corners).reshape(-1, 3)


def _space_nodes(triangles: Floats, order: int) -> tuple[Floats, Floats]:
    """Return nodes (t, n, 3) and weights (t, n) on triangles in space."""
    unit, share = triangle_nodes(np.array([[[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]]), order)
    a, b, c = (triangles[:, k, None] for k in range(3))
    nodes = a + unit[:, :1] * (b - a) + unit[:, 1:] * (c - a)
    twice = np.linalg.norm(np.cross((b - a)[:, 0], (c - a)[:, 0]), axis=1)
    return nodes, twice[:, None] * share


def taken_by(
    regions: Floats, normals: Floats, incident: Radiators, near: Any, order: int, longest: float
) -> Radiators:
    """Return the radiators whose field regions (t, 3, 3) remove from the incident field.

    Triangles become smaller towards the points ``near`` (n, 3).
    """
    triangles, origin = graded(regions, near, 0.58 * longest)
    nodes, weights = _space_nodes(triangles, order)
    places = nodes.reshape(-1, 3)
    m = np.repeat(normals[origin], nodes.shape[1], axis=0)
    value, gradient = incident.field(places, with_gradient=True)
    share = weights.ravel() / (4.0 * math.pi)
    return Radiators(
        places,
        -share * np.einsum("nk,nk->n", gradient, m),
        -(share * value)[:, None] * m,
    )


def shadowed_field(
    bodies: Sequence[Any],
    source: Radiators,
    points: Any,
    order: int = 12,
    longest: float = 1.0,
    share_regions: bool = False,
) -> Floats:
    """Return U at points (n, 3) behind bodies: U_inc minus Kirchhoff's integrals over visible
    regions.

    With ``share_regions``, all radiators of the source use the regions of the first one, which is
    exact for a plate and for bodies of which all radiators see the same faces.
    """
    points = np.reshape(points, (-1, 3)).astype(float)
    surfaces = [body if isinstance(body, Surface) else surface_of(body) for body in bodies]
    total = source.field(points)
    count = len(source.positions)
    for first in range(0, count, count if share_regions else 1):
        some = slice(first, count if share_regions else first + 1)
        part = Radiators(source.positions[some], source.monopoles[some], source.dipoles[some])
        near = np.concatenate([points, source.positions[first : first + 1]])
        regions = lit_regions(surfaces, source.positions[first])
        total -= taken_by(*regions, part, near, order, longest).field(points)
    return total


def sequential_field(
    bodies: Sequence[Any],
    source: Radiators,
    points: Any,
    order: int = 8,
    longest: float = 1.0,
) -> Floats:
    """Return U at points behind bodies, in the order in which the field reaches them.

    The visible side of each body removes the field that earlier bodies have left. ``source`` is a
    single point.
    """
    points = np.reshape(points, (-1, 3)).astype(float)
    surfaces = [body if isinstance(body, Surface) else surface_of(body) for body in bodies]
    (position,) = source.positions
    left = source
    for surface in surfaces:
        near = np.concatenate([points, [position]])
        left = left + -taken_by(*lit_regions([surface], position), left, near, order, longest)
    return left.field(points)


def expected_ratio(source: Any, points: Any, bodies: Any) -> Any:
    """Return the field behind bodies over the free field of a point source; wavelength 1."""
    radiator, points = point_radiator(source), np.array(points, float)
    return shadowed_field(bodies, radiator, points, order=8) / radiator.field(points)
