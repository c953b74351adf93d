"""Derivatives of F: sums over the edges. Source: docs/gradients.md, (G1), (G4)."""

from __future__ import annotations

from typing import Any

from polywigner.kernels.functions.fourier import OutlineTables
from polywigner.kernels.slopes.slopes import Axes, GradientAccumulator, Slopes
from polywigner.numerics.complex_pairs import Pair

__all__ = ["fourier_slopes"]


def fourier_slopes(
    ops: Any, tables: OutlineTables, accumulator: GradientAccumulator, nu_x: Any, nu_y: Any
) -> Slopes:
    """Derivatives of V = F(nu) in the frame."""
    axes = Axes(ops, (nu_x, nu_y))
    rows = [
        (*edge[:4], float(begin), float(end))
        for begin, (edge, end) in enumerate(zip(tables.edges, tables.following, strict=True))
    ]

    def term(ax: Any, ay: Any, bx: Any, by: Any, begin: Any, end: Any) -> tuple[Any, ...]:
        ex, ey = bx - ax, by - ay
        segment = axes.segment(*axes.of(0.5 * (ax + bx), 0.5 * (ay + by)), *axes.of(ex, ey))
        along, across = (pair.scaled(-segment.dp) for pair in segment.moments(ops))
        e0, e1, _ = segment.means
        shared: Any = (0.0,) * accumulator.values
        if accumulator.wanted.vertices:
            at = e0.scaled(0.5) - e1, e0.scaled(0.5) + e1
            shared = accumulator.edge(begin, end, (ey, -ex), at)
        return (along.real, along.imag, across.real, across.imag, *shared)

    sums = ops.sum_over(rows, term, 4 + accumulator.values, like=nu_x)
    zero = Pair(0.0, 0.0)
    frequency = axes.gradient(Pair(*sums[:2]), Pair(*sums[2:4]).scaled(0.5))
    return Slopes(list(frequency), [zero, zero], list(sums[4:]))
