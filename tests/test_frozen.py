"""Recorded kernels return the same values in every later call."""

import subprocess
import sys
import threading

import numpy as np
import pytest

import polywigner as pw

pytestmark = pytest.mark.llvm

SQUARE = pw.shapes.square(1.0)
CHEVRON = pw.shapes.chevron(2.0, 1.2, 0.4)
# Allowed difference between repeated calls, which launch the same kernel.
EXACT = 0.0
# Rounding error in double precision, relative to the area.
ROUNDING = 1e-12


def points(count, seed=0):
    rng = np.random.default_rng(seed)
    return rng.uniform(-0.5, 0.5, (count, 2)), rng.uniform(-5, 5, (count, 2))


def in_engine(*arrays, ad=False):
    import drjit as dr
    import drjit.llvm
    import drjit.llvm.ad

    backend = drjit.llvm.ad if ad else drjit.llvm

    result = [backend.Array2f64(*(column.tolist() for column in a.T)) for a in arrays]
    dr.eval(result)
    return result


def largest(difference):
    return float(np.abs(np.array(difference)).max())


def test_any_number_of_samples_goes_through_a_kernel_traced_once():
    for seed, count in enumerate([1000, 7, 1, 20_000, 1, 33]):
        x, nu = points(count, seed)
        for source in (SQUARE, CHEVRON):
            expected = pw.wigner(source, x, nu, engine="numpy")
            allowed = ROUNDING * source.area
            assert largest(pw.wigner(source, x, nu, engine="llvm") - expected) < allowed
            result = np.array(pw.wigner(source, *in_engine(x, nu)))
            assert largest(result - expected) < allowed


def test_repeated_calls_at_drjit_points_keep_values_and_gradients():
    """Such calls are recorded from the eighth call on."""
    import drjit as dr

    moved = pw.shapes.regular_polygon(30, 0.5).moved((0.3, -0.1))
    tapered = CHEVRON.with_illumination(pw.cosine_taper(2.0, 1.2))
    sizes = [1000, 7, 1, 20_000, 1, 33, 4, 500, 1, 3000, 5]
    for transform, source in (
        (pw.wigner, SQUARE),
        (pw.wigner, moved),
        (pw.wigner, tapered),
        (pw.ambiguity, CHEVRON),
        (pw.ambiguity, moved),
        (pw.fourier, moved),
    ):
        gradients = []
        for seed, count in enumerate(sizes):
            given = points(count, seed)[-1:] if transform is pw.fourier else points(count, seed)
            expected = transform(source, *given, engine="numpy")
            in_drjit = transform(source, *in_engine(*given, ad=True))
            parts = [in_drjit.real, in_drjit.imag] if dr.is_complex_v(in_drjit) else [in_drjit]
            values = np.array(parts[0]) + 1j * np.array(parts[-1]) * (len(parts) - 1)
            assert largest(values - expected) < ROUNDING
            if seed in (0, len(sizes) - 1):
                fixed = in_engine(*points(100), ad=True)[-len(given) :]
                dr.enable_grad(*fixed)
                dr.backward(dr.sum(dr.real(transform(source, *fixed))))
                gradients.append(np.concatenate([np.array(dr.grad(array)) for array in fixed]))
        assert largest(gradients[0]) > 0.0
        assert largest(gradients[0] - gradients[1]) == EXACT


def test_every_transform_repeats_itself():
    x, nu = points(300)
    tapered = SQUARE.with_illumination(pw.cosine_taper(1.0, 1.0))
    for source in (CHEVRON, tapered, pw.shapes.regular_polygon(40, 0.5)):
        for transform, given in (
            (pw.fourier, (nu,)),
            (pw.wigner, (x, nu)),
            (pw.ambiguity, (nu, x)),
            (pw.autocorrelation, (x, x)),
            (pw.position_marginal, (x,)),
        ):
            calls = [transform(source, *given, engine="llvm") for _ in range(3)]
            assert largest(calls[0] - calls[1]) == largest(calls[0] - calls[2]) == EXACT
            expected = transform(source, *given, engine="numpy")
            assert largest(calls[2] - expected) < ROUNDING * max(source.area, 1.0)


def test_threads_may_call_the_same_kernels_at_once():
    """Dr.Jit crashes if two threads record the same function."""
    sources = [pw.shapes.triangle(1.0, 0.7 + k / 100) for k in range(10)]
    given = [points(200 + 10 * k, k) for k in range(4)]
    expected = [[pw.wigner(s, *p, engine="numpy") for s in sources] for p in given]
    together = threading.Barrier(len(given))
    worst = [1.0] * len(given)

    def work(k):
        result = []
        for source, values in zip(sources, expected[k], strict=True):
            together.wait(timeout=60)
            result += [pw.wigner(source, *given[k], engine="llvm") - values for _ in range(3)]
        worst[k] = largest(result)

    threads = [threading.Thread(target=work, args=(k,)) for k in range(len(given))]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert max(worst) < ROUNDING


REMEMBERED = """
import polywigner as pw, numpy as np
x = np.full((100, 2), 0.1)
for source in (pw.shapes.square(1.0), pw.shapes.regular_polygon(40, 1.0)):
    pw.wigner(source, x, x, engine='llvm')
    pw.wigner(source, x, x, engine='llvm')
"""
RECORDED_BY_A_CALLER = """
import numpy as np, polywigner as pw
from polywigner.llvm import prepare
prepare()
import drjit, drjit.llvm as backend
nu = np.array([0.3, 0.2])
value = drjit.freeze(lambda x: pw.wigner(pw.shapes.square(1.0), x, nu))
x = backend.Array2f64([0.1, 0.2, 0.3], [0.0, 0.1, 0.2])
assert np.array_equal(value(x), value(x))
assert np.allclose(value(x), pw.wigner(pw.shapes.square(1.0), x, nu))
"""
# Garbage collection of NumPy memory must not run during the recording of a kernel.
GARBAGE = """
import gc
import sys
import drjit
import numpy as np
from drjit.llvm import Float64
import polywigner as pw

gc.set_threshold(0)
for _ in range(100):  # each in a circle of its own, which a collection alone can free
    circle = [Float64(np.arange(10.0))]
    circle.append(circle)
del circle

def profile(*event):
    if drjit.flag(drjit.JitFlag.FreezingScope):
        sys.setprofile(None)
        gc.set_threshold(1, 1, 1)

sys.setprofile(profile)
pw.wigner(pw.shapes.chevron(2.0, 1.2, 0.4), np.zeros((300, 2)), np.ones((300, 2)), engine="llvm")
assert sys.getprofile() is None, "nothing was recorded"
assert gc.isenabled()
"""


@pytest.mark.parametrize(
    "code", [REMEMBERED, GARBAGE, pytest.param(RECORDED_BY_A_CALLER, marks=pytest.mark.slow)]
)
def test_a_process_with_recorded_kernels_ends_in_silence(code):
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
