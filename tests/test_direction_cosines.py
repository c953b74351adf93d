"""Sources whose waves are weighted by their direction cosines."""

import numpy as np
import pytest

import polywigner as pw
from polywigner.errors import ArgumentError, IlluminationError
from polywigner.illumination.obliquities import (
    OBLIQUITIES,
    emission_factor,
    irradiance_factor,
    times_direction_cosine,
    weighted_sources,
)
from polywigner.propagation.far_fields import far_field

WAVELENGTH = 3e-3
# Sums of a few terms of order one, rounded once each.
ROUNDING = 1e-14

WAVES = pw.Illumination(
    [1.0, 0.5 - 0.2j, 0.3j], np.array([(0.0, 0.0), (200.0, -60.0), (-250.0, 400.0)])
)
PLACES = np.array([(0.1e-3, 0.3e-3), (-0.7e-3, 0.2e-3)])


def field_times_cosines(x, add):
    """sum (p_m + add) c_m exp(2 pi i kappa_m.x), written out."""
    total = np.zeros(len(x), complex)
    for amplitude, kappa in zip(WAVES.amplitudes, WAVES.frequencies, strict=True):
        p = np.emath.sqrt(1 - WAVELENGTH**2 * (kappa @ kappa))
        total += (p + add) * amplitude * np.exp(2j * np.pi * x @ kappa)
    return total


@pytest.mark.parametrize("constant", [0.0, 1.0, -1j])
def test_each_wave_is_multiplied_by_its_direction_cosine(constant):
    aperture = pw.shapes.square(4e-3).with_illumination(WAVES)
    scaled = times_direction_cosine(aperture, WAVELENGTH, constant)
    assert scaled.with_illumination(None) == aperture.with_illumination(None)
    expected = field_times_cosines(PLACES, constant)
    np.testing.assert_allclose(scaled.illumination(PLACES), expected, rtol=ROUNDING)


def test_waves_that_graze_leave_nothing():
    grazing = pw.shapes.square(1e-3).with_illumination(pw.Illumination([1], [(1 / WAVELENGTH, 0)]))
    with pytest.raises(IlluminationError, match="graze"):
        times_direction_cosine(grazing, WAVELENGTH)
    with pytest.raises(IlluminationError, match="graze"):
        times_direction_cosine(pw.phased_array(grazing, [(0, 0), (1, 0)]), WAVELENGTH)
    both = pw.Array([grazing, pw.shapes.square(1e-3).moved((1, 0))])
    assert (times_direction_cosine(both, WAVELENGTH).weights == [0, 1]).all()


def test_bodies_and_wavelengths_of_zero_are_refused():
    corners = np.array([(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)], dtype=float)
    body = pw.Polyhedron(corners, [(0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3)])
    for source in (body, pw.Array([body])):
        with pytest.raises(ArgumentError, match="Polyhedron"):
            times_direction_cosine(source, WAVELENGTH)
    with pytest.raises(ArgumentError, match="wavelength"):
        times_direction_cosine(pw.shapes.square(1.0), 0.0)


@pytest.mark.parametrize("name", OBLIQUITIES)
def test_obliquity_factors_of_pairs_of_waves_are_those_of_their_far_fields(name):
    """Sum of g |F|^2 over the weighted sources, and |a c F + b F_p|^2 of the field itself."""
    angles = np.linspace(-80, 80, 33)
    directions = np.column_stack(
        [np.sin(np.radians(angles)), 0 * angles, np.cos(np.radians(angles))]
    )
    nu, cosine = directions[:, :2] / WAVELENGTH, directions[:, 2]
    square = pw.shapes.square(4e-3)
    steered = square.with_illumination(pw.steering((0.6, 0.0, 0.8), WAVELENGTH))
    for source in (square, steered, square.with_illumination(WAVES)):
        amplitude = WAVELENGTH * far_field(source, directions, WAVELENGTH, name)
        terms = weighted_sources(source, name, WAVELENGTH)
        got = sum(irradiance_factor(f, cosine) * abs(pw.fourier(s, nu)) ** 2 for s, f in terms)
        assert np.abs(got - abs(amplitude) ** 2).max() < ROUNDING * (abs(amplitude) ** 2).max()
        assert len(terms) == 1 or source.illumination == WAVES


def test_kirchhoff_s_mean_lets_grazing_waves_radiate():
    grazing = pw.Illumination([1], [(1 / WAVELENGTH, 0)])
    ((_, forms),) = weighted_sources(
        pw.shapes.square(1e-3).with_illumination(grazing), "kirchhoff", WAVELENGTH
    )
    assert emission_factor(forms, 0.5) == 0.125  # (cos/2)^2/cos
