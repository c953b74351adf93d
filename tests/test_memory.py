"""Memory is bounded by what is given and what is returned, whatever the number of samples."""

from __future__ import annotations

import tracemalloc
from typing import Any

import numpy as np
import pytest

import polywigner as pw
from oracles.references import ENGINES

MIB = 1 << 20
# Beside the result: two chunks, of which one is computed and one on its way. Copies took 64 more.
CHUNK = 40 * MIB


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("form", ["outer product", "one place", "one by one"])
def test_no_copy_of_all_samples_is_made(form: str, engine: str) -> None:
    rng, count = np.random.default_rng(3), 1 << 21
    # of single precision: a copy of all in double precision would be 32 MiB for each argument
    x: Any = rng.random((count, 2), dtype=np.float32) - 0.5
    nu: Any = rng.random((count, 2), dtype=np.float32)
    if form == "outer product":
        x, nu = x[:1024, None], nu[: count // 1024]
    elif form == "one place":
        x = x[0]
    square = pw.shapes.square(1.0)
    how = {"engine": engine, "precision": "single"}
    pw.wigner(square, (0.0, 0.0), nu[:512], **how)  # what is made once
    tracemalloc.start()
    try:
        found = pw.wigner(square, x, nu, **how)
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert found.size == count
    assert peak < found.nbytes + CHUNK
