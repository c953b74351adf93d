"""Radiance, flux and power: closed forms, and two routes to every integral over directions."""

from __future__ import annotations

import math
import sys
from typing import Any

import numpy as np
import pytest
import shapely
from scipy.special import j0, j1

import polywigner as pw
from oracles.quadrature import triangle_nodes
from polywigner.errors import ArgumentError, GeometryError, PolywignerError
from polywigner.radiometry.hemisphere import directions_and_weights

WAVELENGTH = 299792458 / 94e9
K = 2 * math.pi / WAVELENGTH
SQUARE = pw.shapes.square(10e-3)
ELL = pw.Aperture(np.array([[-5, -5], [5, -5], [5, -1], [-1, -1], [-1, 5], [-5, 5]]) * 1e-3)
BEAM = np.array([math.sin(0.5), 0.0, math.cos(0.5)])
STEERED = ELL.with_illumination(pw.steering(BEAM, WAVELENGTH))
TAPERED = SQUARE.with_illumination(pw.cosine_taper(10e-3))
ROW = pw.phased_array(
    pw.shapes.rectangle(1.4e-3, 2e-3),
    pw.arrays.grid_positions(6, 2, 1.6e-3, 2.5e-3),
    np.repeat(np.exp(0.8j * np.arange(6)), 2),
)
MIXED = pw.Array([ELL, SQUARE.moved((12e-3, 1e-3)), TAPERED.moved((3e-3, -9e-3))], [1, -1j, 0.5])
SOURCES = {
    "square": SQUARE,
    "ell": ELL,
    "steered": STEERED,
    "tapered": TAPERED,
    "phased array": ROW,
    "mixed array": MIXED,
}
sources = pytest.mark.parametrize("source", SOURCES.values(), ids=SOURCES)

# Stated in the docstrings, of int |u|^2 over lambda^2 or of int |u|^2.
ACCURACY = 1e-12
# Gauss-Legendre on panels of a few wavelengths, summed in other orders.
ROUTES = 1e-12


def _direction(theta: float, phi: float = 0.0) -> np.ndarray:
    sine = math.sin(theta)
    return np.array([sine * math.cos(phi), sine * math.sin(phi), math.cos(theta)])


def _gauss(low: Any, high: Any, order: int) -> tuple[np.ndarray, np.ndarray]:
    node, weight = np.polynomial.legendre.leggauss(order)
    half = (np.asarray(high) - np.asarray(low))[..., None] / 2
    return np.asarray(low)[..., None] + half * (node + 1), half * weight


def test_radiance_of_a_square_at_its_centre_is_the_closed_form() -> None:
    direction = _direction(0.6, 0.3)
    closed = math.prod(20e-3 * np.sinc(20e-3 * s / WAVELENGTH) for s in direction[:2])
    found = pw.radiance(SQUARE, (0.0, 0.0), direction, WAVELENGTH)
    assert found == pytest.approx(closed / WAVELENGTH**2, abs=1e-4 * ACCURACY / WAVELENGTH**2)


@sources
def test_radiance_over_the_source_is_the_radiant_intensity(source: Any) -> None:
    """int L cos(theta) dx = cos(theta) |F|^2/lambda^2, by the midpoint rule."""
    direction = _direction(0.3, 2.0)
    axis = np.linspace(-20e-3, 25e-3, 1001)
    x = np.stack(np.meshgrid(axis, axis), axis=-1)
    total = pw.radiance(source, x, direction, WAVELENGTH).sum() * (axis[1] - axis[0]) ** 2
    found = pw.radiant_intensity(source, direction, WAVELENGTH)
    energy = pw.energy_budget(source, WAVELENGTH).total
    rule = 2e-4  # of the largest intensity: W has kinks, the rule cells of 45 um
    assert abs(direction[2] * total - found) < rule * energy**2 / WAVELENGTH**2


def test_the_papers_radiance_lacks_the_power_and_has_four_pi_too_many() -> None:
    x, s = (1e-3, -2e-3), _direction(0.2)
    for source, area in ((ELL, ELL.area), (ROW, ROW.support.area)):
        ratio = pw.radiance(source, x, s, WAVELENGTH) / pw.radiance(
            source, x, s, WAVELENGTH, normalisation="paper"
        )
        assert ratio == pytest.approx(4 * math.pi * area)


