"""W and A of an array as sums over pairs of its elements, each pair a slice cut by itself."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polywigner import transforms
from polywigner.illumination import Array as Elements
from polywigner.testing.array_cases import ArrayCase
from polywigner.testing.pieces import lag_slices_of_pairs, position_slices_of_pairs
from polywigner.testing.waves import waves_of

__all__ = ["ambiguity_by_pairs", "wigner_by_pairs"]

Values = NDArray[Any]


def wigner_by_pairs(case: ArrayCase, x: Values, nu: Values) -> Any:
    """The sum of w_j w_k* c_m c_n* exp(2 pi i (k_m - k_n).x) F(nu - (k_m + k_n)/2) of slices."""
    return _summed(
        (parts, factor * _turn((one - other) @ x), nu - (one + other) / 2)
        for j, k, parts in lag_slices_of_pairs(case.elements, x)
        for factor, one, other in _waves_of_pair(case, j, k)
    ).real


def ambiguity_by_pairs(case: ArrayCase, upsilon: Values, xi: Values) -> complex:
    """The sum of w_j w_k* c_m c_n* exp(pi i (k_m + k_n).xi) F(upsilon - k_m + k_n) of slices."""
    return _summed(
        (parts, factor * _turn((one + other) @ xi / 2), upsilon - one + other)
        for j, k, parts in position_slices_of_pairs(case.elements, xi)
        for factor, one, other in _waves_of_pair(case, j, k)
    )


def _turn(turns: Any) -> complex:
    return complex(np.exp(2j * np.pi * turns))


def _waves_of_pair(case: ArrayCase, j: int, k: int) -> Iterator[tuple[complex, Values, Values]]:
    """(w_j w_k* c_m c_n*, k_m, k_n) for the waves of element j and those of element k."""
    one, other = waves_of(case.elements[j]), waves_of(case.elements[k])
    factor = complex(case.weights[j] * case.weights[k].conjugate())
    for c, kappa in zip(one.amplitudes.tolist(), one.frequencies, strict=True):
        for d, frequency in zip(other.amplitudes.tolist(), other.frequencies, strict=True):
            yield factor * c * d.conjugate(), kappa, frequency


def _summed(terms: Iterable[tuple[list[Any], complex, Values]]) -> complex:
    """The sum of factor times F(q) of parts, over (parts, factor, q)."""
    found: dict[bytes, tuple[Values, list[Any], list[complex]]] = {}
    for parts, factor, q in terms:
        if factor:
            _, pieces, factors = found.setdefault(q.tobytes(), (q, [], []))
            pieces += parts
            factors += [factor] * len(parts)
    return sum(
        (
            complex(transforms.fourier(Elements(pieces, factors), q, engine="numpy"))
            for q, pieces, factors in found.values()
        ),
        0j,
    )
