"""Fields at points in Dr.Jit arrays: the values of NumPy points, in arrays of the same kind."""

from typing import Any

import numpy as np
import pytest

import polywigner as pw
from polywigner.errors import ArgumentError

pytestmark = pytest.mark.llvm

SQUARE = pw.shapes.square(3.0)
POINTS = np.random.default_rng(0).uniform((-4.0, -4.0, 3.0), (4.0, 4.0, 9.0), (12, 3))
# Of the largest field here, about 1: tolerances of amplitude and irradiance, and float32.
AGREEMENT = {"double": 1e-8, "single": 2e-3}


def arrays(precision):
    import drjit.llvm as backend

    if precision == "double":
        return backend.Array3f64, backend.TensorXf64, backend.Float64, backend.Complex2f64
    return backend.Array3f, backend.TensorXf, backend.Float, backend.Complex2f


@pytest.mark.parametrize("precision", ["double", "single"])
@pytest.mark.parametrize("method", ["kirchhoff", "fraunhofer"])
def test_amplitudes_of_components_are_complex_arrays(method, precision):
    vector, tensor, _, number = arrays(precision)
    expected = pw.amplitude(SQUARE, POINTS, 1.0, method)
    found = pw.amplitude(SQUARE, vector(*POINTS.T.copy()), 1.0, method)
    assert isinstance(found, number)
    got = np.array(found.real) + 1j * np.array(found.imag)
    assert abs(got - expected).max() < AGREEMENT[precision]
    last = pw.amplitude(SQUARE, tensor(POINTS.reshape(4, 3, 3)), 1.0, method)
    assert isinstance(last, tensor) and last.shape == (4, 3, 2)
    parts = last.numpy().reshape(12, 2)
    assert abs(parts[:, 0] + 1j * parts[:, 1] - expected).max() < AGREEMENT[precision]


@pytest.mark.parametrize("precision", ["double", "single"])
@pytest.mark.parametrize("method", ["wigner", "rayleigh-sommerfeld-1"])
def test_irradiances_are_real_arrays_and_so_are_their_errors(method, precision):
    vector, tensor, real, _ = arrays(precision)
    expected = pw.irradiance(SQUARE, POINTS, 1.0, method)
    found, error = pw.irradiance(SQUARE, vector(*POINTS.T.copy()), 1.0, method, return_error=True)
    assert isinstance(found, real) and isinstance(error, real) and len(error) == 12
    assert abs(np.array(found) - expected).max() < AGREEMENT[precision]
    last = pw.irradiance(SQUARE, tensor(POINTS.reshape(2, 6, 3)), 1.0, method)
    assert isinstance(last, tensor) and last.shape == (2, 6)
    assert abs(last.numpy().ravel() - expected).max() < AGREEMENT[precision]


def test_points_of_other_kinds_are_refused_with_advice():
    import drjit as dr
    import drjit.llvm as backend
    import drjit.llvm.ad as ad

    flat = backend.Array2f([0.0], [3.0])
    asked = ad.Array3f64([0.0], [0.0], [3.0])
    dr.enable_grad(asked)
    whole = backend.Array3i([0], [0], [3])
    single = backend.Array3f([0.0], [0.0], [3.0])
    refused: list[tuple[Any, dict[str, Any], str]] = [
        (flat, {}, "3 components"),
        (backend.TensorXf(np.zeros((4, 2), np.float32)), {}, "3 components"),
        (asked, {"method": "fraunhofer"}, r"drjit\.detach"),
        (whole, {}, "32 or 64 bit real floats"),
        (single, {"precision": "double"}, "convert the arrays"),
        (backend.Array3f([0.0], [0.0], [-3.0]), {}, "z > 0"),
    ]
    for points, options, says in refused:
        for function in (pw.amplitude, pw.irradiance):
            with pytest.raises(ArgumentError, match=says):
                function(SQUARE, points, 1.0, **options)
    value = pw.amplitude(SQUARE, dr.detach(asked), 1.0)
    assert abs(complex(value.real[0], value.imag[0])) > 0.1
