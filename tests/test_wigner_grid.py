"""W at one place over many frequencies is the transform of one lag slice."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import polywigner as pw
from oracles.references import awkward

# What the package promises of W, in units of the area, and what float32 reaches.
ACCURACY = {"double": 1e-13, "single": 5e-6}

SQUARE = pw.shapes.square(1.0)
AWKWARD = ("square annulus", "nearly parallel edges, rotated", "two touching squares, rotated")
SOURCES: dict[str, Any] = {name: awkward(name).aperture for name in AWKWARD} | {
    "chevron": pw.shapes.chevron(2.0, 1.1, 0.6),
    "octagon": pw.shapes.regular_polygon(8, 1.0),
    "ring": pw.shapes.ring(1.0, 0.6, 24),
    "slit": pw.shapes.rectangle(100.0, 1.0),
    "square, far away": pw.Aperture(SQUARE.rings[0] + np.array([6500.0, -4000.0])),
    "needle": pw.Aperture([[0, 0], [10, 10], [9.99, 10.01], [-0.01, 0.01]]),
    "array": pw.Array([SQUARE, pw.Aperture([[2, 0], [3, 0], [2, 1]])], [1, -0.5]),
    "two waves": SQUARE.with_illumination(pw.Illumination([1, 0.5j], [[0.3, 0.1], [-0.2, 0.4]])),
}  # fmt: skip


def _box(source: Any) -> tuple[np.ndarray, float]:
    """The centre of a source's bounds, and the length of their diagonal."""
    xmin, ymin, xmax, ymax = (source if hasattr(source, "bounds") else source.support).bounds
    return np.array([xmin + xmax, ymin + ymax]) / 2, float(np.hypot(xmax - xmin, ymax - ymin))


def _places(source: Any) -> list[np.ndarray]:
    """A centre, where copies may coincide, and others; the last one outside."""
    centre, size = _box(source)
    return [centre + size * np.array(p) for p in ((0, 0), (0.11, 0.07), (-0.2, 0.13), (3, 1))]


def _grid(source: Any, largest: float) -> np.ndarray:
    """Evenly spaced along x, over decades along y, with the origin."""
    _, size = _box(source)
    even = np.linspace(-largest, largest, 33)
    decades = largest * np.geomspace(1e-15, 1, 16)
    axes = even / size, np.concatenate([-decades, [0.0], decades]) / size
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)


def _one_by_one(source: Any, x: np.ndarray, nu: np.ndarray) -> np.ndarray:
    """The same with the slice cut anew for each frequency."""
    flat = nu.reshape(-1, 2)
    values = pw.wigner(source, np.broadcast_to(x, flat.shape), flat, engine="numpy")
    return values.reshape(nu.shape[:-1])


@pytest.mark.slow
@pytest.mark.parametrize("name", SOURCES)
@pytest.mark.parametrize("precision", list(ACCURACY))
def test_a_grid_at_one_place_has_the_values_of_its_points(name: str, precision: Any) -> None:
    source = SOURCES[name]
    area = source.area if hasattr(source, "area") else source.support.area
    for x in _places(source):
        for largest in (8.0, 300.0):
            nu = _grid(source, largest)
            for grid in (nu, nu[::-1].swapaxes(0, 1)):
                got = pw.wigner(source, x, grid, engine="numpy", precision=precision)
                error = np.abs(got - _one_by_one(source, x, grid)).max()
                assert error < ACCURACY[precision] * area


def test_nothing_is_left_outside_the_automean() -> None:
    source = SOURCES["chevron"]
    assert not pw.wigner(source, _places(source)[-1], _grid(source, 8.0), engine="numpy").any()


def test_the_middle_of_a_grid_is_the_area_of_the_lag_slice() -> None:
    source, x = SOURCES["octagon"], (0.1, 0.2)
    axis = np.linspace(-1, 1, 9)
    values = pw.wigner(source, x, np.stack(np.meshgrid(axis, axis), axis=-1), engine="numpy")
    assert abs(values[4, 4] - pw.lag_slice(source, x).area) < ACCURACY["double"] * source.area


def test_on_a_grid_w_of_a_rectangle_is_a_product_of_sincs() -> None:
    """W = prod 2 L sinc(2 nu L), L = a - 2|x|: docs/theory.md."""
    a, x = np.array([3.0, 1.0]), np.array([0.4, -0.1])
    axis = np.linspace(-7, 7, 41)
    nu = np.stack(np.meshgrid(axis, axis), axis=-1)
    length = a - 2 * np.abs(x)
    expected = np.prod(2 * length * np.sinc(2 * nu * length), axis=-1)
    got = pw.wigner(pw.shapes.rectangle(*a), x, nu)
    assert np.abs(got - expected).max() < ACCURACY["double"] * a.prod()


@pytest.mark.parametrize("name", ["chevron", "two waves"])
def test_a_list_of_frequencies_at_one_place_has_the_values_of_its_points(name: str) -> None:
    source = SOURCES[name]
    x, nu = _places(source)[1], np.random.default_rng(1).normal(size=(10_000, 2))
    got = pw.wigner(source, x, nu, engine="numpy")
    assert np.abs(got - _one_by_one(source, x, nu)).max() < ACCURACY["double"] * source.area


def test_what_is_not_finite_stays_in_its_row() -> None:
    source, x = SOURCES["chevron"], _places(SOURCES["chevron"])[1]
    nu = _grid(source, 8.0)
    nu[3, :, 0], nu[:, 5, 1] = np.nan, np.inf
    expected = np.zeros(nu.shape[:-1], bool)
    expected[3], expected[:, 5] = True, True
    np.testing.assert_array_equal(np.isnan(pw.wigner(source, x, nu, engine="numpy")), expected)
    assert np.isnan(pw.wigner(source, (np.nan, 0.0), _grid(source, 8.0), engine="numpy")).all()
