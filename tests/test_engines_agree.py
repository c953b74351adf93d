"""Shapes, types, errors and values on every engine."""

from typing import Any

import numpy as np
import pytest

import polywigner as pw
from oracles.references import ENGINES, awkward
from polywigner.errors import PolywignerError

# Transforms, each with its number of point arguments and whether its result is complex.
TRANSFORMS = [
    pytest.param(pw.wigner, 2, False, id="wigner"),
    pytest.param(pw.ambiguity, 2, True, id="ambiguity"),
    pytest.param(pw.fourier, 1, True, id="fourier"),
    pytest.param(pw.position_marginal, 1, False, id="position_marginal"),
    pytest.param(pw.lag_marginal, 1, False, id="lag_marginal"),
]
transforms = pytest.mark.parametrize(("transform", "arguments", "is_complex"), TRANSFORMS)
engines = pytest.mark.parametrize("engine", ENGINES)

CHEVRON = awkward("chevron").aperture


def _points(*shape, seed=0):
    return np.random.default_rng(seed).uniform(0, 1, (*shape, 2))


@transforms
@engines
def test_results_have_the_shape_of_the_points_and_the_type_of_the_precision(
    transform, arguments, is_complex, engine
):
    def call(points, **how):
        return transform(CHEVRON, *[points] * arguments, engine=engine, **how)

    double, single = (np.complex128, np.complex64) if is_complex else (np.float64, np.float32)
    assert type(call([0.9, 0.6])) is double
    for given in (np.float32, np.float64):  # double precision by default
        assert call(_points(3).astype(given)).dtype == double
    assert call(_points(3), precision="single").dtype == single
    assert call(np.empty((3, 0, 2))).shape == (3, 0)


@engines
def test_lists_integers_masked_and_strided_arrays_are_points_and_stay_as_they_were(engine):
    x, nu = _points(6)[::2, ::-1], np.asfortranarray(_points(3, seed=1))
    before = nu.copy()
    x.setflags(write=False)
    expected = pw.wigner(CHEVRON, x.copy(), nu.copy(), engine=engine)
    for points in ((x, nu), (x.tolist(), nu.tolist()), (np.ma.masked_array(x), nu)):
        assert np.array_equal(pw.wigner(CHEVRON, *points, engine=engine), expected)
    assert np.array_equal(nu, before)
    by_integers = pw.wigner(CHEVRON, [1, 1], np.array([1, 0], dtype=np.int64), engine=engine)
    assert by_integers == pw.wigner(CHEVRON, [1.0, 1.0], [1.0, 0.0], engine=engine)


@transforms
def test_points_with_the_wrong_number_of_components_are_refused(transform, arguments, is_complex):
    # `fourier` accepts a third component and ignores it.
    wrong = 4 if transform is pw.fourier else 3
    for bad in (0.5, [0.5], [0.1] * wrong, np.zeros((2, wrong)), np.zeros((4, 0))):
        for place in range(arguments):
            points: list[Any] = [[0.1, 0.2]] * arguments
            points[place] = bad
            with pytest.raises(PolywignerError, match=r"expected .*2.*got"):
                transform(CHEVRON, *points)


PLACE, NU, COMPLEX = [0.9, 0.6], [0.0, 0.0], np.array([0.5 + 0.1j, 0.2])


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: pw.wigner(CHEVRON, "0.1 0.2", NU), r"expected .*got"),
        (lambda: pw.fourier(CHEVRON, [[1.0, 2.0], [3.0]]), "nu of shape .*different lengths"),
        (lambda: pw.fourier(CHEVRON, np.ma.masked_array([[1.0, 0.0]], [[0, 1]])), "masked"),
        (lambda: pw.wigner(CHEVRON, PLACE, COMPLEX), r"expected .*real.*got"),
        (lambda: pw.ambiguity(CHEVRON, COMPLEX, PLACE), r"expected .*real.*got"),
        (lambda: pw.wigner(CHEVRON, PLACE, NU, precision="quadruple"), "quadruple"),
    ],
)
def test_what_is_no_point_or_precision_is_refused(call, message):
    with pytest.raises(PolywignerError, match=message):
        call()


@pytest.mark.llvm
@pytest.mark.parametrize("source", [CHEVRON, pw.shapes.regular_polygon(64, 1.0)])
def test_of_drjit_arrays_no_points_give_no_values_and_unequal_numbers_are_refused(source):
    import drjit as dr
    import drjit.llvm as backend

    def points(count):
        return backend.Array2f(*np.zeros((2, count), np.float32))

    assert dr.width(pw.wigner(source, points(0), points(0))) == 0
    assert dr.width(pw.wigner(source, points(0), points(1))) == 0
    assert dr.width(pw.ambiguity(source, points(0), points(0)).imag) == 0
    none = backend.TensorXf(np.empty((0, 1, 2), np.float32))
    assert dr.shape(pw.wigner(source, none, np.zeros((5, 2)))) == (0, 5)
    assert dr.shape(pw.ambiguity(source, np.zeros((5, 2)), none)) == (0, 5, 2)
    for few, many in ((2, 3), (0, 2), (10_000, 20_000)):
        with pytest.raises(PolywignerError, match=f"got {few} and {many}"):
            pw.wigner(source, points(few), points(many))


@pytest.mark.llvm
def test_what_contradicts_a_drjit_array_is_refused():
    import drjit.llvm as backend

    point, double = backend.Array2f([0.9], [0.6]), backend.Array2f64([0.9], [0.6])
    with pytest.raises(PolywignerError, match=r"double.*single|single.*double|float32|float64"):
        pw.wigner(CHEVRON, point, point, precision="double")
    with pytest.raises(PolywignerError):
        pw.wigner(CHEVRON, point, double)
    with pytest.raises(PolywignerError):
        pw.wigner(CHEVRON, point, point, engine="cuda")


@pytest.mark.llvm
@pytest.mark.parametrize("transform", [pw.wigner, pw.ambiguity])
def test_many_drjit_samples_of_many_edges_keep_their_order_and_derivatives(transform):
    """Sorting the samples for the computation affects neither results nor derivatives."""
    import drjit as dr
    from drjit.llvm.ad import Array2f64, Float64

    source, count = pw.shapes.regular_polygon(64, 1.0), 5000
    x, nu = 2.0 * _points(count) - 1.0, 4.0 * _points(count, seed=1)
    arrays = [Array2f64(*(Float64(np.ascontiguousarray(c)) for c in v.T)) for v in (x, nu)]
    dr.enable_grad(arrays[1])
    value = transform(source, *arrays)
    real = value if transform is pw.wigner else value.real
    expected = transform(source, x, nu, engine="numpy").real
    assert real.numpy() == pytest.approx(expected, abs=1e-13)
    dr.backward(dr.sum(real * Float64(np.arange(count) % 7.0)))
    step = 1e-6 * np.array([1.0, 0.0])
    change = sum(s * transform(source, x, nu + s * step, engine="numpy").real for s in (1.0, -1.0))
    slopes = np.arange(count) % 7.0 * change / 2e-6
    assert dr.grad(arrays[1]).x.numpy() == pytest.approx(slopes, abs=1e-6)


@engines
def test_lags_on_the_borders_of_cells_do_not_change_others(engine):
    source = pw.shapes.regular_polygon(30, 1.0)
    axis = np.linspace(-2.0, 2.0, 301)
    lags = np.stack(np.meshgrid(axis, axis), axis=-1)
    values, expected = (pw.otf(source, lags, engine=name) for name in (engine, "numpy"))
    assert np.allclose(values, expected, rtol=0.0, atol=1e-12)
