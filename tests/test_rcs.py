"""Radar cross sections against closed forms, rays and laws of physical optics."""

from __future__ import annotations

import math
import warnings
from typing import Any

import numpy as np
import pytest
import shapely

import polywigner as pw
from oracles.bounces import triangles_of
from oracles.meshes import (
    BOX,
    DIRECTIONS,
    L_BODY,
    at,
    block,
    extruded,
    joined,
    moved,
    sphere,
    torus,
    towards,
)
from oracles.meshes import section_root as plate
from oracles.references import read_json
from polywigner.errors import ArgumentError, PolywignerWarning

# Rounding error relative to the amplitude of a plate of the same size.
ROUNDING = 1e-12
# Difference from the reference for two plates, which is a sum over edges of a raster with an error
# of 2e-13.
REFERENCE = 1e-11
# Rounding error of levels in dBsm with three decimals.
STATED = 5e-4

HOLED = pw.Aperture(shapely.Polygon([(0, 0), (4, 0), (4, 3), (0, 2)], [[(1, 1), (2, 1), (2, 2)]]))


def turned(axis: int, x: float = 0.0, y: float = 0.0, z: float = 0.0) -> np.ndarray:
    """Return a pose at a point whose z axis is the global x, y or z axis."""
    pose = np.eye(4)
    pose[:3, :3] = np.roll(np.eye(3), 2 - axis, axis=1)
    pose[:3, 3] = x, y, z
    return pose


PLATE = pw.shapes.square(1.0)
# Three plates [0, 1]^2 that meet at the origin, open towards (1, 1, 1).
TRIHEDRAL = [
    PLATE.placed(turned(k, *(0.5 * (np.arange(3) != k)))) for k in range(3)
]  # fmt: skip
INWARDS = np.ones(3) / math.sqrt(3)
ACROSS = np.array([1.0, 1.0, 0.0]) / math.sqrt(2)
WEDGE = pw.Polyhedron(  # an L-shaped body with an inner angle of 90 degrees and many facets
    L_BODY.vertices, [tuple(t) for t in L_BODY.triangles.tolist()]
)
GROUND = pw.shapes.square(8.0)
WALL = [GROUND, pw.shapes.square(1.0).placed(turned(0, z=0.5))]
SLAB, FIN = moved(block(2, 2, 0.2), 0, 0, -0.2), block(0.2, 1, 1)
# A rotated box with vertices in single precision, as in an STL file.
_TURN = np.linalg.qr(np.random.default_rng(5).normal(size=(3, 3)))[0]
_BLOCK = joined([block(1, 2, 3)])
SINGLE = pw.Polyhedron((_BLOCK.vertices @ _TURN).astype(np.float32), _BLOCK.faces)
UPRIGHT = pw.shapes.square(1.0).placed(turned(0, x=-0.5, z=0.5))


@pytest.mark.parametrize("case", read_json("rcs"), ids=lambda case: str(case["to_radar"]))
def test_boxes_and_shadowed_plates_have_the_reference_values(case: Any) -> None:
    if "vertices" in case:
        body: Any = pw.Polyhedron(case["vertices"], case["faces"])
        size = 0.1 * 0.07
    else:
        body = [pw.shapes.square(0.3), pw.shapes.square(0.1).placed(at(0, 0, 0.2))]
        size = 0.3**2
    result = pw.rcs(body, case["to_radar"], case["wavelength"])
    error = abs(math.sqrt(result) - math.sqrt(case["rcs"]))
    assert error <= REFERENCE * plate(size, case["wavelength"])


@pytest.mark.parametrize(
    ("body", "wavelength", "stated"),
    [
        (pw.shapes.square(5.0), pw.SPEED_OF_LIGHT / 1e9, 49.414),
        (pw.shapes.square(5.0), pw.SPEED_OF_LIGHT / 3e9, 58.957),
        (pw.shapes.square(0.1016), 0.0325, 1.030),
        (pw.shapes.disc(0.1016), 0.0325, 10.973),
    ],
)
def test_plates_seen_at_right_angles_have_the_stated_sections(
    body: Any, wavelength: float, stated: float
) -> None:
    result = 10 * math.log10(pw.rcs(body, (0.0, 0.0, 1.0), wavelength))
    assert result == pytest.approx(stated, abs=STATED)


