"""Types of arguments that are arrays, under the names that ``help()`` shows."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol, TypeAlias

import shapely
from numpy.typing import ArrayLike

__all__ = ["DrJitArray", "Outline", "Points"]


class DrJitArray(Protocol):
    """A Dr.Jit array or tensor, such as ``Array2f``; this room does not import Dr.Jit."""

    @property
    def index_ad(self) -> int:
        """Which variable of its graph of derivatives it is."""
        ...

    def __dlpack__(self, stream: object | None = None) -> Any: ...


Points: TypeAlias = ArrayLike | DrJitArray
"""Numbers with their components along the last axis: whatever NumPy takes, ``xarray.DataArray``
among it, or a Dr.Jit array, which has its components first unless it is a tensor."""

Outline: TypeAlias = (
    ArrayLike | shapely.Polygon | shapely.MultiPolygon | Sequence[ArrayLike | shapely.Polygon]
)
"""One ring (n, 2), several of different lengths, or shapely polygons."""
