"""Derivatives in the ends of slits, against differences and closed forms."""

import numpy as np
import pytest

import polywigner as pw
from polywigner.errors import ArgumentError, GeometryError

pytestmark = pytest.mark.llvm

INTERVALS = np.array([[-1.0, -0.3], [0.2, 0.9], [1.1, 1.6]])
WAVES = pw.Illumination([1.0, 0.4j], [[0.3], [-1.1]])
# Of the largest: slopes are computed in float64 and rounded once, sums of few terms.
ROUNDING = {"double": 1e-13, "single": 1e-6}


def _ends(values, double=True):
    import drjit.llvm.ad as backend

    return (backend.Array2f64 if double else backend.Array2f)(values.T.copy())


def _slits(values, field):
    return pw.Slits(values).with_illumination(field)


def _points(name):
    rng = np.random.default_rng(0)
    place, frequency = rng.uniform(-0.8, 1.2, (7, 1)), rng.uniform(-3, 3, (7, 1))
    pair = [frequency, place] if name == "ambiguity" else [place, frequency]
    return [frequency] if name == "fourier" else pair


@pytest.mark.parametrize("name", ["fourier", "wigner", "ambiguity"])
def test_forward_and_reverse_mode_in_ends_are_adjoint(name):
    import drjit as dr
    import drjit.llvm.ad as backend

    rng, ends = np.random.default_rng(2), _ends(INTERVALS)
    points = [backend.Float64(p[:, 0]) for p in _points(name)]
    change = rng.normal(size=(2, 3))

    def parts():
        value = getattr(pw, name)(
            pw.differentiable(_slits(INTERVALS, WAVES), intervals=ends), *points
        )
        return [value] if name == "wigner" else [value.real, value.imag]

    dr.enable_grad(ends)
    dr.set_grad(ends, backend.Array2f64(change))
    found = parts()
    dr.forward_to(*found)
    forward = [np.array(dr.grad(part)) for part in found]
    weights = [rng.normal(size=len(f)) for f in forward]
    dr.clear_grad(ends)
    dr.backward(sum(dr.dot(p, backend.Float64(w)) for p, w in zip(parts(), weights, strict=True)))
    along = (np.array(dr.grad(ends)) * change).sum()
    expected = sum((f * w).sum() for f, w in zip(forward, weights, strict=True))
    assert abs(along - expected) < ROUNDING["double"] * np.abs(forward).max() * 10


@pytest.mark.parametrize(
    "make",
    [
        lambda ends: pw.differentiable(pw.shapes.square(1.0), intervals=ends),
        lambda ends: pw.differentiable(pw.Slits([0, 1]), weights=ends),
        lambda ends: pw.differentiable(pw.Slits(INTERVALS[:2]), intervals=ends),
        lambda ends: pw.differentiable(pw.Slits(INTERVALS), intervals=INTERVALS),
        lambda ends: pw.amplitude(
            pw.differentiable(intervals=ends), np.array([[0.0, 0.0, 1.0]]), 0.1
        ),
        lambda ends: pw.irradiance(
            pw.differentiable(intervals=ends), np.array([[0.0, 0.0, 1.0]]), 0.1
        ),
    ],
    ids=["aperture", "weights", "too many", "numpy", "amplitude", "irradiance"],
)
def test_what_has_no_ends_to_move_is_refused(make):
    with pytest.raises(ArgumentError, match="expected"):
        make(_ends(INTERVALS))


@pytest.mark.parametrize("order", [[1, 0, 2], [0, 0, 2]])
def test_intervals_that_do_not_ascend_are_refused(order):
    with pytest.raises(GeometryError, match="expected"):
        pw.differentiable(intervals=_ends(INTERVALS[order]))
