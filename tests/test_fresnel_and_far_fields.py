"""Fresnel fields against Fresnel integrals, and far fields. Lengths are in wavelengths."""

import math

import mpmath
import numpy as np
import pytest

import polywigner as pw
from oracles.quadrature import triangle_nodes
from oracles.references import ENGINES

special = pytest.importorskip("scipy.special", reason="Fresnel integrals to compare with")

ROUNDING = 1e-12
"""Of the incident amplitude."""

RECTANGLE = pw.Aperture([(-1.2, -0.7), (1.9, -0.7), (1.9, 1.4), (-1.2, 1.4)])
POINTS = np.array(
    [
        (0.3, 0.2, 1.0),
        (1.9, 0.5, 0.5),
        (1.9, 1.4, 4.0),
        (-1.2, 3.0, 0.02),
        (8.0, -3.0, 20.0),
        (0.0, 0.0, 200.0),
        (2000.0, 100.0, 5000.0),
    ]
)


def by_fresnel_integrals(kappa, point):
    """Return the product of two one-dimensional fields of RECTANGLE."""
    z = point[2]
    scale = math.sqrt(2 / z)
    total = np.exp(2j * np.pi * z) / (1j * z)
    for low, high, x, k in zip((-1.2, -0.7), (1.9, 1.4), point[:2], kappa, strict=True):
        (s0, c0), (s1, c1) = (special.fresnel(scale * (a - x + z * k)) for a in (low, high))
        wave = np.exp(2j * np.pi * (k * x - z * k * k / 2))
        total *= wave * ((c1 - c0) + 1j * (s1 - s0)) / scale
    return complex(total)


@pytest.mark.parametrize("kappa", [(0.0, 0.0), (0.2, -0.1), (0.9, 0.7)])
@pytest.mark.parametrize("engine", ENGINES)
def test_fields_of_a_rectangle_are_products_of_fresnel_integrals(kappa, engine):
    source = RECTANGLE.with_illumination(pw.Illumination([1.0], [kappa]))
    expected = [by_fresnel_integrals(kappa, p) for p in POINTS]
    got = pw.amplitude(source, POINTS, 1.0, "fresnel", tolerance=1e-12, engine=engine)
    np.testing.assert_allclose(got, expected, rtol=0, atol=ROUNDING)


def test_the_intensity_is_the_wigner_function_along_parallel_rays():
    """The integral of W(x, (x' - x)/(lambda z)) over the positions x is |U|^2 (lambda z)^2."""
    triangle = pw.Aperture([(-1.0, -0.8), (1.3, -0.5), (-0.2, 1.1)])
    a, b, c = triangle.rings[0]
    middles = np.array([(a + b) / 2, (b + c) / 2, (c + a) / 2])
    # W has kinks on lines through edge midpoints, so four triangles are divided by their medians.
    corners = [
        (a, middles[0], middles[2]),
        (b, middles[1], middles[0]),
        (c, middles[2], middles[1]),
    ]
    triangles = np.array([*corners, tuple(middles)])
    point, z = np.array([0.4, -0.3]), 1.5
    x, weight = triangle_nodes(triangles, 40)
    w = pw.wigner(triangle, x, (point - x) / z)
    field = pw.amplitude(triangle, (*point, z), 1.0, "fresnel")
    assert abs(field) ** 2 == pytest.approx(float(weight @ w) / z**2, rel=1e-6)


@pytest.mark.parametrize(
    ("method", "share"),
    [("rayleigh-sommerfeld-1", 1.0), ("kirchhoff", 0.5), ("rayleigh-sommerfeld-2", 0.0)],
)
def test_near_the_axis_exact_fields_come_close_to_fresnels(method, share):
    """The first integral has an additional near field of relative size i/(kz)."""
    for z in (100.0, 1000.0):
        points = np.array([(0.2, 0.1, z), (0.5, 1.0, z)])
        exact = pw.amplitude(RECTANGLE, points, 1.0, method)
        paraxial = pw.amplitude(RECTANGLE, points, 1.0, "fresnel")
        # The remaining error is of the order (rho/z)^2 for rho up to 2.5.
        near_field = 1 + 1j * share / (2 * math.pi * z)
        assert np.abs(exact / paraxial - near_field).max() <= 2.5**2 / z**2


