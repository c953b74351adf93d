"""Poses of receivers in front of transmitters."""

import math

import numpy as np


def pose(x: float, y: float, z: float, tilt: float = 0.0, spin: float = 0.0) -> np.ndarray:
    """Return a pose that faces the transmitter, with angles in radians."""
    c, s = math.cos(math.pi + tilt), math.sin(math.pi + tilt)
    a, b = math.cos(spin), math.sin(spin)
    turned = np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]]) @ [[a, -b, 0], [b, a, 0], [0, 0, 1]]
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = turned, (x, y, z)
    return matrix
