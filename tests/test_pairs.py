"""Every position with every frequency: the short way of Dr.Jit gives what the long way gives."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import polywigner as pw
from polywigner.execution.evaluation import pairs_of

# Of areas of about 1. Sums are the same; arguments enter the frame in NumPy or in Dr.Jit, which
# rounds a product and a sum once where NumPy rounds twice.
ROUNDING = {"double": 1e-14, "single": 1e-6}

SOURCES: dict[str, Callable[[], Any]] = {
    "chevron": lambda: pw.shapes.chevron(2.0, 1.1, 0.6),
    "turned needle": lambda: pw.Aperture([[0, 0], [10, 10], [9.99, 10.01], [-0.01, 0.01]]),
    "tapered": lambda: pw.shapes.square(1.0).with_illumination(pw.cosine_taper(1.0, 1.0)),
    "by cells": lambda: pw.shapes.regular_polygon(96, 0.5),
    "mixed": lambda: pw.Array([pw.shapes.square(1.0), pw.shapes.triangle(0.5, 0.4)], [1, 0.5j]),
    "lattice": lambda: pw.phased_array(
        pw.shapes.square(0.4), [[0, 0], [0.5, 0], [0, 0.6], [0.5, 0.6]], weights=[1, 2j, -1, 1]
    ),
}


@pytest.mark.parametrize(
    ("name", "transform", "precision"),
    [(name, pw.wigner, "double") for name in SOURCES]
    + [("by cells", pw.wigner, "single"), ("lattice", pw.ambiguity, "single")]
    + [
        pytest.param(name, transform, precision, marks=pytest.mark.slow)
        for name, transform, precision in (
            *((name, pw.ambiguity, "double") for name in SOURCES),
            ("chevron", pw.wigner, "single"),
            ("mixed", pw.ambiguity, "single"),
        )
    ],
)
def test_pairs_have_the_values_of_single_points(
    llvm: Any, name: str, transform: Callable[..., Any], precision: str
) -> None:
    rng = np.random.default_rng(3)
    positions = rng.normal(size=(3, 5, 1, 1, 2)) * 0.3
    frequencies = rng.normal(size=(1, 9, 8, 2)) * 3
    points = (positions, frequencies)
    if transform is pw.ambiguity:
        points = (frequencies, positions)
    source = SOURCES[name]()
    found = transform(source, *points, precision=precision, engine="llvm")
    each = transform(source, *np.broadcast_arrays(*points), precision=precision, engine="llvm")
    assert found.shape == each.shape == (3, 5, 9, 8)
    assert found.dtype == each.dtype
    np.testing.assert_allclose(found, each, rtol=0, atol=ROUNDING[precision])


@pytest.mark.parametrize("columns", [64, 82, 115, 4097, 349525])
def test_samples_are_dealt_to_rows_and_columns_without_a_slip(llvm: Any, columns: int) -> None:
    rows = max(2, (1 << 20) // columns)
    x = np.arange(rows)[:, None, None] / rows
    nu = np.arange(columns)[:, None] / columns
    slits = pw.Slits([(-2.0, 3.0)])  # W is different for all of these
    found = pw.wigner(slits, x, nu, engine="llvm", precision="single")
    for column in (0, columns - 1):  # where a sample would slip into another row
        at_once = pw.wigner(slits, x[:, 0], nu[column], engine="llvm", precision="single")
        np.testing.assert_allclose(found[:, column], at_once, rtol=0, atol=1e-5)
    at_once = pw.wigner(slits, x[rows // 2], nu, engine="llvm", precision="single")
    np.testing.assert_allclose(found[rows // 2], at_once, rtol=0, atol=1e-5)


@pytest.mark.parametrize(
    ("shapes", "split"),
    [
        ([(5, 1), (5, 1), (1, 70), (1, 70)], (5, 70)),
        ([(5, 1, 1), (4, 1), (70,)], (20, 70)),
        ([(5, 1), (70,), ()], (5, 70)),
        ([(5, 70), (70,)], None),
        ([(5, 1), (1, 20)], None),  # too few to be worth it
        ([(70,), (70,)], None),
    ],
)
def test_rows_and_columns_are_told_by_the_shapes(
    shapes: list[tuple[int, ...]], split: tuple[int, int] | None
) -> None:
    rng = np.random.default_rng(3)
    components = [rng.random(shape) for shape in shapes]
    whole = np.broadcast_arrays(*components)
    pairs = pairs_of(components, whole[0].shape)
    assert (pairs and (pairs.rows, pairs.columns)) == split
    if pairs:
        for component, expected in zip(pairs.components, whole, strict=True):
            np.testing.assert_array_equal(
                np.broadcast_to(component, split), expected.reshape(split)
            )


LATTICE = [[1.0 * i + 0.2 * j, 0.9 * j] for i in range(5) for j in range(3)]
ARRAYS: dict[str, Callable[[], Any]] = {
    "equal": lambda: pw.phased_array(pw.shapes.square(0.8), LATTICE),
    "steered": lambda: pw.phased_array(
        pw.shapes.chevron(0.8, 0.7, 0.3).with_illumination(pw.Illumination([1.0], [[3.5, -1.25]])),
        LATTICE,
        np.exp(2j * np.pi * 0.13 * np.arange(15)),
    ),
    "no product": lambda: pw.phased_array(
        pw.shapes.square(0.8), LATTICE, np.random.default_rng(1).normal(size=15) + 0.5j
    ),
    "overlapping tapers": lambda: pw.phased_array(
        pw.shapes.square(1.5).with_illumination(pw.cosine_taper(1.5, 1.5)), LATTICE
    ),
}


@pytest.mark.parametrize(
    ("engine", "name", "transform", "precision"),
    [("numpy", name, f, "double") for name in ARRAYS for f in (pw.wigner, pw.ambiguity)]
    + [(engine, "steered", pw.ambiguity, "single") for engine in ("numpy", "llvm")]
    + [("llvm", name, pw.wigner, "double") for name in ("steered", "no product")]
    + [
        pytest.param("llvm", name, pw.wigner, "double", marks=pytest.mark.slow)
        for name in ("equal", "overlapping tapers")
    ],
)
@pytest.mark.parametrize("positions_lead", [True, False])
def test_arrays_on_a_lattice_have_the_values_of_single_points_at_pairs(
    request: pytest.FixtureRequest,
    engine: str,
    positions_lead: bool,
    precision: str,
    transform: Callable[..., Any],
    name: str,
) -> None:
    """More places than midpoints of sites, some of them outside; one is not a number."""
    if engine == "llvm":
        request.getfixturevalue("llvm")
    source, rng = ARRAYS[name](), np.random.default_rng(3)
    low, high = (-0.5, -0.5), (5.0, 2.5)
    if transform is pw.ambiguity:
        low, high = (-5.0, -2.5), (5.0, 2.5)
    places, frequencies = rng.uniform(low, high, (300, 2)), rng.uniform(-3, 3, (70, 2))
    places[7, 1] = np.nan
    pair = (places[:, None], frequencies)
    if not positions_lead:
        pair = (places[:70], rng.uniform(-3, 3, (300, 1, 2)))
    points = pair if transform is pw.wigner else pair[::-1]
    how: dict[str, Any] = {"precision": precision, "engine": engine}
    found = transform(source, *points, **how)
    flat = [np.broadcast_to(p, (*found.shape, 2)).reshape(-1, 2) for p in points]
    each = transform(source, *flat, **how).reshape(found.shape)
    energy = abs(pw.lag_marginal(source, (0.0, 0.0)))
    np.testing.assert_allclose(found, each, rtol=0, atol=ROUNDING[precision] * energy)
