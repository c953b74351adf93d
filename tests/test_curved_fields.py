"""Curved waves in radiometry, fields, links and files, and horns against the textbook."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import mpmath
import numpy as np
import pytest

import polywigner as pw
from polywigner.errors import ArgumentError, FileFormatError, QuantityError
from polywigner.illumination.texts import fed

WAVELENGTH = 3.2e-3
MOUTH = pw.shapes.rectangle(16e-3, 12e-3).with_illumination(pw.te_mode(16e-3, 12e-3))
ELL = pw.Aperture(1e-3 * np.array([(0, 0), (12, 0), (12, 4), (4, 4), (4, 12), (0, 12)]) - 6e-3)
HORN = MOUTH.curved((20e-3, 30e-3), WAVELENGTH)
POINTS = np.array([(0, 0, 30e-3), (5e-3, -8e-3, 20e-3), (1e-3, 2e-3, 1e-3), (30e-3, 0, 10e-3)])
METHODS = ["rayleigh-sommerfeld-1", "rayleigh-sommerfeld-2", "kirchhoff", "fresnel", "fraunhofer"]

# Of the incident amplitude: the boundary integrals that flat waves are compared with.
BOUNDARY = 3e-11
# Of the field on the axis, by Gauss's rules and closed forms.
CLOSED = 1e-12
# The directivities of textbooks are closed forms as well.
TEXTBOOK = 1e-12


@pytest.mark.parametrize("method", METHODS)
def test_a_wave_of_no_curvature_has_the_field_of_the_flat_source(method: Any) -> None:
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
def test_far_away_every_field_of_a_horn_is_its_far_field(method: Any) -> None:
    point = (100.0, 200.0, 1e5)
    found = pw.amplitude(HORN, point, WAVELENGTH, method)
    far = pw.amplitude(HORN, point, WAVELENGTH, "fraunhofer")
    if method == "rayleigh-sommerfeld-1":  # Fresnel's distance is another one
        assert found == pytest.approx(far, rel=1e-6, abs=0.0)
    # the slopes of Kirchhoff's waves are not along the axis
    share = {"kirchhoff": 3e-2, "fresnel": 1e-5}.get(method, 1e-6)
    assert abs(found) == pytest.approx(abs(far), rel=share, abs=0.0)


def test_the_field_of_a_horn_on_its_axis_is_an_integral_over_its_mouth() -> None:
    z, k = 12e-3, 2 * np.pi / WAVELENGTH
    node, weight = np.polynomial.legendre.leggauss(120)
    x, y = 8e-3 * node[:, None], 6e-3 * node
    u = np.cos(np.pi * x / 16e-3) * np.exp(
        1j * np.pi / WAVELENGTH * (x * x / 20e-3 + y * y / 30e-3)
    )
    r = np.sqrt(x * x + y * y + z * z)
    kernel = z / r * (1 / r - 1j * k) * np.exp(1j * k * r) / (2 * np.pi * r)
    expected = 8e-3 * 6e-3 * (weight @ (u * kernel) @ weight)
    found, error = pw.amplitude(HORN, (0, 0, z), WAVELENGTH, return_error=True)
    assert abs(found - expected) < CLOSED
    assert 0 < error < CLOSED


def test_a_curved_wave_is_a_lens_before_free_space() -> None:
    z = 40e-3
    places = POINTS[:, :2]
    points = np.column_stack([places, np.full(len(places), z)])
    centred, away = HORN, MOUTH.curved((20e-3, 30e-3), WAVELENGTH, (1e-3, -2e-3))
    lens, space = pw.FirstOrder.lens((-20e-3, -30e-3)), pw.FirstOrder.free_space(z)
    behind = pw.amplitude(MOUTH, places, WAVELENGTH, through=space @ lens)
    found = pw.amplitude(centred, places, WAVELENGTH, through=space)
    assert np.abs(found - behind).max() < CLOSED
    for wave in (centred, away):
        found = pw.amplitude(wave, places, WAVELENGTH, through=space)
        fresnel = pw.amplitude(wave, points, WAVELENGTH, "fresnel")
        ratio = fresnel / found  # but for the phase of the way along the axis
        assert np.abs(ratio - ratio[0]).max() < 1e-9  # the default tolerance


@pytest.mark.parametrize(("order", "decibels"), [(1, 0.01), (3, 1e-5)])
def test_wigner_rays_of_a_horn_add_up_to_its_irradiance(order: int, decibels: float) -> None:
    points = np.array([(0, 0, 0.12), (20e-3, 10e-3, 0.15)])
    exact = pw.irradiance(HORN, points, WAVELENGTH, "auto")
    rays = pw.irradiance(HORN, points, WAVELENGTH, order=order, tolerance=1e-6)
    assert np.abs(10 * np.log10(rays / exact)).max() < decibels


def test_the_third_order_falls_with_the_fourth_power_of_the_distance() -> None:
    horn = pw.shapes.rectangle(12e-3, 9e-3).curved((25e-3, -40e-3), WAVELENGTH)
    errors = []
    for z in (0.06, 0.12):
        point = (0.2 * z, 0.1 * z, z)
        exact = pw.irradiance(horn, point, WAVELENGTH, "auto")
        rays = pw.irradiance(horn, point, WAVELENGTH, order=3, tolerance=1e-9)
        errors.append(abs(rays / exact - 1))
    assert errors[0] > 11 * errors[1]  # 16 in the limit


def test_power_is_that_of_the_spectrum_in_front() -> None:
    budget = pw.energy_budget(HORN, WAVELENGTH)
    assert budget.total == pytest.approx(16e-3 * 12e-3 / 2, rel=1e-12)
    assert 0.9 < budget.propagating_share < 1.0
    axis = pw.radiant_intensity(HORN, (0, 0, 1), WAVELENGTH)
    expected = abs(pw.fourier(HORN, (0, 0))) ** 2 / WAVELENGTH**2
    assert axis == pytest.approx(expected, rel=1e-12)
    radiance = pw.radiance(HORN, (1e-3, 0), (0.1, 0, np.sqrt(0.99)), WAVELENGTH)
    flat = pw.wigner(MOUTH, (1e-3, 0), (0.1 / WAVELENGTH - 1e-3 / (20e-3 * WAVELENGTH), 0))
    assert radiance == pytest.approx(flat / WAVELENGTH**2, rel=1e-12)
    flux = pw.flux_vector(HORN, (2e-3, 0.0), WAVELENGTH)
    assert flux[0] > 0.05 * flux[2] > 0  # it diverges


def test_a_pattern_is_that_of_the_spectrum() -> None:
    theta = np.radians([-30.0, 0.0, 20.0])
    pattern = pw.radiation_pattern(HORN, WAVELENGTH, theta, [0.0, np.pi / 2])
    nu = np.stack([np.sin(theta), np.zeros(3)], axis=-1) / WAVELENGTH
    expected = np.cos(theta) * pw.fourier(HORN, nu) / (1j * WAVELENGTH)
    assert np.abs(pattern["field"].values[:, 0] - expected).max() < CLOSED
    assert pw.read_source(pattern) == HORN
    with pytest.raises(ArgumentError, match="obliquity"):
        pw.radiation_pattern(HORN, WAVELENGTH, theta, 0.0, obliquity="kirchhoff")


def test_links_of_horns_are_reciprocal_and_those_of_their_patterns_far_away() -> None:
    facing = np.diag([-1.0, 1.0, -1.0, 1.0])
    facing[2, 3] = 0.1
    there = pw.coupling(HORN, MOUTH, facing, WAVELENGTH, tolerance=1e-9)
    back = pw.coupling(MOUTH, HORN, facing, WAVELENGTH, tolerance=1e-9)
    assert abs(there - back) < CLOSED
    facing[2, 3] = 100.0
    near = pw.coupling(HORN, HORN, facing, WAVELENGTH)
    far = pw.coupling(HORN, HORN, facing, WAVELENGTH, "fraunhofer")
    assert abs(near / far - 1) < 1e-3
    with pytest.raises(ArgumentError, match="flat wave"):
        pw.coupling(HORN, HORN, facing, WAVELENGTH, "wigner")


def fresnel(t: float) -> complex:
    return complex(mpmath.fresnelc(t) + 1j * mpmath.fresnels(t))


def textbook_e(width: float, height: float, radius: float) -> float:
    """Balanis, (13-19); lengths in wavelengths."""
    size = abs(fresnel(height / np.sqrt(2 * radius))) ** 2
    return 64 * width * radius / (np.pi * height) * size


def textbook_h(width: float, height: float, radius: float) -> float:
    """Balanis, (13-41)."""
    root = np.sqrt(radius)
    u, v = (root / width + s * width / root for s in (1, -1))
    size = abs(fresnel(u / np.sqrt(2)) - fresnel(v / np.sqrt(2))) ** 2
    return 4 * np.pi * height * radius / width * size


# Phase errors at the edge, height^2/(8 radius), in wavelengths.
PHASE_ERRORS = [1 / 64, 1 / 8, 1 / 4, 3 / 8, 1.0]


@pytest.mark.parametrize("s", PHASE_ERRORS)
def test_directivities_are_those_of_the_textbook(s: float) -> None:
    a1, b1 = 5.5, 2.75
    e, h = b1**2 / (8 * s), a1**2 / (8 * s)
    e_plane, h_plane = pw.horns.e_plane(0.5, b1, e, 1.0), pw.horns.h_plane(a1, 0.25, h, 1.0)
    found_e, found_h = (pw.horns.directivity(horn, 1.0) for horn in (e_plane, h_plane))
    assert found_e == pytest.approx(textbook_e(0.5, b1, e), rel=TEXTBOOK)
    assert found_h == pytest.approx(textbook_h(a1, 0.25, h), rel=TEXTBOOK)
    both = pw.horns.directivity(pw.horns.pyramidal(a1, b1, h, e, 1.0), 1.0)
    assert both == pytest.approx(np.pi / (32 * 0.5 * 0.25) * found_e * found_h, rel=TEXTBOOK)


@pytest.mark.parametrize("s", PHASE_ERRORS)
def test_universal_curves_are_those_of_the_textbook(s: float) -> None:
    """F over that of a horn without a phase error, along b1 sin(theta) and a1 sin(theta)."""
    a1, b1 = 5.5, 2.75
    sines = np.linspace(0, 0.9, 7)
    horn = pw.horns.pyramidal(a1, b1, a1**2 / (8 * s), b1**2 / (8 * s), 1.0)
    none = np.zeros_like(sines)
    axis = 2 * a1 / np.pi * b1
    along_e = pw.fourier(horn, np.stack([none, sines], axis=-1)) / axis
    along_h = pw.fourier(horn, np.stack([sines, none], axis=-1)) / axis

    def chirp(width: float, nu: float) -> complex:
        """The integral of exp(i pi x^2/radius - 2 pi i nu x), by Fresnel's integrals."""
        radius = width**2 / (8 * s)
        ends = [np.sqrt(2 / radius) * (edge - nu * radius) for edge in (-width / 2, width / 2)]
        found = (fresnel(ends[1]) - fresnel(ends[0])) * np.sqrt(radius / 2)
        return complex(found * np.exp(-1j * np.pi * nu * nu * radius))

    def cosine(nu: float) -> complex:
        return (chirp(a1, nu - 0.5 / a1) + chirp(a1, nu + 0.5 / a1)) / 2

    e = np.array([chirp(b1, nu) for nu in sines]) * cosine(0.0) / axis
    h = np.array([cosine(nu) for nu in sines]) * chirp(b1, 0.0) / axis
    assert np.abs(along_e - e).max() < TEXTBOOK
    assert np.abs(along_h - h).max() < TEXTBOOK


