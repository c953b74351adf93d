"""Integrals of chirps against 30-digit quadrature, from no turn of phase to hundreds."""

import mpmath
import numpy as np
import pytest

from polywigner.numerics.chirps import chirp_integral

# Rounding of phases of some hundred turns and of some tens of terms.
ROUNDING = 1e-14
# Of integrals over a turn of phase at most, of ends below 1: some ten roundings.
FEW_ROUNDINGS = 2e-15


def exact(end: float, c: float, f: float) -> complex:
    with mpmath.workdps(30):
        b, c, f = (mpmath.mpf(v) for v in (end, c, f))
        pieces = int(abs(b) * max(abs(f), abs(c * b - f))) // 3 + 2
        path = mpmath.linspace(0, b, pieces)
        return complex(mpmath.quad(lambda t: mpmath.expjpi(c * t * t - 2 * f * t), path))


@pytest.mark.parametrize("seed", range(12))
def test_an_integral_keeps_its_digits_relative_to_its_length(seed: int) -> None:
    rng = np.random.default_rng(seed)
    end = rng.uniform(-1, 1)
    c = 10 ** rng.uniform(-12, 1.7) * rng.choice([-1, 1])
    f = 10 ** rng.uniform(-8, 1.5) * rng.choice([-1, 1])
    assert abs(chirp_integral(end, c, f) - exact(end, c, f)) < ROUNDING * abs(end)


def test_a_wave_without_curvature_is_one() -> None:
    for f in (0.0, 1e-9, 0.3, -41.0):
        assert abs(chirp_integral(0.7, 0.0, f) - exact(0.7, 0.0, f)) < ROUNDING


def test_values_do_not_depend_on_what_they_are_computed_with() -> None:
    ends, f = np.linspace(-1, 1, 9), np.array([[-4.0], [0.2], [30.0]])
    table = chirp_integral(ends, 3.0, f)
    single = [[chirp_integral(end, 3.0, value) for end in ends] for value in f[:, 0]]
    assert abs(table - single).max() < FEW_ROUNDINGS


def test_an_integral_about_a_stationary_place_keeps_its_digits() -> None:
    """Curvatures at which a rule of Gauss passes over into Fresnel integrals, and around."""
    for bend in (1e-6, 0.02, 0.1, 0.124, 0.126, 0.2, 0.5, 1.0):
        for share in (0.0, 0.3, 0.5, 1.0):
            found = chirp_integral(0.7, bend / 0.49, share * bend / 0.7)
            assert abs(found - exact(0.7, bend / 0.49, share * bend / 0.7)) < FEW_ROUNDINGS


def test_curvatures_of_both_signs_and_none_go_together() -> None:
    c, f = np.array([[-3.0], [0.0], [1e-9], [3.0]]), np.array([[0.5], [2.0], [-2.0], [0.0]])
    table = chirp_integral([-0.4, 0.0, 0.9], c, f)
    for k, (curvature, frequency) in enumerate(zip(c[:, 0], f[:, 0], strict=True)):
        single = [chirp_integral(end, curvature, frequency) for end in (-0.4, 0.0, 0.9)]
        assert abs(table[k] - single).max() < FEW_ROUNDINGS


@pytest.mark.parametrize("curvature", [0.0, 1e-9, 3.0, -3.0])
def test_no_end_is_no_integral(curvature: float) -> None:
    assert chirp_integral(0.0, curvature, 1.0) == 0.0
