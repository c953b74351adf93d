"""Derivatives of F, W and A of slits in the ends of the slits: docs/gradients.md, (G8).

If the end b of a slit moves, u changes by u(b) times a delta function there.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from polywigner.geometry import Slits
from polywigner.kernels.outline.waves import Wave, Waves, field_of
from polywigner.numerics.complex_pairs import Pair
from polywigner.numerics.phases import cos_sin_turns

__all__ = ["slopes_in_ends"]


def slopes_in_ends(ops: Any, name: str, source: Slits, *points: Any) -> list[tuple[Pair, Pair]]:
    """Derivatives of F, W or A (``name``) in the begin and in the end of each slit.

    ``points``: nu; x and nu; upsilon and xi. ``ops``: in double precision, whatever they are.
    """
    field = _Field(ops, source)
    known: dict[str, Callable[..., Pair]] = {
        "fourier": _of_f,
        "wigner": _of_w,
        "ambiguity": _of_a,
    }
    slope = known[name]
    return [
        (slope(field, begin, *points).scaled(-1.0), slope(field, end, *points))
        for begin, end in source.intervals.tolist()
    ]


class _Field:
    def __init__(self, ops: Any, source: Slits) -> None:
        self.ops, self.rows = ops, [tuple(row) for row in source.intervals.tolist()]
        self.waves: Waves = (Wave(1.0, (0.0,)),)
        if source.illumination is not None:
            amplitudes, frequencies = (
                source.illumination.amplitudes,
                source.illumination.frequencies,
            )
            pairs = zip(amplitudes.tolist(), frequencies.tolist(), strict=True)
            self.waves = tuple(Wave(a, tuple(f)) for a, f in pairs)

    def inner(self, y: Any) -> Pair:
        """The waves at a place, inside a slit or not."""
        return Pair(*field_of(self.ops, self.waves, (y,)))

    def at(self, y: Any) -> Pair:
        """u, which a slit has at its begin and not at its end."""
        ops = self.ops

        def term(begin: Any, end: Any) -> tuple[Any]:
            return (ops.select((y >= begin) & (y < end), 1.0, 0.0),)

        (inside,) = ops.sum_over(self.rows, term, 1, like=y)
        return self.inner(y).scaled(inside)

    def wave(self, turns: Any) -> Pair:
        """exp(-2 pi i turns)."""
        cosine, sine = cos_sin_turns(self.ops, turns)
        return Pair(cosine, -sine)


def _of_f(field: _Field, end: float, nu: Any) -> Pair:
    return field.inner(end) * field.wave(nu * end)


def _of_w(field: _Field, end: float, x: Any, nu: Any) -> Pair:
    """Twice the real part of what one of the two copies contributes, at the lag 2(end - x)."""
    product = field.inner(end) * _conjugate(field.at(2.0 * x - end))
    return Pair((product * field.wave(2.0 * (end - x) * nu)).real * 4.0, 0.0)


def _of_a(field: _Field, end: float, upsilon: Any, xi: Any) -> Pair:
    own = field.inner(end)
    ahead = own * _conjugate(field.at(end - xi)) * field.wave(upsilon * (end - 0.5 * xi))
    behind = field.at(end + xi) * _conjugate(own) * field.wave(upsilon * (end + 0.5 * xi))
    return ahead + behind


def _conjugate(value: Pair) -> Pair:
    return Pair(value.real, -value.imag)