def best_width(of: Any) -> float:
    """The width in sqrt(2 wavelength radius) with the largest directivity, by golden sections."""
    low, high, share = 0.8, 1.6, (np.sqrt(5) - 1) / 2
    while high - low > 1e-6:
        first, second = high - share * (high - low), low + share * (high - low)
        low, high = (low, second) if of(first) > of(second) else (first, high)
    return (low + high) / 2


def test_optimum_horns_are_the_published_ones() -> None:
    """The optimum phase parameters of S. J. Orfanidis, "Electromagnetic Waves and Antennas" (2016),
    chapter 21, 1.2593 and 1.0246 (1.02455 to one digit more), and the horn of Balanis, example
    13.6, designed for 22.6 dB by 51 % aperture efficiency."""
    radius = 30.0
    unit = np.sqrt(2 * radius)

    def h(share: float) -> float:
        return pw.horns.directivity(pw.horns.h_plane(share * unit, 0.5, radius, 1.0), 1.0)

    def e(share: float) -> float:
        return pw.horns.directivity(pw.horns.e_plane(0.5, share * unit, radius, 1.0), 1.0)

    assert round(best_width(h), 4) == 1.2593
    assert best_width(e) == pytest.approx(1.0246, abs=6e-5)
    centimetres = 16.370, 12.859, 32.753, 30.316
    a1, b1, rho_h, rho_e = (0.01 * length for length in centimetres)
    wavelength = 0.3 / 11
    horn = pw.horns.pyramidal(a1, b1, rho_h, rho_e, wavelength)
    ratio = pw.horns.directivity(horn, wavelength)
    assert round(10 * np.log10(ratio), 1) == 22.6
    assert round(ratio * wavelength**2 / (4 * np.pi * a1 * b1), 2) == 0.51


