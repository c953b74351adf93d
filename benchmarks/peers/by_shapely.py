"""W and the OTF with shapely and NumPy: clipped polygons and sums over edges."""

from __future__ import annotations

from typing import Any

import numpy as np
import shapely

__all__ = ["otf", "otf_one_by_one", "polygons_of", "wigner", "wigner_one_by_one"]


def polygons_of(rings: Any) -> Any:
    """Return a (multi)polygon of rings without holes."""
    parts = [shapely.Polygon(ring) for ring in rings]
    return parts[0] if len(parts) == 1 else shapely.MultiPolygon(parts)


def wigner_one_by_one(polygons: Any, x: np.ndarray, nu: np.ndarray) -> np.ndarray:
    """Return W sample by sample, as in a renderer or an integrator."""
    return np.array([_wigner_at(polygons, p, q) for p, q in zip(x, nu, strict=True)])


def _wigner_at(polygons: Any, x: np.ndarray, nu: np.ndarray) -> float:
    forward = shapely.transform(polygons, lambda c: 2 * (c - x))
    mirrored = shapely.transform(polygons, lambda c: 2 * (x - c))
    total = 0.0
    for piece in shapely.get_parts(shapely.intersection(forward, mirrored)):
        if piece.geom_type != "Polygon":
            continue  # contact in a point or a line has no area
        for ring in shapely.get_rings(shapely.orient_polygons(piece)):
            corner = shapely.get_coordinates(ring)
            edge, middle = np.diff(corner, axis=0), (corner[1:] + corner[:-1]) / 2
            along = nu[0] * edge[:, 1] - nu[1] * edge[:, 0]
            total += float((along * np.sinc(edge @ nu)) @ np.sin(2 * np.pi * middle @ nu))
    return total / (2 * np.pi * float(nu @ nu))


def wigner(polygons: Any, x: np.ndarray, nu: np.ndarray) -> np.ndarray:
    """Return W of all samples at once."""
    parts = shapely.get_parts(polygons)
    coordinates, index = shapely.get_coordinates(parts, return_index=True)
    sizes = np.bincount(index)
    forward = 2 * (coordinates - x[:, None])
    copies = []
    for points_of_copy in (forward, -forward):
        pieces = np.split(points_of_copy, np.cumsum(sizes)[:-1], axis=1)
        polygon = np.stack([shapely.polygons(p) for p in pieces], axis=1)
        copies.append(shapely.multipolygons(polygon) if len(sizes) > 1 else polygon[:, 0])
    pieces, which = shapely.get_parts(shapely.intersection(*copies), return_index=True)
    keep = shapely.get_type_id(pieces) == 3
    pieces, which = shapely.orient_polygons(pieces[keep]), which[keep]
    rings, piece = shapely.get_rings(pieces, return_index=True)
    return _edge_sum(rings, which[piece], nu, len(x))


def _edge_sum(rings: np.ndarray, which: np.ndarray, nu: np.ndarray, count: int) -> np.ndarray:
    """Return sums over oriented rings; ring k belongs to sample which[k]."""
    corner, ring = shapely.get_coordinates(rings, return_index=True)
    same = ring[1:] == ring[:-1]
    start, end, sample = corner[:-1][same], corner[1:][same], which[ring[:-1][same]]
    edge, middle, nu = end - start, (start + end) / 2, nu[sample]
    along = nu[:, 0] * edge[:, 1] - nu[:, 1] * edge[:, 0]
    across = (nu * edge).sum(axis=1)
    phase = 2 * np.pi * (nu * middle).sum(axis=1)
    term = along * np.sinc(across) * np.sin(phase) / (2 * np.pi * (nu**2).sum(axis=1))
    return np.bincount(sample, weights=term, minlength=count)


def otf_one_by_one(polygons: Any, xi: np.ndarray) -> np.ndarray:
    """Return the overlap of two shifted pupils over their area, lag by lag."""
    overlaps = [
        shapely.intersection(polygons, shapely.transform(polygons, lambda c, at=at: c + at))
        for at in xi
    ]
    return np.array([overlap.area for overlap in overlaps]) / shapely.area(polygons)


def otf(polygons: Any, xi: np.ndarray) -> np.ndarray:
    """Return the overlaps of all lags at once."""
    coordinates, index = shapely.get_coordinates(shapely.get_parts(polygons), return_index=True)
    moved = coordinates + xi[:, None]
    parts = np.split(moved, np.cumsum(np.bincount(index))[:-1], axis=1)
    shifted = shapely.multipolygons(np.stack([shapely.polygons(part) for part in parts], axis=1))
    shapely.prepare(polygons)
    return shapely.area(shapely.intersection(polygons, shifted)) / shapely.area(polygons)
