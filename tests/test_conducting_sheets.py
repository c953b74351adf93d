"""Soft and hard plates against the exact half-plane and boundary conditions."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import polywigner as pw
from oracles.half_plane import field_of_half_plane, incident_shadow
from oracles.meshes import at, box
from polywigner.errors import ArgumentError
from polywigner.execution import NumpyOperations
from polywigner.kernels.boundary.edge_waves import EdgeRule, edge_wave

KINDS = ("soft", "hard")
LONG = 1e5  # half length of quasi-infinite edges in wavelengths
LAMP = pw.PointSource((0.3, 0.2, -10.0))
OUTLINE = pw.Aperture([(-6, -5), (7, -4), (5, 6), (0, 1), (-5, 4)])
POSE = np.array([[0.8, 0, 0.6, 1], [0, 1, 0, 0], [-0.6, 0, 0.8, 20], [0, 0, 0, 1.0]])
PLATE = OUTLINE.placed(POSE)


def drawn(count: int, low: Any, high: Any, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).uniform(low, high, (count, 3))


def field(source: Any, points: Any, edge: Any, **options: Any) -> Any:
    options = {"obstacles": PLATE, "engine": "numpy", **options}
    return pw.amplitude(source, points, 1.0, "kirchhoff", edge=edge, **options)


@pytest.mark.parametrize(("turns", "nodes", "allowed"), [(4.0, 40, 1e-10), (2.0, 24, 1e-9)])
def test_edge_wave_of_a_half_plane_is_macdonalds(turns: float, nodes: int, allowed: float) -> None:
    rng, count = np.random.default_rng(1), 4000
    radius, start = 10 ** rng.uniform(0.5, 3, count), rng.uniform(0.05, 3.09, count)
    source = np.stack([-radius * np.cos(start), 0 * start, -radius * np.sin(start)], axis=1)
    last, angle = 10 ** rng.uniform(-2, 3, count), rng.uniform(0, 2 * np.pi, count)
    near = np.arange(count) % 3 == 0  # points near the shadow boundary
    angle[near] = np.clip(start + np.pi + 0.05 * rng.normal(size=count), 0, 6.283)[near]
    along = rng.uniform(-30, 30, count)
    points = np.stack([-last * np.cos(angle), along, -last * np.sin(angle)], axis=1)
    none = np.zeros(count)
    wave = edge_wave(
        NumpyOperations(), EdgeRule.of(turns, nodes, 5), tuple(source.T), tuple(points.T),
        (none, none + LONG, none), (none, none - LONG, none), in_front=1.0 * (angle < np.pi),
    )  # fmt: skip
    result = (angle < start + np.pi) - (wave.real + 1j * wave.imag) / (2 * np.pi)
    assert np.abs(result - incident_shadow(source, points)).max() < allowed


@pytest.mark.parametrize("engine", ["numpy", pytest.param("llvm", marks=pytest.mark.llvm)])
@pytest.mark.parametrize("kind", KINDS)
def test_large_plate_is_a_half_plane(kind: str, engine: Any) -> None:
    # An M-shaped plate with one near edge.
    corners = [(0.0, -1.0), (0.0, 1.0), (-0.6, 1.2), (-0.4, 0.0), (-0.6, -1.2)]
    plate = pw.Aperture([(LONG * x, LONG * y) for x, y in corners]).placed(np.eye(4))
    points = drawn(200, -30.0, 30.0)
    points[:40, 2] = 0.0  # in the plane of the plate
    for source, some in (((2.0, 1.0, -40.0), points), ((40.0, 1.0, 0.0), points[40:])):
        result = field(pw.PointSource(source), some, kind, obstacles=plate, engine=engine)
        exact = field_of_half_plane(kind, np.array(source), some)
        assert np.abs(result - exact).max() < 1e-6 / 40


@pytest.mark.parametrize("kind", KINDS)
def test_exchange_of_source_and_point_leaves_the_field(kind: str) -> None:
    starts, ends = drawn(8, (-15, -15, -5), (15, 15, 25), 1), drawn(8, (-15, -15, 15), 45, 2)
    for first, last in zip(starts, ends, strict=True):
        sent = field(pw.PointSource(tuple(first)), last, kind)
        returned = field(pw.PointSource(tuple(last)), first, kind)
        assert abs(sent - returned) * np.linalg.norm(last - first) < 1e-7


def test_field_is_zero_on_a_soft_plate_and_its_slope_on_a_hard_one() -> None:
    flat = np.column_stack([drawn(20, (-2, -3, 0), (2, -1, 0)), np.ones(20)])
    points, normal, step = (flat @ POSE.T)[:, :3], POSE[:3, 2], 1e-3
    free = np.linalg.norm(points - LAMP.position, axis=1).min()
    assert np.abs(field(LAMP, points, "soft")).max() * free < 1e-9
    for side in (-1, 1):
        low, middle, high = (
            field(LAMP, points + side * n * step * normal, "hard") for n in (1, 2, 3)
        )
        slope = (2.5 * (middle - low) - 1.5 * (high - middle)) / step  # extrapolated to the plate
        assert np.abs(slope).max() * free / (2 * np.pi) < 1e-3


@pytest.mark.parametrize("kind", KINDS)
def test_obliquity_of_an_aperture_belongs_to_the_directions_of_the_edges(kind: str) -> None:
    """By (SB5), the field of one condition is a derivative of the field of the other condition."""
    square, points = pw.shapes.square(2.0), drawn(6, (-20, -20, 5), 25)

    def by(method: str, up: float = 0.0) -> Any:
        pose = POSE - up * np.outer([0, 0, 1, 0], [0, 0, 0, 1])
        how: Any = {"obstacles": OUTLINE.placed(pose), "edge": kind, "engine": "numpy"}
        return pw.amplitude(square, points - [0, 0, up], 1.0, method, tolerance=1e-8, **how)

    h = 0.01
    slope = 8 * (by("rayleigh-sommerfeld-2", h) - by("rayleigh-sommerfeld-2", -h))
    slope -= by("rayleigh-sommerfeld-2", 2 * h) - by("rayleigh-sommerfeld-2", -2 * h)
    first = by("rayleigh-sommerfeld-1")
    assert np.abs(first + slope / (12 * h) / (2j * np.pi)).max() < 1e-6
    mean = 0.5 * (first + by("rayleigh-sommerfeld-2"))
    assert np.abs(by("kirchhoff") - mean).max() < 1e-9


@pytest.mark.parametrize(("kind", "other"), [KINDS, KINDS[::-1]])
def test_holes_and_plates_follow_babinet(kind: str, other: str) -> None:
    """A hole in a soft plate corresponds to a hard plate in the hole."""
    whole, part = pw.shapes.rectangle(8.0, 6.0), pw.shapes.square(2.0)
    beside = POSE.copy()
    beside[:3, 3] += POSE[:3, :3] @ [9.0, 1.0, 0.0]
    points = drawn(40, (-20, -20, 5), (20, 20, 40), 5)
    free = pw.amplitude(LAMP, points, 1.0, "kirchhoff")
    behind = (points - POSE[:3, 3]) @ POSE[:3, 2] > 0.0

    def change(edge: str, *plates: Any) -> Any:
        return field(LAMP, points, edge, obstacles=list(plates)) - free

    one, small, aside = whole.placed(POSE), part.placed(POSE), part.placed(beside)
    both = change(kind, one) + change(kind, aside)
    assert np.abs(change(kind, one, aside) - both).max() < 1e-6 * np.abs(free).max()
    filled = change(kind, one) + np.where(behind, -1, 1) * change(other, small)
    off = change(kind, (whole - part).placed(POSE)) - filled
    assert np.abs(off).max() < 1e-6 * np.abs(free).max()


@pytest.mark.parametrize("kind", KINDS)
def test_field_is_smooth_where_the_mirror_image_is_the_source(kind: str) -> None:
    plate, step = pw.shapes.rectangle(8.0, 6.0).placed(at(0.5, 0.2, 20)), np.array([3e-3, 0, 0])
    for shift in (0.0, 1e-12, 1e-7):
        image = np.array([0.3 + shift, 0.2, 50.0])  # mirror image of LAMP
        points = np.stack([image + number * step for number in (0, -2, -1, 1, 2)])
        value, *near = field(LAMP, points, kind, obstacles=plate)
        assert abs(value - np.dot([-1, 4, 4, -1], near) / 6) < 1e-6 * abs(value)


def test_field_in_the_plane_of_a_plate_continues_both_sides() -> None:
    """The change of the field is even for soft plates, and odd for hard plates."""
    flat = np.array([[9.0, 1, 0, 1], [7.2, -3, 0, 1], [-2.0, -9, 0, 1], [0.0, 4.0, 0, 1]])
    points, step = (flat @ POSE.T)[:, :3], 1e-6 * POSE[:3, 2]
    for kind in KINDS:
        below, inside, above = (field(LAMP, points + n * step, kind) for n in (-1, 0, 1))
        assert np.abs(0.5 * (below + above) - inside).max() < 1e-4 * np.abs(inside).min()


def test_field_of_a_distant_source_is_zero_on_a_large_soft_plate() -> None:
    plate, source = pw.shapes.square(2e6).placed(np.eye(4)), pw.PointSource((0.0, 0.0, -1e8))
    value = field(source, np.array([1.0, 2.0, 0.0]), "soft", obstacles=plate)
    assert abs(value) * 1e8 < 1e-7


@pytest.mark.parametrize("kind", KINDS)
def test_plates_in_single_precision_are_in_one_plane(kind: str) -> None:
    points = drawn(20, (-20, -20, 5), (20, 20, 40), 6)
    poses = []
    for shift in (-2.0, 2.0):
        pose = POSE.copy()
        pose[:3, 3] += shift * POSE[:3, 0] + [0.0, 0.0, 1e-6 * shift]
        poses.append(pose)
    halves = [pw.shapes.rectangle(4.0, 6.0).placed(pose) for pose in poses]
    whole = pw.shapes.rectangle(8.0, 6.0).placed(POSE)
    off = field(LAMP, points, kind, obstacles=halves) - field(LAMP, points, kind, obstacles=whole)
    assert np.abs(off).max() * 20 < 1e-5


def test_error_estimate_covers_the_error() -> None:
    points, how = drawn(50, (-20, -20, 5), 40, 4), {"obstacles": PLATE, "edge": "hard"}
    fine = pw.amplitude(LAMP, points, 1.0, tolerance=1e-8, **how)
    result, error = pw.amplitude_with_error(LAMP, points, 1.0, tolerance=1e-3, **how)
    assert np.abs(result - fine).max() < 3 * error.max()


def test_irradiances_and_grids_take_the_edge() -> None:
    square, point = pw.shapes.square(3.0), np.array([2.0, 1.0, 30.0])
    how: Any = {"obstacles": PLATE, "edge": "soft", "engine": "numpy"}
    result = pw.irradiance(square, point, 1.0, "auto", **how)
    field = pw.amplitude(square, point, 1.0, **how)
    assert abs(result / abs(field) ** 2 - 1) < 1e-3
    line = pw.line(square, [point, point + 1.0], 2, 1.0, method="kirchhoff", **how)
    assert line["kirchhoff"].attrs["edge"] == "soft"


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"obstacles": box((-1, -1, 5), (1, 1, 6))}, "plates in one plane"),
        ({"obstacles": [PLATE, OUTLINE.placed(at(0, 0, 40))]}, "plates in one plane"),
        ({"obstacles": None}, "requires obstacles"),
        ({"edge": "metal"}, "edge"),
        ({"obstacles": OUTLINE.placed(at(0, 0, -10))}, "source lies on a soft or hard plate"),
    ],
)
def test_edges_that_cannot_be_are_refused(options: dict[str, Any], words: str) -> None:
    with pytest.raises(ArgumentError, match=words):
        pw.amplitude(LAMP, (0, 0, 50), 1.0, **{"obstacles": PLATE, "edge": "soft", **options})