def test_horns_that_are_none_are_refused() -> None:
    with pytest.raises(ArgumentError, match="radius_y of a horn"):
        pw.horns.e_plane(1.0, 2.0, -3.0, 1.0)
    with pytest.raises(ArgumentError, match="radius_x of a horn"):
        pw.horns.h_plane(1.0, 2.0, "far", 1.0)  # type: ignore[arg-type]


@pytest.mark.parametrize("suffix", ["toml", "json"])
def test_source_files_keep_curved_waves(tmp_path: Path, suffix: str) -> None:
    for wave in (HORN.turned(0.1), pw.Slits([(0, 1e-3)]).curved(0.02, WAVELENGTH, [1e-4])):
        pw.write_source(wave, tmp_path / f"wave.{suffix}")
        assert pw.read_source(tmp_path / f"wave.{suffix}") == wave


HEAD = 'frequency = "94 GHz"\nkind = "aperture"\nshape = {name = "square", a = "10 mm"}\n'


def test_source_files_are_written_by_hand(tmp_path: Path) -> None:
    path = tmp_path / "horn.toml"
    path.write_text(HEAD + '[wavefront]\nradius = ["60 mm", "inf"]\ncentre = ["1 mm", 0]\n')
    wavelength = pw.SPEED_OF_LIGHT / 94e9
    square = pw.shapes.square(10e-3)
    assert pw.read_source(path) == square.curved((60e-3, np.inf), wavelength, (1e-3, 0))
    path.write_text(HEAD + '[wavefront]\nradius = "60 mm"\ncurvature = [[1, 0], [0, 1]]\n')
    with pytest.raises(FileFormatError, match="radius or curvature"):
        pw.read_source(path)


