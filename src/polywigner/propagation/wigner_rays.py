"""Irradiance by Wigner rays: Gauss rules on the source, to a tolerance. Source: (R1), (T1)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray

from polywigner import execution
from polywigner.errors import ArgumentError
from polywigner.execution import Engine
from polywigner.geometry import Aperture, Wavefront
from polywigner.geometry.parts import grid_size, polygons_in
from polywigner.kernels import Kernel, kernel_for
from polywigner.kernels.functions.slices import SliceSum
from polywigner.kernels.kernel import Values
from polywigner.propagation.quadrature import (
    Rule,
    Triangles,
    gauss_rule,
    node_count,
    quartered,
    rule_by_triangles,
    spacings,
    triangulated,
)
from polywigner.source import Array
from polywigner.source.normal_form import normal_form
from polywigner.source.obliquities import DEFAULT, Forms
from polywigner.source.support import mutual_support

Floats = NDArray[np.float64]


@lru_cache(maxsize=64)
def _along_rays(base: Kernel) -> Kernel:
    """The integrand of (R1), from a kernel of W.

    Arguments: ``x, y`` on the source, X, Y and Z of the point, the wavelength, the coefficients of
    the forms of obliquity (D2), and of a curved wave Q_xx, Q_xy, Q_yy and its centre, whose
    frequency depends on the position.
    """

    def enter(ops: Any, frame: Any, x: Any, y: Any, *rest: Any) -> Values:
        point, wavelength, forms, curved = rest[:3], rest[3], Forms(*rest[4:7]), rest[7:]
        along_x, along_y = point[0] - x, point[1] - y
        square = along_x * along_x + along_y * along_y + point[2] * point[2]
        inverse = 1.0 / ops.sqrt(square)
        scale = inverse / wavelength
        nu: Values = (along_x * scale, along_y * scale)
        if curved:
            (xx, xy, yy), (dx, dy) = curved[:3], (x - curved[3], y - curved[4])
            nu = nu[0] - (xx * dx + xy * dy), nu[1] - (xy * dx + yy * dy)
        factor = forms.irradiance(point[2] * inverse) * scale * scale
        return (factor, *base.enter(ops, frame, x, y, *nu))

    base_sum = base.edge_sum

    def edge_sum(ops: Any, tables: Any, _: Any, *inner: Any) -> Values:
        return base_sum(ops, tables, *inner)

    def leave(ops: Any, frame: Any, inner: Values, sums: Values) -> Values:
        return (inner[0] * base.leave(ops, frame, inner[1:], sums)[0],)

    return replace(
        base,
        name=f"{base.name} along rays",
        enter=enter,
        edge_sum=base_sum.after(1) if isinstance(base_sum, SliceSum) else edge_sum,
        leave=leave,
    )


@dataclass(frozen=True)
class Rays:
    """A sum over rays: its sources, and its settings."""

    sources: Sequence[tuple[Aperture | Array, Forms]]
    """Sources and forms as of :meth:`polywigner.source.obliquities.Obliquity.terms`."""
    wavelength: float
    engine: Engine
    double: bool
    curved: tuple[float, ...] = ()
    """Q_xx, Q_xy, Q_yy and the centre of a curved wave on all sources; empty: flat."""
    coherence_width: float = math.inf
    """Coherence width in m."""

    def _kernel(self, source: Aperture | Array) -> tuple[Kernel, Any]:
        """The integrand, and the source with its coherence width as the integrand takes it."""
        light: Any = source
        if self.coherence_width < math.inf:
            light = Wavefront(source, coherence_width=self.coherence_width)
        return _along_rays(kernel_for("wigner", light)), light

    def irradiance(self, rule: Rule, points: Floats) -> Floats:
        """The sum over a rule's nodes at points (n, 3), (n,)."""
        total = np.zeros(len(points))
        for source, forms in self.sources:
            kernel, light = self._kernel(source)
            constants = (self.wavelength, *forms, *self.curved)
            total += execution.evaluate_sums(
                kernel, light, *rule, points, constants, double=self.double, engine=self.engine
            )
        return total

    def integrand(self, nodes: Floats, points: Floats) -> Floats:
        """Irradiance per area from each node (m, 2) at each point (n, 3), (n, m)."""
        total: Any = 0.0
        node, point = nodes.T[:, None, :], points.T[:, :, None]
        for source, forms in self.sources:
            constants = [np.array(value) for value in (self.wavelength, *forms, *self.curved)]
            (values,) = execution.evaluate(
                *self._kernel(source),
                [*node, *point, *constants],
                double=self.double,
                engine=self.engine,
                outputs=1,
            )
            total = total + values
        result: Floats = total
        return result


