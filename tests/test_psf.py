"""Point spread functions: power, the transfer function, defocus, colours."""

import numpy as np
import pytest

import polywigner as pw
from polywigner.errors import ArgumentError

WAVELENGTH, FOCUS = 0.5e-6, 0.1
PUPIL = pw.shapes.disc(5e-3, n=6)
SQUARE = pw.shapes.square(10e-3)
# A unit of length in the image: the width of a square's main lobe is two of them.
UNIT = WAVELENGTH * FOCUS / 10e-3


def points(count):
    return np.random.default_rng(3).uniform(-2, 2, (count, 2)) * UNIT


def test_in_focus_it_is_the_square_of_the_transform_with_unit_power():
    y = points(20)
    scale = WAVELENGTH * FOCUS
    expected = abs(pw.fourier(PUPIL, y / scale)) ** 2 / scale**2 / PUPIL.area
    assert pw.psf(PUPIL, y, WAVELENGTH, FOCUS) == pytest.approx(expected, rel=1e-10)


@pytest.mark.parametrize("defocus", [0.0, 0.7])
def test_its_fourier_transform_is_the_transfer_function(defocus):
    """The OTF of a small pupil lies within 10 mm of lag: by the sampling theorem sums are exact.

    They leave out the light outside of the lattice, which falls off with the third power of its
    size for a pupil that vanishes at its edges.
    """
    pupil = pw.shapes.square(4e-3)
    cosine = pw.Illumination(
        [0.25, 0.25, 0.25, 0.25], 125.0 * np.array([(s, t) for s in (-1, 1) for t in (-1, 1)])
    )
    pupil = pupil.with_illumination(cosine)
    step = WAVELENGTH * FOCUS / 10e-3
    axis = step * np.arange(-40, 41)
    y = np.stack(np.meshgrid(axis, axis), axis=-1)
    light = pw.psf(pupil, y, WAVELENGTH, FOCUS, defocus, 2e-3)
    xi = np.array([(0.0, 0.0), (1e-3, 0.5e-3), (-2e-3, 1e-3), (0.3e-3, 3e-3)])
    waves = np.exp(-2j * np.pi * (y @ xi.T) / (WAVELENGTH * FOCUS))
    found = np.tensordot(light, waves, 2) * step**2
    assert found == pytest.approx(pw.otf(pupil, xi, defocus, 2e-3), abs=2e-4)


def test_a_square_out_of_focus_has_the_strehl_ratio_of_fresnels_integral():
    """(int exp(2 pi i w t^2) dt/2)^4 over t from -1 to 1, w at the middle of a side."""
    at, weights = np.polynomial.legendre.leggauss(40)
    for waves in (0.1, 0.5, -1.3):
        expected = abs(np.exp(2j * np.pi * waves * at**2) @ weights / 2) ** 4
        focused, blurred = (
            pw.psf(SQUARE, (0.0, 0.0), WAVELENGTH, FOCUS, w, 5e-3) for w in (0.0, waves)
        )
        assert blurred / focused == pytest.approx(expected, rel=1e-9)


def test_light_of_several_colours_is_their_mean():
    y, colours = points(5), (0.45e-6, 0.6e-6)
    found = pw.psf(PUPIL, y, colours, FOCUS, weights=(1.0, 3.0))
    single = [pw.psf(PUPIL, y, colour, FOCUS) for colour in colours]
    assert found == pytest.approx(0.25 * single[0] + 0.75 * single[1])


def test_labels_stay():
    xarray = pytest.importorskip("xarray")
    y = points(4)
    found = pw.psf(PUPIL, xarray.DataArray(y, dims=("star", "xy")), WAVELENGTH, FOCUS)
    assert found.dims == ("star",) and found.attrs["units"] == "m-2"
    assert found.values == pytest.approx(pw.psf(PUPIL, y, WAVELENGTH, FOCUS))


@pytest.mark.parametrize(
    ("call", "message"),
    [
        ({"source": pw.Slits([(0.0, 1e-3)])}, "Slits"),
        ({"points": (0.0, 0.0, 0.1)}, r"\(\.\.\., 2\)"),
        ({"focal_length": 0.0}, "focal_length"),
        ({"pupil_radius": -1.0}, "pupil_radius"),
        ({"weights": (1.0, 2.0)}, "weights"),
    ],
)
def test_wrong_arguments_are_named(call, message):
    given = {"source": SQUARE, "points": (0, 0), "wavelength": WAVELENGTH, "focal_length": FOCUS}
    with pytest.raises(ArgumentError, match=message):
        pw.psf(**(given | call))
