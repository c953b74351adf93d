"""Integrals of chirps against 30-digit quadrature, from no turn of phase to hundreds."""

import mpmath
import numpy as np
import pytest

from polywigner.numerics.chirps import chirp_integral, fresnel_tail

# Rounding of phases of some hundred turns and of some tens of terms.
ROUNDING = 1e-14


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
    assert np.array_equal(table, single)


def test_a_tail_is_fresnels_and_falls_off_as_its_first_term() -> None:
    """T(0) = sqrt(pi/4) exp(i pi/4), T -> i/(2 r)."""
    assert fresnel_tail(0.0) == pytest.approx(np.sqrt(np.pi) / 2 * np.exp(0.25j * np.pi), rel=1e-14)
    assert fresnel_tail(1e6) == pytest.approx(0.5j / 1e6, rel=1e-11)
    r = np.linspace(0.1, 30.0, 200)
    with mpmath.workdps(40):
        turn = mpmath.expjpi(mpmath.mpf(1) / 4)
        expected = [
            complex(turn * mpmath.sqrt(mpmath.pi) / 2 * mpmath.exp(-z * z) * mpmath.erfc(-1j * z))
            for z in (turn * mpmath.mpf(value) for value in r[::10])
        ]
    assert abs(fresnel_tail(r[::10]) / expected - 1).max() < ROUNDING
