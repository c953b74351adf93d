"""What goes in and what comes out, on every engine: shapes, types, errors, and the same values."""

from typing import Any

import numpy as np
import pytest

import polywigner as pw
from oracles.references import ENGINES, awkward
from polywigner.errors import PolywignerError

# (function, number of point arguments, complex result)
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
def test_one_point_gives_a_numpy_scalar(transform, arguments, is_complex, engine):
    value = transform(CHEVRON, *[[0.9, 0.6]] * arguments, engine=engine)
    assert isinstance(value, np.complex128 if is_complex else np.float64)
    assert np.ndim(value) == 0


@transforms
@engines
def test_the_result_has_the_type_of_its_precision(transform, arguments, is_complex, engine):
    for given in (np.float32, np.float64):  # NumPy input is computed in double unless asked
        points = [_points(3, seed=k).astype(given) for k in range(arguments)]
        value = transform(CHEVRON, *points, engine=engine)
        assert value.dtype == (np.complex128 if is_complex else np.float64)
    value = transform(CHEVRON, *points, engine=engine, precision="single")
    assert value.dtype == (np.complex64 if is_complex else np.float32)


@transforms
@engines
def test_no_points_give_no_values(transform, arguments, is_complex, engine):
    value = transform(CHEVRON, *[np.empty((0, 2))] * arguments, engine=engine)
    assert value.shape == (0,)
    value = transform(CHEVRON, *[np.empty((3, 0, 2))] * arguments, engine=engine)
    assert value.shape == (3, 0)


@engines
def test_lists_integers_and_strided_arrays_are_points_too(engine):
    x, nu = _points(6)[::2, ::-1], np.asfortranarray(_points(3, seed=1))
    expected = pw.wigner(CHEVRON, x.copy(), nu.copy(), engine=engine)
    assert np.array_equal(pw.wigner(CHEVRON, x, nu, engine=engine), expected)
    assert np.array_equal(pw.wigner(CHEVRON, x.tolist(), nu.tolist(), engine=engine), expected)
    by_integers = pw.wigner(CHEVRON, [1, 1], np.array([1, 0], dtype=np.int64), engine=engine)
    assert by_integers == pw.wigner(CHEVRON, [1.0, 1.0], [1.0, 0.0], engine=engine)


@engines
def test_arguments_are_left_as_they_were(engine):
    x, nu = _points(50), _points(50, seed=1)
    x.setflags(write=False)
    before = nu.copy()
    pw.wigner(CHEVRON, x, nu, engine=engine)
    assert np.array_equal(nu, before)


def test_lists_of_unequal_lengths_are_refused_with_the_shape_that_is_expected():
    with pytest.raises(PolywignerError, match=r"numbers of shape \(\.\.\., 2\)"):
        pw.fourier(CHEVRON, [[1.0, 2.0], [3.0]])


def test_masked_points_are_refused_rather_than_taken_without_their_mask():
    nu = np.ma.masked_array([[1.0, 0.0], [2.0, 0.0]], mask=[[0, 0], [1, 1]])
    with pytest.raises(PolywignerError, match="masked"):
        pw.fourier(CHEVRON, nu)
    assert pw.fourier(CHEVRON, np.ma.masked_array(nu.data)).shape == (2,)


@transforms
def test_points_with_the_wrong_number_of_components_are_refused(transform, arguments, is_complex):
    # the Fourier transform takes three components, and ignores the third
    wrong = 4 if transform is pw.fourier else 3
    for bad in (0.5, [0.5], [0.1] * wrong, np.zeros((2, wrong)), np.zeros((4, 0))):
        for place in range(arguments):
            points: list[Any] = [[0.1, 0.2]] * arguments
            points[place] = bad
            with pytest.raises(PolywignerError, match=r"expected .*2.*got"):
                transform(CHEVRON, *points)


def test_points_that_do_not_broadcast_are_refused():
    with pytest.raises(PolywignerError, match=r"expected .*got"):
        pw.wigner(CHEVRON, _points(3), _points(4))


@pytest.mark.parametrize("bad", ["0.1 0.2", [None, None], [[0.1, 0.2], [0.3]], object()])
def test_what_is_not_numbers_is_refused(bad):
    with pytest.raises(PolywignerError, match=r"expected .*got"):
        pw.wigner(CHEVRON, bad, [0.0, 0.0])


def test_complex_frequencies_are_for_the_fourier_transform_only():
    nu = np.array([0.5 + 0.1j, 0.2])
    assert isinstance(pw.fourier(CHEVRON, nu), np.complex128)
    with pytest.raises(PolywignerError, match=r"expected .*real.*got"):
        pw.wigner(CHEVRON, [0.9, 0.6], nu)
    with pytest.raises(PolywignerError, match=r"expected .*real.*got"):
        pw.ambiguity(CHEVRON, nu, [0.1, 0.1])


def test_unknown_engines_and_precisions_are_refused_by_name():
    with pytest.raises(PolywignerError, match="abacus"):
        pw.wigner(CHEVRON, [0.9, 0.6], [0, 0], engine="abacus")
    with pytest.raises(PolywignerError, match="quadruple"):
        pw.wigner(CHEVRON, [0.9, 0.6], [0, 0], precision="quadruple")


def test_what_is_not_an_aperture_is_refused():
    with pytest.raises(PolywignerError, match=r"expected .*got"):
        pw.wigner([[0, 0], [1, 0], [0, 1]], [0.1, 0.1], [0, 0])


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
def test_a_precision_that_contradicts_a_drjit_array_is_refused():
    import drjit.llvm as backend

    point = backend.Array2f([0.9], [0.6])
    with pytest.raises(PolywignerError, match=r"double.*single|single.*double|float32|float64"):
        pw.wigner(CHEVRON, point, point, precision="double")
    with pytest.raises(PolywignerError):
        pw.wigner(CHEVRON, point, backend.Array2f64([0.9], [0.6]))


@pytest.mark.llvm
def test_an_engine_that_contradicts_a_drjit_array_is_refused():
    import drjit.llvm as backend

    point = backend.Array2f([0.9], [0.6])
    with pytest.raises(PolywignerError):
        pw.wigner(CHEVRON, point, point, engine="cuda")
