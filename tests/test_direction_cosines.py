"""Sources whose waves are weighted by their direction cosines."""

from __future__ import annotations

import numpy as np
import pytest

import polywigner as pw
from polywigner.errors import ArgumentError, IlluminationError
from polywigner.illumination.obliquities import (
    OBLIQUITIES,
    direction_cosines,
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


def field_times_cosines(x: np.ndarray, add: complex) -> np.ndarray:
    """sum (p_m + add) c_m exp(2 pi i kappa_m.x), written out."""
    total = np.zeros(len(x), complex)
    for amplitude, kappa in zip(WAVES.amplitudes, WAVES.frequencies, strict=True):
        p = np.emath.sqrt(1 - WAVELENGTH**2 * (kappa @ kappa))
        total += (p + add) * amplitude * np.exp(2j * np.pi * x @ kappa)
    return total


@pytest.mark.parametrize("constant", [0.0, 1.0, -1j])
def test_each_wave_is_multiplied_by_its_direction_cosine(constant: complex) -> None:
    aperture = pw.shapes.square(4e-3).with_illumination(WAVES)
    scaled = times_direction_cosine(aperture, WAVELENGTH, constant)
    assert scaled.with_illumination(None) == aperture.with_illumination(None)
    expected = field_times_cosines(PLACES, constant)
    np.testing.assert_allclose(scaled.illumination(PLACES), expected, rtol=ROUNDING)


def test_a_wave_steered_by_an_angle_has_the_cosine_of_that_angle() -> None:
    angles = np.radians([0, 10, 60, 89.99])
    kappa = np.column_stack([np.sin(angles), 0 * angles]) / WAVELENGTH
    np.testing.assert_allclose(direction_cosines(kappa, WAVELENGTH), np.cos(angles), rtol=1e-8)


def test_evanescent_waves_have_a_cosine_of_plus_i_times_their_decay() -> None:
    p = direction_cosines(np.array([2 / WAVELENGTH, 0.0]), WAVELENGTH)
    assert p == pytest.approx(1j * np.sqrt(3), rel=ROUNDING)


def test_uniform_sources_leave_at_normal_incidence() -> None:
    square = pw.shapes.square(4e-3)
    slits = pw.Slits([(0, 1e-3)])
    row = pw.phased_array(square, [(0, 0), (5e-3, 0)], [1, 1j])
    for source in (square, slits, row, square.placed(np.eye(4))):
        assert times_direction_cosine(source, WAVELENGTH) is source or (
            times_direction_cosine(source, WAVELENGTH) == source
        )
    for source in (square, slits):
        doubled = times_direction_cosine(source, WAVELENGTH, constant=1.0)
        assert doubled.illumination(np.zeros(1 if source is slits else 2)) == 2
    assert (times_direction_cosine(row, WAVELENGTH, constant=1.0).weights == 2 * row.weights).all()


def test_phased_arrays_stay_lattices_of_equal_elements() -> None:
    element = pw.shapes.square(1e-3).with_illumination(WAVES)
    places = pw.arrays.grid_positions(3, 2, 2e-3)
    array = pw.phased_array(element, places, [1, 2, 3, 4, 5, 6j])
    scaled = times_direction_cosine(array, WAVELENGTH)
    assert scaled == pw.phased_array(
        times_direction_cosine(element, WAVELENGTH), places, array.weights
    )
    assert scaled.sites.lattice is not None


def test_elements_of_mixed_arrays_get_their_own_factors() -> None:
    steered = pw.shapes.square(1e-3).with_illumination(pw.steering((0.6, 0.0, 0.8), WAVELENGTH))
    plain = pw.shapes.square(1e-3).moved((3e-3, 0))
    slits = pw.Slits([(0, 1e-3)]).with_illumination(pw.Illumination([1], [0.6 / WAVELENGTH]))
    array = pw.Array([steered.placed(np.eye(4)), plain], [1, 1])
    nu = np.array([130.0, -40.0, 250.0])
    expected = 1.8 * pw.fourier(steered, nu[:2]) + 2 * pw.fourier(plain, nu[:2])
    found = pw.fourier(times_direction_cosine(array, WAVELENGTH, constant=1.0), nu)
    assert found == pytest.approx(expected, rel=1e-12)
    assert times_direction_cosine(slits, WAVELENGTH).illumination((0.0,)) == pytest.approx(0.8)


def test_waves_that_graze_leave_nothing() -> None:
    grazing = pw.shapes.square(1e-3).with_illumination(pw.Illumination([1], [(1 / WAVELENGTH, 0)]))
    with pytest.raises(IlluminationError, match="graze"):
        times_direction_cosine(grazing, WAVELENGTH)
    with pytest.raises(IlluminationError, match="graze"):
        times_direction_cosine(pw.phased_array(grazing, [(0, 0), (1, 0)]), WAVELENGTH)
    both = pw.Array([grazing, pw.shapes.square(1e-3).moved((1, 0))])
    assert (times_direction_cosine(both, WAVELENGTH).weights == [0, 1]).all()


def test_bodies_and_wavelengths_of_zero_are_refused() -> None:
    corners = np.array([(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)], dtype=float)
    body = pw.Polyhedron(corners, [(0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3)])
    for source in (body, pw.Array([body])):
        with pytest.raises(ArgumentError, match="Polyhedron"):
            times_direction_cosine(source, WAVELENGTH)
    with pytest.raises(ArgumentError, match="wavelength"):
        times_direction_cosine(pw.shapes.square(1.0), 0.0)


@pytest.mark.parametrize("name", OBLIQUITIES)
def test_obliquity_factors_of_pairs_of_waves_are_those_of_their_far_fields(name: str) -> None:
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


def test_kirchhoff_s_mean_lets_grazing_waves_radiate() -> None:
    grazing = pw.Illumination([1], [(1 / WAVELENGTH, 0)])
    ((_, forms),) = weighted_sources(
        pw.shapes.square(1e-3).with_illumination(grazing), "kirchhoff", WAVELENGTH
    )
    assert emission_factor(forms, 0.5) == 0.125  # (cos/2)^2/cos
