"""On a grid of frequencies the Fourier transform comes from the axes, and is the same."""

from __future__ import annotations

import tracemalloc
from typing import Any

import numpy as np
import pytest
import shapely

import polywigner as pw
from oracles.references import ENGINES, awkward, awkward_names
from polywigner.execution.grids import plan_for_grid
from polywigner.kernels import kernel_for

# What the package promises of F, in units of the area, and what float32 reaches.
ACCURACY = {"double": 1e-13, "single": 5e-6}

HEXAGONS = pw.shapes.hexagonal_segments(6.5, gap=0.1)


def _turned(source: pw.Aperture, angle: float, shift: tuple[float, float] = (0, 0)) -> pw.Aperture:
    c, s = np.cos(angle), np.sin(angle)
    turn = np.array([[c, s], [-s, c]])
    return pw.Aperture(
        shapely.transform(source.polygons, lambda points: points @ turn + np.array(shift))
    )


def _random_star(n: int, seed: int) -> pw.Aperture:
    rng = np.random.default_rng(seed)
    angle = 2 * np.pi * (np.arange(n) + rng.random(n)) / n
    radius = rng.uniform(0.4, 1, n)
    return pw.Aperture(radius[:, None] * np.column_stack([np.cos(angle), np.sin(angle)]))


SOURCES = {name: awkward(name).aperture for name in awkward_names()} | {
    "hexagonal pupil": HEXAGONS,
    "hexagonal pupil, turned": _turned(HEXAGONS, 0.2),
    "hexagonal pupil, far away": _turned(HEXAGONS, 0.0, (6500.0, -4000.0)),
    "square, tiny": pw.shapes.square(1e-6),
    "slit along x": pw.shapes.rectangle(100.0, 1.0),
    "slit along y": pw.shapes.rectangle(1.0, 100.0),
    "slit along y, far away": _turned(pw.shapes.rectangle(1.0, 100.0), 0.0, (1e4, 3e4)),
    "needle, turned": _turned(pw.shapes.rectangle(1.0, 1e-6), 0.3),
    "ring": pw.shapes.ring(1.0, 0.9, 64),
    "random star": _random_star(50, 0),
    "disc of 200 edges": pw.shapes.disc(1.0, 200),
}


def _grid(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    return np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1)


def _by_points(source: Any, nu: np.ndarray, **keywords: Any) -> np.ndarray:
    """The same values from a list of points, which is no grid."""
    values = pw.fourier(source, nu.reshape(-1, nu.shape[-1]), **keywords)
    return values.reshape(nu.shape[:-1])


def _is_planned(source: Any, nu: np.ndarray) -> bool:
    kernel = kernel_for("fourier", source)
    return plan_for_grid(kernel, source, [nu[..., 0], nu[..., 1]], True) is not None


def test_a_point_beside_its_place_in_a_grid_is_seen() -> None:
    nu = _grid(np.linspace(-3, 3, 20), np.linspace(-2, 2, 21))
    nu[7, 11] += (0.05, -0.03)
    assert not _is_planned(HEXAGONS, nu)
    expected = pw.fourier(HEXAGONS, nu[7, 11])
    assert pw.fourier(HEXAGONS, nu)[7, 11] == pytest.approx(expected, abs=1e-13 * HEXAGONS.area)


@pytest.mark.parametrize("precision", list(ACCURACY))
def test_a_row_of_enormous_frequencies_does_not_overflow(precision: Any) -> None:
    x, y = np.linspace(-3, 3, 20), np.linspace(-2, 2, 21)
    x[5] = {"double": 1e200, "single": 1e30}[precision]
    values = pw.fourier(HEXAGONS, _grid(x, y), precision=precision, engine="numpy")
    assert np.abs(values[5]).max() < ACCURACY[precision] * HEXAGONS.area