def test_a_text_gives_a_source_its_curved_wave() -> None:
    source = pw.shapes.square(10e-3).moved((1e-3, 0.0))
    expected = source.curved((60e-3, np.inf), WAVELENGTH, (1e-3, 0.0))
    assert fed(source, {"curved": "60 mm, inf"}, WAVELENGTH) == expected
    with pytest.raises(QuantityError, match="curved: expected a radius"):
        fed(source, {"curved": "1 mm, 2 mm, 3 mm"}, WAVELENGTH)


@pytest.mark.slow
def test_the_command_line_gives_a_horn_its_curved_wave(tmp_path: Path) -> None:
    from typer.testing import CliRunner

    from polywigner.cli.app import app

    pw.write_source(MOUTH, tmp_path / "mouth.toml")
    wanted = ["transform", str(tmp_path / "mouth.toml"), "--wavelength", "3.2 mm", "--samples", "9"]
    out = ["--out", str(tmp_path / "horn")]
    found = CliRunner().invoke(app, [*wanted, "--curved", "20 mm, 30 mm", *out])
    assert not found.exit_code, found.output
    values = np.load(tmp_path / "horn.npz")
    nu = np.stack(np.meshgrid(values["frequency"], values["frequency"]), axis=-1)
    assert np.abs(values["fourier"] - pw.fourier(HORN, nu)).max() < CLOSED
    assert np.abs(values["wigner"] - pw.wigner(HORN, values["x"], nu)).max() < CLOSED
