"""Fields behind opaque screens: quadrature, knife edges, UTD and Babinet's principle."""

import math
from typing import Any

import numpy as np
import pytest
from scipy.special import fresnel

import polywigner as pw
from polywigner.errors import ArgumentError, PolywignerError
from polywigner.propagation.screens import spherical_field

K = 2 * math.pi  # wavelength of 1
L_SHAPE = [(-1.0, -0.7), (1.3, -0.7), (1.3, 0.2), (0.1, 0.2), (0.1, 1.2), (-1.0, 1.2)]
# Opening of two rectangles, for quadrature.
PIECES = [(-1.0, -0.7, 1.3, 0.2), (-1.0, 0.2, 0.1, 1.2)]
SOURCE = (0.3, -0.2, -2.1)
# Points in the illuminated region, at the shadow boundary, in the shadow near the plane, far off
# the axis, and at the mirror image of the source.
POINTS = [
    (0.2, 0.4, 3.0), (1.3 + 3.0 / 2.1 - 1e-9, -0.1, 3.0), (2.5, 0.1, 0.6), (4.0, 3.0, 2.0),
    (0.3, -0.2, 2.1), (0.3, -0.2, 2.1 + 1e-9),
]  # fmt: skip
ROUNDING = 2e-13  # relative to a field of 0.3, with 80 x 80 nodes
TOLERANCE = 1e-11

# Half-plane with the edge x = 0. The other edges contribute at most 1e-4.
HALF_PLANE = pw.Aperture([(0, -400), (511, -400), (511, 400), (0, 400)])


def by_quadrature(source, point, method):
    """Return the integral (B1) over the opening, by quadrature."""
    t, w = np.polynomial.legendre.leggauss(80)
    total = 0j
    for x0, y0, x1, y1 in PIECES:
        x = x0 + (t + 1) * (x1 - x0) / 2
        y = (y0 + (t + 1) * (y1 - y0) / 2)[:, None]
        rho = np.sqrt((x - source[0]) ** 2 + (y - source[1]) ** 2 + source[2] ** 2)
        r = np.sqrt((x - point[0]) ** 2 + (y - point[1]) ** 2 + point[2] ** 2)
        waves = np.exp(1j * K * (rho + r)) / (rho * r)
        given = waves * (1 / r - 1j * K) * point[2] / r
        slope = waves * (1 / rho - 1j * K) * -source[2] / rho
        kinds = {"rayleigh-sommerfeld-1": (1, 0), "rayleigh-sommerfeld-2": (0, 1)}
        a, b = kinds.get(method, (0.5, 0.5))
        total += w @ (a * given + b * slope) @ w * (x1 - x0) * (y1 - y0) / 4 / K
    return complex(total)


@pytest.mark.parametrize("method", ["rayleigh-sommerfeld-1", "rayleigh-sommerfeld-2", "kirchhoff"])
def test_point_sources_through_openings_equal_quadrature(method):
    opening = pw.Screen(pw.Aperture(L_SHAPE), pw.PointSource(SOURCE), "opening")
    result = pw.amplitude(opening, POINTS, 1.0, method, tolerance=TOLERANCE)
    expected = [by_quadrature(SOURCE, point, method) for point in POINTS]
    assert np.abs(result - expected).max() < ROUNDING + TOLERANCE


def test_right_before_the_opening_the_field_is_the_free_one():
    near = 1e-7
    opening = pw.Screen(pw.Aperture(L_SHAPE), pw.PointSource((0.0, 0.0, -near)), "opening")
    result = pw.amplitude(opening, (0.0, 0.0, near), 1.0, "kirchhoff", tolerance=1e-12)
    # Edges at a distance of 0.1 contribute at most (near/0.1)^2.
    assert abs(result) * 2 * near == pytest.approx(1.0, abs=1e-11)


def test_a_plate_and_an_opening_add_up_to_the_free_field():
    outline, light = pw.Aperture(L_SHAPE), pw.PointSource(SOURCE, 2j)
    plate, opening = (
        pw.amplitude(pw.Screen(outline, light, kind), POINTS, 1.0, "kirchhoff")
        for kind in ("plate", "opening")
    )
    free = 2j * spherical_field(light.position, np.array(POINTS), 1.0)
    assert np.abs(plate + opening - free).max() < 1e-15


