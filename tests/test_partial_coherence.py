"""Irradiance of partially coherent light against double integrals of the mutual intensity."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
import shapely

import polywigner as pw
from oracles import mutual_intensity as mutual
from oracles.quadrature import triangle_nodes
from polywigner.errors import ArgumentError
from polywigner.propagation.lag_sums import summed_over_pairs
from polywigner.source.obliquities import CONDITIONS as BY_NAME

WAVELENGTH = 1.0
# Tolerance of (PC5) in docs/coherence.md relative to the largest irradiance, and error of parabolic
# waves.
SPHERICAL, PARABOLIC = 1e-7, 2e-8
TRIANGLE = np.array([(-3.0, -2.0), (4.0, -3.0), (1.0, 5.0)])
OTHER = TRIANGLE[[0, 1, 2]] + [9.0, 0.0]
TILT = np.array([0.1, -0.05])
# Two triangles that form the square from -1 to 1.
HALVES = np.array([[(-1, -1), (1, -1), (1, 1)], [(-1, -1), (1, 1), (-1, 1)]])
PLACES = np.random.default_rng(0).uniform(-8, 8, (6, 2))


def points(z: float) -> Any:
    return np.column_stack([PLACES, np.full(len(PLACES), z)])


def sampled(name: str, count: int) -> tuple[Any, Any, Any]:
    """Return a source of triangles, nodes, and weights times the field."""
    plain = pw.Aperture(TRIANGLE)
    if name == "array":
        source = pw.Array([plain, pw.Aperture(OTHER)], [1.0, 0.7j])
        x, w = triangle_nodes(np.array([TRIANGLE, OTHER]), count)
        return source, x, w * np.where(x[:, 0] < 5, 1, 0.7j)
    x, w = triangle_nodes(TRIANGLE[None], count)
    if name == "plain":
        return plain, x, w
    waves = pw.Illumination([1.0, 0.5j], [TILT, (0.0, 0.1)])
    field = np.exp(2j * np.pi * (x @ TILT)) + 0.5j * np.exp(0.2j * np.pi * x[:, 1])
    if name == "waves":
        return plain.with_illumination(waves), x, w * field
    curved = plain.with_illumination(waves).curved(30.0, WAVELENGTH, (1.0, 0.0))
    return curved, x, w * field * np.exp(1j * np.pi * ((x - [1.0, 0.0]) ** 2).sum(axis=1) / 30)


# Pairs of a source and a coherence width.
CASES = [("plain", 1.5), ("waves", 5.0), ("curved", 5.0), ("array", 1.5)]


@pytest.mark.parametrize(("name", "width"), [*CASES, ("plain", 0.4)])
def test_fresnel_irradiance_is_the_double_integral_of_the_mutual_intensity(
    name: str, width: float
) -> None:
    source, x, w = sampled(name, 36)
    at = points(25.0)
    expected = mutual.irradiance(x, w, at, WAVELENGTH, width, mutual.parabolic)
    partly = source.partially_coherent(width)
    result, errors = pw.irradiance_with_error(partly, at, WAVELENGTH, "fresnel")
    assert np.abs(result - expected).max() < PARABOLIC * expected.max()
    assert errors.shape == result.shape and errors.max() < 1e-6 * expected.max()
    system = pw.FirstOrder.free_space(25.0)
    behind = pw.irradiance(partly, at[:, :2], WAVELENGTH, through=system)
    assert behind == pytest.approx(result, abs=PARABOLIC * expected.max())


@pytest.mark.parametrize(("name", "width"), [*CASES, ("plain", 0.7)])
def test_exact_irradiance_is_the_double_integral_of_the_mutual_intensity(
    name: str, width: float
) -> None:
    source, x, w = sampled(name, 36)
    at = points(9.0)
    expected = mutual.irradiance(x, w, at, WAVELENGTH, width, mutual.first_integral)
    result = pw.irradiance(source.partially_coherent(width), at, WAVELENGTH, "auto")
    assert np.abs(result - expected).max() < SPHERICAL * expected.max()


HOLED = shapely.Polygon(
    [(-15, -15), (15, -15), (15, 0), (0, 3), (3, 15), (-15, 12)], [[(-9, -9), (-3, -8), (-6, 0)]]
)


def test_tilts_share_samples_of_the_source_at_a_fresnel_number_of_100() -> None:
    """On the axis, at an edge and in the shadow, against boundary integrals for each tilt."""
    width, source, method = 20.0, pw.Aperture(HOLED), "kirchhoff"
    at = np.array([(0.0, 0.0), (15.0, -4.0), (-25.0, 8.0)])
    at = np.column_stack([at, np.full(3, 30.0**2 / 100)])
    step = 2 * np.pi / (30.0 / width + 6.0)
    t = step * np.arange(-int(5.7 / step), int(5.7 / step) + 1)
    expected, total = np.zeros(3), 0.0
    for x in t:
        for y in t:
            tilt = pw.Illumination([1.0], [np.array([x, y]) / (2 * np.pi * width)])
            share = np.exp(-(x * x + y * y) / 2)
            if share > 1e-8:
                lit = source.with_illumination(tilt)
                expected += share * pw.irradiance(lit, at, WAVELENGTH, method)
                total += share
    result = pw.irradiance(source.partially_coherent(width), at, WAVELENGTH, method)
    assert result == pytest.approx(expected / total, abs=SPHERICAL * expected.max() / total)


CONDITIONS = [("kirchhoff", (0.5, 0.5)), ("rayleigh-sommerfeld-2", (0.0, 1.0))]


@pytest.mark.parametrize(("method", "shares"), CONDITIONS)
def test_normal_derivatives_of_tilted_light_are_taken_tilt_by_tilt(
    method: Any, shares: Any
) -> None:
    source, x, w = sampled("plain", 28)
    at, width = points(9.0), 1.2
    expected = mutual.irradiance_of_tilts(x, [(w, np.zeros(2))], at, WAVELENGTH, width, *shares)
    result = pw.irradiance(source.partially_coherent(width), at, WAVELENGTH, method)
    assert np.abs(result - expected).max() < SPHERICAL * expected.max()


def test_sums_over_pairs_of_points_have_the_normal_derivatives_of_waves() -> None:
    source = pw.shapes.square(10.0).with_illumination(pw.Illumination([1.0, 0.4], [TILT, -TILT]))
    at = points(120.0) * [5.0, 5.0, 1.0]
    width = 1.3
    x, w = triangle_nodes(5 * HALVES, 24)
    waves = [
        (a * w * np.exp(2j * np.pi * s * (x @ TILT)), s * TILT) for s, a in ((1, 1.0), (-1, 0.4))
    ]
    expected = mutual.irradiance_of_tilts(x, waves, at, WAVELENGTH, width, 0.5, 0.5)
    partly = source.partially_coherent(width)
    result = pw.irradiance(partly, at, WAVELENGTH, "kirchhoff")
    assert result == pytest.approx(expected, abs=SPHERICAL * expected.max())
    condition = BY_NAME["kirchhoff"]
    pairs = summed_over_pairs(partly, at, WAVELENGTH, condition, 1e-6, math.inf)
    assert pairs == pytest.approx(expected, abs=1e-6 * expected.max())
    assert summed_over_pairs(partly, at, WAVELENGTH, condition, 1e-6, 0.0) is None  # no time


def test_sums_over_pairs_of_points_are_the_double_integral_of_the_mutual_intensity() -> None:
    source, x, w = sampled("curved", 28)
    at, width = points(30.0), 1.5
    expected = mutual.irradiance(x, w, at, WAVELENGTH, width, mutual.first_integral)
    condition, partly = BY_NAME["rayleigh-sommerfeld-1"], source.partially_coherent(width)
    pairs = summed_over_pairs(partly, at, WAVELENGTH, condition, 1e-6, math.inf)
    assert pairs == pytest.approx(expected, abs=1e-6 * expected.max())


def of_one_axis(side: float, x: Any, spread: float, width: float) -> Any:
    """Return the factor of one axis of a square's Fresnel irradiance, a double integral."""
    t, w = np.polynomial.legendre.leggauss(400)
    t, w = t * side / 2, w * side / 2
    waves = w * np.exp(1j * np.pi * (x[:, None] - t) ** 2 / spread)
    degree = np.exp(-((t[:, None] - t) ** 2) / (2 * width**2))
    return np.einsum("mi,ij,mj->m", waves, degree, waves.conj(), optimize=True).real / spread


