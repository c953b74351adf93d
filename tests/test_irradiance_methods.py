"""Irradiance by each of the methods: the square of the amplitude, unless by rays."""

import math
from typing import Any

import numpy as np
import pytest

import polywigner as pw
from polywigner.errors import ArgumentError, PolywignerWarning

WAVELENGTH = 299792458 / 94e9
SQUARE = pw.shapes.square(10e-3)
POINTS = np.array([[0.0, 0.0, 2 * WAVELENGTH], [4e-3, -9e-3, 30e-3], [0.1, 0.05, 0.2]])


def test_a_method_that_is_none_is_answered_with_all_that_are():
    with pytest.raises(ArgumentError, match=r'"wigner", "rayleigh.*"fraunhofer", "auto", got'):
        pw.irradiance(SQUARE, POINTS, WAVELENGTH, None)


@pytest.mark.parametrize("method", ["kirchhoff", "fresnel", "fraunhofer"])
def test_the_error_of_a_square_follows_from_that_of_the_amplitude(method):
    """| |U + e|^2 - |U|^2 | <= (2 |U| + |e|) |e|; a coarse tolerance makes a larger estimate."""
    field, error = pw.amplitude(SQUARE, POINTS, WAVELENGTH, method, return_error=True)
    values, errors = pw.irradiance(SQUARE, POINTS, WAVELENGTH, method, return_error=True)
    assert values == pytest.approx(np.abs(field) ** 2, rel=1e-14)
    assert errors == pytest.approx((2 * np.abs(field) + error) * error, rel=1e-12)
    assert values.dtype == np.float64 and values.shape == (3,)


def test_a_tolerance_finer_than_the_default_is_passed_on():
    how: dict[str, Any] = {"method": "kirchhoff", "return_error": True}
    _, fine = pw.irradiance(SQUARE, POINTS[1], WAVELENGTH, tolerance=1e-12, **how)
    field = abs(pw.amplitude(SQUARE, POINTS[1], WAVELENGTH, "kirchhoff"))
    incident = 1.0
    assert fine <= 2 * (field + incident * 1e-12) * 1e-12 * incident * (1 + 1e-9)


def test_the_far_field_takes_the_obliquity_it_is_of():
    """g of Rayleigh-Sommerfeld I over that of II is cos^2."""
    values = [
        pw.irradiance(SQUARE, POINTS[2], WAVELENGTH, "fraunhofer", obliquity=obliquity)
        for obliquity in ("rayleigh-sommerfeld-1", "rayleigh-sommerfeld-2")
    ]
    cosine = POINTS[2, 2] / math.hypot(*POINTS[2])
    assert values[0] / values[1] == pytest.approx(cosine**2, rel=1e-12)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"order": 3}, "order"),
        ({"sampling": "sobol"}, "sampling"),
        ({"samples": 100}, "samples"),
        ({"obliquity": "rayleigh-sommerfeld-1"}, "obliquity"),
        ({"tolerance": 2.0}, "tolerance"),
    ],
)
def test_what_rays_alone_have_is_refused_with_other_methods(options, words):
    with pytest.raises(ArgumentError, match=words):
        pw.irradiance(SQUARE, POINTS, WAVELENGTH, "kirchhoff", **options)


@pytest.mark.parametrize(
    ("obliquity", "method"),
    [
        (None, "rayleigh-sommerfeld-1"),
        ("kirchhoff", "kirchhoff"),
        ("rayleigh-sommerfeld-2", "rayleigh-sommerfeld-2"),
    ],
)
def test_auto_is_the_exact_field_of_the_boundary_condition(obliquity, method):
    found = pw.irradiance(SQUARE, POINTS, WAVELENGTH, "auto", obliquity=obliquity)
    np.testing.assert_array_equal(found, pw.irradiance(SQUARE, POINTS, WAVELENGTH, method))


def test_auto_takes_rays_for_what_is_no_boundary_condition():
    found = pw.irradiance(SQUARE, POINTS[2], WAVELENGTH, "auto", obliquity="paper")
    assert found == pw.irradiance(SQUARE, POINTS[2], WAVELENGTH, obliquity="paper")


@pytest.mark.slow
def test_rays_from_many_edges_name_the_faster_method():
    points = (0.0, 0.0, 1e-2)
    with pytest.warns(PolywignerWarning, match="60 edges take seconds; method='auto'"):
        pw.irradiance(pw.shapes.regular_polygon(60, 1e-3), points, 3e-3)
