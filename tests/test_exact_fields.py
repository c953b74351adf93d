"""Exact fields as integrals along edges, against integrals over the opening and against physics.

Lengths are in wavelengths throughout.
"""

from __future__ import annotations

import json
import math
import tracemalloc
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import shapely

import polywigner as pw
from oracles.references import ENGINES, numpy_and_few
from oracles.surface_integrals import surface_fields
from polywigner.errors import ArgumentError, GeometryError
from polywigner.propagation import boundary

METHODS: tuple[Any, ...] = ("rayleigh-sommerfeld-1", "rayleigh-sommerfeld-2", "kirchhoff")
methods = pytest.mark.parametrize("method", METHODS)
engines = pytest.mark.parametrize("engine", ENGINES)

TIGHT = 1e-12
"""Tolerance asked for."""
QUADRATURE = 1e-10
"""Relative; the quadrature over the opening reaches some 1e-12, less at points near it."""
ROUNDING = 1e-12
"""Of fields of order 1: two ways to add up some hundred terms."""
SINGLE = 2e-6
"""Of the incident amplitude: float32 sums of some tens of terms, phases from float64."""

HALF = 1.568  # of the 10 mm square at 94 GHz
SQUARE = pw.shapes.square(2 * HALF)
ELL = pw.Aperture([[-1.5, -1.5], [1.5, -1.5], [1.5, -0.5], [-0.4, -0.5], [-0.4, 1.5], [-1.5, 1.5]])
HOLED = pw.Aperture(
    shapely.Polygon(
        [(-1.6, -1.4), (1.8, -1.2), (1.3, 1.6), (-1.5, 1.3)],
        [[(-0.5, -0.5), (0.2, -0.4), (0.6, 0.5), (-0.3, 0.6)]],
    )
)
DISJOINT = pw.Aperture([[(-2, -1), (-0.5, -1), (-0.5, 1)], [(0.3, -1), (1.8, -0.8), (1.2, 1.1)]])


def waves(amplitudes: Any, directions: Any) -> pw.Illumination:
    return pw.Illumination(amplitudes, directions)


def tilted(source: pw.Aperture, *p: float) -> pw.Aperture:
    return source.with_illumination(waves([1.0], [p]))


TE10 = SQUARE.with_illumination(pw.te_mode(2 * HALF, 2 * HALF, 1, 0))
STEERED = pw.phased_array(
    pw.shapes.square(0.45).with_illumination(pw.steering((0.3, 0.1), 1.0)),
    [(0.5 * i - 0.5, 0.5 * j - 0.25) for i in range(3) for j in range(2)],
    [np.exp(2j * np.pi * (0.15 * i + 0.05 * j)) for i in range(3) for j in range(2)],
)
SOURCES: dict[str, Any] = {
    "square": SQUARE,
    "triangle": pw.shapes.triangle(3.0, 2.5),
    "L": ELL,
    "with a hole": HOLED,
    "disjoint": DISJOINT,
    "oblique": tilted(ELL, 0.5, -0.3),
    "nearly grazing": tilted(SQUARE, 0.97, 0.1),
    "grazing": tilted(SQUARE, 1.0, 0.0),
    "evanescent": tilted(HOLED, 0.9, 0.9),
    "TE10": TE10,
    "steered array": STEERED,
}

HARD_POINTS = np.array(
    [
        (HALF, 0.2, 0.5),  # over an edge of the square
        (HALF, HALF, 0.5),  # over a vertex
        (HALF + 1e-7, -0.3, 0.5),  # a hair beside the edge
        (-1.5, -1.5, 0.5),  # over a vertex of the L
        (-0.4, 0.3, 0.1),  # close to an inner edge
        (0.1, 0.05, 0.02),  # close to the plane
        (HALF + 0.5 / math.sqrt(0.66) * 2, 0.4, 2.0),  # shadow boundary of the oblique wave
        (2.5, 3.0, 1.0),
        (8.0, -3.0, 12.0),
        (0.0, 0.0, 30.0),
    ]
)