# Nodes along a side in addition to those for the phase, rule after rule. Two for the first: on
# cells far smaller than a wavelength W is a quadratic, which it integrates exactly.
_LEVELS = (2.0, 3.0, 4.0, 6.0, 8.0, 11.0, 15.0, 20.0, 28.0)
# Number of cells above which the sum with one node in each cell is tried first.
_MANY_CELLS = 500
# Pairs of a point and a cell whose distances are computed at a time.
_PAIRS_AT_ONCE = 1 << 20
# Most nodes of a rule, 64 MiB.
_MOST_NODES = 1 << 22
# Points whose phase rates agree within this fraction of 1/wavelength share their rules.
_RATE_STEP = 0.25
# Points whose error is smaller than this fraction of the allowed error are not computed again.
_SETTLED = 0.03
# Sources with too many kinks: most cells, and number of points by which cells are refined.
_MOST_CELLS, _PROBES = 1 << 14, 12
# Fraction of the total error in the cells that are divided in one step.
_FRACTION = 0.8


def summed_rays(
    source: Aperture | Array, rays: Rays, points: Floats, tolerance: float, floor: Floats
) -> tuple[Floats, Floats]:
    """Irradiance at points (n, 3), and estimates of its errors, (n,).

    The errors are ``tolerance`` times the irradiance, or times ``floor`` (n,) if larger, unless the
    rules run out.
    """
    values, errors = np.zeros(len(points)), np.zeros(len(points))
    rates = _phase_rates(source, rays.wavelength, points, rays.curved)
    steps = np.ceil(rates * rays.wavelength / _RATE_STEP)
    for step in np.unique(steps):
        rate, group = float(step) * _RATE_STEP / rays.wavelength, np.flatnonzero(steps == step)
        shared = rays, rate, points[group], tolerance, floor[group]
        values[group], errors[group] = _raised(_cells(source, *shared), *shared)
    return values, errors


def _raised(
    cells: Triangles, rays: Rays, rate: float, points: Floats, tolerance: float, floor: Floats
) -> tuple[Floats, Floats]:
    """Rule after rule on the same cells, until all points are settled: :func:`summed_rays`."""
    result, off = np.zeros(len(points)), np.full(len(points), np.inf)
    open_ = np.arange(len(points))
    before: Floats | None = None
    _check_nodes(cells, rate, rays.wavelength)
    for extra in (1.0, *_LEVELS) if len(cells) > _MANY_CELLS else _LEVELS:
        if before is not None and node_count(cells, rate, extra) > _MOST_NODES:
            break
        values = rays.irradiance(gauss_rule(cells, rate, extra), points[open_])
        result[open_] = values
        if before is None:
            before = values
            continue
        errors = np.abs(values - before)
        errors[_are_unresolved(cells, rate, extra, points[open_])] = np.inf
        off[open_] = errors
        allowed = tolerance * np.maximum(np.abs(values), floor[open_])
        if (errors <= allowed).all():
            break
        kept = errors > _SETTLED * allowed
        open_, before = open_[kept], values[kept]
    return result, off


