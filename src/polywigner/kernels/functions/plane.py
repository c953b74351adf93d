"""Kernels of apertures, in their plane and in any pose in space."""

from __future__ import annotations

from collections.abc import Callable
from fractions import Fraction
from functools import lru_cache
from typing import Any

import numpy as np

from polywigner.geometry import Aperture, PlacedAperture
from polywigner.kernels.functions.fourier import (
    GridTables,
    LinearFrame,
    OutlineTables,
    enter_frequency,
    fan_sum,
    grid_tables,
    outline_tables,
)
from polywigner.kernels.functions.slices import AMBIGUITY_SUM, AREA_SUM, WIGNER_SUM
from polywigner.kernels.kernel import Kernel, Values, leave_real, leave_wave
from polywigner.kernels.outline import Tables, build_tables, enter_position_and_frequency, frame_of
from polywigner.kernels.wave_pairs import field_of
from polywigner.numerics import phases
from polywigner.numerics.phases import Pair
from polywigner.source import Array
from polywigner.source.normal_form import normal_form


def new_tables_of(source: Aperture | Array, double: bool) -> Tables:
    """Return the edges, weights and fields of an aperture or array.

    The vertices are in the order of the source. In the cache of :func:`tables_of`, the rings of an
    equal source may start at other vertices.
    """
    return build_tables(normal_form(source), double=double)


tables_of = lru_cache(maxsize=256)(new_tables_of)


@lru_cache(maxsize=256)
def _outline_of(aperture: Aperture, double: bool) -> OutlineTables:
    """Return the edges of an aperture for the Fourier transform, for float64 or float32."""
    return outline_tables(aperture.rings)


@lru_cache(maxsize=256)
def _grid_tables_of(source: Aperture | Array) -> GridTables | None:
    """Return the edges for Fourier transforms on grids; None for slender or placed outlines."""
    if isinstance(source, Aperture):
        outline = _outline_of(source, True)
        return grid_tables(outline, [1.0] * len(outline.edges))
    elements = [element for element in source.elements if isinstance(element, Aperture)]
    if len(elements) < len(source.elements):
        return None
    frame = frame_of(np.concatenate([ring for element in elements for ring in element.rings]))
    outlines = [outline_tables(element.rings, frame) for element in elements]
    field = [
        weight
        for outline, weight in zip(outlines, source.weights.tolist(), strict=True)
        for _ in outline.edges
    ]
    return grid_tables(OutlineTables(frame, tuple(e for o in outlines for e in o.edges)), field)


def placed_frame(plane: Any, pose: Any, double: bool) -> LinearFrame:
    """Return the frame ``plane`` placed at a pose (4, 4) in space. The arithmetic is exact."""
    exact = [[Fraction(value) for value in row] for row in pose.tolist()]
    in_plane = [Fraction(c) for c in plane.centre]
    centre = [row[0] * in_plane[0] + row[1] * in_plane[1] + row[3] for row in exact[:3]]
    rows = [
        [sum(Fraction(m) * row[k] for k, m in enumerate(line)) for row in exact[:3]]
        for line in plane.rows
    ]
    return LinearFrame(
        tuple(phases.doubled(c, double) for c in centre),
        tuple(tuple(phases.doubled(value, double) for value in row) for row in rows),
        plane.measure,
    )


@lru_cache(maxsize=256)
def _placed_tables(source: PlacedAperture, double: bool) -> OutlineTables:
    """Return the edges of an aperture in the frame of its plane in space."""
    plane = _outline_of(source.aperture, double)
    frame = placed_frame(plane.frame, source.pose, double)
    return OutlineTables(frame, plane.edges, plane.following)


