"""Uniform sampling of positions in an aperture, by trapezoids."""

import numpy as np
import pytest
import shapely

import polywigner as pw
from mitsuba_scenes import MONO, use
from polywigner.geometry.convex import trapezoids
from polywigner.mitsuba.sampling import Positions, positions_of
from polywigner.mitsuba.sources import centred_source

pytestmark = pytest.mark.drjit

TURN = np.array([[0.8, -0.6], [0.6, 0.8]])
APERTURES = {
    "square": pw.shapes.square(0.01),
    "turned square": pw.Aperture(pw.shapes.square(0.01).rings[0] @ TURN.T),
    "chevron": pw.shapes.chevron(0.01, 0.01, 0.004),
    "automean of two chevrons": pw.automean(pw.shapes.chevron_pair(0.01, 0.01, 0.004)),
    "ring": pw.shapes.ring(0.006, 0.004, n=16),
    "touching squares": pw.Aperture(
        [[[0, 0], [1, 0], [1, 1], [0, 1]], [[1, 1], [2, 1], [2, 2], [1, 2]]]
    ),
}

# Float32 tables and a few hundred roundings of cumulated areas.
_ROUNDING = 1e-5
# A grid of 200 x 200 midpoints integrates the quadratic functions below to (1/200)^2 per trapezoid.
_GRID, _GRID_ERROR = 200, 2e-3
# The share of samples that are uniform, 2 %, moves means by 1 %.
_EVERYWHERE = 0.012


def _moments(aperture):
    """Means of x, y, x^2, xy, y^2, exactly, from triangles."""
    vertices, triangles = pw.geometry.triangulate(aperture)
    corners = vertices[triangles]
    edges = corners[:, 1:] - corners[:, :1]
    areas = np.abs(np.linalg.det(edges)) / 2
    middles = (corners + np.roll(corners, 1, axis=1)) / 2  # exact for quadratic functions
    x, y = middles[..., 0], middles[..., 1]
    values = np.stack([x, y, x * x, x * y, y * y])
    return (values.mean(axis=2) * areas).sum(axis=1) / areas.sum()


def _sampled(mi, aperture):
    """Images of the midpoints of a grid on the unit square, (n, 2)."""
    positions = Positions(mi, aperture.rings)
    middles = (np.arange(_GRID) + 0.5) / _GRID
    u, v = (axis.ravel().tolist() for axis in np.meshgrid(middles, middles, indexing="ij"))
    if mi.variant().startswith("scalar"):
        points = [positions.sample(mi.Point2f(*pair))[0] for pair in zip(u, v, strict=True)]
        return np.array(points, dtype=float).reshape(-1, 2)
    return np.array(positions.sample(mi.Point2f(mi.Float(u), mi.Float(v)))[0], dtype=float).T


@pytest.mark.parametrize("name", APERTURES)
def test_trapezoids_tile_the_aperture(name):
    aperture = APERTURES[name]
    assert trapezoids(aperture.rings).areas.sum() == pytest.approx(aperture.area, rel=1e-12)


def test_a_rectangle_is_one_trapezoid_so_that_strata_stay_strata():
    assert trapezoids(pw.shapes.rectangle(0.03, 0.01).rings).areas.size == 1


@pytest.mark.parametrize("variant", ["scalar_rgb", MONO])
@pytest.mark.parametrize("name", APERTURES)
def test_positions_are_uniform_in_the_aperture(name, variant):
    aperture = APERTURES[name]
    points = _sampled(use(variant), aperture)
    size = aperture.diameter
    grown = aperture.polygons.buffer(_ROUNDING * size)
    assert shapely.contains_xy(grown, *points.T).all()
    x, y = points.T
    sampled = np.array([f.mean() for f in (x, y, x * x, x * y, y * y)])
    scale = np.array([size, size, size**2, size**2, size**2])
    assert np.abs((sampled - _moments(aperture)) / scale).max() < _GRID_ERROR


@pytest.mark.parametrize("variant", [MONO])
def test_samples_follow_the_marginal_or_its_root(variant):
    """Of a square from -1 to 1, R_x = 16 (1 - |x|)(1 - |y|)."""
    mi = use(variant)
    radiator = centred_source(pw.shapes.square(2.0), "paper")
    middles = (np.arange(_GRID) + 0.5) / _GRID
    u, v = (axis.ravel().tolist() for axis in np.meshgrid(middles, middles))
    means = []
    for sampling in ("uniform", "root-marginal", "marginal"):
        points, _ = positions_of(mi, radiator, sampling, 1.0).sample(
            mi.Point2f(mi.Float(u), mi.Float(v))
        )
        means.append(np.abs(np.array(points)).mean())
    assert means == pytest.approx([1 / 2, 2 / 5, 1 / 3], rel=_EVERYWHERE)
