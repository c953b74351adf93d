"""Derivatives of irradiances by Wigner rays, against differences of converged sums."""

from typing import Any

import numpy as np
import pytest

import polywigner as pw
from polywigner.errors import ArgumentError

pytestmark = pytest.mark.llvm

WAVELENGTH = 3.19e-3
CHEVRON = pw.shapes.chevron(10e-3, 10e-3, 4e-3)
POINTS = np.array([[0, 0, 0.05], [0.01, 0.02, 0.04], [-0.03, 0.01, 0.06]])
FACTOR = np.array([1.0, -2.0, 0.5])
# Of central differences of sums that are accurate to 1e-10.
DIFFERENCES = 1e-6


def _plain(vertices, points, wavelength, **more):
    source = pw.Aperture(vertices)
    return float(FACTOR @ pw.irradiance(source, points, wavelength, tolerance=1e-10, **more))


@pytest.mark.parametrize(
    "obliquity",
    [
        "kirchhoff",
        *(pytest.param(n, marks=pytest.mark.slow) for n in ("rayleigh-sommerfeld-1", "paper")),
    ],
)
def test_derivatives_are_those_of_differences(obliquity):
    import drjit as dr
    import drjit.llvm.ad as backend

    corners = np.concatenate(CHEVRON.rings)
    arrays = [
        backend.Array2f64(corners.T.copy()),
        backend.Array3f64(POINTS.T.copy()),
        backend.Float64(WAVELENGTH),
    ]
    dr.enable_grad(arrays)
    source = pw.differentiable(CHEVRON, vertices=arrays[0])
    found = pw.irradiance(source, *arrays[1:], tolerance=1e-9, obliquity=obliquity)
    plain = pw.irradiance(CHEVRON, POINTS, WAVELENGTH, tolerance=1e-9, obliquity=obliquity)
    assert np.abs(np.array(found) - plain).max() < 1e-8 * plain.max()
    dr.backward(dr.dot(backend.Float64(FACTOR), found))
    rng = np.random.default_rng(1)
    now: list[Any] = [corners, POINTS, WAVELENGTH]
    for k, (array, size) in enumerate(zip(arrays, (1e-7, 1e-6, 1e-9), strict=True)):
        change = rng.normal(size=np.shape(now[k]))
        ends = []
        for sign in (1, -1):
            moved = list(now)
            moved[k] = now[k] + sign * size * change
            ends.append(_plain(*moved, obliquity=obliquity))
        gradient = np.array(dr.grad(array)).T.reshape(np.shape(change))
        scale = np.abs(gradient).max() * np.abs(change).max()
        assert (
            abs((gradient * change).sum() - (ends[0] - ends[1]) / (2 * size)) < DIFFERENCES * scale
        )


def test_points_alone_may_have_derivatives_and_weights_may():
    import drjit as dr
    import drjit.llvm.ad as backend

    array = pw.Array(
        [pw.shapes.square(3e-3).moved((shift, 0)) for shift in (-3e-3, 2e-3)], [1, 0.5 + 0.3j]
    )
    points = backend.TensorXf64(POINTS)
    weights = backend.Complex2f64([1.0, 0.5], [0.0, 0.3])
    dr.enable_grad(points, weights)
    by_points = pw.irradiance(array, points, WAVELENGTH, tolerance=1e-9)
    by_both = pw.irradiance(
        pw.differentiable(array, weights=weights), points, WAVELENGTH, tolerance=1e-9
    )
    assert type(by_both) is backend.TensorXf64
    assert np.abs(np.array(by_points) - np.array(by_both)).max() < 1e-12
    dr.backward(by_both.array)
    real, imag = np.array(dr.grad(weights).real), np.array(dr.grad(weights).imag)
    # irradiance is homogeneous of degree 2 in the weights, and no phase in common matters
    total = np.array(dr.detach(by_both)).sum()
    assert abs((real * [1, 0.5]).sum() + (imag * [0, 0.3]).sum() - 2 * total) < 1e-9 * total
    assert abs((imag * [1, 0.5]).sum() - (real * [0, 0.3]).sum()) < 1e-9 * total


@pytest.mark.parametrize("of", ["weights", "amplitudes"])
def test_rays_of_the_third_order_have_derivatives_in_fields(of):
    """Of a quadratic form: differences over large steps are exact."""
    import drjit as dr
    import drjit.llvm.ad as backend

    elements = [pw.shapes.square(3e-3).moved((shift, 0)) for shift in (-3e-3, 2e-3)]
    frequencies = [[0.0, 0.0], [60.0, -20.0]]
    numbers, change = np.array([1.0, 0.5 + 0.3j]), np.array([0.3 + 0.2j, 0.1 - 0.5j])

    def source(numbers):
        if of == "weights":
            return pw.Array(elements, numbers)
        return elements[0].with_illumination(pw.Illumination(numbers, frequencies))

    above, below = (
        pw.irradiance(source(numbers + s * change), POINTS, WAVELENGTH, order=3, tolerance=1e-9)
        for s in (0.5, -0.5)
    )
    own = backend.Complex2f64(numbers.real.copy(), numbers.imag.copy())
    points = backend.TensorXf64(POINTS)
    for reverse in (False, True):
        dr.clear_grad(own)
        dr.enable_grad(own)
        traced = pw.differentiable(source(numbers), **{of: own})
        if not reverse:
            dr.set_grad(own, backend.Complex2f64(change.real.copy(), change.imag.copy()))
        found = pw.irradiance(traced, points, WAVELENGTH, order=3, tolerance=1e-9)
        if not reverse:
            dr.forward_to(found)
            got = np.array(dr.grad(found))
            assert np.abs(got - (above - below)).max() < 1e-7 * np.abs(above).max()
            continue
        dr.backward(dr.dot(backend.Float64(FACTOR), found.array))
        gradient = dr.grad(own)
        along = np.array(gradient.real) @ change.real + np.array(gradient.imag) @ change.imag
        assert abs(along - FACTOR @ (above - below)) < 1e-7 * np.abs(above).max()


@pytest.mark.parametrize(
    "more", [{"method": "fraunhofer"}, {"return_error": True}, {"sampling": "sobol"}]
)
def test_what_has_no_derivatives_says_so(more):
    import drjit as dr
    import drjit.llvm.ad as backend

    points = backend.Array3f64(POINTS.T.copy())
    dr.enable_grad(points)
    with pytest.raises(ArgumentError, match="with derivatives"):
        pw.irradiance(CHEVRON, points, WAVELENGTH, **more)


def test_rays_of_several_wavelengths_at_once_are_refused():
    import drjit as dr
    import drjit.llvm.ad as backend

    wavelengths = backend.Float64([3e-3, 4e-3])
    dr.enable_grad(wavelengths)
    with pytest.raises(ArgumentError, match="one wavelength, got 2"):
        pw.irradiance(CHEVRON, POINTS, wavelengths)
    vertices = backend.Array2f64(np.concatenate(CHEVRON.rings).T.copy())
    source = pw.differentiable(CHEVRON, vertices=vertices)
    with pytest.raises(ArgumentError, match="expected order=1 with differentiable vertices"):
        pw.irradiance(source, POINTS, WAVELENGTH, order=3)
    assert pw.irradiance(source, np.zeros((2, 0, 3)), WAVELENGTH).shape == (2, 0)
