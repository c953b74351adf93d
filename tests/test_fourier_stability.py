"""Rounding errors of the Fourier transform for all sources, |nu| and directions."""

import itertools
from functools import lru_cache

import numpy as np
import pytest

import polywigner as pw
from oracles import simplices
from oracles.meshes import hollow, moved
from oracles.references import DATA, numpy_and_few
from oracles.sources import CUBE, SOURCES, content, frequencies, points_of

# Limits of the error relative to the area or volume. The documentation states 1e-13 and 1e-6, and
# the measured errors are 2.3e-15 and 6e-7.
ERROR = {"double": 1e-14, "single": 1e-6}
# Factor of the error for a body with walls of 0.01 diameters, because the signed tetrahedra cover
# its volume 33 times.
CAVITY = 33


@lru_cache(maxsize=1)
def _data():
    with np.load(DATA / "fourier_stability.npz") as archive:
        return dict(archive)


# Only every seventh of the stored frequencies is computed anew.
_EVERY = 7


@lru_cache
def _cases(kind):
    data, result = _data(), []
    for name, source in SOURCES[kind].items():
        key = f"{kind}/{name}/"
        nu, expected = data[f"{key}nu"], data[f"{key}F"]
        stored, own = data[key + "vertices"], points_of(source)
        off = np.abs(stored - own).max() / np.abs(stored).max()
        assert off < 1e-12, f"{kind}, {name}: run python -m oracles.generate fourier_stability"
        if off > 0.0:
            # Use the stored floats, because other versions of BLAS round differently.
            nu = nu[::_EVERY]
            expected = simplices.rounded(source, nu)
        result.append((name, source, nu, expected))
    return result


def _allowed(kind, precision):
    return ERROR[precision] * (CAVITY if kind == "body with cavity" else 1)


@pytest.mark.parametrize(
    ("kind", "precision", "engine"),
    numpy_and_few(
        itertools.product(SOURCES, ERROR),
        # Needles, plates and concave bodies use the same formula as convex bodies.
        [
            (kind, "double")
            for kind in SOURCES
            if kind not in ("needle or plate body", "concave body")
        ]
        + [("slits", "single"), ("convex body", "single")],
    ),
)
def test_frequencies_of_all_sizes_and_directions(kind, precision, engine):
    for name, source, nu, expected in _cases(kind):
        got = pw.fourier(source, nu, precision=precision, engine=engine)
        error = np.abs(got - expected).max() / content(source)
        assert error < _allowed(kind, precision), name


def test_a_thin_wall_costs_as_many_digits_as_its_surface_exceeds_its_volume():
    """The limit in docs/accuracy.md is 2e-16 D surface/volume."""
    rng = np.random.default_rng(2)
    for wall in (1e-1, 1e-3, 1e-5):
        body = moved(hollow(CUBE, CUBE.vertices * (1 - 2 * wall) + wall), 0.3, 0.1, 0.2)
        nu = np.concatenate([frequencies(rng, body, d, 2) for d in (-9, -1, 0, 1)])
        error = np.abs(pw.fourier(body, nu) - simplices.rounded(body, nu)).max() / body.volume
        assert error < 2e-16 * 3**0.5 * 12 / body.volume


def test_a_thin_outline_costs_as_many_digits_as_its_perimeter_exceeds_its_area():
    """The limit in docs/accuracy.md is 2e-16 D perimeter/area."""
    rng = np.random.default_rng(4)
    for width in (1e-2, 1e-4, 1e-6):
        ring = pw.Aperture([[0, 0], [1, 0], [1, width], [width, width], [width, 1], [0, 1]])
        nu = np.concatenate([frequencies(rng, ring, d, 2) for d in (-9, -1, 0, 1)])
        error = np.abs(pw.fourier(ring, nu) - simplices.rounded(ring, nu)).max()
        assert error < 2e-16 * ring.diameter * 4.0


SOME = (slice(None, None, 8),) * 2


def _grid(size, source):
    """Return 65 x 65 frequencies up to ``size``/diameter, including zero."""
    points = points_of(source)
    axis = np.linspace(-1, 1, 65) * size / np.linalg.norm(np.ptp(points, axis=0))
    return np.stack(np.meshgrid(axis, 0.7 * axis), axis=-1)


@pytest.mark.parametrize("size", [1e-9, 0.3, 1000.0])
@pytest.mark.parametrize(
    ("kind", "name"),
    [
        ("convex", "triangle"),
        ("concave", "chevron"),
        ("holed", "frame"),
        ("off centre", "chevron"),
    ],
)
def test_grids_are_as_accurate_as_points(kind, name, size):
    """Grids use another algorithm, except near the origin."""
    source = SOURCES[kind][name]
    grid = _grid(size, source)
    exact = simplices.rounded(source, grid[SOME].reshape(-1, 2))
    got = pw.fourier(source, grid, engine="numpy")[SOME].ravel()
    assert np.abs(got - exact).max() < ERROR["double"] * content(source)


HEXAGONS = pw.shapes.hexagonal_segments(6.5, gap=0.1)


def _axes_grid(x, y):
    return np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1)


def test_a_point_beside_its_place_in_a_grid_is_seen():
    nu = _axes_grid(np.linspace(-3, 3, 20), np.linspace(-2, 2, 21))
    nu[7, 11] += (0.05, -0.03)
    expected = pw.fourier(HEXAGONS, nu[7, 11])
    assert pw.fourier(HEXAGONS, nu)[7, 11] == pytest.approx(expected, abs=1e-13 * HEXAGONS.area)


def test_an_array_on_a_grid_is_the_sum_of_its_elements():
    """The array has elements with equal outlines, and one element in another pose."""
    rng, hexagon = np.random.default_rng(3), pw.shapes.regular_polygon(6, 0.55)
    places, weights = rng.uniform(-5, 5, (12, 2)).round(1), np.exp(6j * rng.random(13))
    tilted = np.eye(4)
    tilted[:2, :2] = [[0.8, -0.6], [0.6, 0.8]]
    nu = _axes_grid(np.linspace(-6, 6, 33), np.linspace(-4, 4, 20))
    for last in (hexagon.moved((1e4, 0.0)), pw.shapes.square(0.3).placed(tilted)):
        array = pw.Array([*(hexagon.moved(place) for place in places), last], weights)
        there = nu
        if array.dimension == 3:
            there = np.concatenate([nu, np.ones((*nu.shape[:-1], 1))], axis=-1)
        points = there.reshape(-1, there.shape[-1])
        expected = sum(
            w * pw.fourier(e, points) for e, w in zip(array.elements, weights, strict=True)
        )
        error = np.abs(pw.fourier(array, there).ravel() - expected).max()
        assert error < 1e-13 * np.abs(expected).max()
