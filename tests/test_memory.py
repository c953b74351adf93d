"""Bounds of memory for any number of samples."""

import sys
import time
import tracemalloc
from collections import deque
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
import pytest

import polywigner as pw
from oracles.references import numpy_and_few

MIB = 1 << 20
# Largest memory for two chunks in addition to the result. Copies would take 64 MiB more.
CHUNK = 40 * MIB
# Largest memory for blocks of 2^19 samples in sums over elements or waves. All samples together
# would take 200 to 450 MiB.
BLOCK = 100 * MIB
# Rounding error in single precision, for values up to 3.
ROUNDING = 1e-5


@pytest.mark.parametrize(
    ("form", "engine"),
    numpy_and_few(["outer product", "one place"], ["outer product", "one place", "one by one"]),
)
def test_no_copy_of_all_samples_is_made(form, engine):
    rng, count = np.random.default_rng(3), 1 << 22
    # Four expanded components would take 64 MiB, and 128 MiB in double precision.
    x: Any = rng.random((count, 2), dtype=np.float32) - 0.5
    nu: Any = rng.random((count, 2), dtype=np.float32)
    if form == "outer product":
        x, nu = x[:1024, None], nu[: count // 1024]
    elif form == "one place":
        x = x[0]
    square = pw.shapes.square(1.0)
    how = {"engine": engine, "precision": "single"}
    pw.wigner(square, (0.0, 0.0), nu[:512], **how)  # fill the caches
    result, peak = peak_of(pw.wigner, square, x, nu, **how)
    assert result.size == count
    assert peak < result.nbytes + CHUNK


def peak_of(transform, *arguments, **how):
    tracemalloc.start()
    try:
        result = transform(*arguments, **how)
        return result, tracemalloc.get_traced_memory()[1]
    finally:
        # Threads of Dr.Jit release NumPy arrays later. CPython may crash if this happens while
        # tracing stops (gh-128679).
        if "drjit" in sys.modules:
            sys.modules["drjit"].sync_thread()
            wait_for_threads()
        tracemalloc.stop()


def wait_for_threads():
    """Wait until no more memory is released. Dr.Jit does not report when its threads are done."""
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


def test_threads_share_the_lists_of_pairs_of_edges(monkeypatch):
    """Mitsuba loads the sources of a scene file in threads."""
    older = deque(({}, number, 0) for number in range(20_000))  # the search takes long
    monkeypatch.setattr("polywigner.kernels.cut.winding._cached", older)
    outlines = [pw.shapes.regular_polygon(20 + k, 1.0) for k in range(20)]
    x, nu = np.random.default_rng(0).uniform(-0.4, 0.4, (2, 50, 2))
    interval = sys.getswitchinterval()
    sys.setswitchinterval(1e-5)
    try:
        with ThreadPoolExecutor(4) as pool:
            results = list(pool.map(lambda s: pw.wigner(s, x, nu, engine="numpy"), outlines))
    finally:
        sys.setswitchinterval(interval)
    expected = pw.wigner(pw.shapes.regular_polygon(20, 1.0), x, nu, engine="numpy")
    assert np.array_equal(results[0], expected)