def section_of_sphere(ka: float) -> float:
    """Return pi |1 - (1 - exp(-2i ka))/(2i ka)|^2 in m^2, physical optics of a unit sphere.

    This is the integral of n.s exp(-2i ka n.s) over the illuminated half.
    """
    turn = 2j * ka
    return math.pi * abs(np.exp(-turn) - (1 - np.exp(-turn)) / turn) ** 2


@pytest.mark.parametrize(
    ("splits", "ka"),
    [
        (4, 20.0),
        pytest.param(6, 50.0, marks=pytest.mark.slow),
    ],
)
def test_a_sphere_of_facets_has_the_section_of_a_sphere(splits: int, ka: float) -> None:
    result = pw.rcs(sphere(splits), (0.36, 0.48, 0.8), 2 * math.pi / ka)
    assert 10 * math.log10(result / section_of_sphere(ka)) == pytest.approx(0, abs=0.05)


def test_a_plate_with_a_hole_scatters_its_fourier_transform() -> None:
    wavelength = 0.4
    s = DIRECTIONS[:3]
    amplitude = s[:, 2] * np.abs(pw.fourier(HOLED, 2 * s[:, :2] / wavelength))
    expected = 4 * math.pi / wavelength**2 * amplitude**2
    np.testing.assert_allclose(
        np.sqrt(pw.rcs(HOLED, s, wavelength)),
        np.sqrt(expected),
        rtol=0,
        atol=ROUNDING * plate(HOLED.area, wavelength),
    )


@pytest.mark.parametrize("body", [HOLED, BOX, L_BODY, [L_BODY, HOLED.placed(at(5, 0, 1))]])
def test_a_transmitter_beside_the_receiver_is_a_radar(body: Any) -> None:
    alone = pw.rcs(body, DIRECTIONS, 0.3)
    np.testing.assert_allclose(pw.rcs(body, DIRECTIONS, 0.3, DIRECTIONS), alone, rtol=1e-9)
    for channel in ("vv", "hh"):
        result = pw.rcs(body, DIRECTIONS, 0.3, polarisation=channel)
        np.testing.assert_allclose(result, alone, rtol=1e-9)
    # In backscatter, n x (k x p) is along p.
    assert (pw.rcs(body, DIRECTIONS, 0.3, polarisation="vh") < 1e-25 * plate(10, 0.3) ** 2).all()


def test_the_total_is_the_mean_over_incident_polarisations() -> None:
    both = DIRECTIONS[:2], 0.3, DIRECTIONS[2]
    channels = [pw.rcs(L_BODY, *both, polarisation=name) for name in ("vv", "vh", "hv", "hh")]
    np.testing.assert_allclose(pw.rcs(L_BODY, *both), sum(channels) / 2, rtol=1e-12)


def test_channels_name_the_receiver_first() -> None:
    h = np.cross((0, 0, 1), DIRECTIONS[1])
    h /= np.linalg.norm(h)
    v = np.cross(h, DIRECTIONS[1])
    s, t, horizontal = DIRECTIONS[1], towards(70, 0), (0.0, 1.0, 0.0)
    for name, q in (("vh", v), ("hh", h)):
        expected = pw.rcs(L_BODY, s, 0.3, t, (q, horizontal))
        assert pw.rcs(L_BODY, s, 0.3, t, name) == pytest.approx(expected, rel=1e-9)
    assert pw.rcs(L_BODY, s, 0.3, t, "vh") != pytest.approx(pw.rcs(L_BODY, s, 0.3, t, "hv"))
    above = towards(0, 0), 0.3, t
    result = pw.rcs(L_BODY, *above, "vh")  # v is along x
    expected = pw.rcs(L_BODY, *above, ((1.0, 0.0, 0.0), horizontal))
    assert result == pytest.approx(expected, rel=1e-9, abs=1e-20)


def test_circular_waves_return_turned_the_other_way_from_a_plate() -> None:
    right = np.array([1.0, 1j, 0.0]) / math.sqrt(2)
    square, up = pw.shapes.square(1.0), (0.0, 0.0, 1.0)
    whole, turned, same = (
        pw.rcs(square, up, 0.1, polarisation=pair)
        for pair in (None, (right.conj(), right), (right, right))
    )
    assert turned == pytest.approx(whole) and same < 1e-20 * whole