@pytest.mark.parametrize("name", SOURCES)
def test_integrals_along_edges_are_those_over_the_opening(name: str) -> None:
    source = SOURCES[name]
    expected = np.array([surface_fields(source, p, 1.0) for p in HARD_POINTS])
    for k, method in enumerate(METHODS):
        got = pw.amplitude(source, HARD_POINTS, 1.0, method, tolerance=TIGHT)
        # of the wave that grazes the plane, the slope is zero: up to rounding of terms of order 1
        allowed = QUADRATURE * np.abs(expected[:, k]) + 1e-15
        assert np.all(np.abs(got - expected[:, k]) <= allowed)


def test_values_computed_elsewhere_are_found_again() -> None:
    data = json.loads((Path(__file__).parent / "data" / "exact_fields.json").read_text())
    wavelength = 299792458 / 94e9
    for case in data["values"]:
        if "sphere" in case:
            r = case["sphere"][0]
            theta, phi = np.radians(case["sphere"][1:])
            point = r * np.array(
                [np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)]
            )
        else:
            point = np.array(case["point"])
        source = pw.shapes.square(10e-3).with_illumination(
            waves([1.0], [np.array(case["kappa"]) / wavelength])
        )
        field = pw.amplitude(source, point * wavelength, wavelength, case["method"])
        assert abs(field) ** 2 == pytest.approx(case["value"], rel=data["rtol"])


@pytest.mark.parametrize("direction", [(0.0, 0.0), (0.5, 0.2), (-0.9, 0.3)])
@methods
def test_nothing_jumps_at_the_boundary_of_the_shadow(direction: Any, method: Any) -> None:
    """On the ray through a point of an edge, and beside it by any distance however small."""
    source = tilted(SQUARE, *direction)
    p = np.array([*direction, math.sqrt(1 - np.dot(direction, direction))])
    # nodes of odd rules lie in the middle of the edge, on the ray itself
    for start in ((HALF, 0.0), (HALF, 0.3), (HALF, HALF)):
        for height in (0.5, 5.0, 200.0):
            ray = np.append(start, 0.0) + p * height / p[2]
            offsets = np.array([0.0, *np.geomspace(1e-15, 1e-3, 13)])
            beside = np.concatenate([-offsets[::-1], offsets])
            points = ray + beside[:, None] * [1.0, 0.0, 0.0]
            field = pw.amplitude(source, points, 1.0, method, tolerance=TIGHT)
            centre = field[len(offsets)]
            # a field of waves of length 1 and modulus about 1 changes by 2 pi a length; the first
            # coordinate itself is rounded
            slope = 2 * math.pi * 2
            rounding = 30 * np.spacing(np.abs(ray).max()) + ROUNDING
            assert np.all(np.abs(field - centre) <= slope * np.abs(beside) + rounding)


@methods
@pytest.mark.parametrize("name", ["square", "oblique", "evanescent", "TE10"])
def test_fields_solve_the_wave_equation(name: str, method: Any) -> None:
    """The mean over a sphere is the field at its centre times sin(ka)/(ka)."""
    node, weight = np.polynomial.legendre.leggauss(14)
    angle = 2 * np.pi * np.arange(28) / 28
    rim = np.sqrt(1 - node**2)[:, None]
    sphere = np.stack(
        [rim * np.cos(angle), rim * np.sin(angle), np.broadcast_to(node[:, None], (14, 28))], -1
    )
    for centre, radius in [((0.7, -0.4, 0.6), 0.2), ((2.0, 1.0, 1.5), 0.4)]:
        around = pw.amplitude(SOURCES[name], centre + radius * sphere, 1.0, method, tolerance=TIGHT)
        mean = weight @ around.mean(axis=1) / 2
        field = pw.amplitude(SOURCES[name], centre, 1.0, method, tolerance=TIGHT)
        # what 14 x 28 nodes leave out, harmonics of order 28, is (radius/height)^28
        assert abs(mean - field * np.sinc(2 * radius)) <= ROUNDING


