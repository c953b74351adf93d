"""W, R and A where all edges of the two copies coincide: at the centre of symmetry and at lag 0.

Regular polygons and rings against exact rational arithmetic (``oracles/convex.py``), by each way
that engines cut edges: as rows of a table, one by one, and by cells.
"""

from __future__ import annotations

import numpy as np
import pytest
import shapely

import polywigner as pw
from oracles import convex, exact
from oracles.references import ENGINES

# Relative to the area. Each of n ends of edges is off by some ulps, whatever the angle there.
POLYGON = {"double": 2e-14, "single": 5e-6}
# Of a ring, vertices that are rounded count times diameter times perimeter over area, which is 40
# for radii of 1 and 0.9 and 400 for 0.99; the latter is the limit that docs/accuracy.md gives.
RING = {0.9: 6e-14, 0.99: 3e-13}
# Beyond so many, NumPy takes edges one by one rather than as rows of a table.
MANY_SAMPLES = 264

engines = pytest.mark.parametrize("engine", ENGINES)


def polygon(n: int, shear: float = 0.0, turn: float = 0.1) -> np.ndarray:
    angle = 2 * np.pi * np.arange(n) / n + turn
    return np.column_stack([np.cos(angle) + shear * np.sin(angle), np.sin(angle)])


def worst_error(
    rings: list[np.ndarray], xi: np.ndarray, samples: int, engine: str, precision: str = "double"
) -> float:
    """Of W and R at the origin, and of A at a lag, over the area, at three frequencies."""
    source = pw.Aperture(shapely.Polygon(rings[0], rings[1:]))
    nu = np.array([[0.0, 0.0], [0.3, 0.2], [1.3, -0.7]])
    lag, mean = convex.lag_slice(rings, (0.0, 0.0)), convex.position_slice(rings, xi)
    rows = np.arange(samples) % len(nu)
    how = {"engine": engine, "precision": precision}
    nowhere, lags = np.zeros((samples, 2)), np.broadcast_to(xi, (samples, 2))
    errors = [
        pw.wigner(source, nowhere, nu[rows], **how)
        - np.array([convex.transform(lag, k).real for k in nu])[rows],
        pw.position_marginal(source, nowhere, **how) - float(convex.area(lag)),
        pw.ambiguity(source, nu[rows], lags, **how)
        - np.array([convex.transform(mean, k) for k in nu])[rows],
    ]
    return max(float(np.abs(error).max()) for error in errors) / source.area


@engines
@pytest.mark.parametrize(("n", "precision"), [(64, "double"), (200, "double"), (64, "single")])
def test_regular_polygons_keep_their_digits_at_their_centre(
    n: int, engine: str, precision: str
) -> None:
    error = worst_error([polygon(n)], np.zeros(2), 3, engine, precision)
    assert error < POLYGON[precision]


@engines
def test_sheared_polygons_keep_their_digits_at_their_centre(engine: str) -> None:
    assert worst_error([polygon(64, shear=3.0)], np.zeros(2), 3, engine) < POLYGON["double"]


@engines
def test_many_samples_are_as_accurate_as_few(engine: str) -> None:
    error = worst_error([polygon(40)], np.zeros(2), MANY_SAMPLES, engine)
    assert error < POLYGON["double"]


@engines
def test_lags_along_an_edge_are_as_accurate(engine: str) -> None:
    outline = polygon(64)
    assert worst_error([outline], outline[1] - outline[0], 3, engine) < POLYGON["double"]


@engines
@pytest.mark.parametrize("ratio", list(RING))
@pytest.mark.parametrize("n", [6, 12, 32])
def test_rings_keep_their_digits_at_their_centre(n: int, ratio: float, engine: str) -> None:
    rings = [polygon(n), ratio * polygon(n)]
    assert worst_error(rings, np.zeros(2), 3, engine) < RING[ratio]


def test_the_exact_slices_are_those_of_the_general_oracle() -> None:
    outer, inner = polygon(7), 0.6 * polygon(7)
    for place in ((0.0, 0.0), (0.1, 0.2), (0.4, -0.3)):
        general = exact.lag_region([outer, inner[::-1]], place)
        assert convex.area(convex.lag_slice([outer, inner], place)) == general.area
        general = exact.position_region([outer, inner[::-1]], place)
        assert convex.area(convex.position_slice([outer, inner], place)) == general.area