@pytest.mark.parametrize(
    "body",
    [
        BOX,
        L_BODY,
        HOLED,
        [pw.shapes.square(2.0), pw.shapes.square(1.5).placed(at(0.4, 0.2, 1.0)), BOX],
        [BOX, pw.shapes.square(4.0).placed(at(2.0, 1.0, 0.5))],  # the plate lies on the box
    ],
)
def test_forward_scattering_is_that_of_the_shadow(body: Any) -> None:
    # Some walls are seen edge-on from these directions, and their shadows share edges with other
    # faces.
    for t in (*DIRECTIONS, towards(90, -30), towards(90, 0), towards(60, 45), towards(0, 0)):
        area = shadow_of(body, t)
        result = pw.rcs(body, -t, 0.3, t, "vv")
        assert math.sqrt(result) == pytest.approx(plate(area, 0.3), rel=1e-9)


def shadow_of(body: Any, t: np.ndarray) -> float:
    """Return the projected area of a body along a direction, by a union of its faces."""
    across = np.linalg.svd(t[None])[2][1:].T
    faces = shapely.polygons(triangles_of(body if isinstance(body, list) else [body]) @ across)
    return float(shapely.union_all(faces[shapely.area(faces) > 1e-9]).area)


def section_of_plate(side: float, wavelength: float, s: Any, t: Any, q: Any, p: Any) -> float:
    """Return the cross section (SC1) of a square, a product of two sinc functions."""
    nu = (np.asarray(s) + t) / wavelength
    transform = side**2 * np.sinc(side * nu[0]) * np.sinc(side * nu[1])
    h = np.cross(-np.asarray(t), p)
    normal = np.array([0.0, 0.0, np.sign(t[2])])
    return float(4 * math.pi / wavelength**2 * (np.cross(normal, h) @ q * transform) ** 2)


@pytest.mark.parametrize("channel", ["vv", "hh", "vh", "hv"])
@pytest.mark.parametrize("side", [1, -1])
def test_a_fixed_transmitter_sees_each_azimuth_at_the_poles(channel: Any, side: int) -> None:
    azimuth, t = np.radians([0.0, 40.0, 90.0, 200.0]), towards(90 - side * 60, 70)
    result = pw.rcs_pattern(
        PLATE, 0.13, azimuth, side * math.pi / 2, to_transmitter=t, polarisation=channel
    )["rcs"].values[:, 0]
    v = np.array([t[2] * t[0], t[2] * t[1], t[2] ** 2 - 1]) / math.hypot(t[0], t[1])
    p = {"v": v, "h": np.cross((0, 0, 1), t) / math.hypot(t[0], t[1])}[channel[1]]
    for value, angle in zip(result, azimuth, strict=True):
        c, s = math.cos(angle), math.sin(angle)
        q = {"v": np.array([side * c, side * s, 0.0]), "h": np.array([-s, c, 0.0])}[channel[0]]
        expected = section_of_plate(1.0, 0.13, (0, 0, side), t, q, p)
        assert value == pytest.approx(expected, rel=1e-5, abs=1e-9)


@pytest.mark.parametrize("bounces", [1, 3])
@pytest.mark.parametrize("channel", [None, "vv", "vh"])
@pytest.mark.parametrize("fixed", [True, False])
def test_columns_of_a_pattern_are_continuous_at_the_poles(
    bounces: int, channel: Any, fixed: bool
) -> None:
    body, t = [GROUND, BOX], towards(40, 30) if fixed else None
    azimuth = np.radians([10.0, 100.0, 230.0])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", PolywignerWarning)
        for pole in (math.pi / 2, -math.pi / 2):
            angles = pole * np.array([1.0, 1 - 1e-7])
            how = {"to_transmitter": t, "polarisation": channel, "bounces": bounces}
            result = np.sqrt(pw.rcs_pattern(body, 0.13, azimuth, angles, **how)["rcs"].values)
            np.testing.assert_allclose(
                result[:, 0], result[:, 1], rtol=0, atol=1e-4 * plate(2.0, 0.13)
            )


