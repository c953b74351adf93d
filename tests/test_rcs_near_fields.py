"""Cross sections close to radar antennas, against quadrature, image sources and far fields."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

import mitsuba_scenes
import polywigner as pw
from oracles.meshes import extruded
from polywigner.errors import ArgumentError, GeometryError, PolywignerWarning

# Tolerance of amplitudes; powers have twice this error.
TOLERANCE = 1e-3
WAVELENGTH = 0.02
FEED = pw.shapes.rectangle(0.06, 0.04)
OTHER = pw.shapes.square(0.03)
L_BODY = extruded([(-0.1, -0.1), (0.1, -0.1), (0.1, 0), (0, 0), (0, 0.1), (-0.1, 0.1)], 0.1)
PLATE = pw.shapes.square(0.2)
# Options for powers in (SC3) of docs/rcs.md that are the integral of |u|^2 instead of the radiated
# power.
APERTURE: Any = {"return_power": True, "normalise": "aperture"}


def unit(*vector: float) -> np.ndarray:
    return np.array(vector) / np.linalg.norm(vector)


S, T = unit(0.2, 0.1, 1.0), unit(-0.5, 0.3, 1.0)


def grid(width: float, height: float, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Return points (n, 3) on a rectangle about the origin, and their areas."""
    nodes, weights = np.polynomial.legendre.leggauss(count)
    x, y = np.meshgrid(nodes * width / 2, nodes * height / 2, indexing="ij")
    points = np.stack([x, y, np.zeros_like(x)], axis=-1).reshape(-1, 3)
    return points, np.outer(weights, weights).ravel() * width * height / 4


