"""Arguments of ray matrices, checked once."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from polywigner.errors import ArgumentError
from polywigner.geometry.arguments import real_numbers

__all__ = ["check_symplectic", "checked_pair", "checked_vectors"]

Matrix = NDArray[np.float64]

# Relative to the products that conditions are sums of: a matrix typed to ten digits passes, one
# with a wrong sign or a forgotten element does not.
_SYMPLECTIC = 1e-9


def check_symplectic(matrix: Matrix) -> None:
    """A^T C and B^T D symmetric, A^T D - C^T B = 1, each within rounding of its products."""
    half = len(matrix) // 2
    a, b = matrix[:half, :half], matrix[:half, half:]
    c, d = matrix[half:, :half], matrix[half:, half:]
    conditions = (
        ("A^T C - C^T A = 0", a.T @ c - c.T @ a, abs(a).T @ abs(c)),
        ("B^T D - D^T B = 0", b.T @ d - d.T @ b, abs(b).T @ abs(d)),
        ("A^T D - C^T B = 1", a.T @ d - c.T @ b - np.eye(half), 1 + abs(a).T @ abs(d)),
    )
    for law, found, size in conditions:
        wrong = float(abs(found).max())
        if wrong > _SYMPLECTIC * float(size.max()):
            raise ArgumentError(
                f"expected a symplectic ray matrix, {law}, got one that misses it by {wrong:.3g}; "
                "give A to D of rays (x, s), s the direction cosines, to ten digits, or compose "
                "the system of free_space, lens and magnifier"
            )


def checked_pair(value: Any, expected: str) -> Matrix:
    """One number or two, as two; infinite ones are let through."""
    try:
        numbers = real_numbers(value)
    except ValueError as error:
        raise ArgumentError(f"{expected}, got {error}") from None
    if numbers.shape not in ((), (2,)) or np.isnan(numbers).any():
        raise ArgumentError(f"{expected}, got {value!r}")
    return np.broadcast_to(numbers, 2)


def checked_vectors(name: str, value: Any) -> Matrix:
    try:
        array = real_numbers(value)
    except ValueError as error:
        raise ArgumentError(f"expected {name} as real numbers (..., 2), got {error}") from None
    if array.ndim == 0 or array.shape[-1] != 2:
        raise ArgumentError(f"expected {name} of shape (..., 2), got {array.shape}")
    return array
