"""Irradiance of partially coherent light: the choice of the sum.

The degree of coherence is the mean of exp(2 pi i t.xi) over normal tilts t of the standard
deviation 1/(2 pi width) (PC2). Parabolic waves have a convolution (:mod:`.convolutions`). The
fields of all tilts share samples of the source (:mod:`.tilt_sums`). Widths far below the size of
the source leave short lags only (:mod:`.lag_sums`). The last resort computes the field of one tilt
after another.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polywigner.errors import ArgumentError
from polywigner.geometry import Wavefront
from polywigner.optics import FirstOrder
from polywigner.propagation.convolutions import blur_of, convolved
from polywigner.propagation.lag_sums import pair_sum, summed_over_lags, summed_over_pairs
from polywigner.propagation.source_samples import highest
from polywigner.propagation.tilt_sums import summed_over_tilts, tilt_sum
from polywigner.source.obliquities import CONDITIONS
from polywigner.transforms.wavefronts import coherent_source, flat_of, tilts_of

Floats = NDArray[np.float64]

# Coherence widths along the source from which on sums over short lags are considered.
_MANY = 30.0
# Standard deviations of the tilts, beyond which waves may graze the plane.
_GRAZING = 5.0
# Nanoseconds for each point that are not spent on pairs.
_MOST_COST = 1e10
# Nanoseconds of a wavelength along the outline, and of an edge, for integrals along edges.
_WAVELENGTH, _EDGE = 250.0, 1e4


def partly_coherent_irradiance(
    compute: Callable[[Any, Floats], Any],
    source: Wavefront,
    points: Floats,
    wavelength: float,
    method: str,
    system: FirstOrder | None,
    error: float,
) -> Floats | None:
    """Irradiance (k, n) at points (n, 2) behind a system, or (n, 3); None for a mean over tilts.

    ``compute`` : a coherent source and points to irradiances (k, n), k = 2 with errors.
    ``error`` : of the mean, relative to the largest irradiance.
    """
    if system is None and method != "fresnel":
        if method not in CONDITIONS:
            return None
        compute(coherent_source(source), points[:1])  # for the checks of all arguments
        return _of_spherical_waves(source, points, wavelength, method, error)
    planes, owner = [system] if system is not None else [], np.zeros(len(points), np.intp)
    if system is None:
        heights, owner = np.unique(points[:, 2], return_inverse=True)
        planes = [FirstOrder.free_space(height) for height in heights.tolist()]
    groups = [points[owner == k, :2] for k in range(len(planes))]
    blurs = [blur_of(source, plane.B, wavelength) for plane in planes]
    order = np.argsort(np.argsort(owner, kind="stable"), kind="stable")

    def by_lags() -> Floats | None:
        parts = []
        for group, plane in zip(groups, planes, strict=True):
            if not abs(np.linalg.det(plane.B)) > 0.0:
                return None
            part = summed_over_lags(source, group, wavelength, plane, error)
            if part is None:
                return None
            parts.append(part)
        return _with_error(np.concatenate(parts)[order], error)

    def by_convolution() -> Floats | None:
        lit = coherent_source(source)

        def fields(places: list[Floats]) -> Floats:
            if system is None:
                places = [
                    np.column_stack([x, np.full(len(x), z)])
                    for x, z in zip(places, heights.tolist(), strict=True)
                ]
            return np.asarray(compute(lit, np.concatenate(places)))

        found = convolved(fields, groups, blurs, error)
        if found is None:
            return None
        found[1:] += error * float(found[0].max(initial=0.0))
        return found[..., order]

    many = max(float(blur.reaches.max()) for blur in blurs) > _MANY
    forms = [by_lags, by_convolution] if many else [by_convolution, by_lags]
    first = forms[0]()
    return forms[1]() if first is None else first


def _of_spherical_waves(
    source: Wavefront, points: Floats, wavelength: float, method: str, error: float
) -> Floats | None:
    """Irradiance by the cheapest sum, over tilts or pairs; None for one field after another."""
    cost = _cost_of_fields(source, wavelength, error)
    rule = tilt_sum(source, points, wavelength, method, error)
    if rule is not None and rule.cost < cost:
        cost = rule.cost
    else:
        rule = None
    if _is_short(source) and (not CONDITIONS[method].takes_slopes or _is_steep(source, wavelength)):
        pairs = pair_sum(source, points, wavelength, method)
        if pairs.cost < min(cost, _MOST_COST):
            found = summed_over_pairs(pairs, source, points, wavelength, method, error)
            if found is not None:
                return _with_error(found, error)
    if rule is None:
        return None
    return _with_error(summed_over_tilts(rule), error)


def _cost_of_fields(source: Wavefront, wavelength: float, error: float) -> float:
    """Estimated nanoseconds for each point of the fields of all tilts, by integrals along edges."""
    try:
        count = len(tilts_of(source, error)[1])
    except ArgumentError:  # too many
        return math.inf
    elements = flat_of(source).elements_in_plane
    around = sum(element.polygons.length for element in elements) / wavelength
    edges = sum(len(ring) for element in elements for ring in element.rings)
    return float(count * (around * _WAVELENGTH + edges * _EDGE))


def _is_short(source: Wavefront) -> bool:
    size = np.subtract(*np.reshape(source.bounds, (2, 2))[::-1])
    return bool((size > _MANY * source.coherence_width).all())


def _is_steep(source: Wavefront, wavelength: float) -> bool:
    """Whether next to no tilted wave of a flat source grazes the plane, where p_z has a branch."""
    steepest = highest(source) + _GRAZING / (2 * math.pi * source.coherence_width)
    return source.is_flat and wavelength * steepest < 1.0


def _with_error(values: Floats, error: float) -> Floats:
    return np.stack([values, np.full(len(values), error * float(values.max(initial=0.0)))])
