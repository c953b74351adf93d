"""Coherent arrays with complex weights against exact slices of every pair of elements."""

import copy
import math
import pickle

import numpy as np
import pytest
import shapely

import polywigner as pw
from polywigner import arrays
from polywigner.errors import ArgumentError, GeometryError, IlluminationError

SQUARE = pw.Aperture(shapely.box(-0.5, -0.5, 0.5, 0.5))
BESIDE = pw.Aperture(shapely.box(0.5, -0.5, 1.5, 0.5))  # shares a side with SQUARE
ACROSS = pw.Aperture(shapely.box(0.25, 0.0, 1.25, 1.0))  # overlaps SQUARE
FRAME = pw.Aperture(shapely.box(2, -0.5, 3, 0.5) - shapely.box(2.25, -0.25, 2.75, 0.25))
LEANING = pw.Aperture([[-1, -0.5], [-0.5, -0.5], [-0.5, 0.5], [-1, 0.5 + 1e-6]])
TRIANGLE = pw.Aperture([[2, 0], [3, 0.25], [2.25, 1.125]])

COLLECTIONS = {
    "touching": pw.Array([SQUARE, BESIDE], [1.0, 0.5 - 1.5j]),
    "overlapping": pw.Array([SQUARE, ACROSS, BESIDE], [1.0, 1j, -0.75]),
    "coinciding": pw.Array([SQUARE, SQUARE, FRAME], [1.0, -0.25 + 0.5j, 1 + 1j]),
    "leaning": pw.Array([SQUARE, LEANING, TRIANGLE], [1.0, -1j, 0.5]),
    "real weights": pw.Array([SQUARE, ACROSS, TRIANGLE], [1.0, -0.5, 2.0]),
    "equal weights": pw.Array([SQUARE, ACROSS, FRAME]),
}


SLIT_ARRAY = pw.Array(
    [pw.Slits([[-1, -0.4], [0.1, 0.9]]), pw.Slits([0.5, 1.5]), pw.Slits([-0.4, 0.1])],
    [1.0, 0.5 - 1j, 2j],
)


def _turned(axis, degrees, shift):
    """Return a pose: a rotation about an axis through the origin, then a shift."""
    x, y, z = np.array(axis) / np.linalg.norm(axis)
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    angle = math.radians(degrees)
    pose = np.eye(4)
    pose[:3, :3] += math.sin(angle) * cross + (1 - math.cos(angle)) * cross @ cross
    pose[:3, 3] = shift
    return pose


TETRAHEDRON = pw.Polyhedron(
    [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], [[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]]
)
MIXED = pw.Array(
    [SQUARE, TRIANGLE.placed(_turned((1, 2, 3), 50, (0.5, -1, 2))), TETRAHEDRON],
    [1.0, 0.5 - 2j, 1j],
)


def test_elements_posed_within_the_plane_are_coplanar():
    posed = pw.Array([TRIANGLE.placed(_turned((0, 0, 1), 90, (1, 2, 0))), SQUARE], [1.0, 1j])
    flat = pw.Array([pw.Aperture([[1, 4], [0.75, 5], [-0.125, 4.25]]), SQUARE], [1.0, 1j])
    x, nu = np.random.default_rng(13).uniform(-1, 3, (2, 40, 2))
    assert pw.wigner(posed, x, nu) == pytest.approx(pw.wigner(flat, x, nu), abs=1e-12)
    turned_over = pw.Array([TRIANGLE.placed(_turned((1, 0, 0), 180, (0, 0, 0)))])
    mirrored = pw.Aperture(TRIANGLE.rings[0] * [1, -1])
    assert turned_over.support.polygons.equals_exact(mirrored.polygons, 1e-15)


def test_support_of_overlapping_elements_and_its_automean():
    array = COLLECTIONS["overlapping"]
    union = shapely.union_all([e.polygons for e in array.elements])
    assert array.support.polygons.symmetric_difference(union).area < 1e-12
    outside = np.random.default_rng(14).uniform(-2, 3, (400, 2))
    mean = pw.automean(array.support).polygons
    outside = outside[~shapely.contains_xy(shapely.buffer(mean, 1e-6), *outside.T)]
    assert (pw.position_marginal(array, outside) == 0).all()


