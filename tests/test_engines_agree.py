"""What goes in and what comes out, on every engine: shapes, types, errors, and the same values."""

from __future__ import annotations

import os
import subprocess
import sys
import tracemalloc
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import polywigner as pw
from oracles.references import ENGINES, awkward
from polywigner.errors import PolywignerError

# Two engines round differently: a few units of the double's, or single's, last place of the area.
AGREEMENT = {"double": 1e-13, "single": 5e-6}

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


def _points(*shape: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).uniform(0, 1, (*shape, 2))


@transforms
@engines
def test_one_point_gives_a_numpy_scalar(
    transform: Callable[..., Any], arguments: int, is_complex: bool, engine: str
) -> None:
    value = transform(CHEVRON, *[[0.9, 0.6]] * arguments, engine=engine)
    assert isinstance(value, np.complex128 if is_complex else np.float64)
    assert np.ndim(value) == 0


@transforms
@engines
def test_the_result_has_the_type_of_its_precision(
    transform: Callable[..., Any], arguments: int, is_complex: bool, engine: str
) -> None:
    for given in (np.float32, np.float64):  # NumPy input is computed in double unless asked
        points = [_points(3, seed=k).astype(given) for k in range(arguments)]
        value = transform(CHEVRON, *points, engine=engine)
        assert value.dtype == (np.complex128 if is_complex else np.float64)
    value = transform(CHEVRON, *points, engine=engine, precision="single")
    assert value.dtype == (np.complex64 if is_complex else np.float32)


@transforms
@engines
def test_no_points_give_no_values(
    transform: Callable[..., Any], arguments: int, is_complex: bool, engine: str
) -> None:
    value = transform(CHEVRON, *[np.empty((0, 2))] * arguments, engine=engine)
    assert value.shape == (0,)
    value = transform(CHEVRON, *[np.empty((3, 0, 2))] * arguments, engine=engine)
    assert value.shape == (3, 0)


@engines
def test_lists_integers_and_strided_arrays_are_points_too(engine: str) -> None:
    x, nu = _points(6)[::2, ::-1], np.asfortranarray(_points(3, seed=1))
    expected = pw.wigner(CHEVRON, x.copy(), nu.copy(), engine=engine)
    assert np.array_equal(pw.wigner(CHEVRON, x, nu, engine=engine), expected)
    assert np.array_equal(pw.wigner(CHEVRON, x.tolist(), nu.tolist(), engine=engine), expected)
    by_integers = pw.wigner(CHEVRON, [1, 1], np.array([1, 0], dtype=np.int64), engine=engine)
    assert by_integers == pw.wigner(CHEVRON, [1.0, 1.0], [1.0, 0.0], engine=engine)


@engines
def test_arguments_are_left_as_they_were(engine: str) -> None:
    x, nu = _points(50), _points(50, seed=1)
    x.setflags(write=False)
    before = nu.copy()
    pw.wigner(CHEVRON, x, nu, engine=engine)
    assert np.array_equal(nu, before)


@engines
@pytest.mark.parametrize("precision", ["double", "single"])
def test_many_calls_and_sizes_give_the_same_values(engine: str, precision: str) -> None:
    """Chunks, vector tails and caches must not show."""
    x, nu = _points(70_001), _points(70_001, seed=1)
    whole = pw.wigner(CHEVRON, x, nu, engine=engine, precision=precision)
    allowed = AGREEMENT[precision] * CHEVRON.area
    for part in (slice(0, 1), slice(0, 7), slice(65_530, 65_545), slice(-1, None)):
        again = pw.wigner(CHEVRON, x[part], nu[part], engine=engine, precision=precision)
        assert np.abs(again - whole[part]).max() < allowed


def test_lists_of_unequal_lengths_are_refused_with_the_shape_that_is_expected() -> None:
    with pytest.raises(PolywignerError, match=r"numbers of shape \(\.\.\., 2\)"):
        pw.fourier(CHEVRON, [[1.0, 2.0], [3.0]])


