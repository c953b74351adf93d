"""Gaussian waves over polygons and intervals, against integrals of error functions."""

from __future__ import annotations

import mpmath as mp
import numpy as np
import pytest

from polywigner.execution import NumpyOperations
from polywigner.kernels.functions.gauss_schell import wave_over_edge, wave_over_interval

# Of the square of the largest lag, in double and in single precision.
ERROR = {True: 1e-12, False: 1e-6}
# The same for complex values of the widest coherence in single precision.
COMPLEX_ERROR = {True: 1e-12, False: 2e-5}

# A pentagon around the origin, and one that is far from being symmetric beside it.
AROUND = np.array([(1.3, -0.4), (0.6, 1.1), (-1.2, 0.9), (-0.8, -1.2), (0.9, -1.0)])
BESIDE = np.array([(0.2, 0.1), (1.0, 0.15), (0.6, 1.0), (0.55, 0.3)])
REACH = 1.6


def over_polygon(corners: np.ndarray, nu: np.ndarray, double: bool) -> complex:
    edges = np.roll(corners, -1, axis=0) - corners
    lengths = np.hypot(*edges.T)
    ux, uy = edges.T / lengths
    start = corners[:, 0] * ux + corners[:, 1] * uy
    arguments = (
        start,
        start + lengths,
        corners[:, 0] * uy - corners[:, 1] * ux,
        nu[0] * ux + nu[1] * uy,
        nu[0] * uy - nu[1] * ux,
    )
    ops = NumpyOperations(double)
    real, imag = wave_over_edge(ops, *(a.astype(ops.dtype) for a in arguments))
    return complex(real.sum(), imag.sum())


def by_error_functions(corners: np.ndarray, nu: np.ndarray) -> complex:
    """Green's theorem with the antiderivative along x, and Gauss-Legendre panels along y."""
    nodes, weights = np.polynomial.legendre.leggauss(20)
    total = mp.mpc(0)
    with mp.workdps(25):
        bx, by = (2 * mp.pi * mp.mpf(float(n)) for n in nu)
        factor = mp.sqrt(mp.pi / 2) * mp.exp(-bx * bx / 2)
        for (ax, ay), (cx, cy) in zip(corners, np.roll(corners, -1, axis=0), strict=True):
            if max(min(ay, cy), -9.0) >= min(max(ay, cy), 9.0):
                continue
            low, high = np.clip((ay, cy), -9.0, 9.0)
            slope = (cx - ax) / (cy - ay)
            turns = (abs(nu[1]) + abs(nu[0] * slope)) * abs(high - low)
            panels = 1 + int(abs(high - low) * np.hypot(1, slope) / 2 + turns)
            for panel in range(panels):
                half = (high - low) / panels / 2
                for node, weight in zip(nodes, weights, strict=True):
                    y = low + (2 * panel + 1 + node) * half
                    x = ax + slope * (y - ay)
                    if abs(x) > 12 and abs(y) > 9:
                        continue
                    inner = factor * mp.erf((x + 1j * bx) / mp.sqrt(2))
                    total += weight * half * inner * mp.exp(-y * y / 2 - 1j * by * y)
    return complex(total)


@pytest.mark.parametrize("size", [0.02, 1.0, 3.0, 30.0])
@pytest.mark.parametrize("corners", [AROUND, BESIDE], ids=["around", "beside"])
def test_a_gaussian_wave_over_a_polygon_is_a_sum_over_its_edges(
    corners: np.ndarray, size: float
) -> None:
    largest = (REACH * size) ** 2
    for cycles, direction in (
        (0.0, (0.8, 0.6)),
        (0.05, (0.8, 0.6)),
        (0.7, (0.6, -0.8)),
        (4.0, (0.8, 0.6)),
    ):
        nu = cycles * np.array(direction) / min(size, 2.0)
        expected = by_error_functions(size * corners, nu)
        for double in (True, False):
            found = over_polygon(size * corners, nu, double)
            assert abs(found.real - expected.real) <= ERROR[double] * largest
            assert abs(found - expected) <= COMPLEX_ERROR[double] * largest


@pytest.mark.parametrize("double", [True, False])
@pytest.mark.parametrize("size", [0.02, 1.0, 4.0, 50.0])
def test_a_gaussian_wave_over_an_interval_is_an_error_function(size: float, double: bool) -> None:
    ops = NumpyOperations(double)
    for low, high in ((-1.0, 1.0), (-0.1, 0.9), (0.3, 0.35), (0.0, 1.0)):
        for cycles in (0.0, 0.4, 1.1, 5.0, 200.0):
            beta = 2 * mp.pi * cycles / min(size, 2.0)
            with mp.workdps(60):
                ends = [(size * end + 1j * beta) / mp.sqrt(2) for end in (low, high)]
                scale = mp.sqrt(mp.pi / 2) * mp.exp(-beta * beta / 2)
                # as differences of erfc, which do not cancel
                expected = complex(scale * (mp.erfc(ends[0]) - mp.erfc(ends[1])))
            arguments = (size * low, size * high, float(beta / (2 * mp.pi)))
            wave = wave_over_interval(ops, *(np.array([a], ops.dtype) for a in arguments))
            assert abs(complex(wave[0][0], wave[1][0]) - expected) <= ERROR[double] * size
