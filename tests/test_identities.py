"""Physics against physics: what the transforms of any aperture must obey."""

from __future__ import annotations

import itertools
import math

import mpmath
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import polywigner as pw
from oracles import disc, exact, scanline
from oracles.drawn import polygons as drawn_polygons
from oracles.positions import frequencies, lags, outline, positions
from oracles.quadrature import position_nodes, triangle_nodes
from oracles.references import aperture, awkward
from oracles.shapes import Polygons
from polywigner.geometry import triangulate

# Double precision, relative to the area: what the package promises.
DOUBLE = 1e-12

SHAPES = ["square", "triangle", "chevron", "square annulus", "double slit", "L"]
shapes = pytest.mark.parametrize("name", SHAPES)


def _numpy(transform, source, *points):  # type: ignore[no-untyped-def]
    return transform(source, *points, engine="numpy")


def _frequency_grid(largest: float, spacing: float) -> np.ndarray:
    half = math.ceil(largest / spacing)
    axis = spacing * np.arange(-half, half + 1)
    return np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)


@pytest.mark.parametrize(
    ("x", "field"), [((0.55, 0.45), 1.0), ((0.2, 0.7), 0.0)], ids=["inside", "outside"]
)
def test_wigner_integrates_over_nu_to_the_intensity(x: tuple[float, float], field: float) -> None:
    """Under a Gaussian window the sum over nu is the lag slice smoothed at xi = 0.

    The window is wide enough that its image, of width 0.15, ends inside (or outside) the slice.
    """
    source, width, period = awkward("triangle").aperture, 0.15, 6.0
    nu = _frequency_grid(3.4 / width, 1 / period)
    window = np.exp(-np.pi * width**2 * (nu**2).sum(axis=1))
    total = _numpy(pw.wigner, source, np.array(x), nu) @ window / period**2
    assert total == pytest.approx(field, abs=1e-10)


@pytest.mark.parametrize(
    ("name", "order"), [("square", 16), ("chevron", 5), ("square annulus", 4), ("double slit", 5)]
)
def test_moyal_overlap_with_a_gaussian_beam_is_the_squared_overlap_of_the_fields(
    name: str, order: int
) -> None:
    """int int W W_g = |int u g*|^2 for the Gaussian beam g, whose W_g is Gaussian."""
    source = awkward(name).aperture
    scale = source.diameter / math.sqrt(2)
    width, tilt = 0.5 * scale, np.array([0.6, 0.3]) / scale
    centre = source.centre + np.array([0.1, -0.2]) * scale
    x, weights = position_nodes(source.rings, order)
    # the sum over nu is exact if the lag slices, up to 2 D wide, do not meet their images
    nu = _frequency_grid(2.2 / width + 1 / scale, 1 / (4.5 * scale))
    in_x = 4 * weights * np.exp(-2 * np.pi * ((x - centre) ** 2).sum(axis=1) / width**2)
    bright = in_x > 1e-12 * in_x.max()
    in_nu = np.exp(-2 * np.pi * width**2 * ((nu - tilt) ** 2).sum(axis=1)) / (4.5 * scale) ** 2
    felt = in_nu > 1e-12 * in_nu.max()
    values = _numpy(pw.wigner, source, x[bright][:, None], nu[felt])
    total = in_x[bright] @ values @ in_nu[felt]
    vertices, triangles = triangulate(source)
    points, weights = triangle_nodes(vertices[triangles], 20)
    beam = (
        np.exp(
            -np.pi * ((points - centre) ** 2).sum(axis=1) / width**2 - 2j * np.pi * points @ tilt
        )
        * (2 / width**2) ** 0.5
    )
    expected = abs(weights @ beam) ** 2
    assert expected > 0.01
    assert total == pytest.approx(expected, rel=1e-9 if order == 16 else 1e-4)