def test_close_to_the_opening_the_field_is_the_one_given() -> None:
    """Rayleigh and Sommerfeld's first integral takes the value there, the second the slope."""
    height = 1e-6
    inside, outside = (0.3, -0.7, height), (HALF + 0.2, 0.1, height)
    for direction in ((0.0, 0.0), (0.6, 0.3), (1.3, 0.2)):
        source = tilted(SQUARE, *direction)
        wave = np.exp(2j * np.pi * np.dot(direction, inside[:2]))
        field = pw.amplitude(source, [inside, outside], 1.0)
        # it changes by the height times the slope
        assert abs(field[0] - wave) <= 40 * height and abs(field[1]) <= 40 * height
        pz = np.sqrt(complex(1 - np.dot(direction, direction)))
        step = np.array([0.0, 0.0, 1e-5])
        above = pw.amplitude(source, [inside + step, inside], 1.0, "rayleigh-sommerfeld-2")
        slope = (above[0] - above[1]) / step[2]
        assert slope == pytest.approx(2j * np.pi * pz * wave, abs=1e-3)


@methods
def test_a_whole_is_the_sum_of_its_parts(method: Any) -> None:
    whole = pw.Aperture([(-1, -1), (2, -1), (2, 1.5), (-1, 1.5)])
    parts = [
        pw.Aperture([(-1, -1), (0.3, -1), (0.8, 1.5), (-1, 1.5)]),
        pw.Aperture([(0.3, -1), (2, -1), (2, 1.5), (0.8, 1.5)]),
    ]
    field = waves([1.0, 0.5j], [(0.2, 0.1), (-0.5, 0.4)])
    fields = [
        pw.amplitude(s.with_illumination(field), HARD_POINTS, 1.0, method, tolerance=TIGHT)
        for s in (whole, *parts)
    ]
    np.testing.assert_allclose(fields[0], fields[1] + fields[2], rtol=0, atol=ROUNDING)


@methods
def test_kirchhoffs_field_is_the_mean_of_rayleighs_and_sommerfelds(method: Any) -> None:
    first, second, mean = (
        pw.amplitude(SOURCES["oblique"], HARD_POINTS, 1.0, m, tolerance=TIGHT) for m in METHODS
    )
    np.testing.assert_allclose(mean, (first + second) / 2, rtol=0, atol=ROUNDING)


@methods
def test_the_field_turns_and_is_mirrored_with_its_source(method: Any) -> None:
    c, s = math.cos(0.7), math.sin(0.7)
    for plane in (np.array([[c, -s], [s, c]]), np.array([[1.0, 0.0], [0.0, -1.0]])):
        field = waves([1.0, 0.4j], [(0.3, 0.2), (1.2, -0.3)])
        moved = waves([1.0, 0.4j], field.frequencies @ plane.T)
        outline = shapely.transform(ELL.polygons, lambda p, m=plane: p @ m.T)
        if np.linalg.det(plane) < 0:
            outline = shapely.MultiPolygon([q.reverse() for q in outline.geoms])
        order = np.lexsort(field.frequencies.T[::-1])
        moved = waves(field.amplitudes[order], field.frequencies[order] @ plane.T)
        source, image = ELL.with_illumination(field), pw.Aperture(outline).with_illumination(moved)
        space = np.eye(3)
        space[:2, :2] = plane
        np.testing.assert_allclose(
            pw.amplitude(image, HARD_POINTS @ space.T, 1.0, method, tolerance=TIGHT),
            pw.amplitude(source, HARD_POINTS, 1.0, method, tolerance=TIGHT),
            rtol=0,
            atol=10 * ROUNDING,
        )


def test_source_and_observer_of_kirchhoffs_far_field_may_change_places() -> None:
    there, back = np.array([0.3, -0.5]), np.array([-0.6, 0.2])
    distance = 1e7
    fields = []
    for wave, look in ((there, back), (-back, -there)):
        direction = np.array([*look, math.sqrt(1 - look @ look)])
        fields.append(pw.amplitude(tilted(ELL, *wave), distance * direction, 1.0, "kirchhoff"))
    # they differ by the curvature of the front, D^2/r
    assert fields[0] == pytest.approx(fields[1], rel=1e-5, abs=0.0)


