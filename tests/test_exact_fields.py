"""Exact fields by integrals along edges, against integrals over the opening and physics.

Lengths are in wavelengths.
"""

import math
from typing import Any

import numpy as np
import pytest
import shapely

import polywigner as pw
from oracles.references import numpy_and_few
from oracles.surface_integrals import field_by_quadrature, surface_fields
from polywigner.errors import ArgumentError, GeometryError
from polywigner.propagation.boundary import radiator_of
from polywigner.scattering.near_fields import field_gradient

METHODS: tuple[Any, ...] = ("rayleigh-sommerfeld-1", "rayleigh-sommerfeld-2", "kirchhoff")
methods = pytest.mark.parametrize("method", METHODS)

TIGHT = 1e-12
"""Tolerance asked for."""
QUADRATURE = 1e-10
"""Relative; the quadrature over the opening reaches some 1e-12, less at points near it."""
ROUNDING = 1e-12
"""Of fields of order 1: two ways to add up some hundred terms."""

HALF = 1.568  # half side of a 10 mm square at 94 GHz
SQUARE = pw.shapes.square(2 * HALF)
ELL = pw.Aperture([[-1.5, -1.5], [1.5, -1.5], [1.5, -0.5], [-0.4, -0.5], [-0.4, 1.5], [-1.5, 1.5]])
HOLED = pw.Aperture(
    shapely.Polygon(
        [(-1.6, -1.4), (1.8, -1.2), (1.3, 1.6), (-1.5, 1.3)],
        [[(-0.5, -0.5), (0.2, -0.4), (0.6, 0.5), (-0.3, 0.6)]],
    )
)
DISJOINT = pw.Aperture([[(-2, -1), (-0.5, -1), (-0.5, 1)], [(0.3, -1), (1.8, -0.8), (1.2, 1.1)]])


def waves(amplitudes, directions):
    return pw.Illumination(amplitudes, directions)


def tilted(source, *p):
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
        (HALF, 0.2, 0.5),  # above an edge of the square
        (HALF, HALF, 0.5),  # above a vertex
        (HALF + 1e-7, -0.3, 0.5),  # 1e-7 from the edge
        (-1.5, -1.5, 0.5),  # above a vertex of the L
        (-0.4, 0.3, 0.1),  # close to an inner edge
        (0.1, 0.05, 0.02),  # close to the plane
        (HALF + 0.5 / math.sqrt(0.66) * 2, 0.4, 2.0),  # shadow boundary of the oblique wave
        (2.5, 3.0, 1.0),
        (8.0, -3.0, 12.0),
        (0.0, 0.0, 30.0),
    ]
)


@pytest.mark.parametrize("name", SOURCES)
def test_integrals_along_edges_are_those_over_the_opening(name):
    source = SOURCES[name]
    expected = np.array([surface_fields(source, p, 1.0) for p in HARD_POINTS])
    for k, method in enumerate(METHODS):
        got = pw.amplitude(source, HARD_POINTS, 1.0, method, tolerance=TIGHT)
        # The slope of the grazing wave is zero up to rounding.
        allowed = QUADRATURE * np.abs(expected[:, k]) + 1e-15
        assert np.all(np.abs(got - expected[:, k]) <= allowed)


@pytest.mark.parametrize("direction", [(0.0, 0.0), (0.5, 0.2), (-0.9, 0.3)])
@methods
def test_nothing_jumps_at_the_boundary_of_the_shadow(direction, method):
    """The points are on the ray through a point of an edge, and at small distances from the ray."""
    source = tilted(SQUARE, *direction)
    p = np.array([*direction, math.sqrt(1 - np.dot(direction, direction))])
    # Quadrature rules with an odd number of nodes have a node at the centre of the edge, on the ray
    # itself.
    for start in ((HALF, 0.0), (HALF, HALF)):
        for height in (0.5, 200.0):
            ray = np.append(start, 0.0) + p * height / p[2]
            offsets = np.array([0.0, *np.geomspace(1e-15, 1e-3, 13)])
            beside = np.concatenate([-offsets[::-1], offsets])
            points = ray + beside[:, None] * [1.0, 0.0, 0.0]
            field = pw.amplitude(source, points, 1.0, method, tolerance=TIGHT)
            centre = field[len(offsets)]
            # A field of modulus 1 changes by 2 pi per wavelength, and the coordinate is rounded.
            slope = 2 * math.pi * 2
            rounding = 30 * np.spacing(np.abs(ray).max()) + ROUNDING
            assert np.all(np.abs(field - centre) <= slope * np.abs(beside) + rounding)


