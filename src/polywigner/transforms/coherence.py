"""Partly coherent sources: in closed form, and as an incoherent mean over tilts.

A and R are those of the coherent source times the degree of coherence exp(-xi^2/(2 width^2)), and W
is an integral over the lag slice with this weight, in closed form (docs/coherence.md, (PC3),
(I5)). The degree of coherence is also the mean of exp(2 pi i t.xi) over tilts t of a normal
density, whose standard deviation is 1/(2 pi width) along each axis (PC2). So |F|^2, exact fields,
and W of arrays that have short cuts of their own, are means over shifted frequencies: no lag of a
source is longer than its box, so that the rules of :mod:`polywigner.numerics.nodes` know how
many tilts they need.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polywigner.errors import ArgumentError
from polywigner.geometry.wavefront import Wavefront
from polywigner.illumination.array import tilted_source
from polywigner.numerics.nodes import normal_product_rule
from polywigner.transforms.arguments import broadcast_shape

__all__ = [
    "TILT_ERROR",
    "coherent_source",
    "degree_of_coherence",
    "in_closed_form",
    "is_partly_coherent",
    "mean_over_tilts",
    "tilts_of",
]

Values = NDArray[np.float64]

TILT_ERROR = {True: 1e-11, False: 1e-7}
"""Error of means over tilts in double and in single precision, relative to the largest of A."""

# Widths in the area of a source: some four tilts for each.
_MOST_WIDTHS = 1 << 15
# Widths over the diagonal of a source from which on the light is so nearly coherent that what it
# lacks is a linear function of 1/width^2: closed forms cancel, and the next term of the degree of
# coherence is 1.3e-13, or 8e-7 in single precision. Below the least one W is the width's area times
# a function of position: squares of lags in widths stay far from the largest float.
_WIDEST, _NARROWEST = {True: 1e3, False: 20.0}, 1e-9

# Values at a time.
_BLOCK = 1 << 20


def is_partly_coherent(source: Any) -> bool:
    """Whether the points of a source are coherent over a width only."""
    return isinstance(source, Wavefront) and not source.is_coherent


def coherent_source(source: Wavefront, tilt: Any = None) -> Any:
    """The source in coherent light: a Wavefront if its wave is curved; times exp(2 pi i tilt.x)."""
    flat = source.source if tilt is None else tilted_source(source.source, tilt)
    return Wavefront(flat, source.curvature, source.centre).coherent


def degree_of_coherence(source: Wavefront, xi: Any) -> Any:
    """exp(-xi^2/(2 width^2)) of lags (..., d), (...): (PC1)."""
    with np.errstate(over="ignore"):
        scaled = np.asarray(xi, dtype=np.float64) / source.coherence_width
        return np.exp(-0.5 * np.square(scaled).sum(axis=-1))


def tilts_of(source: Wavefront, error: float, longest: float = math.inf) -> tuple[Values, Values]:
    """Tilts (n, d) in 1/m and weights (n,), whose mean of what a source makes errs by ``error``.

    Relative to the largest that it could be if all of the source were in phase. ``longest``: lag in
    m along each axis, of the mean of a number to which longer ones add next to nothing.

    Raises ArgumentError for a width so small that there would be too many.
    """
    sides = _sides(source)
    reaches = np.minimum(sides, longest) / source.coherence_width
    if math.prod(1.0 + reaches) > _MOST_WIDTHS:
        least = math.prod(sides.tolist()) ** (1 / len(sides)) / _MOST_WIDTHS ** (1 / len(sides))
        raise ArgumentError(
            f"expected a width of coherence of at least {least:.3g} m for a source of "
            f"{' x '.join(f'{side:.3g}' for side in sides)} m, got {source.coherence_width:.3g} m, "
            "a sum over too many tilts; polywigner.wigner takes any width"
        )
    nodes, weights = normal_product_rule(tuple(reaches.tolist()), error)
    return nodes / (2 * math.pi * source.coherence_width), weights


def _sides(source: Wavefront) -> Values:
    """The sides of the source's box, (d,) in m."""
    return np.asarray(np.subtract(*np.reshape(source.bounds, (2, -1))[::-1]))


def in_closed_form(
    closed_form: Callable[..., Any],
    of_coherent: Callable[..., Any],
    wave: Wavefront,
    x: Values,
    nu: Values,
    double: bool,
) -> Any:
    """W of a source that is coherent over any width, by its closed form ``(source, x, nu)``."""
    size, width = math.hypot(*_sides(wave)), wave.coherence_width
    least, most = _NARROWEST * size, _WIDEST[double] * size
    held = wave._with(coherence_width=min(max(width, least), most))
    values = closed_form(held, x, nu)
    if width < least:
        return values * (width / least) ** wave.dimension
    if width <= most:
        return values
    limit = of_coherent(x, nu)
    return limit + (values - limit) * (most / width) ** 2


def mean_over_tilts(
    evaluate: Callable[..., Any], source: Wavefront, nu: Any, *others: Any, double: bool
) -> Any:
    """The mean of ``evaluate(*others, nu - t)`` over the tilts t of a source.

    ``nu``, ``others``: (..., d), which broadcast against each other. The tilts become a last axis
    of samples, over which slices are cut once; ``evaluate`` sees some 1e6 values at a time.
    """
    tilts, weights = tilts_of(source, TILT_ERROR[double])
    arrays = [np.asarray(points) for points in (*others, nu)]
    shape = broadcast_shape(arrays)

    def mean(*parts: Any) -> Any:
        *rest, frequency = parts
        spread = [points[..., None, :] for points in rest]
        values = evaluate(*spread, frequency[..., None, :] - tilts)
        return values @ weights.astype(values.real.dtype)

    if math.prod(shape) * len(weights) <= _BLOCK:
        return mean(*arrays)[()]
    flat = [np.broadcast_to(a, (*shape, a.shape[-1])).reshape(-1, a.shape[-1]) for a in arrays]
    step = max(1, _BLOCK // len(weights))
    parts = [mean(*(a[k : k + step] for a in flat)) for k in range(0, len(flat[0]), step)]
    return np.concatenate(parts).reshape(shape)