def test_arrays_are_values():
    array = COLLECTIONS["touching"]
    same = pw.Array(list(array.elements), [1.0, 0.5 - 1.5j])
    assert array == same and hash(array) == hash(same)
    assert array != pw.Array(array.elements) and array != "array"
    assert pickle.loads(pickle.dumps(array)) == array == copy.deepcopy(array)
    assert len({array, same, MIXED}) == 2
    assert pw.Array([SQUARE], [-0.0 + 1j]) == pw.Array([SQUARE], [1j])
    assert hash(pw.Array([SQUARE], [-0.0 + 1j])) == hash(pw.Array([SQUARE], [1j]))
    with pytest.raises(AttributeError, match="build a new one"):
        array.weights = np.ones(2)
    with pytest.raises(ValueError, match="read-only"):
        array.weights[0] = 2.0
    assert repr(MIXED).startswith("Array(1 x Aperture, 1 x PlacedAperture, 1 x Polyhedron")
    copies = pw.phased_array(SQUARE, [[0.0, 0.0], [3.0, 0.0]])
    assert repr(copies) == "Array(2 x Aperture, weights all 1)"
    assert [a.dimension for a in (SLIT_ARRAY, array, MIXED)] == [1, 2, 3]


ZERO = np.zeros(2)
FLAT = [[0, 0], [1, 0]]
WAVELENGTH = 3.189e-3
TILTED = SQUARE.placed(_turned((1, 0, 0), 5, (0, 0, 0)))
RAISED = SQUARE.placed(_turned((1, 0, 0), 0, (0, 0, 0.25)))


