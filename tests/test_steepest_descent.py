"""Optical fields by steepest descent against integrals along edges with 25 digits.

The reference (`oracles.edge_integrals`) shares only the phases with the kernels.
"""

import math
from typing import Any

import numpy as np
import pytest

import polywigner as pw
from oracles.references import numpy_and_few, read_json
from polywigner.execution import NumpyOperations
from polywigner.numerics.nodes import error_of, gauss_legendre, node_sums, nodes_needed

REFERENCE = read_json("edge_integrals")
LIGHT = REFERENCE["wavelength"]
STAR = pw.shapes.star(*REFERENCE["star"])
GROUPS: dict[str, Any] = REFERENCE["groups"]

DEFAULT = 1e-9
"""Default tolerance, as a fraction of the incident amplitude or of the far field."""
ROUNDING = 2e-11
"""Phases of up to 1e5 cycles."""


def complex_of(parts):
    values = np.array(parts)
    return values[..., 0] + 1j * values[..., 1]


def star_in(group):
    p = np.array(group["direction"])
    return STAR.with_illumination(pw.Illumination([1.0], [p / LIGHT])) if p.any() else STAR


def allowed(points):
    """Return the unit of the tolerance: the largest possible field of the source, at most 1."""
    return np.minimum(1.0, STAR.area / (LIGHT * np.linalg.norm(points, axis=1)))


@pytest.mark.parametrize(("name", "engine"), numpy_and_few(GROUPS, list(GROUPS)[:2]))
def test_fields_are_integrals_along_edges(name, engine):
    group = GROUPS[name]
    points, expected = np.array(group["points"]), complex_of(group["fields"])
    for k, method in enumerate(REFERENCE["methods"]):
        got, error = pw.amplitude_with_error(star_in(group), points, LIGHT, method, engine=engine)
        missed = np.abs(got - expected[:, k])
        assert np.all(missed <= error) and np.all(error <= DEFAULT * allowed(points))
        # the estimate is conservative
        assert np.all(missed <= ROUNDING * allowed(points))


@pytest.mark.parametrize("name", [name for name, group in GROUPS.items() if "fresnel" in group])
def test_parabolic_fields_are_integrals_along_edges(name):
    points, expected = np.array(GROUPS[name]["points"]), complex_of(GROUPS[name]["fresnel"])
    got, error = pw.amplitude_with_error(STAR, points, LIGHT, "fresnel")
    missed = np.abs(got - expected)
    assert np.all(missed <= error) and np.all(error <= DEFAULT)
    assert np.all(missed <= ROUNDING)


@pytest.mark.parametrize("tolerance", [1e-2, 1e-4, 1e-6, 1e-11])
def test_errors_stay_within_the_tolerance(tolerance):
    for name in ("200 Fresnel zones", "lines through corners"):
        points, expected = np.array(GROUPS[name]["points"]), complex_of(GROUPS[name]["fields"])
        options = {"tolerance": tolerance, "engine": "numpy"}
        got, error = pw.amplitude_with_error(STAR, points, LIGHT, "kirchhoff", **options)
        assert np.all(np.abs(got - expected[:, 1]) <= error)
        assert error.max() <= tolerance


def test_all_waves_of_an_illumination_add_up_at_points_of_both_methods():
    """Propagating, grazing and evanescent waves, below and above the height of panels."""
    directions = [(0.0, 0.0), (0.3, -0.4), (0.95, 0.0), (0.9, 0.9)]
    weights = [1.0, 0.5j, -0.3, 0.2]
    square = pw.shapes.square(12.0)
    points = np.array([(1.0, 2.0, z) for z in (15.9, 16.1, 40.0)] + [(9.0, -3.0, 30.0)])
    whole = square.with_illumination(pw.Illumination(weights, directions))
    total = pw.amplitude(whole, points, 1.0)
    parts = [
        weight * pw.amplitude(square.with_illumination(pw.Illumination([1.0], [p])), points, 1.0)
        for weight, p in zip(weights, directions, strict=True)
    ]
    assert total == pytest.approx(sum(parts), rel=0, abs=1e-8)


def test_the_height_where_panels_end_changes_nothing():
    """The field changes by 2 pi times the step in wavelengths, 2e-8 here."""
    rng = np.random.default_rng(3)
    points = np.column_stack([rng.uniform(-30, 30, (200, 2)), np.full(200, 16.0)])
    step = np.array([0.0, 0.0, 1e-8])
    square = pw.shapes.square(40.0)
    below, above = (pw.amplitude(square, points + sign * step, 1.0) for sign in (-1, 1))
    assert np.abs(above - below).max() < 3 * math.pi * 2e-8


@pytest.mark.parametrize(("gap", "radians"), [(0.05, 0.3), (0.5, 20.0)])
def test_quadrature_errors_are_below_their_estimates_which_are_small(gap, radians):
    ops = NumpyOperations()
    needed, expected = nodes_needed(ops, 12.0, gap, radians)

    def sums(count, factor=1.0):
        x, *weights = gauss_legendre(count).T
        values = factor * np.exp(1j * radians * x) / (x - 1j * gap)
        return [terms.sum() for terms in node_sums(values.real, values.imag, *weights)]

    real, imag, size, *_ = few = sums(math.ceil(needed))
    exact = sums(724)
    estimate = error_of(ops, few, expected, 0.0)
    assert math.hypot(real - exact[0], imag - exact[1]) < estimate < 1e-3 * size
    turned = error_of(ops, sums(math.ceil(needed), 1j), expected, 0.0)
    assert turned == pytest.approx(estimate, rel=1e-6)
