"""Diffracted fields behind opaque bodies and plates, by silhouettes."""

from __future__ import annotations

import json
import math
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import polywigner as pw
from oracles.meshes import at, ball, box
from oracles.references import numpy_and_few
from polywigner.errors import ArgumentError, PolywignerWarning, StoreError
from polywigner.execution import NumpyOperations
from polywigner.kernels.boundary.edge_waves import EdgeRule, edge_wave

REFERENCE = json.loads((Path(__file__).parent / "data" / "shadows.json").read_text("utf-8"))
WAVELENGTH = REFERENCE["wavelength"]
SQUARE = pw.shapes.square(REFERENCE["side"])
LAMP = pw.PointSource((0.3e-3, 0.1e-3, -0.11))

# Default tolerance, relative to the largest field without obstacles.
TOLERANCE = 1e-6
# Angles are evaluated 1e-8 of the distance off each point, relative to a narrow gap.
TOUCHING = 1e-6
# Error of 80 nodes along an edge and of 16 nodes on the complex path, with a margin of 50.
NEAR_EDGE = 1e-10


def drawn_points(count: int, low: Any, high: Any, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).uniform(low, high, (count, 3))


def field(source: Any, points: Any, obstacles: Any, **options: Any) -> Any:
    return pw.amplitude(
        source, points, WAVELENGTH, "kirchhoff", obstacles=obstacles, engine="numpy", **options
    )


def free_field(points: np.ndarray) -> np.ndarray:
    distance = np.linalg.norm(points - np.array(LAMP.position), axis=-1)
    return np.exp(2j * math.pi * distance / WAVELENGTH) / distance


BEHIND = drawn_points(60, (-0.06, -0.06, 0.05), (0.06, 0.06, 0.3))
BODIES = {
    "plate": pw.Aperture(REFERENCE["plate_outline"]).placed(REFERENCE["plate_pose"]),
    "box": pw.Polyhedron(REFERENCE["box_vertices"], REFERENCE["box_faces"]),
}


@pytest.mark.parametrize(("name", "engine"), numpy_and_few(BODIES, ["box"], slow=["plate"]))
def test_field_of_an_aperture_behind_a_body_is_the_sum_over_points_of_it(
    name: str, engine: Any
) -> None:
    expected = REFERENCE[name]
    result = pw.amplitude(
        SQUARE, expected["points"], WAVELENGTH, obstacles=BODIES[name], engine=engine
    )
    error = np.abs(np.abs(result) - expected["field"]).max()
    assert error < TOLERANCE * max(expected["free"])


def test_tolerance_bounds_the_error_and_the_estimate_covers_it() -> None:
    points, how = REFERENCE["box"]["points"], {"obstacles": BODIES["box"]}
    fine = pw.amplitude(SQUARE, points, WAVELENGTH, tolerance=1e-8, **how)
    result, error = pw.amplitude_with_error(SQUARE, points, WAVELENGTH, tolerance=1e-5, **how)
    off = np.abs(result - fine).max()
    assert off < 1e-5 * np.abs(fine).max() and off < 3 * error.max()


def test_hole_in_a_wall_adds_to_the_plate_that_would_fill_it() -> None:
    hole = pw.shapes.rectangle(0.012, 0.02)
    wall = pw.shapes.square(0.2) - hole
    free = free_field(BEHIND)
    parts = [field(LAMP, BEHIND, body.placed(at())) - free for body in (wall, hole)]
    whole = field(LAMP, BEHIND, pw.shapes.square(0.2).placed(at())) - free
    assert np.abs(parts[0] + parts[1] - whole).max() < TOLERANCE * np.abs(free).max()


def test_two_slits_in_a_wall_interfere_as_two_apertures_do() -> None:
    slits, wall = pw.shapes.double_slit((0.01, 0.01), 0.03, (-0.012, 0.012)), pw.shapes.square(0.5)
    x = np.linspace(-0.1, 0.1, 41)
    points = np.column_stack([x, 0 * x, 0 * x + 0.3])
    for distance in (0.2, 1e5 * WAVELENGTH):
        source = pw.PointSource((0.0, 0.0, -distance), distance)
        cut, solid = (field(source, points, body.placed(at())) for body in (wall - slits, wall))
        opening = pw.Screen(slits, source, kind="opening")
        expected = pw.amplitude(opening, points, WAVELENGTH, "kirchhoff")
        # The edge of the wall contributes a tenth, with and without slits.
        assert np.abs(cut - solid - expected).max() < TOLERANCE * np.abs(expected).max()
    far = pw.amplitude(slits, points, WAVELENGTH, "kirchhoff")
    assert np.abs(cut - solid - far).max() < 2e-3 * np.abs(far).max()  # a distant point


