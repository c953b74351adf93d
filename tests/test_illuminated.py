"""Transforms of sources with tapers, steering and waves of their own, against direct quadrature."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
import shapely

import polywigner as pw
import polywigner.testing
from oracles.references import ENGINES

engines = pytest.mark.parametrize("engine", ENGINES)

ELL = pw.Aperture([[0, 0], [2, 0], [2, 1], [1, 1], [1, 2], [0, 2]])
FRAME = pw.Aperture(shapely.box(-1, -1, 1, 1) - shapely.box(-0.5, -0.5, 0.25, 0.5))
PARTS = pw.Aperture(shapely.union(shapely.box(-1, 0, -0.25, 1), shapely.box(0.25, 0, 1, 0.75)))
SQUARE = pw.Aperture(shapely.box(0.5, 0, 1.25, 0.75))  # overlaps the triangle
TRIANGLE = pw.Aperture([[0, 0], [1, 0.25], [0.25, 1.125]])

COSINE = pw.Illumination([0.25] * 4, [[0.25, 0.25], [0.25, -0.25], [-0.25, 0.25], [-0.25, -0.25]])
WILD = pw.Illumination([1, 0.3 - 0.5j, -0.2 + 1j], [[1.5, 0.5], [0.7, -0.4], [1.6, 0.4]])
STEERED = pw.Illumination([1.0], [[50.0, 20.0]])

SOURCES: dict[str, Any] = {
    "convex, cosine": TRIANGLE.with_illumination(COSINE),
    "non-convex, cosine": ELL.with_illumination(COSINE),
    "holed, three waves": FRAME.with_illumination(WILD),
    "disjoint, three waves": PARTS.with_illumination(WILD),
    "steered taper": ELL.with_illumination(STEERED * COSINE),
    "elements with fields of their own": pw.Array(
        [SQUARE.with_illumination(COSINE), TRIANGLE.with_illumination(WILD), TRIANGLE],
        [1, 1j, -0.5],
    ),
    "elements with one field": pw.Array(
        [SQUARE.with_illumination(WILD), TRIANGLE.with_illumination(2j * WILD)], [1.0, 0.5]
    ),
}


TE10 = 3.1358703246970885  # reference value, in units of the wavelength squared


def test_integral_of_w_over_frequencies_is_the_irradiance() -> None:
    # against a Gaussian window, whose transform is a Gaussian of lags: narrow, so that it only
    # sees lags inside the slice, where the field is smooth; sums over frequencies are spectral
    source = ELL.with_illumination(WILD)
    width, step = 24.0, 0.2
    axis = np.arange(-3.2, 3.2, step / width) * width
    nu = np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)
    window = np.exp(-np.pi * (nu**2).sum(axis=-1) / width**2)
    for x in ([0.5, 0.5], [1.25, 0.625], [0.375, 1.5]):
        got = (pw.wigner(source, np.array(x), nu) * window).sum() * (axis[1] - axis[0]) ** 2
        # the same integral over lags: the autocorrelation times the narrow Gaussian
        lag = np.linspace(-6, 6, 121) / width
        xi = np.stack(np.meshgrid(lag, lag), axis=-1)
        narrow = width**2 * np.exp(-np.pi * width**2 * (xi**2).sum(axis=-1))
        r = source.illumination(x + xi / 2) * source.illumination(x - xi / 2).conj()
        expected = (r * narrow).sum() * (lag[1] - lag[0]) ** 2
        assert got == pytest.approx(expected.real, rel=1e-9)
        # and the window's width costs this much of |u|^2
        assert got == pytest.approx(abs(source.illumination(x)) ** 2, rel=0.05)


def test_te10_mode_has_the_known_wigner_function() -> None:
    # u = cos(pi x/L) on a square of ten millimetres at 94 GHz
    wavelength = 299792458.0 / 94e9
    side = 10e-3 / wavelength
    mode = pw.Illumination([0.5, 0.5], [[0.5 / side, 0.0], [-0.5 / side, 0.0]])
    guide = pw.shapes.square(side).with_illumination(mode)
    assert pw.wigner(guide, (0.5, 0.3), (0.2, 0.1)) == pytest.approx(TE10, rel=1e-6)


@engines
def test_a_single_wave_shifts_the_transforms(engine: str) -> None:
    kappa, rng = np.array([700.0, -300.0]), np.random.default_rng(9)
    source = ELL.with_illumination(pw.Illumination([2j], [kappa]))
    x, xi = rng.uniform(0, 1.5, (2, 50, 2))
    nu = rng.normal(size=(50, 2))
    how = {"engine": engine}
    allowed = 4e-12  # nu + kappa is rounded to 1e-13
    w = pw.wigner(source, x, nu + kappa, **how)
    assert np.abs(w - 4 * pw.wigner(ELL, x, nu, **how)).max() < allowed
    a = pw.ambiguity(source, nu, xi, **how)
    turned = 4 * pw.ambiguity(ELL, nu, xi, **how) * np.exp(2j * np.pi * (xi @ kappa))
    assert np.abs(a - turned).max() < allowed
    f = pw.fourier(source, nu + kappa, **how)
    assert np.abs(f - 2j * pw.fourier(ELL, nu, **how)).max() < allowed


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
    pupil = SOURCES["non-convex, cosine"]
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


def test_samples_of_the_automean_bound_the_wigner_function() -> None:
    source = SOURCES["elements with fields of their own"]
    points, density = pw.sample_automean(source, 4000, "marginal", seed=1)
    largest = float(
        sum(
            abs(weight)
            * element.area
            * (1 if element.illumination is None else abs(element.illumination.amplitudes).sum())
            for weight, element in zip(source.weights, source.elements, strict=True)
        )
    )
    nu = np.array([0.3, 0.2])
    ratio = pw.wigner(source, points, nu) / density
    assert np.abs(ratio).max() <= largest**2 * (1 + 1e-9)
    expected = abs(pw.fourier(source, nu)) ** 2
    assert abs(ratio.mean() - expected) < 5 * ratio.std() / math.sqrt(len(ratio))
