"""Derivatives through the kernels, traced by Dr.Jit, against central differences."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import polywigner as pw

pytestmark = pytest.mark.llvm

SOURCES = {
    "chevron": pw.shapes.chevron(2.0, 1.1, 0.6),
    # edges that lean against each other: positions are rounded to a grid there
    "leaning square": pw.Aperture([[0, 0], [1, 0], [1, 1], [0, 1 + 1e-5]]),
}
# Central differences of float64 values with steps of 1e-6: their own error.
STEP, ALLOWED = 1e-6, 1e-7


def _differences(f: Callable[..., Any], arguments: list[np.ndarray], which: int) -> np.ndarray:
    columns = []
    for k in (0, 1):
        shift = np.zeros(2)
        shift[k] = STEP
        up, down = list(arguments), list(arguments)
        up[which], down[which] = arguments[which] + shift, arguments[which] - shift
        columns.append((f(*up) - f(*down)) / (2 * STEP))
    return np.stack(columns, axis=-1)


@pytest.mark.parametrize("mode", ["forward", "backward"])
@pytest.mark.parametrize("which", [0, 1], ids=["x", "nu"])
@pytest.mark.parametrize("name", SOURCES)
def test_gradients_of_the_wigner_function(name: str, which: int, mode: str) -> None:
    import drjit
    import drjit.llvm.ad as backend

    source, rng = SOURCES[name], np.random.default_rng(5)
    low, high = np.reshape(source.bounds, (2, 2))
    points = [rng.uniform(low, high, (40, 2)), rng.uniform(-2, 2, (40, 2))]
    arrays = [backend.TensorXf64(p) for p in points]
    drjit.enable_grad(arrays[which])
    expected = _differences(lambda *a: pw.wigner(source, *a), points, which)
    if mode == "backward":
        value = pw.wigner(source, *arrays)
        drjit.backward(drjit.sum(value.array))
        got = np.array(drjit.grad(arrays[which]))
        assert np.abs(got - expected).max() < ALLOWED * max(1.0, np.abs(expected).max())
        return
    for k in (0, 1):
        seed = np.zeros((40, 2))
        seed[:, k] = 1.0
        drjit.set_grad(arrays[which], backend.TensorXf64(seed))
        value = pw.wigner(source, *arrays)
        got = np.array(drjit.forward_to(value, flags=drjit.ADFlag.Default).array)
        assert np.abs(got - expected[:, k]).max() < ALLOWED * max(1.0, np.abs(expected).max())
        drjit.clear_grad(arrays[which])


@pytest.mark.parametrize("corners", [5, 64], ids=["unrolled", "in a loop"])
@pytest.mark.parametrize("mode", ["forward", "backward"])
def test_gradients_of_the_fourier_transform(corners: int, mode: str) -> None:
    import drjit
    import drjit.llvm.ad as backend

    source, points = (
        pw.shapes.disc(1.0, n=corners),
        np.random.default_rng(6).uniform(-2, 2, (20, 2)),
    )
    expected = _differences(lambda nu: abs(pw.fourier(source, nu)) ** 2, [points], 0)
    nu = backend.Array2f64(points[:, 0].copy(), points[:, 1].copy())
    drjit.enable_grad(nu)
    if mode == "forward":
        drjit.set_grad(nu, backend.Array2f64(1.0, 0.0))
    field = pw.fourier(source, nu)
    power = drjit.square(field.real) + drjit.square(field.imag)
    if mode == "forward":
        got, expected = np.array(drjit.forward_to(power)), expected[:, 0]
    else:
        drjit.backward(drjit.sum(power))
        got = np.array(drjit.grad(nu)).T
    assert np.abs(got - expected).max() < ALLOWED * np.abs(expected).max()