def test_spot_of_arago_is_as_bright_behind_a_ball_as_behind_its_disc() -> None:
    sphere = ball(0.02, 24)
    rim = sphere.vertices[np.abs(sphere.vertices[:, 2]) < 1e-9][:, :2]
    order = np.argsort(np.arctan2(rim[:, 1], rim[:, 0]))
    disc = pw.Aperture(rim[order]).placed(at())
    axis = [(0.0, 0.0, 0.2), (0.0, 0.0, 0.5)]
    lamp = pw.PointSource((0.0, 0.0, -300.0))
    spots = [np.abs(field(lamp, axis, body)) * 300.0 for body in (sphere, disc)]
    assert np.abs(spots[0] / spots[1] - 1).max() < 1e-3  # the outline of the mesh is a polygon
    # On the axis, the field is (1 + z/r)/2 of the incident field, with the distance r from the
    # edge, because all paths around the disc have equal lengths.
    closed_form = 0.5 + 0.5 / np.hypot(1, 0.02 / np.array([0.2, 0.5]))
    assert np.abs(spots[1] / closed_form - 1).max() < 2e-3


def test_boundary_wave_of_a_near_edge_is_the_integral_along_the_edge() -> None:
    """At these distances, the arguments of the roots in (SB3) add up to more than 180 degrees."""
    rng, count = np.random.default_rng(0), 500
    before, behind = 10 ** rng.uniform(-2, 0, (2, count))
    angle, zero = rng.uniform(-3, 3, count), np.zeros(count)
    source = (zero, -before, zero)
    point = (rng.normal(size=count) * before, behind * np.cos(angle), behind * np.sin(angle))
    ends = (rng.uniform(-2, -1, count), zero, zero), (rng.uniform(1, 2, count), zero, zero)
    along, deformed = (
        edge_wave(NumpyOperations(), EdgeRule.of(cycles, 80, tails), source, point, *ends)
        for cycles, tails in ((10.0, 2), (1.0, 16))
    )
    difference = np.hypot(along.real - deformed.real, along.imag - deformed.imag)
    assert difference.max() < NEAR_EDGE


def test_knife_edge_is_that_of_fresnel() -> None:
    from scipy.special import fresnel

    edge = pw.Aperture([(0, -40), (40, -40), (40, 40), (0, 40)]).placed(at(z=10.0))
    lamp, x = pw.PointSource((0.0, 0.0, -1e-3)), np.linspace(-0.6, 0.2, 17)
    points = np.column_stack([x, 0 * x, 0 * x + 20.0])
    scale = math.sqrt(2 * (10.001 + 10.0) / (WAVELENGTH * 10.001 * 10.0)) * 10.001 / 20.001
    s, c = fresnel(-x * scale)
    expected = np.abs((0.5 + c) + 1j * (0.5 + s)) / math.sqrt(2)
    distance = np.linalg.norm(points - np.array(lamp.position), axis=1)
    level = 20 * np.log10(np.abs(field(lamp, points, edge)) * distance / expected)
    assert np.abs(level).max() < 0.02


L_SHAPE = pw.Polyhedron(
    [[x, y, z] for y in (0, 5) for x, z in ((0, 0), (10, 0), (10, 4), (4, 4), (4, 10), (0, 10))],
    [[0, 1, 2, 3, 4, 5], [11, 10, 9, 8, 7, 6], [0, 6, 7, 1], [1, 7, 8, 2],
     [2, 8, 9, 3], [3, 9, 10, 4], [4, 10, 11, 5], [5, 11, 6, 0]],
)  # fmt: skip


@pytest.mark.parametrize("place", [(30, -20, -10), (4, 2.5, -40)])
@pytest.mark.parametrize(
    ("whole", "parts"),
    [
        (box((0, 0, 0), (10, 5, 9)), [box((0, 0, 0), (10, 5, 4)), box((0, 0, 4), (10, 5, 9))]),
        (L_SHAPE, [box((0, 0, 0), (10, 5, 4)), box((0, 0, 4), (4, 5, 10))]),
        (
            pw.shapes.rectangle(60, 50).placed(at()),
            [pw.shapes.rectangle(30, 50).placed(at(x=x)) for x in (-15, 15)],
        ),
    ],
    ids=["tall box", "step", "wall"],
)
def test_bodies_that_touch_throw_the_shadow_of_one(whole: Any, parts: Any, place: Any) -> None:
    points = drawn_points(40, (-60, -60, 20), (60, 60, 60))
    source = pw.PointSource(place)
    one, two = (
        pw.amplitude(source, points, 1.0, "kirchhoff", obstacles=bodies, engine="numpy")
        for bodies in (whole, parts)
    )
    assert np.abs(one - two).max() < TOUCHING * np.abs(one).max()