@methods
def test_far_away_fields_are_fraunhofers(method: Any) -> None:
    """And come closer to it as 1/r, up to a million wavelengths."""
    direction = np.array([0.4, -0.3, math.sqrt(0.75)])
    source = ELL.with_illumination(waves([1.0, 0.3j], [(0.3, 0.1), (1.4, 0.2)]))
    misses = []
    for distance in (1e2, 1e4, 1e6):
        place = distance * direction
        exact = pw.amplitude(source, place, 1.0, method, tolerance=TIGHT)
        far = pw.amplitude(source, place, 1.0, "fraunhofer", obliquity=method)
        misses.append(abs(exact - far) / abs(far))
    assert misses[0] < 0.2
    # a hundred times closer each time; phases of 1e6 wavelengths are good to 1e-9
    assert misses[0] / misses[1] == pytest.approx(100, rel=0.1)
    assert misses[1] / misses[2] == pytest.approx(100, rel=0.1)


def test_an_array_is_the_sum_of_its_elements_in_their_places() -> None:
    rng = np.random.default_rng(5)
    positions = np.stack(np.meshgrid(np.arange(32), np.arange(32)), -1).reshape(-1, 2) * 0.5
    weights = rng.normal(size=1024) + 1j * rng.normal(size=1024)
    element = pw.shapes.square(0.45).with_illumination(waves([0.7, 0.3], [(0.2, 0), (-0.4, 0.6)]))
    array = pw.phased_array(element, positions, weights)
    points = np.array([(7.3, 8.1, 0.3), (20.0, -3.0, 5.0), (100.0, 50.0, 3e3)])
    got = pw.amplitude(array, points, 1.0, "kirchhoff", tolerance=TIGHT)
    shifted = points[:, None] - np.append(positions, np.zeros((1024, 1)), axis=1)
    expected = pw.amplitude(element, shifted, 1.0, "kirchhoff", tolerance=TIGHT) @ weights
    # 1024 terms of modulus about 1
    np.testing.assert_allclose(got, expected, rtol=0, atol=1e-10)


def test_memory_does_not_grow_with_the_number_of_elements(monkeypatch: pytest.MonkeyPatch) -> None:
    """Beyond as many panels as are taken at a time, here fewer than usual."""
    monkeypatch.setattr(boundary, "_ROWS", 512)
    points = np.array([(0.0, 0.0, 3.0), (5.0, 1.0, 20.0)])
    peaks = []
    for count in (128, 1024):
        positions = np.random.default_rng(2).uniform(-30, 30, (count, 2))
        array = pw.phased_array(pw.shapes.square(0.4), positions)
        tracemalloc.start()
        pw.amplitude(array, points, 1.0, tolerance=1e-2, engine="numpy")
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    assert peaks[1] < 1.5 * peaks[0]


def test_elements_of_an_array_may_be_of_any_kind() -> None:
    flat = np.eye(4)
    flat[:2, :2], flat[0, 3] = [[0, -1], [1, 0]], 2.5
    array = pw.Array([TE10, ELL.placed(flat), tilted(DISJOINT, 1.1, 0.4)], [1, 2j, 0.5])
    expected = (
        pw.amplitude(TE10, HARD_POINTS, 1.0)
        + 2j * pw.amplitude(pw.Array([ELL.placed(flat)]), HARD_POINTS, 1.0)
        + 0.5 * pw.amplitude(tilted(DISJOINT, 1.1, 0.4), HARD_POINTS, 1.0)
    )
    np.testing.assert_allclose(pw.amplitude(array, HARD_POINTS, 1.0), expected, atol=5e-9, rtol=0)


EXACT = [(p, m) for p in ("double", "single") for m in METHODS]


