"""The warning of bodies whose faces light each other, so that later reflections matter."""

from __future__ import annotations

import math
from functools import lru_cache
from itertools import product
from typing import NamedTuple

import numpy as np
import shapely
from numpy.typing import NDArray

from polywigner.geometry.arguments import warn_caller
from polywigner.scattering.facets import SMOOTH, Facets

Floats = NDArray[np.float64]
Indices = NDArray[np.intp]

# Distance that counts as none, as a fraction of the body's size: STL files round vertices to 1e-7.
# Beams of less than the same fraction of its square are neglected.
_SMALL = 1e-6
# Triangles that are compared each with each, half of them the largest ones; comparisons at a time.
_MOST_TRIANGLES, _BLOCK = 1500, 1 << 18
# Directions that are looked at, and pairs of triangles for each: a second or two in all.
_MOST_DIRECTIONS, _MOST_BEAMS = 256, 4096
# Rays at a time whose obstacles are looked for.
_RAYS = 64
# Points of a beam: the middle of its cross section, and points near its corners.
_NEAR_CORNER = 0.9


def warn_of_reflections(facets: Facets, travelling: Floats) -> None:
    """Warn if waves that travel along k (m, 3) go from one face of a body to another one."""
    if lights_itself(facets, travelling):
        warn_caller(
            "faces of the body light each other: what comes back by two or three reflections is "
            "left out, which is most of it in corner reflectors; pass bounces=3 (docs/rcs.md)"
        )


def lights_itself(facets: Facets, travelling: Floats) -> bool:
    """Whether a wave that travels along one of k (m, 3) goes from one face to another.

    Faces that join smoothly, or whose planes are parallel within 30 degrees, do not count: they
    are curved, or send waves on rather than back. At most 256 directions are looked at.
    """
    if not facets.casts_shadows or not len(travelling):
        return False
    pairs = _facing_pairs(facets)
    if not len(pairs.one):
        return False
    directions = np.unique(travelling, axis=0)
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    step = math.ceil(len(directions) / _MOST_DIRECTIONS)
    return any(_lights(facets, pairs, k) for k in directions[::step])


class _Pairs(NamedTuple):
    """Sides of triangles (n,) in front of each other's planes."""

    one: Indices
    other: Indices
    normal: Floats
    """(n, 3) of the one, on its side."""
    other_normal: Floats
    """(n, 3)"""

    def taken(self, rows: Indices) -> _Pairs:
        vectors = self.normal[rows], self.other_normal[rows]
        return _Pairs(self.one[rows], self.other[rows], *vectors)