def test_body_in_the_shadow_of_another_changes_nothing() -> None:
    wall = pw.shapes.rectangle(0.06, 0.05).placed(at())
    hidden = box((-0.005, -0.004, 0.003), (0.005, 0.004, 0.009))
    alone = field(LAMP, BEHIND, wall)
    both = field(LAMP, BEHIND, [wall, hidden])
    # The edges of the wall may be divided.
    assert np.abs(both - alone).max() < 1e-12 * np.abs(alone).max()


def test_light_on_a_floor_does_not_know_of_it_nor_what_is_below_of_fringes_above() -> None:
    floor = pw.shapes.square(3.0).placed(at(z=0.2))
    body = box((-0.02, -0.01, 0.1), (0.01, 0.02, 0.15))
    points = drawn_points(60, (-0.06, -0.06, 0.2), (0.06, 0.06, 0.2))
    alone, with_floor = field(LAMP, points, body), field(LAMP, points, [body, floor])
    # The edge of the floor, at 500 wavelengths, contributes as well.
    assert np.abs(with_floor - alone).max() < 0.01 * np.abs(alone).max()
    below = drawn_points(40, (-0.06, -0.06, 0.25), (0.06, 0.06, 0.3))
    alone, with_body = field(LAMP, below, floor), field(LAMP, below, [floor, body])
    assert np.abs(with_body - alone).max() < TOUCHING * np.abs(free_field(below)).max()


def test_field_is_smooth_but_on_surfaces() -> None:
    body = box((-0.02, -0.01, 0.02), (0.02, 0.03, 0.05))
    lines = [((-0.1, -0.08, 0.03), (0.1, 0.08, 0.03)), ((-0.1, -0.1, 0.2), (0.1, 0.1, 0.01))]
    for first, last in lines:
        points = np.linspace(first, last, 2001)
        step = np.linalg.norm(points[1] - points[0]) / WAVELENGTH
        values = field(LAMP, points, body)
        inside = values == 0.0
        jumps = np.abs(np.diff(values))
        jumps[inside[1:] | inside[:-1]] = 0.0
        assert jumps.max() < 3 * 2 * math.pi * step * np.abs(free_field(points)).max()


def test_points_on_edges_faces_and_in_bodies_have_values() -> None:
    body = box((-0.02, -0.01, 0.02), (0.02, 0.03, 0.05))
    middle, edge, corner = (0.0, 0.01, 0.03), (0.02, 0.01, 0.05), (0.02, 0.03, 0.05)
    points = np.array([middle, edge, corner, (0.0, 0.01, 0.02), (0.0, 0.01, 0.05)])
    values = field(LAMP, points, body)
    level = np.abs(values) / np.abs(free_field(points))
    assert np.isfinite(values).all()
    assert level[0] == 0.0
    assert 0.2 < level[1] < 0.8 and level[3] > 0.5 and level[4] < 0.5


def test_exchange_of_source_and_point_behind_a_plate_leaves_the_field() -> None:
    plate = pw.shapes.rectangle(0.04, 0.03)
    tilt = np.array([[0.8, 0, 0.6, 0], [0, 1, 0, 0], [-0.6, 0, 0.8, 0], [0, 0, 0, 1.0]])
    back = np.diag([1.0, 1.0, -1.0, 1.0]) @ tilt @ np.diag([1.0, 1.0, -1.0, 1.0])
    receiver = (0.01, 0.02, 0.1)
    for x, y, z in drawn_points(8, (-0.03, -0.03, 0.05), (0.03, 0.03, 0.2)):
        sent = field(pw.PointSource((x, y, -z)), receiver, plate.placed(tilt))
        returned = field(pw.PointSource((0.01, 0.02, -0.1)), (x, y, z), plate.placed(back))
        assert abs(sent - returned) < TOUCHING * abs(sent)