def test_a_source_much_smaller_than_the_wavelength_is_lambertian() -> None:
    """F is its area in all directions, so that the radiant intensity goes with the cosine."""
    speck = pw.shapes.triangle(1e-6, 2e-6)
    for theta in (0.0, 0.7, 1.5):
        intensity = pw.radiant_intensity(speck, _direction(theta), WAVELENGTH)
        expected = math.cos(theta) * (speck.area / WAVELENGTH) ** 2
        # (k D)^2 of the speck is 2e-5
        assert intensity == pytest.approx(expected, rel=1e-6, abs=0.0)
    solid = math.pi * (speck.area / WAVELENGTH) ** 2
    assert pw.power(speck, WAVELENGTH) == pytest.approx(solid, rel=1e-5, abs=0.0)


def test_single_precision_stays_single() -> None:
    s = _direction(0.4)[None].repeat(3, axis=0)
    for function, double in (
        (lambda **how: pw.radiance(SQUARE, (0, 0), s, WAVELENGTH, **how), np.float64),
        (lambda **how: pw.radiant_intensity(SQUARE, s, WAVELENGTH, **how), np.float64),
    ):
        assert function().dtype == double
        single = function(precision="single")
        assert single.dtype == np.float32
        assert single == pytest.approx(function(), rel=1e-4)


@pytest.mark.parametrize("phase", [1e-3, 1.0, 12.0, 90.0, 390.0, 410.0, 1700.0])
def test_directions_integrate_waves_of_every_lag_to_rounding(phase: float) -> None:
    """exp(i k xi.s) for |xi| up to the lag: J1(z)/z with the cosine, sin(z)/z without."""
    nodes = list(directions_and_weights(phase / (2 * math.pi), 1.0))
    for z in (phase, 0.83 * phase):
        along = np.array([math.cos(0.4), math.sin(0.4)])
        waves = [(np.exp(1j * z * (s[:, :2] @ along)), s[:, 2], w) for s, w in nodes]
        flux = sum((w * c) @ e for e, c, w in waves)
        radiance = sum(w @ e for e, _, w in waves)
        assert flux == pytest.approx(2 * math.pi * j1(z) / z, abs=2e-14)
        assert radiance == pytest.approx(2 * math.pi * math.sin(z) / z, abs=2e-14)


