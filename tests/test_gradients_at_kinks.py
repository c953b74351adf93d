"""Derivatives where those of either side differ, and close to such places."""

import numpy as np
import pytest

import polywigner as pw
from oracles import exact

pytestmark = pytest.mark.llvm

RINGS = {
    "hexagon": np.array([[2, 0], [1, 1], [-1, 1], [-2, 0], [-1, -1], [1, -1.0]]),
    "chevron": np.array([[0, 0], [1, 0.5], [2, 0], [2, 0.625], [1, 1.125], [0, 0.625]]),
    "L": np.array([[0, 0], [2, 0], [2, 1], [1, 1], [1, 2], [0, 2.0]]),
}
NU = np.array([0.3125, -0.1875])
# To the right of every direction of an edge, which lie between 0 and 180 degrees.
RIGHT = np.array([1.0, -0.3125])
# Gradients change by their own derivatives, of about 2 pi nu D, on the way; D is 4 at most.
STEP, CHANGE = 2.0**-36, 1e-7
# Of the largest component of the gradient anywhere, which is about the area of the outline.
ERRORS = {"double": 1e-14, "single": 2e-6}
# How far from the kink: a few thousand ulps and more.
DISTANCES = {"double": (2.0**-10, 2.0**-34), "single": (2.0**-6, 2.0**-14)}


def _points(values, double=True):
    import drjit.llvm.ad as backend

    kind = backend.Array2f64 if double else backend.Array2f
    return kind(np.ascontiguousarray(np.asarray(values, np.float64).T))


def _gradient(name, ring, point, double=True):
    """In vertices, and in the two points, of Re W or Re A, one after the other."""
    import drjit as dr

    pair = (point, NU) if name == "wigner" else (NU, point)
    arrays = [_points(ring, double), *(_points([p], double) for p in pair)]
    dr.enable_grad(arrays)
    value = getattr(pw, name)(pw.differentiable(vertices=arrays[0]), *arrays[1:])
    dr.backward(value if name == "wigner" else value.real)
    return np.concatenate([np.array(dr.grad(a), np.float64).T for a in arrays])


def _places(name, ring):
    """Where corners of the two copies meet, and edges if any are parallel."""
    if name == "wigner":
        return np.unique([(p + q) / 2 for p in ring for q in ring], axis=0)
    return np.unique([p - q for p in ring for q in ring], axis=0)


def test_where_a_corner_crosses_an_edge_derivatives_are_continuous():
    """A quadrilateral without parallel sides; at the middle of a diagonal only corners meet."""
    ring = np.array([[0, 0], [2, 0.25], [1.75, 1.5], [0.25, 1.0]])
    for k in (0, 1):
        middle = (ring[k] + ring[k + 2]) / 2
        one, other = (_gradient("wigner", ring, middle + s * STEP * RIGHT) for s in (1, -1))
        assert np.abs(one).max() > 0.1
        assert np.abs(one - other).max() < CHANGE


@pytest.mark.parametrize("precision", ERRORS)
@pytest.mark.parametrize("shape", ["chevron", "L"])
def test_close_to_kinks_derivatives_err_as_elsewhere(shape, precision):
    ring, double = RINGS[shape], precision == "double"
    area = pw.Aperture(ring).area
    move = np.array([0.25, 0.125])  # too short to lead across an edge
    for place in _places("wigner", ring)[5::6]:
        for distance in DISTANCES[precision]:
            x = (place + distance * RIGHT).astype(np.float64 if double else np.float32)
            x = x.astype(np.float64)
            wide, narrow = (
                _exact_wigner(ring, x + h * move) - _exact_wigner(ring, x - h * move)
                for h in (distance / 4, distance / 8)
            )
            expected = float((8 * narrow - wide) / (6 * exact.mpmath.mpf(distance / 4)))
            got = _gradient("wigner", ring, x, double)[len(ring)] @ move
            # the differences err by (h 2 pi nu D)^4, which counts at the larger distances
            allowed = ERRORS[precision] + 10 * distance**4
            assert abs(got - expected) < allowed * area


def _exact_wigner(ring, x):
    with exact.mpmath.workdps(exact.DIGITS):
        return exact.transform(exact.lag_region([ring], x), NU).real