def test_power_that_a_shadow_takes_is_what_the_body_blocks() -> None:
    plate = pw.shapes.rectangle(0.05, 0.04)
    lamp, z = pw.PointSource((0.0, 0.0, -3.0)), 0.1
    g = (np.arange(400) + 0.5) / 400 * 0.8 - 0.4
    points = np.stack(np.meshgrid(g, g, [z], indexing="ij"), axis=-1).reshape(-1, 3)
    free = np.exp(2j * np.pi / WAVELENGTH) / np.linalg.norm(points - lamp.position, axis=1)
    result = pw.amplitude(lamp, points, WAVELENGTH, "kirchhoff", obstacles=plate.placed(at()))
    cosine = (z + 3.0) / np.linalg.norm(points - lamp.position, axis=1)
    lost = ((np.abs(free) ** 2 - np.abs(result) ** 2) * cosine).sum() * (g[1] - g[0]) ** 2
    blocked = plate.area / 9.0
    assert abs(lost / blocked - 1) < 0.01


def _at_a_point(**options: Any) -> Any:
    return pw.amplitude(SQUARE, (0.0, 0.0, 0.3), WAVELENGTH, **options)


def _on_a_line(**options: Any) -> Any:
    return pw.line(SQUARE, [(0, 0, 0.2), (0, 0, 0.3)], 3, WAVELENGTH, **options)


@pytest.mark.parametrize(
    ("compute", "body", "options", "words"),
    [
        (_at_a_point, pw.shapes.square(1.0), {}, "placed"),
        (_at_a_point, "box.stl", {}, "Polyhedra"),
        (_at_a_point, BODIES["box"], {"method": "fresnel"}, "requires one of the methods"),
        (_at_a_point, BODIES["box"], {"tolerance": 1e-12}, "tolerance"),
        (_at_a_point, box((-1, -1, -1), (1, 1, 1)), {}, "away from the source"),
        (_on_a_line, BODIES["box"], {}, "got method='wigner'"),
        (
            _on_a_line,
            BODIES["box"],
            {"method": "kirchhoff", "bandwidth": 1e9},
            "cannot be combined",
        ),
    ],
)
def test_obstacles_and_options_that_cannot_be_are_refused(
    compute: Any, body: Any, options: dict[str, Any], words: str
) -> None:
    with pytest.raises(ArgumentError, match=words):
        compute(obstacles=body, **options)


def test_obstacle_at_the_source_warns() -> None:
    near = box((0.0, 0.0, 0.5e-3), (0.01, 0.01, 0.02))
    with pytest.warns(PolywignerWarning, match="evanescent waves are neglected"):
        pw.amplitude(SQUARE, (0.0, 0.0, 0.3), WAVELENGTH, obstacles=near)


def test_store_of_a_volume_belongs_to_its_obstacles(tmp_path: Path) -> None:
    pytest.importorskip("zarr")
    pytest.importorskip("dask")
    body = BODIES["box"]
    moved = pw.Polyhedron(body.vertices + np.array([0.0, 0.0, 1e-9]), body.faces)

    def stored(obstacles: Any) -> Any:
        box = [(-0.05, -0.05, 0.28), (0.05, 0.05, 0.3)]
        return pw.volume(
            SQUARE, box, (3, 2, 2), WAVELENGTH, method="kirchhoff", engine="numpy",
            out=tmp_path / "field.zarr", obstacles=obstacles,
        )  # fmt: skip

    first = stored(body)["kirchhoff"].values
    assert np.array_equal(stored([body])["kirchhoff"].values, first)
    for other in (None, moved, [body, BODIES["plate"]]):
        with pytest.raises(StoreError, match="obstacles"):
            stored(other)


def test_partly_coherent_light_is_the_mean_over_its_tilts() -> None:
    width, points = 12e-3, [(x, 0.01, 0.3) for x in (-0.05, 0.0)]
    how: Any = {"obstacles": BODIES["plate"], "tolerance": 1e-2, "engine": "numpy"}
    # The expected irradiance is |U|^2 averaged over normally distributed tilts kappa of the wave.
    nodes, weights = np.polynomial.hermite_e.hermegauss(3)
    expected = 0.0
    for (i, first), (j, second) in product(enumerate(nodes), repeat=2):
        tilt = np.array([first, second]) / (2 * math.pi * width)
        tilted = SQUARE.with_illumination(pw.Illumination([1.0], [tilt]))
        part = pw.irradiance(tilted, points, WAVELENGTH, "auto", **how)
        expected = expected + weights[i] * weights[j] / (2 * math.pi) * part
    source = pw.Wavefront(SQUARE, coherence_width=width)
    result = pw.irradiance(source, points, WAVELENGTH, "auto", **how)
    assert np.abs(result - expected).max() < 1e-2 * expected.max()
    coherent = pw.irradiance(SQUARE, points, WAVELENGTH, "auto", **how)
    assert np.abs(result - coherent).max() > 0.03 * expected.max()
