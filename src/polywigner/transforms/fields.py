"""A source of the plane as weighted outlines, whatever it is made of."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray

from polywigner.geometry import Aperture
from polywigner.illumination import Array, Illumination

__all__ = ["PlaneField", "bound_of", "field_of", "is_lit_by_waves"]


@dataclass(frozen=True, eq=False)
class PlaneField:
    """u = sum of weight_k u_k over outlines that may overlap; real weights for real fields.

    u_k is the illumination of the outline, or 1.
    """

    outlines: tuple[Aperture, ...]
    weights: NDArray[Any]

    @cached_property
    def bounds(self) -> tuple[float, float, float, float]:
        """(xmin, ymin, xmax, ymax) of all outlines."""
        west, south, east, north = self._boxes.T
        return float(west.min()), float(south.min()), float(east.max()), float(north.max())

    @cached_property
    def centre(self) -> NDArray[np.float64]:
        """Centre of the bounds, (2,)."""
        west, south, east, north = self.bounds
        return np.array([west / 2 + east / 2, south / 2 + north / 2])

    @cached_property
    def is_lit(self) -> bool:
        """Whether there are waves on an outline."""
        return any(outline.illumination is not None for outline in self.outlines)

    def waves(self, k: int) -> tuple[NDArray[np.complex128], NDArray[np.float64]]:
        """Amplitudes (m,) at the centre and frequencies (m, 2) of the waves on an outline."""
        illumination = self.outlines[k].illumination
        if illumination is None:
            return np.ones(1, np.complex128), np.zeros((1, 2))
        centred = illumination.moved(-self.centre)
        return centred.amplitudes, centred.frequencies

    @cached_property
    def content(self) -> float:
        """Bound on |F|: the areas times the moduli of the weights."""
        return float(sum(o.area * w for o, w in zip(self.outlines, abs(self.weights), strict=True)))

    @cached_property
    def amplitude(self) -> float:
        """Bound on |u|: of all elements whose boxes meet that of one, the moduli add up."""
        boxes = shapely.box(*self._boxes.T)
        first, second = shapely.STRtree(boxes).query(boxes, predicate="intersects")
        totals = np.zeros(len(boxes))
        np.add.at(totals, first, abs(self.weights)[second])
        return float(totals.max())

    @property
    def _boxes(self) -> NDArray[np.float64]:
        return np.array([outline.bounds for outline in self.outlines])

    def transposed(self) -> PlaneField:
        """With x and y exchanged."""
        return PlaneField(tuple(map(_transposed, self.outlines)), self.weights)


def is_lit_by_waves(source: Any) -> bool:
    """Whether the field is not constant on an element of a source."""
    return any(element.illumination is not None for element in source.elements_in_plane)


def field_of(source: Aperture | Array) -> PlaneField:
    """The outlines, with the waves on them, and weights of an aperture or array of one plane."""
    if isinstance(source, Aperture):
        return PlaneField((source,), np.ones(1))
    return PlaneField(source.elements_in_plane, source.weights)


def bound_of(source: Aperture | Array) -> PlaneField:
    """A field at least as large, on the same outlines: waves count by the sum of their sizes."""
    field = field_of(source)
    if not is_lit_by_waves(source):
        return field
    sizes = [
        1.0 if o.illumination is None else float(np.abs(o.illumination.amplitudes).sum())
        for o in field.outlines
    ]
    return PlaneField(field.outlines, field.weights * np.array(sizes))


def _transposed(aperture: Aperture) -> Aperture:
    copy = Aperture._of_parts(
        [tuple(ring[::-1, ::-1] for ring in part) for part in aperture._parts]
    )
    field = aperture.illumination
    if field is None:
        return copy
    return copy.with_illumination(Illumination(field.amplitudes, field.frequencies[:, ::-1]))
