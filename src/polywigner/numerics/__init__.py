"""Numerical functions without physics, and types of arrays.

===================  ===========================================================================
module               content
===================  ===========================================================================
``grid_arithmetic``  exact arithmetic on vertices rounded to a grid
``phases``           accurate phases, sines and cosines; complex numbers as pairs of arrays;
                     means of plane waves over segments, triangles and tetrahedra
``nodes``            Gauss rules on intervals, triangles and trapezoids
``chirps``           integrals of waves with a quadratic phase
``jets``             numbers with their derivatives
===================  ===========================================================================
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields
from typing import Any, Protocol, Self

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]
Indices = NDArray[np.intp]


def cluster_indices(values: Floats, tolerance: float) -> Indices:
    """Return a cluster index for each row of a table, in lexicographic order of the rows.

    Rows belong to the same cluster if the entries of each column are connected by steps of at most
    ``tolerance``.
    """
    labels = np.empty(values.shape, np.intp)
    for column, label in zip(values.T, labels.T, strict=True):
        order = np.argsort(column)
        label[order] = np.cumsum(np.diff(column[order], prepend=column[order[:1]]) > tolerance)
    return np.unique(labels, axis=0, return_inverse=True)[1].ravel()


def index_blocks(count: int, size: float) -> list[slice]:
    """Divide the indices from 0 to ``count`` - 1 into slices of ``size`` (at least 1) indices."""
    step = max(1, int(size))
    return [slice(start, min(start + step, count)) for start in range(0, count, step)]


def blocks_by_size(sizes: NDArray[np.integer[Any]], limit: int) -> list[Indices]:
    """Divide the indices of items into consecutive blocks whose sizes add up to about ``limit``.

    A block may exceed the limit by up to the size of one item.
    """
    block = np.cumsum(sizes) // limit
    blocks = np.split(np.arange(len(sizes)), np.flatnonzero(np.diff(block)) + 1)
    return blocks if len(sizes) else []


def sums_by_index(index: Indices, values: Complex, count: int) -> Complex:
    """Return the sums (count,) of complex values (n,) that have the same index."""
    real, imag = (np.bincount(index, part, count) for part in (values.real, values.imag))
    return np.asarray(real + 1j * imag)


class Columns:
    """Base class of dataclasses whose fields are arrays with one row per item."""

    @classmethod
    def of(cls, parts: Sequence[Self]) -> Self:
        """Concatenate the rows of several objects."""
        names = [item.name for item in fields(cls)]  # type: ignore[arg-type]
        return cls(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))

    def subset(self, rows: NDArray[np.bool_] | Indices | slice) -> Self:
        """Return the rows selected by a mask, by indices or by a slice."""
        arrays = (getattr(self, item.name) for item in fields(self))  # type: ignore[arg-type]
        return type(self)(*(array[rows] for array in arrays))


class Mask(Protocol):
    """A truth value, or an array of truth values from NumPy or Dr.Jit."""

    def __and__(self, other: Any, /) -> Mask: ...
    def __or__(self, other: Any, /) -> Mask: ...


class Number(Protocol):
    """A float, or an array of floats from NumPy or Dr.Jit."""

    def __add__(self, other: Any, /) -> Number: ...
    def __radd__(self, other: Any, /) -> Number: ...
    def __sub__(self, other: Any, /) -> Number: ...
    def __rsub__(self, other: Any, /) -> Number: ...
    def __mul__(self, other: Any, /) -> Number: ...
    def __rmul__(self, other: Any, /) -> Number: ...
    def __truediv__(self, other: Any, /) -> Number: ...
    def __rtruediv__(self, other: Any, /) -> Number: ...
    def __neg__(self) -> Number: ...
    def __abs__(self) -> Number: ...
    def __lt__(self, other: Any, /) -> Mask: ...
    def __gt__(self, other: Any, /) -> Mask: ...
    def __le__(self, other: Any, /) -> Mask: ...
    def __ge__(self, other: Any, /) -> Mask: ...
