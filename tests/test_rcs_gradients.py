"""Derivatives of cross sections in directions, against central differences."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import polywigner as pw
from oracles.meshes import BOX, L_BODY
from polywigner.errors import ArgumentError

pytestmark = pytest.mark.llvm

# Central differences of steps h of functions that vary over 1/(4 pi 3 m/0.3 m) rad: (h 120)^2/6,
# and 1e-16/h of rounding.
STEP, DIFFERENCES = 1e-5, 1e-6
PLATE = pw.Aperture([(0, 0), (2, 0.3), (1.4, 1.6), (0.2, 1.1)])
# no face of any body is seen edge-on, where bistatic sections jump
S = np.array([[0.36, 0.48, 0.8], [-0.64, 0.48, 0.6], [0.28, -0.94, 0.2]])
S /= np.linalg.norm(S, axis=1, keepdims=True)
T = np.array([0.48, 0.6, 0.64])
T /= np.linalg.norm(T)
WAVELENGTH = 0.3


def tensor(values: Any) -> Any:
    import drjit as dr
    from drjit.llvm.ad import TensorXf64

    found = TensorXf64(np.asarray(values, float))
    dr.enable_grad(found)
    return found


def differences(find: Any, directions: np.ndarray) -> np.ndarray:
    """Central differences across unit vectors (n, 3), each value of its own."""
    found = np.zeros_like(directions)
    for axis in range(3):
        moved = []
        for sign in (1, -1):
            there = directions.copy()
            there[:, axis] += sign * STEP
            moved.append(find(there / np.linalg.norm(there, axis=1, keepdims=True)))
        found[:, axis] = (moved[0] - moved[1]) / (2 * STEP)
    return found


@pytest.mark.parametrize(
    ("body", "polarisation", "transmitter"),
    [
        (BOX, "vv", None),
        (PLATE, None, T),
        (PLATE, "vh", None),
        (L_BODY, "vh", T),
        (L_BODY, None, None),
    ],
    ids=["box, alike", "plate, all", "plate, crossed", "L, crossed", "L, all"],
)
def test_derivatives_in_directions_are_those_of_differences(
    body: Any, polarisation: Any, transmitter: Any
) -> None:
    import drjit as dr

    s = tensor(S)
    t = None if transmitter is None else tensor(transmitter)
    sigma = pw.rcs(body, s, WAVELENGTH, t, polarisation)
    np.testing.assert_allclose(
        sigma.numpy(), pw.rcs(body, S, WAVELENGTH, transmitter, polarisation), rtol=1e-12
    )
    dr.backward(dr.sum(sigma))
    expected = differences(
        lambda moved: pw.rcs(body, moved, WAVELENGTH, transmitter, polarisation), S
    )
    scale = 12 * np.pi / WAVELENGTH * 4 * np.pi * (1 / WAVELENGTH) ** 2
    np.testing.assert_allclose(s.grad.numpy(), expected, rtol=0, atol=DIFFERENCES * scale)
    if t is not None:
        expected = differences(
            lambda moved: pw.rcs(body, S, WAVELENGTH, moved, polarisation).sum(), T[None]
        )
        np.testing.assert_allclose(t.grad.numpy(), expected[0], rtol=0, atol=DIFFERENCES * scale)


def test_derivatives_go_forward_as_in_reverse() -> None:
    import drjit as dr
    from drjit.llvm.ad import Array3f64, TensorXf64

    s, way = tensor(S), np.array([[0.1, -0.2, 0.3]] * 3)
    sigma = pw.rcs(BOX, s, [[0.3], [0.2]])
    dr.set_grad(s, TensorXf64(way))
    forward = dr.forward_to(sigma).numpy()
    assert sigma.shape == (2, 3)
    columns = Array3f64(S.T.copy())
    dr.enable_grad(columns)
    once = pw.rcs(BOX, columns, 0.3)
    dr.backward(once)
    np.testing.assert_allclose((columns.grad.numpy().T * way).sum(axis=1), forward[0], rtol=1e-9)


def test_antennas_near_by_take_no_arrays_of_drjit() -> None:
    with pytest.raises(ArgumentError, match="arrays with a source"):
        pw.rcs(PLATE, tensor(S), WAVELENGTH, source=pw.shapes.square(1.0))
