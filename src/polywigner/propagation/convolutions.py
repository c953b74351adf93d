"""Irradiance of partly coherent light in parabolic waves, as a convolution.

A tilt of the source shifts its irradiance as it is. The mean over normal tilts of the standard
deviation 1/(2 pi width) (PC2) is a convolution with a normal density, which the points of a plane
share.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from polywigner.geometry import Wavefront
from polywigner.numerics.nodes import normal_product_rule

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]
Indices = NDArray[np.intp]

# Points of one lattice, and of all lattices, at which fields are computed.
_MOST_IN_LATTICE, _MOST_POINTS = 1 << 24, 1 << 22
# Points and neighbours at a time.
_BLOCK = 1 << 22


class _Share(NamedTuple):
    """Points (m, 2) at which the coherent irradiance is needed, and the mean of its values."""

    points: Floats
    mean: Callable[[Floats], Floats]


class Blur(NamedTuple):
    """The normal density of the shifts of an irradiance by tilts."""

    axes: Floats
    """(2, 2), columns: its principal directions in the plane of the points."""
    spreads: Floats
    """(2,) its standard deviations along them in m."""
    reaches: Floats
    """(2,) sides of the source, in coherence widths, that interfere along them."""


def blur_of(source: Wavefront, transfer: Floats, wavelength: float) -> Blur:
    """The blur by the tilts of a source: a tilt t shifts points by wavelength ``transfer`` t.

    ``transfer`` : (2, 2) in m, B of a first-order system.
    """
    axes, scales, right = np.linalg.svd(transfer)
    size = np.subtract(*np.reshape(source.bounds, (2, 2))[::-1])
    reaches = (abs(right) @ size) / source.coherence_width
    spreads = wavelength * scales / (2 * math.pi * source.coherence_width)
    return Blur(axes, spreads, reaches)


def convolved(
    compute: Callable[[list[Floats]], Floats], groups: list[Floats], blurs: list[Blur], error: float
) -> Floats | None:
    """Irradiances at points of several planes, (n, 2) each, blurred; None for too many points.

    ``compute`` : points of each plane -> coherent irradiances (k, m) of all of them.
    ``error`` : relative to the largest irradiance. The rules are the trapezoidal rule on a lattice
    that the points of a plane share, and Gauss-Hermite's at each point: the one of fewer fields.
    """
    shares = [
        _share_of(points, blur, error) for points, blur in zip(groups, blurs, strict=True)
    ]  # fmt: skip
    if any(share is None for share in shares):
        return None
    parts = [share for group in shares if group is not None for share in group]
    if sum(len(share.points) for share in parts) > _MOST_POINTS:
        return None
    counts = [sum(len(share.points) for share in group or ()) for group in shares]
    values = compute(
        [np.concatenate([share.points for share in group or ()]) for group in shares]
    )  # fmt: skip
    assert values.shape[-1] == sum(counts)
    ends = np.cumsum([len(share.points) for share in parts])[:-1]
    pieces = np.split(values, ends, axis=-1)
    found = [share.mean(piece) for share, piece in zip(parts, pieces, strict=True)]
    return np.concatenate(found, axis=-1)


def _share_of(points: Floats, blur: Blur, error: float) -> list[_Share] | None:
    """Where the irradiance is needed for points (n, 2) of a plane; in parts if they lie far off."""
    steps = math.sqrt(2.0 * math.log(16.0 / error))
    along = points @ blur.axes
    axes = [
        _lattice_axis(along[:, k], float(blur.spreads[k]), float(blur.reaches[k]), steps)
        for k in (0, 1)
    ]
    size = math.prod(len(axis.places) for axis in axes)
    if size > _MOST_IN_LATTICE:
        if len(points) == 1:
            return None
        axis = int(np.ptp(along, axis=0).argmax())
        order = np.argsort(along[:, axis], kind="stable")
        halves = np.array_split(order, 2)
        shares: list[_Share] = []
        for half in halves:
            part = _share_of(points[half], blur, error)
            if part is None:
                return None
            shares += part
        return [_joined(shares, order)]
    return [_cheapest(points, along, axes, blur, error)]


def _joined(shares: list[_Share], order: Indices) -> _Share:
    """Join shares of points, which are the points ``order`` one after another."""
    ends = np.cumsum([len(share.points) for share in shares])[:-1]

    def mean(values: Floats) -> Floats:
        pieces = np.split(values, ends, axis=-1)
        found = np.concatenate(
            [share.mean(piece) for share, piece in zip(shares, pieces, strict=True)], axis=-1
        )
        result = np.empty_like(found)
        result[..., order] = found
        return result

    return _Share(np.concatenate([share.points for share in shares]), mean)


class _Axis(NamedTuple):
    """Places (m,) of a lattice along an axis; those near points (n, k), and their weights."""

    places: Floats
    near: Indices
    weights: Floats


def _lattice_axis(along: Floats, spread: float, reach: float, steps: float) -> _Axis:
    """The trapezoidal rule for a normal density about points (n,), on one lattice.

    The irradiance has frequencies up to reach/(2 pi spread), so that steps of
    2 pi spread/(reach + steps) leave exp(-steps^2/2) of it by aliases.
    """
    step = 2 * math.pi * spread / (reach + steps)
    if step <= 1e-12 * float(np.ptp(along)) or spread == 0.0:  # no blur along this axis
        places, near = np.unique(along, return_inverse=True)
        return _Axis(places, near[:, None], np.ones((len(along), 1)))
    half = math.ceil(steps * spread / step)
    origin = float(along.min())
    first = np.rint((along - origin) / step).astype(np.intp)
    near = first[:, None] + np.arange(2 * half + 1)
    places = np.asarray(origin + step * np.arange(-half, int(first.max()) + half + 1))
    away = (places[near] - along[:, None]) / spread
    weights = np.exp(-0.5 * away * away)
    return _Axis(places, near, weights / weights.sum(axis=1, keepdims=True))


def _cheapest(points: Floats, along: Floats, axes: list[_Axis], blur: Blur, error: float) -> _Share:
    """The lattice, or a rule at each point where that takes fewer fields."""
    nodes, weights = normal_product_rule(tuple(blur.reaches.tolist()), error)
    first, second = axes
    needed = np.zeros((len(first.places), len(second.places)), bool)
    step = max(1, _BLOCK // (first.near.shape[1] * second.near.shape[1]))
    blocks = [slice(k, k + step) for k in range(0, len(points), step)]
    for some in blocks:
        needed[first.near[some][:, :, None], second.near[some][:, None, :]] = True
    count = int(np.count_nonzero(needed))
    if (blur.spreads > 0).all() and len(points) * len(weights) < count:
        shifted = along[:, None] + nodes * blur.spreads

        def mean_of_rule(values: Floats) -> Floats:
            return np.asarray(values.reshape(*values.shape[:-1], len(points), -1) @ weights)

        return _Share(shifted.reshape(-1, 2) @ blur.axes.T, mean_of_rule)
    here = np.nonzero(needed)
    places = np.column_stack([first.places[here[0]], second.places[here[1]]])

    def mean_of_lattice(values: Floats) -> Floats:
        table = np.zeros((*values.shape[:-1], *needed.shape))
        table[..., needed] = values
        found = np.empty((*values.shape[:-1], len(points)))
        for some in blocks:
            near = table[..., first.near[some][:, :, None], second.near[some][:, None, :]]
            found[..., some] = np.einsum(
                "...nij,ni,nj->...n", near, first.weights[some], second.weights[some]
            )
        return found

    return _Share(places @ blur.axes.T, mean_of_lattice)
