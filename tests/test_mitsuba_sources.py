"""Tapered, steered and arrayed sources in scenes."""

import numpy as np
import pytest
import shapely

import polywigner as pw
from mitsuba_scenes import (
    CHEVRON,
    MILLIMETRE,
    RADIANCE_ERROR,
    VARIANTS,
    WAVELENGTH,
    draws,
    emitter_of,
    evaluated,
    light,
    use,
)
from polywigner.mitsuba.plugins.mixtures import Mixture
from polywigner.mitsuba.plugins.wigner import DrawnWaves

pytestmark = pytest.mark.drjit

BEAM = np.array([np.sin(np.radians(20)), 0.0, np.cos(np.radians(20))])
PATCH = pw.shapes.rectangle(1.2e-3, 1.0e-3)
PLACES = pw.arrays.grid_positions(5, 4, 1.9e-3)
HORN = pw.shapes.rectangle(10e-3, 8e-3).with_illumination(pw.te_mode(10e-3, 8e-3))


def lattice(nx, ny, at=0.0):
    """Return patches at 1.9 mm with Taylor weights, steered to 20 degrees."""
    places = pw.arrays.grid_positions(nx, ny, 1.9e-3)
    weights = pw.arrays.window_weights((nx, ny), "taylor", sll=25)
    weights = weights * pw.arrays.steering_weights(places, BEAM, WAVELENGTH)
    return pw.phased_array(PATCH, places + at, weights)


def any_elements():
    """Return different elements, including a rotated element and an element with a taper."""
    turned = pw.shapes.triangle(3e-3, 2e-3).placed(
        [[0.6, -0.8, 0, 3e-3], [0.8, 0.6, 0, 1e-3], [0, 0, 1, 0], [0, 0, 0, 1]]
    )
    tapered = pw.shapes.square(2e-3).with_illumination(pw.cosine_taper(2e-3)).moved([-2e-3, 0])
    return pw.Array([turned, tapered, pw.shapes.square(1e-3).moved([0, -3e-3])], [1, 1j, -0.5])


SOURCES = {
    "TE10": HORN,
    "tapered and steered": pw.shapes.rectangle(10e-3, 4e-3).with_illumination(
        pw.taylor_taper(10e-3) * pw.steering(BEAM, WAVELENGTH)
    ),
    "lattice": lattice(12, 16),
    "lattice of 1024 half a metre away": lattice(32, 32, at=0.5),
    "focused": pw.phased_array(
        PATCH, PLACES, pw.arrays.focusing_weights(PLACES, (0, 0, 0.02), WAVELENGTH)
    ),
    "any elements": any_elements(),
    "chevron": CHEVRON,
    "curved": pw.shapes.rectangle(12e-3, 8e-3)
    .with_illumination(pw.te_mode(12e-3, 8e-3))
    .curved((0.03, 0.05), WAVELENGTH, (1e-3, 0.0))
    .moved((2e-3, 1e-3)),
}


@pytest.mark.parametrize(
    ("name", "variant"),
    [
        ("lattice", "scalar_rgb"),
        *(pytest.param(name, "llvm_ad_mono", marks=pytest.mark.llvm) for name in SOURCES),
        *(pytest.param("chevron", *each.values, marks=each.marks) for each in VARIANTS[2:]),
    ],
)
def test_the_radiance_is_that_of_the_wigner_function_with_complex_fields(name, variant):
    mi = use(variant)
    source = SOURCES[name]
    emitter = emitter_of(light(source, power=3.0))
    support = emitter.spec.support
    within, direction = draws(20 if variant == "scalar_rgb" else 1000, 1.0)
    x = within * (support.bounds[2:] - support.centre)
    seen = evaluated(mi, emitter, x / MILLIMETRE, direction)
    nu = direction[:, :2] / WAVELENGTH
    expected = pw.wigner(source, x + support.centre, nu, engine="numpy")
    expected *= direction[:, 2]  # Rayleigh-Sommerfeld I
    expected *= 3.0 / pw.radiated_power(source, WAVELENGTH) / WAVELENGTH**2
    assert np.abs(seen - expected[:, None]).max() < RADIANCE_ERROR * 4 * 3.0 / WAVELENGTH**2
    assert expected.min() < 0 < expected.max()


EVANESCENT = pw.shapes.chevron(10e-3, 10e-3, 4e-3).with_illumination(
    pw.Illumination([1, 0.5j], [(40.0, 10.0), (450.0, 0.0)])
)
"""The second wave has 1.4 cycles per wavelength."""