BAD = {
    ArgumentError: [
        (lambda: pw.Array(SQUARE), "pass a list of elements"),
        (lambda: pw.Array([]), "none"),
        (lambda: pw.Array([SQUARE, "b"]), "str as element 1"),
        (lambda: pw.Array([SQUARE, SLIT_ARRAY]), "pass its elements"),
        (lambda: pw.Array([SQUARE, pw.Slits([0, 1])]), "one dimension"),
        (lambda: pw.fourier(MIXED, ZERO), "shape"),
        (lambda: pw.automean(COLLECTIONS["touching"]), "Aperture"),
        (lambda: pw.phased_array(None, [[0, 0]]), "to repeat, got NoneType"),
        (lambda: pw.phased_array(SQUARE, [0, 1]), r"\(n, 2\)"),
        (lambda: pw.phased_array(SQUARE, [[0, np.inf]]), "finite positions"),
        (lambda: pw.array_factor([[0, 0, 0, 0]], None, [0]), "positions"),
        (lambda: pw.array_factor([[0, 0]], None, [0.0]), "nu of shape"),
        (lambda: arrays.grid_positions(0, 3, 1.0), "nx"),
        (lambda: arrays.grid_positions(3, 3, 0.0), "pitch_x"),
        (lambda: arrays.grid_positions(2000, 2000, 1.0), "1048576 elements"),
        (lambda: arrays.ring_positions([1.0], [3, 4]), "as many radii"),
        (lambda: arrays.ring_positions([0.0], [3]), "one element at radius 0"),
        (lambda: pw.phased_array(pw.shapes.square(1.0), [[0, 0], [1]]), "different lengths"),
        (lambda: arrays.thinned([[0, 0]], 0.0, 1), "fill"),
        (lambda: arrays.thinned([[0, 0], [1, 1]], 0.6, 1, [1, 0.1]), "up to 0.55"),
        (lambda: arrays.thinned([[0, 0]], 1e-9, 1), "another seed"),
        (lambda: arrays.steering_weights([[0, 0, 0]], (0, 1), 1.0), "unit vector"),
        (lambda: arrays.steering_weights([[0, np.nan]], (0, 0, 1), 1.0), "finite positions"),
        (lambda: arrays.focusing_weights([[0, 0]], (0, 0, 0), 1.0), "z above zero"),
        (lambda: arrays.window_weights(4, "kaiser"), 'window to be one of "uniform", "taylor"'),
        (lambda: pw.steering((0, 0.1, 1), WAVELENGTH), "length 1.00499"),
        (lambda: pw.steering((0, 0.6, -0.8), WAVELENGTH), "z component of at least 0"),
        (lambda: pw.steering((0.8, 0.7), WAVELENGTH), "norm 1.06"),
        (lambda: pw.steering((0, 0, 0, 1), WAVELENGTH), "unit vector"),
        (lambda: pw.steering((0, np.nan, 1), WAVELENGTH), "finite"),
        (lambda: pw.steering((0, 0, 1), 0), "wavelength"),
        (lambda: pw.uniform(3), "dimension"),
        (lambda: pw.cosine_taper(None), "expected a width"),
        (lambda: pw.cosine_taper(1e-2, -6e-3), "height"),
        (lambda: pw.cosine_taper(1e-2, power=0), "power"),
        (lambda: pw.cosine_taper(1e-2, 6e-3, dimension=1), "height=None"),
        (lambda: pw.te_mode(1e-2, 6e-3, 0, 0), "m of at least 1"),
        (lambda: pw.te_mode(1e-2, 6e-3, 0, 1), "TE_01 has no y component"),
        (lambda: pw.te_mode(1e-2, 6e-3, 1, 0, component="z"), "component"),
        (lambda: pw.taylor_taper(1e-2, sll=-30), "30 for sidelobes at -30 dB"),
        (lambda: pw.taylor_taper(1e-2, nbar=101), "nbar"),
        (lambda: pw.fit_illumination([[0, 0], [1, 1]], [1]), "2 points"),
        (lambda: pw.fit_illumination([[0, np.inf]], [1]), "finite"),
        (lambda: pw.fit_illumination([[0, 0]], [np.nan]), "finite"),
        (lambda: pw.fit_illumination([[0, 0]], ["a"]), "finite"),
        (lambda: pw.fit_illumination(FLAT, [1, 0], cut_off=1.0), "cut_off"),
        (lambda: pw.fit_illumination(FLAT, [1, 0], order=-1), "order"),
    ],
    IlluminationError: [
        (lambda: pw.Array([SQUARE], [1, 2]), r"1 elements, got an array of shape \(2,\)"),
        (lambda: pw.Array([SQUARE], ["a"]), "complex weights"),
        (lambda: pw.Array([SQUARE], [np.nan]), "finite"),
        (lambda: pw.Array([SQUARE], [0.0]), "not all zero"),
        (lambda: pw.Array([SQUARE], np.ma.masked_equal([1], 1)), "masked"),
        (lambda: pw.fit_illumination(FLAT, [0, 0]), "zeros"),
        (lambda: pw.fit_illumination([[0, 0]], [1], [1.0, 2.0, 3.0]), "2"),
        (lambda: pw.fit_illumination(FLAT, [1, 0], np.zeros((0, 2))), "one"),
    ],
    GeometryError: [
        (lambda: pw.wigner(MIXED, ZERO, ZERO), "a tilt of"),
        (lambda: pw.wigner(pw.Array([TETRAHEDRON]), ZERO, ZERO), "Polyhedron for element 0"),
        (lambda: pw.wigner(pw.Array([TILTED]), ZERO, ZERO), "a tilt of 5 degrees"),
        (lambda: pw.ambiguity(pw.Array([RAISED]), ZERO, ZERO), "z = 0.25"),
        (lambda: SLIT_ARRAY.support, "array of slits"),
        (lambda: pw.Slits([[0, 1], [0.5, 2]]), "do not overlap"),
        (lambda: pw.Slits([[0, 0]]), "wider than zero"),
        (lambda: pw.Slits([[0, math.nan]]), "finite"),
        (lambda: pw.Slits([0, 1, 2]), r"\(m, 2\)"),
        (lambda: pw.Slits([]), r"\(m, 2\)"),
        (lambda: pw.Slits("slit"), r"\(m, 2\)"),
        (lambda: pw.Slits(np.array([[0, 1j]])), r"\(m, 2\)"),
        (lambda: pw.Slits(np.ma.masked_equal([[0.0, 1.0]], 1.0)), "masked"),
    ],
}


@pytest.mark.parametrize("engine", ["numpy", "llvm"])
def test_an_overlapping_element_of_weight_zero_contributes_nothing(engine):
    rng = np.random.default_rng(5)
    x, nu = rng.uniform(-0.5, 0.5, (50, 2)), rng.uniform(-3, 3, (50, 2))
    array = pw.Array([SQUARE, ACROSS], [1.0, 0.0])
    got = pw.wigner(array, x, nu, engine=engine)
    assert np.abs(got - pw.wigner(SQUARE, x, nu, engine=engine)).max() < 1e-14
    got = pw.ambiguity(array, nu, x, engine=engine)
    assert np.abs(got - pw.ambiguity(SQUARE, nu, x, engine=engine)).max() < 1e-14


@pytest.mark.parametrize(
    ("error", "call", "message"), [(error, *row) for error, rows in BAD.items() for row in rows]
)
def test_bad_sources_fields_and_layouts_are_refused_with_advice(error, call, message):
    with pytest.raises(error, match=message):
        call()