def knife_edge(v):
    """Return the relative field behind a knife edge, the Fresnel integral from v."""
    s, c = fresnel(v)
    return (1 + 1j) / 2 * ((0.5 - c) - 1j * (0.5 - s))


def test_grazing_is_half_the_field_and_knife_edges_follow_fresnel():
    # ITU-R P.526: v = h sqrt(2 (d1 + d2)/(wavelength d1 d2)), at 5 m from the edge on both sides.
    wavelength = 0.1
    x = np.array([-1.0, -0.4, -0.1, 0.0, 0.1, 0.4, 1.0])
    points = np.stack([x, 0 * x, 0 * x + 5.0], axis=-1)
    screen = pw.Screen(HALF_PLANE, pw.PointSource((0.0, 0.0, -5.0)))
    field = pw.amplitude(screen, points, wavelength, "kirchhoff", tolerance=1e-6)
    distance = np.hypot(x, 10.0)
    result = 20 * np.log10(np.abs(field) * distance)
    v = np.sign(x) * 2 * np.sqrt((5.0 + np.hypot(x, 5.0) - distance) / wavelength)
    expected = 20 * np.log10(np.abs(knife_edge(v)))
    # The formula omits (1 + cos)/2 of Kirchhoff's integral, for angles up to 11 degrees.
    assert np.abs(result - expected).max() < 0.08
    assert result[3] == pytest.approx(-6.0206, abs=1e-3)


def test_screens_say_what_they_expect():
    outline, light = pw.Aperture(L_SHAPE), pw.PointSource(SOURCE)
    lit = outline.with_illumination(pw.steering((0.1, 0.0), 1.0))
    bad: list[Any] = [
        lambda: pw.PointSource(SOURCE, "1"),
        lambda: pw.PlaneWave((1.0, 0.0, 0.0)),
        lambda: pw.Screen(lit, light),
        lambda: pw.amplitude(pw.Screen(outline, light), (0.0, 0.0, 1.0), 1.0, "fresnel"),
        lambda: pw.irradiance(pw.Screen(outline, light), (0.0, 0.0, 1.0), 1.0),
        lambda: pw.amplitude(
            pw.Screen(outline, light), (0.0, 0.0, 1.0), 1.0, "kirchhoff", obliquity="kirchhoff"
        ),
        lambda: pw.wigner(pw.Screen(outline, light), (0.0, 0.0), (0.0, 0.0)),
    ]
    for call in bad:
        with pytest.raises(PolywignerError) as caught:
            call()
        assert isinstance(caught.value, ArgumentError)
    for z in (0.0, 1.0):
        with pytest.raises(
            ArgumentError, match=r"front of the screen, at z < 0, got the position \(0\.0"
        ):
            pw.Screen(outline, pw.PointSource((0.0, 0.0, z)))


def test_directions_of_any_length_become_unit_vectors():
    for length in (1e-9, 1.0, 1e9):
        direction = pw.PlaneWave((length, 0.0, length)).direction
        np.testing.assert_allclose(direction, (math.sqrt(0.5), 0.0, math.sqrt(0.5)), rtol=1e-15)


@pytest.mark.parametrize("light", [pw.PointSource, pw.PlaneWave])
def test_fields_are_linear_in_the_amplitude(light):
    vector = SOURCE if light is pw.PointSource else (0.1, -0.2, 1.0)
    one, dark, many = (
        pw.amplitude(pw.Screen(pw.Aperture(L_SHAPE), light(vector, a)), POINTS, 1.0, "kirchhoff")
        for a in (1.0, 0.0, 3e30j)
    )
    assert (dark == 0).all()
    np.testing.assert_allclose(many, 3e30j * one, rtol=1e-12)


def test_irradiance_is_the_square_and_errors_are_told():
    screen = pw.Screen(pw.Aperture(L_SHAPE), pw.PointSource(SOURCE))
    field, error = pw.amplitude_with_error(screen, POINTS, 1.0, "kirchhoff")
    assert (error < 1e-9 * 2).all()
    result = pw.irradiance(screen, POINTS, 1.0, "kirchhoff")
    np.testing.assert_allclose(result, np.abs(field) ** 2, rtol=1e-12)
