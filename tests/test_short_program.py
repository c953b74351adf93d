"""The 62-line program of the theory agrees with pw.wigner and pw.ambiguity."""

import numpy as np
import pytest
import shapely

import polywigner as pw
from oracles import short_program

# Largest error relative to the total area times the largest |weight|^2.
WORST = 2e-14
# The grid moves the sides of a sliver by a fraction of its length squared.
AREAS = {"sliver": 1.0}

HOLED = pw.Aperture(shapely.box(0, 0, 3, 2).difference(shapely.box(1, 0.5, 2, 1.5)))
OVERLAPPING = pw.Array(
    [pw.Aperture(shapely.box(0, 0, 2, 1)), pw.Aperture(shapely.box(1, 0, 3, 1)), HOLED],
    [1.0, 0.5j, 0.2j - 0.3],
)
SLIVER = pw.Aperture([(0, 0), (1, 1e-9), (1 + 1e-9, 1e-3), (1e-12, 1e-3 + 1e-9)])
SOURCES = {
    "square": pw.shapes.square(1.0),
    "chevron": pw.shapes.chevron(1.0, 0.8, 0.3),
    "30-gon": pw.shapes.regular_polygon(30, 1.0),
    "sliver": SLIVER,
    "hole": HOLED,
    "overlapping weights": OVERLAPPING,
    "far away": HOLED.moved((1e4, -3e3)),
}


def draws(source, count, seed=0):
    """Return rings, weights, area, points and lags, half of them at ties."""
    random = np.random.default_rng(seed)
    rings, weights = short_program.rings_and_weights(source)
    vertices = np.concatenate(rings)
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    first, second = (vertices[random.integers(len(vertices), size=count)] for _ in range(2))
    x = np.concatenate([random.uniform(low, high, (count, 2)), (first + second) / 2])
    xi = np.concatenate([random.uniform(low - high, high - low, (count, 2)), first - second])
    for places in (x, xi):  # an ulp from a tie
        places[::5] += random.integers(-1, 2, places[::5].shape) * np.spacing(np.abs(places[::5]))
    nu = random.normal(size=x.shape) * 10 ** random.uniform(-9, 1, (len(x), 1)) / np.ptp(vertices)
    nu[::7] = 0
    elements = getattr(source, "elements_in_plane", [source])
    area = sum(e.area for e in elements) * np.abs(weights).max() ** 2
    return rings, weights, area, x, xi, nu


@pytest.mark.parametrize("name", SOURCES)
def test_the_short_program_agrees_with_the_package_at_shared_edges_and_centres(name):
    source = SOURCES[name]
    rings, weights, area, x, xi, nu = draws(source, 60)
    area = AREAS.get(name, area)
    wigner = short_program.wigner(rings, weights, x, nu)
    assert np.abs(wigner - pw.wigner(source, x, nu)).max() < WORST * area
    ambiguity = short_program.ambiguity(rings, weights, nu, xi)
    assert np.abs(ambiguity - pw.ambiguity(source, nu, xi)).max() < WORST * area
