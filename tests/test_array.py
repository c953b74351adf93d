"""Coherent collections with complex weights, against exact slices of every pair of elements."""

from __future__ import annotations

import copy
import itertools
import math
import pickle

import numpy as np
import pytest
import shapely
from hypothesis import strategies as st

import polywigner as pw
from oracles.references import ENGINES, numpy_and_few
from polywigner.errors import ArgumentError, GeometryError, IlluminationError, PolywignerError

# Relative to (sum |w| sqrt(content))^2, which bounds the sum over pairs in absolute values.
TOLERANCE = {"double": 1e-13, "single": 3e-6}

engines = pytest.mark.parametrize("engine", ENGINES)

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


def _scale(array: pw.Array) -> float:
    areas = [element.area for element in array.elements]
    return float((np.abs(array.weights) * np.sqrt(areas)).sum() ** 2)


def _special(array: pw.Array, count: int, seed: int) -> np.ndarray:
    """Midpoints of vertices and of points on edges, some an ulp or a little aside."""
    rng = np.random.default_rng(seed)
    corners = np.concatenate([ring for e in array.elements for ring in e.rings])
    pick = corners[rng.integers(len(corners), size=(4, count))]
    share = rng.choice([0.0, 0.5, 0.25, 0.3], (2, count, 1))
    ends = [pick[k] + share[k] * (pick[k + 2] - pick[k]) for k in (0, 1)]
    aside = rng.choice([0.0, 0.0, 1e-16, 1e-13, 1e-9], (count, 2)) * rng.normal(size=(count, 2))
    return np.stack([(ends[0] + ends[1]) / 2 + aside, ends[0] - ends[1] + aside])


def _frequencies(count: int, seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    size = 10 ** rng.uniform(-12, 2.5, (count, 1))
    angle = rng.choice([0.0, np.pi / 2, 1.0, 2.0], (count, 1))
    return size * np.hstack([np.cos(angle), np.sin(angle)])


@engines
def test_equal_weights_on_tiles_are_one_aperture(engine: str) -> None:
    tiles = [SQUARE, BESIDE, pw.Aperture(shapely.box(-0.5, 0.5, 1.5, 1.25))]
    array, whole = pw.Array(tiles, [0.6 - 0.8j] * 3), pw.shapes.rectangle(2.0, 1.75)
    shift = np.array([0.5, 0.375])
    (x, xi), nu = _special(array, 200, 4), _frequencies(200, 5)
    allowed = 4 * TOLERANCE["double"] * whole.area
    moved = pw.Aperture([ring + shift for ring in whole.rings])
    for transform, points in (
        (pw.wigner, (x, nu)),
        (pw.ambiguity, (nu, xi)),
        (pw.position_marginal, (x,)),
        (pw.lag_marginal, (xi,)),
        (pw.autocorrelation, (x, 0.77 * xi)),
    ):
        expected = transform(moved, *points, engine=engine)
        assert np.abs(transform(array, *points, engine=engine) - expected).max() < allowed
    expected = (0.6 - 0.8j) * pw.fourier(moved, nu, engine=engine)
    assert np.abs(pw.fourier(array, nu, engine=engine) - expected).max() < allowed


@engines
def test_opposite_weights_on_one_element_are_dark(engine: str) -> None:
    dark = pw.Array([TRIANGLE, TRIANGLE], [1 + 2j, -1 - 2j])
    (x, xi), nu = _special(dark, 50, 6), _frequencies(50, 7)
    allowed = TOLERANCE["double"] * _scale(dark)
    assert np.abs(pw.fourier(dark, nu, engine=engine)).max() == 0.0
    assert np.abs(pw.wigner(dark, x, nu, engine=engine)).max() < allowed
    assert np.abs(pw.ambiguity(dark, nu, xi, engine=engine)).max() < allowed
    assert np.abs(pw.autocorrelation(dark, x, xi, engine=engine)).max() == 0.0
    with pytest.raises(IlluminationError, match="light"):
        pw.otf(dark, [0.0, 0.0])
    almost = pw.Array(dark.elements, [1.0, -1.0 + 1e-9])  # |u|^2 = 1e-18 is lost in rounding
    with pytest.raises(IlluminationError, match="cancel"):
        pw.otf(almost, [0.0, 0.0])


weights = st.complex_numbers(max_magnitude=4, min_magnitude=0.25)


@engines
def test_otf_of_an_apodised_pupil(engine: str) -> None:
    # nested squares add up to a stepped taper; its OTF by a fine midpoint sum
    steps = [pw.shapes.square(side) for side in (1.0, 0.75, 0.5)]
    pupil = pw.Array(steps, [0.5, 0.25, 0.25])
    axis = (np.arange(256) + 0.5) / 256 - 0.5
    distance = np.maximum.outer(abs(axis), abs(axis))
    taper = 0.5 + 0.25 * (distance < 3 / 8) + 0.25 * (distance < 1 / 4)
    xi = np.array([[0.0, 0.0], [0.25, 0.0], [0.5, 0.125], [-0.125, 0.375]])
    expected = []
    for lag in xi:
        k, m = np.round(lag * 256).astype(int)
        shifted = np.zeros((768, 768))
        shifted[256:512, 256:512] = taper
        expected.append((np.roll(shifted, (k, m), (0, 1)) * shifted).sum() / (taper**2).sum())
    assert np.abs(pw.otf(pupil, xi, engine=engine) - expected).max() < 1e-12
    defocused = pw.otf(pupil, xi, defocus=0.5, engine=engine)
    assert defocused[0] == pytest.approx(1.0, abs=1e-13)
    assert (np.abs(defocused) <= 1 + 1e-13).all()


SLIT_ARRAY = pw.Array(
    [pw.Slits([[-1, -0.4], [0.1, 0.9]]), pw.Slits([0.5, 1.5]), pw.Slits([-0.4, 0.1])],
    [1.0, 0.5 - 1j, 2j],
)


def _turned(
    axis: tuple[float, float, float], degrees: float, shift: tuple[float, ...]
) -> np.ndarray:
    """A pose: a rotation about an axis through the origin, then a shift."""
    x, y, z = np.array(axis) / np.linalg.norm(axis)
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    angle = math.radians(degrees)
    pose = np.eye(4)
    pose[:3, :3] += math.sin(angle) * cross + (1 - math.cos(angle)) * cross @ cross
    pose[:3, 3] = shift
    return pose


TETRAHEDRON = pw.Polyhedron(
    [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]],
    [[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]],
)
MIXED = pw.Array(
    [SQUARE, TRIANGLE.placed(_turned((1, 2, 3), 50, (0.5, -1, 2))), TETRAHEDRON],
    [1.0, 0.5 - 2j, 1j],
)


