"""Radiance, flux and power against closed forms and integrals over directions."""

from __future__ import annotations

import math
from itertools import product
from typing import Any

import numpy as np
import pytest
import shapely
from scipy.special import j1

import polywigner as pw
from oracles.quadrature import triangle_nodes
from polywigner.errors import ArgumentError, GeometryError
from polywigner.radiometry.directions import longest_path

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

# Errors that the documentation states, relative to int |u|^2 over lambda^2 and to int |u|^2.
ACCURACY = 1e-12
# Rounding error of Gauss-Legendre sums over panels of a few wavelengths, in another order.
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
    result = pw.radiance(SQUARE, (0.0, 0.0), direction, WAVELENGTH)
    assert result == pytest.approx(closed / WAVELENGTH**2, abs=1e-4 * ACCURACY / WAVELENGTH**2)


def test_a_source_much_smaller_than_the_wavelength_is_lambertian() -> None:
    """F is constant, so the radiant intensity is proportional to the cosine."""
    speck = pw.shapes.triangle(1e-6, 2e-6)
    for theta in (0.0, 0.7, 1.5):
        intensity = pw.radiant_intensity(speck, _direction(theta), WAVELENGTH)
        expected = math.cos(theta) * (speck.area / WAVELENGTH) ** 2
        # (k D)^2 of the source is 2e-5.
        assert intensity == pytest.approx(expected, rel=1e-6, abs=0.0)
    solid = math.pi * (speck.area / WAVELENGTH) ** 2
    assert pw.power(speck, WAVELENGTH) == pytest.approx(solid, rel=1e-5, abs=0.0)


def test_single_precision_stays_single() -> None:
    s = _direction(0.4)[None].repeat(3, axis=0)
    for call in (
        lambda **how: pw.radiance(SQUARE, (0, 0), s, WAVELENGTH, **how),
        lambda **how: pw.radiant_intensity(SQUARE, s, WAVELENGTH, **how),
    ):
        single = call(precision="single")
        assert (single.dtype, call().dtype) == (np.float32, np.float64)
        assert single == pytest.approx(call(), rel=1e-4)


def _power_by_lags(width: float, wavelength: float) -> float:
    """Integrate R(xi) J1(k |xi|)/(lambda |xi|) over xi for a square, along rays of an octant."""
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
    result = pw.power(SQUARE, wavelength) / SQUARE.area
    assert result == pytest.approx(_power_by_lags(10e-3, wavelength) / SQUARE.area, abs=ROUTES)


@sources
def test_what_leaves_the_plane_anywhere_is_the_power(source: Any) -> None:
    """The integral of J_z is the power. The sum over 1 mm cells has errors at jumps of J_z."""
    axis = np.arange(-17e-3, 19e-3, 1e-3) + 0.11e-3
    x = np.stack(np.meshgrid(axis, axis), axis=-1)
    wavelength = 3 * WAVELENGTH  # a ninth of the directions
    total = pw.flux_vector(source, x, wavelength)[..., 2].sum() * 1e-3**2
    budget = pw.energy_budget(source, wavelength)
    rule = 2e-2 * budget.total
    assert total == pytest.approx(budget.propagating, abs=rule)


