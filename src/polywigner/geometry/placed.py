"""An aperture in a pose: a plane polygon anywhere in space."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np
from numpy.typing import NDArray

from polywigner.geometry.aperture import Aperture

__all__ = ["PlacedAperture"]


@final
@dataclass(frozen=True, eq=False)
class PlacedAperture:
    """An aperture and its rigid pose in space; made by :meth:`Aperture.placed`."""

    aperture: Aperture
    pose: NDArray[np.float64]
    """(4, 4) read-only: from the aperture's frame, in whose plane z = 0 it lies, to the world."""

    @property
    def normal(self) -> NDArray[np.float64]:
        """Unit normal (3,), the side to which the aperture radiates."""
        return self.pose[:3, 2]

    @property
    def area(self) -> float:
        return self.aperture.area

    def _key(self) -> tuple[Aperture, bytes]:
        return self.aperture, self.pose.tobytes()

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, PlacedAperture):
            return NotImplemented
        return self._key() == other._key()

    def __hash__(self) -> int:
        return hash(self._key())
