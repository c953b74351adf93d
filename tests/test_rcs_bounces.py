"""Cross sections by two and three reflections, against closed forms, rays and laws."""

from __future__ import annotations

import math
import warnings
from typing import Any

import numpy as np
import pytest
import shapely

import polywigner as pw
from oracles.bounces import scattered_field, triangles_of
from oracles.meshes import (
    BOX,
    DIRECTIONS,
    STEPS,
    across,
    at,
    drone,
    extruded,
    sphere,
    towards,
)
from oracles.meshes import section_root as plate
from oracles.references import read_json
from polywigner.errors import ArgumentError, PolywignerWarning
from polywigner.scattering import facet_beams

# Error relative to the largest amplitude. The references are other sums over the same polygons.
REFERENCE = 1e-9
# Error relative to the amplitude of a plate of the body's size. Shadows have errors of 1e-12.
ROUNDING = 1e-11
# Error of ray tracing with 250 rays across a body, relative to the amplitude of a plate with the
# area of its shadow.
RAYS = 1e-3
# Relative to the amplitude of a plate times its size in wavelengths: physical optics is not
# reciprocal at edges of retroreflecting faces.
RECIPROCAL = 0.4

SQUARE = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], dtype=float)
TRIANGLE = SQUARE[[0, 1, 3]]
INWARDS = np.ones(3) / math.sqrt(3)


def facing_out(corners: Any) -> Any:
    """Return the plane plate with corners (n, 3)."""
    points = np.asarray(corners, dtype=float)
    x, other = points[1] - points[0], points[2] - points[0]
    z = np.cross(x, other)
    pose = np.eye(4)
    pose[:3, 0], pose[:3, 2] = x / np.linalg.norm(x), z / np.linalg.norm(z)
    pose[:3, 1], pose[:3, 3] = np.cross(pose[:3, 2], pose[:3, 0]), points[0]
    return pw.Aperture((points - points[0]) @ pose[:3, :2]).placed(pose)


def trihedral(shape: np.ndarray, size: float = 1.0) -> list[Any]:
    """Return three perpendicular plates that meet at the origin, open towards (1, 1, 1)."""
    flat = np.column_stack([shape, np.zeros(len(shape))]) * size
    return [facing_out(np.roll(flat, k, axis=1)) for k in range(3)]


def dihedral(degrees: float, size: float = 1.0) -> list[Any]:
    """Return two squares that meet along the x axis; the first square is in z = 0, y > 0."""
    a = math.radians(degrees)
    flat = np.column_stack([SQUARE, np.zeros(4)]) * size
    turn = np.array([[1, 0, 0], [0, math.cos(a), math.sin(a)], [0, 0, 0]])
    return [facing_out(flat), facing_out(flat @ turn)]


def rectangle(x: tuple[float, float], y: tuple[float, float], z: float) -> Any:
    return facing_out([(x[0], y[0], z), (x[1], y[0], z), (x[1], y[1], z), (x[0], y[1], z)])


@pytest.mark.parametrize("name", ["square trihedral", "triangular trihedral", "dihedral"])
def test_corners_have_the_reference_values_on_and_off_their_axes(name: str) -> None:
    cases = [case for case in read_json("corner") if case["body"] == name]
    largest = math.sqrt(max(case["rcs"] for case in cases))
    body = [facing_out(face) for face in cases[0]["faces"]]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", PolywignerWarning)  # single reflections
        for case in cases:
            how = {name: case[name] for name in ("polarisation", "bounces")}
            result = pw.rcs(body, case["to_radar"], case["wavelength"], **how)
            error = abs(math.sqrt(result) - math.sqrt(case["rcs"]))
            assert error <= REFERENCE * largest, case


@pytest.mark.parametrize(
    ("body", "direction", "section", "decibels"),
    [
        (trihedral(SQUARE), INWARDS, 12 * math.pi, (0.01, 0.002, 0.001)),
        (trihedral(TRIANGLE), INWARDS, 4 * math.pi / 3, (0.121, 0.1, 0.1)),
        (dihedral(90.0), towards(45, 90), 8 * math.pi, (0.08, 0.05, 0.02)),
    ],
    ids=["square trihedral", "triangular trihedral", "dihedral"],
)
def test_corners_have_the_closed_forms_on_their_axes(
    body: Any, direction: np.ndarray, section: float, decibels: tuple[float, ...]
) -> None:
    # The faces themselves reflect, less for larger faces.
    for size, limit in zip((10, 20, 30), decibels, strict=True):
        for channel in ("vv", "hh", "vh", "hv"):
            result = pw.rcs(body, direction, 1 / size, polarisation=channel, bounces=3)
            ratio = result / (section * size**2)
            is_same = channel[0] == channel[1]
            assert abs(10 * math.log10(ratio)) < limit if is_same else ratio < 1e-12


