"""Autocorrelation against slices by shapely, and optical transfer functions."""

import math

import numpy as np
import pytest
import shapely

import polywigner as pw
from oracles.references import ENGINES
from polywigner.errors import ArgumentError

engines = pytest.mark.parametrize("engine", ENGINES)

HOLED = pw.Aperture(shapely.box(-1, -1, 1, 1) - shapely.box(-0.5, -0.5, 0.25, 0.5))
SLITS = pw.Slits([[-1.0, -0.4], [0.1, 0.9]])


def test_points_on_shared_edges_belong_to_exactly_one_tile():
    corner = np.linspace(0, 1, 9)
    points = np.stack(np.meshgrid(corner, corner), axis=-1).reshape(-1, 2)
    tiles = [
        pw.Aperture(shapely.box(x, y, x + 0.5, y + 0.5)) for x in (0.0, 0.5) for y in (0.0, 0.5)
    ]
    inside = sum(pw.autocorrelation(tile, points, np.zeros(2)).real for tile in tiles)
    whole = pw.autocorrelation(pw.shapes.rectangle(4.0, 4.0), points, np.zeros(2)).real
    assert (whole == 1).all()
    assert ((inside == 1) | (points == 1).any(axis=-1) | (points == 0).any(axis=-1)).all()
    assert (inside <= 1).all()


def _pupil_overlap(xi, waves, radius):
    """Return the defocused transfer function of the slit [-1, 1] by quadrature."""
    nodes, weights = np.polynomial.legendre.leggauss(80)
    half = 1 - abs(xi) / 2
    x = half * nodes

    def pupil(p):
        return np.exp(2j * math.pi * waves * p**2 / radius**2)

    return complex(half * weights @ (pupil(x + xi / 2) * pupil(x - xi / 2).conj())) / 2


@pytest.mark.parametrize("waves", [0.0, 0.5, -2.0])
def test_defocus_is_a_cut_through_the_ambiguity_function(waves):
    slit = pw.Slits([-1, 1])
    for xi in (0.0, 0.3, -0.3, 1.1, 1.9):
        expected = _pupil_overlap(xi, waves, 1.0)
        assert pw.otf(slit, [xi], waves) == pytest.approx(expected, abs=1e-13)
        # The transfer function of a square pupil is a product. The farthest vertex is at the radius
        # sqrt(2).
        square = pw.otf(pw.shapes.square(2.0), [xi, 0.4], waves)
        product = _pupil_overlap(xi, waves, math.sqrt(2)) * _pupil_overlap(0.4, waves, math.sqrt(2))
        assert square == pytest.approx(product, abs=1e-13)
        stated = pw.otf(pw.shapes.square(2.0), [xi, 0.4], waves, pupil_radius=1.0)
        product = _pupil_overlap(xi, waves, 1.0) * _pupil_overlap(0.4, waves, 1.0)
        assert stated == pytest.approx(product, abs=1e-13)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"pupil_radius": 0.0}, "pupil_radius to be a length above zero"),
        ({"pupil_radius": "1 mm"}, "pupil_radius to be a length above zero, got '1 mm'"),
        ({"defocus": math.inf}, "finite defocus"),
        ({"defocus": np.array([0.5, 1.0])}, "finite defocus"),
    ],
)
def test_unusable_pupils_are_refused(arguments, message):
    with pytest.raises(ArgumentError, match=message):
        pw.otf(HOLED, [0.1, 0.1], **arguments)


@engines
def test_points_that_are_no_numbers_have_no_autocorrelation(engine):
    x = np.array([[0.7, 0.7], [np.nan, 0.0], [0.0, np.nan]])
    for xi in (np.zeros((3, 2)), np.full((3, 2), [0.0, np.nan])):
        got = pw.autocorrelation(HOLED, x, xi, engine=engine)
        expected = np.isnan(np.concatenate([x, xi], axis=1)).any(axis=1)
        assert (np.isnan(got) == expected).all()
    slits = pw.autocorrelation(SLITS, [[np.nan], [0.5]], [0.0], engine=engine)
    assert np.isnan(slits[0]) and slits[1] == 1.0


DISC_OF_64 = 2e-5
"""The 64-gon with the disc's area; of focused OTFs it errs by 1e-5."""


def _defocused_otf_of_a_disc(lag, waves):
    """Return the defocused OTF of a unit disc by lines along the lag (Hopkins)."""
    node, weight = np.polynomial.legendre.leggauss(120)
    half = np.sqrt(1 - lag * lag / 4)
    angle = (node + 1) * np.pi / 4
    y = half * np.sin(angle)
    length = 2 * np.sqrt(1 - y * y) - lag
    return float(weight @ (length * np.sinc(2 * waves * lag * length) * np.cos(angle))) * half / 2


def test_a_disc_out_of_focus_has_the_radius_that_is_told():
    """The default radius is the distance of the vertices, which are outside the disc."""
    disc = pw.shapes.disc(1.0)
    lags = np.linspace(0.05, 1.95, 20)
    xi = np.stack([lags, 0 * lags], axis=-1)
    expected = np.array([_defocused_otf_of_a_disc(lag, 1.0) for lag in lags])
    assert np.abs(pw.otf(disc, xi, 1.0, 1.0) - expected).max() < DISC_OF_64
    by_default = np.abs(pw.otf(disc, xi, 1.0) - expected).max()
    assert 1.2e-3 < by_default < 1.3e-3  # stated in the docstring of `otf`