def _enter_shift(ops: Any, frame: Any, *arguments: Any) -> Values:
    """Return the phase of the centre and carrier in cycles, and upsilon and xi in the frame.

    A has the factor exp(-2 pi i phase).
    """
    upsilon, xi = arguments[: len(arguments) // 2], arguments[len(arguments) // 2 :]
    cycles, *inner = enter_frequency(ops, frame, *upsilon)
    cycles = phases.less_carrier(ops, frame, cycles, *xi)
    return (cycles, *inner, *frame.vector(ops, *xi))


def enter_both_ends(ops: Any, frame: Any, *arguments: Any) -> Values:
    """Return the negated carrier phase in cycles, and x + xi/2 and x - xi/2 in the frame."""
    count = len(arguments) // 2
    x, xi = arguments[:count], arguments[count:]
    cycles = phases.less_carrier(ops, frame, 0.0 * xi[0], *xi)
    ahead = (p + 0.5 * lag for p, lag in zip(x, xi, strict=True))
    behind = (p - 0.5 * lag for p, lag in zip(x, xi, strict=True))
    return (cycles, *frame.position(ops, *ahead), *frame.position(ops, *behind))


def product_of_both(ops: Any, frame: Any, inner: Values, sums: Values) -> Values:
    """Return the autocorrelation u(x + xi/2) u*(x - xi/2), with its carrier phase."""
    product = Pair(*sums[:2]) * Pair(*sums[2:]).conjugate()
    if not any(frame.carrier):
        return product.real, product.imag
    return phases.rotated(ops, inner[0], product.real, -product.imag)


def field(ops: Any, tables: Tables, x: Any, y: Any) -> tuple[Any, Any]:
    """Return the real and imaginary part of the field at a point in the frame, without the carrier.

    Edges that cross the horizontal ray to the right of the point add or subtract the weight of
    their element. An edge includes its lower end but not its upper end, so a point on a common edge
    of two polygons belongs to exactly one polygon.
    """

    def term(ax: Any, ay: Any, bx: Any, by: Any, real: Any, imag: Any) -> tuple[Any, Any]:
        side = ops.cross(bx - ax, by - ay, x - ax, y - ay)
        up = (ay <= y) & (by > y) & (side > 0.0)
        down = (ay > y) & (by <= y) & (side < 0.0)
        winding = ops.select(up, 1.0, 0.0) - ops.select(down, 1.0, 0.0)
        return real * winding, imag * winding

    total = Pair(0.0, 0.0)
    for group, waves in enumerate(tables.groups):
        rows = tables.edges[tables.names[:, 3] == group].tolist()
        weight = Pair(*ops.sum_over(rows, term, 2, like=x))
        total = total + (weight * Pair(*field_of(ops, waves, (x, y))))
    # Comparisons with NaN are false, so the winding number alone would be 0 at NaN.
    undefined = (x - x) + (y - y)
    return total.real + undefined, total.imag + undefined


def at_both_ends(field: Any) -> Callable[..., Values]:
    """Return a function that evaluates ``field(ops, tables, *x)`` at both ends of a lag.

    The returned function is the edge sum of a kernel whose first step is :func:`enter_both_ends`.
    """
    return lambda ops, tables, cycles, *ends: (
        *field(ops, tables, *ends[: len(ends) // 2]),
        *field(ops, tables, *ends[len(ends) // 2 :]),
    )


AUTOCORRELATION = Kernel(
    "autocorrelation",
    2,
    tables_of,
    enter_both_ends,
    at_both_ends(field),
    product_of_both,
)
WIGNER = Kernel("wigner", 2, tables_of, enter_position_and_frequency, WIGNER_SUM, leave_real)


FOURIER = Kernel(
    "fourier",
    2,
    _outline_of,
    enter_frequency,
    fan_sum,
    leave_wave,
    _grid_tables_of,
)
FOURIER_PLACED = Kernel("fourier in space", 3, _placed_tables, enter_frequency, fan_sum, leave_wave)
AMBIGUITY = Kernel("ambiguity", 2, tables_of, _enter_shift, AMBIGUITY_SUM, leave_wave)
LAG_MARGINAL = Kernel(
    "lag_marginal",
    2,
    tables_of,
    lambda ops, frame, *xi: frame.vector(ops, *xi),
    AREA_SUM,
    leave_real,
)
"""Area of the position slice, which is the lag marginal of a uniform aperture."""
