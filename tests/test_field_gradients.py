"""Derivatives of exact and Fresnel fields, against integrals over areas and laws of physics."""

import numpy as np
import pytest
import shapely

import polywigner as pw
from oracles.surface_integrals import field_by_quadrature
from polywigner.errors import ArgumentError

pytestmark = pytest.mark.llvm

WAVELENGTH = 3e-3
OUTER = 1e-3 * np.array([[0, 0], [6, 1], [5, 5], [1, 4]])
HOLE = 1e-3 * np.array([[2, 2], [3, 3.5], [4, 2.5]])
CHEVRON = pw.shapes.chevron(7e-3, 5e-3, 3e-3)
# Three waves, the last of them evanescent.
WAVES = pw.Illumination([1, 0.5j, 0.3 - 0.2j], [[0, 0], [90, -60], [300, 250]])
SOURCES = {
    "hole": pw.Aperture(shapely.Polygon(OUTER, [HOLE])),
    "waves": CHEVRON.with_illumination(WAVES),
    "array": pw.Array([CHEVRON, pw.shapes.square(3e-3).moved((8e-3, 1e-3))], [1, 0.4 + 0.7j]),
}
POINTS = np.array([[1e-3, 2e-3, 9e-3], [-0.02, 0.01, 0.03], [0.004, -0.006, 5e-3]])
FACTOR = np.array([1.0, -0.5 + 0.3j, 0.7j])
EXACT = ["rayleigh-sommerfeld-1", "rayleigh-sommerfeld-2", "kirchhoff"]
# Of the largest component. Differences of the fourth order with this step err by (k step)^4, 1e-14,
# and by rounding of fields, 1e-14 over k step; 2e-11 was found.
STEP, DIFFERENCES = 1e-7, 1e-9
# The last digits of float64 sums along edges.
ROUNDING = 1e-12


def _backend():
    import drjit.llvm.ad as backend

    return backend


def _corners(source):
    return np.concatenate([ring for element in source.elements_in_plane for ring in element.rings])


def _moved(source, corners):
    """The same source with other vertices."""
    vertices = _backend().Array2f64(np.ascontiguousarray(corners.T))
    return pw.differentiable(source, vertices=vertices).source


def _slope(f):
    near, far = (f(h) - f(-h) for h in (STEP, 2 * STEP))
    return (8 * near - far) / (12 * STEP)


def _traced(source, points):
    import drjit as dr

    vertices = _backend().Array2f64(np.ascontiguousarray(_corners(source).T))
    places = _backend().Array3f64(np.ascontiguousarray(points.T))
    dr.enable_grad(vertices, places)
    return pw.differentiable(source, vertices=vertices), vertices, places


def _gradient(source, points, method):
    """Of Re sum FACTOR* U, in points (n, 3) and in vertices (v, 2)."""
    import drjit as dr

    traced, vertices, places = _traced(source, points)
    field = pw.amplitude(traced, places, WAVELENGTH, method)
    real, imag = _backend().Float64(FACTOR.real.copy()), _backend().Float64(FACTOR.imag.copy())
    dr.backward(dr.sum(real * field.real + imag * field.imag))
    return np.array(places.grad).T, np.array(vertices.grad).T


def _field(source, points, method):
    if method == "fresnel":
        return pw.amplitude(source, points, WAVELENGTH, method, tolerance=1e-13)
    return field_by_quadrature(source, points, WAVELENGTH, method)


@pytest.mark.parametrize("method", [*EXACT, "fresnel"])
@pytest.mark.parametrize("name", SOURCES)
def test_derivatives_are_those_of_integrals_over_the_area(name, method):
    source = SOURCES[name]
    of_points, of_vertices = _gradient(source, POINTS, method)
    rng = np.random.default_rng(2)
    places, corners = rng.normal(size=POINTS.shape), rng.normal(size=of_vertices.shape)

    def by_points(h):
        return (FACTOR.conj() * _field(source, POINTS + h * places, method)).real

    def by_vertices(h):
        moved = _moved(source, _corners(source) + h * corners)
        return (FACTOR.conj() @ _field(moved, POINTS, method)).real

    errors = np.abs(_slope(by_points) - (of_points * places).sum(axis=1))
    assert (errors < DIFFERENCES * np.abs(of_points).max(axis=1)).all()
    error = abs(_slope(by_vertices) - (of_vertices * corners).sum())
    assert error < DIFFERENCES * np.abs(of_vertices).max()


