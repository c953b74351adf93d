"""Exact visible lengths along scan lines, without polygons and set operations."""

from __future__ import annotations

import numpy as np


def visible_lengths(corners: np.ndarray, k: np.ndarray, angle: float, height: float) -> np.ndarray:
    """Return the visible lengths (n,) of triangles (n, 3, 3) for an observer who looks along k.

    The scan line has an angle and a height. Between neighbouring ends and crossings of triangles
    along the scan line, a single triangle is nearest to the observer.
    """
    first = np.cross(k, (0.3, 0.5, 0.8))
    first /= np.linalg.norm(first)
    second = np.cross(k, first)
    along = np.cos(angle) * first + np.sin(angle) * second
    across = np.cos(angle) * second - np.sin(angle) * first
    x, y, z = corners @ along, corners @ across - height, corners @ k
    lengths = np.zeros(len(corners))
    low, high = np.full(len(x), np.inf), np.full(len(x), -np.inf)
    ends = np.zeros((2, len(x)))
    for a, b in ((0, 1), (1, 2), (2, 0)):
        crosses = (y[:, a] > 0) != (y[:, b] > 0)
        t = y[:, a] / np.where(crosses, y[:, a] - y[:, b], 1.0)
        place, depth = x[:, a] + t * (x[:, b] - x[:, a]), z[:, a] + t * (z[:, b] - z[:, a])
        lower, upper = crosses & (place < low), crosses & (place > high)
        low[lower], ends[0, lower] = place[lower], depth[lower]
        high[upper], ends[1, upper] = place[upper], depth[upper]
    (rows,) = np.nonzero(high - low > 1e-13)
    if not len(rows):
        return lengths
    low, high, ends = low[rows], high[rows], ends[:, rows]
    slope = (ends[1] - ends[0]) / (high - low)
    level = ends[0] - slope * low
    with np.errstate(divide="ignore", invalid="ignore"):
        crossings = (level - level[:, None]) / (slope[:, None] - slope)
    limits = np.concatenate([low, high, crossings[np.isfinite(crossings)]])
    limits = np.unique(limits[(limits >= low.min()) & (limits <= high.max())])
    middle = (limits[1:] + limits[:-1]) / 2
    depths = level[:, None] + slope[:, None] * middle
    depths[(middle < low[:, None]) | (middle > high[:, None])] = np.inf
    nearest = depths.argmin(axis=0)
    is_met = np.isfinite(depths.min(axis=0))
    np.add.at(lengths, rows[nearest[is_met]], np.diff(limits)[is_met])
    return lengths
