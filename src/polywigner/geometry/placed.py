"""An aperture in a pose: a plane polygon anywhere in space."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, final

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from polywigner.geometry.aperture import Aperture

__all__ = ["PlacedAperture"]


@final
@dataclass(frozen=True, eq=False)
class PlacedAperture:
    """An aperture and its rigid pose in space; made by :meth:`Aperture.placed`."""

    aperture: Aperture
    pose: NDArray[np.float64]
    """(4, 4) read-only: from the aperture's frame, in whose plane z = 0 it lies, to the world."""

    def __post_init__(self) -> None:
        pose = np.array(self.pose, dtype=np.float64)
        pose.setflags(write=False)
        object.__setattr__(self, "pose", pose)

    def __reduce__(self) -> tuple[Any, ...]:
        # Through the constructor: an array that is copied or unpickled can be written to.
        return PlacedAperture, (self.aperture, self.pose)

    @property
    def normal(self) -> NDArray[np.float64]:
        """Unit normal (3,), the side to which the aperture radiates."""
        return self.pose[:3, 2]

    @property
    def area(self) -> float:
        return self.aperture.area

    def plot(self, ax: Axes | None = None, unit: str = "mm") -> Axes:
        """The outline in its own plane, as :meth:`Aperture.plot` draws it."""
        return self.aperture.plot(ax, unit)

    def _key(self) -> tuple[Aperture, bytes]:
        return self.aperture, self.pose.tobytes()

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, PlacedAperture):
            return NotImplemented
        return self._key() == other._key()

    def __hash__(self) -> int:
        return hash(self._key())
