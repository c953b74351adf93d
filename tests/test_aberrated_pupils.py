"""Pupils with aberrations against closed forms, Nijboer-Zernike sums and dense quadrature."""

import numpy as np
import pytest
import shapely
from scipy.special import fresnel, j0, jacobi, jv

import polywigner as pw
from oracles.quadrature import triangle_nodes, triangles_of
from polywigner.errors import ArgumentError, PolywignerWarning
from polywigner.transforms import aberrations

WAVELENGTH, FOCUS, RADIUS = 550e-9, 0.1, 5e-3
SCALE = WAVELENGTH * FOCUS
SQUARE = pw.shapes.square(2 * RADIUS)
HEXAGON = pw.shapes.regular_polygon(6, RADIUS)
COMA = pw.zernike({8: 0.3 * WAVELENGTH, 6: 0.15 * WAVELENGTH}, RADIUS)
# Errors relative to a disc. The error of an n-gon is of the order n^-4, and extrapolation removes
# this term.
DISC, EXTRAPOLATED = 1e-8, 1.0 / 15.0
DENSE = 1e-9


def of_a_disc(function, n=96):
    """Extrapolate a function from polygons with n and 2 n corners to a disc."""
    coarse, fine = (function(pw.shapes.disc(RADIUS, k)) for k in (n, 2 * n))
    return fine + (fine - coarse) * EXTRAPOLATED


def strehl_of_zernike(j, waves):
    """Integrate over the radius; the integral over the angle is a Bessel function."""
    n, m = aberrations.noll(j)
    node, weight = np.polynomial.legendre.leggauss(300)
    r = (node + 1) / 2
    degree = (n - abs(m)) // 2
    radial = (-1) ** degree * r ** abs(m) * jacobi(degree, abs(m), 0)(1 - 2 * r**2)
    phase = 2 * np.pi * waves * aberrations.zernike_norm((n, m)) * radial
    wave = j0(phase) if m else np.exp(1j * phase)
    return abs((weight * r) @ wave) ** 2


@pytest.mark.slow
@pytest.mark.parametrize("waves", [0.02, 0.5])
def test_the_strehl_ratio_of_each_zernike_is_its_closed_form(waves):
    for j in range(1, 37):
        aberration = pw.zernike({j: waves * WAVELENGTH}, RADIUS)
        result = of_a_disc(
            lambda disc, w=aberration: pw.strehl(disc, WAVELENGTH, w), 64 if waves < 0.5 else 100
        )
        assert result == pytest.approx(strehl_of_zernike(j, waves), abs=DISC), j


def test_marechals_approximation_holds_for_small_aberrations():
    for j in range(4, 37):
        aberration = pw.zernike({j: 0.02 * WAVELENGTH}, RADIUS)
        result = pw.strehl(pw.shapes.disc(RADIUS), WAVELENGTH, aberration)
        assert result == pytest.approx(np.exp(-((2 * np.pi * 0.02) ** 2)), abs=2e-3)


def test_defocus_and_spherical_aberration_have_closed_forms():
    """The Strehl ratios are sinc^2, and Fresnel integrals of 6 t^2 - 6 t + 1 with t = r^2."""
    c = 0.3
    defocus, spherical = (pw.zernike({j: c * WAVELENGTH}, RADIUS) for j in (4, 11))
    result = of_a_disc(lambda disc: pw.strehl(disc, WAVELENGTH, defocus))
    assert result == pytest.approx(np.sinc(2 * np.sqrt(3) * c) ** 2, abs=DISC)
    # The integral of exp(i a s^2) ds from s = -1/2 to 1/2, with s = t - 1/2.
    a = 2 * np.pi * c * np.sqrt(5) * 6
    sine, cosine = fresnel(0.5 * np.sqrt(2 * a / np.pi))
    expected = (cosine**2 + sine**2) * (2 * np.pi / a)
    result = of_a_disc(lambda disc: pw.strehl(disc, WAVELENGTH, spherical))
    assert result == pytest.approx(expected, abs=DISC)