def test_close_to_the_opening_the_field_is_the_one_given():
    """The first integral has the value of the wave, and the second integral has its slope."""
    height = 1e-6
    inside, outside = (0.3, -0.7, height), (HALF + 0.2, 0.1, height)
    for direction in ((0.0, 0.0), (0.6, 0.3), (1.3, 0.2)):
        source = tilted(SQUARE, *direction)
        wave = np.exp(2j * np.pi * np.dot(direction, inside[:2]))
        field = pw.amplitude(source, [inside, outside], 1.0)
        # The field changes by the slope times the height above the opening.
        assert abs(field[0] - wave) <= 40 * height and abs(field[1]) <= 40 * height
        pz = np.sqrt(complex(1 - np.dot(direction, direction)))
        step = np.array([0.0, 0.0, 1e-5])
        above = pw.amplitude(source, [inside + step, inside], 1.0, "rayleigh-sommerfeld-2")
        slope = (above[0] - above[1]) / step[2]
        assert slope == pytest.approx(2j * np.pi * pz * wave, abs=1e-3)


LIFTED = pw.Array([SQUARE, SQUARE.placed(np.eye(4) + np.outer(*np.eye(4)[[2, 3]]))])


@pytest.mark.parametrize(
    ("method", "engine"),
    numpy_and_few(
        METHODS,
        ["kirchhoff"],  # both terms of the edge sum
        slow=[method for method in METHODS if method != "kirchhoff"],
    ),
)
def test_engines_agree(engine, method):
    source = pw.Array([SOURCES["oblique"], SOURCES["evanescent"]], [1, 0.5j])
    expected = pw.amplitude(source, HARD_POINTS, 1.0, method, tolerance=TIGHT, engine="numpy")
    got = pw.amplitude(source, HARD_POINTS, 1.0, method, engine=engine, tolerance=TIGHT)
    np.testing.assert_allclose(got, expected, rtol=0, atol=ROUNDING)


def test_the_error_is_estimated_and_kept_below_the_tolerance():
    rng = np.random.default_rng(1)
    points = rng.uniform((-3, -3, 0), (3, 3, 4), (200, 3))
    points[:100, 2] = 10.0 ** rng.uniform(-5, 0, 100)
    for name in ("square", "nearly grazing", "TE10", "evanescent"):
        exact = pw.amplitude(SOURCES[name], points, 1.0, "kirchhoff", tolerance=1e-13)
        for tolerance in (1e-2, 1e-4, 1e-8):
            got, error = pw.amplitude_with_error(
                SOURCES[name], points, 1.0, "kirchhoff", tolerance=tolerance
            )
            true = np.abs(got - exact)
            assert np.all(true <= error + 1e-13)
            assert np.all(error <= tolerance)
            # A larger tolerance needs fewer nodes.
            assert error.max() > 1e-4 * tolerance


def test_one_point_gives_a_number_and_no_points_an_empty_array():
    field = pw.amplitude(SQUARE, (0, 0, 1), 1.0)
    assert isinstance(field, np.complex128)
    value, error = pw.amplitude_with_error(SQUARE, (0, 0, 1), 1.0)
    assert value == field and isinstance(error, np.float64)
    assert pw.amplitude(SQUARE, np.empty((0, 4, 3)), 1.0).shape == (0, 4)


@pytest.mark.parametrize(
    ("arguments", "options", "says"),
    [
        ((pw.Slits([[0, 1]]), (0, 0, 1), 1.0), {}, "Slits"),
        ((LIFTED, (0, 0, 1), 1.0), {}, "z = 0"),
        ((SQUARE, (0, 0, -1), 1.0), {}, "z > 0"),
        ((SQUARE, (0, 0, 1), 1.0, "rs1"), {}, "rayleigh-sommerfeld-2"),
        ((SQUARE, (0, 0, 1), 1.0, "wigner"), {}, "polywigner.irradiance"),
        ((SQUARE, (0, 0, 1), 1.0), {"obliquity": "kirchhoff"}, "fraunhofer"),
    ],
)
def test_bad_arguments_are_refused_in_words(arguments, options, says):
    with pytest.raises((ArgumentError, GeometryError)) as caught:
        pw.amplitude(*arguments, **options)
    assert says in str(caught.value)


