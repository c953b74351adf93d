"""Rays of curved and partly coherent sources: focus, fringes, cones and noise."""

import math
from typing import Any

import numpy as np
import pytest

import polywigner as pw
from polywigner.cli import main
from polywigner.errors import ArgumentError

pytest.importorskip("xarray")

WAVELENGTH = 3.2e-3
SQUARE = pw.shapes.square(10e-3)
CURVED = SQUARE.curved((-0.02, 0.03), WAVELENGTH, centre=(1e-3, 2e-3))
# Narrow pupils of light, whose rays are paraxial: tan and sin differ by 1e-5 of a spot.
LIGHT, FOCAL_LENGTH = 0.6e-6, 1.0
PUPIL = pw.shapes.regular_polygon(6, 2.5e-3)
LENS = PUPIL.curved(-FOCAL_LENGTH, LIGHT)

# Of Student's numbers: seeds are fixed, right code exceeds it with a chance of 1e-4 each.
UNLIKELY = 5.0
ROUNDING = 1e-12


def significance(sums, expected):
    """How many standard errors the mean of independent sums is from what it should be."""
    error = sums.std(ddof=1) / math.sqrt(len(sums))
    return float(abs(sums.mean() - expected) / error)


def sums_of(values, parts=32):
    """Estimates of the whole sum from parts of independent rays."""
    return parts * values.reshape(parts, -1).sum(axis=1)


def wave(x, y):
    return pw.Illumination([1.0], [(x, y)])


def test_a_converging_wave_has_its_focus_where_a_lens_has():
    """In the focal plane the irradiance is |F|^2/(lambda f)^2 of the flat source."""
    half = 300e-6
    rays = pw.sample_rays(LENS, LIGHT, 1 << 15, cone=4e-3)
    found = pw.rays.rebuild(rays, FOCAL_LENGTH, (-half, -half, half, half), (5, 5))
    t, w = np.polynomial.legendre.leggauss(5)
    x = (half / 5 * (2 * np.arange(-2, 3)[:, None] + t)).ravel()
    nu = np.stack(np.meshgrid(x, x, indexing="ij"), axis=-1) / (LIGHT * FOCAL_LENGTH)
    exact = np.abs(pw.fourier(PUPIL, nu)) ** 2 / (LIGHT * FOCAL_LENGTH) ** 2
    mean = np.einsum("iajb,a,b->ji", exact.reshape(5, 5, 5, 5), w / 2, w / 2)
    error = found.standard_error.values
    assert (abs(found.irradiance.values - mean) / error).max() < UNLIKELY
    assert error.max() < 0.04 * mean.max()


@pytest.mark.parametrize("width", [1.5e-3, 3e-3, math.inf])
def test_fringes_of_two_slits_have_the_visibility_of_the_degree_of_coherence(width):
    """In directions that a slit alone lights evenly they are 1 + |mu| cos(2 pi d nu)."""
    distance = 3e-3
    across = distance / 20  # uneven by a hundredth at the rim of the cone
    slits = pw.shapes.double_slit(across, across, (-distance / 2, distance / 2))
    light = slits.partially_coherent(width)
    cone = LIGHT / distance
    rays = pw.sample_rays(light, LIGHT, 1 << 14, cone=cone, directions="uniform")
    fringe = np.cos(2 * math.pi * distance * rays.direction.values[:, 0] / LIGHT)
    # the visibility from the sums with 1 and with the fringe, whose means over a disc are these
    x, y = np.meshgrid(*2 * [np.linspace(-1, 1, 401)])
    inside = np.cos(2 * math.pi * x[x**2 + y**2 < 1])
    first, second = inside.mean(), (inside**2).mean()
    visibility = math.exp(-((distance / width) ** 2) / 2)
    share = (first + visibility * second) / (1 + visibility * first)
    excess = rays.weight.values * (fringe - share)
    assert significance(sums_of(excess), 0.0) < UNLIKELY
    error = sums_of(excess).std() / math.sqrt(32) / (second * rays.weight.values.sum())
    assert error < 0.05