def test_masked_points_are_refused_rather_than_taken_without_their_mask() -> None:
    nu = np.ma.masked_array([[1.0, 0.0], [2.0, 0.0]], mask=[[0, 0], [1, 1]])
    with pytest.raises(PolywignerError, match="masked"):
        pw.fourier(CHEVRON, nu)
    assert pw.fourier(CHEVRON, np.ma.masked_array(nu.data)).shape == (2,)


@transforms
def test_points_with_the_wrong_number_of_components_are_refused(
    transform: Callable[..., Any], arguments: int, is_complex: bool
) -> None:
    # the Fourier transform takes three components, and ignores the third
    wrong = 4 if transform is pw.fourier else 3
    for bad in (0.5, [0.5], [0.1] * wrong, np.zeros((2, wrong)), np.zeros((4, 0))):
        for place in range(arguments):
            points: list[Any] = [[0.1, 0.2]] * arguments
            points[place] = bad
            with pytest.raises(PolywignerError, match=r"expected .*2.*got"):
                transform(CHEVRON, *points)


def test_points_that_do_not_broadcast_are_refused() -> None:
    with pytest.raises(PolywignerError, match=r"expected .*got"):
        pw.wigner(CHEVRON, _points(3), _points(4))


@pytest.mark.parametrize("bad", ["0.1 0.2", [None, None], [[0.1, 0.2], [0.3]], object()])
def test_what_is_not_numbers_is_refused(bad: Any) -> None:
    with pytest.raises(PolywignerError, match=r"expected .*got"):
        pw.wigner(CHEVRON, bad, [0.0, 0.0])


def test_complex_frequencies_are_for_the_fourier_transform_only() -> None:
    nu = np.array([0.5 + 0.1j, 0.2])
    assert isinstance(pw.fourier(CHEVRON, nu), np.complex128)
    with pytest.raises(PolywignerError, match=r"expected .*real.*got"):
        pw.wigner(CHEVRON, [0.9, 0.6], nu)
    with pytest.raises(PolywignerError, match=r"expected .*real.*got"):
        pw.ambiguity(CHEVRON, nu, [0.1, 0.1])


def test_unknown_engines_and_precisions_are_refused_by_name() -> None:
    with pytest.raises(PolywignerError, match="abacus"):
        pw.wigner(CHEVRON, [0.9, 0.6], [0, 0], engine="abacus")
    with pytest.raises(PolywignerError, match="quadruple"):
        pw.wigner(CHEVRON, [0.9, 0.6], [0, 0], precision="quadruple")


def test_what_is_not_an_aperture_is_refused() -> None:
    with pytest.raises(PolywignerError, match=r"expected .*got"):
        pw.wigner([[0, 0], [1, 0], [0, 1]], [0.1, 0.1], [0, 0])


def test_without_an_llvm_library_auto_computes_and_llvm_says_what_is_missing() -> None:
    program = """
import polywigner as pw
from polywigner.errors import EngineError
source = pw.Aperture([[0, 0], [1, 0], [0, 1]])
point = [0.3, 0.3], [0, 0]
print(pw.wigner(source, *point) == pw.wigner(source, *point, engine="numpy"))
try:
    pw.wigner(source, [0.3, 0.3], [0, 0], engine="llvm")
except EngineError as error:
    print(error)
"""
    environment = {**os.environ, "POLYWIGNER_NO_LLVM": "1"}
    answer = subprocess.run(
        [sys.executable, "-c", program], env=environment, capture_output=True, text=True, timeout=60
    )
    assert answer.returncode == 0, answer.stderr
    same, message = answer.stdout.splitlines()
    assert same == "True"
    assert "LLVM" in message


def test_an_outer_product_of_millions_needs_little_more_than_its_result() -> None:
    source = awkward("square").aperture
    x, nu = _points(1500, 1), _points(1, 1500, seed=1)
    tracemalloc.start()
    value = pw.wigner(source, x, nu, engine="numpy")
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert value.shape == (1500, 1500)
    assert peak < value.nbytes + 60e6  # one chunk's temporaries, whatever the size