GROUND = pw.shapes.square(8.0)
FRAME = pw.Aperture(shapely.Polygon([(0, 0), (4, 0), (4, 3), (0, 2)], [[(1, 1), (2, 1), (2, 2)]]))
TILTED = np.eye(4)
TILTED[:3, :3] = np.array([[0.8, 0, 0.6], [0, 1, 0], [-0.6, 0, 0.8]])
TILTED[:3, 3] = 0.5, 0.0, 1.5


RAY_CASES: dict[str, Any] = {
    "behind": (trihedral(SQUARE), towards(120, 60), towards(40, 60)),  # received behind it
    "40 degrees": (dihedral(40), towards(60, 80), None),
    "60 degrees": (dihedral(60), towards(20, 80), towards(70, 85)),
    "stairs": (STEPS, towards(60, 80), towards(70, 15)),
    "box": ([GROUND, BOX], towards(45, 160), towards(55, 20)),
    "plates": ([rectangle((-2, 2), (-1, 2), -0.5), *trihedral(SQUARE)], towards(40, 20), None),
    "hole": ([GROUND.placed(at(1, 1, 0)), FRAME.placed(TILTED)], towards(30, 20), towards(40, 200)),
}


@pytest.mark.parametrize(
    ("case", "rays"),
    [
        ("40 degrees", 60),
        ("stairs", 60),
        *(pytest.param(name, 250, marks=pytest.mark.slow) for name in RAY_CASES),
    ],
)
def test_beams_are_the_rays_of_all_reflections(case: str, rays: int) -> None:
    body, s, t = RAY_CASES[case]
    wavelength, transmitter = 0.9, s if t is None else t
    p = across(transmitter)
    triangles = triangles_of(body if isinstance(body, list) else [body])
    field, area = scattered_field(triangles, s, transmitter, p, wavelength, 3, across=rays)
    for axis in np.eye(3):
        q = axis - s * (axis @ s)
        q /= np.linalg.norm(q)
        result = math.sqrt(pw.rcs(body, s, wavelength, t, (q, p), bounces=3))
        expected = math.sqrt(4 * math.pi) / wavelength * abs(q @ field)
        allowed = RAYS * (250 / rays) ** 1.2 * plate(area, wavelength)
        assert result == pytest.approx(expected, abs=allowed)


@pytest.mark.slow
@pytest.mark.parametrize(("polar", "azimuth"), [(60.1, 90.2), (70.0, 33.0)])
def test_beams_of_a_drone_are_the_rays_of_two_reflections(polar: float, azimuth: float) -> None:
    body, s, wavelength = drone(12), towards(polar, azimuth), 0.1
    p = across(s)
    field, area = scattered_field(triangles_of([body]), s, s, p, wavelength, 2, across=250)
    result = math.sqrt(pw.rcs(body, s, wavelength, polarisation=(p, p), bounces=2))
    expected = math.sqrt(4 * math.pi) / wavelength * abs(p @ field)
    assert result == pytest.approx(expected, abs=RAYS * plate(area, wavelength))


@pytest.mark.parametrize("degrees", [80.0, 90.0, 100.0])
def test_a_beam_sent_back_is_the_same_both_ways(degrees: float) -> None:
    body, t = dihedral(degrees), towards(45, 80)
    a = math.radians(degrees)
    k, normals = -t, ((0, 0, 1), (0, math.sin(a), -math.cos(a)))
    for normal in np.array(normals):
        k = k - 2 * (k @ normal) * normal
    for wavelength in (0.03, 0.01, 0.003):
        scale = plate(1.0, wavelength)
        for q, p in ((across(k), across(t)), (np.cross(k, across(k)), across(t))):
            there = math.sqrt(pw.rcs(body, k, wavelength, t, (q, p), bounces=2))
            back = math.sqrt(pw.rcs(body, t, wavelength, k, (p, q), bounces=2))
            assert there == pytest.approx(back, abs=RECIPROCAL * wavelength * scale)
        assert pw.rcs(body, k, wavelength, t, bounces=2) > 0.1 * scale**2


