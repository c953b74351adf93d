"""The comparison with other packages by ``make bench``."""

import sys
from pathlib import Path

import numpy as np
import pytest

import polywigner as pw

sys.path.append(str(Path(__file__).parents[1]))

from benchmarks import timing
from benchmarks.peers import cpp, jax_kernel, libformfactor
from benchmarks.questions import polyhedra, wigner

pytestmark = pytest.mark.slow  # kernels of peers are compiled

TINY = timing.Effort(rounds=2, seconds=1e-4, most=1 << 8, checked=3, quick=True)
# Rounding errors relative to the area: float32 after tens of cycles of phase, and float64.
SINGLE, DOUBLE = 5e-6, 1e-13
# Difference from libformfactor, relative to the volume. libformfactor switches between series and
# closed forms.
PEER_OF_BODIES = 1e-10


@pytest.mark.skipif(cpp.compiler() is None, reason="no C++ compiler here")
@pytest.mark.parametrize("precision", ["single", "double"])
@pytest.mark.parametrize("case", ["chevron", "18 hexagons"])  # unrolled; loops over tables
def test_the_kernel_in_cpp_gives_the_wigner_function(case, precision):
    source = wigner.SOURCES[case]()
    x, nu = wigner.points(source, 203)  # not a multiple of the vector length
    result = wigner.in_cpp(source, precision, 1)(x, nu)()
    expected = pw.wigner(source, x, nu, engine="numpy")
    error = np.abs(result - expected).max() / source.area
    assert error < (SINGLE if precision == "single" else DOUBLE)


@pytest.mark.skipif(not jax_kernel.available(), reason="JAX is not installed")
def test_the_kernel_traced_by_jax_gives_the_wigner_function():
    source = wigner.SOURCES["chevron"]()
    x, nu = wigner.points(source, 1000)  # more samples than the direct NumPy path takes
    result = np.asarray(wigner.in_jax(source, "double")(x, nu)())
    expected = pw.wigner(source, x, nu, engine="numpy")
    assert np.abs(result - expected).max() < DOUBLE * source.area


@pytest.fixture
def own_threads():
    """Restore the number of threads after measurements in this process."""
    drjit = pytest.importorskip("drjit")
    before = drjit.thread_count()
    yield
    drjit.set_thread_count(before)


@pytest.mark.usefixtures("own_threads")
@pytest.mark.parametrize("case", ["square", "two chevrons"])
def test_all_contenders_for_w_meet_the_exact_values(case, monkeypatch):
    monkeypatch.setattr(jax_kernel, "available", lambda: False)
    monkeypatch.setattr(cpp, "compiler", lambda: None)
    lines = wigner.measure(case, 1, TINY)
    assert {line.precision for line in lines} == {"single", "double"}
    for line in lines:
        for figure in filter(None, (line.ours, line.theirs)):
            assert figure.error is not None
            assert figure.error < (SINGLE if line.precision == "single" else DOUBLE)
            assert 0 < figure.median <= figure.best
    missing = {line.peer: line.note for line in lines if line.theirs is None}
    assert "pip install jax" in missing["JAX"] and "compiler" in missing["C++"]


@pytest.mark.skipif(not libformfactor.available(), reason="BornAgain is not installed")
@pytest.mark.parametrize("case", polyhedra.CASES)
def test_libformfactor_has_the_same_bodies(case):
    body = polyhedra.BODIES[case]()
    source, shape = body.source, libformfactor.body(body.name, *body.sizes)
    nu = np.random.default_rng(0).normal(size=(50, 3))
    expected = pw.fourier(source, nu, engine="numpy")
    result = [libformfactor.from_python(shape, nu)]
    if cpp.compiler() is not None:
        result.append(libformfactor.from_cpp(shape, polyhedra.centre(source))(nu))
    assert np.abs(np.array(result) - expected).max() < PEER_OF_BODIES * source.volume
