"""What is integrated over the boundary of a slice: W, A and the areas of slices, in the frame.

A term is that of the last part of an edge from a to b = a + e, the fraction s of its length; None
for the whole edge, which needs no products with it.
Source: docs/theory/transforms.md, (W1), (A1).
"""

from __future__ import annotations

import math
from typing import Any

from polywigner.kernels.formulas.slice_sum import Integrand
from polywigner.kernels.functions.stokes import moved_off_zero, segment_wave
from polywigner.numerics.phases import sin_turns

__all__ = ["AMBIGUITY", "LAG_AREA", "POSITION_AREA", "WIGNER"]

Values = tuple[Any, ...]


def _along(ops: Any, x: Any, y: Any, u: Any, v: Any) -> Any:
    return ops.fma(x, u, y * v)


def _wigner_at(ops: Any, offset: Values, nu_x: Any, nu_y: Any) -> Values:
    """nu, moved off 0 by so little that W, even in nu, changes by less than rounding; nu.T."""
    floor = 1e-9 if ops.double else 1e-6
    tiny = (abs(nu_x) < floor) & (abs(nu_y) < floor)  # false if either is not a number
    nu_x, nu_y = ops.select(tiny, floor, nu_x), ops.select(tiny, 0.0, nu_y)
    return nu_x, nu_y, _along(ops, nu_x, nu_y, *offset)


def _wigner_term(ops: Any, shared: Values, edge: Values, part: Any) -> Values:
    """(c/q) sin(2 pi s q) sin(2 pi [nu.(2b - T) - s q]) with q = nu.e and c = cross(nu, e).

    The two copies are mirror images: the edges of one, doubled, are the whole boundary. Nothing
    cancels as nu goes to 0.
    """
    (nu_x, nu_y, turns), (ax, ay, bx, by) = shared, edge
    ex, ey = bx - ax, by - ay
    # Its square is a normal number: processors take a hundred times as long for subnormal ones.
    floor = 1e-30 if ops.double else 1e-18
    along = _along(ops, nu_x, nu_y, ex, ey)
    along = ops.select(abs(along) < floor, floor, along)
    if part is None:
        half, middle = along, _along(ops, nu_x, nu_y, ax + bx, ay + by) - turns
    else:
        half = part * along
        middle = ops.fma(nu_x, 2.0 * bx, ops.fma(nu_y, 2.0 * by, -half)) - turns
    across = _along(ops, nu_x, nu_y, ey, -ex)
    return (across / along * (sin_turns(ops, half) * sin_turns(ops, middle)),)


def _wigner_total(ops: Any, shared: Values, sums: Values) -> Values:
    nu_x, nu_y, turns = shared
    square = math.pi**2 * _along(ops, nu_x, nu_y, nu_x, nu_y)
    return (sums[0] / square + (turns - turns),)  # what is no number is none in the result


def _ambiguity_at(ops: Any, offset: Values, v_x: Any, v_y: Any) -> Values:
    """upsilon off 0, and its half along T."""
    v_x, v_y = moved_off_zero(ops, v_x, v_y)
    return v_x, v_y, 0.5 * _along(ops, v_x, v_y, *offset)


def _ambiguity_term(ops: Any, shared: Values, edge: Values, part: Any) -> Values:
    """c s [sinc(s q) exp(2 pi i v.m) - 1] with q = v.e, c = cross(v, e) and m the part's middle."""
    (v_x, v_y, turns), (ax, ay, bx, by) = shared, edge
    ex, ey = bx - ax, by - ay
    half, across = 0.5 * _along(ops, v_x, v_y, ex, ey), _along(ops, v_x, v_y, ey, -ex)
    if part is not None:
        half, across = part * half, part * across
    middle = _along(ops, v_x, v_y, bx, by) - half - turns
    sine, cosine = segment_wave(ops, half, middle)
    return across * sine, across * cosine


def _ambiguity_total(ops: Any, shared: Values, sums: Values) -> Values:
    """Real and imaginary part of A, less the phase of the centre."""
    v_x, v_y, turns = shared
    scale = 0.5 / math.pi / _along(ops, v_x, v_y, v_x, v_y)
    undefined = turns - turns
    return sums[0] * scale + undefined, sums[1] * scale + undefined


def _area_at(ops: Any, offset: Values) -> Values:
    return offset


def _area_term(ops: Any, shared: Values, edge: Values, part: Any) -> Values:
    """cross(2a - T, e) s: four times the area of the triangle of a part and T/2, the middle."""
    (tx, ty), (ax, ay, bx, by) = shared, edge
    ex, ey = bx - ax, by - ay
    area = _along(ops, (ax + ax) - tx, (ay + ay) - ty, ey, -ex)
    return (area if part is None else part * area,)


def _lag_area_total(ops: Any, shared: Values, sums: Values) -> Values:
    """Lags are twice as long as positions, and the other copy has as much of the boundary."""
    tx, ty = shared
    return (2.0 * sums[0] + ((tx - tx) + (ty - ty)),)


def _position_area_total(ops: Any, shared: Values, sums: Values) -> Values:
    """The area, and no imaginary part."""
    tx, ty = shared
    undefined = (tx - tx) + (ty - ty)
    return 0.25 * sums[0] + undefined, undefined


WIGNER = Integrand(1, _wigner_at, _wigner_term, _wigner_total)
AMBIGUITY = Integrand(2, _ambiguity_at, _ambiguity_term, _ambiguity_total)
LAG_AREA = Integrand(1, _area_at, _area_term, _lag_area_total)
POSITION_AREA = Integrand(1, _area_at, _area_term, _position_area_total)