@pytest.mark.parametrize(
    "body",
    [BOX, GROUND, sphere(1), [BOX, extruded([(5, 5), (6, 5), (6, 6), (5, 6)], 0.5)]],
    ids=["box", "plate", "sphere", "two boxes"],
)
def test_bodies_whose_faces_do_not_light_each_other_reflect_once(body: Any) -> None:
    directions = DIRECTIONS[:2] if isinstance(body, list) else DIRECTIONS
    for t in (None, DIRECTIONS[1]):
        once = pw.rcs(body, directions, 0.3, t)
        np.testing.assert_array_equal(pw.rcs(body, directions, 0.3, t, bounces=3), once)


def test_a_corner_turned_with_its_radar_is_the_same() -> None:
    axes, _ = np.linalg.qr(np.random.default_rng(3).normal(size=(3, 3)))
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = axes * np.linalg.det(axes), (10, -3, 2)
    s, t = towards(50, 40), towards(35, 60)
    body = trihedral(TRIANGLE)
    turned = [part.aperture.placed(pose @ part.pose) for part in body]
    for transmitter, other in ((None, None), (t, pose[:3, :3] @ t)):
        expected = pw.rcs(body, s, 0.1, transmitter, bounces=3)
        result = pw.rcs(turned, pose[:3, :3] @ s, 0.1, other, bounces=3)
        scale = plate(0.5, 0.1)
        assert math.sqrt(result) == pytest.approx(math.sqrt(expected), abs=ROUNDING * scale)


def test_a_plate_with_a_hole_reflects_as_its_parts_do() -> None:
    window = pw.Aperture(
        shapely.Polygon([(0, 0), (3, 0), (3, 3), (0, 3)], [[(1, 1), (2, 1), (2, 2), (1, 2)]])
    )
    parts = [
        rectangle((0, 3), (0, 1), 0), rectangle((0, 3), (2, 3), 0), rectangle((0, 1), (1, 2), 0),
        rectangle((2, 3), (1, 2), 0),
    ]  # fmt: skip
    others = [
        facing_out([(0, 0, 0), (0, 3, 0), (0, 3, 3), (0, 0, 3)]),  # a wall next to it
        rectangle((-1, 3), (-1, 3), -0.8),  # illuminated through the hole
    ]
    for s, t in ((towards(40, 2), None), (towards(50, 10), towards(30, 10))):
        whole = pw.rcs([window, *others], s, 0.3, t, "vv", bounces=3)
        split = pw.rcs([*parts, *others], s, 0.3, t, "vv", bounces=3)
        scale = plate(16.0, 0.3)
        assert math.sqrt(whole) == pytest.approx(math.sqrt(split), abs=ROUNDING * scale)
        filled = pw.rcs([rectangle((0, 3), (0, 3), 0), *others], s, 0.3, t, "vv", bounces=3)
        assert abs(math.sqrt(whole) - math.sqrt(filled)) > 1e-3 * scale


@pytest.mark.slow
def test_too_many_beams_are_refused_in_one_sentence() -> None:
    ball = sphere(5)
    other = pw.Polyhedron(ball.vertices + np.array([0.0, 3.0, 0.0]), ball.faces)
    with pytest.raises(ArgumentError, match="use bounces=1, or simplify the mesh"):
        pw.rcs([ball, other], (0.0, 0.0, 1.0), 0.05, bounces=3)


def test_a_direction_whose_reflections_fail_is_nan(monkeypatch: pytest.MonkeyPatch) -> None:
    body, directions = trihedral(SQUARE), np.array([INWARDS, [0.6, 0.0, 0.8], [0.0, 0.8, 0.6]])
    expected = pw.rcs(body, directions, 0.3, bounces=2)
    hits_after = facet_beams.hits_after

    def failing(facets: Any, ends: Any, bounces: int) -> Any:
        if 1 in ends.samples:
            raise shapely.errors.GEOSException("side location conflict")
        return hits_after(facets, ends, bounces)

    monkeypatch.setattr(facet_beams, "hits_after", failing)
    with pytest.warns(PolywignerWarning, match="1 of 3 directions cannot be computed"):
        result = pw.rcs(body, directions, 0.3, bounces=2)
    expected[1] = np.nan
    np.testing.assert_allclose(result, expected, rtol=1e-12)
