"""Irradiance of partly coherent light as a sum over tilts that share nodes on the source."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from polywigner.execution.progress import told
from polywigner.geometry import Wavefront
from polywigner.illumination import Array, Illumination
from polywigner.illumination.obliquities import CONDITIONS, direction_cosines
from polywigner.propagation.arrangement import gauss_rule, node_count, triangulated
from polywigner.propagation.source_samples import (
    field_at,
    largest_slopes,
    slope,
)
from polywigner.transforms.wavefronts import flat_of

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]
Indices = NDArray[np.intp]

# Nodes along a side of a triangle beyond those of the phase, for 1e-9 of the field; and cycles of
# phase that stand for the pole of the kernel at a distance, which lies as far off the plane.
_EXTRA, _POLE = 8.0, 1.6
# Share of the largest tilt, whose weight is next to nothing, that the nodes resolve.
_STEEPEST = 0.7
# Nanoseconds of a node for each tilt; of a wavelength along the outline, and of an edge, whose
# integrals take the place of nodes.
_NODE, _WAVELENGTH, _EDGE = 0.7, 250.0, 1e4
# Pairs of a point and a node, and nodes at a time.
_MATRIX, _NODES = 1 << 20, 1 << 12


class NodeSum(NamedTuple):
    """Fields of all tilts as sums over the same nodes on the source."""

    nodes: Floats
    fields: list[tuple[Complex, Complex]]
    """Weights (n,) of the rule times a field, and its cosines p_z (t,) with each tilt."""
    tilts: Floats
    shares: Floats

    @property
    def cost(self) -> float:
        """About how many nanoseconds it takes for each point."""
        return _NODE * len(self.nodes) * len(self.fields) * len(self.shares)


def node_sum(
    source: Wavefront, points: Floats, wavelength: float, method: str, rule: tuple[Floats, Floats]
) -> NodeSum | None:
    """The sum for points (n, 3); None where integrals along edges take less time.

    ``rule`` : tilts and their shares, of :func:`tilts_of`.
    """
    has_slopes = CONDITIONS[method].takes_slopes
    if has_slopes and not source.is_flat:
        return None
    flat, (tilts, shares) = flat_of(source), rule
    rate = float(largest_slopes(source, points, wavelength).max(initial=0.0))
    rate += _STEEPEST * float(np.linalg.norm(tilts, axis=1).max(initial=0.0))
    rate = max(rate, _POLE / float(points[:, 2].min(initial=math.inf)))
    elements = [(flat, 1.0)]
    if isinstance(flat, Array):
        elements = list(zip(flat.elements_in_plane, flat.weights.tolist(), strict=True))
    triangles = [triangulated(list(element.polygons.geoms)) for element, _ in elements]
    count = sum(node_count(found, rate, _EXTRA) for found in triangles)
    if not count * _NODE <= cost_of_edges(source, wavelength):
        return None
    rules = [gauss_rule(found, rate, _EXTRA) for found in triangles]
    nodes = np.concatenate([x for x, _ in rules])
    if not has_slopes:
        parts = [w * a * field_at(e, x) for (x, a), (e, w) in zip(rules, elements, strict=True)]
        field = np.concatenate(parts) * _curved_wave(source, nodes)
        return NodeSum(nodes, [(field, np.zeros(len(tilts), np.complex128))], tilts, shares)
    ends = np.cumsum([0, *(len(a) for _, a in rules)])
    fields: dict[tuple[float, ...], Complex] = {}
    for k, ((x, a), (element, w)) in enumerate(zip(rules, elements, strict=True)):
        own = element.illumination or Illumination([1.0], [(0.0, 0.0)])
        for amplitude, kappa in zip(own.amplitudes, own.frequencies, strict=True):
            wave = fields.setdefault(tuple(kappa.tolist()), np.zeros(len(nodes), np.complex128))
            wave[ends[k] : ends[k + 1]] += w * a * amplitude * np.exp(2j * np.pi * (x @ kappa))
    waves = [(f, direction_cosines(tilts + k, wavelength)) for k, f in fields.items()]
    return NodeSum(nodes, waves, tilts, shares)


def _curved_wave(source: Wavefront, x: Floats) -> Complex:
    away = x - source.centre
    return np.asarray(np.exp(1j * np.pi * ((away @ source.curvature) * away).sum(axis=1)))


def summed_over_nodes(rule: NodeSum, points: Floats, wavelength: float, method: str) -> Floats:
    """Irradiance (n,) at points (n, 3), by (Q7)."""
    condition = CONDITIONS[method]
    found = np.empty(len(points))
    step = max(1, _MATRIX // max(_NODES, len(rule.shares)))
    k = 2 * math.pi / wavelength
    with told("points", range(0, len(points), step)) as starts:
        for start in starts:
            some = points[start : start + step]
            total = np.zeros((len(some), len(rule.shares)), np.complex128)
            for first in range(0, len(rule.nodes), _NODES):
                x = rule.nodes[first : first + _NODES]
                tilted = np.exp(2j * math.pi * (x @ rule.tilts.T))
                squares = ((some[:, None, :2] - x) ** 2).sum(axis=-1)
                height = some[:, 2, None]
                reach = np.sqrt(squares + height**2)
                # the phase relative to that of the height, whose turns would be rounded
                turns = squares / (reach + height) / wavelength
                waves = np.exp(2j * math.pi * turns) / (1j * wavelength * reach)
                rise = slope(height, reach, k)
                for field, cosines in rule.fields:
                    lit = waves * field[first : first + _NODES]
                    total += condition.field * ((lit * rise) @ tilted)
                    if condition.slope:
                        total += condition.slope * cosines * (lit @ tilted)
            found[start : start + step] = np.square(np.abs(total)) @ rule.shares
    return found


def cost_of_edges(source: Wavefront, wavelength: float) -> float:
    """About how many nanoseconds the field at a point takes by integrals along edges."""
    elements = flat_of(source).elements_in_plane
    around = sum(element.polygons.length for element in elements) / wavelength
    edges = sum(len(ring) for element in elements for ring in element.rings)
    return float(around * _WAVELENGTH + edges * _EDGE)
