"""Where the copies of one element are, and their weights."""

from __future__ import annotations

from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from polywigner.illumination.lattices import Lattice, lattice_of

__all__ = ["Sites"]


class Sites:
    """Positions (n, d) and complex weights (n,), compared by content; to be left unchanged."""

    def __init__(self, positions: NDArray[np.float64], weights: NDArray[np.complex128]) -> None:
        self.positions, self.weights = positions, weights
        self._key = (positions.shape, positions.tobytes(), weights.tobytes())

    @property
    def dimension(self) -> int:
        return int(self.positions.shape[1])

    @cached_property
    def lattice(self) -> Lattice | None:
        """The plane lattice that the sites are on, if they are."""
        if self.dimension != 2 or len(self.positions) < 2:
            return None
        return lattice_of(self.positions, self.weights)

    def __eq__(self, other: object) -> bool:
        return self._key == other._key if isinstance(other, Sites) else NotImplemented

    def __hash__(self) -> int:
        return hash(self._key)
