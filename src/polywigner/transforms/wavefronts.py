"""Transforms of curved and partially coherent sources.

The Fourier transform of a curved wave is a sum of Fresnel integrals along edges. Partial coherence
multiplies A and R by the degree of coherence exp(-xi^2/(2 width^2)), equation (PC3). This degree is
the mean of exp(2 pi i t.xi) over normally distributed tilts t with the standard deviation 1/(2 pi
width), equation (PC2). W has a closed form, equation (I5). Power spectra, exact fields and the W of
large arrays are averages over tilts. The number of tilts depends on the longest lag, which is the
size of the bounding box.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from polywigner import kernels
from polywigner.errors import ArgumentError, IlluminationError
from polywigner.geometry import Aperture, Slits, Wavefront
from polywigner.geometry.rings import sides_of
from polywigner.numerics import Complex, Floats, index_blocks
from polywigner.numerics.chirps import chirp_over_intervals, chirp_over_rings, waves_of_cycles
from polywigner.numerics.nodes import gaussian_product_rule
from polywigner.source.normal_form import normal_form
from polywigner.transforms.checked_calls import Values, broadcast_shape

TILT_ERROR = {True: 1e-11, False: 1e-7}
"""Error of averages over tilts in double and single precision, relative to the largest A."""

# Largest ratio of the coherence width to the diagonal of a source, in double (True) and single
# precision, for which the closed form of W is used. The closed form loses digits by cancellation at
# larger ratios, so W is computed as the coherent W plus a term proportional to 1/width^2. The next
# term is 1.3e-13 of W in double and 8e-7 of W in single precision.
_WIDEST = {True: 1e3, False: 20.0}

_BLOCK = 1 << 20


def flat_source(source: Any) -> Any:
    """Return the flat source of a Wavefront. Any other source is returned unchanged."""
    return source.source if isinstance(source, Wavefront) else source


def checked_wavefront(wave: Wavefront) -> Wavefront:
    """Return the source, or raise IlluminationError if it is not coherent."""
    if not wave.is_coherent:
        raise IlluminationError(
            "expected a coherent source, got one with a coherence width of "
            f"{wave.coherence_width:g} m, whose field has no phase; use polywigner.irradiance "
            "or radiant_intensity"
        )
    return wave


def is_partly_coherent(source: Any) -> bool:
    """Return whether the coherence width of a source is finite."""
    return isinstance(source, Wavefront) and not source.is_coherent


def principal_axes(curvature: Floats) -> tuple[Floats, Floats]:
    """Return the principal curvatures, and their axes as the columns of an orthogonal matrix.

    The curvatures are not sorted by magnitude, and the axes may be left-handed.
    """
    if not np.any(curvature - np.diag(np.diagonal(curvature))):
        return np.diagonal(curvature).copy(), np.eye(len(curvature))
    values, axes = np.linalg.eigh(curvature)
    return values, axes


def chirp_transform(source: Any, q: Floats, axes: Floats, centre: Floats, nu: Floats) -> Complex:
    """Return the Fourier transform (n,) of a source with a quadratic phase, at nu (n, d).

    The transform is int u(x) exp(i pi (x - c).Q (x - c) - 2 pi i nu.x) dx, where u is the field of
    the source and c is ``centre``. The matrix Q has the principal curvatures ``q`` along the
    columns of ``axes``.
    """
    curvatures = np.broadcast_to(q, nu.shape)
    total = np.zeros(len(nu), np.complex128)
    # NaN frequencies give NaN without a warning.
    with np.errstate(invalid="ignore"):
        for element in normal_form(source).in_plane.elements:
            waves = zip(element.amplitudes.tolist(), element.frequencies, strict=True)
            for amplitude, kappa in waves:
                value = _chirp_of_outline(element.outline, curvatures, axes, centre, nu - kappa)
                total += (element.weight * amplitude) * value
    return total


def _chirp_of_outline(
    element: Aperture | Slits, q: Floats, axes: Floats, centre: Floats, nu: Floats
) -> Complex:
    """Return the :func:`chirp_transform` of one uniform outline. ``q`` has the shape of ``nu``."""
    origin = np.atleast_1d(np.asarray(element.centre, dtype=np.float64))
    away = (origin - centre) @ axes
    inner = nu @ axes - q * away
    cycles = ((q * away) @ away) / 2 - nu @ origin
    phase = waves_of_cycles(cycles)
    values = np.empty(len(nu), np.complex128)
    largest = np.argmax(np.abs(q), axis=1)
    for axis in range(q.shape[1]):
        rows = np.flatnonzero(largest == axis)
        if len(rows):
            values[rows] = _centred_chirp(element, origin, axes, axis, q[rows], inner[rows])
    return np.asarray(phase * values)


def _centred_chirp(
    element: Aperture | Slits, origin: Floats, axes: Floats, axis: int, q: Floats, nu: Floats
) -> Complex:
    """Return the chirp transform of an outline whose coordinates are relative to ``origin`` (d,).

    ``q`` and ``nu`` (n, d) are components along the principal axes. ``axis`` is the index of the
    principal axis with the largest curvature.
    """
    if isinstance(element, Slits):
        return chirp_over_intervals(element.intervals - origin, q[:, 0], nu[:, 0])
    order = [axis, 1 - axis]
    rotation = axes[:, order]
    rings = tuple((ring - origin) @ rotation for ring in element.rings)
    values = chirp_over_rings(rings, q[:, order], nu[:, order])
    # Exchanged axes reverse the orientation of the outline.
    return values * np.sign(np.linalg.det(rotation))


def coherent_source(source: Wavefront, tilt: Any = None) -> Any:
    """Return a coherent source with the same curved wave, optionally times exp(2 pi i tilt.x).

    The tilt is in 1/m.
    """
    flat = source.source if tilt is None else normal_form(source.source).tilted(tilt).public
    return Wavefront(flat, source.curvature, source.centre).coherent


def degree_of_coherence(source: Wavefront, xi: ArrayLike) -> Floats:
    """Return the degree of coherence exp(-xi^2/(2 width^2)) at lags xi (..., d), equation (PC1)."""
    with np.errstate(over="ignore"):
        scaled = np.asarray(xi, dtype=np.float64) / source.coherence_width
        return np.exp(-0.5 * np.square(scaled).sum(axis=-1))


def tilts_of(source: Wavefront, error: float, longest: float = math.inf) -> tuple[Floats, Floats]:
    """Return the tilts (n, d) in 1/m and their weights for averages with the specified error.

    The error is relative to the value for a source whose points are all in phase. The weights have
    the sum 1. ``longest`` is the largest lag in m along each axis that contributes. Raises
    ArgumentError if the average needs too many tilts.
    """
    sides = sides_of(source.bounds)
    lags_in_widths = np.minimum(sides, longest) / source.coherence_width
    if math.prod(1.0 + lags_in_widths) > kernels.MOST_WIDTHS:
        least = (math.prod(sides.tolist()) / kernels.MOST_WIDTHS) ** (1 / len(sides))
        raise ArgumentError(
            f"expected a coherence width of at least {least:.3g} m for a source of "
            f"{' x '.join(f'{side:.3g}' for side in sides)} m, got "
            f"{source.coherence_width:.3g} m, which would need too many tilts; use a larger width, "
            "or polywigner.wigner, which accepts any width unless the source is an array of "
            "hundreds of elements"
        )
    nodes, weights = gaussian_product_rule(tuple(lags_in_widths.tolist()), error)
    return nodes / (2 * math.pi * source.coherence_width), weights


def wigner_at_any_width(
    closed_form: Callable[..., Any],
    of_coherent: Callable[..., Any],
    wave: Wavefront,
    x: Any,
    nu: Any,
    double: bool,
) -> Values:
    """Return the Wigner function of a source with any coherence width.

    ``closed_form(source, x, nu)`` is accurate up to a largest width. Beyond this width, the result
    is extrapolated from the value at this width and from ``of_coherent(x, nu)``.
    """
    most, width = _WIDEST[double] * math.hypot(*sides_of(wave.bounds)), wave.coherence_width
    values = closed_form(wave._with(coherence_width=min(width, most)), x, nu)
    if width <= most:
        return values
    limit = of_coherent(x, nu)
    return limit + (values - limit) * (most / width) ** 2


def mean_over_tilts(
    evaluate: Callable[..., Any], source: Wavefront, nu: Any, *others: Any, double: bool
) -> Values:
    """Return the mean of ``evaluate(*others, nu - t)`` over the tilts t of a source.

    ``nu`` and ``others`` broadcast. The tilts form the last axis of the samples, so each slice is
    computed once for all tilts.
    """
    tilts, weights = tilts_of(source, TILT_ERROR[double])
    arrays = [np.asarray(points) for points in (*others, nu)]
    shape = broadcast_shape(arrays)

    def mean(*parts: Any) -> Values:
        """Return the mean for points that fit into memory with all tilts."""
        *positions, frequency = parts
        spread = [points[..., None, :] for points in positions]
        values = evaluate(*spread, frequency[..., None, :] - tilts)
        return values @ weights.astype(values.real.dtype)

    if math.prod(shape) * len(weights) <= _BLOCK:
        return mean(*arrays)[()]
    flat = [np.broadcast_to(a, (*shape, a.shape[-1])).reshape(-1, a.shape[-1]) for a in arrays]
    blocks = index_blocks(len(flat[0]), _BLOCK // len(weights))
    parts = [mean(*(a[block] for a in flat)) for block in blocks]
    return np.concatenate(parts).reshape(shape)
