"""Links between two sources against reference values, integrals of fields and closed forms."""

import math
from typing import Any

import numpy as np
import pytest
import shapely

import polywigner as pw
from oracles.poses import pose
from oracles.quadrature import nodes_on
from oracles.references import read_json
from polywigner.errors import ArgumentError, GeometryError, IlluminationError

WAVELENGTH = pw.SPEED_OF_LIGHT / 94e9
APERTURE: Any = {"normalise": "aperture"}
EXACT = ["rayleigh-sommerfeld-1", "rayleigh-sommerfeld-2", "kirchhoff"]
SQUARE = pw.shapes.square(10e-3)
COSINE = SQUARE.with_illumination(pw.Illumination([0.5, 0.5], [(50.0, 0.0), (-50.0, 0.0)]))
STEERED = SQUARE.with_illumination(pw.Illumination([1.0], [(0.3 / WAVELENGTH, 0.0)]))
L_SHAPE = pw.Aperture(1e-3 * np.array([(0, 0), (12, 0), (12, 4), (4, 4), (4, 12), (0, 12)]) - 6e-3)
PAIR = pw.Aperture([1e-3 * np.array([(0, 0), (3, 0), (3, 5)]) + (x, 0) for x in (-4e-3, 2e-3)])
HOLED = pw.Aperture(shapely.Polygon([(0, 0), (8e-3, 1e-3), (5e-3, 7e-3)], [[(4e-3, 2e-3),
    (5e-3, 2e-3), (5e-3, 4e-3)]]))  # fmt: skip
REFERENCE = {
    name: case for name, case in read_json("links").items() if not name.startswith("triangle")
}
SOURCES = {
    "square to L, shifted, tilted": (SQUARE, L_SHAPE),
    "TE10 square to square, tilted": (COSINE, SQUARE),
    "steered square to TE10 square": (STEERED, COSINE),
}
# Error due to the rounding of sums, and to the reference values (2.5e-14).
ROUNDING = 1e-12
# Error of sums of some hundred fields, each with an error of 1e-12.
FIELDS = 1e-10


def norm(source):
    """Return the integral of |u|^2."""
    return float(np.real(pw.lag_marginal(source, (0.0, 0.0))))


# Factors a and b of the far field a c + b of a wave at the cosine c.
FACTORS = {"rayleigh-sommerfeld-2": (0.0, 1.0), "kirchhoff": (0.5, 0.5)}


def rays(count=64):
    """Return unit vectors (n, 3) in the front hemisphere, and solid angles."""
    node, weight = np.polynomial.legendre.leggauss(count)
    theta, phi = np.meshgrid(math.pi / 4 * (node + 1), np.arange(2 * count) * math.pi / count)
    sine = np.sin(theta)
    result = np.stack([sine * np.cos(phi), sine * np.sin(phi), np.cos(theta)], axis=-1)
    return result.reshape(-1, 3), (weight * sine).ravel() * math.pi**2 / (4 * count)


def radiated(one, method, other=None):
    """Return the integral of g F* F' dOmega/wavelength^2, (RX1) of docs/links.md."""
    directions, solid_angles = rays()
    a, b = FACTORS.get(method, (1.0, 0.0))
    share = (a * directions[:, 2] + b) ** 2 * solid_angles / WAVELENGTH**2
    far, second = (pw.fourier(s, directions[:, :2] / WAVELENGTH) for s in (one, other or one))
    return complex((share * far.conj()) @ second)


@pytest.mark.parametrize("method", EXACT)
@pytest.mark.parametrize("name", REFERENCE)
def test_couplings_have_their_reference_values(name, method):
    case, pair = REFERENCE[name], SOURCES.get(name, (SQUARE, SQUARE))
    expected = complex(*case["coupling"][method])
    for tolerance in (1e-6, 1e-10):
        result = pw.coupling(
            *pair, case["to_transmitter"], WAVELENGTH, method, tolerance, normalise="aperture"
        )
        assert abs(result - expected) <= tolerance * abs(expected)


