"""The parts of the kernels, each against high precision or exact arithmetic."""

from __future__ import annotations

import math
from fractions import Fraction

import mpmath
import numpy as np
import pytest
import shapely
from hypothesis import given
from hypothesis import strategies as st

from polywigner.execution import NumpyOperations, ScalarOperations
from polywigner.kernels.functions.edge_terms import segment_wave
from polywigner.kernels.outline.frame import frame_of
from polywigner.numerics.complex_pairs import Pair
from polywigner.numerics.divided_differences import simplex_complex_wave, simplex_plane_wave
from polywigner.numerics.exact import (
    RoundingGrid,
    exact_cross,
    signed_convex_pieces,
)
from polywigner.numerics.phases import cos_sin_turns, sin_turns, turns_to_centre

DOUBLE, SINGLE, SCALAR = NumpyOperations(True), NumpyOperations(False), ScalarOperations()
# The measured bounds of the docstrings, in absolute terms: all values are at most one.
SINE_ERROR = {True: 6e-16, False: 2.4e-7}
WAVE_ERROR = {True: 2e-15, False: 6e-7}

# What is below 1e-30 turns might as well be zero; its square must not underflow.
turns = (st.floats(-1e3, 1e3) | st.floats(-1, 1) | st.floats(-1e-6, 1e-6)).map(
    lambda t: t if abs(t) > 1e-30 else 0.0
)


def _exact_wave(*corners: complex) -> complex:
    """exp[0, -2 pi i u, ...] by the recursion of divided differences, with many digits."""
    with mpmath.workdps(120):
        # Nodes moved apart by 1e-25, far below rounding: no two coincide, and the quotients
        # still have 45 digits.
        nodes = [
            -2j * mpmath.pi * mpmath.mpmathify(z) + mpmath.mpf(10) ** -25 * k
            for k, z in enumerate((0, *corners))
        ]
        values = [mpmath.exp(node) for node in nodes]
        for order in range(1, len(nodes)):
            pairs = zip(values, values[1:], nodes, nodes[order:], strict=False)
            values = [(b - a) / (z - y) for a, b, y, z in pairs]
        return complex(values[0])


@pytest.mark.parametrize("ops", [DOUBLE, SINGLE], ids=["double", "single"])
def test_sine_and_cosine_of_turns_have_the_stated_error(ops: NumpyOperations) -> None:
    r = np.linspace(-1000, 1000, 200_001).astype(ops.dtype)
    exact = 2 * np.pi * (r.astype(float) - np.rint(r.astype(float)))
    assert np.abs(sin_turns(ops, r) - np.sin(exact)).max() < SINE_ERROR[ops.double]
    cosine, sine = cos_sin_turns(ops, r)
    assert np.abs(cosine - np.cos(exact)).max() < SINE_ERROR[ops.double]
    assert np.abs(sine - np.sin(exact)).max() < SINE_ERROR[ops.double]


@given(u=turns, v=turns)
def test_wave_over_a_triangle_is_the_second_divided_difference(u: float, v: float) -> None:
    exact = _exact_wave(u, v)
    cosine, sine = simplex_plane_wave(SCALAR, u, v)
    assert complex(cosine, -sine) == pytest.approx(exact, abs=WAVE_ERROR[True])
    u32, v32 = np.float32(u), np.float32(v)
    cosine, sine = simplex_plane_wave(SINGLE, np.array([u32]), np.array([v32]))
    exact = _exact_wave(float(u32), float(v32))
    assert complex(cosine[0], -sine[0]) == pytest.approx(exact, abs=WAVE_ERROR[False])


complex_turns = st.complex_numbers(max_magnitude=5) | st.complex_numbers(max_magnitude=1e-3)


@given(u=complex_turns, v=complex_turns)
def test_wave_over_a_triangle_continues_to_complex_frequencies(u: complex, v: complex) -> None:
    got = simplex_complex_wave(SCALAR, Pair(u.real, u.imag), Pair(v.real, v.imag))
    largest = max(1.0, *(math.exp(2 * math.pi * z.imag) for z in (u, v)))
    expected = _exact_wave(u, v)
    assert complex(got.real, got.imag) == pytest.approx(expected, abs=1e-14 * largest)


@given(u=turns, v=turns, w=turns)
def test_wave_over_a_tetrahedron_is_the_third_divided_difference(
    u: float, v: float, w: float
) -> None:
    exact = _exact_wave(u, v, w)
    cosine, sine = simplex_plane_wave(SCALAR, u, v, w)
    assert complex(cosine, -sine) == pytest.approx(exact, abs=WAVE_ERROR[True])
    got = simplex_complex_wave(SCALAR, *(Pair(p, -1e-3 * abs(p)) for p in (u, v, w)))
    exact = _exact_wave(*(complex(p, -1e-3 * abs(p)) for p in (u, v, w)))
    assert complex(got.real, got.imag) == pytest.approx(exact, abs=1e-14)