def test_plates_that_coincide_count_once() -> None:
    alone = pw.rcs(PLATE, DIRECTIONS, 0.1)
    for body in ([PLATE, PLATE], pw.Array([PLATE])):
        np.testing.assert_allclose(pw.rcs(body, DIRECTIONS, 0.1), alone, rtol=1e-12)


@pytest.mark.parametrize(
    ("body", "t", "bounces"),
    [(BOX, None, 1), (L_BODY, None, 1), ([PLATE, UPRIGHT], DIRECTIONS[:2, None], 3)],
)
def test_directions_and_wavelengths_broadcast(body: Any, t: Any, bounces: int) -> None:
    lengths = np.array([0.2, 0.3, 0.5])
    s = DIRECTIONS[:, None] if t is None else DIRECTIONS[:, None, None]
    table = pw.rcs(body, s, lengths, t, bounces=bounces)
    assert table.shape == ((4, 3) if t is None else (4, 2, 3))
    places = [None] if t is None else list(t[:, 0])
    single = [
        [[pw.rcs(body, one, x, place, bounces=bounces) for x in lengths] for place in places]
        for one in DIRECTIONS
    ]
    np.testing.assert_allclose(table, np.reshape(single, table.shape), rtol=1e-9)
    assert isinstance(pw.rcs(body, DIRECTIONS[0], 0.3, bounces=bounces), float)
    assert pw.rcs(body, np.zeros((0, 3)), 0.3, bounces=bounces).shape == (0,)


def test_a_face_below_a_wavelength_is_warned_of() -> None:
    plank = extruded([(0, 0), (2, 0), (2, 0.1), (0, 0.1)], 3.0)  # ends of 2 m x 0.1 m
    for body, wavelength in ((BOX, 10.0), (BOX, 0.8), (plank, 0.5), ([HOLED, plank], 0.5)):
        with pytest.warns(PolywignerWarning, match="faces of several wavelengths"):
            pw.rcs(body, (0.0, 0.0, 1.0), wavelength)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        pw.rcs(BOX, (0.0, 0.0, 1.0), 0.6)  # the smallest face is 1 m x 0.5 m
        pw.rcs(sphere(3), (0.0, 0.0, 1.0), 0.5)  # fine facets of a smooth surface


@pytest.mark.parametrize(("body", "bounces"), [(L_BODY, 1), ([PLATE, UPRIGHT], 3)])
def test_a_pattern_is_a_table_of_sections(body: Any, bounces: int) -> None:
    azimuth, elevation = np.radians([-30.0, 0.0, 100.0]), np.radians([-90.0, 0.0, 40.0, 90.0])
    how: Any = {"polarisation": "hh", "bounces": bounces}
    result = pw.rcs_pattern(body, 0.3, azimuth, elevation, **how)
    assert result["rcs"].dims == ("azimuth", "elevation")
    for i, j in np.ndindex(3, 4 if bounces == 1 else 3):
        s = towards(90 - math.degrees(elevation[j]), math.degrees(azimuth[i]))
        expected = math.sqrt(pw.rcs(body, s, 0.3, **how))
        value = math.sqrt(result["rcs"].values[i, j])
        assert value == pytest.approx(expected, abs=1e-6 * plate(9, 0.3))
    assert result.attrs["largest_rcs"] == result["rcs"].values.max()
    assert result.attrs["bounces"] == bounces
    assert ("three reflections" in result["rcs"].attrs["method"]) == (bounces == 3)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((3.0, (0, 0, 1), 0.1), "bodies or obstacles to be Polyhedra"),
        (([], (0, 0, 1), 0.1), "empty list"),
        (([BOX, pw.Slits([(0, 1)])], (0, 0, 1), 0.1), "got Slits"),
        ((pw.Array([BOX, BOX], [1, -1]), (0, 0, 1), 0.1), "bodies without weights"),
        ((pw.shapes.square(1).with_illumination(pw.steering((0.1, 0), 0.1)), (0, 0, 1), 0.1),
         "plates without illuminations"),
        ((BOX, (0, 0, 2), 0.1), "of length 2"),
        ((BOX, (0, 1), 0.1), "unit vectors"),
        ((BOX, (0, 0, math.nan), 0.1), "unit vectors"),
        ((BOX, (0, 0, 1), -0.1), "wavelengths to be numbers above zero"),
        ((BOX, (0, 0, 1), "10 mm"), "wavelengths to be numbers"),
        ((BOX, np.eye(3), [0.1, 0.2]), "broadcast against"),
        ((BOX, (0, 0, 1), 0.1, None, "vx"), "expected polarisation"),
        ((BOX, (0, 0, 1), 0.1, None, 3), "expected polarisation"),
        ((BOX, (0, 0, 1), 0.1, None, ((1, 0, 0), (0, 0, 1))), "90 degrees"),
        ((BOX, (0, 0, 1), 0.1, None, ((2, 0, 0), (1, 0, 0))), "of length 2"),
        ({"elevation": 2.0}, "elevation to be angles"),
        ({"to_transmitter": np.eye(3)}, r"unit vectors of shape \(3,\)"),
        ({"polarisation": "circular"}, "expected polarisation"),
        *(({"bounces": n}, "bounces to be a whole number") for n in (0, 4, 1.5, "2", True)),
    ],
)  # fmt: skip
def test_wrong_arguments_are_refused(arguments: Any, message: str) -> None:
    with pytest.raises(ArgumentError, match=message):
        if isinstance(arguments, dict):
            pw.rcs_pattern(**{"body": BOX, "wavelength": 0.3, "azimuth": 0.0, "elevation": 0.0}
                           | arguments)  # fmt: skip
        else:
            pw.rcs(*arguments)