def field_and_slope(
    width: float, height: float, pose: np.ndarray, points: np.ndarray, normal: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the first Rayleigh-Sommerfeld integral of a rectangle per root of int |u|^2.

    The points (n, 3) are mapped by ``pose`` to the frame of the rectangle. The second result is the
    derivative of the field along a normal, divided by ik.
    """
    k = 2 * np.pi / WAVELENGTH
    places, areas = grid(width, height, 10)
    at, along = points @ pose[:3, :3].T + pose[:3, 3], pose[:3, :3] @ normal
    way = at[:, None] - places
    r = np.linalg.norm(way, axis=2)
    wave = np.exp(1j * k * r) * areas / (2 * np.pi * math.sqrt(width * height))
    f = (1 / r**3 - 1j * k / r**2) * wave  # times z
    f_of_r = (1j * k / r**3 - 3 / r**4 + k * k / r**2 + 2j * k / r**3) * wave
    slope = along[2] * f + way[..., 2] * f_of_r * ((way @ along) / r)
    return (way[..., 2] * f).sum(axis=1), slope.sum(axis=1) / (1j * k)


def looking(at: np.ndarray) -> np.ndarray:
    """Return a pose at a point whose z axis points to the origin."""
    return np.linalg.inv(mitsuba_scenes.looking(at, -at, (0.6, 0.8, 0.0)))


@pytest.mark.parametrize("distance", [pytest.param(0.25, marks=pytest.mark.slow), 1.0])
def test_a_plate_near_a_radar_is_that_of_quadrature(distance: float) -> None:
    pose = looking(distance * unit(0.03, -0.02, 1.0))
    points, areas = grid(0.2, 0.2, 36)
    field, slope = field_and_slope(0.06, 0.04, pose, points, np.array([0.0, 0.0, 1.0]))
    expected = abs((field * slope * areas).sum()) ** 2
    _, power = pw.rcs(PLATE, pose, WAVELENGTH, polarisation="vv", source=FEED, **APERTURE)
    content = (np.abs(field * slope) * areas).sum()
    assert math.sqrt(power) == pytest.approx(math.sqrt(expected), abs=TOLERANCE * content)
    assert content < 10 * math.sqrt(expected)  # no null


@pytest.mark.parametrize("body", [PLATE, L_BODY], ids=["plate", "L"])
@pytest.mark.parametrize("polarisation", [None, "hh", "vh"])
def test_far_away_it_is_the_cross_section(body: Any, polarisation: Any) -> None:
    far = pw.rcs(body, S, WAVELENGTH, T, polarisation)
    at = np.array([30.0, 60.0])[:, None]  # separate parts
    near = pw.rcs(body, at * S, WAVELENGTH, at * T, polarisation, source=FEED, receiver=OTHER)
    rest = np.abs(np.sqrt(near) - math.sqrt(far))
    size = math.sqrt(4 * np.pi) * 0.04 / WAVELENGTH
    # The remaining error decreases at least as 1/R.
    assert rest[1] < 0.51 * rest[0] + 2e-4 * size
    assert rest[1] < 2e-2 * size


def test_a_small_body_has_its_section_near_an_antenna_too() -> None:
    body = pw.shapes.square(0.02)
    at = np.array([0.0, 0.0, 0.3])  # inside the near field of 0.36 m
    result = pw.rcs(body, at, WAVELENGTH, source=pw.shapes.square(0.06))
    assert 10 * math.log10(result / pw.rcs(body, (0, 0, 1), WAVELENGTH)) == pytest.approx(
        0, abs=0.3
    )


def test_shadows_near_a_radar_are_those_of_rays() -> None:
    small = pw.Aperture([(-0.02, -0.03), (0.03, -0.02), (0.01, 0.03)])
    pose = np.eye(4)
    pose[:3, 3] = 0.01, 0.02, 0.1
    at = np.array([0.05, 0.03, 0.45])
    radar = looking(at)
    pair = [PLATE, small.placed(pose)]
    _, power = pw.rcs(pair, radar, WAVELENGTH, polarisation="vv", source=FEED, **APERTURE)
    outline = np.asarray(small.rings[0])
    sides = np.roll(outline, -1, axis=0) - outline

    def inside(places: np.ndarray) -> np.ndarray:
        beside = places[:, None, :2] - outline
        return (sides[:, 0] * beside[..., 1] - sides[:, 1] * beside[..., 0] > 0).all(axis=1)

    points, areas = grid(0.2, 0.2, 100)
    # Intersections of rays from the radar with the plane of the small plate.
    through = at + (points - at) * ((at[2] - 0.1) / at[2])
    shadow = inside(through - pose[:3, 3])
    others, their = grid(0.06, 0.06, 100)
    others += (0.005, 0.0, 0.0)
    lit = inside(others)
    every = np.concatenate([points[~shadow], others[lit] + pose[:3, 3]])
    field, slope = field_and_slope(0.06, 0.04, radar, every, np.array([0.0, 0.0, 1.0]))
    total = (field * slope * np.concatenate([areas[~shadow], their[lit]])).sum()
    # The grid is 100 cells wide, and the shadow edge has an error of half a cell.
    assert math.sqrt(power) == pytest.approx(abs(total), rel=1e-2)


def test_an_antenna_with_a_null_at_the_body_has_a_power_alone() -> None:
    halves = [FEED.moved((-0.05, 0.0)), FEED.moved((0.05, 0.0))]
    odd = pw.Array(halves, [1.0, -1.0])
    with pytest.warns(PolywignerWarning, match="a null at the centre"):
        sigma, power = pw.rcs(PLATE, (0, 0, 1.0), WAVELENGTH, source=odd, return_power=True)
    assert sigma == math.inf
    assert 0 < power < 1


def test_the_radar_equation_has_its_decibels() -> None:
    """10 dBm, antennas of 0 dBi, and 20 dBsm at 10 m and 24.125 GHz give -81.089 dBm.

    The gain of an antenna is the directivity of its pattern.
    """
    wavelength = pw.SPEED_OF_LIGHT / 24.125e9
    patch = pw.shapes.square(0.4 * wavelength)
    gain = pw.radiation_pattern(patch, wavelength, 0.0, 0.0).attrs["largest_directivity"]
    plate = pw.shapes.square(math.sqrt(10 * wavelength / math.sqrt(4 * math.pi)))
    assert pw.rcs(plate, (0, 0, 1), wavelength) == pytest.approx(100)
    sigma, power = pw.rcs(plate, (0, 0, 10.0), wavelength, source=patch, return_power=True)
    received = 10 + 10 * math.log10(power) - 2 * gain
    curved = 10 * math.log10(sigma / 100)  # the plate of 19 cm is not in the far field at 10 m
    assert received - curved == pytest.approx(-81.089, abs=1e-3)
    assert -0.3 < curved < 0


def test_cross_sections_are_the_same_however_powers_count() -> None:
    """Both definitions of power differ by the squared radiated fractions."""
    at = 0.5 * S, WAVELENGTH, 0.6 * T
    result, expected = (
        pw.rcs(PLATE, *at, source=FEED, receiver=OTHER, return_power=True, normalise=count)
        for count in ("radiated", "aperture")
    )
    assert result[0] == pytest.approx(expected[0], rel=1e-12)
    shares = [pw.radiated_power(s, WAVELENGTH) / s.area for s in (FEED, OTHER)]
    assert result[1] == pytest.approx(expected[1] / math.prod(shares), rel=1e-12)
    assert math.prod(shares) < 0.9


@pytest.mark.parametrize(
    ("arguments", "keywords", "error", "message"),
    [
        (((0, 0, 1), 0.1), {"receiver": FEED}, ArgumentError, "require a source"),
        (((0, 0, 0), 0.02), {"source": FEED}, ArgumentError, "zero"),
        (((0, 0, 1e200), 0.02), {"source": FEED}, ArgumentError, "not finite"),
        (((0, 0), 0.02), {"source": FEED}, ArgumentError, "in m from the body"),
        (((0, 0, 1), 0.02), {"source": PLATE, "tolerance": 1.0}, ArgumentError, "tolerance"),
        (((0, 0, 1), 0.02), {"source": PLATE, "normalise": "all"}, ArgumentError, "normalise"),
        (
            ((0, 0, 9), 0.02),
            {"source": FEED, "bounces": 2},
            ArgumentError,
            "cannot be combined with a source",
        ),
        ((np.eye(4), 0.02), {"source": FEED}, GeometryError, "in front of the plane of the source"),
        ((2 * np.eye(4), 0.02), {"source": FEED}, GeometryError, "to_radar to be rigid poses"),
    ],
)
def test_wrong_arguments_are_refused(
    arguments: Any, keywords: Any, error: Any, message: str
) -> None:
    with pytest.raises(error, match=message):
        pw.rcs(PLATE, *arguments, **keywords)


@pytest.mark.parametrize("pair", [("30 deg", "right"), ((1, 0.2j), "y")])
def test_polarised_antennas_weigh_currents_in_vector_fields(pair: Any) -> None:
    """The coupling b is the integral of E_r . (n x H_t) over a tilted plate, by Gauss nodes."""
    pose = looking(1.0 * unit(0.3, -0.2, 1.0))
    points, areas = grid(0.2, 0.2, 36)
    at, turn = points @ pose[:3, :3].T + pose[:3, 3], pose[:3, :3]
    jones = {"y": (0, 1), "30 deg": (math.cos(math.pi / 6), 0.5), "right": (1, 1j)}
    received, sent = (np.array(jones.get(p, p) if isinstance(p, str) else p) for p in pair)
    electric = pw.field(FEED, at, WAVELENGTH, received) @ turn
    magnetic = pw.field(FEED, at, WAVELENGTH, (-sent[1], sent[0])) @ turn
    value = (electric * np.cross((0.0, 0.0, 1.0), magnetic)).sum(axis=1)
    expected, content = abs(value @ areas) / FEED.area, np.abs(value) @ areas / FEED.area
    _, power = pw.rcs(PLATE, pose, WAVELENGTH, polarisation=pair, source=FEED, **APERTURE)
    assert math.sqrt(power) == pytest.approx(expected, abs=TOLERANCE * content)


def test_a_plate_turns_the_hand_of_a_circular_wave() -> None:
    at, plate = (0.0, 0.0, 1.0), pw.shapes.square(0.1)
    same, other, linear, crossed = (
        pw.rcs(plate, at, WAVELENGTH, polarisation=p, source=FEED)
        for p in ("right", ("left", "right"), "x", ("y", "x"))
    )
    assert other == pytest.approx(linear, rel=1e-2)
    assert max(same, crossed) < 1e-4 * linear
    named = pw.rcs(plate, at, WAVELENGTH, polarisation="hh", source=FEED)
    assert linear == pytest.approx(named, rel=2e-2)  # both on the axis


@pytest.mark.parametrize("named", ["vv", "vh", "hv"])
def test_far_away_polarised_antennas_have_the_named_cross_section(named: str) -> None:
    """A source that points at the body has its y axis along v, and its x axis along h or -h."""
    own = [{"v": "y", "h": "x"}[letter] for letter in named]
    far = pw.rcs(PLATE, S, WAVELENGTH, T, named)
    near = pw.rcs(PLATE, 60.0 * S, WAVELENGTH, 60.0 * T, own, source=FEED, receiver=OTHER)
    assert near == pytest.approx(far, rel=2e-3)
