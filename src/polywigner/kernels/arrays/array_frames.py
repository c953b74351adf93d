"""The frame of an array on a lattice: its element's, and which sites count at a place."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polywigner.geometry import Aperture, automean
from polywigner.illumination.lattices import Lattice
from polywigner.kernels.outline.frame import Frame
from polywigner.numerics import phases

__all__ = ["ArrayFrame", "Window", "array_frame", "steps_of"]

# A place within this of the edge of a region contributes less than rounding.
_EDGE = 4e-15
# Margin around an element's region, in its size: more than single precision rounds.
_MARGIN = 1e-4


Pair2 = tuple[float, float]


@dataclass(frozen=True)
class Window:
    """Which whole numbers h along one direction have t - h in the open interval (low, high)."""

    low: float
    high: float
    start: int
    """The first of those that the lattice has, ..."""
    steps: int
    """... and how many it has."""

    @property
    def _is_all(self) -> bool:
        """Whether the interval holds no fewer: elements much larger than the lattice."""
        return self.high - self.low >= self.steps

    @property
    def count(self) -> int:
        """The most that there can be."""
        if self._is_all:
            return self.steps
        return max(1, math.ceil(self.high - self.low - _EDGE))

    def first(self, ops: Any, t: Any) -> Any:
        if self._is_all:
            return 0.0 * t + float(self.start)
        return ops.round(t - self.high + 0.5)


@dataclass(frozen=True)
class ArrayFrame:
    """The frame of the element, and the lattice."""

    element: Frame
    origin: Pair2
    """The centre of the element's frame at the first site."""
    basis: tuple[Pair2, Pair2]
    inverse: tuple[Pair2, Pair2]
    """From positions to lattice coordinates."""
    turns: Pair2
    """By which the phase of the weights grows from site to site, along each direction."""
    middle: tuple[phases.Doubled, ...]
    """Middle of the elements' centres."""
    means: tuple[Window, Window]
    differences: tuple[Window, Window]
    sites: tuple[Window, Window]
    support: tuple[Pair2, Pair2]
    """Low and high corner, in the element's frame, of what its automean lies within."""

    @property
    def content(self) -> float:
        return self.element.content

    @property
    def carrier(self) -> tuple[float, ...]:
        return self.element.carrier

    @property
    def slope(self) -> Pair2:
        """The turns less those of the carrier, which is counted with all of a lag or position."""
        one, two = (
            own - float(np.dot(self.carrier, b))
            for own, b in zip(self.turns, self.basis, strict=True)
        )
        return one, two

    def coordinates(self, x: Any, y: Any) -> tuple[Any, Any]:
        """A vector in steps of the lattice."""
        (xx, xy), (yx, yy) = self.inverse
        return x * xx + y * xy, x * yx + y * yy

    def less(self, x: Any, y: Any, first: Any, second: Any, scale: float) -> tuple[Any, Any]:
        """A vector minus steps of the lattice times ``scale``."""
        (ax, ay), (bx, by) = self.basis
        return (
            x - (first * (scale * ax) + second * (scale * bx)),
            y - (first * (scale * ay) + second * (scale * by)),
        )

    def may_count(self, x: Any, y: Any) -> Any:
        """Whether W of the element may differ from 0 at a place of its frame."""
        low, high = self.support
        return (x > low[0]) & (x < high[0]) & (y > low[1]) & (y < high[1])

    def step(self, first: float, second: float) -> tuple[Any, Any]:
        """A constant number of steps, in the frame."""
        exact = np.array(self.basis).T @ np.array([first, second])
        (shifted,) = self.element.vertices((exact + np.array(self.element.centre))[None, :])
        return float(shifted[0]), float(shifted[1])


def array_frame(
    lattice: Lattice, element: Aperture, frame: Frame, turns: Pair2, double: bool
) -> ArrayFrame:
    basis = np.array(lattice.basis)
    inverse = np.linalg.inv(basis.T)
    centre = np.array(frame.centre)
    outline = (np.concatenate(element.rings) - centre) @ inverse.T
    region = np.concatenate(automean(element).rings)
    mean = (region - centre) @ inverse.T
    low, high = outline.min(axis=0).tolist(), outline.max(axis=0).tolist()
    origin = np.array(lattice.origin) + centre
    count = np.array(lattice.weights.shape) - 1
    middle = origin + (count / 2) @ basis
    spread = [b - a for a, b in zip(low, high, strict=True)]
    b1, b2 = lattice.basis
    i1, i2 = inverse.tolist()
    return ArrayFrame(
        frame,
        (float(origin[0]), float(origin[1])),
        (b1, b2),
        ((i1[0], i1[1]), (i2[0], i2[1])),
        turns,
        tuple(phases.doubled(float(c), double) for c in middle),
        _windows((2 * mean).min(axis=0), (2 * mean).max(axis=0), 0 * count, 2 * count + 1),
        _windows([-s for s in spread], spread, -count, 2 * count + 1),
        _windows(low, high, 0 * count, count + 1),
        _box(frame.vertices(region)),
    )


def _box(points: NDArray[np.float64]) -> tuple[Pair2, Pair2]:
    """Corners of the points' box, larger than it by far more than rounding."""
    low, high = points.min(axis=0), points.max(axis=0)
    margin = _MARGIN * (high - low)
    (x0, y0), (x1, y1) = (low - margin).tolist(), (high + margin).tolist()
    return (x0, y0), (x1, y1)


def _windows(low: Any, high: Any, start: Any, steps: Any) -> tuple[Window, Window]:
    first, second = (
        Window(float(a), float(b), int(k), int(n))
        for a, b, k, n in zip(low, high, start, steps, strict=True)
    )
    return first, second


def steps_of(
    frame: ArrayFrame, windows: tuple[Window, Window], scale: float
) -> list[tuple[float, float, float, float]]:
    """Numbers of steps from the first that counts, and the vector that they are in the frame."""
    counts = (range(window.count) for window in windows)
    return [(float(k), float(m), *frame.step(scale * k, scale * m)) for k, m in product(*counts)]