@pytest.mark.parametrize("waves", [0.05, 0.2])
def test_spots_are_the_sums_of_nijboer_and_zernike(waves):
    """U is 2 sum beta_n^m i^-m (-1)^((n - m)/2) J_(n+1)(v)/v exp(i m phi), with |m| for m."""
    aberration = pw.zernike({8: waves * WAVELENGTH, 4: 0.5 * waves * WAVELENGTH}, RADIUS)
    node, weight = np.polynomial.legendre.leggauss(80)
    r, angle = (node + 1) / 2, np.arange(96) * (2 * np.pi / 96)
    x, y = r[:, None] * np.cos(angle), r[:, None] * np.sin(angle)
    field = np.exp(2j * np.pi / WAVELENGTH * aberration(RADIUS * x, RADIUS * y))
    area = np.repeat(weight * r / 96, 96).reshape(x.shape)
    orders = [(n, m) for n in range(41) for m in range(-n, n + 1, 2)]
    beta = aberrations.zernike_values(orders, x, y) * area * field
    v, phi = np.array([1.0, 3.0, 5.5, 8.0]), np.array([0.3, 1.9, -2.0, 4.0])
    total = 0.0
    for (n, m), part in zip(orders, beta.sum(axis=(1, 2)), strict=True):
        k = abs(m)
        wave = np.cos(k * phi) if m >= 0 else np.sin(k * phi)
        radial = (-1) ** ((n - k) // 2) * (-1j) ** k * jv(n + 1, v) / v
        total = total + aberrations.zernike_norm((n, m)) ** 2 * part * 2 * radial * wave
    points = (v / (2 * np.pi) * SCALE / RADIUS)[:, None] * np.stack([np.cos(phi), np.sin(phi)], -1)
    unit = np.pi * RADIUS**2 / SCALE**2
    result = of_a_disc(
        lambda disc: pw.psf(disc, points, WAVELENGTH, FOCUS, aberration=aberration) / unit
    )
    assert result == pytest.approx(np.abs(total) ** 2, abs=DISC)


def dense_spot(pupil, weights, aberration, points, wavelength, defocus=0.0, order=60):
    """Return |U|^2 by quadrature with 60 x 60 nodes on each triangle."""
    total = 0.0
    for element, weight in zip(pupil, weights, strict=True):
        x, area = triangle_nodes(triangles_of(element.polygons), order)
        cycles = aberration(*x.T) / wavelength + defocus * (x**2).sum(axis=1) / RADIUS**2
        waves = np.exp(2j * np.pi * (cycles - points @ x.T / (wavelength * FOCUS)))
        total = total + waves @ (weight * area)
    return np.abs(total / (wavelength * FOCUS)) ** 2


@pytest.mark.parametrize("pupil", [SQUARE, HEXAGON, pw.shapes.ring(RADIUS, 2e-3, 12)])
def test_spots_with_coma_and_astigmatism_are_dense_sums(pupil):
    axis = np.linspace(-30e-6, 40e-6, 9)
    points = np.stack(np.meshgrid(axis, axis), axis=-1)
    result = pw.psf(pupil, points, WAVELENGTH, FOCUS, 0.4, RADIUS, aberration=COMA)
    expected = dense_spot([pupil], [1.0], COMA, points.reshape(-1, 2), WAVELENGTH, 0.4)
    peak = pupil.area / SCALE**2
    assert result.ravel() / peak == pytest.approx(expected / pupil.area / peak, abs=DENSE)


@pytest.mark.parametrize("pupil", [SQUARE, HEXAGON, pw.shapes.ring(RADIUS, 2e-3, 12)])
def test_transfer_functions_are_dense_sums_over_the_slices(pupil):
    lags = np.array([(0.0, 0.0), (1e-3, 2e-3), (4e-3, -1e-3), (-6e-3, 3e-3)])
    expected = []
    for lag in lags:
        ahead, behind = (
            shapely.transform(pupil.polygons, lambda p, s=sign * lag / 2: p + s) for sign in (-1, 1)
        )
        x, area = triangle_nodes(triangles_of(ahead & behind), 60)
        phase = COMA(*(x + lag / 2).T) - COMA(*(x - lag / 2).T)
        expected.append(area @ np.exp(2j * np.pi * phase / WAVELENGTH) / pupil.area)
    result = pw.otf(pupil, lags, aberration=COMA, wavelength=WAVELENGTH)
    assert result == pytest.approx(np.array(expected), abs=DENSE)
    curve = pw.mtf(pupil, lags / SCALE, WAVELENGTH, FOCUS, aberration=COMA)
    assert curve == pytest.approx(np.abs(expected), abs=DENSE)


def test_a_path_of_defocus_is_the_argument_defocus():
    path = pw.Aberration([[0, 0, 1], [0, 0, 0], [1, 0, 0]], RADIUS) * (0.7 * WAVELENGTH)
    lags = np.array([(1e-3, 0.0), (3e-3, 4e-3)])
    expected = pw.otf(HEXAGON, lags, 0.7, RADIUS)
    result = pw.otf(HEXAGON, lags, aberration=path, wavelength=WAVELENGTH)
    assert result == pytest.approx(expected, abs=1e-12)
    points = np.array([(0.0, 0.0), (1e-5, 2e-5)])
    expected = pw.psf(HEXAGON, points, WAVELENGTH, FOCUS, 0.7, RADIUS)
    result = pw.psf(HEXAGON, points, WAVELENGTH, FOCUS, aberration=path)
    assert result == pytest.approx(expected, rel=1e-9)


def test_a_tilt_shifts_the_spot_and_a_function_is_its_polynomial():
    tilt = pw.Aberration(lambda x, y: 2e-4 * x - 1e-4 * y, RADIUS)
    points = np.array([(0.0, 0.0), (5e-6, -7e-6)])
    result = pw.psf(HEXAGON, points + np.array([2e-5, -1e-5]), WAVELENGTH, FOCUS, aberration=tilt)
    assert result == pytest.approx(pw.psf(HEXAGON, points, WAVELENGTH, FOCUS), rel=1e-9)


def test_segments_with_pistons_over_a_band_of_ten_percent():
    primary = pw.shapes.hexagonal_segments(2e-3, 0.1e-3, rings=1, centre=True)
    segments = list(primary.segments)
    piston = WAVELENGTH * np.array([0, 0, 1.0, 0, 0, 0, 0.3])
    band = WAVELENGTH * np.linspace(0.95, 1.05, 5)
    mirror = pw.segmented_pupil(segments, WAVELENGTH, piston)
    wave = pw.zernike({6: 0.1 * WAVELENGTH}, RADIUS)
    points = np.array([(0.0, 0.0), (6e-6, 1e-6), (-1e-5, 2e-5)])
    expected = np.mean(
        [
            dense_spot(segments, np.exp(2j * np.pi * piston / length), wave, points, length)
            for length in band
        ],
        axis=0,
    )
    result = pw.psf(mirror, points, band, FOCUS, aberration=wave)
    peak = primary.area / SCALE**2
    assert result / peak == pytest.approx(expected / primary.area / peak, abs=DENSE)
    axis = dense_spot(segments, np.exp(2j * np.pi * piston / WAVELENGTH), wave, points, WAVELENGTH)
    ratio = axis[0] * SCALE**2 / primary.area**2
    assert pw.strehl(mirror, WAVELENGTH, wave) == pytest.approx(ratio, abs=DENSE)
    shares = np.array([segment.area for segment in segments]) / primary.area
    of_pistons = np.sqrt(shares @ piston**2 - (shares @ piston) ** 2)
    assert pw.wavefront_error(mirror) == pytest.approx(of_pistons, rel=1e-9)


def test_the_rms_over_a_disc_is_the_root_of_the_sum_of_squares():
    wave = pw.zernike({1: 1e-6, 4: 3e-8, 9: 4e-8}, RADIUS)
    result = of_a_disc(lambda disc: pw.wavefront_error(disc, wave))
    assert result == pytest.approx(5e-8, rel=1e-7)


def test_the_rms_of_a_curved_wave_is_refused_because_its_curvature_is_a_phase():
    with pytest.raises(ArgumentError, match="got a Wavefront; pass its path"):
        pw.wavefront_error(pw.Wavefront(SQUARE, curvature=np.eye(2)))


@pytest.mark.parametrize("method", ["fresnel", "fraunhofer"])
def test_fields_of_aberrated_sources(method):
    source = pw.Array([HEXAGON.moved((6e-3, 1e-3)), SQUARE.moved((-6e-3, 0.0))], [1.0, 0.5j])
    points = np.array([(0.0, 0.0, 5.0), (3e-3, -2e-3, 5.0), (1e-3, 1e-3, 7.0)])
    points[:, 2] *= 1.0 if method == "fresnel" else 300.0
    none = pw.zernike({4: 0.0}, RADIUS)
    how = {"tolerance": 1e-12} if method == "fresnel" else {}
    expected = pw.amplitude(source, points, WAVELENGTH, method, **how)
    result, error = pw.amplitude_with_error(source, points, WAVELENGTH, method, aberration=none)
    assert np.abs(result - expected).max() < 1e-9 * np.abs(expected).max()
    assert error.max() < 1e-9 * np.abs(expected).max()
    lens = COMA + pw.Aberration([[0, 0, 1], [0, 0, 0], [1, 0, 0]]) * (-0.5 / FOCUS)
    spot = np.array([(0.0, 0.0, FOCUS), (1e-5, -5e-6, FOCUS)])
    if method == "fresnel":
        field = pw.amplitude(HEXAGON, spot, WAVELENGTH, method, aberration=lens)
        expected = pw.psf(HEXAGON, spot[:, :2], WAVELENGTH, FOCUS, aberration=COMA)
        assert np.abs(field) ** 2 / HEXAGON.area == pytest.approx(expected, rel=1e-7)


def test_images_of_masks_with_an_aberration():
    pupil, small = pw.shapes.disc(2.5e-3, 24), pw.shapes.square(1e-7)
    lines = pw.shapes.rectangle(1e-6, 2e-6)
    points = np.column_stack([np.linspace(-1e-6, 1e-6, 9), np.zeros(9)])
    scene = {"wavelength": WAVELENGTH, "distance": 10e-3}
    path = pw.Aberration([[0, 0, 1], [0, 0, 0], [1, 0, 0]], 2.5e-3) * (0.4 * WAVELENGTH)
    condenser = pw.shapes.disc(1.5e-3, 24)
    image = lambda light, **how: pw.partially_coherent_image(  # noqa: E731
        lines, (2e-6, 2e-6), pupil, light, points, **scene, **how
    )
    expected = image(condenser, defocus=0.4, pupil_radius=2.5e-3)
    assert image(condenser, aberration=path) == pytest.approx(expected, abs=1e-9)
    coma = pw.zernike({8: 0.2 * WAVELENGTH}, 2.5e-3)
    step = WAVELENGTH * 10e-3 / 2e-6  # spacing of the orders in the pupil
    orders = np.array([-step, 0.0, step]) if step < 2.4e-3 else np.zeros(1)
    weights = np.sinc(orders / step / 2) / 2
    waves = np.exp(2j * np.pi * (np.outer(points[:, 0], orders) / (WAVELENGTH * 10e-3)))
    field = waves @ (weights * np.exp(2j * np.pi * coma(orders, 0 * orders) / WAVELENGTH))
    assert image(small, aberration=coma) == pytest.approx(np.abs(field) ** 2, abs=1e-3)


def test_five_waves_of_defocus_and_coma_keep_the_tolerance():
    points = np.array([(0.0, 0.0), (5e-5, 2e-5)])
    wave = pw.zernike({8: 1.0 * WAVELENGTH}, RADIUS)
    spot = pw.psf(SQUARE, points, WAVELENGTH, FOCUS, 5.0, RADIUS, aberration=wave)
    expected = dense_spot([SQUARE], [1.0], wave, points, WAVELENGTH, 5.0, 200) / SQUARE.area
    assert spot / (SQUARE.area / SCALE**2) == pytest.approx(
        expected / (SQUARE.area / SCALE**2), abs=DENSE
    )


def test_a_numerical_aperture_replaces_the_focal_length():
    points, frequency = np.array([(1e-6, 2e-6)]), np.array([(1e5, 0.0)])
    disc = pw.shapes.disc(RADIUS)
    near = {"numerical_aperture": 0.25, "pupil_radius": RADIUS}
    far = {"focal_length": RADIUS / 0.25, "pupil_radius": RADIUS}
    assert pw.psf(disc, points, 1e-6, **near) == pytest.approx(pw.psf(disc, points, 1e-6, **far))
    assert pw.mtf(disc, frequency, 1e-6, **near) == pw.mtf(disc, frequency, 1e-6, **far)
    cutoff = 2 * 0.25 / 1e-6
    assert pw.mtf(disc, (1.01 * cutoff, 0.0), 1e-6, **near) == 0.0
    for wrong in ({}, {**near, **far}, {"numerical_aperture": 1.5}):
        with pytest.raises(ArgumentError, match="numerical_aperture"):
            pw.psf(disc, points, 1e-6, **wrong)


def test_a_path_with_a_step_warns():
    step = pw.Aberration(lambda x, y: 1e-7 * (x + y > 1e-3), RADIUS)
    with pytest.warns(PolywignerWarning, match="estimated error"):
        pw.psf(SQUARE, (0.0, 0.0), WAVELENGTH, FOCUS, aberration=step)


@pytest.mark.parametrize(
    "options",
    [{"method": "kirchhoff"}, {"method": "fraunhofer", "obliquity": "kirchhoff"},
     {"method": "fresnel", "obstacles": SQUARE.placed(np.eye(4))}],
)  # fmt: skip
def test_fields_without_aberrations_are_named(options):
    with pytest.raises(ArgumentError, match="aberration requires"):
        pw.amplitude(SQUARE, (0.0, 0.0, 1.0), WAVELENGTH, aberration=COMA, **options)


def test_a_coefficient_in_nanometres_is_refused_at_once():
    with pytest.raises(ArgumentError, match="in metres"):
        pw.psf(
            pw.shapes.square(6e-3), (0.0, 0.0), 550e-9, 0.05, aberration=pw.zernike({4: 25}, 5e-3)
        )
