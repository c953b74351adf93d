"""Outlines in their frame: the edges of all elements, with weights and fields."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from polywigner.geometry import Aperture
from polywigner.kernels.outline.frame import Frame, frame_of
from polywigner.kernels.outline.wave_pairs import (
    UNIFORM,
    Waves,
    carrier_of,
    difference_pairs,
    waves_in_frame,
)
from polywigner.source.normal_form import Source

# Cost of each further wave on an edge, relative to the cost of cutting the edge by another edge.
_EDGES_PER_WAVE = 24
# Largest number of edges that are compiled as code. Edges as code are two to four times as fast as
# edges as data, but take 1 ms to compile for each pair of edges and each wave
# (benchmarks/wigner_cost.py).
_MOST_EDGES_AS_CODE = 16

Floats = npt.NDArray[np.float64]


# Comparison by identity is fast.
@dataclass(frozen=True, eq=False)
class Tables:
    """The elements of a coherent source as edges, weights and fields, in one frame."""

    frame: Frame
    edges: Floats
    """Shape (n, 6): start and end of each edge, and complex weight of its element."""
    names: npt.NDArray[np.intp]
    """Shape (n, 4): indices of the vertices at which each edge begins and ends, of its element, and
    of its group."""
    apertures: tuple[Aperture, ...]
    """The elements in the plane of the source."""
    weights: tuple[Any, ...]
    """Complex weights of the elements, relative to the field of their group."""
    factors: tuple[complex, ...]
    """Weight of each element divided by the user's weight, one factor for each element."""
    groups: tuple[Waves, ...]
    """Distinct fields on the elements, without the weights of the elements."""
    double: bool
    coherence: Any = None
    """Matrix that converts lags in the frame to coherence widths; None for coherent light."""
    pairs: dict[Any, Any] = field(default_factory=dict, repr=False)
    """Lists of pairs of edges that can cross, by view, groups, precision and number of cells."""
    lists: dict[Any, Any] = field(default_factory=dict, repr=False)
    """The same lists in the form that NumPy uses, one entry for W and one for A."""

    @cached_property
    def uniform(self) -> bool:
        """Whether all weights are 1."""
        return all(weight == 1.0 for weight in self.weights)

    @cached_property
    def phased(self) -> bool:
        """Whether any weight is complex."""
        return any(weight.imag for weight in self.weights)

    @cached_property
    def clips(self) -> int:
        """Number of pairs of edges, which is the cost of one slice.

        Each wave after the first counts as 24 edges, because it is integrated over each part of an
        edge.
        """
        return len(self.edges) * (len(self.edges) + _EDGES_PER_WAVE * (self.waves_per_cut - 1))

    @cached_property
    def waves_per_cut(self) -> int:
        """Number of plane waves that are integrated over a part of an edge."""
        return max(
            sum(len(difference_pairs(waves, other)) for other in self.groups)
            for waves in self.groups
        )

    @cached_property
    def fits_code(self) -> bool:
        """Whether compiled kernels may have each edge as a constant: for few edges and one wave."""
        is_short = len(self.edges) <= _MOST_EDGES_AS_CODE and self.waves_per_cut == 1
        return is_short and self.coherence is None

    @cached_property
    def by_element(self) -> Tables:
        """The same tables with each element as a separate group of weight 1."""
        edges, names = self.edges.copy(), self.names.copy()
        edges[:, 4:], names[:, 3] = (1.0, 0.0), names[:, 2]
        group_of = dict(zip(self.names[:, 2].tolist(), self.names[:, 3].tolist(), strict=True))
        count = len(self.weights)
        groups = tuple(self.groups[group_of.get(k, 0)] for k in range(count))
        return replace(
            self,
            edges=edges,
            names=names,
            weights=(1.0,) * count,
            groups=groups,
            pairs={},
            lists={},
        )

    def mutual(self, real: Any, imag: Any, level: Any, level_imag: Any) -> tuple[Any, Any]:
        """Return (real, imag) of an element's weight times the conjugate of another weight."""
        if self.uniform:
            return level, 0.0
        if not self.phased:
            return real * level, 0.0
        return real * level + imag * level_imag, imag * level - real * level_imag


def build_tables(source: Source, *, double: bool) -> Tables:
    """Return the tables of the elements of a coherent source, in its plane.

    ``double``: whether the kernels compute in float64 rather than float32.
    """
    elements, groups = source.in_plane.elements, source.in_plane.groups
    frame = frame_of(np.concatenate([ring for element in elements for ring in element.rings]))
    first = [elements[group.members[0]].illumination for group in groups]
    frame = replace(frame, carrier=carrier_of(first, 2))
    factors, group_of = np.ones(len(elements), np.complex128), np.zeros(len(elements), np.intp)
    for number, group in enumerate(groups):
        factors[group.members], group_of[group.members] = group.factors, number
    weights = tuple((source.weights * factors).tolist())
    edges, names, vertices = [], [], 0
    for number, element in enumerate(elements):
        for ring in element.rings:
            start = frame.vertices(ring)
            index = vertices + np.arange(len(ring))
            end, following = (np.roll(values, -1, axis=0) for values in (start, index))
            weight = np.full((len(ring), 2), (weights[number].real, weights[number].imag))
            edges.append(np.hstack([start, end, weight]))
            same = np.full((len(ring), 2), (number, group_of[number]))
            names.append(np.column_stack([index, following, same]))
            vertices += len(ring)
    return Tables(
        frame,
        np.concatenate(edges),
        np.concatenate(names),
        tuple(element.shape for element in elements),
        weights,
        tuple(factors.tolist()),
        tuple(waves_in_frame(illumination, frame) for illumination in first),
        double,
    )


def is_plain(tables: Tables) -> bool:
    """Return whether the source has unit weights, full coherence and no waves."""
    return tables.groups == (UNIFORM,) and tables.uniform and tables.coherence is None