@pytest.mark.parametrize(
    ("scale", "engine"), numpy_and_few([1.0, 1 + 0.5j], [1.0], slow=[1 + 0.5j])
)
def test_fourier_transform_of_a_mixed_collection_is_the_weighted_sum(
    scale: complex, engine: str
) -> None:
    nu = scale * np.random.default_rng(10).normal(size=(30, 3))
    expected = sum(
        w * pw.fourier(e, nu, engine=engine)
        for w, e in zip(MIXED.weights, MIXED.elements, strict=True)
    )
    got = pw.fourier(MIXED, nu, engine=engine)
    assert np.abs(got - expected).max() <= 4e-16 * np.abs(expected).max()
    assert pw.fourier(MIXED, nu, engine=engine, precision="single").dtype == np.complex64


def test_moving_a_whole_collection_turns_its_transform() -> None:
    pose = _turned((2, -1, 0.5), 75, (3, -2, 1))
    nu = np.random.default_rng(11).normal(size=(30, 3))
    moved = pw.fourier(MIXED.placed(pose), nu)
    expected = pw.fourier(MIXED, nu @ pose[:3, :3]) * np.exp(-2j * np.pi * nu @ pose[:3, 3])
    assert np.abs(moved - expected).max() < 1e-13


def _face_poses() -> list[np.ndarray]:
    """Poses of a unit square that make it the six faces of a cube around the origin."""
    front = _turned((0, 0, 1), 0, (0, 0, 0.5))
    sides = [_turned((0, 1, 0), angle, (0, 0, 0)) @ front for angle in (0, 90, 180, 270)]
    return [*sides, *(_turned((1, 0, 0), angle, (0, 0, 0)) @ front for angle in (90, -90))]


@pytest.mark.parametrize("scale", [1.0, 1 + 0.25j])
def test_faces_of_a_body_with_obliquity_radiate_like_its_volume(scale: complex) -> None:
    # divergence theorem: sum_j conj(nu).n_j F_j = -2 pi i |nu|^2 F(body)
    faces = pw.Array([SQUARE.placed(pose) for pose in _face_poses()])
    nu = scale * np.random.default_rng(12).normal(size=(30, 3))
    size = np.linalg.norm(nu, axis=-1)
    corners = np.array(list(itertools.product((-0.5, 0.5), repeat=3)))
    hull = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
    body = pw.fourier(pw.Polyhedron(corners, hull), nu)
    got = pw.fourier(faces, nu, obliquity="paper")
    assert np.abs(got + 2j * np.pi * size * body).max() < 1e-13 * np.abs(got).max()


def test_obliquity_is_the_cosine_at_which_a_wave_leaves() -> None:
    nu = np.array([[0, 0, 2.0], [2.0, 0, 0], [0, 0, -2.0], [3.0, 0, 4.0]])
    plain = pw.fourier(SQUARE, nu)
    assert pw.fourier(SQUARE, nu, obliquity="paper") == pytest.approx(plain * [1, 0, -1, 0.8])
    assert np.isnan(pw.fourier(SQUARE, [0.0, 0.0, 0.0], obliquity="paper"))
    assert pw.fourier(SQUARE, [0.0, 0.0, 1e-200], obliquity="paper") == pytest.approx(1.0)