@pytest.mark.parametrize(
    "source", [CURVED, CURVED.partially_coherent(8e-3)], ids=["curved", "partly coherent"]
)
def test_the_power_in_a_narrow_cone_is_that_of_the_radiant_intensity(source):
    """Many places have their beam outside of the cone."""
    axis, half = np.array([0.3, 0.2, math.sqrt(0.87)]), 0.1
    rays = pw.sample_rays(source, WAVELENGTH, 1 << 17, cone=half, axis=axis)
    assert (rays.direction.values @ axis).min() > math.cos(half) - ROUNDING
    t, w = np.polynomial.legendre.leggauss(4)
    theta, phi = half * (t + 1) / 2, np.arange(12) * math.pi / 6
    across = np.cross(axis, [0.0, 1.0, 0.0])
    across /= np.linalg.norm(across)
    around = np.cos(phi)[:, None] * across + np.sin(phi)[:, None] * np.cross(axis, across)
    s = np.cos(theta)[:, None, None] * axis + np.sin(theta)[:, None, None] * around
    # of Rayleigh-Sommerfeld I: a cosine more than the paper's
    intensity = (s[..., 2] * pw.radiant_intensity(source, s, WAVELENGTH)).mean(axis=1)
    power = math.pi * half * float(w @ (intensity * np.sin(theta)))
    sums = sums_of(rays.weight.values)
    assert significance(sums, power) < UNLIKELY
    assert sums.std() / math.sqrt(32) < 0.06 * power


@pytest.mark.parametrize("source", [LENS, PUPIL.partially_coherent(0.2e-3)], ids=["lens", "lamp"])
def test_directions_follow_the_wave_so_that_noise_is_that_of_the_flat_source(source):
    flat, found = (
        pw.sample_rays(s, LIGHT, 1 << 15, cone=0.02).weight.values for s in (PUPIL, source)
    )
    assert np.linalg.norm(found) < 1.2 * np.linalg.norm(flat)


def test_a_wave_that_is_flat_and_coherent_has_the_rays_of_its_source():
    for wave in (SQUARE.curved(math.inf, WAVELENGTH), SQUARE.partially_coherent(math.inf)):
        found = pw.sample_rays(wave, WAVELENGTH, 512, cone=0.7)
        expected = pw.sample_rays(SQUARE, WAVELENGTH, 512, cone=0.7)
        for name in ("position", "direction", "weight"):
            scale = float(abs(expected[name]).max())
            assert found[name].values == pytest.approx(expected[name].values, abs=1e-12 * scale)


@pytest.mark.parametrize("obliquity", ["rayleigh-sommerfeld-1", "paper"])
def test_a_watt_of_the_aperture_is_that_of_the_flat_source_a_radiated_one_is_not(obliquity):
    for source in (CURVED, SQUARE.partially_coherent(4e-3)):
        how: Any = {"count": 64, "obliquity": obliquity}
        rays = pw.sample_rays(source, WAVELENGTH, **how)
        for count, own in (
            ("aperture_power", SQUARE.area),
            ("power", pw.radiated_power(source, WAVELENGTH, obliquity)),
        ):
            watt = pw.sample_rays(source, WAVELENGTH, **how, **{count: 1.0})
            assert watt.weight.values == pytest.approx(rays.weight.values / own, rel=ROUNDING)


@pytest.mark.parametrize("source", [CURVED, SQUARE.partially_coherent(4e-3)])
def test_obliquities_that_differ_from_wave_to_wave_are_refused(source):
    for name in ("kirchhoff", "rayleigh-sommerfeld-2"):
        with pytest.raises(ArgumentError, match="curved wave or partly coherent"):
            pw.sample_rays(source, WAVELENGTH, 64, obliquity=name)
    plain, paper = (
        pw.sample_rays(source, WAVELENGTH, 64, obliquity=name) for name in (None, "paper")
    )
    expected = plain.weight.values / plain.direction.values[:, 2]
    assert paper.weight.values == pytest.approx(expected, rel=ROUNDING)


def test_the_command_has_curved_and_partly_coherent_waves(tmp_path):
    outline = tmp_path / "square.wkt"
    outline.write_text("POLYGON ((-5 -5, 5 -5, 5 5, -5 5, -5 -5))")
    words = ["rays", str(outline), "--wavelength", "3.2 mm", "--count", "64"]
    words += ["--curved", "60 mm, inf", "--coherence", "4 mm", "--out", str(tmp_path / "some.npz")]
    assert main(words) == 0
    source = pw.read_aperture(outline).curved((0.06, math.inf), WAVELENGTH)
    expected = pw.sample_rays(source.partially_coherent(4e-3), WAVELENGTH, 64)
    assert pw.rays.load(tmp_path / "some.npz").equals(expected)
