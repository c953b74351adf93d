"""The transforms in one dimension: sums over intervals in closed form.

The lag slice of two intervals and the position slice of two shifted ones are intervals again, so
every transform is a sum of plane waves' means over intervals (docs/theory.md, (S1) to (S3)).
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from itertools import combinations_with_replacement
from typing import Any

from polywigner.geometry import Slits
from polywigner.kernels.complex_pairs import Pair
from polywigner.kernels.stokes import mean_complex_wave
from polywigner.kernels.trigonometry import mean_plane_wave

__all__ = ["SlitFrame", "SlitTables", "ambiguity", "fourier", "fourier_complex", "wigner"]

Interval = tuple[float, float]


@dataclass(frozen=True)
class SlitFrame:
    """x' = (x - centre)/scale, nu' = scale nu; the scale is a power of two."""

    centre: tuple[float]
    scale: float

    @property
    def content(self) -> float:
        return self.scale

    def position(self, ops: Any, x: Any) -> tuple[Any]:
        return ((x - self.centre[0]) * (1 / self.scale),)

    def vector(self, ops: Any, xi: Any) -> tuple[Any]:
        return (xi * (1 / self.scale),)

    def frequency(self, ops: Any, nu: Any) -> tuple[Any]:
        return (nu * self.scale,)


@dataclass(frozen=True)
class SlitTables:
    """The intervals in their frame; ``edges`` are what a sum runs over."""

    frame: SlitFrame
    edges: tuple[Interval, ...]


@lru_cache(maxsize=256)
def slit_tables(slits: Slits, double: bool) -> SlitTables:
    """The tables of slits; the same for either precision."""
    low, high = slits.bounds
    frame = SlitFrame((low + (high - low) / 2,), math.ldexp(1.0, math.frexp(high - low)[1]))
    inner = (slits.intervals - frame.centre[0]) / frame.scale
    return SlitTables(frame, tuple((a, b) for a, b in inner.tolist()))


def fourier(ops: Any, tables: SlitTables, nu: Any) -> tuple[Any, Any]:
    """F(nu) as (cosine part, sine part), F = cosine - i sine."""
    cosine: Any = 0.0
    sine: Any = 0.0
    for a, b in tables.edges:
        c, s = mean_plane_wave(ops, nu * a, nu * b)
        cosine = ops.fma(c, b - a, cosine)
        sine = ops.fma(s, b - a, sine)
    return cosine, sine


def fourier_complex(ops: Any, tables: SlitTables, nu: Pair) -> Pair:
    """F(nu) for complex nu."""
    total = Pair(0.0, 0.0)
    for a, b in tables.edges:
        total = total + mean_complex_wave(ops, nu.scaled(a), nu.scaled(b)).scaled(b - a)
    return total


def _overlap(ops: Any, a: Any, b: Any, c: Any, d: Any) -> tuple[Any, Any, Any]:
    """Begin, end and length of [a, b] & [c, d]; length 0 and begin = end if they do not meet."""
    low = ops.maximum(a, c)
    high = ops.maximum(low, ops.minimum(b, d))
    return low, high, high - low


def lag_intervals(ops: Any, tables: SlitTables, x: Any) -> Iterator[tuple[Any, Any, Any, float]]:
    """(begin, end, length, how often) of what pairs of slits contribute to the lag slice at x.

    2(I_k - x) & 2(x - I_l); the pair (l, k) gives the mirror image and is counted with (k, l).
    """
    numbered = tuple(enumerate(tables.edges))
    for (k, (a, b)), (m, (c, d)) in combinations_with_replacement(numbered, 2):
        twice = 2.0 * x
        times = 1.0 if k == m else 2.0
        overlap = _overlap(ops, 2.0 * a - twice, 2.0 * b - twice, twice - 2.0 * d, twice - 2.0 * c)
        yield (*overlap, times)


def wigner(ops: Any, tables: SlitTables, x: Any, nu: Any) -> Any:
    """W(x, nu): the cosine transform of the lag slice, which is symmetric."""
    total: Any = 0.0
    for low, high, length, times in lag_intervals(ops, tables, x):
        cosine, _ = mean_plane_wave(ops, nu * low, nu * high)
        total = ops.fma(cosine * length, times, total)
    return total


def lag_slice_length(ops: Any, tables: SlitTables, x: Any) -> Any:
    """R_x(x)."""
    total: Any = 0.0
    for _, _, length, times in lag_intervals(ops, tables, x):
        total = ops.fma(length, times, total)
    return total


def position_intervals(ops: Any, tables: SlitTables, xi: Any) -> Iterator[tuple[Any, Any, Any]]:
    """(begin, end, length) of (I_k - xi/2) & (I_l + xi/2) for all pairs."""
    half = 0.5 * xi
    for a, b in tables.edges:
        for c, d in tables.edges:
            yield _overlap(ops, a - half, b - half, c + half, d + half)


def ambiguity(ops: Any, tables: SlitTables, upsilon: Any, xi: Any) -> tuple[Any, Any]:
    """A(upsilon, xi) as (cosine part, sine part)."""
    cosine: Any = 0.0
    sine: Any = 0.0
    for low, high, length in position_intervals(ops, tables, xi):
        c, s = mean_plane_wave(ops, upsilon * low, upsilon * high)
        cosine = ops.fma(c, length, cosine)
        sine = ops.fma(s, length, sine)
    return cosine, sine


def position_slice_length(ops: Any, tables: SlitTables, xi: Any) -> Any:
    """R_xi(xi)."""
    total: Any = 0.0
    for _, _, length in position_intervals(ops, tables, xi):
        total = total + length
    return total