@methods
@pytest.mark.filterwarnings("ignore:implausible wavelength")
@pytest.mark.filterwarnings("error")
def test_the_field_of_a_source_far_below_a_wavelength_is_as_good_as_promised(method):
    """The field is exp(ikR)/R of a point source, with the static field of its derivative."""
    wide, away = 1e-9, 1e-3
    patch = pw.shapes.square(wide)
    value, error = pw.amplitude_with_error(patch, (0.0, 0.0, away), 1.0, method)
    wave = wide**2 * np.exp(2j * math.pi * away) / away
    with_share = {"rayleigh-sommerfeld-1": 1.0, "kirchhoff": 0.5}.get(method, 0.0)
    expected = wave * (-1j + with_share / (2 * math.pi * away))
    far_below = 1e-6  # corrections are (width/distance)^2; terms of edge sums cancel
    assert abs(value - expected) < far_below * abs(expected)
    assert error < far_below * abs(expected)


@pytest.mark.filterwarnings("error")
def test_on_an_edge_there_is_half_of_the_field_and_on_a_corner_a_quarter():
    result = pw.amplitude(pw.shapes.square(3.0), [(1.5, 0.0, 1e-70), (1.5, 1.5, 1e-70)], 1.0)
    assert result == pytest.approx([0.5, 0.25], abs=1e-9)


def test_edges_of_too_many_wavelengths_are_refused_with_a_word_on_units():
    with pytest.raises(ArgumentError, match=r"wavelengths along all edges.*check the unit"):
        pw.amplitude(pw.shapes.square(1.0), (0.0, 0.0, 1.0), 1e-10)


@pytest.mark.parametrize(
    ("name", "method"),
    [
        *(("with a hole", method) for method in METHODS),
        ("evanescent", "rayleigh-sommerfeld-2"),
        ("steered array", "kirchhoff"),
    ],
)
def test_gradients_are_those_of_integrals_over_the_opening(method, name):
    """Fourth-order differences have errors of (k step)^4/30 = 5e-11, and rounding."""
    points, step = np.array([[0.3, 0.6, 2.9], [-6.0, 3.0, 5.0]]), 1e-3
    result = field_gradient(radiator_of(SOURCES[name]), points, 1.0, method, 1e-9)
    for axis in range(3):
        moved = step * np.array([-2, -1, 1, 2])[:, None, None] * np.eye(3)[axis] + points
        fields = field_by_quadrature(SOURCES[name], moved.reshape(-1, 3), 1.0, method)
        slopes = np.array([1, -8, 8, -1]) @ fields.reshape(4, -1) / (12 * step)
        assert np.abs(result[:, axis] - slopes).max() < 1e-8 * np.abs(result).max()


@pytest.mark.llvm
@pytest.mark.parametrize(
    ("name", "call"),
    [
        ("points", lambda vector, _: pw.amplitude(SQUARE, vector, 1.0)),
        ("points", lambda vector, _: pw.field(SQUARE, vector, 1.0, "x")),
        ("source", lambda _, source: pw.amplitude(source, (0, 0, 3), 1.0)),
        ("to_radar", lambda vector, _: pw.rcs(SQUARE, vector, 1.0)),
        ("receiver", lambda _, source: pw.coupling(SQUARE, source, np.eye(4), 1.0)),
        ("nu", lambda vector, _: pw.fourier(SQUARE.curved(9.0, 1.0), vector)),
    ],
)  # fmt: skip
def test_arrays_of_drjit_are_refused_where_the_host_computes(name, call):
    from drjit.llvm import Array2f64, Array3f64

    source = pw.differentiable(vertices=Array2f64(np.concatenate(SQUARE.rings).T.copy()))
    with pytest.raises(ArgumentError, match=f"^expected {name} to be made of NumPy arrays, got"):
        call(Array3f64(0.0, 0.0, 3.0), source)