@pytest.mark.parametrize("engine", ENGINES)
def test_the_automatic_engine_agrees_with_the_one_asked_for(engine: Any) -> None:
    axis = np.linspace(-8, 8, 260)
    nu = _grid(axis, axis[:256])
    for source in (HEXAGONS, SOURCES["random star"]):
        error = np.abs(pw.fourier(source, nu) - pw.fourier(source, nu, engine=engine)).max()
        assert error < ACCURACY["double"] * source.area


@pytest.mark.slow
def test_a_grid_is_tiled_without_seams_and_without_much_memory() -> None:
    source = pw.shapes.hexagonal_segments(1.0, gap=0.05, rings=8)
    x, y = np.linspace(-3, 3, 601), np.linspace(-2, 4, 603)
    nu = _grid(x, y)
    tracemalloc.start()
    values = pw.fourier(source, nu, engine="numpy")
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    # without tiles, and with the waves of all 1296 edges at once, 77 MB
    assert peak < values.nbytes + 60e6
    some = np.random.default_rng(0).integers(0, 600, (2, 200))
    expected = pw.fourier(source, nu[*some], engine="numpy")
    assert np.abs(values[*some] - expected).max() < ACCURACY["double"] * source.area


def _repeated(element: pw.Aperture, places: np.ndarray, weights: Any) -> pw.Array:
    """The element, its middle at each place."""
    middle = np.reshape(element.bounds, (2, 2)).mean(axis=0)
    return pw.Array([pw.Aperture(element.rings[0] - middle + p) for p in places], weights)


def _arrays() -> dict[str, pw.Array]:
    rng = np.random.default_rng(3)
    hexagon = pw.shapes.regular_polygon(6, 0.55)
    places = rng.uniform(-5, 5, (12, 2)).round(1)  # some overlap
    pistons = np.exp(2j * np.pi * rng.random(12))
    patches = np.column_stack([np.arange(16) * 0.6, np.zeros(16)])
    tilted = np.eye(4)
    tilted[:2, :2] = [[0.8, -0.6], [0.6, 0.8]]
    return {
        "segments with pistons": _repeated(hexagon, places, pistons),
        "row of patches, weighted": _repeated(
            pw.shapes.rectangle(0.3, 0.2), patches, np.hanning(18)[1:-1]
        ),
        "one element is off": pw.Array([hexagon, pw.shapes.square(3.0)], [1.0, 0.0]),
        "sparse": _repeated(hexagon, 1e4 * places, pistons),
        "one element in a pose": pw.Array([hexagon, pw.shapes.square(0.3).placed(tilted)]),
    }


@pytest.mark.parametrize("name", list(_arrays()))
@pytest.mark.parametrize("precision", list(ACCURACY))
def test_an_array_on_a_grid_is_the_sum_of_its_elements(name: str, precision: Any) -> None:
    array = _arrays()[name]
    even, decades = np.linspace(-6, 6, 33), 6 * np.geomspace(1e-15, 1, 16)
    nu = _grid(even, np.concatenate([-decades, [0.0], decades]))
    if array.dimension == 3:
        nu = np.concatenate([nu, np.ones((*nu.shape[:-1], 1))], axis=-1)
    content = sum(
        abs(w) * (e if isinstance(e, pw.Aperture) else e.aperture).area
        for e, w in zip(array.elements, array.weights, strict=True)
    )
    expected = sum(
        w * _by_points(e, nu) for e, w in zip(array.elements, array.weights, strict=True)
    )
    got = pw.fourier(array, nu, precision=precision)
    assert got.dtype == (np.complex128 if precision == "double" else np.complex64)
    assert np.abs(got - expected).max() < ACCURACY[precision] * content
    assert _is_planned(array, nu[..., :2]) == (name not in ("sparse", "one element in a pose"))


def test_an_array_on_a_grid_of_complex_frequencies_is_the_sum_of_its_elements() -> None:
    array = _arrays()["segments with pistons"]
    nu = _grid(np.linspace(-3, 3, 20), np.linspace(-2, 2, 21)) * (1 + 0.1j)
    assert np.array_equal(pw.fourier(array, nu), _by_points(array, nu))
