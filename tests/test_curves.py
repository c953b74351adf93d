"""Curves become chords within the tolerance, with few vertices."""

import math

import numpy as np
import pytest

from polywigner.errors import FileFormatError
from polywigner.geometry.io.outlines import (
    Arc,
    Bezier,
    Curve,
    flattened,
    sampled,
    transformed,
)

# Relative error of distances, which are rounded. Sampled distances are below the true maximum.
ROUNDING = 1e-12

DENSE = 3001

UNIT_ARC = Arc(np.zeros(2), np.array([1.0, 0]), np.array([0, 1.0]), 0.3, 1.1)
SKEW = np.array([[1.0, 0.4], [-0.3, 2.0]])
CUBIC = np.array([[0.0, 0], [0, 5], [6, -5], [6, 1]])

CURVES: dict[str, Curve] = {
    "arc": UNIT_ARC,
    "long arc": Arc(np.ones(2), np.array([0.0, 2]), np.array([2.0, 0]), 4.0, -6.0),
    "elliptic arc": transformed(UNIT_ARC, SKEW, np.array([5.0, -3])),
    "flat elliptic arc": transformed(UNIT_ARC, np.diag([1, 1e-3]), np.zeros(2)),
    "parabola": Bezier(CUBIC[:3]),
    "cubic": Bezier(CUBIC),
    "bent cubic": Bezier(CUBIC[[0, 2, 1, 3]]),
    "degree 5": Bezier(np.vstack([CUBIC, [[3, 3], [9, 9]]])),
}


def points_on(curve):
    """Return many points of the curve from its definition."""
    t = np.linspace(0, 1, DENSE)
    if isinstance(curve, Arc):
        angles = (curve.start + t * curve.sweep)[:, None]
        return curve.centre + np.cos(angles) * curve.u + np.sin(angles) * curve.v
    assert isinstance(curve, Bezier)
    degree = len(curve.points) - 1
    powers = np.arange(degree + 1)
    basis = np.array([math.comb(degree, k) for k in powers]) * t[:, None] ** powers
    basis = basis * (1 - t[:, None]) ** (degree - powers)
    return basis @ curve.points


def largest_distance(points, chords):
    start, chord = chords[:-1], np.diff(chords, axis=0)
    along = ((points[:, None] - start) * chord).sum(-1) / (chord**2).sum(-1)
    nearest = start + np.clip(along, 0, 1)[..., None] * chord
    return float(np.linalg.norm(points[:, None] - nearest, axis=-1).min(axis=1).max())


def chords_of(curve, tolerance):
    """Return the chords of a curve and a line back to its start."""
    first, last = sampled(curve)
    ring = flattened([[curve, np.array([last, first])]], tolerance)[0]
    assert np.allclose(ring[[0, -1]], [first, last], rtol=0, atol=ROUNDING * np.abs(ring).max())
    return ring


@pytest.mark.parametrize("curve", CURVES.values(), ids=CURVES)
@pytest.mark.parametrize("tolerance", [0.3, 1e-4])
def test_no_point_is_farther_from_the_chords_than_the_tolerance(curve, tolerance):
    chords = chords_of(curve, tolerance)
    points = points_on(curve)
    assert largest_distance(points, chords) <= tolerance * (1 + ROUNDING)
    spacing = np.abs(np.diff(points, axis=0)).max()
    assert largest_distance(chords, points) <= 1e-3 * spacing  # vertices lie on the curve


@pytest.mark.parametrize("value", [math.nan, 1e200])
def test_numbers_out_of_range_are_refused(value):
    line = np.array([[0.0, 0], [value, 1], [1, 1], [0, 0]])
    with pytest.raises(FileFormatError, match="finite numbers below 1e\\+100"):
        flattened([[line]], None)
