"""Derivatives of OTF, MTF and PSF in vertices, weights and coefficients, against differences."""

from typing import Any

import numpy as np
import pytest
import shapely

import polywigner as pw
from polywigner.errors import ArgumentError

WAVELENGTH, FOCUS, RADIUS = 550e-9, 0.1, 5e-3
PATH = pw.zernike({8: 0.2 * WAVELENGTH, 6: 0.1 * WAVELENGTH, 4: 0.05 * WAVELENGTH}, RADIUS)
POLYGON = pw.Aperture([(-4e-3, -3e-3), (4e-3, -4e-3), (3e-3, 1e-3), (1e-3, 4e-3), (-3e-3, 3e-3)])
HOLED = pw.shapes.ring(5e-3, 2e-3, 6)
PAIR = pw.Array(
    [
        pw.shapes.square(3e-3).moved((-2e-3, 0)),
        pw.shapes.regular_polygon(6, 2e-3).moved((2e-3, 1e-3)),
    ],
    [1.0, 0.7 - 0.3j],
)  # fmt: skip
LAGS = np.array([(1e-3, 2e-3), (2.9e-3, -1e-3), (0.2e-3, 0.1e-3)])
SPOT = np.array([(0.0, 0.0), (3e-6, -5e-6), (1e-5, 2e-5)])
BAND = [WAVELENGTH, 1.1 * WAVELENGTH]
FINE = {"tolerance": 1e-12}
FUNCTIONS = {
    "otf": lambda pupil, path: pw.otf(
        pupil, LAGS, 0.3, RADIUS, aberration=path, wavelength=WAVELENGTH, **FINE
    ),
    "mtf": lambda pupil, path: pw.mtf(
        pupil, LAGS / (WAVELENGTH * FOCUS), BAND, FOCUS, 0.3, RADIUS, aberration=path, pixel=3e-6,
        **FINE,
    ),
    "psf": lambda pupil, path: pw.psf(
        pupil, SPOT, BAND, FOCUS, 0.3, RADIUS, aberration=path, **FINE
    ),
}  # fmt: skip
# Error of fourth-order differences relative to the largest derivative.
DIFFERENCES = 1e-8


def corners_of(source: Any) -> Any:
    elements = getattr(source, "elements", [source])
    return np.concatenate([ring for element in elements for ring in element.rings])


def with_corners(source: Any, corners: Any, weights: Any) -> Any:
    """Return the source with other vertices, in the order of its rings."""
    if not isinstance(source, pw.Array):
        rings = np.split(corners, np.cumsum([len(ring) for ring in source.rings])[:-1])
        return pw.Aperture(shapely.Polygon(rings[0], rings[1:]))
    ends = np.cumsum([len(element.rings[0]) for element in source.elements])[:-1]
    return pw.Array([pw.Aperture(ring) for ring in np.split(corners, ends)], weights)


@pytest.mark.parametrize("name", FUNCTIONS)
@pytest.mark.parametrize("source", [HOLED, PAIR], ids=["holed", "pair"])
def test_derivatives_are_the_limits_of_differences(llvm: Any, name: str, source: Any) -> None:
    import drjit as dr
    from drjit.llvm.ad import Array2f64, Complex2f64, Float64

    function, corners = FUNCTIONS[name], corners_of(source)
    rng = np.random.default_rng(1)
    moves = rng.normal(size=corners.shape) * 1e-3
    changes = rng.normal(size=3) * WAVELENGTH
    factors = np.array(getattr(source, "weights", []))
    weighings = rng.normal(size=len(factors)) + 1j * rng.normal(size=len(factors))

    def at(step: float) -> Any:
        path = PATH.with_coefficients(PATH.coefficients + step * changes)
        pupil = with_corners(source, corners + step * moves, factors + step * weighings)
        return function(pupil, path)

    step = 1e-4
    expected = (8 * (at(step) - at(-step)) - (at(2 * step) - at(-2 * step))) / (12 * step)

    coefficients, vertices = Float64(PATH.coefficients), Array2f64(corners.T)
    numbers: list[Any] = [coefficients, vertices]
    values: list[Any] = [Float64(changes), Array2f64(moves.T)]
    how = {"vertices": vertices}
    if len(factors):
        how["weights"] = Complex2f64(Float64(factors.real), Float64(factors.imag))
        numbers.append(how["weights"])
        values.append(Complex2f64(Float64(weighings.real), Float64(weighings.imag)))
    dr.enable_grad(*numbers)
    result = function(pw.differentiable(source, **how), PATH.with_coefficients(coefficients))
    for number, value in zip(numbers, values, strict=True):
        dr.set_grad(number, value)
    dr.enqueue(dr.ADMode.Forward, *numbers)
    dr.traverse(dr.ADMode.Forward)
    derivative = dr.grad(result)
    if name == "otf":
        result, derivative = (np.array(v[0]) + 1j * np.array(v[1]) for v in (result, derivative))
    assert np.ravel(result) == pytest.approx(at(0.0), rel=1e-9)
    assert np.abs(np.ravel(derivative) - expected).max() < DIFFERENCES * np.abs(expected).max()


def test_reverse_derivatives_lead_to_a_flat_wavefront(llvm: Any) -> None:
    """Steps along the gradient raise the peak; the gradient is zero for a flat wavefront."""
    import drjit as dr
    from drjit.llvm.ad import Float64

    def peak(values: Any) -> Any:
        path = pw.zernike({4: 0.0, 8: 0.0}, RADIUS).with_coefficients(values)
        return pw.psf(POLYGON, [(0.0, 0.0)], WAVELENGTH, FOCUS, aberration=path)

    gradients = []
    for size in (0.05, 0.0):
        values = Float64([size * WAVELENGTH, -size * WAVELENGTH])
        dr.enable_grad(values)
        dr.backward(peak(values))
        gradients.append(np.array(values.grad) * WAVELENGTH)
    limit = POLYGON.area / (WAVELENGTH * FOCUS) ** 2
    assert gradients[0][0] < -0.1 * limit and gradients[0][1] > 0.05 * limit
    assert np.abs(gradients[1]).max() < 1e-9 * limit


def test_a_pupil_without_aberrations_has_derivatives(llvm: Any) -> None:
    """A square of side a has OTF(x) = 1 - x/a, whose derivative in the scale s is x/a."""
    import drjit as dr
    from drjit.llvm.ad import Array2f64, Float64

    scale = Float64(1.0)
    dr.enable_grad(scale)
    corners = corners_of(pw.shapes.square(2e-3)).T
    square = pw.differentiable(vertices=Array2f64(*corners) * scale)
    dr.backward(pw.otf(square, [(0.5e-3, 0.0)])[0])
    assert scale.grad[0] == pytest.approx(0.25, abs=1e-12)
    with pytest.raises(ArgumentError, match="NumPy"):
        pw.otf(square, Array2f64(0.5e-3, 0.0))
    with pytest.raises(ArgumentError, match="only psf, otf and mtf"):
        pw.strehl(POLYGON, WAVELENGTH, PATH.with_coefficients(Float64([1e-9] * 3)))


def test_lags_without_overlap_have_derivatives_of_zero(llvm: Any) -> None:
    import drjit as dr
    from drjit.llvm.ad import Float64

    coefficients = Float64(PATH.coefficients)
    dr.enable_grad(coefficients)
    path = PATH.with_coefficients(coefficients)
    lags = np.full((140, 2), 4 * RADIUS)  # more lags than in one block
    dr.backward(pw.otf(POLYGON, lags, aberration=path, wavelength=WAVELENGTH)[0])
    assert not np.array(coefficients.grad).any()
