"""Partially coherent images: overlaps of polygons, limits, and sums over the source."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import shapely

import polywigner as pw
from polywigner.errors import ArgumentError, GeometryError, PolywignerError

EXACT = 1e-10
WAVELENGTH, DISTANCE = 0.5e-6, 10e-3
SCALE = WAVELENGTH * DISTANCE


def rectangle(low: Any, high: Any) -> pw.Aperture:
    (a, b), (c, d) = low, high
    return pw.Aperture([(a, b), (c, b), (c, d), (a, d)])


def segment(low: float, high: float, nu: float) -> complex:
    """Return the integral of exp(-2 pi i nu x) over an interval."""
    size = max(0.0, high - low)
    return size * np.sinc(nu * size) * np.exp(-1j * np.pi * nu * (low + high))


def drawn_lags(count: int, reach: float) -> Any:
    rng = np.random.default_rng(7)
    return rng.uniform(-reach, reach, (2, count, 2))


@pytest.mark.parametrize("defocus", [0.0, 0.8])
def test_rectangles_have_the_overlaps_of_their_sides(defocus: float) -> None:
    pupil, light = ((-2.0, -1.5), (2.5, 1.0)), ((-0.7, -0.4), (1.1, 0.9))
    first, second = drawn_lags(50, 3.0)
    radius, total = 3.0, 1.8 * 1.3
    result = pw.transmission_cross_coefficient(
        rectangle(*pupil), rectangle(*light), first, second, defocus, radius
    )
    slope = defocus / radius**2
    expected = np.ones(50, np.complex128)
    for axis in range(2):
        a, b = first[:, axis], second[:, axis]
        ends = np.stack([pupil[0][axis] - a, pupil[0][axis] - b, np.full(50, light[0][axis])])
        low = ends.max(axis=0)
        ends = np.stack([pupil[1][axis] - a, pupil[1][axis] - b, np.full(50, light[1][axis])])
        high, nu = ends.min(axis=0), -2 * slope * (a - b)
        parts = [segment(*each) for each in zip(low, high, nu, strict=True)]
        expected *= np.array(parts) * np.exp(2j * np.pi * slope * (a * a - b * b))
    assert np.abs(result - expected / total).max() < EXACT
    assert (np.abs(expected) > 0.1).sum() > 5


TRIANGLE = pw.Aperture([(-1.0, -0.8), (1.2, -0.5), (0.1, 1.3)])


def sampled(places: Any, lags: Any, defocus: float) -> Any:
    """Return the pupil function P of two segments with piston and tilt at points."""
    x = places + lags
    field = np.zeros(x.shape[:-1], np.complex128)
    for sign, weight, kappa in ((-1, 1.0, (0.0, 0.0)), (1, 0.6j, (0.3, -0.2))):
        inside = (sign * x[..., 0] > 0) & (abs(x[..., 0]) < 3) & (abs(x[..., 1]) < 2)
        field += np.where(inside, weight * np.exp(2j * np.pi * (x @ np.array(kappa))), 0)
    return field * np.exp(2j * np.pi * defocus / 9 * np.square(x).sum(axis=-1))


def segmented() -> pw.Array:
    left, right = rectangle((-3, -2), (0, 2)), rectangle((0, -2), (3, 2))
    tilted = right.with_illumination(pw.Illumination([1.0], [(0.3, -0.2)]))
    return pw.Array([left, tilted], [1.0, 0.6j])


def test_segments_with_pistons_and_tilts_are_sampled() -> None:
    rng = np.random.default_rng(3)
    u, v = rng.random((2, 400_000))
    u, v = np.where(u + v > 1, 1 - u, u), np.where(u + v > 1, 1 - v, v)
    a, b, c = TRIANGLE.rings[0]
    places = a + u[:, None] * (b - a) + v[:, None] * (c - a)
    for first, second in zip(*drawn_lags(2, 2.5), strict=True):
        result = pw.transmission_cross_coefficient(segmented(), TRIANGLE, first, second, 0.5, 3.0)
        p, q = sampled(places, first, 0.5), sampled(places, second, 0.5)
        assert abs(result - (p * q.conj()).mean()) < 6e-3


def test_exchange_of_lags_conjugates_and_equal_lags_are_shares() -> None:
    first, second = drawn_lags(20, 3.0)
    how: Any = (0.4, 3.0)
    one = pw.transmission_cross_coefficient(segmented(), TRIANGLE, first, second, *how)
    other = pw.transmission_cross_coefficient(segmented(), TRIANGLE, second, first, *how)
    assert one == pytest.approx(other.conj(), abs=EXACT)
    same = pw.transmission_cross_coefficient(segmented(), TRIANGLE, first, first, *how)
    assert np.abs(same.imag).max() < EXACT
    assert same.real.min() > -EXACT and same.real.max() < 1 + EXACT


def test_small_condensers_are_coherent_and_large_ones_incoherent() -> None:
    pupil = pw.shapes.regular_polygon(7, 1.0)
    first, second = drawn_lags(30, 0.6)
    point = pw.shapes.square(1e-7)
    coherent = pw.transmission_cross_coefficient(pupil, point, first, second, 0.3, 1.0)
    phase = 0.3 * (np.square(first).sum(1) - np.square(second).sum(1))
    assert coherent == pytest.approx(np.exp(2j * np.pi * phase), abs=1e-5)
    wide = pw.shapes.square(10.0)
    incoherent = pw.transmission_cross_coefficient(pupil, wide, first, second, 0.3, 1.0)
    shift = pw.otf(pupil, first - second, 0.3, 1.0) * pupil.area / wide.area
    # The origin of the pupil is halfway between the two shifted copies.
    assert np.abs(incoherent) == pytest.approx(np.abs(shift), abs=EXACT)


PUPIL = pw.shapes.regular_polygon(9, 3e-3)
CONDENSER = pw.shapes.regular_polygon(5, 1.4e-3)
MASK = pw.Aperture(np.array([[-2, -2], [2, -2], [2, -1], [-1, -1], [-1, 2], [-2, 2]]) * 1e-6)
PERIOD = np.array([[6.0, 0.0], [2.0, 7.0]]) * 1e-6


def abbe(mask: Any, points: Any, source: Any, defocus: float, background: float = 0.0) -> Any:
    """Return the image as a sum of coherent images over points of the source."""
    reciprocal = np.linalg.inv(PERIOD).T
    numbers = np.stack(np.meshgrid(*2 * [np.arange(-8, 9)]), axis=-1).reshape(-1, 2)
    orders = numbers @ reciprocal
    sign = -1.0 if background else 1.0
    amplitudes = sign * pw.fourier(mask, orders) / abs(np.linalg.det(PERIOD))
    amplitudes[(numbers == 0).all(axis=1)] += background
    waves = np.exp(2j * np.pi * points @ orders.T)
    total = 0.0
    for place in source:
        x = place + SCALE * orders
        passes = shapely.contains_xy(PUPIL.polygons, x[:, 0], x[:, 1])
        phase = np.exp(2j * np.pi * defocus / 9e-6 * np.square(x).sum(axis=1))
        total = total + np.abs(waves @ (amplitudes * passes * phase)) ** 2 / len(source)
    return total


def test_image_is_abbes_sum_over_the_source() -> None:
    points = np.random.default_rng(1).uniform(-5e-6, 5e-6, (20, 2))
    g = (np.arange(400) + 0.5) / 400 * 2.8e-3 - 1.4e-3
    grid = np.stack(np.meshgrid(g, g), axis=-1).reshape(-1, 2)
    inside = shapely.contains_xy(CONDENSER.polygons, grid[:, 0], grid[:, 1])
    source = grid[inside][::61]
    result = pw.partially_coherent_image(
        MASK, PERIOD, PUPIL, CONDENSER, points, WAVELENGTH, DISTANCE, 0.7, 3e-3
    )
    assert result == pytest.approx(abbe(MASK, points, source, 0.7), abs=4e-3)
    assert result.max() > 0.2


def test_image_by_a_point_of_light_is_that_of_its_orders_and_babinets() -> None:
    points = np.random.default_rng(4).uniform(-5e-6, 5e-6, (10, 2))
    place = np.array([0.21e-3, -0.13e-3])
    how: Any = (PERIOD, PUPIL, pw.shapes.square(1e-10).moved(place), points, WAVELENGTH, DISTANCE)
    result = pw.partially_coherent_image(MASK, *how, 0.7, 3e-3)
    assert result == pytest.approx(abbe(MASK, points, [place], 0.7), abs=1e-6)
    dark = pw.partially_coherent_image(MASK, *how, 0.2, 3e-3, transmission=0.0, background=1.0)
    assert dark == pytest.approx(abbe(MASK, points, [place], 0.2, background=1.0), abs=1e-6)
    nothing = pw.partially_coherent_image(MASK, *how, transmission=0.5j, background=0.5j)
    assert nothing == pytest.approx(0.25, abs=1e-12)


BAR = pw.shapes.rectangle(1e-6, 6e-6)
BOX = pw.shapes.square(1e-6)
CROSSED = [BAR, BAR.turned(np.pi / 2)]
LENS: Any = (PUPIL, CONDENSER, [(0.0, 0.0), (2e-6, 2e-6), (1e-6, 0.0)], WAVELENGTH, DISTANCE)


def test_crossed_bars_are_their_union_and_their_overlap_is_refused() -> None:
    union = CROSSED[0] | CROSSED[1]
    dark = pw.partially_coherent_image(union, (6e-6, 6e-6), *LENS, transmission=0, background=1)
    # In each period, the clear part next to the bars is a square.
    clear = pw.shapes.square(5e-6).moved((3e-6, 3e-6))
    expected = pw.partially_coherent_image(clear, (6e-6, 6e-6), *LENS)
    assert dark == pytest.approx(expected, abs=EXACT)
    for weights in (None, [1.0, -1.0]):
        with pytest.raises(GeometryError, match=r"elements of the mask overlap.*union"):
            pw.partially_coherent_image(pw.Array(CROSSED, weights), (6e-6, 6e-6), *LENS)
    touching = pw.Array([pw.shapes.square(2e-6), pw.shapes.square(2e-6).moved((2e-6, 0.0))])
    both = pw.partially_coherent_image(touching, (6e-6, 6e-6), *LENS)
    one = pw.partially_coherent_image(
        pw.shapes.rectangle(4e-6, 2e-6).moved((1e-6, 0.0)), (6e-6, 6e-6), *LENS
    )
    assert both == pytest.approx(one, abs=EXACT)


@pytest.mark.parametrize(
    ("mask", "period"),
    [
        (pw.shapes.rectangle(7e-6, 1e-6), (6e-6, 6e-6)),
        (pw.shapes.rectangle(5e-6, 1e-6), ((6e-6, 0.0), (3e-6, 0.5e-6))),
        (pw.Array([BOX, BOX.moved((6.5e-6, 0))]), (6e-6, 2e-6)),
    ],
)  # fmt: skip
def test_a_mask_that_overlaps_its_copies_is_refused(mask: Any, period: Any) -> None:
    with pytest.raises(GeometryError, match=r"overlap.*copies.*period"):
        pw.partially_coherent_image(mask, period, *LENS)


def test_a_mask_wider_than_its_period_may_leave_room_for_its_copies() -> None:
    """A bar at 30 degrees passes between its periodic copies."""
    bar = pw.shapes.rectangle(9e-6, 0.5e-6).turned(np.pi / 6)
    image = pw.partially_coherent_image(bar, (6e-6, 6e-6), *LENS)
    assert np.isfinite(image).all()


@pytest.mark.parametrize("radius", [0.05, 50.0])
def test_too_large_a_condenser_is_refused_with_both_numbers(radius: float) -> None:
    how: Any = (pw.shapes.square(3e-6), (6e-6, 6e-6), PUPIL, pw.shapes.disc(radius))
    with pytest.raises(ArgumentError, match=r"at most 1448 diffraction orders"):
        pw.partially_coherent_image(*how, [(0.0, 0.0)], WAVELENGTH, DISTANCE)


def test_clear_light_is_one_and_a_fine_grating_is_grey() -> None:
    cell = pw.shapes.square(1e-6)
    how: Any = (PUPIL, CONDENSER, [(0.0, 0.0), (3e-7, 1e-7)], WAVELENGTH, DISTANCE)
    clear = pw.partially_coherent_image(cell, (1e-6, 1e-6), *how)
    assert clear == pytest.approx(1.0, abs=1e-12)
    half = pw.shapes.rectangle(0.25e-6, 0.5e-6)  # diffraction orders beyond the pupil
    grey = pw.partially_coherent_image(half, (0.5e-6, 0.5e-6), *how)
    assert grey == pytest.approx(0.25, abs=1e-12)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"period": (1e-6, 0.0)}, "period"),
        ({"pupil": pw.Slits([(0.0, 1.0)])}, "pupil"),
        ({"points": [1.0, 2.0, 3.0]}, "points"),
        ({"distance": -1.0}, "distance"),
    ],
)
def test_what_makes_no_image_is_refused(change: dict[str, Any], words: str) -> None:
    names = ("mask", "period", "pupil", "condenser", "points", "wavelength", "distance")
    usual = (MASK, PERIOD, PUPIL, CONDENSER, [(0.0, 0.0)], WAVELENGTH, DISTANCE)
    how: dict[str, Any] = dict(zip(names, usual, strict=True))
    with pytest.raises(PolywignerError, match=words):
        pw.partially_coherent_image(**how | change)
    if "pupil" in change:
        with pytest.raises(ArgumentError, match="broadcast"):
            pw.transmission_cross_coefficient(PUPIL, CONDENSER, np.ones((2, 2)), np.ones((3, 2)))


MIRROR = pw.shapes.hexagonal_segments(1.0, 0.02, rings=1)


def test_tilts_of_all_segments_move_the_spot_and_pistons_do_not() -> None:
    length, focus = 1e-3, 20.0
    x = np.random.default_rng(5).uniform(-0.02, 0.02, (20, 2))
    slope = np.array([4e-4, -2e-4])
    centres = np.array([part.centroid.coords[0] for part in MIRROR.polygons.geoms])
    # A plane wave is equivalent to a tilt of each segment, with pistons at the centres of the
    # segments.
    tilted = pw.segmented_pupil(MIRROR, length, centres @ slope + 3e-5, slope)
    plain = pw.psf(MIRROR, x, length, focus)
    assert pw.psf(tilted, x + focus * slope, length, focus) == pytest.approx(plain, rel=1e-9)
    assert pw.psf(tilted, x, length, focus) != pytest.approx(plain, rel=1e-2)


@pytest.mark.parametrize("gap", [0.0, 0.02])
def test_segments_that_touch_take_pistons_as_those_apart(gap: float) -> None:
    mirror = pw.shapes.hexagonal_segments(1.0, gap, rings=1)
    step = pw.segmented_pupil(mirror, 1e-3, [0, 0, 0, 0.5e-3, 0, 0])
    peaks = [float(pw.psf(pupil, (0, 0), 1e-3, 20.0)) for pupil in (step, mirror)]
    assert peaks[0] / peaks[1] == pytest.approx((4 / 6) ** 2, rel=1e-9)


def test_segments_keep_their_fields_and_odd_ones_are_refused() -> None:
    tapered = pw.shapes.square(1.0).with_illumination(pw.cosine_taper(1.0))
    pair = pw.segmented_pupil([tapered, tapered.moved((2.0, 0.0))], 1e-3, [0.0, 0.5e-3])
    assert abs(pw.fourier(pair, (0.0, 0.0))) < 1e-12
    assert abs(pw.fourier(pair, (0.25, 0.0))) == pytest.approx(
        2 * abs(pw.fourier(tapered, (0.25, 0.0)))
    )
    for pupil, piston in ((MIRROR, [1.0, 2.0]), (MIRROR, "flat"), ("mirror", 0.0), ([], 0.0)):
        with pytest.raises(ArgumentError):
            pw.segmented_pupil(pupil, 1e-3, piston)