def _flux_from_the_lag_slice(aperture: pw.Aperture, x: Any, kappa: Any) -> np.ndarray:
    """Return J of exp(2 pi i kappa.x) on an aperture, from kernels over the lag slice.

    The kernel int s exp(-2 pi i nu.xi) dOmega/lambda^2 is J1(k rho)/(lambda rho) along z, and
    i/lambda grad sin(k rho)/(k rho) along the plane.
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


def test_no_flux_along_the_plane_without_a_phase_and_none_outside_the_automean() -> None:
    x = [[1e-3, 2e-3], [3e-3, -4e-3], [30e-3, 0.0]]
    flux = pw.flux_vector(TAPERED, x, WAVELENGTH)
    assert np.abs(flux[:, :2]).max() < ACCURACY
    assert not flux[2].any()


def test_a_wave_beyond_grazing_stays_at_the_aperture() -> None:
    """A field of 1.5 cycles per wavelength is evanescent except at its edges."""
    field = pw.Illumination([1.0], [[1.5 / WAVELENGTH, 0.0]])
    large = pw.shapes.square(20 * WAVELENGTH).with_illumination(field)
    budget = pw.energy_budget(large, WAVELENGTH)
    assert budget.evanescent_fraction > 0.98


def test_a_dark_source_has_no_power_and_no_shares() -> None:
    budget = pw.energy_budget(pw.Array([SQUARE, SQUARE], [1, -1]), WAVELENGTH)
    assert max(abs(budget.total), abs(budget.propagating)) < 1e-18


REFUSED: dict[str, tuple[Any, str]] = {
    "a direction behind": (lambda: pw.radiance(SQUARE, (0, 0), (0, 0, -1), 1.0), "z >= 0"),
    "a long direction": (lambda: pw.radiant_intensity(SQUARE, (0, 0, 2), 1.0), "of length 2"),
    "two components": (lambda: pw.radiant_intensity(SQUARE, (0, 1), 1.0), r"\(\.\.\., 3\)"),
    "three for x": (lambda: pw.flux_vector(SQUARE, (0, 0, 0), 1.0), r"\(\.\.\., 2\)"),
    "no wavelength": (lambda: pw.power(SQUARE, 0.0), "wavelength"),
    "slits": (lambda: pw.power(pw.Slits([[0, 1]]), 1.0), "rectangles"),
    "a pose": (lambda: pw.power(SQUARE.placed(np.eye(4)), 1.0), "aperture"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_radiates_to_nowhere_is_refused_in_words(name: str) -> None:
    call, words = REFUSED[name]
    with pytest.raises(ArgumentError, match=f"expected.*({words}.*got|got.*{words})"):
        call()


def test_elements_off_the_plane_are_refused() -> None:
    tilted = np.diag([1.0, -1.0, -1.0, 1.0])
    tilted[2, 3] = 1.0
    with pytest.raises(GeometryError, match="in the plane z = 0"):
        pw.power(pw.Array([SQUARE, SQUARE.placed(tilted)]), WAVELENGTH)


@pytest.mark.drjit
def test_drjit_arrays_are_sent_to_the_transforms() -> None:
    import drjit.scalar

    with pytest.raises(ArgumentError, match="to be made of NumPy arrays"):
        pw.radiant_intensity(SQUARE, drjit.scalar.Array3f64(0, 0, 1), WAVELENGTH)


@pytest.mark.parametrize("wavelength", [1e-9, 1e-30])
def test_integrals_over_directions_of_too_many_wavelengths_are_refused(wavelength: float) -> None:
    slanted = SQUARE.with_illumination(pw.steering((0.9, 0.0, math.sqrt(0.19)), wavelength))
    for call in (
        lambda: pw.power(slanted, wavelength),
        lambda: pw.flux_vector(SQUARE, (0.0, 0.0), wavelength),
        lambda: pw.radiation_pattern(SQUARE, wavelength, [0.0], [0.0]),
    ):
        with pytest.raises(ArgumentError, match="wavelengths across a source"):
            call()


WIDE = pw.Aperture(np.array([[0, 0], [3.0, 0.2], [0.8, 2.4]]) * 1e-3)
EDGES = {
    "rayleigh-sommerfeld-1": 1 / (4 * math.pi),
    "kirchhoff": (0.5 + math.pi / 8) / (2 * math.pi**2),
    "rayleigh-sommerfeld-2": 0.0,
    "paper": 1 / (2 * math.pi**2),
}


@pytest.mark.parametrize("scale", [1, 100])
@pytest.mark.parametrize("obliquity", EDGES)
def test_wide_sources_lose_what_their_edges_keep(obliquity: Any, scale: int) -> None:
    source, wavelength = WIDE.scaled(scale), 550e-9
    lost = source.area - pw.radiated_power(source, wavelength, obliquity)
    edges = source.polygons.length * wavelength
    assert lost == pytest.approx(EDGES[obliquity] * edges, abs=1e-5 * edges)
    if obliquity == "paper":
        assert pw.energy_budget(source, wavelength).evanescent == pytest.approx(lost, rel=1e-9)


@pytest.mark.slow
def test_rays_of_a_wide_curved_wave_carry_its_power_but_for_its_edges() -> None:
    places, weights = triangle_nodes(WIDE.rings[0][None], 20)
    cosines = np.sqrt(1 - np.square(places / 5e-3).sum(axis=1))
    shares = []
    for wavelength in (1100e-9, 550e-9):
        power = pw.radiated_power(WIDE.curved(5e-3, wavelength), wavelength)
        shares.append((cosines @ weights - power) / (WIDE.polygons.length * wavelength))
    assert shares[0] == pytest.approx(EDGES["rayleigh-sommerfeld-1"], rel=0.1)
    assert shares[1] == pytest.approx(shares[0], rel=2e-3)


def test_paths_of_a_curved_wave_differ_by_its_sag_as_well() -> None:
    curved, off_centre = SQUARE.curved(0.2, WAVELENGTH), SQUARE.curved(0.2, WAVELENGTH, (5e-3, 0.0))
    assert longest_path(SQUARE) == pytest.approx(math.hypot(10e-3, 10e-3))
    assert longest_path(curved) == pytest.approx(longest_path(SQUARE) + 50e-6 / 0.4)
    assert longest_path(off_centre) == pytest.approx(longest_path(SQUARE) + 125e-6 / 0.4)


def test_elements_that_touch_radiate_as_one() -> None:
    half = pw.shapes.rectangle(0.4, 0.8).moved((0.2, 0.0))
    pair = pw.Array([half, half.moved((-0.4, 0.0))])
    whole = pw.power(pw.shapes.square(0.8), 1e-3)
    assert pw.power(pair, 1e-3) == pytest.approx(whole, rel=1e-10)
    # In opposite phases, the common edge counts twice.
    opposite = pw.Array(pair.elements, [1.0, -1.0])
    assert whole - pw.power(opposite, 1e-3) == pytest.approx(
        4 * 0.8e-3 / (2 * math.pi**2), rel=1e-3
    )


def test_power_of_partly_coherent_wide_light_is_the_mean_over_tilts() -> None:
    wavelength, width = 1e-3, 20e-3
    square = pw.shapes.square(0.8)
    node, weight = np.polynomial.hermite_e.hermegauss(5)
    tilts = node / (2 * math.pi * width) * wavelength
    mean = 0.0
    for (x, a), (y, b) in product(zip(tilts, weight / weight.sum(), strict=True), repeat=2):
        tilt = pw.steering((x, y, math.sqrt(1 - x * x - y * y)), wavelength)
        mean += a * b * pw.power(square.with_illumination(tilt), wavelength)
    result = pw.power(square.partially_coherent(width), wavelength)
    assert result == pytest.approx(mean, rel=1e-8)
