"""Slits: the transforms in one dimension against closed forms, quadrature and identities."""

from __future__ import annotations

import itertools
import math
import pickle
from fractions import Fraction

import mpmath
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import polywigner as pw
from polywigner.errors import ArgumentError, GeometryError
from polywigner.testing import (
    assert_fourier_stable,
    assert_otf_properties,
    assert_wigner_identities,
)

ROUNDING = 4e-15  # times the total width; sums of a few terms of that size


PAIR = pw.Slits([[-1.0, -0.4], [0.1, 0.9]])


@st.composite
def slits(draw: st.DrawFn) -> pw.Slits:
    """One to four slits whose ends lie on a lattice of 1/16, so that edges often coincide."""
    ends = draw(st.sets(st.integers(-32, 32), min_size=2, max_size=8))
    ordered = sorted(ends)[: len(ends) // 2 * 2]
    shift = draw(st.sampled_from([0.0, 1000.0]))
    return pw.Slits(np.reshape(ordered, (-1, 2)) / 16 + shift)


def _wave(intervals: list[tuple[Fraction, Fraction]], nu: float) -> complex:
    """Sum of the integrals of exp(-2 pi i nu x), with 50 digits."""
    with mpmath.workdps(50):
        total = mpmath.mpc(0)
        for a, b in intervals:
            low, high = (mpmath.mpf(v.numerator) / v.denominator for v in (a, b))
            wave = mpmath.expjpi(-mpmath.mpf(nu) * (low + high))
            total += (high - low) * mpmath.sincpi(mpmath.mpf(nu) * (high - low)) * wave
        return complex(total)


def _overlaps(first: list, second: list) -> list[tuple[Fraction, Fraction]]:
    pairs = ((max(a, c), min(b, d)) for a, b in first for c, d in second)
    return [(low, high) for low, high in pairs if low < high]


def _exact(source: pw.Slits) -> list[tuple[Fraction, Fraction]]:
    return [(Fraction(a), Fraction(b)) for a, b in source.intervals.tolist()]


frequencies = st.floats(-40, 40) | st.floats(-1e-9, 1e-9) | st.sampled_from([0.0, 1.0, 16.0])


@given(source=slits(), nu=frequencies)
def test_fourier_transform_is_a_sum_of_sincs(source: pw.Slits, nu: float) -> None:
    expected = _wave(_exact(source), nu)
    assert abs(pw.fourier(source, [nu]) - expected) < ROUNDING * source.length


@given(source=slits(), nu=frequencies, place=st.integers(-64, 64))
def test_wigner_function_is_the_transform_of_the_lag_slice(
    source: pw.Slits, nu: float, place: int
) -> None:
    x = place / 32 + source.bounds[0]
    here = [(2 * (a - Fraction(x)), 2 * (b - Fraction(x))) for a, b in _exact(source)]
    there = [(-b, -a) for a, b in here]
    overlaps = _overlaps(here, there)
    expected = _wave(overlaps, nu)
    allowed = 4 * ROUNDING * max(source.diameter, source.length)
    assert abs(expected.imag) < 1e-12
    assert abs(pw.wigner(source, [x], [nu]) - expected.real) < allowed
    width = float(sum(b - a for a, b in overlaps))
    assert abs(pw.position_marginal(source, [x]) - width) < allowed


@given(source=slits(), upsilon=frequencies, lag=st.integers(-64, 64))
def test_ambiguity_function_is_the_transform_of_the_position_slice(
    source: pw.Slits, upsilon: float, lag: int
) -> None:
    half = Fraction(lag, 32) / 2
    behind = [(a - half, b - half) for a, b in _exact(source)]
    ahead = [(a + half, b + half) for a, b in _exact(source)]
    overlaps = _overlaps(behind, ahead)
    xi = [lag / 32]
    allowed = ROUNDING * max(source.diameter, source.length)
    assert abs(pw.ambiguity(source, [upsilon], xi) - _wave(overlaps, upsilon)) < allowed
    width = float(sum(b - a for a, b in overlaps))
    assert abs(pw.lag_marginal(source, xi) - width) < allowed


def test_marginals_of_the_wigner_function_are_intensity_and_spectrum() -> None:
    nu = np.array([0.7])
    # W is piecewise analytic in x with kinks at the means of the ends
    ends = PAIR.intervals.ravel()
    kinks = np.unique((ends[:, None] + ends) / 2)
    nodes, weights = np.polynomial.legendre.leggauss(24)
    spectrum = 0.0
    for a, b in itertools.pairwise(kinks):
        x = (a + b) / 2 + (b - a) / 2 * nodes
        spectrum += (b - a) / 2 * weights @ pw.wigner(PAIR, x[:, None], nu)
    assert spectrum == pytest.approx(abs(pw.fourier(PAIR, nu)) ** 2, abs=1e-13)


def test_a_centred_slit_has_the_textbook_functions() -> None:
    width, x, nu, xi = 0.8, 0.15, 1.3, 0.3
    slit = pw.Slits([-width / 2, width / 2])
    length = width - 2 * abs(x)
    assert pw.wigner(slit, [x], [nu]) == pytest.approx(2 * length * np.sinc(2 * nu * length))
    length = width - abs(xi)
    assert pw.ambiguity(slit, [nu], [xi]) == pytest.approx(length * np.sinc(nu * length))


def test_complex_frequencies_continue_the_transform() -> None:
    nu = 0.4 + 0.2j
    expected = sum(
        (np.exp(-2j * math.pi * nu * b) - np.exp(-2j * math.pi * nu * a)) / (-2j * math.pi * nu)
        for a, b in PAIR.intervals
    )
    assert pw.fourier(PAIR, [nu]) == pytest.approx(expected, abs=1e-14)
    far = pw.Slits(PAIR.intervals + 3.0)
    assert pw.fourier(far, [nu]) == pytest.approx(expected * np.exp(-6j * math.pi * nu))


def test_slits_are_sorted_merged_where_they_touch_and_compared_by_content() -> None:
    touching = pw.Slits([[0.2, 0.1], [0.3, 0.2], [0.9, 0.5]])
    assert touching == pw.Slits([[0.5, 0.9], [0.1, 0.3]])
    assert hash(touching) == hash(pw.Slits([[0.1, 0.3], [0.5, 0.9]]))
    assert touching.length == pytest.approx(0.6)
    assert pickle.loads(pickle.dumps(touching)) == touching
    with pytest.raises(ValueError, match="read-only"):
        touching.intervals[0, 0] = 1.0
    with pytest.raises(AttributeError, match="cannot be changed"):
        touching.intervals = None  # type: ignore[misc]


@pytest.mark.parametrize(
    ("intervals", "message"),
    [
        ([[0, 1], [0.5, 2]], "do not overlap"),
        ([[0, 0]], "wider than zero"),
        ([[0, math.nan]], "finite"),
        ([0, 1, 2], r"\(m, 2\)"),
        ([], r"\(m, 2\)"),
        ("slit", r"\(m, 2\)"),
        (np.array([[0, 1j]]), r"\(m, 2\)"),
        (np.ma.masked_equal([[0.0, 1.0]], 1.0), "masked"),
    ],
)
def test_unusable_slits_are_refused(intervals: object, message: str) -> None:
    with pytest.raises(GeometryError, match=message):
        pw.Slits(intervals)


def test_points_of_slits_have_one_component() -> None:
    for bad in (0.5, [0.1, 0.2], np.zeros((3, 2))):
        with pytest.raises(ArgumentError, match=r"expected nu of shape \(\.\.\., 1\)"):
            pw.fourier(PAIR, bad)


@pytest.mark.llvm
def test_a_grating_of_many_slits_is_summed_in_parts() -> None:
    """More pairs than one kernel takes: compiled kernels and NumPy sum all of them."""
    grating = pw.Slits(np.arange(50)[:, None] + np.array([0.0, 0.3]))
    rng = np.random.default_rng(6)
    x, nu = rng.uniform(0, 50, (200, 1)), rng.uniform(-3, 3, (200, 1))
    for transform, arguments in ((pw.wigner, (x, nu)), (pw.ambiguity, (nu, x - 25))):
        compiled = transform(grating, *arguments, engine="llvm")
        assert np.abs(compiled).max() > 1
        difference = np.abs(compiled - transform(grating, *arguments, engine="numpy")).max()
        assert difference < 10 * ROUNDING * grating.length


@st.composite
def _any_slits(draw: st.DrawFn) -> pw.Slits:
    """Slits of any width and distance, also narrow ones, here and far away."""
    gaps = draw(st.lists(st.floats(0.05, 1), min_size=2, max_size=8))
    ends = np.cumsum(gaps[: len(gaps) // 2 * 2]).reshape(-1, 2)
    ends[:, 1] = ends[:, 0] + np.diff(ends, axis=1)[:, 0] * 10.0 ** -draw(st.integers(0, 6))
    return pw.Slits(ends + draw(st.sampled_from([0.0, -0.5, 1000.0])))


@pytest.mark.slow
@given(source=_any_slits())
@settings(max_examples=25, deadline=None)
def test_any_slits_obey_all_identities(source: pw.Slits) -> None:
    assert_wigner_identities(source, points=40, engine="numpy")
    assert_fourier_stable(source, points=38, engine="numpy")
    assert_otf_properties(source, points=40, engine="numpy")