@given(length=turns, middle=turns)
def test_wave_over_a_segment_keeps_its_digits_near_zero(length: float, middle: float) -> None:
    sine, cosine_less_one = segment_wave(SCALAR, 0.5 * length, middle)
    with mpmath.workdps(40):
        sinc = mpmath.sincpi(length)
        exact_sine = sinc * mpmath.sinpi(2 * mpmath.mpf(middle))
        with mpmath.workdps(100):  # the cosine of 1e-30 is 1 - 5e-60
            exact_cosine = mpmath.sincpi(length) * mpmath.cospi(2 * mpmath.mpf(middle)) - 1
    # relative to the size of the quantities themselves, not to one
    assert abs(sine - float(exact_sine)) <= 1e-15 * min(1, 7 * abs(middle))
    size = min(1.0, 20 * middle**2 + 2 * length**2)
    assert abs(cosine_less_one - float(exact_cosine)) <= 3e-15 * size


@given(st.lists(st.floats(-1, 1, allow_subnormal=False), min_size=4, max_size=4))
def test_the_cross_product_of_every_engine_is_good_to_an_ulp(values: list[float]) -> None:
    values = [v if abs(v) > 1e-100 else 0.0 for v in values]  # products must not underflow
    ax, ay, bx, by = values
    exact = Fraction(ax) * Fraction(by) - Fraction(ay) * Fraction(bx)
    for got in (
        SCALAR.cross(ax, ay, bx, by),
        float(DOUBLE.cross(*(np.array([v]) for v in values))[0]),
    ):
        assert abs(Fraction(got) - exact) <= 2 * Fraction(math.ulp(float(exact)))
    assert exact_cross(ax, ay, bx, by) == float(exact)


def test_nearly_parallel_vectors_have_an_accurate_cross_product() -> None:
    step = 2.0**-52
    rng = np.random.default_rng(1)
    naive = []
    for ax, ay, stretch in rng.uniform(0.1, 0.5, (100, 3)):
        a = (round(ax / step) * step, round(ay / step) * step)
        b = (round(stretch * ax / step) * step, round(stretch * ay / step) * step)
        exact = exact_cross(*a, *b)
        assert abs(SCALAR.cross(*a, *b) - exact) <= 1e-15 * abs(exact)
        naive.append(abs(a[0] * b[1] - a[1] * b[0] - exact) / abs(exact))
    assert max(naive) > 0.01  # what the compensation is for


def test_pieces_bent_by_the_grid_keep_their_area_and_their_shared_sides() -> None:
    step = RoundingGrid.for_precision(True).step
    bent = np.array([[0, 0], [0.25, -step], [0.5, 0], [0.5, 0.25], [0.25, 0.25 - step], [0, 0.25]])
    pieces = signed_convex_pieces([bent])
    area = sum(
        weight * sum(exact_cross(*p, *q) for p, q in zip(piece, np.roll(piece, -1, 0), strict=True))
        for piece, weight in pieces
    )
    assert area == sum(
        exact_cross(*p, *q) for p, q in zip(bent, np.roll(bent, -1, axis=0), strict=True)
    )
    assert len(pieces) > 1
    assert any(weight < 0 for _, weight in pieces) or all(len(p) == 3 for p, _ in pieces)


def test_a_piece_that_the_grid_folds_onto_itself_is_not_taken_for_convex() -> None:
    folded = np.array([[0, 0], [0.5, 0], [0.25, 0], [0.5, 0.5]])  # no right turn, but a reversal
    pieces = signed_convex_pieces([folded])
    assert all(len(piece) == 3 for piece, _ in pieces)
    area = sum(w * shapely.Polygon(piece).area for piece, w in pieces)
    assert area == pytest.approx(0.0625)


@pytest.mark.parametrize("ops", [DOUBLE, SINGLE], ids=["double", "single"])
def test_the_phase_of_a_far_shape_is_reduced_without_loss(ops: NumpyOperations) -> None:
    far = np.array([[1000.1, -2000.3], [1001.2, -2000.3], [1001.2, -1999.1]])
    frame = frame_of(far)
    nu = np.array([12.345678, -987.654321]).astype(ops.dtype)
    got = float(turns_to_centre(ops, frame.centre, nu[:1], nu[1:])[0])
    exact = sum(Fraction(float(n)) * Fraction(c) for n, c in zip(nu, frame.centre, strict=True))
    error = (Fraction(got) - exact) % 1
    # the rest of the centre beyond two floats is what is left in float32
    assert min(error, 1 - error) < (1e-15 if ops.double else 5e-7)
