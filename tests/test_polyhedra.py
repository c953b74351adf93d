"""Fourier transforms of polyhedra and of apertures in a pose."""

import copy
import math
import pickle

import numpy as np
import pytest

import polywigner as pw
from oracles.meshes import ball, extruded, hollow, moved
from oracles.references import ENGINES, read_json
from oracles.sources import CUBE, rotation
from polywigner.errors import ArgumentError, GeometryError

# Errors relative to the volume or area.
TOLERANCE = {"double": 1e-13, "single": 2e-6}

engines = pytest.mark.parametrize("engine", ENGINES)

CUBE_CORNERS, CUBE_FACES = CUBE.vertices, CUBE.faces


@engines
@pytest.mark.parametrize("precision", list(TOLERANCE))
def test_polyhedra_have_their_reference_values(engine, precision):
    data = read_json("fourier_polyhedra")
    assert len(data["cases"]) >= 50
    for name, shape in data["shapes"].items():
        body = pw.Polyhedron(shape["vertices"], shape["faces"])
        cases = [case for case in data["cases"] if case["shape"] == name]
        cases = [case for case in cases if not any(imag for _, imag in case["q"])]
        q = np.array([[real for real, _ in case["q"]] for case in cases])
        expected = np.array([complex(*map(float, case["F"])) for case in cases])
        got = pw.fourier(body, -q / (2 * math.pi), precision=precision, engine=engine)
        assert np.abs(got - expected).max(initial=0.0) < TOLERANCE[precision] * body.volume


def test_a_prism_is_its_base_times_a_slit():
    base = [[0, 0], [2, 0], [2, 0.6], [1, 1.1], [0.3, 0.4], [0, 0.6]]  # not convex
    rng = np.random.default_rng(4)
    nu = rng.normal(size=(200, 3)) * 10.0 ** rng.uniform(-12, 2, (200, 1))
    body = extruded(base, 0.7)
    product = pw.fourier(pw.Aperture(base), nu) * pw.fourier(pw.Slits([0, 0.7]), nu[:, 2:])
    assert np.abs(pw.fourier(body, nu) - product).max() < 1e-14 * body.volume


def test_the_diameter_is_the_largest_distance_of_two_vertices():
    rng = np.random.default_rng(0)
    for stretch in ((1.0, 1.0, 1.0), (30.0, 1.0, 0.1)):
        body = ball(1.0, 9)
        shifted = pw.Polyhedron(body.vertices * stretch + rng.normal(size=3), body.faces)
        apart = np.linalg.norm(shifted.vertices[:, None] - shifted.vertices, axis=-1)
        assert shifted.diameter == pytest.approx(apart.max(), rel=1e-14)


def test_a_box_is_a_product_of_sincs_wherever_it_stands():
    box = moved(CUBE, -0.5, -0.5, -0.5)
    nu = np.random.default_rng(5).uniform(-30, 30, (100, 3))
    expected = np.prod(np.sinc(nu), axis=-1)
    assert np.abs(pw.fourier(box, nu) - expected).max() < 1e-14
    shift = np.array([1024.0, -512.0, 256.0])  # a power of two, so that vertices are exact
    far = moved(box, *shift)
    turns = nu @ shift  # products of floats with powers of two are exact, but not their sum
    phase = np.exp(-2j * np.pi * ((nu * shift) % 1).sum(axis=-1))
    assert np.abs(turns).max() > 1e3
    assert np.abs(pw.fourier(far, nu) - expected * phase).max() < 1e-13


def test_a_body_of_several_shells_is_the_sum_of_its_parts():
    cavity = pw.Polyhedron(0.25 + 0.5 * CUBE_CORNERS, CUBE_FACES)
    shell = hollow(CUBE, cavity.vertices)
    assert shell.volume == 1 - 0.125
    nu = np.random.default_rng(6).uniform(-3, 3, (20, 3))
    parts = pw.fourier(CUBE, nu) - pw.fourier(cavity, nu)
    assert np.abs(pw.fourier(shell, nu) - parts).max() < 1e-14