@pytest.mark.parametrize(
    ("precision", "method", "engine"),
    numpy_and_few(
        EXACT,
        [("double", "kirchhoff")],  # both terms of the sum along edges
        slow=[case for case in EXACT if case != ("double", "kirchhoff")],
    ),
)
def test_engines_agree(engine: Any, precision: Any, method: Any) -> None:
    source = pw.Array([SOURCES["oblique"], SOURCES["evanescent"]], [1, 0.5j])
    expected = pw.amplitude(source, HARD_POINTS, 1.0, method, tolerance=TIGHT, engine="numpy")
    got = pw.amplitude(
        source, HARD_POINTS, 1.0, method, precision=precision, engine=engine, tolerance=1e-5
    )
    assert got.dtype == (np.complex128 if precision == "double" else np.complex64)
    np.testing.assert_allclose(got, expected, rtol=0, atol=3 * SINGLE)


@engines
@methods
def test_single_precision_keeps_phases_at_a_hundred_thousand_wavelengths(
    engine: Any, method: Any
) -> None:
    rng = np.random.default_rng(3)
    points = 1e5 * rng.normal(size=(50, 3))
    points[:, 2] = np.abs(points[:, 2]) + 1e3
    # in the beam of a wide aperture as well, where direct wave and edges interfere
    wide = tilted(pw.shapes.square(200.0), 0.3, 0.2)
    direct = np.array([0.3, 0.2, math.sqrt(0.87)]) * 1e4 + rng.normal(0, 60, (20, 3)) * [1, 1, 0]
    # rounding of a length of 200 wavelengths is 1e-5 of a wavelength
    tries: Any = ((ELL, points, 1e-6), (wide, direct, 1e-4))
    for source, places, allowed in tries:
        exact, error = pw.amplitude(source, places, 1.0, method, return_error=True)
        got = pw.amplitude(
            source, places, 1.0, method, tolerance=1e-4, precision="single", engine=engine
        )
        size = source.area / np.linalg.norm(places, axis=1)
        assert np.all(error <= 1e-9 * size)
        assert np.all(np.abs(got - exact) <= allowed * np.minimum(size, 1.0))


def test_the_error_is_estimated_and_kept_below_the_tolerance() -> None:
    rng = np.random.default_rng(1)
    points = rng.uniform((-3, -3, 0), (3, 3, 4), (400, 3))
    points[:200, 2] = 10.0 ** rng.uniform(-5, 0, 200)
    for name in ("square", "nearly grazing", "TE10", "evanescent"):
        exact = pw.amplitude(SOURCES[name], points, 1.0, "kirchhoff", tolerance=1e-13)
        for tolerance in (1e-2, 1e-4, 1e-8):
            got, error = pw.amplitude(
                SOURCES[name], points, 1.0, "kirchhoff", tolerance=tolerance, return_error=True
            )
            true = np.abs(got - exact)
            assert np.all(true <= error + 1e-13)
            assert np.all(error <= tolerance)
            # and no effort is wasted on digits that nobody asked for
            assert error.max() > 1e-4 * tolerance


def test_one_point_gives_a_number_and_no_points_an_empty_array() -> None:
    field = pw.amplitude(SQUARE, (0, 0, 1), 1.0)
    assert isinstance(field, np.complex128)
    value, error = pw.amplitude(SQUARE, (0, 0, 1), 1.0, return_error=True)
    assert value == field and isinstance(error, np.float64)
    assert pw.amplitude(SQUARE, np.empty((0, 4, 3)), 1.0).shape == (0, 4)


