"""Transforms of sources with tapers, steering and waves of their own, against direct quadrature."""

from __future__ import annotations

import math

import numpy as np
import pytest

import polywigner as pw
import polywigner.testing

ELL = pw.Aperture([[0, 0], [2, 0], [2, 1], [1, 1], [1, 2], [0, 2]])
TRIANGLE = pw.Aperture([[0, 0], [1, 0.25], [0.25, 1.125]])

COSINE = pw.Illumination([0.25] * 4, [[0.25, 0.25], [0.25, -0.25], [-0.25, 0.25], [-0.25, -0.25]])
WILD = pw.Illumination([1, 0.3 - 0.5j, -0.2 + 1j], [[1.5, 0.5], [0.7, -0.4], [1.6, 0.4]])

TE10 = 3.1358703246970885  # reference value, in units of the wavelength squared


def test_te10_mode_has_the_known_wigner_function() -> None:
    # u = cos(pi x/L) on a square of ten millimetres at 94 GHz
    wavelength = 299792458.0 / 94e9
    side = 10e-3 / wavelength
    mode = pw.Illumination([0.5, 0.5], [[0.5 / side, 0.0], [-0.5 / side, 0.0]])
    guide = pw.shapes.square(side).with_illumination(mode)
    assert pw.wigner(guide, (0.5, 0.3), (0.2, 0.1)) == pytest.approx(TE10, rel=1e-6)


def test_fourier_transform_of_waves_far_from_the_origin_keeps_its_digits() -> None:
    shift = np.array([1024.0, -512.0])
    far = ELL.moved(shift).with_illumination(WILD)
    turn = np.exp(2j * np.pi * np.array([math.fmod(k @ shift, 1.0) for k in WILD.frequencies]))
    near = ELL.with_illumination(pw.Illumination(WILD.amplitudes * turn, WILD.frequencies))
    nu = np.round(np.random.default_rng(10).uniform(-40, 40, (50, 2)) * 2**20) / 2**20
    turns = np.array([math.fmod(n[0] * 1024.0, 1.0) - math.fmod(n[1] * 512.0, 1.0) for n in nu])
    expected = pw.fourier(near, nu) * np.exp(-2j * np.pi * turns)
    assert np.abs(pw.fourier(far, nu) - expected).max() < 1e-12


def test_fourier_transform_of_a_placed_aperture_with_waves() -> None:
    angle = 0.7
    pose = np.array(
        [
            [math.cos(angle), 0, math.sin(angle), 3.0],
            [0, 1, 0, -2.0],
            [-math.sin(angle), 0, math.cos(angle), 1.0],
            [0, 0, 0, 1],
        ]
    )
    nu = np.random.default_rng(11).normal(size=(30, 3)) * (1 + 0.2j)
    source = ELL.with_illumination(WILD)
    expected = pw.fourier(source, nu @ pose[:3, :2]) * np.exp(-2j * np.pi * (nu @ pose[:3, 3]))
    got = pw.fourier(source.placed(pose), nu)
    assert np.abs(got - expected).max() < 1e-13 * np.abs(expected).max()
    moved = pw.Array([source.placed(pose)], [2.0])
    assert np.abs(pw.fourier(moved, nu) - 2 * expected).max() < 2e-13 * np.abs(expected).max()


def test_otf_of_a_tapered_pupil_is_its_autocorrelation() -> None:
    pupil = ELL.with_illumination(COSINE)
    xi = np.array([[0.0, 0.0], [0.25, 0.5]])
    got = pw.otf(pupil, xi)
    assert got[0] == pytest.approx(1.0, abs=1e-14)
    energy = pw.lag_marginal(pupil, [0.0, 0.0]).real
    assert got[1] == pytest.approx(complex(pw.lag_marginal(pupil, xi[1]) / energy))


def test_waves_turn_and_shift_with_elements_posed_in_the_plane() -> None:
    angle = 0.5
    rotation = np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])
    pose = np.eye(4)
    pose[:2, :2], pose[:2, 3] = rotation, (1.0, -2.0)
    source = TRIANGLE.with_illumination(WILD)
    posed = pw.Array([source.placed(pose)])
    x, nu = np.random.default_rng(14).uniform(0, 1, (2, 40, 2))
    there = x @ rotation.T + pose[:2, 3]
    expected = pw.wigner(source, x, nu)
    assert np.abs(pw.wigner(posed, there, nu @ rotation.T) - expected).max() < 1e-13
