"""Pistons, tilts and curved waves are path lengths at all wavelengths."""

from __future__ import annotations

import pickle
from typing import Any

import numpy as np
import pytest

import polywigner as pw
from polywigner.quantities import SPEED_OF_LIGHT

DESIGN, FOCUS = 2e-6, 0.1
MIRROR = pw.shapes.hexagonal_segments(1e-3, 0.02e-3, rings=1)
PISTON = np.array([0.0, -5.3, 0.2, 1.0, 0.4, 0.0]) * DESIGN
TILT = np.zeros((6, 2))
TILT[2], TILT[5] = (3e-3, 1e-3), (-1e-3, 2e-3)
PUPIL = pw.segmented_pupil(MIRROR, DESIGN, PISTON, TILT)
WAVELENGTHS = np.array([1e-6, 1.7e-6, 2e-6, 3.1e-6])
EXACT = 1e-11


def amplitude(x: Any, wavelength: float) -> Any:
    """Return the Fourier integral of the pupil at image points x (n, 2), a sum over segments."""
    total: Any = 0.0
    for segment, piston, tilt in zip(MIRROR.polygons.geoms, PISTON, TILT, strict=True):
        centre = np.array(segment.centroid.coords[0])
        path = piston - tilt @ centre
        nu = (np.asarray(x) / FOCUS - tilt) / wavelength
        wave = np.exp(2j * np.pi * path / wavelength)
        total = total + wave * pw.fourier(pw.Aperture(segment), nu)
    return total


POINTS = np.random.default_rng(1).uniform(-3e-4, 3e-4, (20, 2))


def test_a_piston_of_a_full_wave_changes_nothing_at_any_fraction_of_the_wave() -> None:
    step = pw.segmented_pupil(MIRROR, DESIGN, [0, 0, 0, DESIGN, 0, 0])
    for length, strehl in ((DESIGN, 1.0), (DESIGN / 2, 1.0), (2 * DESIGN, (4 / 6) ** 2)):
        peaks = [float(pw.psf(pupil, (0, 0), length, FOCUS)) for pupil in (step, MIRROR)]
        assert peaks[0] / peaks[1] == pytest.approx(strehl, rel=EXACT)


def test_psf_is_the_sum_over_segments_at_each_wavelength_and_their_mean() -> None:
    each = []
    for length in WAVELENGTHS.tolist():
        expected = np.abs(amplitude(POINTS, length)) ** 2 / (length * FOCUS) ** 2 / MIRROR.area
        result = pw.psf(PUPIL, POINTS, length, FOCUS)
        assert result == pytest.approx(expected, abs=EXACT * expected.max())
        each.append(expected)
    weights = [1.0, 2.0, 0.5, 1.0]
    mean = np.average(each, axis=0, weights=weights)
    result = pw.psf(PUPIL, POINTS, WAVELENGTHS, FOCUS, weights=weights)
    assert result == pytest.approx(mean, abs=EXACT * mean.max())


def test_mtf_is_that_of_the_psf_at_each_wavelength() -> None:
    """A dense sum over segments of the pupil and their shifted copies."""
    frequency = np.array([(2e3, 1e3), (7e3, -2e3)])
    lengths = [1.3e-6, 2.4e-6]
    total: Any = 0.0
    for length in lengths:
        lag = frequency * length * FOCUS
        rebuilt = pw.segmented_pupil(MIRROR, length, PISTON, TILT)
        total = total + pw.otf(rebuilt, lag) / 2
    assert pw.mtf(PUPIL, frequency, lengths, FOCUS) == pytest.approx(np.abs(total), abs=EXACT)


