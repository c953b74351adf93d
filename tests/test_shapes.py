"""Catalogue of shapes: areas in closed form, symmetries and errors."""

import math
import pickle

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from outlines import CHEVRON, relaxed
from polywigner.errors import ArgumentError, GeometryError
from polywigner.geometry import Aperture, shapes

# Rounding error of products and sums of a few floats.
ROUNDING = 1e-14

_length = st.floats(1e-6, 1e3)
_part = st.floats(0.01, 0.99)

AREAS = {
    "rectangle": (shapes.rectangle(2, 3), 6),
    "square": (shapes.square(0.01), 1e-4),
    "triangle": (shapes.triangle(2, 3), 3),
    "hexagon": (shapes.regular_polygon(6, 2), 6 * math.sqrt(3)),
    "disc": (shapes.disc(2), 4 * math.pi),
    "ring": (shapes.ring(2, 1, n=50), 3 * math.pi),
    "star": (shapes.star(5, 1, 0.4), 5 * 0.4 * math.sin(math.pi / 5)),
    "chevron": (shapes.chevron(2, 1.1, 0.6), 1.2),
    "two chevrons": (shapes.chevron_pair(2, 1.1, 0.6), 2.4),
    "V": (shapes.vee(2, 1, 0.1), 1 - (1 - 0.1 * math.sqrt(2)) ** 2),
    "U": (shapes.u_shape(3, 4, 0.5), 12 - 2 * 3.5),
    "bow-tie": (shapes.bow_tie(2, 1), 1),
    "bow-tie with a gap": (shapes.bow_tie(2, 1, gap=0.5), 0.75),
    "two slits": (shapes.double_slit((0.1, 0.3), 2, (-1, 0.5)), 0.8),
    "18 segments": (shapes.hexagonal_segments(1.32), 18 * 1.32**2 * math.sqrt(3) / 2),
    "18 segments apart": (shapes.hexagonal_segments(1.32, 0.01), 18 * 1.32**2 * math.sqrt(3) / 2),
    "three discs": (shapes.interferometer([(0, 0), (5, 0), (0, 9)], 1), 3 * math.pi),
}


@pytest.mark.parametrize(("aperture", "area"), AREAS.values(), ids=AREAS)
def test_areas_have_their_closed_form(aperture, area):
    assert aperture.area == pytest.approx(area, rel=ROUNDING)


PLACED = {"two slits", "three discs"}
ROUND = {"star"}  # centred at the origin, with asymmetric bounds


@pytest.mark.parametrize("name", sorted(AREAS.keys() - PLACED - ROUND))
def test_bounds_are_centred_at_the_origin(name):
    aperture = AREAS[name][0]
    assert np.allclose(aperture.centre, 0, rtol=0, atol=ROUNDING * aperture.diameter)


@relaxed
@given(_length, _length, _part)
def test_the_chevron_is_the_reference_one_scaled(width, height, part):
    thickness = height * part
    x, y, t = width / 2, height / 2, thickness
    expected = [(-x, -y), (0, y - t), (x, -y), (x, t - y), (0, y), (-x, t - y)]
    assert shapes.chevron(width, height, thickness) == Aperture(expected)
    reference = Aperture(CHEVRON - [1, 0.55])
    result = shapes.chevron(2, 1.1, 0.6)
    assert result.polygons.symmetric_difference(reference.polygons).area < ROUNDING


@relaxed
@given(st.integers(3, 200), _length)
def test_a_disc_has_the_area_of_the_circle_whatever_its_sides(sides, radius):
    assert shapes.disc(radius, sides).area == pytest.approx(math.pi * radius**2, rel=ROUNDING)


@relaxed
@given(_length, _length, _part)
def test_arms_of_the_vee_are_as_thick_as_asked(width, height, part):
    """The thickness is the distance between the outer edge and the notch."""
    half, length = width / 2, math.hypot(width / 2, height)
    thickness = part * half * height / length
    aperture = shapes.vee(width, height, thickness)
    x, y = max(aperture.rings[0], key=lambda vertex: (vertex[0] == 0) * (vertex[1] + height))
    assert x == 0  # the notch
    distance = half * (y + height / 2) / length
    assert distance == pytest.approx(thickness, rel=1e-9)


@pytest.mark.parametrize("rings", [1, 2, 3])
@pytest.mark.parametrize("centre", [False, True])
def test_honeycombs_have_their_number_of_segments(rings, centre):
    count = 3 * rings * (rings + 1) + centre
    apart = shapes.hexagonal_segments(1.0, 0.1, rings, centre)
    assert len(apart.polygons.geoms) == count
    together = shapes.hexagonal_segments(1.0, 0.0, rings, centre)
    assert len(together.polygons.geoms) == 1
    assert len(together.rings) == (1 if centre else 2)
    assert together.area == pytest.approx(count * math.sqrt(3) / 2, rel=ROUNDING)
    first, *others = apart.polygons.geoms
    assert min(map(first.distance, others)) == pytest.approx(0.1, rel=1e-12)


