"""Many samples in a lane, one after the other, are as many lanes."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import polywigner as pw
from polywigner.engines import drjit_arrays, strides

pytestmark = pytest.mark.llvm

CHEVRON = pw.shapes.chevron(2.0, 1.1, 0.6)
# Not a whole number of lanes, nor of what they take.
SAMPLES = 1003
# Of the largest: sums of a thousand terms in another order.
ROUNDING = {"double": 1e-13, "single": 1e-5}


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


def _gradients(name: str, own: Any, source: Any, double: bool) -> list[np.ndarray]:
    import drjit as dr
    import drjit.llvm.ad as backend

    kind, number = (
        (backend.Array2f64, backend.Float64) if double else (backend.Array2f, backend.Float)
    )
    rng = np.random.default_rng(3)
    points = [kind(rng.uniform(-0.8, 0.8, (2, SAMPLES))) for _ in range(2)]
    points = points[: 1 if name == "fourier" else 2]
    dr.enable_grad(own, points)
    value = getattr(pw, name)(source(own), *points)
    parts = [value] if name == "wigner" else [value.real, value.imag]
    dr.backward(sum(dr.sum(p * number(rng.normal(size=SAMPLES))) for p in parts))
    found = [own, *points]
    return [np.array([dr.grad(part) for part in a], np.float64) for a in found]


@pytest.mark.parametrize("precision", ROUNDING)
@pytest.mark.parametrize("case", CASES)
def test_gradients_of_many_samples_are_those_of_few(
    case: str, precision: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    name, make, source = CASES[case]
    double = precision == "double"
    few = _gradients(name, make(double), source, double)
    taken: list[int] = []

    def stride(samples: int) -> int:
        taken.append(samples)
        return 4

    monkeypatch.setattr(drjit_arrays, "_WORTH_COMPILING", 0)
    monkeypatch.setattr("polywigner.engines.gradients.stride_of", stride)
    many = _gradients(name, make(double), source, double)
    assert taken == [SAMPLES]
    for one, other in zip(few, many, strict=True):
        assert np.abs(one - other).max() < ROUNDING[precision] * np.abs(one).max()


def test_a_lane_takes_more_samples_only_where_there_is_work_for_all_threads() -> None:
    assert strides.stride_of(1 << 16) == 1
    assert strides.stride_of(1 << 40) == strides.stride_of(1 << 41) > 1