def test_irradiance_and_fields_take_the_phases_of_their_wavelength() -> None:
    system = pw.FirstOrder.fourier(FOCUS)
    for length in WAVELENGTHS.tolist():
        scale = (length * FOCUS) ** 2
        expected = np.abs(amplitude(POINTS, length)) ** 2 / scale
        result = pw.irradiance(PUPIL, POINTS, length, through=system)
        assert result == pytest.approx(expected, abs=EXACT * expected.max())
        rebuilt = pw.segmented_pupil(MIRROR, length, PISTON, TILT)
        place = (1e-4, -2e-4, 0.05)
        for method in ("fresnel", "rayleigh-sommerfeld-1", "fraunhofer"):
            fields = [pw.amplitude(pupil, place, length, method) for pupil in (PUPIL, rebuilt)]
            assert fields[0] == pytest.approx(fields[1], rel=1e-8)
    by_frequency = pw.amplitude(PUPIL, place, method="fresnel", frequency=SPEED_OF_LIGHT / 1e-6)
    rebuilt = pw.segmented_pupil(MIRROR, 1e-6, PISTON, TILT)
    assert by_frequency == pytest.approx(pw.amplitude(rebuilt, place, 1e-6, "fresnel"), rel=1e-8)
    one, other = (
        pw.wigner(pupil, (1e-4, 0.0), (1e3, 2e3), through=system, wavelength=1e-6)
        for pupil in (PUPIL, rebuilt)
    )
    assert one == pytest.approx(other, rel=1e-9)


@pytest.mark.parametrize(
    "kind", ["segments", pytest.param("array of curved elements", marks=pytest.mark.slow)]
)
def test_a_band_is_the_mean_over_wavelengths_with_their_own_phases(kind: str) -> None:
    def made(length: float) -> Any:
        if kind == "segments":
            return pw.segmented_pupil(MIRROR, length, PISTON, TILT)
        element = pw.shapes.square(2e-4).curved(0.01, length)
        return pw.phased_array(element, [(0.0, 0.0), (4e-4, 1e-4), (-6e-4, 0.0)], [1, 0.5j, -1])

    carrier, width, place = SPEED_OF_LIGHT / DESIGN, 2e13, (1e-4, 2e-4)
    node, weight = np.polynomial.legendre.leggauss(16)
    frequencies = carrier + width * node / 2
    system = pw.FirstOrder.fourier(0.02)
    each = [
        abs(pw.amplitude(made(length), place, length, through=system)) ** 2
        for length in (SPEED_OF_LIGHT / frequencies).tolist()
    ]
    expected = weight @ each / 2
    result = pw.irradiance(made(DESIGN), place, DESIGN, through=system, bandwidth=width)
    assert result == pytest.approx(expected, rel=1e-3)


def test_curved_waves_keep_their_radius_and_phase_shifters_their_phases() -> None:
    square, place = pw.shapes.square(1e-3), (1e-4, 2e-4, 0.02)
    wave, rebuilt = (square.curved((0.05, -0.03), length, (1e-4, 0.0)) for length in (2e-6, 1e-6))
    assert wave.at_wavelength(1e-6) == rebuilt
    one, other = (pw.amplitude(w, place, 1e-6, "fresnel") for w in (wave, rebuilt))
    assert one == pytest.approx(other, rel=1e-9)
    fixed = pw.Wavefront(square, wave.curvature, wave.centre)
    assert fixed.at_wavelength(1e-6) is fixed
    twice = wave.curved(0.05, 1e-6)
    assert twice == rebuilt.curved(0.05, 1e-6)
    weights = np.exp(2j * np.pi * np.array([0.0, 0.3, 0.9]))
    row = pw.phased_array(pw.shapes.square(1e-4), [(0, 0), (2e-4, 0), (4e-4, 0)], weights)
    assert row.at_wavelength(1e-6) is row


def test_path_lengths_survive_copies_and_other_wavelengths() -> None:
    copy = pickle.loads(pickle.dumps(PUPIL))
    assert copy == PUPIL
    shorter = copy.at_wavelength(1e-6)
    assert shorter != PUPIL and shorter.at_wavelength(1e-6) is shorter
    back = shorter.at_wavelength(DESIGN)
    nu = np.array([(300.0, -200.0)])
    assert pw.fourier(back, nu) == pytest.approx(pw.fourier(PUPIL, nu), rel=EXACT)
    partly = PUPIL.partially_coherent(4e-4)
    rebuilt = pw.segmented_pupil(MIRROR, 1e-6, PISTON, TILT).partially_coherent(4e-4)
    result, expected = (pw.irradiance(p, (0, 0, 0.05), 1e-6, "fresnel") for p in (partly, rebuilt))
    assert result == pytest.approx(expected, rel=1e-9)