@pytest.mark.parametrize("method", [*EXACT, "fraunhofer"])
def test_powers_of_a_link_are_those_that_its_sources_radiate(method):
    pair, place = (STEERED, COSINE), pose(4e-3, -3e-3, 41e-3, 0.0, 0.5)
    counts = ("radiated", "aperture")
    by = {n: pw.coupling(*pair, place, WAVELENGTH, method, 1e-4, normalise=n) for n in counts}
    expected = math.prod(norm(source) / radiated(source, method).real for source in pair)
    result = by["radiated"] / by["aperture"]
    assert result == pytest.approx(expected**0.5, rel=ROUNDING)
    assert abs(expected - 1) > 0.03


@pytest.mark.parametrize("method", EXACT)
def test_a_coupling_is_the_same_in_both_directions(method):
    to_transmitter = pose(8e-3, -5e-3, 21e-3, 0.5, 0.8)
    pair = (COSINE, L_SHAPE.with_illumination(pw.Illumination([1, 0.4j], [(80, 20), (-30, 150)])))
    there = pw.coupling(*pair, to_transmitter, WAVELENGTH, method)
    back = pw.coupling(*pair[::-1], np.linalg.inv(to_transmitter), WAVELENGTH, method)
    assert abs(there - back) <= 2e-6 * abs(there)


@pytest.mark.parametrize(
    ("receiver", "place"),
    [(HOLED, (3e-3, 1e-3, 12e-3, 0.3, 1.0)), (COSINE, (30e-3, 0, 9e-3, 0.6, 0.2))],
)
def test_a_coupling_is_the_field_summed_over_the_receiver(receiver, place):
    to_transmitter = pose(*place)
    places, weights = nodes_on(receiver, 24)
    points = places @ to_transmitter[:3, :2].T + to_transmitter[:3, 3]
    field = pw.amplitude(PAIR, points, WAVELENGTH, "rayleigh-sommerfeld-2", tolerance=1e-12)
    expected = field @ weights / math.sqrt(norm(PAIR) * norm(receiver))
    result = pw.coupling(
        PAIR, receiver, to_transmitter, WAVELENGTH, "rayleigh-sommerfeld-2", FIELDS, **APERTURE
    )
    assert abs(result - expected) <= 2 * FIELDS * abs(expected)


@pytest.mark.parametrize("distance", [1e5, 1e9, 1e13])
def test_phases_are_right_at_any_distance(distance):
    to_transmitter = pose(0.3 * distance, 0.1 * distance, distance, 0.2)
    exact = pw.coupling(COSINE, L_SHAPE, to_transmitter, WAVELENGTH, tolerance=1e-9)
    far = pw.coupling(COSINE, L_SHAPE, to_transmitter, WAVELENGTH, "fraunhofer")
    # The error of Fraunhofer's approximation decreases with the distance.
    assert abs(exact / far - 1) < max(1e-9, 0.1 / distance)


@pytest.mark.parametrize("normalise", ["radiated", "aperture"])
def test_an_array_couples_as_the_sum_of_its_elements(normalise):
    places = pw.arrays.grid_positions(4, 3, 2e-3, 2e-3)
    weights = np.exp(1j * np.arange(12)) * np.linspace(1, 2, 12)
    patch = pw.shapes.square(1.5e-3).with_illumination(pw.Illumination([1, 0.5], [(0, 0), (90, 0)]))
    array = pw.phased_array(patch, places, weights)
    to_transmitter = pose(5e-3, 0, 30e-3, 0.2)
    how: Any = {"tolerance": 1e-9, "normalise": normalise}
    result = pw.coupling(array, L_SHAPE, to_transmitter, WAVELENGTH, **how)
    total = 0j
    for place, weight in zip(places, weights, strict=True):
        own = np.eye(4)
        own[:2, 3] = -place
        total += weight * pw.coupling(patch, L_SHAPE, own @ to_transmitter, WAVELENGTH, **how)
    powers = [
        norm(s) if normalise == "aperture" else radiated(s, EXACT[0]).real for s in (patch, array)
    ]
    expected = total * math.sqrt(powers[0] / powers[1])
    assert abs(result - expected) < 1e-8 * abs(expected)


