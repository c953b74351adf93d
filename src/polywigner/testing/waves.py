"""The field of a source as its waves, those of a uniform one included: one wave, 1."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polywigner.geometry import Aperture, Slits
from polywigner.illumination import Illumination

__all__ = ["Waves", "waves_of"]

Array = NDArray[Any]


@dataclass(frozen=True)
class Waves:
    """u = sum of amplitude exp(2 pi i frequency.x)."""

    amplitudes: Array
    """(m,) complex."""
    frequencies: Array
    """(m, d)."""

    @property
    def uniform(self) -> bool:
        """Whether the field is 1."""
        return bool(np.all(self.amplitudes == 1)) and not self.frequencies.any()

    @property
    def strength(self) -> float:
        """Bound on |u|."""
        return float(np.abs(self.amplitudes).sum())

    @property
    def carrier(self) -> Array:
        """The mean frequency (d,), by power."""
        return np.asarray(np.abs(self.amplitudes) ** 2 @ self.frequencies) / float(
            (np.abs(self.amplitudes) ** 2).sum()
        )

    @property
    def spread(self) -> float:
        """Largest distance of a frequency from the carrier, in 1/m."""
        return float(np.linalg.norm(self.frequencies - self.carrier, axis=1).max())

    def pairs(self) -> Iterator[tuple[complex, Array, Array]]:
        """(c_m c_n*, mean of both frequencies, difference of both) of all ordered pairs."""
        for c, kappa in zip(self.amplitudes.tolist(), self.frequencies, strict=True):
            for d, other in zip(self.amplitudes.tolist(), self.frequencies, strict=True):
                yield c * d.conjugate(), (kappa + other) / 2, kappa - other

    def middles(self, rng: np.random.Generator, count: int) -> Array:
        """(count, d) means of two frequencies, about which W is large."""
        return self._drawn(rng, count, 0.5, 0.5)

    def distances(self, rng: np.random.Generator, count: int) -> Array:
        """(count, d) differences of two frequencies, about which A is large."""
        return self._drawn(rng, count, 1.0, -1.0)

    def _drawn(self, rng: np.random.Generator, count: int, first: float, second: float) -> Array:
        if len(self.amplitudes) == 1:  # no draws: the places of uniform sources depend on them
            return np.broadcast_to((first + second) * self.frequencies, (count, self._dimension))
        one, other = rng.integers(len(self.amplitudes), size=(2, count))
        return first * self.frequencies[one] + second * self.frequencies[other]

    @property
    def _dimension(self) -> int:
        return int(self.frequencies.shape[1])

    def field(self) -> Illumination:
        """The waves as an Illumination."""
        return Illumination(self.amplitudes, self.frequencies)

    def mapped(self, matrix: Array, shift: Array) -> Waves:
        """Carried along by x -> matrix x + shift."""
        kappa = self.frequencies @ np.linalg.inv(matrix)
        return Waves(self.amplitudes * np.exp(-2j * np.pi * (kappa @ shift)), kappa)

    def conjugate(self) -> Waves:
        return Waves(self.amplitudes.conj(), -self.frequencies)


def waves_of(source: Aperture | Slits) -> Waves:
    """The waves on a source."""
    field = source.illumination
    if field is None:
        return Waves(np.ones(1, complex), np.zeros((1, 1 if isinstance(source, Slits) else 2)))
    return Waves(field.amplitudes, field.frequencies)
