"""Points of phase space behind a first-order system, as points before it. Source: (O2), (O3)."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from polywigner import execution, kernels
from polywigner.errors import ArgumentError
from polywigner.geometry.arguments import checked_wavelength
from polywigner.optics import FirstOrder
from polywigner.transforms.arguments import checked_points
from polywigner.transforms.traced_sources import Differentiable

__all__ = ["before", "blocks_for", "checked_system"]

Named = tuple[str, Any]


def before(
    function: str, source: Any, through: Any, wavelength: Any, x: Named, nu: Named
) -> tuple[Any, Any]:
    """A position and a frequency, or a lag and a frequency shift, as they were in the first plane.

    Both go by the same matrix, (x, lambda nu) and (xi, lambda upsilon): W_out of W, and A_out of A.
    Raises ArgumentError for a system without a wavelength, and the other way round.
    """
    if through is None:
        raise ArgumentError(
            f"expected wavelength with through= only, got {wavelength!r}; leave it out, or pass a "
            "FirstOrder"
        )
    system = checked_system(through)
    if wavelength is None:
        raise ArgumentError("expected a wavelength with through=, got none; pass wavelength=...")
    length = checked_wavelength(wavelength)
    plain = source.source if isinstance(source, Differentiable) else source
    dimension = kernels.kernel_for(function, plain).dimension
    a, b, c, d = blocks_for(system, dimension)
    return (
        _combined(dimension, (d.T, x), (-length * b.T, nu)),
        _combined(dimension, (a.T, nu), (-c.T / length, x)),
    )


def checked_system(through: Any) -> FirstOrder:
    """The system itself; ArgumentError for anything else."""
    if not isinstance(through, FirstOrder):
        raise ArgumentError(
            f"expected through as a polywigner.FirstOrder, got {type(through).__name__}"
        )
    return through


def blocks_for(system: FirstOrder, dimension: int) -> tuple[NDArray[np.float64], ...]:
    """A, B, C and D of sources in two dimensions, or (1, 1) of slits, which lie along x."""
    blocks = (system.A, system.B, system.C, system.D)
    if dimension == 2:
        return blocks
    if any(block[0, 1] or block[1, 0] for block in blocks):
        raise ArgumentError(
            "expected a system that keeps x and y apart for slits, got one that mixes them: "
            f"{system!r}"
        )
    return tuple(block[:1, :1] for block in blocks)


def _combined(dimension: int, *terms: tuple[NDArray[np.float64], Named]) -> Any:
    """The sum of matrices times points; those of matrices that are zero do not even broadcast."""
    present = [(matrix, point) for matrix, point in terms if matrix.any()]
    if any(execution.is_drjit(value) for _, (_, value) in present):
        found, kind = execution.components_of_all([point for _, point in present], dimension)
        whole = np.concatenate([matrix for matrix, _ in present], axis=1)
        return kind.points(execution.matrix_times(whole, [c for row in found for c in row]))
    total: Any = None
    for matrix, (name, value) in present:
        points = checked_points(name, value, dimension, complex_allowed=False)
        part = _product(matrix, points)
        try:
            total = part if total is None else total + part
        except ValueError:
            raise ArgumentError(
                "expected shapes that broadcast before the last axis, got "
                f"{' and '.join(str(np.shape(v)) for _, (_, v) in present)}; insert axes of "
                "length 1, as in x[:, None, :]"
            ) from None
    return total


def _product(matrix: NDArray[np.float64], points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Without the elements that are zero: grids stay grids, and infinite points are no nan."""
    if not (matrix - np.diag(np.diag(matrix))).any():
        return points * np.diag(matrix)
    return points @ matrix.T
