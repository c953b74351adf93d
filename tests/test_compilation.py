"""Kernels are compiled once for all numbers, shapes, strides and alignments."""

from collections.abc import Callable
from contextlib import contextmanager
from typing import Any

import numpy as np
import pytest

import polywigner as pw
from polywigner.errors import GeometryError

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
def compiled():
    """Yield a list that contains the kernels compiled in the block."""
    import drjit

    result: list[Any] = []
    drjit.kernel_history_clear()
    with drjit.scoped_set_flag(drjit.JitFlag.KernelHistory, True):
        yield result
        history = drjit.kernel_history([drjit.KernelType.JIT])
    result += [e["hash"] for e in history if e["cache_disk"] or not e["cache_hit"]]


def _unaligned(values):
    """Return a copy at an unaligned address."""
    memory = np.empty(values.size + 1)
    memory[1:] = values.ravel()
    return memory[1:].reshape(values.shape)


@pytest.mark.parametrize("name", SOURCES)
@pytest.mark.parametrize(
    ("form", "transform", "precision"),
    [("outer product", pw.wigner, "double"), ("one by one", pw.ambiguity, "single")],
    ids=["outer product", "one by one"],
)
def test_a_second_call_compiles_nothing(form, transform, name, precision, llvm):
    source = SOURCES[name]()
    rng = np.random.default_rng(3)

    def call(rows, columns, change=np.asarray):
        places = change(rng.uniform(-0.3, 0.3, (rows, 1, 2)))
        frequencies = change(rng.normal(size=(columns, 2)))
        points = [places, frequencies]
        if form == "one by one":
            points = [change(p.copy().reshape(-1, 2)) for p in np.broadcast_arrays(*points)]
        if transform is pw.ambiguity:
            points = points[::-1]
        transform(source, *points, precision=precision, engine="llvm")

    call(5, 300)
    call(80, 300)  # several rows share sums
    with compiled() as result:
        call(5, 300, _unaligned)
        call(7, 411)
        call(70, 300, lambda p: np.asfortranarray(p))
        call(2, 1000, lambda p: np.repeat(p, 2, axis=0)[::2])
    assert result == []


def test_points_of_numpy_beside_arrays_of_the_engine_compile_nothing_anew(llvm):
    import drjit as dr
    import drjit.llvm.ad as backend

    source, rng = SOURCES["square"](), np.random.default_rng(4)
    kept = []  # keeps memory, so that each call has another address

    def call(count):
        kept.append(np.empty(count))
        x = backend.Array2f64(*rng.uniform(-0.5, 0.5, (2, count)).tolist())
        dr.enable_grad(x)
        dr.backward(pw.wigner(source, x, rng.normal(size=(count, 2))))
        dr.eval(dr.grad(x))

    call(50)
    with compiled() as result:
        for count in range(51, 60):
            call(count)
    assert result == []


# Largest number of kernels: for W, A and F, with or without vertices on a grid, and with lines of
# both orientations.
MOST_FORMS = 12
# Rounding error of sums of ten terms, relative to the area.
DOUBLE = 2e-12
TRANSFORMS: dict[str, Callable[..., Any]] = {
    "wigner": pw.wigner,
    "ambiguity": lambda source, x, nu, **how: pw.ambiguity(source, nu, x, **how),
    "fourier": lambda source, x, nu, **how: pw.fourier(source, nu, **how),
}


def random_outlines(seed):
    rng = np.random.default_rng(seed)
    while True:
        count = rng.integers(3, 13)
        angle, radius = np.sort(rng.random(count)) * 2 * np.pi, 0.3 + 0.7 * rng.random(count)
        try:
            yield pw.Aperture(radius[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1))
        except GeometryError:
            continue


@pytest.mark.parametrize("name", TRANSFORMS)
def test_any_number_of_outlines_needs_a_few_kernels(name):
    rng, outlines = np.random.default_rng(3), random_outlines(4)

    def call(count):
        for source in (next(outlines) for _ in range(count)):
            x, nu = rng.normal(size=(2, 50, 2))
            result = TRANSFORMS[name](source, x, nu, engine="llvm")
            error = np.abs(result - TRANSFORMS[name](source, x, nu, engine="numpy")).max()
            assert error <= DOUBLE * source.area

    with compiled() as first:
        call(12)
    with compiled() as more:
        call(24)
    assert len(set(first)) + len(set(more)) <= MOST_FORMS
    assert len(more) < MOST_FORMS // 2


@pytest.mark.parametrize("derivatives", [False, True])
def test_arrays_of_the_engine_need_no_kernel_of_their_own(derivatives):
    import drjit as dr
    import drjit.llvm.ad as backend

    rng, outlines = np.random.default_rng(8), random_outlines(9)

    def call(count):
        for source in (next(outlines) for _ in range(count)):
            x, nu = (backend.Array2f64(*v.tolist()) for v in rng.normal(size=(2, 2, 50)))
            if derivatives:
                dr.enable_grad(x)
            value = pw.wigner(source, x, nu)
            if derivatives:
                dr.backward(value)
            dr.eval(dr.grad(x) if derivatives else value)

    call(10)
    with compiled() as result:
        call(10)
    assert len(result) < MOST_FORMS
