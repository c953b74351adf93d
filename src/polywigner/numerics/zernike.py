"""Zernike polynomials of the unit disc: values, derivatives and the usual single indices.

With z = x + iy, the polynomials V_n^m(z) = R_n^m(r) exp(i m theta) obey, for m >= 0,

    V_n^m = z V_(n-1)^(m-1) + conj(z) V_(n-1)^(m+1) - V_(n-2)^m,    V_n^(-m) = conj(V_n^m),

The recurrence has no cancellation, so high orders are accurate. The real part of V_n^m is the
cosine polynomial, and the imaginary part the sine polynomial. Source: T. B. Andersen, Opt. Express
26, 18878 (2018), in complex form.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Order = tuple[int, int]
"""Radial order n and azimuthal frequency m. Negative m denote sine terms."""


def noll(j: int) -> Order:
    """Return the order of a Noll index 1, 2, ... (R. J. Noll, J. Opt. Soc. Am. 66, 207 (1976))."""
    n = (math.isqrt(8 * j - 7) - 1) // 2
    rank = j - n * (n + 1) // 2 - 1
    m = (rank + 1) // 2 * 2 if n % 2 == 0 else rank // 2 * 2 + 1
    return n, m if j % 2 == 0 else -m


def osa(j: int) -> Order:
    """Return the order of an OSA/ANSI index 0, 1, ... (ANSI Z80.28)."""
    n = (math.isqrt(8 * j + 1) - 1) // 2
    return n, 2 * j - n * (n + 2)


def fringe(j: int) -> Order:
    """Return the order of a fringe (University of Arizona) index 1, 2, ..."""
    d = math.isqrt(j - 1)  # (n + |m|)/2
    rank = j - 1 - d * d
    m = d - rank // 2
    return 2 * d - m, m if rank % 2 == 0 else -m


class Indexing(NamedTuple):
    """A numbering of the polynomials by a single index."""

    order: Callable[[int], Order]
    """Function that converts an index to an order (n, m)."""
    first: int
    """First index of the numbering, 0 or 1."""
    is_normalised: bool
    """True if the polynomials have unit rms on the disc; False if they are 1 at the rim."""


INDEXINGS = {
    "noll": Indexing(noll, 1, True),
    "fringe": Indexing(fringe, 1, False),
    "osa": Indexing(osa, 0, True),
}


def norm(order: Order) -> float:
    """Return the factor that gives a polynomial unit rms on the disc."""
    n, m = order
    return math.sqrt((n + 1) * (2 if m else 1))


def values(orders: Sequence[Order], x: Floats, y: Floats) -> Floats:
    """Return polynomials (k, ...) at x, y (...), normalised to a largest value of 1 on the rim."""
    table = _complex_values(max((n for n, _ in orders), default=0), x, y)
    return np.array([_part(table, order) for order in orders])


def gradients(orders: Sequence[Order], x: Floats, y: Floats) -> Floats:
    """Return derivatives (k, 2, ...) in x and y of :func:`values`.

    The recurrences are d/dz V_n^m - d/dz V_(n-2)^m = n V_(n-1)^(m-1), and with n V_(n-1)^(m+1) on
    the right for the derivative in conj(z).
    """
    table = _complex_values(max((n for n, _ in orders), default=0), x, y)
    return np.array([_gradient(table, order) for order in orders])


def _complex_values(highest: int, x: Floats, y: Floats) -> dict[Order, NDArray[np.complex128]]:
    """Return V_n^m (...) for 0 <= m <= n <= highest with n - m even."""
    z = np.asarray(x) + 1j * np.asarray(y)
    table: dict[Order, NDArray[np.complex128]] = {(0, 0): np.ones_like(z)}
    for n in range(1, highest + 1):
        for m in range(n % 2, n + 1, 2):
            value = z * _at(table, n - 1, m - 1)
            if m < n:
                value = value + z.conj() * table[n - 1, m + 1] - table[n - 2, m]
            table[n, m] = value
    return table


def _at(table: dict[Order, NDArray[np.complex128]], n: int, m: int) -> NDArray[np.complex128]:
    """Return V_n^m for any m, zero for |m| > n."""
    if abs(m) > n:
        return np.zeros_like(table[0, 0])
    return table[n, m] if m >= 0 else table[n, -m].conj()


def _part(table: dict[Order, NDArray[np.complex128]], order: Order) -> Floats:
    n, m = order
    return table[n, m].real if m >= 0 else table[n, -m].imag


def _gradient(table: dict[Order, NDArray[np.complex128]], order: Order) -> Floats:
    n, m = order
    by_z = by_conjugate = np.zeros_like(table[0, 0])
    for k in range(n, 0, -2):
        by_z = by_z + k * _at(table, k - 1, abs(m) - 1)
        by_conjugate = by_conjugate + k * _at(table, k - 1, abs(m) + 1)
    both = np.array([by_z + by_conjugate, 1j * (by_z - by_conjugate)])
    return both.real if m >= 0 else both.imag