@pytest.mark.parametrize(
    ("body", "direction", "is_lit"),
    [
        (TRIHEDRAL, INWARDS, True),
        (TRIHEDRAL[:2], ACROSS, True),
        (L_BODY, ACROSS, True),
        (WEDGE, ACROSS, True),
        ([GROUND, BOX], towards(45, 0), True),  # a box on the ground
        (WALL, towards(60, 0), True),
        (WALL, towards(60, 180), True),  # from behind
        (WALL, towards(60, 90), False),
        ([SLAB, moved(FIN, 0, 0, -0.01)], towards(60, 0), True),  # its edge is inside the slab
        (joined([SLAB, moved(FIN, 0, 0, 0.3)]), towards(60, 40), True),  # above it, in one mesh
        ([SLAB, FIN], towards(180, 0), False),  # hidden by the slab
        (TRIHEDRAL, -INWARDS, False),  # outside
        (TRIHEDRAL, np.eye(3)[2], False),  # along two of its plates
        (L_BODY, towards(90, 300), False),
        (HOLED, DIRECTIONS, False),
        (sphere(1), DIRECTIONS, False),
        (torus(40, 20), DIRECTIONS, False),  # smooth
        ([PLATE, PLATE.placed(at(0, 0, 0.5))], DIRECTIONS, False),
        ([PLATE, PLATE.placed(at(1, 0, 0))], DIRECTIONS, False),  # coplanar plates
        ([block(1, 1, 1), moved(block(1, 1, 1), 1, 0, 0)], DIRECTIONS, False),  # halves of a box
        (joined([block(1, 1, 1), moved(block(1, 1, 1), 1, 0, 0)]), DIRECTIONS, False),
        (SINGLE, DIRECTIONS, False),
    ],
)
def test_faces_that_light_each_other_at_a_concave_edge_are_warned_of(
    body: Any, direction: np.ndarray, is_lit: bool
) -> None:
    with warnings.catch_warnings(record=True) as result:
        warnings.simplefilter("always")
        pw.rcs(body, direction, 0.05)
    assert [w.category for w in result] == [PolywignerWarning] * is_lit
    for about in result:
        assert "two or three reflections" in str(about.message)
        assert "pass bounces=3" in str(about.message)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        pw.rcs(body, np.atleast_2d(direction)[0], 0.05, bounces=2)


def test_concave_edges_near_an_antenna_are_warned_of() -> None:
    feed, place = pw.shapes.square(0.05), 5.0 * INWARDS
    with pytest.warns(PolywignerWarning, match="two or three reflections"):
        pw.rcs(TRIHEDRAL, place, 0.05, source=feed, tolerance=0.1)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        pw.rcs(TRIHEDRAL, -place, 0.05, source=feed, tolerance=0.1)