def _are_unresolved(
    cells: Triangles, rate: float, extra: float, points: Floats
) -> NDArray[np.bool_]:
    """Return a mask (n,) of points so near to the cells that their rays pass between nodes.

    The integrand has singularities at complex positions as far from the real ones as the point is
    from the source: at a distance d, nodes h apart err by a fraction of exp(-2 pi d/h). If that is
    more than 1/e, two rules may agree because neither of them resolves the integrand.
    """
    nearest = spacings(cells, rate, extra) / (2 * np.pi)
    low, high = cells.min(axis=1), cells.max(axis=1)
    unresolved = points[:, 2] < nearest.max()
    candidates = np.flatnonzero(unresolved)
    step = max(1, _PAIRS_AT_ONCE // len(cells))
    for start in range(0, len(candidates), step):
        some = candidates[start : start + step]
        place = points[some, None]
        aside = place[..., :2] - np.clip(place[..., :2], low, high)
        gap = np.sqrt((aside**2).sum(axis=-1) + place[..., 2] ** 2)
        unresolved[some] = (gap < nearest).any(axis=1)
    return unresolved


def _check_nodes(cells: Triangles, rate: float, wavelength: float) -> None:
    count = node_count(cells, rate, _LEVELS[0])
    if not count <= _MOST_NODES:
        across = float(np.ptp(cells.reshape(-1, 2), axis=0).max()) / wavelength
        raise ArgumentError(
            f"expected a source of fewer wavelengths for Wigner rays to these points, got one of "
            f"{across:.3g} across, for which {count:.2g} places on it would have to be summed up; "
            f"use method={DEFAULT!r}, which is exact, and check the unit of the "
            "wavelength"
        )


def _phase_rates(
    source: Aperture | Array, wavelength: float, points: Floats, curved: Sequence[float]
) -> Floats:
    """Largest |nu - kappa| of the rays to each point, in cycles per metre, kappa of any wave."""
    xmin, ymin, xmax, ymax = source.bounds
    corners = np.array([(x, y) for x in (xmin, xmax) for y in (ymin, ymax)])
    rays = points[:, None, :2] - corners
    length = np.sqrt((rays**2).sum(axis=-1) + points[:, None, 2] ** 2)
    nu = rays / (wavelength * length[..., None])
    bent = 0.0
    if curved:
        q = np.array([curved[:2], curved[1:3]])
        nu = nu - (corners - np.array(curved[3:])) @ q
        bent = float(np.linalg.norm(q, 2) * np.hypot(xmax - xmin, ymax - ymin))
    result = np.zeros(len(points))
    for kappa in normal_form(source).frequencies:
        result = np.maximum(result, np.linalg.norm(nu - kappa, axis=-1).max(axis=1))
    return result + bent


def _cells(
    source: Aperture | Array,
    rays: Rays,
    rate: float,
    points: Floats,
    tolerance: float,
    floor: Floats,
) -> Triangles:
    """Triangles without kinks inside; if there are too many kinks, triangles refined by error.

    W has a continuous gradient across most kinks, so the error of a cell with a kink in it falls
    as the fourth power of its size.
    """
    if has_few_kinks(source):
        return smooth_triangles(source)
    cells = triangulated(list(mutual_support(source).polygons.geoms))
    _check_nodes(cells, rate, rays.wavelength)
    chosen = np.unique(np.linspace(0, len(points) - 1, _PROBES).astype(int))
    probes, allowed = points[chosen], tolerance * floor[chosen]
    while len(cells) < _MOST_CELLS:
        # the first and the third rule that `_raised` takes
        coarse, fine = (_on_cells(cells, rays, rate, probes, _LEVELS[k]) for k in (0, 2))
        enough = np.maximum(allowed, tolerance * np.abs(fine.sum(axis=0)))
        shares = (np.abs(fine - coarse) / enough).max(axis=1)
        if float(shares.sum()) <= 1.0:
            break
        order = np.argsort(-shares)
        needed = np.searchsorted(np.cumsum(shares[order]), _FRACTION * shares.sum()) + 1
        divided = np.zeros(len(cells), dtype=bool)
        divided[order[:needed]] = True
        cells = np.concatenate([cells[~divided], quartered(cells[divided])])
    return cells


def _on_cells(cells: Triangles, rays: Rays, rate: float, points: Floats, extra: float) -> Floats:
    """Integrals over each cell at each point, (cells, points)."""
    parts = []
    sizes = np.linalg.norm(cells - np.roll(cells, 1, axis=1), axis=-1).max(axis=1)
    step = max(1, int(2**21 / (len(points) * (extra + 3.5 * rate * sizes.max()) ** 2)))
    for start in range(0, len(cells), step):
        nodes, weights, owners = rule_by_triangles(cells[start : start + step], rate, extra)
        values = rays.integrand(nodes, points) * weights
        sums = np.zeros((min(step, len(cells) - start), len(points)))
        np.add.at(sums, owners, values.T)
        parts.append(sums)
    return np.concatenate(parts)


# ---- cells where W is smooth ---------------------------------------------------------------------

# Most segments of kinks, some seconds' work, and most points where they meet.
_MOST_KINKS, _MOST_MEETINGS = 1 << 16, 1 << 20
# Segments whose meetings are counted.
_COUNTED = 256


@lru_cache(maxsize=64)
def _kinks(source: Aperture | Array) -> Floats | None:
    """The segments (T1), each once: (m, 2, 2), ends in the plane; None if there may be too many."""
    form = normal_form(source)
    elements, means = form.in_plane.elements, np.zeros((1, 2))
    grid = 0.0
    if form.lattice is not None:
        elements, positions = (form.lattice.element,), form.lattice.positions
        means = (positions[:, None] / 2 + positions / 2).reshape(-1, 2)
        grid = grid_size(positions) if positions.any() else 1.0
        means = np.unique(np.rint(means / grid), axis=0) * grid
    rings = [ring for element in elements for ring in element.rings]
    vertices = np.concatenate(rings)
    if len(means) * len(vertices) ** 2 > _MOST_KINKS:
        return None
    ends = np.concatenate([np.roll(ring, -1, axis=0) for ring in rings])
    first = vertices[:, None] / 2 + vertices / 2
    second = vertices[:, None] / 2 + ends / 2
    own = np.stack([first, second], axis=-2).reshape(-1, 2, 2)
    grid = max(grid, grid_size(vertices))
    return _distinct((_distinct(own, grid) + means[:, None, None]).reshape(-1, 2, 2), grid)


def _distinct(segments: Floats, grid: float) -> Floats:
    """Segments (n, 2, 2) without repetitions, coordinates rounded to the grid.

    Segments of opposite directions count as one, and segments that shrink to a point as none.
    """
    whole = np.rint(segments / grid)
    order = np.lexsort((whole[..., 1], whole[..., 0]), axis=1)
    whole = np.take_along_axis(whole, order[..., None], axis=1)
    result = np.unique(whole.reshape(-1, 4), axis=0).reshape(-1, 2, 2) * grid
    return np.asarray(result[(result[:, 0] != result[:, 1]).any(axis=-1)])


@lru_cache(maxsize=64)
def has_few_kinks(source: Aperture | Array) -> bool:
    """Whether the cells can be computed: up to 65,536 segments that meet some million times."""
    segments = _kinks(source)
    if segments is None:
        return False
    lines = shapely.linestrings(segments)
    counted = lines[:: max(1, len(lines) // _COUNTED)]
    meetings = shapely.STRtree(lines).query(counted, predicate="intersects").shape[1]
    return bool(meetings / len(counted) * len(lines) / 2 <= _MOST_MEETINGS)


@lru_cache(maxsize=64)
def smooth_triangles(source: Aperture | Array) -> Triangles:
    """Triangles (n, 3, 2) that tile the automean of a source and that no kink of W crosses.

    For sources that :func:`has_few_kinks` accepts.
    """
    segments = _kinks(source)
    assert segments is not None
    grid = grid_size(segments.reshape(-1, 2))
    noded = shapely.union_all(shapely.linestrings(segments), grid_size=grid)
    cells = np.array(polygons_in(shapely.polygonize([noded])), dtype=object)
    support = mutual_support(source).polygons
    shapely.prepare(support)
    inside = shapely.contains_properly(support, shapely.point_on_surface(cells))
    return triangulated(cells[inside])