def test_estimated_errors_hold():
    poses = np.array([pose(4e-3, 0, z, 0.1) for z in (9e-3, 30e-3, 0.3)])
    pair = (L_SHAPE, STEERED)
    best = pw.coupling(*pair, poses, WAVELENGTH, tolerance=1e-10)
    for tolerance in (1e-2, 1e-4, 1e-7):
        result, errors = pw.coupling(
            *pair, poses, WAVELENGTH, tolerance=tolerance, return_error=True
        )
        assert (np.abs(result - best) <= errors + 1e-10).all()
        assert (errors <= tolerance * np.abs(result)).all()
        assert errors.min() < 0.5 * tolerance * np.abs(result).min()


def test_poses_broadcast_and_a_pose_gives_a_number():
    poses = np.array([[pose(x, 0, z) for x in (0, 5e-3, 9e-3)] for z in (20e-3, 40e-3)])
    result = pw.coupling(SQUARE, COSINE, poses, WAVELENGTH)
    assert result.shape == (2, 3)
    alone = pw.coupling(SQUARE, COSINE, poses[1, 2], WAVELENGTH)
    assert isinstance(alone, complex)
    assert abs(alone - result[1, 2]) <= 1e-6 * abs(alone)
    assert pw.coupling(SQUARE, COSINE, poses[:0], WAVELENGTH).shape == (0, 3)


def _changed(**entries):
    matrix = pose(0, 0, 0.1)
    for name, value in entries.items():
        matrix[int(name[1]), int(name[2])] = value
    return matrix


@pytest.mark.parametrize(
    ("place", "message"),
    [
        (np.diag([-1.0, 1.0, -1.0, 1.0]), "add a distance along z"),
        (pose(0, 0, -0.1), "the entire receiver must be in front of the plane of the transmitter"),
        (pose(0, 0, 0.1, math.pi), "rotate one source by 180 degrees"),
        (pose(0.1, 0, 2e-3, 0.7), "got its point .* move it forwards"),
        (
            pose(10e-3, 0, 9e-3, -0.6),
            "the entire transmitter must be in front of the plane of the receiver",
        ),
        ([pose(0, 0, 1), pose(0, 0, -1)], "in pose 1"),
        (_changed(m00=-2.0), "scales by .*; scale"),
        (_changed(m00=1.0), "mirror image"),
        (_changed(m23=math.nan), "numbers must be finite"),
        (_changed(m30=1.0), "last row"),
        (np.eye(3), r"shape \(3, 3\)"),
    ],
)
def test_poses_that_make_no_link_are_refused(place, message):
    with pytest.raises(GeometryError, match=message):
        pw.coupling(SQUARE, SQUARE, place, WAVELENGTH)


@pytest.mark.parametrize(
    ("change", "error", "message"),
    [
        ({"transmitter": pw.Slits([(0, 1e-3)])}, ArgumentError, "Slits"),
        ({"receiver": pw.Array([SQUARE, SQUARE], [1, -1])}, IlluminationError, "cancel"),
        ({"wavelength": 0.0}, ArgumentError, "wavelength"),
        ({"tolerance": 1e-14}, ArgumentError, "tolerance"),
        ({"wavelength": 1e-9, "to_transmitter": pose(0, 0, 1e-5)}, ArgumentError, "pairs of cells"),
        ({"polarisation": ("x", "y", "x")}, ArgumentError, "Jones"),
        ({"polarisation": (1.0, math.nan)}, ArgumentError, "Jones"),
        ({"polarisation": ("x", "up")}, ArgumentError, "45 deg"),
        ({"polarisation": "x", "method": "kirchhoff"}, ArgumentError, "magnetic"),
        ({"method": "magnetic"}, ArgumentError, "requires a polarisation"),
    ],
)
def test_other_arguments_are_refused(change, error, message):
    arguments = {"transmitter": SQUARE, "receiver": SQUARE, "to_transmitter": pose(0, 0, 0.1)}
    with pytest.raises(error, match=message):
        pw.coupling(**{**arguments, "wavelength": WAVELENGTH, **change})
