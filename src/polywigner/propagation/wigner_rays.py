"""Irradiance by Wigner rays (R1), to a tolerance.

The automean is the set of midpoints between any two points of the source. Gauss rules integrate the
Wigner function W over triangles on the automean that no kink of W crosses (T1), (T2).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np
import shapely

from polywigner import execution
from polywigner.execution import Engine
from polywigner.geometry import Aperture, Wavefront
from polywigner.geometry.arguments import check_most, warn_caller
from polywigner.geometry.parts import grid_size, polygons_in
from polywigner.geometry.rings import edges_of_rings
from polywigner.kernels import Kernel, kernel_for
from polywigner.kernels.functions.slices import SliceSum
from polywigner.kernels.kernel import Values
from polywigner.numerics import Floats
from polywigner.numerics.nodes import (
    Triangles,
    gauss_rule,
    node_count,
    quartered,
    spacings,
    triangles_of,
)
from polywigner.propagation.boundary import radiator_of
from polywigner.propagation.far_fields import check_slopes
from polywigner.radiometry.directions import PlaneSource
from polywigner.source import Array
from polywigner.source.array import mutual_support
from polywigner.source.normal_form import normal_form
from polywigner.source.obliquities import DEFAULT, Forms, ObliquityName, obliquity_of
from polywigner.transforms.public_transforms import energy_of
from polywigner.transforms.wavefronts import flat_source, is_partly_coherent

# Fraction of the largest possible irradiance (T2) below which the allowed error is absolute.
_FLOOR = 1e-3
# Number of edges above which rays take seconds, a hundred times longer than the exact field.
_MANY_EDGES = 50
# Distance [wavelengths] below which rays are a rough approximation.
_NEAREST = 2.0

# Numbers of additional nodes along a side of a triangle for successive quadrature rules. Two nodes
# are exact on small triangles, where W is quadratic.
_LEVELS = (2.0, 3.0, 4.0, 6.0, 8.0, 11.0, 15.0, 20.0, 28.0)
# Number of triangles above which a rule with one additional node is used first.
_MANY_TRIANGLES = 500
# Largest number of nodes, which take 64 MiB.
_MOST_NODES = 1 << 22
# Points share a quadrature rule if their highest frequencies differ by at most this fraction of
# 1/wavelength.
_RATE_STEP = 0.25
# Fraction of the allowed error below which the error of a point is not reduced further.
_SETTLED = 0.03

NodeSum = Callable[[tuple[Floats, Floats], Floats], Floats]
"""Function of nodes, weights and points that returns irradiances."""


def irradiance_by_rays(
    source: PlaneSource | Wavefront,
    points: Floats,
    wavelength: float,
    obliquity: ObliquityName | None,
    allowed: float,
    engine: Engine,
) -> tuple[Floats, Floats]:
    """Return the irradiance by Wigner rays at points (n, 3), and its estimated error, both (n,).

    An ``obliquity`` of None selects the default. ``allowed`` is the allowed relative error. The
    estimated error is absolute, and infinite if no rule resolves the rays. Warns if the allowed
    error is exceeded.
    """
    condition, flat = obliquity_of(obliquity), flat_source(source)
    curved: tuple[float, ...] = ()
    if isinstance(source, Wavefront) and not source.is_flat:
        (xx, xy), (_, yy) = source.curvature.tolist()
        curved = (xx, xy, yy, *source.centre.tolist())
        check_slopes(source, condition.name)
    execution.checked_engine(engine)
    terms = []
    for part, forms in condition.terms(flat, wavelength):
        if is_partly_coherent(source):
            part = Wavefront(part, coherence_width=normal_form(source).coherence_width)
        kernel = _along_rays(kernel_for("wigner", part))
        terms.append((kernel, part, (wavelength, *forms, *curved)))
    radiator = radiator_of(flat)
    clearance = radiator.distance(points)
    if (clearance < _NEAREST * wavelength).any():
        warn_caller(
            f"some points are less than {_NEAREST:g} wavelengths from the source, where Wigner "
            f"rays are a rough approximation; use method={DEFAULT!r}, which is exact"
        )
    edges = sum(len(ring) for ring in normal_form(flat).rings)
    if edges > _MANY_EDGES:
        warn_caller(
            f"Wigner rays take seconds for a source of {edges} edges; use method='auto' for the "
            "exact field, which is about a hundred times faster"
        )

    def node_sum(rule: tuple[Floats, Floats], block: Floats) -> Floats:
        """Return the irradiance at points (n, 3) for a quadrature rule on the source."""
        total = np.zeros(len(block))
        for kernel, part, constants in terms:
            total += execution.evaluate_sums(
                kernel, part, *rule, block, constants, double=True, engine=engine
            )
        return total

    area = sum(element.area for element in flat.elements_in_plane)
    spread = wavelength * radiator.distance_of_centre(points)
    largest = energy_of(flat) / area * np.minimum(1.0, (area / spread) ** 2)
    floor = _FLOOR * largest
    values, errors = np.zeros(len(points)), np.zeros(len(points))
    rates = _phase_rates(source, wavelength, points)
    steps = np.ceil(rates * wavelength / _RATE_STEP)
    triangles = _triangles(flat)
    for step in np.unique(steps):
        rate, group = float(step) * _RATE_STEP / wavelength, np.flatnonzero(steps == step)
        count = node_count(triangles, rate, _LEVELS[0])  # of the coarsest rule
        remedy = f"use method={DEFAULT!r}, which is exact, and check the unit of the wavelength"
        check_most(count, _MOST_NODES, "quadrature nodes for Wigner rays to these points", remedy)
        values[group], errors[group] = _refined_sums(
            node_sum, triangles, rate, points[group], clearance[group], allowed, floor[group]
        )
    if not (errors <= allowed * np.maximum(np.abs(values), floor)).all():
        warn_caller(
            "the tolerance is not met at all points; use irradiance_with_error for estimates of "
            "the errors, or method='auto' for the exact field"
        )
    return values, errors


@lru_cache(maxsize=64)
def _along_rays(base: Kernel) -> Kernel:
    """Return a kernel of the irradiance along a ray (R1), from a kernel of the Wigner function.

    The arguments are the position (x, y) on the source, the point (X, Y, Z), the wavelength, three
    obliquity coefficients (D2), and, for curved waves, Q_xx, Q_xy, Q_yy and the centre.
    """

    def enter(ops: Any, frame: Any, x: Any, y: Any, *rest: Any) -> Values:
        """Return the factor of W in the irradiance, and the arguments of the kernel of W."""
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
        """Return the edge sum of W, without the factor of the irradiance."""
        return base_sum(ops, tables, *inner)

    def leave(ops: Any, frame: Any, inner: Values, sums: Values) -> Values:
        """Return W times the factor of the irradiance."""
        return (inner[0] * base.leave(ops, frame, inner[1:], sums)[0],)

    return replace(
        base,
        name=f"{base.name} along rays",
        enter=enter,
        edge_sum=base_sum.after(1) if isinstance(base_sum, SliceSum) else edge_sum,
        leave=leave,
    )


def _refined_sums(
    node_sum: NodeSum,
    triangles: Triangles,
    rate: float,
    points: Floats,
    clearance: Floats,
    tolerance: float,
    floor: Floats,
) -> tuple[Floats, Floats]:
    """Return the irradiance at points and its error, from successive quadrature rules.

    The allowed error is ``tolerance`` times the irradiance, or times ``floor`` (n,) if ``floor`` is
    larger. ``rate`` is the highest spatial frequency of the integrand in 1/m, and ``clearance``
    (n,) contains the distances from the source in m. The integrand for a point at the distance d
    has complex singularities. Therefore, a rule with node spacing h has a relative error of exp(-2
    pi d/h). If this error exceeds 1/e, two inaccurate rules may agree, so the estimated error is
    set to infinity.
    """
    values, errors = np.zeros(len(points)), np.full(len(points), np.inf)
    remaining = np.arange(len(points))
    previous: Floats | None = None
    for extra in (1.0, *_LEVELS) if len(triangles) > _MANY_TRIANGLES else _LEVELS:
        if previous is not None and node_count(triangles, rate, extra) > _MOST_NODES:
            break
        sums = node_sum(gauss_rule(triangles, rate, extra)[:2], points[remaining])
        values[remaining] = sums
        if previous is None:
            previous = sums
            continue
        change = np.abs(sums - previous)
        change[clearance[remaining] < spacings(triangles, rate, extra).max() / (2 * np.pi)] = np.inf
        errors[remaining] = change
        allowed = tolerance * np.maximum(np.abs(sums), floor[remaining])
        if (change <= allowed).all():
            break
        unsettled = change > _SETTLED * allowed
        remaining, previous = remaining[unsettled], sums[unsettled]
    return values, errors


def _phase_rates(source: PlaneSource | Wavefront, wavelength: float, points: Floats) -> Floats:
    """Return the highest spatial frequency in 1/m of the integrand for each point, shape (n,)."""
    form = normal_form(source)
    low, high = np.reshape(form.bounds, (2, 2))
    corners = np.array([(x, y) for x in (low[0], high[0]) for y in (low[1], high[1])])
    rays = points[:, None, :2] - corners
    length = np.sqrt((rays**2).sum(axis=-1) + points[:, None, 2] ** 2)
    nu = rays / (wavelength * length[..., None]) - (corners - form.centre) @ form.curvature
    rates = np.zeros(len(points))
    for kappa in form.frequencies:
        rates = np.maximum(rates, np.linalg.norm(nu - kappa, axis=-1).max(axis=1))
    return rates + float(np.linalg.norm(form.curvature, 2) * np.linalg.norm(high - low))


# Largest number of kinks, whose computation takes some seconds, and largest number of their
# intersections.
_MOST_KINKS, _MOST_INTERSECTIONS = 1 << 16, 1 << 20
# Size of the sample of kinks from which the number of intersections is estimated.
_SAMPLE = 256


def _kinks(source: Aperture | Array) -> Floats | None:
    """Return the segments (m, 2, 2) of positions at which W has kinks, or None if there are many.

    The segments consist of the midpoints between a vertex and the points of an edge (T1).
    """
    form = normal_form(source)
    elements, means = form.in_plane.elements, np.zeros((1, 2))
    grid = 0.0
    if form.copies is not None:
        elements, positions = (form.copies.element,), form.copies.positions
        means = (positions[:, None] / 2 + positions / 2).reshape(-1, 2)
        grid = grid_size(positions) if positions.any() else 1.0
        means = np.unique(np.rint(means / grid), axis=0) * grid
    rings = [ring for element in elements for ring in element.rings]
    vertices, ends = edges_of_rings(rings)
    if len(means) * len(vertices) ** 2 > _MOST_KINKS:
        return None
    first = vertices[:, None] / 2 + vertices / 2
    second = vertices[:, None] / 2 + ends / 2
    segments = np.stack([first, second], axis=-2).reshape(-1, 2, 2)
    grid = max(grid, grid_size(vertices))
    return _distinct((_distinct(segments, grid) + means[:, None, None]).reshape(-1, 2, 2), grid)


def _distinct(segments: Floats, grid: float) -> Floats:
    """Round segments to a grid; drop duplicates in either direction and segments of zero length."""
    steps = np.rint(segments / grid)
    order = np.lexsort((steps[..., 1], steps[..., 0]), axis=1)
    steps = np.take_along_axis(steps, order[..., None], axis=1)
    distinct = np.unique(steps.reshape(-1, 4), axis=0).reshape(-1, 2, 2) * grid
    return np.asarray(distinct[(distinct[:, 0] != distinct[:, 1]).any(axis=-1)])


@lru_cache(maxsize=64)
def _triangles(source: Aperture | Array) -> Triangles:
    """Return triangles that tile the automean.

    No kink crosses a triangle unless there are too many kinks.
    """
    segments, support = _kinks(source), mutual_support(source).polygons
    if segments is None or _intersection_count(segments) > _MOST_INTERSECTIONS:
        # Triangles may cross kinks here. Across most kinks, the gradient of W is continuous, so
        # errors are of fourth order in the size of the triangles.
        return quartered(triangles_of(list(support.geoms))[0])
    grid = grid_size(segments.reshape(-1, 2))
    noded = shapely.union_all(shapely.linestrings(segments), grid_size=grid)
    cells = np.array(polygons_in(shapely.polygonize([noded])), dtype=object)
    shapely.prepare(support)
    inside = shapely.contains_properly(support, shapely.point_on_surface(cells))
    return triangles_of(cells[inside])[0]


def _intersection_count(segments: Floats) -> float:
    """Estimate the number of pairs of segments (m, 2, 2) that intersect."""
    lines = shapely.linestrings(segments)
    sample = lines[:: max(1, len(lines) // _SAMPLE)]
    intersections = shapely.STRtree(lines).query(sample, predicate="intersects").shape[1]
    return float(intersections / len(sample) * len(lines) / 2)