@pytest.mark.llvm
@pytest.mark.parametrize("precision", ["single", "double"])
def test_drjit_arrays_in_give_drjit_arrays_out(precision: str) -> None:
    import drjit as dr
    import drjit.llvm as backend

    double = precision == "double"
    vector = backend.Array2f64 if double else backend.Array2f
    tensor = backend.TensorXf64 if double else backend.TensorXf
    real = backend.Float64 if double else backend.Float
    x, nu = _points(40), _points(40, seed=1)
    expected = pw.wigner(CHEVRON, x, nu, engine="numpy")
    allowed = AGREEMENT[precision] * CHEVRON.area
    components = pw.wigner(CHEVRON, vector(*x.T.copy()), vector(*nu.T.copy()))
    assert isinstance(components, real)
    assert np.abs(np.array(components) - expected).max() < allowed
    last = pw.wigner(CHEVRON, tensor(x.reshape(8, 5, 2)), tensor(nu.reshape(8, 5, 2)))
    assert isinstance(last, tensor) and dr.shape(last) == (8, 5)
    assert np.abs(np.array(last).ravel() - expected).max() < allowed
    amplitude = pw.fourier(CHEVRON, vector(*nu.T.copy()))
    got = np.array(amplitude.real) + 1j * np.array(amplitude.imag)
    assert np.abs(got - pw.fourier(CHEVRON, nu, engine="numpy")).max() < allowed


@pytest.mark.llvm
@pytest.mark.parametrize("source", [CHEVRON, pw.shapes.regular_polygon(64, 1.0)])
def test_of_drjit_arrays_no_points_give_no_values_and_unequal_numbers_are_refused(
    source: pw.Aperture,
) -> None:
    import drjit as dr
    import drjit.llvm as backend

    def points(count: int) -> Any:
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
def test_of_drjit_arrays_no_frequencies_give_no_values_of_arrays_either() -> None:
    import drjit as dr
    import drjit.llvm as backend

    places = [[1.5 * k, 0.0] for k in range(30)]
    square = pw.shapes.square(1.0)
    none = backend.Array2f(*np.zeros((2, 0), np.float32))
    no_tensor = backend.TensorXf(np.empty((0, 2), np.float32))
    for array in (pw.Array([square, CHEVRON], [1, 0.5j]), pw.phased_array(square, places)):
        assert dr.width(pw.fourier(array, none).real) == 0
        assert dr.shape(pw.fourier(array, no_tensor)) == (0, 2)


@pytest.mark.llvm
def test_threads_that_begin_together_find_the_engine_whole() -> None:
    code = """
import threading, time, numpy as np, polywigner as pw
errors = []
def work(k):
    time.sleep(0.005 * k)  # while another one imports
    try:
        pw.fourier(pw.shapes.square(1.0), np.zeros((5, 2)), engine="llvm")
    except BaseException as error:
        errors.append(error)
threads = [threading.Thread(target=work, args=(k,)) for k in range(60)]
[thread.start() for thread in threads]
[thread.join() for thread in threads]
assert not errors, errors
"""
    subprocess.run([sys.executable, "-c", code], check=True)


@pytest.mark.llvm
def test_a_precision_that_contradicts_a_drjit_array_is_refused() -> None:
    import drjit.llvm as backend

    point = backend.Array2f([0.9], [0.6])
    with pytest.raises(PolywignerError, match=r"double.*single|single.*double|float32|float64"):
        pw.wigner(CHEVRON, point, point, precision="double")
    with pytest.raises(PolywignerError):
        pw.wigner(CHEVRON, point, backend.Array2f64([0.9], [0.6]))


@pytest.mark.llvm
def test_an_engine_that_contradicts_a_drjit_array_is_refused() -> None:
    import drjit.llvm as backend

    point = backend.Array2f([0.9], [0.6])
    with pytest.raises(PolywignerError):
        pw.wigner(CHEVRON, point, point, engine="cuda")
