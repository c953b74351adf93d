"""What is compiled once serves every later call: other numbers, shapes, strides and alignments."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import polywigner as pw

pytestmark = pytest.mark.llvm

SOURCES: dict[str, Callable[[], Any]] = {
    "square": lambda: pw.shapes.square(1.0),
    "chevron": lambda: pw.shapes.chevron(1.0, 1.1, 0.4),
    "by cells": lambda: pw.shapes.regular_polygon(40, 0.5),
    "two waves": lambda: pw.shapes.chevron(1.0, 1.1, 0.4).with_illumination(
        pw.Illumination([1.0, 0.5j], [[0.3, 0.1], [-0.2, 0.4]])
    ),
}


@contextmanager
def compiled() -> Iterator[list[Any]]:
    """The kernels that are new to this process, filled in at the end."""
    import drjit

    found: list[Any] = []
    drjit.kernel_history_clear()
    with drjit.scoped_set_flag(drjit.JitFlag.KernelHistory, True):
        yield found
        history = drjit.kernel_history([drjit.KernelType.JIT])
    found += [e["hash"] for e in history if e["cache_disk"] or not e["cache_hit"]]


def _unaligned(values: Any) -> Any:
    """The same numbers, eight bytes further than memory usually starts."""
    memory = np.empty(values.size + 1)
    memory[1:] = values.ravel()
    return memory[1:].reshape(values.shape)


@pytest.mark.parametrize("name", SOURCES)
@pytest.mark.parametrize(
    ("form", "transform", "precision"),
    [("outer product", pw.wigner, "double"), ("one by one", pw.ambiguity, "single")],
    ids=["outer product", "one by one"],
)
def test_a_second_call_compiles_nothing(
    form: str, transform: Callable[..., Any], name: str, precision: str, llvm: Any
) -> None:
    source = SOURCES[name]()
    rng = np.random.default_rng(3)

    def call(rows: int, columns: int, change: Callable[[Any], Any] = np.asarray) -> None:
        places = change(rng.uniform(-0.3, 0.3, (rows, 1, 2)))
        frequencies = change(rng.normal(size=(columns, 2)))
        points = [places, frequencies]
        if form == "one by one":
            points = [change(p.copy().reshape(-1, 2)) for p in np.broadcast_arrays(*points)]
        if transform is pw.ambiguity:
            points = points[::-1]
        transform(source, *points, precision=precision, engine="llvm")

    call(5, 300)
    call(80, 300)  # of many rows, sums are made beforehand
    with compiled() as found:
        call(5, 300, _unaligned)
        call(7, 411)
        call(70, 300, lambda p: np.asfortranarray(p))
        call(2, 1000, lambda p: np.repeat(p, 2, axis=0)[::2])
    assert found == []


def test_points_of_numpy_beside_arrays_of_the_engine_compile_nothing_anew(llvm: Any) -> None:
    import drjit as dr
    import drjit.llvm.ad as backend

    source, rng = SOURCES["square"](), np.random.default_rng(4)
    kept = []  # so that memory begins elsewhere in each call

    def call(count: int) -> None:
        kept.append(np.empty(count))
        x = backend.Array2f64(*rng.uniform(-0.5, 0.5, (2, count)).tolist())
        dr.enable_grad(x)
        dr.backward(pw.wigner(source, x, rng.normal(size=(count, 2))))
        dr.eval(dr.grad(x))

    call(50)
    with compiled() as found:
        for count in range(51, 60):
            call(count)
    assert found == []


_PROGRAM = """
import numpy as np, polywigner as pw
from polywigner.toolchain.llvm import prepare
prepare()
import drjit
drjit.set_flag(drjit.JitFlag.KernelHistory, True)
points = np.random.default_rng({seed}).normal(size=(2, 5000 + {seed}, 2))
pw.wigner(pw.shapes.chevron(1.0, 1.1, 0.4), *points, engine="llvm")
history = drjit.kernel_history([drjit.KernelType.JIT])
print([bool(e["cache_disk"]) for e in history if not e["cache_hit"] or e["cache_disk"]])
"""


@pytest.mark.slow
def test_another_process_finds_compiled_kernels_on_disk(tmp_path: Path, llvm: Any) -> None:
    environment = {**os.environ, "HOME": str(tmp_path)}
    seen = []
    for seed in (1, 2):
        command = [sys.executable, "-c", _PROGRAM.format(seed=seed)]
        run = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
        seen.append(run.stdout.strip())
    assert "False" in seen[0]
    assert seen[1].strip("[]") and "False" not in seen[1]
