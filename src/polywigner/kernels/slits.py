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
from polywigner.illumination import Array
from polywigner.kernels.trigonometry import mean_plane_wave

__all__ = ["SlitFrame", "SlitTables", "ambiguity", "wigner"]


@dataclass(frozen=True)
class Interval:
    """A slit, and the complex amplitude of the field in it."""

    begin: float
    end: float
    real: float = 1.0
    imag: float = 0.0

    def mutual(self, other: Interval) -> tuple[float, float]:
        """Field here times the conjugate of the other: (real, imaginary) part."""
        product = complex(self.real, self.imag) * complex(other.real, -other.imag)
        return product.real, product.imag


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
def slit_tables(source: Slits | Array, double: bool) -> SlitTables:
    """The tables of slits or an array of slits; the same for either precision."""
    if isinstance(source, Slits):
        groups: list[tuple[Slits, complex]] = [(source, 1.0)]
    else:
        pairs = zip(source.coplanar, source.weights.tolist(), strict=True)
        groups = [(slits, weight) for slits, weight in pairs if isinstance(slits, Slits)]
    low = min(slits.bounds[0] for slits, _ in groups)
    high = max(slits.bounds[1] for slits, _ in groups)
    frame = SlitFrame((low + (high - low) / 2,), math.ldexp(1.0, math.frexp(high - low)[1]))
    intervals = (
        Interval(begin, end, complex(weight).real, complex(weight).imag)
        for slits, weight in groups
        for begin, end in ((slits.intervals - frame.centre[0]) / frame.scale).tolist()
    )
    return SlitTables(frame, tuple(intervals))


def _overlap(ops: Any, a: Any, b: Any, c: Any, d: Any) -> tuple[Any, Any, Any]:
    """Begin, end and length of [a, b] & [c, d]; length 0 and begin = end if they do not meet."""
    low = ops.maximum(a, c)
    high = ops.maximum(low, ops.minimum(b, d))
    return low, high, high - low


Overlap = tuple[Any, Any, Any, float, float]


def lag_intervals(ops: Any, tables: SlitTables, x: Any) -> Iterator[Overlap]:
    """What pairs of slits contribute to the lag slice at x: 2(I_k - x) & 2(x - I_l).

    Begin, end, length, and the mutual field as real and imaginary part. The pair (l, k) gives the
    mirror image with the conjugate field, and is counted with (k, l).
    """
    numbered = tuple(enumerate(tables.edges))
    twice = 2.0 * x
    for (k, one), (m, other) in combinations_with_replacement(numbered, 2):
        real, imag = (part * (1.0 if k == m else 2.0) for part in one.mutual(other))
        overlap = _overlap(
            ops,
            2.0 * one.begin - twice,
            2.0 * one.end - twice,
            twice - 2.0 * other.end,
            twice - 2.0 * other.begin,
        )
        yield (*overlap, real, imag)


def wigner(ops: Any, tables: SlitTables, x: Any, nu: Any) -> Any:
    """W(x, nu): the transform of the lag slice, real because the slice is Hermitian."""
    total: Any = 0.0
    for low, high, length, real, imag in lag_intervals(ops, tables, x):
        cosine, sine = mean_plane_wave(ops, nu * low, nu * high)
        total = ops.fma(cosine * length, real, total)
        if imag:
            total = ops.fma(sine * length, imag, total)
    return total


def lag_slice_length(ops: Any, tables: SlitTables, x: Any) -> Any:
    """R_x(x)."""
    total: Any = 0.0
    for _, _, length, real, _ in lag_intervals(ops, tables, x):
        total = ops.fma(length, real, total)
    return total


def position_intervals(ops: Any, tables: SlitTables, xi: Any) -> Iterator[Overlap]:
    """(I_k - xi/2) & (I_l + xi/2) for all pairs, as :func:`lag_intervals` gives them."""
    half = 0.5 * xi
    for one in tables.edges:
        for other in tables.edges:
            overlap = _overlap(
                ops, one.begin - half, one.end - half, other.begin + half, other.end + half
            )
            yield (*overlap, *one.mutual(other))


def ambiguity(ops: Any, tables: SlitTables, upsilon: Any, xi: Any) -> tuple[Any, Any]:
    """A(upsilon, xi) as (cosine part, sine part)."""
    cosine: Any = 0.0
    sine: Any = 0.0
    for low, high, length, real, imag in position_intervals(ops, tables, xi):
        c, s = mean_plane_wave(ops, upsilon * low, upsilon * high)
        cosine = ops.fma(c * real + s * imag, length, cosine)
        sine = ops.fma(s * real - c * imag, length, sine)
    return cosine, sine


def position_slice_length(ops: Any, tables: SlitTables, xi: Any) -> tuple[Any, Any]:
    """R_xi(xi) as (real, imaginary) part."""
    total_real: Any = 0.0
    total_imag: Any = 0.0
    for _, _, length, real, imag in position_intervals(ops, tables, xi):
        total_real = ops.fma(length, real, total_real)
        total_imag = ops.fma(length, imag, total_imag)
    return total_real, total_imag