@pytest.mark.parametrize("gap", [0.0, 0.1])
@pytest.mark.parametrize("centre", [False, True])
def test_segments_are_numbered_by_columns_and_stay_apart(gap, centre):
    mirror = shapes.hexagonal_segments(1.0, gap, 2, centre)
    moved = pickle.loads(pickle.dumps(mirror.turned(np.pi).scaled(2.0).moved((1.0, 0.0))))
    centres = np.array([segment.centre for segment in mirror.segments])
    assert len(centres) == 18 + centre
    order = np.lexsort((np.round(centres[:, 1], 9), np.round(centres[:, 0], 9)))
    assert (order == np.arange(len(centres))).all()
    assert sum(segment.area for segment in mirror.segments) == pytest.approx(mirror.area)
    result = [segment.centre for segment in moved.segments]
    assert np.allclose(result, -2.0 * centres + [1.0, 0.0], atol=1e-12)
    assert len(moved.with_illumination(None).segments) == len(centres)


def test_segments_of_other_apertures_are_their_parts():
    pair = shapes.double_slit(0.5, 1.0, (-1.0, 1.0))
    assert [segment.area for segment in pair.segments] == pytest.approx([0.5] * 2)


def test_what_touches_is_one():
    assert shapes.double_slit(1.0, 1.0, (-0.5, 0.5)) == shapes.rectangle(2, 1)
    assert shapes.grating(4, 0.5, 0.5) == shapes.slit(2)
    assert shapes.slit_pair(1, (0, 1)) == shapes.slit(2, 0.5)
    assert shapes.slit_pair((0.1, 0.3), (-1, 0.5)).bounds == pytest.approx((-1.05, 0.65))


def test_slits_and_stations_stay_where_they_are_put():
    slits = shapes.double_slit((0.1, 0.3), 2, (-1, 0.5))
    assert slits.bounds == pytest.approx((-1.05, -1, 0.65, 1))
    assert shapes.double_slit(0.2, 2, (-1, 1)) == shapes.double_slit((0.2, 0.2), 2, (-1, 1))
    stations = shapes.interferometer([(0, 0), (5, 1)], 0.5, n=16)
    centres = sorted((p.centroid.x, p.centroid.y) for p in stations.polygons.geoms)
    assert np.allclose(centres, [(0, 0), (5, 1)], rtol=0, atol=1e-14)


def test_two_chevrons_stand_one_behind_the_other():
    pair = shapes.chevron_pair(2, 1.1, 0.6)
    single = shapes.chevron(2, 1.1, 0.6).rings[0]
    shift = np.array([0, 0.45])
    expected = Aperture([single - shift, single + shift])
    assert pair.polygons.symmetric_difference(expected.polygons).area < ROUNDING
    beside = shapes.chevron_pair(2, 1.1, 0.6, offset=(2.5, 0))
    assert beside.bounds == pytest.approx((-2.25, -0.55, 2.25, 0.55))
    touching = shapes.chevron_pair(2, 1.1, 0.6, offset=(0, 0.6))
    assert len(touching.rings) == 1


BAD = {
    "too many slits": lambda: shapes.grating(10**10, 1, 2),
    "too many vertices": lambda: shapes.disc(1, 10**10),
    "1D slit at infinity": lambda: shapes.slit(1, math.inf),
    "three 1D slits": lambda: shapes.slit_pair(1, (0, 2, 4)),
    "slits on slits": lambda: shapes.grating(3, 1, 0.5),
    "zero": lambda: shapes.square(0),
    "NaN": lambda: shapes.rectangle(math.nan, 1),
    "text": lambda: shapes.square("10 mm"),
    "two sides": lambda: shapes.regular_polygon(2, 1),
    "true sides": lambda: shapes.disc(1, True),
    "inner above outer": lambda: shapes.ring(1, 2),
    "thick chevron": lambda: shapes.chevron(2, 1, 1),
    "thick V": lambda: shapes.vee(1, 1, 0.5),
    "thick U": lambda: shapes.u_shape(1, 1, 0.5),
    "wide gap": lambda: shapes.bow_tie(1, 1, gap=1),
    "negative gap": lambda: shapes.hexagonal_segments(1, -0.1),
    "three slits": lambda: shapes.double_slit(1, 1, (0, 2, 4)),
    "stations on a line": lambda: shapes.interferometer([0, 1, 2], 1),
    "offset in space": lambda: shapes.chevron_pair(2, 1.1, 0.6, offset=(0, 0, 1)),
}


OVERLAPPING = {
    "slits": lambda: shapes.double_slit(2, 1, (0, 1)),
    "1D slits": lambda: shapes.slit_pair(2, (0, 1)),
    "chevrons": lambda: shapes.chevron_pair(2, 1.1, 0.6, offset=(0, 0.5)),
    "stations": lambda: shapes.interferometer([(0, 0), (1, 0)], 1),
}
REFUSED = {
    **{name: (build, ArgumentError, "expected .*, got ") for name, build in BAD.items()},
    **{name: (build, GeometryError, "do not overlap") for name, build in OVERLAPPING.items()},
}


@pytest.mark.parametrize(("build", "error", "message"), REFUSED.values(), ids=REFUSED)
def test_arguments_that_do_not_fit_raise_and_say_why(build, error, message):
    with pytest.raises(error, match=message):
        build()