@pytest.mark.parametrize(
    ("arguments", "options", "says"),
    [
        ((pw.Slits([[0, 1]]), (0, 0, 1), 1.0), {}, "Slits"),
        ((pw.Array([pw.Slits([[0, 1]])]), (0, 0, 1), 1.0), {}, "Slits"),
        ((SQUARE, (0, 0, -1), 1.0), {}, "z > 0"),
        ((SQUARE, (0, 0, 1), 0.0), {}, "wavelength"),
        ((SQUARE, (0, 0, 1), 1.0, "rs1"), {}, "rayleigh-sommerfeld-2"),
        ((SQUARE, (0, 0, 1), 1.0, "wigner"), {}, "polywigner.irradiance"),
        ((SQUARE.polygons, (0, 0, 1), 1.0), {}, "make one by Aperture("),
        ((SQUARE, (0, 0, 1), 1.0), {"tolerance": 1e-15}, "tolerance"),
        ((SQUARE, (0, 0, 1), 1.0), {"tolerance": 1e-9, "precision": "single"}, "double"),
        ((SQUARE, (0, 0, 1), 1.0), {"tolerance": 1.0}, "tolerance"),
        ((SQUARE, (0, 0, 1), 1.0), {"obliquity": "kirchhoff"}, "fraunhofer"),
        ((SQUARE, (0, 0, 1), 1.0, "fraunhofer"), {"obliquity": "paper"}, "kirchhoff"),
        ((SQUARE, (0, 0, 1), 1.0), {"engine": "gpu"}, "engine"),
        ((SQUARE, (0, 0, 1), 1.0), {"precision": "half"}, "precision"),
    ],
)
def test_bad_arguments_are_refused_in_words(arguments: Any, options: Any, says: str) -> None:
    with pytest.raises(ArgumentError) as caught:
        pw.amplitude(*arguments, **options)
    assert says in str(caught.value)


def test_elements_off_the_plane_are_refused() -> None:
    lifted = np.eye(4)
    lifted[2, 3] = 0.1
    with pytest.raises(GeometryError, match="z = 0"):
        pw.amplitude(pw.Array([SQUARE, SQUARE.placed(lifted)]), (0, 0, 1), 1.0)


@methods
@pytest.mark.filterwarnings("ignore:got a source of")
@pytest.mark.filterwarnings("error")
def test_the_field_of_a_source_far_below_a_wavelength_is_as_good_as_promised(method: Any) -> None:
    """Well within a wavelength: exp(ikR)/R of a point, with the static field of its derivative."""
    wide, away = 1e-9, 1e-3
    patch = pw.shapes.square(wide)
    value, error = pw.amplitude(patch, (0.0, 0.0, away), 1.0, method, return_error=True)
    wave = wide**2 * np.exp(2j * math.pi * away) / away
    with_share = {"rayleigh-sommerfeld-1": 1.0, "kirchhoff": 0.5}.get(method, 0.0)
    expected = wave * (-1j + with_share / (2 * math.pi * away))
    far_below = 1e-6  # corrections are (wide/away)^2; rounding of sums along edges that cancel
    assert abs(value - expected) < far_below * abs(expected)
    assert error < far_below * abs(expected)


@pytest.mark.filterwarnings("error")
def test_on_an_edge_there_is_half_of_the_field_and_on_a_corner_a_quarter() -> None:
    edge, corner, height = (1.5, 0.0), (1.5, 1.5), 1e-70
    opening = pw.shapes.square(3.0)
    assert pw.amplitude(opening, (*edge, height), 1.0) == pytest.approx(0.5, abs=1e-9)
    assert pw.amplitude(opening, (*corner, height), 1.0) == pytest.approx(0.25, abs=1e-9)


@methods
@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("point", [(0, 0, 1e160), (1e160, 0, 1), (1.5, 1.5, 1e-300)])
def test_lengths_whose_squares_floats_cannot_be_are_refused(method: Any, point: Any) -> None:
    with pytest.raises(ArgumentError, match=r"expected lengths between .* use a unit"):
        pw.amplitude(pw.shapes.square(3.0), point, 1.0, method)


@methods
@pytest.mark.filterwarnings("error")
def test_a_point_as_far_away_as_the_universe_sees_a_spherical_wave(method: Any) -> None:
    far = 1e40
    value = pw.amplitude(pw.shapes.square(3.0), (0, 0, far), 1.0, method)
    assert abs(value) == pytest.approx(9.0 / far, rel=1e-9, abs=0.0)


@pytest.mark.parametrize("wavelength", [1e-10, 1e-30])
def test_edges_of_too_many_wavelengths_are_refused_with_a_word_on_units(wavelength: float) -> None:
    with pytest.raises(ArgumentError, match=r"edges of at most .* check the unit"):
        pw.amplitude(pw.shapes.square(1.0), (0.0, 0.0, 1.0), wavelength)
