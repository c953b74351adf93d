"""Transforms of uniform outlines as kernels that sum over the boundary of a slice."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Any

from polywigner.geometry import Aperture
from polywigner.kernels.formulas import integrands
from polywigner.kernels.formulas.slice_sum import Integrand, cell_of, several, sum_over_slice
from polywigner.kernels.functions import plane
from polywigner.kernels.kernel import leave_wave
from polywigner.kernels.outline.frame import Frame
from polywigner.kernels.outline.pair_grid import PairGrid, cells_across, pair_grid
from polywigner.kernels.outline.rings import Outline, outline_of
from polywigner.kernels.outline.waves import (
    UNIFORM,
    WavePair,
    Waves,
    difference_pairs,
    mean_pairs,
)
from polywigner.numerics.complex_pairs import Pair

__all__ = [
    "AMBIGUITY",
    "LAG_MARGINAL",
    "POSITION_MARGINAL",
    "WIGNER",
    "BoundarySum",
    "SliceTables",
    "mirrored_pair",
    "shifted_pair",
]

Values = tuple[Any, ...]

# Where nobody knows how many samples there will be.
_MANY = 1 << 20


@dataclass(frozen=True, eq=False)
class SliceTables:
    """Two outlines, and the lists of their pairs of edges."""

    first: Outline
    second: Outline
    grids: dict[Any, Any] = field(default_factory=dict, repr=False)
    """Lists by cells across, and by the engine that holds them."""

    @property
    def frame(self) -> Frame:
        return self.first.frame

    @property
    def edges(self) -> Any:
        """(n, 4) both ends of each edge that is cut."""
        return self.first.edges

    def across(self, samples: int) -> int:
        """Cells along the longer side for so many samples."""
        return cells_across(self.first, self.second, samples)

    def grid(self, samples: int = _MANY) -> PairGrid:
        """Lists for so many samples."""
        across = self.across(samples)
        found: PairGrid = self.kept(across, lambda: pair_grid(self.first, self.second, across))
        return found

    def held(self, ops: Any, samples: int = _MANY) -> PairGrid:
        """The same in the memory of an engine."""
        across = self.across(samples)
        grid: PairGrid = self.kept((across, ops.key), lambda: self.grid(samples).held(ops.held))
        return grid

    def kept(self, key: Hashable, make: Callable[[], Any]) -> Any:
        """What ``make`` gives, made once for a key."""
        if key not in self.grids:
            self.grids[key] = make()
        return self.grids[key]


@lru_cache(maxsize=64)
def mirrored_pair(source: Aperture, double: bool) -> SliceTables:
    """An outline and its copy turned by half a turn, for W."""
    outline = outline_of(source, double)
    return SliceTables(outline, outline)


@dataclass(frozen=True, eq=False)
class BoundarySum:
    """A kernel's sum over the boundary of a slice."""

    integrand: Integrand
    arguments: int
    """How many numbers a sample has."""
    split: Callable[..., tuple[Values, Values]]
    """(*arguments in the frame) -> the offset between the copies, arguments of the integrand."""
    place: int = 0
    """Which of the arguments are the place on which amplitudes of pairs of waves depend: two."""
    wave_pairs: Callable[[Waves, Waves], Sequence[WavePair]] = mean_pairs
    """The pairs of waves of a field that are one integrand each: (I2), (I3)."""
    sides: tuple[float, ...] = (1.0,)
    """From which copies the slice is seen: both for A; those of W are mirror images."""

    def __call__(self, ops: Any, tables: SliceTables, *inner: Any) -> Values:
        pair = tables.held(ops, ops.count(inner[0]) or _MANY)
        offset, arguments = self.split(*inner)
        offset, waves = self.snapped(ops, pair, *offset), tables.first.waves
        if waves == UNIFORM:
            return self.on_grid(ops, pair, offset, *arguments)
        return self._of_waves(
            ops, pair, offset, waves, arguments, inner[self.place : self.place + 2]
        )

    def _of_waves(
        self, ops: Any, pair: PairGrid, offset: Values, waves: Waves, arguments: Values, at: Values
    ) -> Values:
        """The sum over pairs of waves of an amplitude times the sum at a shifted frequency."""
        pairs = self.wave_pairs(waves, waves)
        shifted = [component for wave in pairs for component in wave.detuned(arguments)]
        integrand = several(self.integrand, len(pairs))
        found = sum_over_slice(ops, pair, offset, integrand, *shifted, sides=self.sides)
        count = len(found) // len(pairs)
        total = Pair(0.0, 0.0)
        for number, wave in enumerate(pairs):
            mine = found[count * number : count * (number + 1)]
            total = total + Pair(*wave.amplitude(ops, at)) * Pair(mine[0], *mine[1:] or [0.0])
        return (total.real, total.imag)[:count]

    def snapped(self, ops: Any, pair: PairGrid, *offset: Any) -> Values:
        """An offset on the grid of the vertices."""
        *_, step = ops.gather(pair.numbers, ops.truncated(0.0))
        return tuple(ops.snapped(t, step) for t in offset)

    def on_grid(self, ops: Any, pair: PairGrid, offset: Values, *arguments: Any) -> Values:
        """The sums over a uniform source, of lists held by ``ops`` and for offsets on the grid."""
        return sum_over_slice(ops, pair, offset, self.integrand, *arguments, sides=self.sides)

    def cells(self, ops: Any, pair: PairGrid, offset: Values) -> Any:
        """The cells of offsets on the grid: samples are best taken in their order."""
        return cell_of(ops, pair, *offset)


@lru_cache(maxsize=64)
def shifted_pair(source: Aperture, double: bool) -> SliceTables:
    """An outline and a copy of it that is shifted, for A."""
    outline = outline_of(source, double)
    return SliceTables(outline, outline.turned())


WIGNER = replace(
    plane.WIGNER,
    tables=mirrored_pair,
    edge_sum=BoundarySum(integrands.WIGNER, 4, lambda x, y, *nu: ((2.0 * x, 2.0 * y), nu)),
)
POSITION_MARGINAL = replace(
    plane.POSITION_MARGINAL,
    tables=mirrored_pair,
    edge_sum=BoundarySum(integrands.LAG_AREA, 2, lambda x, y: ((2.0 * x, 2.0 * y), ())),
)
AMBIGUITY = replace(
    plane.AMBIGUITY,
    tables=shifted_pair,
    leave=lambda ops, frame, inner, sums: leave_wave(ops, frame, inner, (sums[0], -sums[1])),
    edge_sum=BoundarySum(
        integrands.AMBIGUITY,
        4,
        lambda turns, vx, vy, *xi: (xi, (vx, vy)),
        3,
        difference_pairs,
        (1.0, -1.0),
    ),
)
LAG_MARGINAL = replace(
    plane.LAG_MARGINAL,
    tables=shifted_pair,
    edge_sum=BoundarySum(integrands.POSITION_AREA, 2, lambda *xi: (xi, ()), sides=(1.0, -1.0)),
)
