"""Arrays whose elements sit on a lattice, recognised from their positions and weights."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polywigner.errors import IlluminationError, value_text
from polywigner.geometry.arguments import finite_array

# Positions count as those of a lattice if they miss it by less than this fraction of the extent of
# the array: what rounding does to multiples of a pitch.
_ROUNDING = 4e-15
# Sites a lattice may have for each element on it: those without one count as weight 0.
_SITES_PER_ELEMENT = 16
# Weights count as a product of two profiles, or as real but for a phase that grows evenly along the
# array, if this fraction of the largest is all that is left.
_EQUAL = 1e-14
# Positions whose differences from all others are taken, to find the shortest: on a lattice of which
# one site in 16 is filled, none of so many has a neighbour in one of 10^7 arrays.
_PAIRED_WITH_ALL = 128


@dataclass(frozen=True)
class Lattice:
    """Sites origin + i b1 + j b2, 0 <= i < n1 and 0 <= j < n2, and the weights there."""

    origin: tuple[float, float]
    basis: tuple[tuple[float, float], tuple[float, float]]
    """b1 and b2."""
    weights: NDArray[np.complex128]
    """(n1, n2)"""
    middle: tuple[tuple[float, float], tuple[float, float]]
    """Middle of the sites, x and y, each as the sum of two floats."""
    misfit: float
    """The most by which a position misses its site in x or y, as a fraction of the extent."""


def lattice_of(positions: NDArray[np.float64], weights: NDArray[np.complex128]) -> Lattice | None:
    """The lattice of positions (n, 2), or None if they are on none (or hardly fill it)."""
    extent = float(np.ptp(positions, axis=0).max())
    if extent == 0.0:
        return None
    basis = _basis(positions, extent)
    if basis is None:
        return None
    away = positions - positions[0]
    whole = np.rint(np.linalg.solve(basis.T, away.T).T)
    left = away - whole @ basis
    largest = float(np.abs(positions).max())
    if np.abs(left).max() > _ROUNDING * max(extent, largest):
        return None
    first = whole.min(axis=0)
    index = (whole - first).astype(np.intp)
    shape = index.max(axis=0) + 1
    if int(np.prod(shape)) > _SITES_PER_ELEMENT * len(positions) + 16:
        return None
    table = np.zeros(tuple(shape), np.complex128)
    np.add.at(table, (index[:, 0], index[:, 1]), weights)
    origin = positions[0] + first @ basis
    b1, b2 = basis.tolist()
    shift = left.mean(axis=0)
    middle = shift + (first + (np.array(shape) - 1) / 2) @ basis
    (x, from_x), (y, from_y) = zip(positions[0].tolist(), middle.tolist(), strict=True)
    return Lattice(
        (float(origin[0]), float(origin[1])),
        (tuple(b1), tuple(b2)),
        table,
        ((x, from_x), (y, from_y)),
        float(np.abs(left - shift).max()) / extent,
    )


def _basis(positions: NDArray[np.float64], extent: float) -> NDArray[np.float64] | None:
    """Two short differences that are not parallel, as rows; any second one for a row."""
    first = _shortest(positions, extent, None)
    if first is None:
        return None
    second = _shortest(positions, extent, first)
    if second is None:
        second = np.array([-first[1], first[0]])
    return _refined(np.stack([first, second]), positions)


def _shortest(
    positions: NDArray[np.float64], extent: float, other: NDArray[np.float64] | None
) -> NDArray[np.float64] | None:
    """The shortest difference of two positions, not parallel to another; towards +x, or +y."""
    best, length = None, np.inf
    # even in the order given, which is that of rows more often than not: one in each of many rows
    paired = np.linspace(0, len(positions) - 1, min(len(positions), _PAIRED_WITH_ALL))
    for start in positions[paired.astype(np.intp)]:
        block = positions - start
        size = np.hypot(block[:, 0], block[:, 1])
        allowed = size > 1e-9 * extent
        if other is not None:
            cross = np.abs(block[:, 0] * other[1] - block[:, 1] * other[0])
            allowed &= cross > 1e-6 * size * np.hypot(*other)
        size = np.where(allowed, size, np.inf)
        k = int(np.argmin(size))
        if size[k] < length * (1 - 1e-9):
            best, length = block[k], float(size[k])
    if best is None:
        return None
    backwards = best[0] < -1e-9 * length or (abs(best[0]) <= 1e-9 * length and best[1] < 0)
    return -best if backwards else best


def _refined(basis: NDArray[np.float64], positions: NDArray[np.float64]) -> NDArray[np.float64]:
    """The basis from the farthest sites rather than from neighbours."""
    steps = np.rint(np.linalg.solve(basis.T, (positions - positions[0]).T).T)
    if np.linalg.matrix_rank(steps - steps.mean(axis=0)) < 2:
        used = int(np.argmax(np.ptp(steps, axis=0)))
        k, m = int(np.argmax(steps[:, used])), int(np.argmin(steps[:, used]))
        count = steps[k, used] - steps[m, used]
        if count:
            basis[used] = (positions[k] - positions[m]) / count
        return basis
    # By normal equations, which are well conditioned, in extended precision where there is one: the
    # basis is good to an ulp, since its error counts once for every step.
    s, p = steps.astype(np.longdouble), positions.astype(np.longdouble)
    s, p = s - s.mean(axis=0), p - p.mean(axis=0)
    (aa, ab), (_, bb) = s.T @ s
    right = s.T @ p
    first, second = bb * right[0] - ab * right[1], aa * right[1] - ab * right[0]
    found = (np.stack([first, second]) / (aa * bb - ab * ab)).astype(np.float64)
    found[np.abs(found) <= 1e-15 * np.abs(found).max(axis=1)[:, None]] = 0.0
    return found


@dataclass(frozen=True)
class Profile:
    """Weights factor a_i exp(2 pi i turns i) along one direction; the a_i real if possible."""

    amplitudes: tuple[complex, ...]
    turns: float
    factor: complex

    @property
    def is_uniform(self) -> bool:
        return all(amplitude == 1.0 for amplitude in self.amplitudes)


def separated(weights: NDArray[np.complex128]) -> tuple[Profile, Profile] | None:
    """Two profiles whose product the weights (n1, n2) are, or None."""
    found = column_and_row(weights)
    return None if found is None else (_profile(found[0]), _profile(found[1]))


def column_and_row(
    weights: NDArray[np.complex128],
) -> tuple[NDArray[np.complex128], NDArray[np.complex128]] | None:
    """(n1,) and (n2,) numbers whose product the weights (n1, n2) are, or None."""
    i, j = np.unravel_index(int(np.argmax(np.abs(weights))), weights.shape)
    row, column = weights[i, :], weights[:, j] / weights[i, j]
    if np.abs(np.outer(column, row) - weights).max() > _EQUAL * np.abs(weights[i, j]):
        return None
    return column, row


def _profile(values: NDArray[np.complex128]) -> Profile:
    """An even phase, a constant factor, and real amplitudes, all 1 if they are equal."""
    size = np.abs(values)
    lit = np.flatnonzero(size > _EQUAL * size.max())
    turns = _even_phase(values, lit)
    steady = values * np.exp(-2j * np.pi * turns * np.arange(len(values)))
    factor = complex(steady[lit[0]])
    relative = steady / factor
    allowed = 8 * _EQUAL * len(values) * np.abs(relative).max()
    if np.abs(relative - 1.0).max() <= allowed:
        return Profile((1.0,) * len(values), turns, factor)
    if np.abs(relative.imag).max() <= allowed:
        return Profile(tuple(relative.real.tolist()), turns, factor)
    return Profile(tuple(values.tolist()), 0.0, 1.0)


def _even_phase(values: NDArray[np.complex128], lit: NDArray[np.intp]) -> float:
    """Turns by which the phase grows from one element to the next, up to changes of sign."""
    neighbours = lit[:-1][np.diff(lit) == 1]
    if not len(neighbours):
        return 0.0
    squares = (values / np.abs(values).max()) ** 2
    turns = float(np.angle((squares[neighbours + 1] * squares[neighbours].conj()).sum())) / (
        4 * np.pi
    )
    left = np.angle(squares[lit] * np.exp(-4j * np.pi * turns * lit) / squares[lit[0]]) / (
        4 * np.pi
    )
    slope = float(np.polyfit(lit - lit.mean(), left, 1)[0]) if len(lit) > 2 else 0.0
    turns += slope
    return 0.0 if abs(turns) < 1e-15 else turns


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


def checked_positions(positions: Any, components: tuple[int, ...]) -> NDArray[np.float64]:
    """Finite positions (n, d) with a d out of `components`, (n,) standing for (n, 1)."""
    expected = f"expected finite positions of shape {' or '.join(f'(n, {c})' for c in components)}"
    shapes: list[tuple[int | None, ...]] = [(None, c) for c in components]
    shapes += [(None,)] if 1 in components else []
    places = finite_array(positions, expected, *shapes)
    return places[:, None] if places.ndim == 1 else places


def checked_sites(
    positions: Any, weights: Any, dimension: int | None = None
) -> tuple[NDArray[np.float64], NDArray[np.complex128]]:
    """Positions (n, d) and weights (n,), read-only; of one dimension, or of any up to three."""
    places = checked_positions(positions, (1, 2, 3) if dimension is None else (dimension,)) + 0.0
    places.setflags(write=False)
    return places, checked_weights(weights, len(places))


def checked_weights(weights: Any, count: int) -> NDArray[np.complex128]:
    """Weights (n,) of n elements, read-only; None for all 1."""
    if weights is None:
        array = np.ones(count, np.complex128)
    else:
        try:
            if np.ma.is_masked(weights) or np.asarray(weights).dtype.kind in "US":
                raise TypeError
            array = np.array(weights, dtype=np.complex128)
        except (TypeError, ValueError, OverflowError):
            raise IlluminationError(
                f"expected {count} complex weights, none of them masked, got {value_text(weights)}"
            ) from None
    if array.shape != (count,):
        raise IlluminationError(
            f"expected one weight for each of {count} elements, got shape {array.shape}"
        )
    if not (np.isfinite(array).all() and array.any()):
        raise IlluminationError(
            f"expected finite weights other than zero, got {value_text(array.tolist())}"
        )
    array += 0.0  # no negative zeros, which equal zeros but hash differently
    array.setflags(write=False)
    return array
