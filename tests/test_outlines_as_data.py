"""One compiled kernel for all outlines: the values of other ways, and few kernels."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
import shapely

import polywigner as pw
from polywigner.errors import GeometryError
from polywigner.plans import forced
from test_compilation import compiled

# Of sums of some ten terms, each good to an ulp or two of the area; single precision of 6e-8.
DOUBLE, SINGLE = 2e-13, 3e-5
# Of W, A and F: with or without vertices on a grid, pieces turned over, lines of both kinds.
MOST_FORMS = 12

TRANSFORMS: dict[str, Callable[..., Any]] = {
    "wigner": pw.wigner,
    "ambiguity": lambda source, x, nu, **how: pw.ambiguity(source, nu, x, **how),
    "fourier": lambda source, x, nu, **how: pw.fourier(source, nu, **how),
}


def random_outlines(seed: int) -> Iterator[pw.Aperture]:
    rng = np.random.default_rng(seed)
    while True:
        count = rng.integers(3, 13)
        angle, radius = np.sort(rng.random(count)) * 2 * np.pi, 0.3 + 0.7 * rng.random(count)
        try:
            yield pw.Aperture(radius[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1))
        except GeometryError:
            continue


def awkward_outlines() -> Iterator[pw.Aperture]:
    box = shapely.box(-0.5, -0.5, 0.5, 0.5)
    yield pw.Aperture(box)
    yield pw.Aperture(box.difference(shapely.box(-0.2, -0.3, 0.1, 0.4)))
    yield pw.Aperture(shapely.union(box, shapely.box(1.0, 0.1, 1.5, 0.9)))
    yield pw.Aperture([[0, 0], [1, 1e-5], [1.0002, 2e-4], [1e-4, 1.5e-4]])  # a needle
    yield pw.shapes.regular_polygon(12, 1e-6)


@pytest.mark.llvm
@pytest.mark.parametrize(
    ("name", "precision"),
    [
        *((name, "double") for name in TRANSFORMS),
        ("wigner", "single"),
        # seconds of compilation, for the same operations in single precision
        *(
            pytest.param(name, "single", marks=pytest.mark.slow)
            for name in ("ambiguity", "fourier")
        ),
    ],
)
def test_values_are_those_of_numpy(name: str, precision: str, llvm: Any) -> None:
    allowed = DOUBLE if precision == "double" else SINGLE
    rng = np.random.default_rng(5)
    outlines = random_outlines(1)
    for source in [*awkward_outlines(), *(next(outlines) for _ in range(10))]:
        size = np.sqrt(source.area)
        x, nu = rng.normal(size=(200, 2)) * 0.4 * size, rng.normal(size=(200, 2)) * 3 / size
        x[:20], nu[:5] = 0.0, 0.0  # coincident edges, and the limit
        x += np.array(shapely.Point(source.bounds[0] * 0.5, 0).coords[0]) * (name == "wigner")
        expected = TRANSFORMS[name](source, x, nu, engine="numpy")
        with forced("pairs"):
            found = TRANSFORMS[name](source, x, nu, engine="llvm", precision=precision)
        assert np.abs(found - expected).max() <= allowed * 4 * source.area


@pytest.mark.llvm
@pytest.mark.parametrize("weights", [[1.0, 1.0], [1.0, 1j], [2.0, -0.5]])
def test_collections_with_any_weights_are_data_too(weights: Any, llvm: Any) -> None:
    outlines = random_outlines(11)
    pieces = [next(outlines), pw.Aperture(next(outlines).rings[0] + np.array([1.5, 0.4]))]
    source, rng = pw.Array(pieces, weights), np.random.default_rng(12)
    functions: list[Callable[..., Any]] = [*TRANSFORMS.values(), _of_lags, _of_places]
    for count in (3, 500):  # a kernel recorded for other numbers of samples
        x, nu = rng.normal(size=(2, count, 2)) * 0.5
        for function in functions:
            expected = function(source, x, nu, engine="numpy")
            with forced("pairs"):
                found = function(source, x, nu, engine="llvm")
            assert found.shape == expected.shape
            assert np.abs(found - expected).max() <= DOUBLE * 40


def _of_lags(source: Any, x: Any, nu: Any, **how: Any) -> Any:
    return pw.lag_marginal(source, x, **how)


def _of_places(source: Any, x: Any, nu: Any, **how: Any) -> Any:
    return pw.position_marginal(source, x, **how)


@pytest.mark.llvm
@pytest.mark.parametrize("name", TRANSFORMS)
def test_any_number_of_outlines_needs_a_few_kernels(name: str, llvm: Any) -> None:
    rng, outlines = np.random.default_rng(3), random_outlines(4)

    def call(count: int) -> None:
        for source in (next(outlines) for _ in range(count)):
            x, nu = rng.normal(size=(2, 50, 2))
            TRANSFORMS[name](source, x, nu, engine="llvm")

    with compiled() as first:
        call(20)
    with compiled() as more:
        call(60)
    assert len(set(first)) + len(set(more)) <= MOST_FORMS
    assert len(more) < MOST_FORMS // 2


@pytest.mark.llvm
def test_arrays_of_the_engine_need_no_kernel_of_their_own(llvm: Any) -> None:
    import drjit.llvm.ad as backend

    rng, outlines = np.random.default_rng(6), random_outlines(7)

    def call(count: int) -> None:
        for source in (next(outlines) for _ in range(count)):
            x, nu = rng.normal(size=(2, 50, 2))
            arrays = [backend.Array2f64(*points.T.tolist()) for points in (x, nu)]
            found = pw.wigner(source, *arrays).numpy()
            assert np.abs(found - pw.wigner(source, x, nu, engine="numpy")).max() <= DOUBLE * 12

    call(30)
    with compiled() as found:
        call(30)
    assert len(found) < MOST_FORMS // 2


@pytest.mark.llvm
def test_derivatives_need_no_kernel_of_their_own(llvm: Any) -> None:
    import drjit as dr
    import drjit.llvm.ad as backend

    rng, outlines = np.random.default_rng(8), random_outlines(9)

    def call(count: int) -> None:
        for source in (next(outlines) for _ in range(count)):
            x, nu = (backend.Array2f64(*v.tolist()) for v in rng.normal(size=(2, 2, 50)))
            dr.enable_grad(x)
            dr.backward(pw.wigner(source, x, nu))
            dr.eval(dr.grad(x))

    call(15)
    with compiled() as found:
        call(15)
    assert len(found) < MOST_FORMS