@pytest.mark.parametrize("share", [2 / 3, 1 / 30])
def test_a_square_has_the_product_of_its_axes_behind_any_first_order_system(share: float) -> None:
    length, side, (z1, z2) = 0.5e-6, 1e-3, (0.5, 0.2)
    width = share * side
    partly = pw.shapes.square(side).partially_coherent(width)
    x = np.linspace(-1e-3, 1e-3, 9)
    along = np.column_stack([x, 0.3 * x + 1e-4])
    system = pw.FirstOrder(
        np.block([[np.eye(2), np.diag([z1, z2])], [np.zeros((2, 2)), np.eye(2)]])
    )
    expected = of_one_axis(side, along[:, 0], length * z1, width)
    expected = expected * of_one_axis(side, along[:, 1], length * z2, width)
    result = pw.irradiance(partly, along, length, through=system)
    assert np.abs(result - expected).max() < PARABOLIC * expected.max()
    # Rotated, and at several distances.
    c, s = np.cos(0.4), np.sin(0.4)
    turn, none = np.array([[c, -s], [s, c]]), np.zeros((2, 2))
    turned = pw.FirstOrder(np.block([[turn, none], [none, turn]])) @ system
    behind = pw.irradiance(partly, along @ turn.T, length, through=[turned])
    assert behind == pytest.approx(result, abs=PARABOLIC * expected.max())


