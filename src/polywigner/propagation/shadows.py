"""Shadows that diffract: the field of a source behind opaque bodies and plates. Source: (SB1).

The source is a grid of points that radiate (B8). Behind bodies the wave of each point is the free
one times a ratio, an integral along the silhouette that this point sees (Maggi and Rubinowicz),
whose integrand (B9) stays smooth across the boundary of the shadow. One wave passes one edge:
waves over two edges, and waves that creep around a body, are left out.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polywigner import execution
from polywigner.errors import ArgumentError, PolywignerWarning
from polywigner.geometry.arguments import checked_number
from polywigner.geometry.silhouettes import Obstacles, Silhouette
from polywigner.illumination.obliquities import CONDITIONS
from polywigner.kernels.boundary.edge_waves import silhouette_edge
from polywigner.propagation.equivalent import equivalent_grid
from polywigner.propagation.panels import radiator_of
from polywigner.propagation.screens import PointSource
from polywigner.transforms.wavefronts import flat_of

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]

DEFAULT_TOLERANCE = 1e-6
"""Relative error of fields behind obstacles: far below the error of black edges, one at a time."""
LEAST_TOLERANCE = 1e-8
"""The smallest tolerance of fields behind obstacles."""

# Nodes of a panel: 3 and so many for each digit. Measured before plates and boxes: 6 nodes 1e-5,
# 8 nodes 5e-8, 10 nodes 1.3e-10, 12 nodes 2e-13 (the error estimate takes three nodes fewer).
_NODES_PER_DIGIT, _MORE_NODES, _FEWER = 0.8, 3, 3
# Most turns of the detour along a panel, and its length over its distance from points and source.
_TURNS, _LONGEST = 1.0, 3.0
# Panels end at this length, in wavelengths: nearer a point, an edge's share is lost in rounding.
_SHORTEST = 1e-7
# How far beside a point angles are taken, as a share of its distance: beyond rounding.
_ASIDE = 1e-8
# Panels that points may share, beyond which they are too near for it.
_PANELS_A_WAVELENGTH, _PANELS_AN_EDGE = 8.0, 64
# Points in a block, which share panels.
_POINTS = 1 << 12
# Most points that stand for a source: a quarter of an hour for 1,000 points behind a box.
_MOST_SOURCES = 1 << 14
# Nearer to the source than this, in wavelengths, its waves that fade are not left out unseen.
_NEAR = 1.0


def checked_shadow_tolerance(tolerance: float | None) -> float:
    """A tolerance that fields behind obstacles keep; ArgumentError for others."""
    if tolerance is None:
        return DEFAULT_TOLERANCE
    meaning = f"a number from {LEAST_TOLERANCE:g} to 0.1 with obstacles"
    number = checked_number(tolerance, "tolerance", meaning)
    if not LEAST_TOLERANCE <= number <= 0.1:
        raise ArgumentError(f"expected tolerance as {meaning}, got {tolerance!r}")
    return number


def shadow_of(
    source: Any,
    obstacles: Any,
    points: Floats,
    wavelength: float,
    method: str,
    tolerance: float,
    engine: str,
    with_error: bool = False,
) -> tuple[Complex, NDArray[np.bool_], Floats]:
    """Return the change that obstacles make to the field at points (n, 3), in m, of a source.

    Also whether a point is in a body, where the field is zero, and the estimated error (n,); zeros
    unless ``with_error``. ``source``: whatever :func:`equivalent_grid` takes, or a PointSource.

    Raises ArgumentError for obstacles of the wrong kind, ones around the source, and sources that
    take too many points.
    """
    bodies = Obstacles(obstacles, wavelength)
    places = points / wavelength
    sources = _radiating(source, wavelength, method, tolerance)
    _check_clearance(bodies, sources)
    nodes = _MORE_NODES + math.ceil(-_NODES_PER_DIGIT * math.log10(tolerance))
    total, off = np.zeros(len(points), np.complex128), np.zeros(len(points))
    for place, field, slope in sources:
        ahead = places - place
        distance = np.linalg.norm(ahead, axis=1)
        turns = distance - np.round(distance)
        wave = np.exp(2j * math.pi * turns) / (1j * distance)
        if field:
            near = 1.0 + 0.5j / (math.pi * distance)
            wave *= field * (ahead[:, 2] / distance) * near + slope
        else:
            wave *= slope
        ratio = ratios(bodies, place, places, engine, nodes)
        total += wave * (ratio - 1.0)
        if with_error:
            fewer = ratios(bodies, place, places, engine, nodes - _FEWER)
            off += np.abs(wave * (ratio - fewer))
    return total, bodies.inside(places), off


def _radiating(
    source: Any, wavelength: float, method: str, tolerance: float
) -> list[tuple[Floats, complex, complex]]:
    """Points that radiate: their place in wavelengths, and weights of field and slope."""
    if isinstance(source, PointSource):
        # exp(ikR)/R is i/wavelength times exp(ikR)/(i R/wavelength)
        return [(np.array(source.position) / wavelength, 0j, 1j * source.amplitude / wavelength)]
    radiator = radiator_of(flat_of(source))
    condition = CONDITIONS[method]
    found = equivalent_grid(
        source, radiator, wavelength, condition, 0.1 * tolerance,
        lambda counts: math.prod(counts) <= _MOST_SOURCES,
    )  # fmt: skip
    if found is None:
        raise ArgumentError(
            f"expected a source that up to {_MOST_SOURCES} points stand for with obstacles, got "
            f"sides of {np.round((radiator.high - radiator.low) / wavelength, 1).tolist()} "
            "wavelengths; pass a larger tolerance, or a part of the source"
        )
    x, y = (h * n for h, n in zip(found.half, found.nodes, strict=True))
    middle = radiator.centre / wavelength
    none = np.zeros_like(found.weights[0])
    field = found.weights[0] if condition.field else none
    slope = found.weights[-1] if len(found.weights) > bool(condition.field) else none
    return [
        (np.array([a + middle[0], b + middle[1], 0.0]), complex(field[i, j]), complex(slope[i, j]))
        for i, a in enumerate(x)
        for j, b in enumerate(y)
    ]


def _check_clearance(bodies: Obstacles, sources: Sequence[tuple[Floats, complex, complex]]) -> None:
    places = np.array([place for place, _, _ in sources])
    if bodies.inside(places).any():
        raise ArgumentError("expected obstacles away from the source, got a body around it")
    nearest = min(float(body.distance(places).min()) for body in bodies.bodies)
    if nearest < _NEAR and len(sources) > 1:
        warnings.warn(
            f"an obstacle is {nearest:.2g} wavelengths from the source: waves that fade within a "
            "wavelength are left out of its shadow",
            PolywignerWarning,
            stacklevel=5,
        )


def ratios(bodies: Obstacles, source: Floats, points: Floats, engine: str, nodes: int) -> Complex:
    """Field at points (n, 3) over the free one, of a point source (3,). Lengths in wavelengths."""
    seen = bodies.silhouette(source)
    found = np.ones(len(points), np.complex128)
    reach = bodies.reach(source)
    distance = np.linalg.norm(points - source, axis=1)
    closed = (distance > reach) & seen.counts_everywhere
    for mine, panels in _blocks(seen, source, points, np.flatnonzero(closed)):
        found[mine] += _sums(panels, source, points[mine], None, nodes, engine)
    # where bodies are behind a point as well, it is asked whether it sees the source; both this
    # and the angles are those of a place so close beside it that no edge is met exactly
    aside = points + _ASIDE * distance[:, None] * np.array([0.57, 0.31, 0.76])
    found[~closed] = ~bodies.hide(source, aside[~closed])
    for mine, panels in _blocks(seen, source, points, np.flatnonzero(~closed)):
        found[mine] += _sums(panels, source, points[mine], aside[mine], nodes, engine)
    return found


def _blocks(
    seen: Silhouette, source: Floats, points: Floats, numbers: NDArray[np.intp]
) -> Iterator[tuple[NDArray[np.intp], Silhouette]]:
    """Numbers of points that are near each other, and the silhouette in panels for all of them.

    Blocks are halved along their longest side until they are small beside their distance.
    """
    around = float(np.linalg.norm(seen.edges[:, 1] - seen.edges[:, 0], axis=1).sum())
    enough = int(_PANELS_A_WAVELENGTH * around) + _PANELS_AN_EDGE * len(seen.edges)
    todo = [numbers] if len(numbers) else []
    while todo:
        mine = todo.pop()
        if len(mine) <= _POINTS:
            panels = panels_of(seen, source, points[mine], enough if len(mine) > 1 else None)
            if panels is not None:
                yield mine, panels
                continue
        along = int(np.ptp(points[mine], axis=0).argmax())
        order = mine[np.argsort(points[mine, along], kind="stable")]
        todo += [order[: len(order) // 2], order[len(order) // 2 :]]


def panels_of(
    seen: Silhouette, source: Floats, points: Floats, most: int | None
) -> Silhouette | None:
    """Cut edges into panels that a rule sums for all points; None for more than ``most``."""
    edges, planes = seen.edges, seen.planes
    low, high = points.min(axis=0), points.max(axis=0)
    done, count = [(edges[:0], planes[:0])], 0
    while len(edges):
        middle, half = edges.mean(axis=1), 0.5 * (edges[:, 1] - edges[:, 0])
        length = 2.0 * np.linalg.norm(half, axis=1)
        distance = np.linalg.norm(middle - np.clip(middle, low, high), axis=1)
        from_source = np.linalg.norm(middle - source, axis=1)
        good = length <= _TURNS / 2.0
        slopes = _steepest(middle, half / (0.5 * length)[:, None], source, low, high)
        good |= length * slopes <= _TURNS
        good &= length <= _LONGEST * np.minimum(distance, from_source)
        good |= length <= _SHORTEST
        done.append((edges[good], planes[good]))
        count += len(edges) + int((~good).sum())
        if most is not None and count > most:
            return None
        planes = np.concatenate([planes[~good], planes[~good]])
        bad, centre = edges[~good], middle[~good][:, None]
        edges = np.concatenate(
            [np.stack([bad[:, 0], centre[:, 0]], 1), np.stack([centre[:, 0], bad[:, 1]], 1)]
        )
    first, second = zip(*done, strict=True)
    return Silhouette(np.concatenate(first), np.concatenate(second))


def _steepest(middle: Floats, along: Floats, source: Floats, low: Floats, high: Floats) -> Floats:
    """Bound on the slope of the detour along panels, (k,), for points in a box."""
    q = middle - source
    own = np.einsum("kc,kc->k", q, along) / np.linalg.norm(q, axis=1)
    corners = np.array([[(low, high)[(n >> c) & 1][c] for c in range(3)] for n in range(8)])
    r = corners[None] - middle[:, None]
    size = np.maximum(np.linalg.norm(r, axis=2), 1e-300)
    other = np.einsum("knc,kc->kn", r, along) / size
    inside = ((middle > low) & (middle < high)).all(axis=1)
    steepest = np.maximum(np.abs(own[:, None] - other).max(axis=1), 0.05)
    return np.where(inside, 2.0, steepest)


def _sums(
    seen: Silhouette, source: Floats, points: Floats, aside: Floats | None, nodes: int, engine: str
) -> Complex:
    """The integral along panels of a silhouette over 2 pi, (n,)."""
    panels, planes = seen.edges, seen.planes
    if not len(panels):
        return np.zeros(len(points), np.complex128)
    places, weights = np.polynomial.legendre.leggauss(nodes)
    middle, half = panels.mean(axis=1), 0.5 * (panels[:, 1] - panels[:, 0])
    columns = [
        middle[:, None] + half[:, None] * places[:, None],
        half[:, None] * weights[:, None],
    ]
    if aside is not None:
        counts = np.zeros((len(panels), nodes, 1))
        counts[:, 0] = 1.0  # the angle of a panel once: at its first node
        shared = np.concatenate([middle, panels[:, 0], panels[:, 1]], axis=1)
        columns += [np.repeat(part[:, None], nodes, axis=1) for part in (shared, planes)]
        columns.insert(3, counts)
    table = np.concatenate(columns, axis=2).reshape(len(panels) * nodes, -1)
    samples = points if aside is None else np.column_stack([points, aside])
    real, imag = execution.evaluate_rows(_row, table, samples, source, 2, engine)
    return np.asarray((real + 1j * imag) / (2.0 * math.pi))


def _row(ops: Any, row: tuple[Any, ...], sample: tuple[Any, ...], source: tuple[Any, ...]) -> Any:
    return silhouette_edge(ops, source, sample[:3], row, sample[3:] or None)
