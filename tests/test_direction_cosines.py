"""Sources whose waves are weighted by their direction cosines."""

import numpy as np
import pytest
from scipy.special import j0

import polywigner as pw
from polywigner.errors import IlluminationError
from polywigner.propagation.far_fields import far_field
from polywigner.source.obliquities import OBLIQUITIES, Forms, times_direction_cosine

WAVELENGTH = 3e-3
# Rounding error of sums of a few terms of order one.
ROUNDING = 1e-14

WAVES = pw.Illumination(
    [1.0, 0.5 - 0.2j, 0.3j], np.array([(0.0, 0.0), (200.0, -60.0), (-250.0, 400.0)])
)


def test_waves_that_graze_leave_nothing():
    grazing = pw.shapes.square(1e-3).with_illumination(pw.Illumination([1], [(1 / WAVELENGTH, 0)]))
    with pytest.raises(IlluminationError, match="grazing waves"):
        times_direction_cosine(grazing, WAVELENGTH)
    with pytest.raises(IlluminationError, match="grazing waves"):
        times_direction_cosine(pw.phased_array(grazing, [(0, 0), (1, 0)]), WAVELENGTH)
    both = pw.Array([grazing, pw.shapes.square(1e-3).moved((1, 0))])
    assert (times_direction_cosine(both, WAVELENGTH).weights == [0, 1]).all()


@pytest.mark.parametrize("name", OBLIQUITIES)
def test_obliquity_factors_of_pairs_of_waves_are_those_of_their_far_fields(name):
    """The sum of g |F|^2 over the weighted sources equals |a c F + b F_p|^2."""
    angles = np.linspace(-80, 80, 33)
    directions = np.column_stack(
        [np.sin(np.radians(angles)), 0 * angles, np.cos(np.radians(angles))]
    )
    nu, cosine = directions[:, :2] / WAVELENGTH, directions[:, 2]
    square = pw.shapes.square(4e-3)
    steered = square.with_illumination(pw.steering((0.6, 0.0, 0.8), WAVELENGTH))
    for source in (square, steered, square.with_illumination(WAVES)):
        amplitude = WAVELENGTH * far_field(source, directions, WAVELENGTH, name)
        terms = OBLIQUITIES[name].terms(source, WAVELENGTH)
        got = sum(f.irradiance(cosine) * abs(pw.fourier(s, nu)) ** 2 for s, f in terms)
        assert np.abs(got - abs(amplitude) ** 2).max() < ROUNDING * (abs(amplitude) ** 2).max()
        assert len(terms) == 1 or source.illumination == WAVES


def test_kirchhoff_s_mean_lets_grazing_waves_radiate():
    grazing = pw.shapes.square(1e-3).with_illumination(pw.Illumination([1], [(1 / WAVELENGTH, 0)]))
    ((_, forms),) = OBLIQUITIES["kirchhoff"].terms(grazing, WAVELENGTH)
    assert forms.radiance(0.5) == 0.125  # (cos/2)^2/cos


def test_radiance_factors_and_their_transforms_are_those_of_the_irradiance_factor():
    """The disc of directions has the element sin(theta) cos(theta) d theta d phi."""
    forms, q = Forms(0.3, 0.5, 0.7), np.array([0.4, 3.0, 25.0])
    assert forms.irradiance(0.5) == pytest.approx(0.3 / 4 + 0.5 / 2 + 0.7, rel=ROUNDING)
    assert forms.radiance(0.5) == pytest.approx(forms.irradiance(0.5) / 0.5, rel=ROUNDING)
    node, weight = np.polynomial.legendre.leggauss(60)
    theta = (node + 1) * np.pi / 4
    sine, ring = np.sin(theta), weight * np.pi / 4 * 2 * np.pi * np.sin(theta)
    expected = j0(q[:, None] * sine) @ (ring * forms.irradiance(np.cos(theta)))
    assert forms.at_lags(q) == pytest.approx(expected, rel=100 * ROUNDING)
