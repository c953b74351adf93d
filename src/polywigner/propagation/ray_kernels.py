"""The share of one place on a source in the irradiance at one point, as kernels for engines.

The integrand of (T2): W, or the six moments (T1), for the ray from the place to the point, times
factors that depend on the ray's geometry alone. Those are computed in float64, before the sums.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache
from typing import Any

from polywigner import kernels
from polywigner.illumination.obliquities import irradiance_factor
from polywigner.kernels import Kernel
from polywigner.kernels.cut.slice_parts import PART_COLUMNS
from polywigner.kernels.cut.slice_sums import SliceSum
from polywigner.kernels.functions.part_kernels import (
    PART_MOMENTS,
    PART_MOMENTS_ALONG,
    PART_PARTLY_COHERENT,
    PART_WIGNER,
)
from polywigner.kernels.kernel import Values

__all__ = ["part_kernel", "ray_factors", "ray_kernel"]


def ray_kernel(source: Any, order: int, curved: bool = False) -> Kernel:
    """The integrand of (T2) for a source, to leading or to third order.

    Arguments: ``x, y`` on the source, ``X, Y, Z`` of the point, the wavelength, the coefficients
    of the four forms of obliquity (T4), and of a curved wave Q_xx, Q_xy, Q_yy and its centre: it
    is bilinear in place and lag, and so a frequency at each place to any order in the lag.

    Raises ArgumentError for what has no Wigner function of two dimensions, GeometryError for arrays
    whose elements do not lie in the plane z = 0.
    """
    name = "wigner" if order == 1 else "lag moments along" if curved else "lag moments"
    return _composed(kernels.kernel_for(name, source), order)


def part_kernel(order: int, curved: bool = False, partly: bool = False) -> Kernel:
    """The integrand of a part of the lag slice at a place: ``x, y``, its columns, the rest.

    ``partly``: in partly coherent light, to leading order.
    """
    moments = PART_MOMENTS_ALONG if curved else PART_MOMENTS
    whole = PART_PARTLY_COHERENT if partly else PART_WIGNER
    return _composed(whole if order == 1 else moments, order, PART_COLUMNS)


@lru_cache(maxsize=64)
def _composed(base: Kernel, order: int, columns: int = 0) -> Kernel:
    """``columns``: arguments of the base besides place and frequency, between the two."""
    factors = ray_factors(order)
    count = 1 if order == 1 else 6

    def enter(ops: Any, frame: Any, x: Any, y: Any, *rest: Any) -> Values:
        own, rest = rest[:columns], rest[columns:]
        point, wavelength, forms, curved = rest[:3], rest[3], rest[4:8], rest[8:]
        along_x, along_y = point[0] - x, point[1] - y
        square = along_x * along_x + along_y * along_y + point[2] * point[2]
        inverse = 1.0 / ops.sqrt(square)
        scale = inverse / wavelength
        place = own or (x, y)
        nu: Values = (along_x * scale, along_y * scale)
        ray = nu
        if curved:
            (xx, xy, yy), (dx, dy) = curved[:3], (x - curved[3], y - curved[4])
            nu = nu[0] - (xx * dx + xy * dy), nu[1] - (xy * dx + yy * dy)
            nu = nu if order == 1 else (*nu, *ray)
        inner = base.enter(ops, frame, *place, *nu)
        return (*factors(point[2] * inverse, inverse, wavelength, forms), *inner)

    own = base.edge_sum

    def edge_sum(ops: Any, tables: Any, *inner: Any) -> Values:
        return own(ops, tables, *inner[count:])

    def leave(ops: Any, frame: Any, inner: Values, sums: Values) -> Values:
        values = base.leave(ops, frame, inner[count:], sums)
        return (sum(a * b for a, b in zip(inner[:count], values, strict=True)),)

    return replace(
        base,
        name=f"{base.name} along rays",
        enter=enter,
        edge_sum=own.after(count) if isinstance(own, SliceSum) else edge_sum,
        leave=leave,
    )


def ray_factors(order: int) -> Callable[[Any, Any, Any, Values], Values]:
    """(cosine, 1/|r|, wavelength, forms) -> the factors of W, or of the moments (T1)."""
    return _leading if order == 1 else _third_order


def _leading(c: Any, inverse: Any, wavelength: Any, forms: Values) -> Values:
    """The factor of W: g/(wavelength |r|)^2, for 1/|r| ``inverse``."""
    density = inverse / wavelength
    return (irradiance_factor(forms, c) * density * density,)


def _third_order(c: Any, inverse: Any, wavelength: Any, forms: Values) -> Values:
    """The factors of the moments (T1), from those of S0, S1, Smm, S2 and S3 in (T4)."""
    first, mixed, both, crossed = forms
    first, mixed, crossed = first * c * c, mixed * c, crossed * c
    h = wavelength / (2 * math.pi)  # 1/k
    square = inverse * inverse
    s0 = first * (1.0 + h * h * square) + mixed + both + crossed * h * inverse
    s1 = (first + mixed) * (h * square) - crossed * (0.5 * inverse)
    s_mm = (first + mixed * 0.875 + both * 0.5) * square
    s2 = (first * -0.5 - mixed * 0.375 - both * 0.25) * square
    s3 = (first + mixed + both) * (square / (8.0 * h))
    density = inverse * inverse / (wavelength * wavelength)
    s3 = s3 * density * wavelength
    return (
        s0 * density,
        s1 * density * wavelength,
        s_mm * density * (wavelength * wavelength),
        s2 * density,
        s3,
        s3 * -(wavelength * wavelength),
    )
