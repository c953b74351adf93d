"""Many samples in a lane, one after the other, are as many lanes."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import polywigner as pw

pytestmark = pytest.mark.llvm

CHEVRON = pw.shapes.chevron(2.0, 1.1, 0.6)
# At once, so many for each thread that a lane takes several; in parts, one for each lane. The last
# part is not a whole number of lanes.
MANY, PART = 1 << 17, 1 << 16
# Of the largest: sums of 10^5 terms of either sign in another order.
ROUNDING = {"double": 1e-12, "single": 1e-4}


def _vertices(source: Any, double: bool) -> Any:
    import drjit.llvm.ad as backend

    return (backend.Array2f64 if double else backend.Array2f)(np.concatenate(source.rings).T.copy())


def _numbers(values: Any, double: bool) -> Any:
    import drjit.llvm.ad as backend

    values = np.asarray(values, np.complex128)
    kind = backend.Complex2f64 if double else backend.Complex2f
    return kind(values.real.copy(), values.imag.copy())


ARRAY = pw.phased_array(pw.shapes.square(0.8), np.array([[0, 0], [1.0, 0.2]]), [1.0, 0.5j])
TWO_WAVES = pw.Illumination([1.0, 0.5j], [[0.0, 0.0], [0.4, 0.1]])
LIT = pw.shapes.square(1.5).with_illumination(TWO_WAVES)
CASES: dict[str, tuple[str, Callable[[bool], Any], Callable[[Any], Any]]] = {
    "W, vertices": (
        "wigner",
        lambda double: _vertices(CHEVRON, double),
        lambda own: pw.differentiable(CHEVRON, vertices=own),
    ),
    "A, vertices": (
        "ambiguity",
        lambda double: _vertices(CHEVRON, double),
        lambda own: pw.differentiable(CHEVRON, vertices=own),
    ),
    "F, vertices": (
        "fourier",
        lambda double: _vertices(CHEVRON, double),
        lambda own: pw.differentiable(CHEVRON, vertices=own),
    ),
    "W, weights": (
        "wigner",
        lambda double: _numbers(ARRAY.weights, double),
        lambda own: pw.differentiable(ARRAY, weights=own),
    ),
    "W, amplitudes": (
        "wigner",
        lambda double: _numbers(TWO_WAVES.amplitudes, double),
        lambda own: pw.differentiable(LIT, amplitudes=own),
    ),
}


def _gradients(
    name: str, own: Any, source: Any, points: np.ndarray, weights: np.ndarray, double: bool
) -> list[np.ndarray]:
    """Of a weighted sum of all values, in the source's own numbers and in points."""
    import drjit as dr
    import drjit.llvm.ad as backend

    kind, number = (
        (backend.Array2f64, backend.Float64) if double else (backend.Array2f, backend.Float)
    )
    arrays = [kind(p.copy()) for p in points[: 1 if name == "fourier" else 2]]
    dr.enable_grad(own, arrays)
    value = getattr(pw, name)(source(own), *arrays)
    parts = [value] if name == "wigner" else [value.real, value.imag]
    terms = zip(parts, weights, strict=False)
    dr.backward(sum(dr.sum(part * number(weight.copy())) for part, weight in terms))
    return [np.array([dr.grad(part) for part in a], np.float64) for a in (own, *arrays)]


SLOW = pytest.mark.slow


@pytest.mark.parametrize(
    ("case", "precision"),
    [
        ("W, vertices", "double"),
        *(pytest.param(case, "double", marks=SLOW) for case in list(CASES)[1:]),
        pytest.param("W, vertices", "single", marks=SLOW),
    ],
)
def test_gradients_of_many_samples_are_those_of_few(case: str, precision: str) -> None:
    import drjit as dr

    name, make, source = CASES[case]
    double, count = precision == "double", MANY * dr.thread_count() + 1003
    rng = np.random.default_rng(3)
    points, weights = rng.uniform(-0.8, 0.8, (2, 2, count)), rng.normal(size=(2, count))
    many = _gradients(name, make(double), source, points, weights, double)
    few = []
    for part in (slice(first, first + PART) for first in range(0, count, PART)):
        some = points[:, :, part], weights[:, part]
        few.append(_gradients(name, make(double), source, *some, double))
    own, *places = zip(*few, strict=True)
    expected = [np.sum(own, axis=0), *(np.concatenate(p, axis=-1) for p in places)]
    for one, other in zip(expected, many, strict=True):
        assert np.abs(one - other).max() < ROUNDING[precision] * np.abs(one).max()