@pytest.mark.parametrize(("places", "is_shown"), [(1, False), (10**6, True)])
def test_what_takes_long_shows_on_a_terminal_how_far_it_is(
    places: int, is_shown: bool, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("COLUMNS", "200")
    count = sum(len(w) for _, w in directions_and_weights(10.0, 1.0, places))
    assert count > 1000
    told = capsys.readouterr().err
    assert (told != "") == is_shown
    assert not is_shown or ("directions" in told and f"{count}/{count}" in told)


def _power_by_lags(width: float, wavelength: float) -> float:
    """Of a square: int R(xi) J1(k |xi|)/(lambda |xi|) dxi, along rays of one octant."""
    k = 2 * math.pi / wavelength
    phi, over_phi = _gauss(0.0, math.pi / 4, 40)
    edges = np.linspace(0.0, 1.0, 40)[:, None] * width / np.cos(phi)
    rho, over_rho = _gauss(edges[:-1], edges[1:], 16)
    shared = (width - rho * np.cos(phi)[:, None]) * (width - rho * np.sin(phi)[:, None])
    inner = (shared * j1(k * rho) / wavelength * over_rho).sum(axis=(0, 2))
    return float(8 * inner @ over_phi)


@pytest.mark.parametrize("wavelengths", [0.1, 1.0, 3.1357, 20.0])
def test_power_of_a_square_equals_the_integral_over_lags(wavelengths: float) -> None:
    wavelength = 10e-3 / wavelengths
    found = pw.power(SQUARE, wavelength) / SQUARE.area
    assert found == pytest.approx(_power_by_lags(10e-3, wavelength) / SQUARE.area, abs=ROUTES)


def test_the_square_of_the_paper_keeps_6_62_percent_to_itself() -> None:
    """The share was found by adaptive quadrature over directions, independently of this code."""
    budget = pw.energy_budget(SQUARE, WAVELENGTH)
    assert budget.total == pytest.approx(SQUARE.area)
    assert budget.propagating_share == pytest.approx(0.9337740718695343, rel=1e-12)
    assert budget.evanescent_share == pytest.approx(0.0662, abs=5e-5)
    assert budget.propagating + budget.evanescent == pytest.approx(budget.total)


@sources
def test_what_leaves_the_plane_anywhere_is_the_power(source: Any) -> None:
    """int J_z dx = power, by the midpoint rule; J_z jumps at the outlines, in cells of 1 mm."""
    axis = np.arange(-17e-3, 19e-3, 1e-3) + 0.11e-3
    x = np.stack(np.meshgrid(axis, axis), axis=-1)
    wavelength = 3 * WAVELENGTH  # a ninth of the directions
    total = pw.flux_vector(source, x, wavelength)[..., 2].sum() * 1e-3**2
    budget = pw.energy_budget(source, wavelength)
    rule = 2e-2 * budget.total
    assert total == pytest.approx(budget.propagating, abs=rule)


def _flux_from_the_lag_slice(aperture: pw.Aperture, x: Any, kappa: Any) -> np.ndarray:
    """J of exp(2 pi i kappa.x) on an aperture: the far hemisphere's kernels over the lag slice.

    int s exp(-2 pi i nu.xi) dOmega/lambda^2 = J1(k rho)/(lambda rho) along z, and along the plane
    i/lambda grad sin(k rho)/(k rho).
    """
    triangles = shapely.get_parts(shapely.constrained_delaunay_triangles(pw.lag_slice(aperture, x)))
    corners = shapely.get_coordinates(triangles).reshape(-1, 4, 2)[:, :3]
    xi, weight = triangle_nodes(corners, 40)
    rho = np.hypot(*xi.T)
    z = K * rho
    slope = (np.cos(z) - np.sin(z) / z) / rho
    wave = np.exp(2j * np.pi * (xi @ np.asarray(kappa))) * weight
    along = 1j / WAVELENGTH * (wave * slope / rho) @ xi
    return np.array([*along.real, (wave @ (j1(z) / (WAVELENGTH * rho))).real])


@pytest.mark.parametrize("x", [(-3e-3, -3e-3), (0.5e-3, -2.2e-3), (0.2e-3, 0.3e-3)])
def test_flux_equals_the_integral_of_kernels_over_the_lag_slice(x: tuple[float, float]) -> None:
    plain = pw.flux_vector(ELL, x, WAVELENGTH)
    assert plain == pytest.approx(_flux_from_the_lag_slice(ELL, x, (0, 0)), abs=1e-10)
    steered = pw.flux_vector(STEERED, x, WAVELENGTH)
    expected = _flux_from_the_lag_slice(ELL, x, BEAM[:2] / WAVELENGTH)
    assert steered == pytest.approx(expected, abs=1e-10)


def test_flux_of_a_disc_at_its_centre_is_one_minus_a_bessel_function() -> None:
    """J_z = int J1(k rho) k d rho over the lag slice, a disc of twice the radius."""
    radius, n = 5e-3, 180
    found = pw.flux_vector(pw.shapes.disc(radius, n=n), (0, 0), WAVELENGTH)
    polygon = (2 * math.pi / n) ** 2  # the outline's deviation from the circle, times k radius
    assert found[2] == pytest.approx(1 - j0(2 * K * radius), abs=K * radius * polygon)


def test_the_flux_of_a_large_steered_aperture_is_that_of_its_plane_wave() -> None:
    """|u|^2 through the plane, along the beam: J = |u|^2 s/s_z, up to waves from the edges."""
    large = pw.shapes.square(60 * WAVELENGTH).with_illumination(pw.steering(BEAM, WAVELENGTH))
    flux = pw.flux_vector(large, (0, 0), WAVELENGTH)
    assert flux[2] == pytest.approx(1.0, abs=1e-2)
    assert flux[:2] == pytest.approx(BEAM[:2] / BEAM[2], abs=0.05)


def test_no_flux_along_the_plane_without_a_phase_and_none_outside_the_automean() -> None:
    x = [[1e-3, 2e-3], [3e-3, -4e-3], [30e-3, 0.0]]
    flux = pw.flux_vector(TAPERED, x, WAVELENGTH)
    assert np.abs(flux[:, :2]).max() < ACCURACY
    assert not flux[2].any()


def test_a_wave_beyond_grazing_stays_at_the_aperture() -> None:
    """A field of 1.5 cycles per wavelength is evanescent but for its edges."""
    field = pw.Illumination([1.0], [[1.5 / WAVELENGTH, 0.0]])
    large = pw.shapes.square(20 * WAVELENGTH).with_illumination(field)
    budget = pw.energy_budget(large, WAVELENGTH)
    assert budget.evanescent_share > 0.98


def test_the_evanescent_share_falls_in_proportion_to_the_wavelength() -> None:
    """It sits at the edges: perimeter times wavelength over area (ratio of doubling: 2)."""
    shares = [pw.energy_budget(ELL, 10e-3 / n).evanescent_share for n in (40, 80)]
    assert shares[0] / shares[1] == pytest.approx(2.0, rel=0.05)


def test_an_array_without_grating_lobes_radiates_its_fill_factor() -> None:
    """Of the orders of a lattice at half a wavelength only the zeroth propagates, and has that."""
    pitch, side, n = WAVELENGTH / 2, 0.3 * WAVELENGTH, 32
    array = pw.phased_array(pw.shapes.square(side), pw.arrays.grid_positions(n, n, pitch))
    share = pw.energy_budget(array, WAVELENGTH).propagating_share
    rim = 0.02  # perimeter times wavelength over area, as of any aperture
    assert share == pytest.approx((side / pitch) ** 2, rel=rim)


def test_a_dark_source_has_no_power_and_no_shares() -> None:
    budget = pw.energy_budget(pw.Array([SQUARE, SQUARE], [1, -1]), WAVELENGTH)
    assert budget.total == pytest.approx(0.0, abs=1e-18)
    assert budget.propagating == pytest.approx(0.0, abs=1e-18)


def test_flux_takes_positions_of_any_shape_in_bounded_blocks(monkeypatch: Any) -> None:
    from polywigner.radiometry import flux

    x = np.linspace(-6e-3, 6e-3, 24).reshape(3, 4, 2)
    whole = pw.flux_vector(SQUARE, x, WAVELENGTH)
    assert whole.shape == (3, 4, 3)
    monkeypatch.setattr(flux, "_BLOCK", 1)
    assert pw.flux_vector(SQUARE, x, WAVELENGTH) == pytest.approx(whole, abs=ACCURACY)
    assert pw.flux_vector(SQUARE, np.empty((0, 2)), WAVELENGTH).shape == (0, 3)


REFUSED: dict[str, tuple[Any, str]] = {
    "a direction behind": (lambda: pw.radiance(SQUARE, (0, 0), (0, 0, -1), 1.0), "z >= 0"),
    "a long direction": (lambda: pw.radiant_intensity(SQUARE, (0, 0, 2), 1.0), "length 1"),
    "no number": (lambda: pw.radiant_intensity(SQUARE, (math.nan, 0, 1), 1.0), "length 1"),
    "two components": (lambda: pw.radiant_intensity(SQUARE, (0, 1), 1.0), r"\(\.\.\., 3\)"),
    "a text": (lambda: pw.radiant_intensity(SQUARE, "up", 1.0), "unit vectors"),
    "three for x": (lambda: pw.flux_vector(SQUARE, (0, 0, 0), 1.0), r"\(\.\.\., 2\)"),
    "x infinite": (lambda: pw.flux_vector(SQUARE, (0, math.inf), 1.0), "finite"),
    "no wavelength": (lambda: pw.power(SQUARE, 0.0), "wavelength"),
    "a normalisation": (lambda: pw.radiance(SQUARE, (0, 0), (0, 0, 1), 1.0, "SI"), "paper"),
    "slits": (lambda: pw.power(pw.Slits([[0, 1]]), 1.0), "rectangles"),
    "an array of slits": (
        lambda: pw.power(pw.phased_array(pw.Slits([[0, 1]]), [0.0, 2.0]), 1.0),
        "rectangles",
    ),
    "a pose": (lambda: pw.power(SQUARE.placed(np.eye(4)), 1.0), "aperture"),
    "nothing": (lambda: pw.energy_budget(None, 1.0), "Aperture"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_radiates_to_nowhere_is_refused_in_words(name: str) -> None:
    call, words = REFUSED[name]
    with pytest.raises(ArgumentError, match=words) as caught:
        call()
    assert isinstance(caught.value, PolywignerError)
    assert "expected" in str(caught.value) and "got" in str(caught.value)


def test_elements_off_the_plane_are_refused() -> None:
    tilted = np.diag([1.0, -1.0, -1.0, 1.0])
    tilted[2, 3] = 1.0
    with pytest.raises(GeometryError, match="one plane"):
        pw.power(pw.Array([SQUARE, SQUARE.placed(tilted)]), WAVELENGTH)


@pytest.mark.drjit
def test_drjit_arrays_are_sent_to_the_transforms() -> None:
    import drjit.scalar

    with pytest.raises(ArgumentError, match=r"polywigner\.wigner"):
        pw.radiant_intensity(SQUARE, drjit.scalar.Array3f64(0, 0, 1), WAVELENGTH)


@pytest.mark.parametrize("wavelength", [1e-9, 1e-30])
def test_integrals_over_directions_of_too_many_wavelengths_are_refused(wavelength: float) -> None:
    with pytest.raises(ArgumentError, match="wavelengths across"):
        pw.power(SQUARE, wavelength)
    with pytest.raises(ArgumentError, match="wavelengths across"):
        pw.flux_vector(SQUARE, (0.0, 0.0), wavelength)
    with pytest.raises(ArgumentError, match="wavelengths across"):
        pw.radiation_pattern(SQUARE, wavelength, [0.0], [0.0])
