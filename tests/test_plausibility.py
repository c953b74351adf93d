"""Warnings about values that seem to be in another unit."""

import warnings

import numpy as np
import pytest

import polywigner as pw
from polywigner.errors import PolywignerWarning

WAVELENGTH = 3.2e-3
SQUARE = pw.shapes.square(10e-3)
IN_MM = pw.shapes.square(10.0)  # 10 mm as a number of metres
POINT = (0.0, 0.0, 50.0)
AXIS = (0.0, 0.0, 1.0)
FEW = np.radians([0.0, 10.0])

CALLS = {
    "amplitude": lambda s, w: pw.amplitude(s, POINT, w),
    "radiance": lambda s, w: pw.radiance(s, (0.0, 0.0), AXIS, w),
    "suggest_sampling": lambda s, w: pw.suggest_sampling(s, w, "pattern"),
    "hemisphere": lambda s, w: pw.hemisphere(s, 50.0, FEW, 0.0, w, method="fresnel"),
    "frequency": lambda s, w: pw.radiant_intensity(s, AXIS, frequency=pw.SPEED_OF_LIGHT / w),
    "named": lambda s, w: pw.radiant_intensity(direction=AXIS, wavelength=w, source=s),
    "array": lambda s, w: pw.radiant_intensity(pw.Array([s]), AXIS, w),
}


def warned(call, *arguments):
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        call(*arguments)
    return caught


@pytest.mark.parametrize("name", CALLS)
def test_a_source_of_thousands_of_wavelengths_is_asked_about_once_and_a_usual_one_never(name):
    (result,) = warned(CALLS[name], IN_MM, WAVELENGTH)
    assert result.category is PolywignerWarning
    assert "wavelengths across; check whether mm" in str(result.message)
    assert not warned(CALLS[name], SQUARE, WAVELENGTH)


def test_the_doubt_about_a_wavelength_names_the_line_of_the_call():
    (result,) = warned(CALLS["named"], IN_MM, WAVELENGTH)
    assert result.filename == __file__


def test_bounds_of_arrays_hold_their_elements():
    positions = [(0.0, 0.0), (3.0, 1.0)]
    for array in (
        pw.phased_array(SQUARE, positions),
        pw.Array([SQUARE.moved(p) for p in positions]),
    ):
        np.testing.assert_allclose(array.bounds, (-5e-3, -5e-3, 3.005, 1.005))
    slits = pw.Slits([(0.0, 1.0)])
    assert pw.phased_array(slits, [0.0, 4.0]).bounds == pw.Array([slits, slits.moved([4.0])]).bounds


def link(source, distance, wavelength):
    facing = np.diag([-1.0, 1.0, -1.0, 1.0])
    facing[2, 3] = distance
    return pw.coupling(source, source, facing, wavelength)


def test_links_of_a_hundred_thousand_sizes_are_asked_about():
    """10 mm squares at a distance of 3000 mm."""
    (result,) = warned(link, SQUARE, 3000.0, WAVELENGTH)
    assert result.category is PolywignerWarning
    assert "3000 m" in str(result.message)
    assert "mm were passed as m" in str(result.message)


def aperture(size, wavelength):
    pw.suggest_sampling(pw.shapes.square(size), wavelength, "pattern")


USUAL = {
    "optics": (aperture, 25e-3, 550e-9),
    "large optics": (aperture, 0.2, 550e-9),
    "small hole": (aperture, 2e-7, 550e-9),
    "small hole at terahertz": (aperture, 1e-6, 1.2e-4),
    "radar on the road": (link, SQUARE, 250.0, WAVELENGTH),
    "link between two masts": (link, pw.shapes.square(0.3), 5e3, 3.7e-3),
    "link between two fibres": (link, pw.shapes.square(1e-5), 1.2, 1.55e-6),
    "link between two telescopes": (link, pw.shapes.square(0.1), 3e3, 1.55e-6),
}


@pytest.mark.parametrize("name", USUAL)
def test_sources_and_links_of_usual_sizes_are_not_asked_about(name):
    assert not warned(*USUAL[name])