def test_moyal_squared_wigner_integrates_over_nu_to_the_area_of_the_lag_slice() -> None:
    """Parseval on a grid of frequencies; its tail beyond N cycles falls like 1/N."""
    source, x = awkward("chevron").aperture, np.array([1.05, 0.62])
    expected = _numpy(pw.position_marginal, source, x)
    missing = []
    for largest in (10.0, 20.0, 40.0):
        nu = _frequency_grid(largest, 1 / 4.5)  # the slice is 4 wide
        total = (_numpy(pw.wigner, source, x, nu) ** 2).sum() / 4.5**2
        missing.append((expected - total) / expected)
    assert 0 < missing[2] < 5e-3
    ratios = [a / b for a, b in itertools.pairwise(missing)]
    assert ratios == pytest.approx([2, 2], rel=0.15)


def test_the_wigner_function_of_a_rectangle_is_a_product_of_sincs() -> None:
    rng = np.random.default_rng(3)
    a, b = 2.0, 0.7
    source = pw.Aperture([[-a / 2, -b / 2], [a / 2, -b / 2], [a / 2, b / 2], [-a / 2, b / 2]])
    x = rng.uniform(-0.6, 0.6, (400, 2)) * (a, b)
    nu = rng.normal(size=(400, 2)) * 10.0 ** rng.uniform(-9, 2, (400, 1))
    side = np.maximum(0, np.array([a, b]) - 2 * np.abs(x))
    expected = np.prod(2 * side * np.sinc(2 * nu * side), axis=1)
    assert np.abs(_numpy(pw.wigner, source, x, nu) - expected).max() < DOUBLE * a * b
    side = np.maximum(0, np.array([a, b]) - np.abs(2 * x))
    expected = np.prod(side * np.sinc(nu * side), axis=1)
    assert np.abs(_numpy(pw.ambiguity, source, nu, 2 * x) - expected).max() < DOUBLE * a * b
    expected = a * b * np.sinc(nu[:, 0] * a) * np.sinc(nu[:, 1] * b)
    assert np.abs(_numpy(pw.fourier, source, nu) - expected).max() < DOUBLE * a * b


@pytest.mark.parametrize("cycles", [0.4, 1.7])
def test_polygons_of_equal_area_approach_the_disc_at_fourth_order(cycles: float) -> None:
    """At the centre of a disc W = 4 pi R^2 2 J1(z)/z with z = 4 pi R |nu|."""
    z = 4 * math.pi * cycles
    expected = 4 * math.pi * 2 * float(mpmath.besselj(1, z)) / z
    nu = cycles * np.array([math.cos(0.4), math.sin(0.4)])
    error = [
        abs(_numpy(pw.wigner, pw.shapes.disc(1.0, n), np.zeros(2), nu) - expected)
        for n in (16, 32, 64)
    ]
    # once areas agree, the mean square radius differs from the disc's at order n^-4
    orders = [math.log2(a / b) for a, b in itertools.pairwise(error)]
    assert min(orders) > 3.9


# Fourth order where all sides take part alike, third where a slice cuts through some of them, and
# second where the area itself is not the disc's.
DISC_ORDERS = {
    "F": 4,
    "W at the centre": 4,
    "W elsewhere": 3,
    "W elsewhere, inscribed": 2,
    "A(0, xi)": 3,
    "A elsewhere": 3,
}


@pytest.mark.parametrize("quantity", disc.QUANTITIES, ids=lambda quantity: quantity.name)
def test_polygons_approach_the_disc_at_their_order(quantity: disc.Quantity) -> None:
    """Largest errors over some directions; of few of them, which side is cut where is chance."""
    error = disc.errors(quantity, (32, 64, 128, 256))
    mean_order = disc.orders(error).mean()
    assert mean_order == pytest.approx(DISC_ORDERS[quantity.name], abs=0.25)


def test_a_polygon_of_64_sides_is_a_disc_to_four_digits() -> None:
    assert (
        max(disc.errors(q, (64,))[0] for q in disc.QUANTITIES if "inscribed" not in q.name) < 5e-5
    )


