"""Friis' formula and the radar equation with directivities of patterns."""

import math
from typing import Any

import numpy as np
import pytest

import polywigner as pw
from oracles.poses import pose as facing

EXACT = ("rayleigh-sommerfeld-1", "rayleigh-sommerfeld-2", "kirchhoff")
# Distance, in units of the Fraunhofer distance 2 D^2/wavelength, at which quadratic phases are 1e-3
# rad.
FAR = 1000.0
# Error in dB due to quadratic phases of a curved source; 1e-6 dB for flat sources.
DECIBELS = 1e-3


def square(side):
    """Return a square; all lengths are in wavelengths of 1 m."""
    return pw.shapes.square(side)


ROW = pw.phased_array(
    square(0.4),
    pw.arrays.grid_positions(8, 1, 0.5, 0.5),
    np.exp(2j * np.pi * math.sin(math.pi / 6) * 0.5 * np.arange(8)),
)
# Source, diameter in wavelengths, and angles of the line of sight from both normals.
LINKS: dict[str, tuple[Any, float, float, float]] = {
    **{f"{side} wavelengths": (square(side), 1.42 * side, 0.25, -0.15) for side in (0.3, 0.47, 1)},
    "3 wavelengths": (square(3.0), 4.25, 0.1, -0.2),
    "10 wavelengths": (square(10.0), 14.2, 0.02, 0.03),
    "steered row": (ROW, 3.95, math.pi / 6, math.pi / 6 + 0.03),
}
CURVED = {"curved": (square(3.0).curved(20.0, 1.0), 4.25, 0.1, -0.2)}
CASES = [(name, obliquity) for name in LINKS for obliquity in EXACT] + [("curved", EXACT[0])]


def along(angle):
    """Return a direction at an angle from z towards x."""
    return np.array([math.sin(angle), 0.0, math.cos(angle)])


def placed(angle, other, distance):
    """Return the pose of a source at a distance, with these angles to the line of sight."""
    pose = facing(*(distance * along(angle)), angle - other)
    # As seen from the second source, the first source is at the angle ``other``.
    assert np.allclose(-pose[:3, :3].T @ along(angle), along(other))
    return pose


def directivity(source, angle, obliquity):
    """Return the directivity in dBi."""
    pattern = pw.radiation_pattern(source, 1.0, angle, 0.0, obliquity=obliquity)  # type: ignore
    return float(pattern["directivity"].values.item())


def decibels(power):
    return 10 * math.log10(power)


def link(name, obliquity):
    """Return both sources, the receiver's pose, and Friis' power ratio in dB."""
    source, diameter, *angles = (LINKS | CURVED)[name]
    distance = FAR * 2 * diameter**2
    gains = sum(directivity(source, angle, obliquity) for angle in angles)
    pose = placed(angles[0], angles[1], distance)
    return source, pose, gains - 2 * decibels(4 * math.pi * distance)


@pytest.mark.parametrize(("name", "obliquity"), CASES)
def test_far_away_a_coupling_is_friis_with_directivities(name, obliquity):
    source, pose, expected = link(name, obliquity)
    b = pw.coupling(source, source, pose, 1.0, obliquity)
    assert decibels(abs(b) ** 2) == pytest.approx(expected, abs=DECIBELS)


@pytest.mark.parametrize("name", LINKS)
def test_a_small_plate_far_away_echoes_by_the_radar_equation(name):
    """For a plate across the line of sight, |b|^2 = G^2 lambda^2 sigma/((4 pi)^3 r^4)."""
    source, diameter, angle, _ = LINKS[name]
    distance = FAR * 2 * max(diameter, 2.0) ** 2
    plate = square(1.4)
    pose = placed(angle, 0.0, distance)
    _, power = pw.rcs(plate, pose, 1.0, source=source, polarisation="vv", return_power=True)
    sigma = 4 * math.pi * plate.area**2
    gain = directivity(source, angle, EXACT[0])
    expected = 2 * gain + decibels(sigma / ((4 * math.pi) ** 3 * distance**4))
    assert decibels(power) == pytest.approx(expected, abs=DECIBELS)


@pytest.mark.parametrize("obliquity", EXACT)
def test_propagating_waves_bring_no_more_than_all(obliquity):
    """At a distance of a wavelength, evanescent waves are negligible."""
    for side in (0.47, 1.0, 3.0):
        poses = [placed(angle, -angle, 1.0 + 2 * side * abs(angle)) for angle in (0.0, 0.3)]
        shares = np.abs(pw.coupling(square(side), square(side), poses, 1.0, obliquity, 1e-4)) ** 2
        assert (shares < 1).all()
    assert shares[0] > 0.7