def test_bodies_that_touch_along_an_edge_or_a_face_are_the_sum_of_both():
    nu = np.random.default_rng(4).normal(size=(20, 3))
    for shift in ([1, 1, 0], [1, 0, 0]):
        both = np.concatenate([CUBE_CORNERS, CUBE_CORNERS + shift])
        corners, places = np.unique(both, axis=0, return_inverse=True)
        faces = np.array(CUBE_FACES)
        pair = pw.Polyhedron(corners, places.reshape(-1)[np.concatenate([faces, faces + 8])])
        assert pair.volume == 2.0
        expected = pw.fourier(CUBE, nu) * (1 + np.exp(-2j * np.pi * nu @ shift))
        assert np.abs(pw.fourier(pair, nu) - expected).max() < TOLERANCE["double"] * 2


def test_a_turned_body_has_the_turned_transform():
    turn = rotation(7)
    body = extruded([[0, 0], [1, 0], [0.2, 0.3], [0, 1]], 0.4)
    turned = pw.Polyhedron(body.vertices @ turn.T, body.faces)
    nu = np.random.default_rng(8).uniform(-5, 5, (50, 3))
    assert np.abs(pw.fourier(turned, nu @ turn.T) - pw.fourier(body, nu)).max() < 1e-14


def test_faces_that_all_run_inwards_are_turned_round():
    inward = pw.Polyhedron(CUBE_CORNERS, [face[::-1] for face in CUBE_FACES])
    assert inward.volume == 1.0
    assert {frozenset(f) for f in inward.faces} == {frozenset(f) for f in CUBE_FACES}
    assert pickle.loads(pickle.dumps(inward)) == inward
    assert hash(inward) == hash(pw.Polyhedron(inward.vertices, inward.faces))


@pytest.mark.parametrize(
    ("vertices", "faces", "message"),
    [
        (CUBE_CORNERS, CUBE_FACES[:-1], "closed surface"),
        (CUBE_CORNERS, [CUBE_FACES[0][::-1], *CUBE_FACES[1:]], "consistently oriented"),
        (CUBE_CORNERS + np.eye(8)[:, :3] * 0.1, CUBE_FACES, "planar faces"),
        (CUBE_CORNERS * [1, 1, 0], CUBE_FACES, "volume|cross"),
        (CUBE_CORNERS, [[0, 1, 9], *CUBE_FACES], "vertex indices"),
        (CUBE_CORNERS, [[0, 1], *CUBE_FACES], "three or more"),
        (CUBE_CORNERS[:, :2], CUBE_FACES, r"\(n, 3\)"),
        (CUBE_CORNERS * np.nan, CUBE_FACES, "finite"),
        (CUBE_CORNERS, 7, "lists of vertex indices"),
        (CUBE_CORNERS, np.array(CUBE_FACES) + 0.5, "whole"),
        (np.ma.masked_equal(CUBE_CORNERS, 1.0), CUBE_FACES, "masked"),
        (CUBE_CORNERS * 1e150, CUBE_FACES, r"below 1e\+100"),
    ],
)
def test_unusable_polyhedra_are_refused(vertices, faces, message):
    with pytest.raises(GeometryError, match=message):
        pw.Polyhedron(vertices, faces)


CHEVRON = pw.Aperture([[0, 0], [1, 0.5], [2, 0], [2, 0.6], [1, 1.1], [0, 0.6]])


@engines
def test_a_placed_aperture_sees_the_frequency_in_its_own_frame(engine):
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation(9), [0.3, -2.0, 5.0]
    placed = CHEVRON.placed(pose)
    nu = np.random.default_rng(10).uniform(-4, 4, (100, 3))
    local = nu @ pose[:3, :3]
    expected = pw.fourier(CHEVRON, local[:, :2]) * np.exp(-2j * np.pi * nu @ pose[:3, 3])
    got = pw.fourier(placed, nu, engine=engine)
    assert np.abs(got - expected).max() < 1e-13 * CHEVRON.area