@lru_cache(maxsize=16)
def _facing_pairs(facets: Facets) -> _Pairs:
    """Pairs of triangles of different surfaces that see each other if nothing is in between."""
    rows, small = _representatives(facets), _SMALL * facets.size
    normal, surface, is_plate = facets.normal[rows], facets.surface[rows], facets.is_plate[rows]
    corners = facets.corners[rows]
    level = (normal * corners[:, 0]).sum(axis=1)
    columns: list[list[Indices]] = []
    for start in range(0, len(rows), max(1, _BLOCK // len(rows))):
        some = slice(start, start + max(1, _BLOCK // len(rows)))
        bent = np.abs(normal[some] @ normal.T) < SMOOTH
        bent &= surface[some, None] != surface
        # heights of the others over the planes of some, and of some over the planes of the others
        heights = np.einsum("ik,jck->ijc", normal[some], corners) - level[some, None, None]
        back = np.einsum("jk,ick->ijc", normal, corners[some]) - level[None, :, None]
        for one, other in product((1, -1), repeat=2):
            faces = bent & ((one * heights).max(axis=2) > small)
            faces &= (other * back).max(axis=2) > small
            faces &= (is_plate[some, None] if one < 0 else True) & (is_plate if other < 0 else True)
            first, second = np.nonzero(faces)
            sides = np.full(len(first), one), np.full(len(first), other)
            columns.append([first + start, second, *sides])
    first, second, one_side, other_side = (
        np.concatenate(column) for column in zip(*columns, strict=True)
    )
    normals = one_side[:, None] * normal[first], other_side[:, None] * normal[second]
    return _Pairs(rows[first], rows[second], *normals)


def _representatives(facets: Facets) -> Indices:
    """Numbers of triangles: all, or the largest ones and some of the others."""
    order = np.argsort(-np.linalg.norm(facets.vector, axis=1), kind="stable")
    if len(order) <= _MOST_TRIANGLES:
        return order
    half = _MOST_TRIANGLES // 2
    return np.concatenate([order[:half], order[half :: math.ceil(len(order) / half)]])


def _lights(facets: Facets, pairs: _Pairs, k: Floats) -> bool:
    """Whether a wave along k (3,) goes from the one triangle to the other of one of the pairs."""
    onto = pairs.normal @ k
    after = pairs.other_normal @ k - 2 * onto * (pairs.normal * pairs.other_normal).sum(axis=1)
    (rows,) = np.nonzero((onto < -_SMALL) & (after < -_SMALL))
    some = pairs.taken(rows[:: math.ceil(max(1, len(rows)) / _MOST_BEAMS)])
    places, ways, lengths = _beams(facets, some, k)
    for start in range(0, len(places), _RAYS):
        few = slice(start, start + _RAYS)
        free = ~_blocked(facets, places[few], np.broadcast_to(-k, places[few].shape), np.inf)
        free[free] = ~_blocked(facets, places[few][free], ways[few][free], lengths[few][free])
        if free.any():
            return True
    return False


def _beams(facets: Facets, pairs: _Pairs, k: Floats) -> tuple[Floats, Floats, Floats]:
    """Points (m, 3) whose reflected rays meet the other triangle, the rays and their lengths."""
    ways = k - 2 * (pairs.normal @ k)[:, None] * pairs.normal
    across = np.cross(ways, np.eye(3)[np.abs(ways).argmin(axis=1)])
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    axes = np.stack([across, np.cross(ways, across), ways], axis=2)
    both = [facets.corners[rows] @ axes for rows in (pairs.one, pairs.other)]
    low = np.maximum(*(part[..., :2].min(axis=1) for part in both))
    high = np.minimum(*(part[..., :2].max(axis=1) for part in both))
    (near,) = np.nonzero((low < high).all(axis=1))
    flat = [np.asarray(shapely.polygons(part[near, :, :2])) for part in both]
    shared = shapely.intersection(*flat)
    wide = shapely.area(shared) > _SMALL * facets.size**2
    shared, near = shared[wide], near[wide]
    middle = shapely.get_coordinates(shapely.centroid(shared))
    corners, owner = shapely.get_coordinates(shared, return_index=True)
    points = np.concatenate([middle, middle[owner] + _NEAR_CORNER * (corners - middle[owner])])
    rows = near[np.concatenate([np.arange(len(near)), owner])]
    depths = [_depths(part[rows], points) for part in both]
    lengths = depths[1] - depths[0]
    ahead = lengths > _SMALL * facets.size
    rows, lengths = rows[ahead], lengths[ahead]
    there = np.column_stack([points[ahead], depths[0][ahead]])
    return (axes[rows] @ there[:, :, None])[..., 0], ways[rows], lengths


def _depths(triangles: Floats, points: Floats) -> Floats:
    """Third coordinates (n,) of the planes of triangles (n, 3, 3) at points (n, 2)."""
    first, second = triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    normal = np.cross(first, second)
    beyond = ((points - triangles[:, 0, :2]) * normal[:, :2]).sum(axis=1)
    return np.asarray(triangles[:, 0, 2] - beyond / normal[:, 2])


def _blocked(
    facets: Facets, start: Floats, along: Floats, lengths: Floats | float
) -> NDArray[np.bool_]:
    """Whether rays (n, 3) of some lengths (n,) meet a triangle beyond where they start."""
    small = _SMALL * facets.size
    with np.errstate(divide="ignore", invalid="ignore"):
        slope = along @ facets.normal.T
        height = (facets.normal * facets.corner).sum(axis=1) - start @ facets.normal.T
        distance = height / slope
        meets = (distance > small) & (distance < np.reshape(lengths, (-1, 1)) - small)
        ray, facet = np.nonzero(meets)
        place = start[ray] + distance[ray, facet][:, None] * along[ray]
    corners = facets.corners[facet]
    sides = np.roll(corners, -1, axis=1) - corners
    inside = np.cross(sides, place[:, None] - corners) @ facets.normal[facet][:, :, None]
    blocked = np.zeros(len(start), np.bool_)
    blocked[ray[(inside[..., 0] > 0).all(axis=1)]] = True
    return blocked
