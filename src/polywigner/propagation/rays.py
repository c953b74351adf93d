"""Irradiance by Wigner rays: sums over places on the source, for many points at once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polywigner import engines
from polywigner.engines import Engine
from polywigner.geometry import Aperture
from polywigner.illumination import Array
from polywigner.propagation.obliquities import Forms
from polywigner.propagation.ray_kernels import ray_kernel
from polywigner.propagation.rays_rules import Rule

__all__ = ["Rays"]

Values = NDArray[np.float64]

# Pairs of a place and a point at a time: 32 MiB of results in float64, and some times as much while
# they are computed.
_BLOCK = 1 << 22


@dataclass(frozen=True)
class Rays:
    """What is summed, and how."""

    sources: Sequence[tuple[Aperture | Array, Forms]]
    """Those of :func:`polywigner.propagation.obliquities.weighted_sources`."""
    wavelength: float
    order: int
    engine: Engine
    double: bool

    def irradiance(self, rule: Rule, points: Values) -> Values:
        """The sum over a rule's nodes at points (n, 3), (n,)."""
        total = np.zeros(len(points))
        for nodes, columns in _blocks(rule, points):
            values = self.integrand(nodes[0], points[columns])
            total[columns] += values @ nodes[1]
        return total

    def integrand(self, places: Values, points: Values) -> Values:
        """What each place (m, 2) contributes per area at each point (n, 3): (n, m)."""
        total: Any = 0.0
        place, point = places.T[:, None, :], points.T[:, :, None]
        for source, forms in self.sources:
            constants = [np.array(value) for value in (self.wavelength, *forms)]
            (values,) = engines.evaluate(
                ray_kernel(source, self.order),
                source,
                [*place, *point, *constants],
                double=self.double,
                engine=self.engine,
                outputs=1,
            )
            total = total + values
        result: Values = total
        return result


def _blocks(rule: Rule, points: Values) -> Any:
    """(part of the rule, points) of about equal size."""
    nodes, weights = rule
    step = max(1, _BLOCK // max(1, len(points)))
    if len(nodes) <= _BLOCK:
        step = len(nodes)
    for start in range(0, len(nodes), step):
        part = nodes[start : start + step], weights[start : start + step]
        width = max(1, _BLOCK // len(part[0]))
        for low in range(0, len(points), width):
            yield part, slice(low, low + width)
