"""Emitters and receivers whose light is a mixture, against quadrature, in small scenes."""

import numpy as np
import pytest

import polywigner as pw
from mitsuba_scenes import pose, use
from polywigner.errors import SceneError
from polywigner.mitsuba import aperture, register_source
from polywigner.mitsuba.direct_light import coupled_share, facing_parts
from polywigner.mitsuba.placement import PlacedSource
from polywigner.mitsuba.sources import Mixture
from polywigner.mitsuba.wigner import DrawnWaves
from polywigner.propagation.far_fields import powers_of
from polywigner.propagation.irradiances import parts_of
from polywigner.quantities import SPEED_OF_LIGHT

WAVELENGTH = 3.2e-3
WIDTH = 8e-3
SLITS = pw.shapes.double_slit(2e-3, 12e-3, (-6e-3, 6e-3))


def radiated_power(source, bandwidth=None):
    """Mean over tilts and wavelengths."""
    return sum(
        weight * powers_of(part, length, "rayleigh-sommerfeld-1")[0]
        for part, length, weight in parts_of(source, WAVELENGTH, bandwidth, 1e-4)
    )


@pytest.mark.parametrize(
    "how",
    [
        {"source": SLITS.partially_coherent(WIDTH), "obliquity": "kirchhoff"},
        {"source": SLITS, "bandwidth": 3e11},
    ],
)
def test_mixtures_that_cannot_be_drawn_are_refused(how):
    use("scalar_rgb")
    with pytest.raises(SceneError, match="expected"):
        aperture(wavelength=WAVELENGTH, **how)


def test_a_direct_link_is_the_mean_over_tilts_and_wavelengths():
    """Far away it is Friis' formula, with the blurred intensity of the emitter over its power."""
    use("scalar_rgb")
    square, far, width, band = pw.shapes.square(6e-3), 20.0, 12e-3, 2e9
    partly = square.partially_coherent(width)
    about = (WAVELENGTH, "rayleigh-sommerfeld-1", 1.0)
    powers = radiated_power(partly, band), pw.radiated_power(square, WAVELENGTH)
    here, back = np.eye(4), pose((0.0, 0.0, far), np.pi)
    emitter = PlacedSource("sent", square, here, *about, powers[0], mixture=Mixture(width, band))
    parts = facing_parts(emitter, PlacedSource("taken", square, back, *about, powers[1]))
    intensity = pw.radiant_intensity(partly, (0, 0, 1), WAVELENGTH) / powers[0]
    expected = intensity * square.area**2 / far**2 / powers[1]
    assert coupled_share(parts, 1e-6) == pytest.approx(expected, rel=1e-3, abs=0)


def test_scalar_variants_draw_waves_of_the_right_spread():
    """Tilts of standard deviation 1/(2 pi width), and frequencies over all of the band."""
    mi = use("scalar_rgb")

    waves = DrawnWaves(mi, Mixture(WIDTH, 20e9))
    draw = np.random.default_rng(3)
    found = [
        waves.wave(1 / WAVELENGTH, mi.Point2f(*x), mi.Point3f(*p))
        for x, p in zip(draw.normal(size=(800, 2)), draw.normal(size=(800, 3)), strict=True)
    ]
    tilts = np.array([[w.tilt.x, w.tilt.y] for w in found]) * (2 * np.pi * WIDTH)
    assert np.abs(tilts.mean(axis=0)).max() < 0.12
    assert np.abs(tilts.std(axis=0) - 1).max() < 0.1
    frequencies = np.array([float(w.inverse) for w in found]) * SPEED_OF_LIGHT
    middle = SPEED_OF_LIGHT / WAVELENGTH
    assert np.abs(frequencies - middle).max() <= 10.01e9
    assert frequencies.std() == pytest.approx(20e9 / np.sqrt(12), rel=0.1)


def test_a_scene_in_xml_reads_coherence_and_bandwidth():
    mi = use("scalar_rgb")
    key = register_source(SLITS)
    scene = mi.load_string(
        f"""<scene version="3.0.0"><shape type="wigner"><string name="source" value="{key}"/>
        <string name="frequency" value="94 GHz"/><string name="coherence" value="4 mm"/>
        <string name="bandwidth" value="2 GHz"/></shape></scene>"""
    )
    mixture = scene.emitters()[0].spec.mixture
    assert (mixture.coherence_width, mixture.bandwidth) == (4e-3, 2e9)
