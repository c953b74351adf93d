"""Irradiance by Wigner rays: sums over places on the source, for many points at once."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polywigner import execution
from polywigner.execution import Engine
from polywigner.geometry import Aperture, Wavefront
from polywigner.illumination import Array
from polywigner.illumination.obliquities import Forms
from polywigner.kernels import Kernel, kernel_for, tables_of
from polywigner.kernels.cut.slice_parts import slice_parts
from polywigner.propagation.ray_kernels import part_kernel, ray_kernel
from polywigner.propagation.rays_rules import Rule

__all__ = ["Rays"]

Values = NDArray[np.float64]

# Cuts that are made in NumPy beforehand, a few seconds' work; of more edges or places they are part
# of the kernel.
_MOST_CUTS = 1 << 29
# Edges of all places whose parts are held at a time: of each perhaps one, in some 100 bytes.
_EDGES_AT_ONCE = 1 << 20


@dataclass(frozen=True)
class Rays:
    """A sum over rays: its sources, and its settings."""

    sources: Sequence[tuple[Aperture | Array, Forms]]
    """Sources and forms as of :func:`polywigner.illumination.obliquities.weighted_sources`."""
    wavelength: float
    order: int
    engine: Engine
    double: bool
    curved: tuple[float, ...] = ()
    """Of a curved wave on all sources: Q_xx, Q_xy, Q_yy, and its centre."""
    coherence_width: float = math.inf
    """Of the light, in m; finite to leading order only."""

    @property
    def is_partly_coherent(self) -> bool:
        return self.coherence_width < math.inf

    def _lit(self, source: Aperture | Array) -> Any:
        """A source with this light, as kernels take it."""
        if not self.is_partly_coherent:
            return source
        return Wavefront(source, coherence_width=self.coherence_width)

    def irradiance(self, rule: Rule, points: Values) -> Values:
        """The sum over a rule's nodes at points (n, 3), (n,)."""
        total = np.zeros(len(points))
        for source, forms in self.sources:
            for kernel, places, weights in self._listed(source, rule):
                total += execution.evaluate_sums(
                    kernel,
                    self._lit(source),
                    places,
                    weights,
                    points,
                    (self.wavelength, *forms, *self.curved),
                    double=self.double,
                    engine=self.engine,
                )
        return total

    def _listed(
        self, source: Aperture | Array, rule: Rule
    ) -> Iterator[tuple[Kernel, Values, Values]]:
        """Kernels, and what to sum them over: parts of slices, or places as they are."""
        nodes, weights = rule
        if not self._is_by_parts(source, len(nodes)):
            yield ray_kernel(self._lit(source), self.order, bool(self.curved)), nodes, weights
            return
        tables = tables_of(source, True)
        host = execution.NumpyOperations(double=True)
        step = max(1, _EDGES_AT_ONCE // len(tables.edges))
        for start in range(0, len(nodes), step):
            some, share = nodes[start : start + step], weights[start : start + step]
            inner = tables.frame.position(host, *some.T)
            owners, rows = slice_parts(host, tables, *inner)
            yield (
                part_kernel(self.order, bool(self.curved), self.is_partly_coherent),
                np.column_stack([some[owners], rows]),
                share[owners],
            )

    def _is_by_parts(self, source: Aperture | Array, places: int) -> bool:
        """Whether W is a sum over the edges of all elements, not one of an array's short cuts.

        And there are not so many edges that finding those which matter is most of the work.
        """
        by_edges = self.order == 3 or kernel_for("wigner", source).slices is not None
        return by_edges and tables_of(source, True).clips * places <= _MOST_CUTS

    def integrand(self, places: Values, points: Values) -> Values:
        """Irradiance per area from each place (m, 2) at each point (n, 3), (n, m)."""
        total: Any = 0.0
        place, point = places.T[:, None, :], points.T[:, :, None]
        for source, forms in self.sources:
            numbers = (self.wavelength, *forms, *self.curved)
            constants = [np.array(value) for value in numbers]
            (values,) = execution.evaluate(
                ray_kernel(self._lit(source), self.order, bool(self.curved)),
                self._lit(source),
                [*place, *point, *constants],
                double=self.double,
                engine=self.engine,
                outputs=1,
            )
            total = total + values
        result: Values = total
        return result