def test_divergence_theorem_ties_faces_to_bodies():
    """2 pi i nu F(body) = - sum over the faces of n F(face), with independent kernels."""
    body = pw.Polyhedron(CUBE_CORNERS @ rotation(11).T, CUBE_FACES)
    nu = np.random.default_rng(12).uniform(-2, 2, (20, 3))
    total = np.zeros((20, 3), complex)
    for face in body.faces:
        corners = body.vertices[list(face)]
        x = corners[1] - corners[0]
        normal = np.cross(x, corners[2] - corners[0])
        pose = np.eye(4)
        pose[:3, 0], pose[:3, 2] = x / np.linalg.norm(x), normal / np.linalg.norm(normal)
        pose[:3, 1] = np.cross(pose[:3, 2], pose[:3, 0])
        pose[:3, 3] = corners[0]
        flat = (corners - corners[0]) @ pose[:3, :2]
        total += pw.fourier(pw.Aperture(flat).placed(pose), nu)[:, None] * pose[:3, 2]
    left = -2j * np.pi * nu * pw.fourier(body, nu)[:, None]
    assert np.abs(left - total).max() < 1e-13


def test_an_aperture_without_a_pose_ignores_the_third_component():
    nu = np.array([[0.3, -0.2, 7.0], [1.0, 0.5, 0.0]])
    assert (pw.fourier(CHEVRON, nu) == pw.fourier(CHEVRON, nu[:, :2])).all()


@pytest.mark.llvm
def test_third_components_of_drjit_points_are_ignored_too():
    import drjit.llvm as backend

    flat = pw.fourier(CHEVRON, backend.Array2f64([0.3, 1.0], [-0.2, 0.5]))
    deep = pw.fourier(CHEVRON, backend.Array3f64([0.3, 1.0], [-0.2, 0.5], [7.0, 0.0]))
    assert (np.array(flat.real) == np.array(deep.real)).all()


@pytest.mark.llvm
def test_placed_apertures_at_drjit_points_have_values_and_gradients():
    import drjit as dr
    import drjit.llvm.ad as backend

    pose = np.array([[0.8, 0, 0.6, 0.3], [0, 1, 0, -0.2], [-0.6, 0, 0.8, 0.1], [0, 0, 0, 1.0]])
    placed = CHEVRON.placed(pose)
    nu = np.random.default_rng(0).normal(size=(20, 3))
    expected = pw.fourier(placed, nu)
    for _ in range(10):  # later calls repeat a recorded kernel
        values = pw.fourier(placed, backend.Array3f64(nu.T.copy())).numpy()
        assert np.abs(values - expected).max() < 1e-14 * CHEVRON.area
    points = backend.Array3f64(nu.T.copy())
    dr.enable_grad(points)
    dr.backward(dr.sum(dr.real(pw.fourier(placed, points))))
    h = 1e-5
    slopes = [
        (pw.fourier(placed, nu + step) - pw.fourier(placed, nu - step)).real / (2 * h)
        for step in h * np.eye(3)
    ]
    # Central differences have errors of h^2, times the third derivative.
    assert np.abs(np.array(points.grad) - slopes).max() < 1e-6 * CHEVRON.area


@pytest.mark.parametrize(
    ("pose", "message"),
    [
        (np.diag([2.0, 2.0, 2.0, 1.0]), "scales by"),
        (np.diag([-1.0, 1.0, 1.0, 1.0]), "mirror"),
        (np.eye(3), "shape"),
        (np.eye(4) + 0j, r"\(4, 4\)"),
    ],
)
def test_poses_that_are_not_rigid_are_refused(pose, message):
    with pytest.raises(GeometryError, match=message):
        CHEVRON.placed(pose)


@pytest.mark.parametrize(
    ("source", "message"),
    [
        (CUBE, "only polywigner.fourier"),
        (CHEVRON.placed(np.eye(4)), r"attribute \.aperture"),
    ],
)
def test_sources_in_space_have_no_wigner_function_of_their_own(source, message):
    with pytest.raises(ArgumentError, match=message):
        pw.wigner(source, [0, 0, 0], [0, 0, 0])


def test_copies_of_a_placed_aperture_are_equal_and_cannot_be_written_to():
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation(5), (1.0, 2.0, 3.0)
    placed = CHEVRON.placed(pose)
    for same in (pickle.loads(pickle.dumps(placed)), copy.deepcopy(placed), copy.copy(placed)):
        assert same == placed and hash(same) == hash(placed)
        with pytest.raises(ValueError, match="read-only"):
            same.pose[0, 3] = 7.0