@pytest.mark.filterwarnings("ignore:.*error above the tolerance")
def test_just_behind_the_source_parabolic_waves_are_as_good_as_the_phases_of_its_edges():
    """Phases of 1e7 and 1e9 cycles along an edge have ulps of 1e-9 and 1e-7 cycles."""
    points = np.array(
        [(0.3, 0.2, 1e-7), (1.5 - 1e-4, 0.2, 1e-7), (1.5, 0.2, 1e-9), (2.0, 0.2, 1e-9)]
    )
    result, error = pw.amplitude_with_error(pw.shapes.square(3.0), points, 1.0, "fresnel")
    expected = np.array([by_mpmath(3.0, point.tolist(), 1.0) for point in points])
    assert np.all(np.abs(result - expected) <= error)
    assert error[:2].max() < 1e-6 and error.max() < 1e-4


@pytest.mark.parametrize(
    ("obliquity", "factor"),
    [
        (None, lambda c, p: c),
        ("rayleigh-sommerfeld-1", lambda c, p: c),
        ("kirchhoff", lambda c, p: (c + p) / 2),
        ("rayleigh-sommerfeld-2", lambda c, p: p),
    ],
)
def test_the_far_field_is_the_fourier_transform_with_its_obliquity(obliquity, factor):
    wavelength = 3e-3
    kappas = np.array([(50.0, 20.0), (300.0, 250.0)])  # the second wave is evanescent
    p = np.sqrt(1 - wavelength**2 * (kappas**2).sum(axis=1) + 0j)
    outline = pw.shapes.rectangle(8e-3, 5e-3).moved((1.0, -2.0))
    source = outline.with_illumination(pw.Illumination([1.0, 0.5j], kappas))
    direction = np.array([0.36, 0.48, 0.8])
    points = np.append(outline.centre, 0.0) + 7.0 * direction
    terms = [
        amplitude
        * pw.fourier(outline.moved(-outline.centre), direction[:2] / wavelength - kappa)
        * np.exp(2j * np.pi * kappa @ outline.centre)
        * factor(direction[2], cosine)
        for amplitude, kappa, cosine in zip([1.0, 0.5j], kappas, p, strict=True)
    ]
    wave = np.exp(2j * np.pi * 7.0 / wavelength) / (1j * wavelength * 7.0)
    got = pw.amplitude(source, points, wavelength, "fraunhofer", obliquity=obliquity)
    # The distance of 2333 wavelengths and the position of the source are rounded.
    assert got == pytest.approx(wave * sum(terms), rel=1e-10)


def test_waves_that_graze_the_plane_have_no_slope_and_no_far_field_of_it():
    source = RECTANGLE.with_illumination(pw.Illumination([1.0], [(1.0, 0.0)]))
    second = "rayleigh-sommerfeld-2"
    assert abs(pw.amplitude(source, (1, 2, 3), 1.0, second)) <= 1e-15
    assert pw.amplitude(source, (1, 2, 3), 1.0, "fraunhofer", obliquity=second) == 0


def by_mpmath(side, point, wavelength):
    """Return the field of a square with 40 digits."""
    x, y, z = map(mpmath.mpf, point)
    length = mpmath.mpf(wavelength)
    with mpmath.workdps(40):
        half, scale = mpmath.mpf(side) / 2, mpmath.sqrt(2 / (length * z))
        total = mpmath.expjpi(2 * z / length) / 2j
        for place in (x, y):
            ends = [scale * (sign * half - place) for sign in (1, -1)]
            (c1, s1), (c0, s0) = ((mpmath.fresnelc(e), mpmath.fresnels(e)) for e in ends)
            total *= (c1 - c0) + 1j * (s1 - s0)
        return complex(total)


OPTICAL, SIDE = 0.5e-6, 1e-3
BESIDE = [(0.0, 0.0), (0.5e-3, 0.1e-3), (0.5e-3, 0.5e-3), (0.5e-3 + 1e-9, 0.2e-3), (1e-3, 0.7e-3)]


@pytest.mark.parametrize("z", [20.0, 0.5, 5e-3, 1e-4, 1e-5])
def test_optical_fields_on_edges_corners_and_close_by_are_those_of_fresnel_integrals(z):
    """The Fresnel numbers are 0.025 to 50,000."""
    count = 5 if z > 1e-4 else 3
    points = np.array([(*place, z) for place in BESIDE[:count]])
    square = pw.shapes.square(SIDE)
    result, error = pw.amplitude_with_error(square, points, OPTICAL, "fresnel")
    expected = np.array([by_mpmath(SIDE, point.tolist(), OPTICAL) for point in points])
    assert np.abs(result - expected).max() < 2e-9
    assert error.max() < 2e-9
    behind = pw.amplitude(square, points[:, :2], OPTICAL, through=pw.FirstOrder.free_space(z))
    wave = complex(mpmath.expjpi(2 * mpmath.mpf(z) / mpmath.mpf(OPTICAL)))
    assert np.abs(result - behind * wave).max() < 3e-9
