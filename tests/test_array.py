"""Coherent collections with complex weights, against exact slices of every pair of elements."""

import copy
import math
import pickle

import numpy as np
import pytest
import shapely

import polywigner as pw
from polywigner.errors import ArgumentError, GeometryError, IlluminationError

SQUARE = pw.Aperture(shapely.box(-0.5, -0.5, 0.5, 0.5))
BESIDE = pw.Aperture(shapely.box(0.5, -0.5, 1.5, 0.5))  # shares a side with SQUARE
ACROSS = pw.Aperture(shapely.box(0.25, 0.0, 1.25, 1.0))  # overlaps both
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
    """A pose: a rotation about an axis through the origin, then a shift."""
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


def test_every_source_of_the_plane_or_the_line_names_its_elements():
    slits = pw.Slits([[0, 1], [2, 3]])
    assert SQUARE.elements_in_plane == (SQUARE,)
    assert slits.elements_in_plane == (slits,)
    for source in (SQUARE, slits):
        assert pw.Array([source, source]).elements_in_plane == (source, source)
        with pytest.warns(DeprecationWarning, match="elements_in_plane"):
            assert pw.Array([source]).coplanar == (source,)


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
TILTED = SQUARE.placed(_turned((1, 0, 0), 5, (0, 0, 0)))
RAISED = SQUARE.placed(_turned((1, 0, 0), 0, (0, 0, 0.25)))


@pytest.mark.parametrize(
    ("call", "error", "message"),
    [
        (lambda: pw.Array(SQUARE), ArgumentError, "put it into a list"),
        (lambda: pw.Array([]), ArgumentError, "none"),
        (lambda: pw.Array([SQUARE, "b"]), ArgumentError, "str at 1"),
        (lambda: pw.Array([SQUARE, SLIT_ARRAY]), ArgumentError, "join its elements"),
        (lambda: pw.Array([SQUARE, pw.Slits([0, 1])]), ArgumentError, "one dimension"),
        (lambda: pw.Array([SQUARE], [1, 2]), IlluminationError, r"1 elements, got shape \(2,\)"),
        (lambda: pw.Array([SQUARE], ["a"]), IlluminationError, "complex weights"),
        (lambda: pw.Array([SQUARE], [np.nan]), IlluminationError, "finite"),
        (lambda: pw.Array([SQUARE], [0.0]), IlluminationError, "zeros only"),
        (lambda: pw.Array([SQUARE], np.ma.masked_equal([1], 1)), IlluminationError, "masked"),
        (lambda: pw.wigner(MIXED, ZERO, ZERO), GeometryError, "leans by"),
        (lambda: pw.wigner(pw.Array([TETRAHEDRON]), ZERO, ZERO), GeometryError, "Polyhedron at 0"),
        (lambda: pw.wigner(pw.Array([TILTED]), ZERO, ZERO), GeometryError, "leans by 5 degrees"),
        (lambda: pw.ambiguity(pw.Array([RAISED]), ZERO, ZERO), GeometryError, "z = 0.25"),
        (lambda: pw.fourier(MIXED, ZERO), ArgumentError, "shape"),
        (lambda: pw.fourier(SQUARE, ZERO, obliquity="paper"), ArgumentError, "shape"),
        (lambda: pw.fourier(SQUARE, ZERO, obliquity="cos"), ArgumentError, "'paper'"),
        (
            lambda: pw.fourier(MIXED, np.ones(3), obliquity="paper"),
            ArgumentError,
            "Polyhedron, which has no normal",
        ),
        (lambda: SLIT_ARRAY.placed(np.eye(4)), GeometryError, "Slits"),
        (lambda: SLIT_ARRAY.support, GeometryError, "Slits"),
        (lambda: pw.automean(COLLECTIONS["touching"]), ArgumentError, "Aperture"),
    ],
)
def test_bad_collections_are_refused_with_advice(call, error, message):
    with pytest.raises(error, match=message):
        call()
