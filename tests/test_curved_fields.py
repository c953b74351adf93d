"""Curved waves in radiometry, fields, links and files, and textbook horns."""

import mpmath
import numpy as np
import pytest

import polywigner as pw
from polywigner.errors import ArgumentError

WAVELENGTH = 3.2e-3
MOUTH = pw.shapes.rectangle(16e-3, 12e-3).with_illumination(pw.te_mode(16e-3, 12e-3))
ELL = pw.Aperture(1e-3 * np.array([(0, 0), (12, 0), (12, 4), (4, 4), (4, 12), (0, 12)]) - 6e-3)
HORN = MOUTH.curved((20e-3, 30e-3), WAVELENGTH)
POINTS = np.array([(0, 0, 30e-3), (5e-3, -8e-3, 20e-3), (1e-3, 2e-3, 1e-3), (30e-3, 0, 10e-3)])
METHODS = ["rayleigh-sommerfeld-1", "rayleigh-sommerfeld-2", "kirchhoff", "fresnel", "fraunhofer"]

# Error of boundary integrals relative to the incident amplitude.
BOUNDARY = 3e-11
# Error of the field on the axis by Gauss rules and closed forms.
CLOSED = 1e-12
# Error of the closed forms of textbooks.
TEXTBOOK = 1e-12


@pytest.mark.parametrize("method", METHODS)
def test_a_wave_of_no_curvature_has_the_field_of_the_flat_source(method):
    for source in (MOUTH, ELL):
        flat = source.curved(np.inf, WAVELENGTH)
        expected = pw.amplitude(
            source,
            POINTS,
            WAVELENGTH,
            method,
            **({} if method == "fraunhofer" else {"tolerance": 1e-11}),
        )
        assert np.abs(pw.amplitude(flat, POINTS, WAVELENGTH, method) - expected).max() < BOUNDARY


@pytest.mark.parametrize("method", ["fresnel", "rayleigh-sommerfeld-1", "kirchhoff"])
def test_far_away_every_field_of_a_horn_is_its_far_field(method):
    point = (100.0, 200.0, 1e5)
    result = pw.amplitude(HORN, point, WAVELENGTH, method)
    far = pw.amplitude(HORN, point, WAVELENGTH, "fraunhofer")
    if method == "rayleigh-sommerfeld-1":  # Fresnel's approximation has another distance.
        assert result == pytest.approx(far, rel=1e-6, abs=0.0)
    # Relative errors by method. For Kirchhoff, the slopes of the waves are not along the axis.
    share = {"kirchhoff": 3e-2, "fresnel": 1e-5}.get(method, 1e-6)
    assert abs(result) == pytest.approx(abs(far), rel=share, abs=0.0)


def test_wigner_rays_of_a_horn_add_up_to_its_irradiance():
    points = np.array([(0, 0, 0.12), (20e-3, 10e-3, 0.15)])
    exact = pw.irradiance(HORN, points, WAVELENGTH, "auto")
    rays = pw.irradiance(HORN, points, WAVELENGTH, tolerance=1e-6)
    assert np.abs(10 * np.log10(rays / exact)).max() < 0.01


def test_power_is_that_of_the_spectrum_in_front():
    budget = pw.energy_budget(HORN, WAVELENGTH)
    assert budget.total == pytest.approx(16e-3 * 12e-3 / 2, rel=1e-12)
    assert 0.9 < budget.propagating_fraction < 1.0
    axis = pw.radiant_intensity(HORN, (0, 0, 1), WAVELENGTH)
    expected = abs(pw.fourier(HORN, (0, 0))) ** 2 / WAVELENGTH**2
    assert axis == pytest.approx(expected, rel=1e-12)
    radiance = pw.radiance(HORN, (1e-3, 0), (0.1, 0, np.sqrt(0.99)), WAVELENGTH)
    flat = pw.wigner(MOUTH, (1e-3, 0), (0.1 / WAVELENGTH - 1e-3 / (20e-3 * WAVELENGTH), 0))
    assert radiance == pytest.approx(flat / WAVELENGTH**2, rel=1e-12)
    flux = pw.flux_vector(HORN, (2e-3, 0.0), WAVELENGTH)
    assert flux[0] > 0.05 * flux[2] > 0  # the wave diverges


def test_a_pattern_is_that_of_the_spectrum():
    theta = np.radians([-30.0, 0.0, 20.0])
    pattern = pw.radiation_pattern(HORN, WAVELENGTH, theta, [0.0, np.pi / 2])
    nu = np.stack([np.sin(theta), np.zeros(3)], axis=-1) / WAVELENGTH
    expected = np.cos(theta) * pw.fourier(HORN, nu) / (1j * WAVELENGTH)
    assert np.abs(pattern["field"].values[:, 0] - expected).max() < CLOSED
    assert pw.read_source(pattern) == HORN
    with pytest.raises(ArgumentError, match="obliquity"):
        pw.radiation_pattern(HORN, WAVELENGTH, theta, 0.0, obliquity="kirchhoff")


def test_links_of_horns_are_reciprocal_and_those_of_their_patterns_far_away():
    facing = np.diag([-1.0, 1.0, -1.0, 1.0])
    facing[2, 3] = 0.1
    there = pw.coupling(HORN, MOUTH, facing, WAVELENGTH, tolerance=1e-9)
    back = pw.coupling(MOUTH, HORN, facing, WAVELENGTH, tolerance=1e-9)
    assert abs(there - back) < CLOSED
    facing[2, 3] = 100.0
    near = pw.coupling(HORN, HORN, facing, WAVELENGTH)
    far = pw.coupling(HORN, HORN, facing, WAVELENGTH, "fraunhofer")
    assert abs(near / far - 1) < 1e-3


def fresnel(t):
    return complex(mpmath.fresnelc(t) + 1j * mpmath.fresnels(t))


def textbook_e(width, height, radius):
    """Balanis, (13-19); lengths in wavelengths."""
    size = abs(fresnel(height / np.sqrt(2 * radius))) ** 2
    return 64 * width * radius / (np.pi * height) * size


def textbook_h(width, height, radius):
    """Balanis, (13-41)."""
    root = np.sqrt(radius)
    u, v = (root / width + s * width / root for s in (1, -1))
    size = abs(fresnel(u / np.sqrt(2)) - fresnel(v / np.sqrt(2))) ** 2
    return 4 * np.pi * height * radius / width * size


# Phase errors at the edge in wavelengths, height^2/(8 radius).
PHASE_ERRORS = [1 / 64, 3 / 8]


@pytest.mark.parametrize("s", PHASE_ERRORS)
def test_directivities_are_those_of_the_textbook(s):
    a1, b1 = 5.5, 2.75
    e, h = b1**2 / (8 * s), a1**2 / (8 * s)
    e_plane, h_plane = pw.horns.e_plane(0.5, b1, e, 1.0), pw.horns.h_plane(a1, 0.25, h, 1.0)
    found_e, found_h = (pw.horns.directivity(horn, 1.0) for horn in (e_plane, h_plane))
    assert found_e == pytest.approx(textbook_e(0.5, b1, e), rel=TEXTBOOK)
    assert found_h == pytest.approx(textbook_h(a1, 0.25, h), rel=TEXTBOOK)
    both = pw.horns.directivity(pw.horns.pyramidal(a1, b1, h, e, 1.0), 1.0)
    assert both == pytest.approx(np.pi / (32 * 0.5 * 0.25) * found_e * found_h, rel=TEXTBOOK)
    with pytest.raises(ArgumentError, match="radius_y of a horn"):
        pw.horns.e_plane(1.0, 2.0, -3.0, 1.0)