def by_pairs_of_waves(source, x, direction, factor):
    """Sum c_m c_n* exp(2 pi i (k_m - k_n).x) F(nu - (k_m + k_n)/2, slice) g(p_m, p_n*, c)."""
    outline = source.with_illumination(None)
    lag_slice = pw.Aperture(pw.lag_slice(outline, x))
    amplitudes, kappa = source.illumination.amplitudes, source.illumination.frequencies
    p = np.emath.sqrt(1 - WAVELENGTH**2 * (kappa**2).sum(axis=1))
    total = 0j
    for m in range(len(amplitudes)):
        for n in range(len(amplitudes)):
            nu = direction[:2] / WAVELENGTH - (kappa[m] + kappa[n]) / 2
            turn = np.exp(2j * np.pi * (kappa[m] - kappa[n]) @ x)
            pair = amplitudes[m] * amplitudes[n].conj() * turn * pw.fourier(lag_slice, nu)
            total += pair * factor(p[m], p[n].conj(), direction[2])
    return float(total.real)


OBLIQUE = {
    "kirchhoff": lambda p, q, c: (p + c) * (q + c) / 4,
    "rayleigh-sommerfeld-2": lambda p, q, c: p * q,
}


@pytest.mark.parametrize("obliquity", OBLIQUE)
@pytest.mark.parametrize("source", [HORN, EVANESCENT], ids=["TE10", "evanescent"])
def test_the_obliquity_of_several_waves_is_that_of_each_pair_of_them(source, obliquity):
    mi = use("scalar_rgb")
    emitter = emitter_of(light(source, obliquity=obliquity))
    centre = emitter.spec.support.centre
    support = emitter.spec.support.moved(-centre)
    within, direction = draws(30, 1.0)
    x = within * np.array(support.bounds[2:])
    inside = [support.polygons.contains(shapely.Point(place)) for place in x]
    x, direction = x[inside], direction[inside]
    seen = evaluated(mi, emitter, x / MILLIMETRE, direction)
    expected = np.array(
        [
            by_pairs_of_waves(source, place, towards, OBLIQUE[obliquity])
            for place, towards in zip(x + centre, direction, strict=True)
        ]
    )
    expected *= 1 / WAVELENGTH**2 / direction[:, 2]
    # |u| is at most 2, and 1/cos is at most 6, which multiplies the error.
    scale = 4 * source.area * 4 / WAVELENGTH**2 / direction[:, 2:]
    assert len(x) >= 10
    assert (np.abs(seen - expected[:, None]) < RADIANCE_ERROR * scale).all()


def test_another_wavelength_turns_the_waves_whose_obliquity_counts():
    mi = use("scalar_rgb")
    source, how = SOURCES["tapered and steered"], {"obliquity": "kirchhoff", "power": 1e-4}
    changed = emitter_of(light(source, **how))
    parameters = mi.traverse(changed)
    parameters["wavelength"] = 0.8 * WAVELENGTH
    parameters.update()
    x, direction = draws(30, 0.004)
    result, expected = (
        evaluated(mi, emitter, x / MILLIMETRE, direction)
        for emitter in (changed, emitter_of(light(source, 0.8 * WAVELENGTH, **how)))
    )
    # The limit is larger, because the wavelength is in single precision.
    assert np.abs(result - expected).max() < 10 * RADIANCE_ERROR * np.abs(expected).max()


def test_scalar_variants_draw_waves_of_the_right_spread():
    """Tilts have the standard deviation 1/(2 pi width), and frequencies are in the band."""
    mi = use("scalar_rgb")

    waves = DrawnWaves(mi, Mixture(8e-3, 20e9))
    draw = np.random.default_rng(3)
    result = [
        waves.wave(1 / WAVELENGTH, mi.Point2f(*x), mi.Point3f(*p))
        for x, p in zip(draw.normal(size=(800, 2)), draw.normal(size=(800, 3)), strict=True)
    ]
    tilts = np.array([[w.tilt.x, w.tilt.y] for w in result]) * (2 * np.pi * 8e-3)
    assert np.abs(tilts.mean(axis=0)).max() < 0.12
    assert np.abs(tilts.std(axis=0) - 1).max() < 0.1
    frequencies = np.array([float(w.inverse) for w in result]) * pw.SPEED_OF_LIGHT
    middle = pw.SPEED_OF_LIGHT / WAVELENGTH
    assert np.abs(frequencies - middle).max() <= 10.01e9
    assert frequencies.std() == pytest.approx(20e9 / np.sqrt(12), rel=0.1)
