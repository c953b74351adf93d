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
        for source, forms in self.sources:
            total += engines.evaluate_sums(
                ray_kernel(source, self.order),
                source,
                *rule,
                points,
                (self.wavelength, *forms),
                double=self.double,
                engine=self.engine,
            )
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
