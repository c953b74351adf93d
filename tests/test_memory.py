"""Memory is bounded by what is given and what is returned, whatever the number of samples."""

import sys
import time
import tracemalloc
from typing import Any

import numpy as np
import pytest

import polywigner as pw
from oracles.references import ENGINES

MIB = 1 << 20
# Beside the result: two chunks, of which one is computed and one on its way. Copies took 64 more.
CHUNK = 40 * MIB
# Sums over elements or waves hold some arrays of a block of 2^19 samples. Of all samples they
# would be 200 to 450 MiB.
BLOCK = 100 * MIB
# Of sums in single precision, whose largest value is 3.
ROUNDING = 1e-5


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("form", ["outer product", "one place", "one by one"])
def test_no_copy_of_all_samples_is_made(form, engine):
    rng, count = np.random.default_rng(3), 1 << 22
    # Single precision: four expanded components would take 64 MiB, and 128 MiB in double precision.
    x: Any = rng.random((count, 2), dtype=np.float32) - 0.5
    nu: Any = rng.random((count, 2), dtype=np.float32)
    if form == "outer product":
        x, nu = x[:1024, None], nu[: count // 1024]
    elif form == "one place":
        x = x[0]
    square = pw.shapes.square(1.0)
    how = {"engine": engine, "precision": "single"}
    pw.wigner(square, (0.0, 0.0), nu[:512], **how)  # what is made once
    result, peak = peak_of(pw.wigner, square, x, nu, **how)
    assert result.size == count
    assert peak < result.nbytes + CHUNK


def peak_of(transform, *arguments, **how):
    tracemalloc.start()
    try:
        result = transform(*arguments, **how)
        return result, tracemalloc.get_traced_memory()[1]
    finally:
        # Threads of Dr.Jit let go of NumPy's arrays a little later. CPython may end the process if
        # they do so while tracing stops (gh-128679).
        if "drjit" in sys.modules:
            sys.modules["drjit"].sync_thread()
            wait_for_threads()
        tracemalloc.stop()


def wait_for_threads():
    """Until no memory has been let go of for a while: Dr.Jit does not tell when it has done so."""
    before, quiet = -1, 0
    for _ in range(200):
        now = tracemalloc.get_traced_memory()[0]
        quiet = quiet + 1 if abs(now - before) < MIB // 16 else 0
        if quiet == 8:
            return
        before = now
        time.sleep(0.025)


@pytest.mark.parametrize("source", ["array", pytest.param("waves", marks=pytest.mark.slow)])
def test_sums_of_transforms_hold_some_samples_at_a_time(source):
    count = 1 << 22
    nu: Any = np.random.default_rng(3).random((count, 2), dtype=np.float32)
    square = pw.shapes.square(1.0)
    waves = pw.Illumination([1.0, 0.5], [[0.0, 0.0], [0.3, 0.2]])
    summed: Any = {
        "array": pw.phased_array(square, [[0.0, 0.0], [1.5, 0.2], [0.1, 2.0]]),
        "waves": pw.shapes.triangle(1.0, 1.0).with_illumination(waves),
    }[source]
    some = slice(count - 1000, None)
    result, peak = peak_of(pw.fourier, summed, nu, precision="single")
    assert peak < result.nbytes + BLOCK
    expected = pw.fourier(summed, nu[some], engine="numpy")
    assert np.abs(result[some] - expected).max() < ROUNDING
