"""Polynomials along a segment, as lists of coefficients that are numbers or arrays."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import zip_longest
from typing import Any

__all__ = ["Polynomial", "added", "multiplied", "scaled"]

Polynomial = Sequence[Any]
"""Coefficients of 1, t, t^2, ..."""


def added(first: Polynomial, second: Polynomial) -> list[Any]:
    """The sum."""
    return [b if a is None else a if b is None else a + b for a, b in zip_longest(first, second)]


def scaled(polynomial: Polynomial, factor: Any) -> list[Any]:
    """A multiple; nothing is multiplied by a constant 1."""
    if isinstance(factor, float) and factor == 1.0:
        return list(polynomial)
    return [coefficient * factor for coefficient in polynomial]


def multiplied(first: Polynomial, second: Polynomial) -> list[Any]:
    """The product."""
    result: list[Any] = [None] * (len(first) + len(second) - 1)
    for i, a in enumerate(first):
        for j, b in enumerate(second):
            product = b if isinstance(a, float) and a == 1.0 else a * b
            known = result[i + j]
            result[i + j] = product if known is None else known + product
    return result