@pytest.mark.parametrize("method", ["kirchhoff", "fresnel"])
def test_forward_and_reverse_agree(method):
    import drjit as dr

    source = SOURCES["waves"]
    of_points, of_vertices = _gradient(source, POINTS, method)
    rng = np.random.default_rng(4)
    changes = rng.normal(size=of_vertices.shape), rng.normal(size=of_points.shape)
    traced, vertices, places = _traced(source, POINTS)
    dr.set_grad(vertices, type(vertices)(np.ascontiguousarray(changes[0].T)))
    dr.set_grad(places, type(places)(np.ascontiguousarray(changes[1].T)))
    slope = dr.forward_to(pw.amplitude(traced, places, WAVELENGTH, method))
    along = (FACTOR.conj() @ (np.array(slope.real) + 1j * np.array(slope.imag))).real
    expected = (of_vertices * changes[0]).sum() + (of_points * changes[1]).sum()
    assert abs(along - expected) < ROUNDING * np.abs(of_points).max()


def test_a_source_that_is_lit_evenly_may_move_instead_of_the_points():
    of_points, of_vertices = _gradient(SOURCES["hole"], POINTS, "kirchhoff")
    largest = np.abs(of_points).max()
    assert np.abs(of_points.sum(axis=0)[:2] + of_vertices.sum(axis=0)).max() < ROUNDING * largest


@pytest.mark.parametrize("name", ["array", "waves"])
def test_fields_are_linear_in_weights_and_amplitudes(name):
    import drjit as dr

    backend, source = _backend(), SOURCES[name]
    key = "weights" if name == "array" else "amplitudes"
    values = source.weights if name == "array" else source.illumination.amplitudes
    numbers = backend.Complex2f64(values.real.copy(), values.imag.copy())
    dr.enable_grad(numbers)
    traced = pw.differentiable(source, **{key: numbers})
    found = pw.irradiance(traced, POINTS, WAVELENGTH, "kirchhoff")
    plain = pw.irradiance(source, POINTS, WAVELENGTH, "kirchhoff")
    assert np.abs(np.array(found) - plain).max() < ROUNDING * plain.max()
    dr.backward(dr.sum(found.array))
    gradient = np.array(numbers.grad.real) + 1j * np.array(numbers.grad.imag)
    # |U|^2 is homogeneous of degree 2 in them, and a phase in common changes nothing; of fields
    # that are accurate to 1e-9
    assert abs(values.conj() @ gradient - 2 * plain.sum()) < 1e-8 * plain.sum()
    numbers = backend.Complex2f64(values.real.copy(), values.imag.copy())
    dr.enable_grad(numbers)
    dr.set_grad(numbers, backend.Complex2f64(values.real.copy(), values.imag.copy()))
    traced = pw.differentiable(source, **{key: numbers})
    field = pw.amplitude(traced, POINTS, WAVELENGTH, "rayleigh-sommerfeld-1")
    along = np.array(dr.forward_to(field))
    assert np.abs(along - np.array(field)).max() < 1e-8 * np.abs(along).max()


def test_results_and_derivatives_are_the_kind_of_array_that_points_are():
    import drjit as dr

    backend = _backend()
    exact, _ = _gradient(CHEVRON, POINTS, "kirchhoff")
    points = backend.TensorXf(POINTS.astype(np.float32)[:, None])
    dr.enable_grad(points)
    field = pw.amplitude(CHEVRON, points, WAVELENGTH, "kirchhoff")
    assert type(field) is backend.TensorXf
    assert field.shape == (3, 1, 2)
    factor = np.stack([FACTOR.real, FACTOR.imag], axis=-1).astype(np.float32)
    dr.backward(dr.sum(field.array * backend.Float(factor.ravel())))
    # float32 places are off by 6e-8 of 3e-2 m, 4e-6 radians
    assert np.abs(np.array(points.grad)[:, 0] - exact).max() < 1e-5 * np.abs(exact).max()


@pytest.mark.parametrize(
    ("function", "more", "message"),
    [
        (pw.amplitude, {"method": "fraunhofer"}, "fraunhofer"),
        (pw.amplitude, {"return_error": True}, "return_error"),
        (pw.irradiance, {"method": "kirchhoff", "order": 3}, "expected order with method"),
        (pw.irradiance, {"method": "fresnel", "obliquity": "paper"}, "obliquity"),
        (pw.amplitude, {"method": "wigner"}, "wigner"),
    ],
)
def test_what_has_no_derivatives_says_so(function, more, message):
    _, _, points = _traced(CHEVRON, POINTS)
    with pytest.raises(ArgumentError, match=message):
        function(CHEVRON, points, WAVELENGTH, **more)
    with pytest.raises(ArgumentError, match="wavelength without derivatives"):
        pw.amplitude(CHEVRON, POINTS, _backend().Float64(WAVELENGTH))
