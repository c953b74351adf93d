"""Positions sampled from the automean have the stated density."""

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

import polywigner as pw
from oracles.drawn import polygons
from oracles.references import aperture
from polywigner.errors import ArgumentError, GeometryError

HOLED = pw.Aperture(shapely.box(-1, -1, 1, 1) - shapely.box(-0.5, -0.5, 0.25, 0.5))
SOURCES = {
    "square": pw.shapes.square(0.01),
    "chevrons": pw.shapes.chevron_pair(0.02, 0.012, 0.004),
    "double slit": pw.shapes.double_slit((0.1, 0.3), 0.5, (-1, 0.5)),
    "holed": HOLED,
    "star far away": pw.Aperture(pw.shapes.star(5, 1.0, 0.4).rings[0] + [300.0, -200.0]),
}
SLITS = pw.Slits([[-1.0, -0.9], [0.1, 0.9], [1.0, 1.05]])
sources = pytest.mark.parametrize("source", SOURCES.values(), ids=SOURCES)

COUNT = 20_000
ROUNDING = 1e-12


@settings(max_examples=25)
@given(drawn=polygons(), seed=st.integers(0, 2**32 - 1))
def test_every_position_lies_in_the_automean(drawn, seed):
    source = aperture(drawn)
    support = pw.automean(source)
    points, density = pw.sample_automean(source, 50, seed=seed)
    distance = shapely.distance(support.polygons, shapely.points(points))
    assert distance.max() < 1e-12 * (source.diameter + np.abs(source.bounds).max())
    assert (density == 1 / support.area).all()


@sources
@pytest.mark.parametrize("turns", [0.0, 0.3, 1.5])
def test_sums_of_the_wigner_function_converge_to_the_squared_spectrum(source, turns):
    nu = np.array([0.8, 0.6]) * turns / source.diameter
    expected = abs(pw.fourier(source, nu)) ** 2
    x, density = pw.sample_automean(source, COUNT, seed=3)
    terms = pw.wigner(source, x, nu) / density
    deviation = max(terms.std() / np.sqrt(COUNT), ROUNDING * source.area**2)
    assert abs(terms.mean() - expected) < 5 * deviation


ARRAYS = {
    "opposed squares": pw.Array(
        [pw.shapes.square(1.0), pw.Aperture([[0.8, 0.1], [2.0, 0.1], [2.0, 0.9], [0.8, 0.9]])],
        [1.0, -0.5j],
    ),
    "overlapping": pw.Array([HOLED, pw.shapes.square(1.0), HOLED], [1.0, -2.0, 0.0]),
    "single slits": SLITS,
    "slits": pw.Array([SLITS, pw.shapes.slit(0.4, 0.5)], [1.0, -0.8]),
}


@pytest.mark.parametrize("source", ARRAYS.values(), ids=ARRAYS)
def test_sums_of_the_wigner_function_of_arrays_converge(source):
    x, density = pw.sample_automean(source, 4 * COUNT, seed=6)
    elements = getattr(source, "elements", [source])
    contents = [getattr(e, "area", None) or e.length for e in elements]
    bound = (abs(getattr(source, "weights", np.ones(1))) @ contents) ** 2
    for nu in ([0.0] * x.shape[1], [0.4] * x.shape[1]):
        terms = pw.wigner(source, x, nu) / density
        deviation = terms.std() / np.sqrt(len(terms)) + ROUNDING * bound
        assert abs(terms.mean() - abs(pw.fourier(source, nu)) ** 2) < 5 * deviation


def test_strata_of_the_unit_square_stay_strata_of_a_rectangle():
    numbers = np.random.default_rng(1).random((256, 2))
    points, _ = pw.sample_automean(pw.shapes.rectangle(2.0, 1.0), numbers)
    assert np.abs(points - (2 * numbers - 1) * (1.0, 0.5)).max() < ROUNDING


def test_a_seed_gives_the_same_positions_and_a_generator_goes_on():
    first, generator = pw.sample_automean(HOLED, 10, seed=7)[0], np.random.default_rng(7)
    third, fourth = (pw.sample_automean(HOLED, 10, seed=generator)[0] for _ in range(2))
    assert (first == third).all() and (third != fourth).any()


def test_corners_of_the_unit_square_stay_in_the_automean():
    last = np.nextafter(1.0, 0.0)
    corners = [[0.0, 0.0], [last, last], [0.0, last], [last, 0.0]]
    for source in SOURCES.values():
        points, _ = pw.sample_automean(source, corners)
        away = shapely.distance(pw.automean(source).polygons, shapely.points(points))
        assert away.max() < ROUNDING * (source.diameter + np.abs(source.bounds).max())


@pytest.mark.parametrize(
    ("samples", "message"),
    [
        (0, "samples to be a whole number from 1"),
        (True, "count, or numbers"),
        ([[0.5, 1.0]], r"in \[0, 1\), got 1.0"),
        ([[0.5, np.nan]], "got nan"),
        ([[0.5, 0.5, 0.5]], r"shape \(n, 2\)"),
        ("many", "count, or numbers"),
    ],
)
def test_unusable_samples_are_refused(samples, message):
    with pytest.raises(ArgumentError, match=message):
        pw.sample_automean(HOLED, samples)


def test_sources_without_a_phase_space_are_refused():
    with pytest.raises(ArgumentError, match="expected a source"):
        pw.sample_automean(HOLED.placed(np.eye(4)), 3)
    leaning = np.array([[1, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]])
    with pytest.raises(GeometryError, match="in the plane z = 0"):
        pw.sample_automean(pw.Array([HOLED, HOLED.placed(leaning)]), 3)
    with pytest.raises(ArgumentError, match="seed"):
        pw.sample_automean(HOLED, 3, seed="x")