def test_elements_posed_within_the_plane_are_coplanar() -> None:
    posed = pw.Array([TRIANGLE.placed(_turned((0, 0, 1), 90, (1, 2, 0))), SQUARE], [1.0, 1j])
    flat = pw.Array([pw.Aperture([[1, 4], [0.75, 5], [-0.125, 4.25]]), SQUARE], [1.0, 1j])
    x, nu = np.random.default_rng(13).uniform(-1, 3, (2, 40, 2))
    assert pw.wigner(posed, x, nu) == pytest.approx(pw.wigner(flat, x, nu), abs=1e-12)
    turned_over = pw.Array([TRIANGLE.placed(_turned((1, 0, 0), 180, (0, 0, 0)))])
    mirrored = pw.Aperture(TRIANGLE.rings[0] * [1, -1])
    assert turned_over.support.polygons.equals_exact(mirrored.polygons, 1e-15)


def test_every_source_of_the_plane_or_the_line_names_its_elements() -> None:
    slits = pw.Slits([[0, 1], [2, 3]])
    assert SQUARE.elements_in_plane == (SQUARE,)
    assert slits.elements_in_plane == (slits,)
    for source in (SQUARE, slits):
        assert pw.Array([source, source]).elements_in_plane == (source, source)
        with pytest.warns(DeprecationWarning, match="elements_in_plane"):
            assert pw.Array([source]).coplanar == (source,)


def test_support_of_overlapping_elements_and_its_automean() -> None:
    array = COLLECTIONS["overlapping"]
    union = shapely.union_all([e.polygons for e in array.elements])
    assert array.support.polygons.symmetric_difference(union).area < 1e-12
    outside = np.random.default_rng(14).uniform(-2, 3, (400, 2))
    mean = pw.automean(array.support).polygons
    outside = outside[~shapely.contains_xy(shapely.buffer(mean, 1e-6), *outside.T)]
    assert (pw.position_marginal(array, outside) == 0).all()


def test_arrays_are_values() -> None:
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
        (lambda: pw.Array(None), ArgumentError, "NoneType"),
        (lambda: pw.Array([SQUARE, "b"]), ArgumentError, "str at 1"),
        (lambda: pw.Array([SQUARE, SLIT_ARRAY]), ArgumentError, "join its elements"),
        (lambda: pw.Array([SQUARE, pw.Slits([0, 1])]), ArgumentError, "one dimension"),
        (lambda: pw.Array([SQUARE], [1, 2]), IlluminationError, r"1 elements, got shape \(2,\)"),
        (lambda: pw.Array([SQUARE], 1.0), IlluminationError, "one weight for each"),
        (lambda: pw.Array([SQUARE], ["a"]), IlluminationError, "complex weights"),
        (lambda: pw.Array([SQUARE], [np.nan]), IlluminationError, "finite"),
        (lambda: pw.Array([SQUARE], [0.0]), IlluminationError, "zeros only"),
        (lambda: pw.Array([SQUARE], ["1"]), IlluminationError, "complex weights"),
        (lambda: pw.Array([SQUARE], [1e200]), IlluminationError, "divide all by it"),
        (lambda: pw.Array([SQUARE], [1e-200]), IlluminationError, "divide all by it"),
        (lambda: pw.Array([SQUARE], np.ma.masked_equal([1], 1)), IlluminationError, "masked"),
        (lambda: pw.wigner(MIXED, ZERO, ZERO), GeometryError, "leans by"),
        (lambda: pw.wigner(pw.Array([TETRAHEDRON]), ZERO, ZERO), GeometryError, "Polyhedron at 0"),
        (lambda: pw.wigner(pw.Array([TILTED]), ZERO, ZERO), GeometryError, "leans by 5 degrees"),
        (lambda: pw.ambiguity(pw.Array([RAISED]), ZERO, ZERO), GeometryError, "z = 0.25"),
        (lambda: pw.otf(pw.Array([TILTED]), ZERO), GeometryError, "leans"),
        (lambda: pw.fourier(MIXED, ZERO), ArgumentError, "shape"),
        (lambda: pw.fourier(SQUARE, ZERO, obliquity="paper"), ArgumentError, "shape"),
        (lambda: pw.fourier(SQUARE, ZERO, obliquity="cos"), ArgumentError, "'paper'"),
        (lambda: pw.fourier(SQUARE, ZERO, obliquity=np.ones(2)), ArgumentError, "'paper'"),
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
def test_bad_collections_are_refused_with_advice(
    call: object, error: type[PolywignerError], message: str
) -> None:
    with pytest.raises(error, match=message):
        call()
