"""Sources with a curved or partly coherent wave: their parts, spectra, and means over tilts.

F of a curved wave is a sum of Fresnel integrals along edges. A and R of partly coherent light are
the coherent source's times the degree of coherence exp(-xi^2/(2 width^2)), and W is an integral
over the lag slice with this weight, in closed form (docs/coherence.md, (PC3), (I5)). The degree of
coherence is also the mean of exp(2 pi i t.xi) over tilts t of a normal density, whose standard
deviation is 1/(2 pi width) along each axis (PC2). So |F|^2, exact fields, and W of large arrays
with short cuts of their own, are means over shifted frequencies: no lag of a source is longer than
its box, so that the rules of :mod:`polywigner.numerics.nodes` know how many tilts they need.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polywigner import kernels
from polywigner.errors import ArgumentError, IlluminationError
from polywigner.geometry import Aperture, Slits, Wavefront
from polywigner.numerics.chirps import chirp_over_intervals, chirp_over_rings
from polywigner.numerics.nodes import normal_product_rule
from polywigner.source.normal_form import normal_form
from polywigner.transforms.checked_calls import broadcast_shape

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]

TILT_ERROR = {True: 1e-11, False: 1e-7}
"""Error of means over tilts in double and in single precision, relative to the largest of A."""

# Widths over the diagonal of a source from which on the light is so nearly coherent that what it
# lacks is a linear function of 1/width^2: closed forms cancel, and the next term of the degree of
# coherence is 1.3e-13, or 8e-7 in single precision. Below the least one W is the width's area times
# a function of position: squares of lags in widths stay far from the largest float.
_WIDEST, _NARROWEST = {True: 1e3, False: 20.0}, 1e-9
# Squares of the diagonal in the area of a source, which is computed in double precision if it has
# more: single precision misses 1e-7 of this square.
_THIN = 16.0

# Floats at a time.
_BLOCK = 1 << 20


def flat_of(source: Any) -> Any:
    """The flat source of a Wavefront; any other source as it is."""
    return source.source if isinstance(source, Wavefront) else source


def checked_wavefront(wave: Wavefront) -> Wavefront:
    """The source, unless it is one that transforms do not take.

    Raises IlluminationError for one that is partly coherent.
    """
    if not wave.is_coherent:
        raise IlluminationError(
            "expected a coherent source, got one that is coherent over "
            f"{wave.coherence_width:g} m, of which there is no field with a phase; use "
            "polywigner.irradiance or radiant_intensity, which take it"
        )
    return wave


def is_partly_coherent(source: Any) -> bool:
    """Whether the points of a source are coherent over a width only."""
    return isinstance(source, Wavefront) and not source.is_coherent


# --- curved waves


def principal_axes(curvature: Floats) -> tuple[Floats, Floats]:
    """Curvatures (d,) along the axes that are the columns of a rotation (d, d)."""
    if not np.any(curvature - np.diag(np.diagonal(curvature))):
        return np.diagonal(curvature).copy(), np.eye(len(curvature))
    values, axes = np.linalg.eigh(curvature)
    return values, axes


def chirp_transform(source: Any, q: Floats, axes: Floats, centre: Floats, nu: Floats) -> Complex:
    """int u(x) exp(i pi (x - c).Q (x - c) - 2 pi i nu.x) dx at points (n, d), shape (n,).

    ``q``: (n, d) or (d,) curvatures along the columns of ``axes`` (d, d).
    """
    curvatures = np.broadcast_to(q, nu.shape)
    total = np.zeros(len(nu), np.complex128)
    with np.errstate(invalid="ignore"):  # of frequencies that are no numbers
        for element in normal_form(source).in_plane.elements:
            waves = zip(element.amplitudes.tolist(), element.frequencies, strict=True)
            for amplitude, kappa in waves:
                value = _uniform(element.outline, curvatures, axes, centre, nu - kappa)
                total += (element.weight * amplitude) * value
    return total


def _uniform(
    element: Aperture | Slits, q: Floats, axes: Floats, centre: Floats, nu: Floats
) -> Complex:
    """About the middle o of the element: x = o + y, with y in the axes of the wave."""
    middle = np.atleast_1d(np.asarray(element.centre, dtype=np.float64))
    away = (middle - centre) @ axes
    inner = nu @ axes - q * away
    turns = ((q * away) @ away) / 2 - nu @ middle
    phase = np.exp(2j * math.pi * (turns - np.round(turns)))
    values = np.empty(len(nu), np.complex128)
    largest = np.argmax(np.abs(q), axis=1)
    for axis in range(q.shape[1]):
        mine = np.flatnonzero(largest == axis)
        if len(mine):
            values[mine] = _bent(element, middle, axes, axis, q[mine], inner[mine])
    return np.asarray(phase * values)


def _bent(
    element: Aperture | Slits, middle: Floats, axes: Floats, axis: int, q: Floats, nu: Floats
) -> Complex:
    """About the origin, with the larger curvature along one of the axes."""
    if isinstance(element, Slits):
        return chirp_over_intervals(element.intervals - middle, q[:, 0], nu[:, 0])
    order = [axis, 1 - axis]
    turn = axes[:, order]
    rings = tuple((ring - middle) @ turn for ring in element.rings)
    found = chirp_over_rings(rings, q[:, order], nu[:, order])
    return found * np.sign(np.linalg.det(turn))  # exchanged axes turn outlines over


# --- partly coherent light


def coherent_source(source: Wavefront, tilt: Any = None) -> Any:
    """The source in coherent light: a Wavefront if its wave is curved; times exp(2 pi i tilt.x)."""
    flat = source.source if tilt is None else normal_form(source.source).tilted(tilt).public
    return Wavefront(flat, source.curvature, source.centre).coherent


def degree_of_coherence(source: Wavefront, xi: Any) -> Any:
    """exp(-xi^2/(2 width^2)) of lags (..., d), (...): (PC1)."""
    with np.errstate(over="ignore"):
        scaled = np.asarray(xi, dtype=np.float64) / source.coherence_width
        return np.exp(-0.5 * np.square(scaled).sum(axis=-1))


def tilts_of(source: Wavefront, error: float, longest: float = math.inf) -> tuple[Floats, Floats]:
    """Tilts (n, d) in 1/m and weights (n,), whose mean of the source's light errs by ``error``.

    Relative to the largest that it could be if all of the source were in phase. ``longest``: lag in
    m along each axis, of the mean of a number to which longer ones add next to nothing.

    Raises ArgumentError for a width so small that there would be too many.
    """
    sides = _sides(source)
    reaches = np.minimum(sides, longest) / source.coherence_width
    if math.prod(1.0 + reaches) > kernels.MOST_WIDTHS:
        least = (math.prod(sides.tolist()) / kernels.MOST_WIDTHS) ** (1 / len(sides))
        raise ArgumentError(
            f"expected a width of coherence of at least {least:.3g} m for a source of "
            f"{' x '.join(f'{side:.3g}' for side in sides)} m, got {source.coherence_width:.3g} m, "
            "a sum over too many tilts; polywigner.wigner takes any width, except for arrays of "
            "hundreds of elements"
        )
    nodes, weights = normal_product_rule(tuple(reaches.tolist()), error)
    return nodes / (2 * math.pi * source.coherence_width), weights


def _sides(source: Wavefront) -> Floats:
    """The sides of the source's box, (d,) in m."""
    return np.asarray(np.subtract(*np.reshape(source.bounds, (2, -1))[::-1]))


def is_thin(wave: Wavefront) -> bool:
    """Whether single precision, with an error of 1e-7 of the squared longest lag, does not do."""
    if wave.dimension == 1:
        return False
    area = sum(element.area for element in wave.source.elements_in_plane)
    return float(np.square(_sides(wave)).sum()) > _THIN * area


def within_widths(
    closed_form: Callable[..., Any],
    of_coherent: Callable[..., Any],
    wave: Wavefront,
    x: Any,
    nu: Any,
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