def test_points_at_many_distances_are_those_of_each_plane() -> None:
    partly = pw.Aperture(TRIANGLE).partially_coherent(2.0)
    z = np.array([8.0, 30.0, 8.0, 55.0])
    at = np.column_stack([PLACES[:4], z])
    result = pw.irradiance(partly, at, WAVELENGTH, "fresnel")
    each = [float(pw.irradiance(partly, place, WAVELENGTH, "fresnel")) for place in at]
    assert result == pytest.approx(each, rel=1e-7)
    far_apart = at * [30.0, 30.0, 1.0]  # on separate lattices
    assert np.isfinite(pw.irradiance(partly, far_apart, WAVELENGTH, "fresnel")).all()


def test_images_of_partly_coherent_sources_are_those_of_coherent_ones() -> None:
    source = pw.Aperture(TRIANGLE)
    at = 2.0 * PLACES
    for width in (5.0, 0.01):
        result = pw.irradiance(
            source.partially_coherent(width), at, WAVELENGTH, through=pw.FirstOrder.magnifier(2.0)
        )
        expected = pw.irradiance(source, at, WAVELENGTH, through=pw.FirstOrder.magnifier(2.0))
        assert result == pytest.approx(expected, abs=1e-12)


def test_wide_coherence_is_coherent_and_narrow_coherence_a_lamp() -> None:
    source, at = pw.shapes.square(20.0), np.array([(3.0, -4.0, 60.0)])
    for method in ("auto", "kirchhoff", "fresnel"):
        coherent = pw.irradiance(source, at, WAVELENGTH, method)
        wide = pw.irradiance(source.partially_coherent(1e5), at, WAVELENGTH, method)
        assert wide == pytest.approx(coherent, rel=1e-6)
    # |u|^2 2 pi sigma^2 times the integral of |h|^2 over the source
    width = 0.02
    x, w = triangle_nodes(10 * HALVES, 40)
    lamp = 2 * np.pi * width**2 * np.abs(mutual.first_integral(x, at, WAVELENGTH)) ** 2 @ w
    result = pw.irradiance(source.partially_coherent(width), at, WAVELENGTH, "auto")
    assert result == pytest.approx(lamp, rel=2e-2)


def test_arguments_of_partly_coherent_light_are_checked_as_those_of_coherent_light() -> None:
    partly = pw.shapes.square(4.0).partially_coherent(1.0)
    with pytest.raises(ArgumentError):
        pw.irradiance(partly, (0.0, 0.0, 9.0), WAVELENGTH, "auto", engine="bogus")
    with pytest.raises(ArgumentError, match="z > 0"):
        pw.irradiance(partly, (0.0, 0.0, -9.0), WAVELENGTH, "fresnel")
    assert pw.irradiance(partly, np.zeros((0, 3)), WAVELENGTH, "fresnel").shape == (0,)