@shapes
def test_transforms_are_continuous_down_to_zero_frequency(name: str) -> None:
    """Values at |nu| D = 1e-14 ... 1e-1 against exact ones: no threshold shows."""
    case = awkward(name)
    source, rng = case.aperture, np.random.default_rng(4)
    x = source.centre + np.array([0.11, 0.07]) * source.diameter
    xi = np.array([0.21, -0.13]) * source.diameter
    for size in 10.0 ** np.arange(-14, 0):
        angle = rng.uniform(0, 2 * np.pi)
        nu = size / source.diameter * np.array([math.cos(angle), math.sin(angle)])
        w, a, f = (
            _numpy(pw.wigner, source, x, nu),
            _numpy(pw.ambiguity, source, nu, xi),
            _numpy(pw.fourier, source, nu),
        )
        allowed = DOUBLE * case.area
        assert w == pytest.approx(exact.wigner(case.rings, x, nu), abs=allowed)
        assert a == pytest.approx(exact.ambiguity(case.rings, nu, xi), abs=allowed)
        assert f == pytest.approx(exact.fourier(case.rings, nu), abs=allowed)


def test_two_parts_interfere_with_twice_the_cross_term_midway() -> None:
    """Midway between two equal slits W is 2 W_slit cos(4 pi nu.d), d half their distance."""
    slit = np.array([[-0.1, -1], [0.1, -1], [0.1, 1], [-0.1, 1.0]])
    shift = np.array([0.4, 0.0])
    both = pw.Aperture([slit - shift, slit + shift])
    rng = np.random.default_rng(5)
    x, nu = rng.uniform(-0.1, 0.1, (50, 2)), rng.normal(size=(50, 2)) * 3
    alone = _numpy(pw.wigner, pw.Aperture(slit), x, nu)
    expected = 2 * alone * np.cos(4 * np.pi * nu @ shift)
    assert np.abs(_numpy(pw.wigner, both, x, nu) - expected).max() < DOUBLE * both.area


@pytest.mark.slow
@given(polygons=drawn_polygons(), seed=st.integers(0, 2**32 - 1))
@settings(
    max_examples=60,
    deadline=None,
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.filter_too_much],
)
def test_any_aperture_agrees_with_exact_clipping_at_special_positions(
    polygons: Polygons, seed: int
) -> None:
    rng, rings = np.random.default_rng(seed), exact.oriented(polygons)
    source, shape, area = aperture(polygons), outline(rings), exact.area(rings)
    x, xi, nu = positions(rng, shape, 4), lags(rng, shape, 4), frequencies(rng, shape, 4)
    wigner = [exact.wigner(rings, p, q) for p, q in zip(x, nu, strict=True)]
    assert np.abs(_numpy(pw.wigner, source, x, nu) - wigner).max() < DOUBLE * area
    ambiguity = [exact.ambiguity(rings, q, p) for p, q in zip(xi, nu, strict=True)]
    assert np.abs(_numpy(pw.ambiguity, source, nu, xi) - ambiguity).max() < DOUBLE * area
    fourier = [exact.fourier(rings, q) for q in nu]
    assert np.abs(_numpy(pw.fourier, source, nu) - fourier).max() < DOUBLE * area


@pytest.mark.slow
@given(polygons=drawn_polygons(), seed=st.integers(0, 2**32 - 1))
@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.too_slow])
def test_any_aperture_agrees_with_scanlines_at_generic_positions(
    polygons: Polygons, seed: int
) -> None:
    rng, rings = np.random.default_rng(seed), exact.oriented(polygons)
    source, area = aperture(polygons), exact.area(rings)
    points = np.concatenate(rings)
    low, high = points.min(axis=0), points.max(axis=0)
    x, xi = rng.uniform(low, high, (4, 2)), rng.uniform(low - high, high - low, (4, 2))
    nu = rng.normal(size=(4, 2)) * 10.0 ** rng.uniform(-3, 1, (4, 1))
    wigner = [scanline.wigner(rings, p, q) for p, q in zip(x, nu, strict=True)]
    assert np.abs(_numpy(pw.wigner, source, x, nu) - wigner).max() < DOUBLE * area
    ambiguity = [scanline.ambiguity(rings, q, p) for p, q in zip(xi, nu, strict=True)]
    assert np.abs(_numpy(pw.ambiguity, source, nu, xi) - ambiguity).max() < DOUBLE * area
