"""Detection of lattices in the positions and weights of array elements."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from polywigner.errors import IlluminationError, value_text
from polywigner.geometry.arguments import Immutable, complex_array, finite_array
from polywigner.numerics import Complex, Floats, Indices

# Largest distance of positions from lattice sites, as a fraction of the extent of the array.
_ROUNDING = 4e-15
# Largest number of lattice sites per element; empty sites have the weight 0.
_SITES_PER_ELEMENT = 16
# Largest deviation from a product at which weights count as separable, as a fraction of the largest
# weight.
_EQUAL = 1e-14
# Number of positions whose neighbours are searched for. If one site in 16 is filled at random, the
# probability that none of these positions has a neighbour is 1e-7.
_PAIRED_WITH_ALL = 128


@dataclass(frozen=True)
class Lattice:
    """Sites origin + i b1 + j b2 with 0 <= i < n1 and 0 <= j < n2, and their weights."""

    origin: tuple[float, float]
    basis: tuple[tuple[float, float], tuple[float, float]]
    """Basis vectors b1 and b2 of the lattice in m."""
    weights: Complex
    """Weights of the sites, shape (n1, n2); 0 for sites without an element."""
    centre: tuple[tuple[float, float], tuple[float, float]]
    """Centre of the sites, x and y, each as a sum of two floats."""
    misfit: float
    """Largest distance of a position from its site along x or y, as a fraction of the extent."""


def lattice_of(positions: Floats, weights: Complex) -> Lattice | None:
    """Return the lattice of positions (n, 2), or None if there is no lattice or few sites are used.

    A single position has no lattice, nor do positions with components other than x and y.
    """
    if positions.shape[1] != 2 or len(positions) < 2:
        return None
    extent = float(np.ptp(positions, axis=0).max())
    if extent == 0.0:
        return None
    basis = _basis_vectors(positions, extent)
    if basis is None:
        return None
    offsets = positions - positions[0]
    steps = np.rint(np.linalg.solve(basis.T, offsets.T).T)
    residuals = offsets - steps @ basis
    largest = float(np.abs(positions).max())
    if np.abs(residuals).max() > _ROUNDING * max(extent, largest):
        return None
    first = steps.min(axis=0)
    index = (steps - first).astype(np.intp)
    shape = index.max(axis=0) + 1
    if int(np.prod(shape)) > _SITES_PER_ELEMENT * len(positions) + 16:
        return None
    table = np.zeros(tuple(shape), np.complex128)
    np.add.at(table, (index[:, 0], index[:, 1]), weights)
    origin = positions[0] + first @ basis
    b1, b2 = basis.tolist()
    shift = residuals.mean(axis=0)
    centre = shift + (first + (np.array(shape) - 1) / 2) @ basis
    (x, from_x), (y, from_y) = zip(positions[0].tolist(), centre.tolist(), strict=True)
    return Lattice(
        (float(origin[0]), float(origin[1])),
        (tuple(b1), tuple(b2)),
        table,
        ((x, from_x), (y, from_y)),
        float(np.abs(residuals - shift).max()) / extent,
    )


def _basis_vectors(positions: Floats, extent: float) -> Floats | None:
    """Return two basis vectors of the lattice of positions (n, 2) as rows, shape (2, 2).

    Positions on a line get a second vector normal to the line. The result is None if all positions
    coincide. ``extent``: size of the array.
    """
    first = _shortest_difference(positions, extent, None)
    if first is None:
        return None
    second = _shortest_difference(positions, extent, first)
    if second is None:
        second = np.array([-first[1], first[0]])
    return _fitted_basis(np.stack([first, second]), positions)


def _shortest_difference(positions: Floats, extent: float, other: Floats | None) -> Floats | None:
    """Return the shortest difference of two positions that is not parallel to ``other``.

    The x component of the vector is positive, or zero with a positive y component. The result is
    None if there is no such difference. ``extent``: size of the array. ``other``: vector, or None
    to allow any direction.
    """
    best, length = None, np.inf
    # The indices are equally spaced, because positions are usually ordered by rows.
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


def _fitted_basis(basis: Floats, positions: Floats) -> Floats:
    """Return approximate basis vectors (2, 2), improved by a fit to all positions (n, 2).

    The least-squares fit changes both vectors. For positions on a line, the argument is changed in
    place and returned.
    """
    steps = np.rint(np.linalg.solve(basis.T, (positions - positions[0]).T).T)
    if np.linalg.matrix_rank(steps - steps.mean(axis=0)) < 2:
        used = int(np.argmax(np.ptp(steps, axis=0)))
        k, m = int(np.argmax(steps[:, used])), int(np.argmin(steps[:, used]))
        count = steps[k, used] - steps[m, used]
        if count:
            basis[used] = (positions[k] - positions[m]) / count
        return basis
    # The normal equations use extended precision, because an error of the basis grows with the
    # number of steps.
    s, p = steps.astype(np.longdouble), positions.astype(np.longdouble)
    s, p = s - s.mean(axis=0), p - p.mean(axis=0)
    (aa, ab), (_, bb) = s.T @ s
    right = s.T @ p
    first, second = bb * right[0] - ab * right[1], aa * right[1] - ab * right[0]
    refined = (np.stack([first, second]) / (aa * bb - ab * ab)).astype(np.float64)
    refined[np.abs(refined) <= 1e-15 * np.abs(refined).max(axis=1)[:, None]] = 0.0
    return refined


@dataclass(frozen=True)
class Profile:
    """Weights factor * a_i exp(2 pi i c i) along one direction of a lattice."""

    amplitudes: tuple[complex, ...]
    """Amplitudes a_i, real if possible."""
    cycles_per_element: float
    """Slope c of the phase, in cycles per element."""
    factor: complex
    """Constant factor of the weights."""

    @property
    def is_uniform(self) -> bool:
        """Whether all amplitudes are 1."""
        return all(amplitude == 1.0 for amplitude in self.amplitudes)


def separated(weights: Complex) -> tuple[Profile, Profile] | None:
    """Return two profiles, along i and j, whose product is the weights (n1, n2).

    The result is None if the weights are not a product.
    """
    factors = column_and_row(weights)
    return None if factors is None else (_profile_of(factors[0]), _profile_of(factors[1]))


def column_and_row(weights: Complex, tolerance: float = _EQUAL) -> tuple[Complex, Complex] | None:
    """Return factors (n1,) and (n2,) of weights (n1, n2); None if they are not a product.

    ``tolerance``: accepted deviation, as a fraction of the largest weight.
    """
    i, j = np.unravel_index(int(np.argmax(np.abs(weights))), weights.shape)
    row, column = weights[i, :], weights[:, j] / weights[i, j]
    if np.abs(np.outer(column, row) - weights).max() > tolerance * np.abs(weights[i, j]):
        return None
    return column, row


def _profile_of(values: Complex) -> Profile:
    """Convert weights (n,) along one direction to amplitudes, linear phase and factor."""
    size = np.abs(values)
    active = np.flatnonzero(size > _EQUAL * size.max())
    cycles = _linear_phase(values, active)
    unsteered = values * np.exp(-2j * np.pi * cycles * np.arange(len(values)))
    factor = complex(unsteered[active[0]])
    relative = unsteered / factor
    allowed = 8 * _EQUAL * len(values) * np.abs(relative).max()
    if np.abs(relative - 1.0).max() <= allowed:
        return Profile((1.0,) * len(values), cycles, factor)
    if np.abs(relative.imag).max() <= allowed:
        return Profile(tuple(relative.real.tolist()), cycles, factor)
    return Profile(tuple(values.tolist()), 0.0, 1.0)


def _linear_phase(values: Complex, active: Indices) -> float:
    """Return the slope in cycles per element of the phase of values, which may change sign.

    ``active`` contains the indices of the values that are not zero.
    """
    neighbours = active[:-1][np.diff(active) == 1]
    if not len(neighbours):
        return 0.0
    squares = (values / np.abs(values).max()) ** 2
    step = (squares[neighbours + 1] * squares[neighbours].conj()).sum()
    cycles = float(np.angle(step)) / (4 * np.pi)
    if len(active) > 2:
        residual = squares[active] * np.exp(-4j * np.pi * cycles * active) / squares[active[0]]
        slope = np.polyfit(active - active.mean(), np.angle(residual) / (4 * np.pi), 1)[0]
        cycles += float(slope)
    return 0.0 if abs(cycles) < 1e-15 else cycles


class Sites(Immutable):
    """Positions (n, d) and complex weights (n,) that are compared by content."""

    positions: Floats
    weights: Complex

    def __init__(self, positions: Floats, weights: Complex) -> None:
        self._set(positions=positions, weights=weights)

    @cached_property
    def _key(self) -> tuple[Any, ...]:
        """Values by which sites are compared."""
        return self.positions.shape, self.positions.tobytes(), self.weights.tobytes()

    @property
    def dimension(self) -> int:
        """Number of components of a position."""
        return int(self.positions.shape[1])

    @cached_property
    def lattice(self) -> Lattice | None:
        """The lattice of the sites in the plane; None if there is no lattice."""
        return lattice_of(self.positions, self.weights)


def joint_bounds(
    boxes: Sequence[tuple[float, ...]], positions: Floats | None = None
) -> tuple[float, ...]:
    """Return the common bounds (lower corner, upper corner) of boxes given in the same form.

    If ``positions`` (n, d) are specified, the boxes are copied to each position.
    """
    low, high = np.split(np.array(boxes), 2, axis=1)
    shifts = np.zeros((1, low.shape[1])) if positions is None else positions
    lower, upper = low.min(axis=0) + shifts.min(axis=0), high.max(axis=0) + shifts.max(axis=0)
    return (*lower.tolist(), *upper.tolist())


def checked_positions(positions: Any, components: tuple[int, ...]) -> Floats:
    """Return finite positions (n, d) with d in `components`; (n,) counts as (n, 1).

    Raises ArgumentError for other values.
    """
    expected = f"expected finite positions of shape {' or '.join(f'(n, {c})' for c in components)}"
    shapes: list[tuple[int | None, ...]] = [(None, c) for c in components]
    shapes += [(None,)] if 1 in components else []
    positions = finite_array(positions, expected, *shapes)
    return positions[:, None] if positions.ndim == 1 else positions


def checked_sites(
    positions: Any, weights: Any, dimension: int | None = None
) -> tuple[Floats, Complex]:
    """Return read-only positions (n, d) and weights (n,). Any d is valid if ``dimension`` is None.

    Weights of None stand for 1. Raises ArgumentError for other positions, and IlluminationError for
    other weights.
    """
    positions = checked_positions(positions, (1, 2, 3) if dimension is None else (dimension,)) + 0.0
    positions.setflags(write=False)
    return positions, checked_weights(weights, len(positions))


def checked_weights(weights: Any, count: int) -> Complex:
    """Return read-only complex weights (count,); None stands for weights of 1.

    Raises IlluminationError for other values, and if all weights are zero.
    """
    expected = f"expected complex weights, one for each of the {count} elements"
    values = np.ones(count) if weights is None else weights
    array = complex_array(values, expected, (count,), error=IlluminationError)
    if not array.any():
        raise IlluminationError(f"{expected}, not all zero, got {value_text(weights)}")
    # Adding 0.0 turns -0.0 into 0.0, which has a different hash.
    array += 0.0
    array.setflags(write=False)
    return array
