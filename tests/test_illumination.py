"""Tapers, steering and fits: the fields that they promise, and the lobes that follow from them."""

from __future__ import annotations

import pickle
import warnings
from typing import Any

import numpy as np
import pytest
import scipy.signal.windows

import polywigner as pw
from polywigner.errors import ArgumentError, GeometryError, IlluminationError, PolywignerWarning

# Sums of up to 33 waves of amplitude below 1, each a few ulp wrong; fields are of size 1.
ROUNDING = 1e-14

A, B = 10e-3, 6e-3  # lengths along x and y
WAVELENGTH = 3.189e-3


def points(dimension: int = 2, count: int = 200) -> np.ndarray:
    """Positions in the rectangle A x B, or in the interval A, the edges among them."""
    inside = np.random.default_rng(5).uniform(-0.5, 0.5, (count, dimension))
    edges = np.array([[-0.5, 0.5], [0.5, 0.0], [0.5, -0.5], [0.0, 0.0]])[:, :dimension]
    return np.concatenate([inside, edges]) * [A, B][:dimension]


def far_field(aperture: Any, field: pw.Illumination, nu: np.ndarray) -> np.ndarray:
    return pw.fourier(aperture.with_illumination(field), nu)


def sidelobe_levels(pattern: np.ndarray) -> np.ndarray:
    """Heights in dB under the first sample, which is the main lobe's peak, of all later maxima."""
    level = 20 * np.log10(np.abs(pattern) / abs(pattern[0]))
    inner = level[1:-1]
    return inner[(inner > level[:-2]) & (inner > level[2:])]


@pytest.mark.parametrize("dimension", [1, 2])
def test_the_uniform_field_is_one(dimension: int) -> None:
    assert (pw.uniform(dimension)(points(dimension)) == 1).all()
    assert len(pw.uniform(dimension)) == 1


@pytest.mark.parametrize("degrees", [0.0, 20.0, -37.0, 89.0])
def test_a_steered_square_radiates_most_towards_the_direction(degrees: float) -> None:
    sine, cosine = np.sin(np.radians(degrees)), np.cos(np.radians(degrees))
    s = np.array([0.6 * sine, -0.8 * sine, cosine])
    square = pw.shapes.square(A)
    field = pw.steering(s, WAVELENGTH)
    x = points()
    expected = np.exp(2j * np.pi / WAVELENGTH * (x @ s[:2]))
    np.testing.assert_allclose(field(x), expected, atol=ROUNDING)
    peak = s[:2] / WAVELENGTH
    around = peak + np.random.default_rng(0).normal(size=(500, 2)) / A
    strength = np.abs(far_field(square, field, around))
    assert np.abs(far_field(square, field, peak)) == pytest.approx(square.area, rel=ROUNDING)
    assert (strength < square.area).all()


def test_a_direction_may_be_a_unit_vector_or_its_transverse_part() -> None:
    s = np.array([2.0, 3.0, 6.0]) / 7
    assert pw.steering(s, WAVELENGTH) == pw.steering(s[:2], WAVELENGTH)
    assert pw.steering(s.tolist(), WAVELENGTH) == pw.steering(tuple(s[:2]), WAVELENGTH)


def test_slits_are_steered_by_the_sine_of_an_angle() -> None:
    field = pw.steering(-0.25, WAVELENGTH)
    x = points(1)
    expected = np.exp(-0.5j * np.pi / WAVELENGTH * x[:, 0])
    np.testing.assert_allclose(field(x), expected, atol=ROUNDING)
    assert field == pw.steering([-0.25], WAVELENGTH)


@pytest.mark.parametrize(
    ("direction", "complaint"),
    [
        ((0, 0, 0), "length 0"),
        ((0, 0.1, 1), "length 1.00499"),
        ((0, 0.6, -0.8), "z > 0"),
        ((0.8, 0.7), "length of 1.06"),
        (1.2, "length of 1.2"),
        ((0, 0, 0, 1), "unit vector"),
        ((0, np.nan, 1), "finite"),
        ("north", "finite"),
    ],
)
def test_what_is_no_direction_is_refused(direction: Any, complaint: str) -> None:
    with pytest.raises(ArgumentError, match=complaint):
        pw.steering(direction, WAVELENGTH)


@pytest.mark.parametrize("power", [1, 2, 3, 7, 32])
def test_a_cosine_taper_is_a_power_of_cosines(power: int) -> None:
    x = points()
    field = pw.cosine_taper(A, B, power)
    expected = np.prod(np.cos(np.pi * x / [A, B]), axis=-1) ** power
    np.testing.assert_allclose(field(x), expected, atol=ROUNDING)
    assert len(field) == (power + 1) ** 2


def test_a_taper_may_run_along_one_axis_only() -> None:
    x = points()
    along_x, along_y = pw.cosine_taper(A, power=2), pw.cosine_taper(None, B, power=2)
    np.testing.assert_allclose(along_x(x), np.cos(np.pi * x[:, 0] / A) ** 2, atol=ROUNDING)
    np.testing.assert_allclose(along_y(x), np.cos(np.pi * x[:, 1] / B) ** 2, atol=ROUNDING)
    assert along_x * along_y == pw.cosine_taper(A, B, power=2)


def test_slits_have_tapers_of_their_width() -> None:
    x = points(1)
    field = pw.cosine_taper(A, power=3, dimension=1)
    np.testing.assert_allclose(field(x), np.cos(np.pi * x[:, 0] / A) ** 3, atol=ROUNDING)
    taylor, series = pw.taylor_taper(A, dimension=1), [0.25j, 1, -0.5]
    np.testing.assert_allclose(
        taylor(x), pw.taylor_taper(A)(np.pad(x, ((0, 0), (0, 1)))), atol=ROUNDING
    )
    turns = 2j * np.pi * x[:, 0] / A
    expected = 0.25j * np.exp(-turns) + 1 - 0.5 * np.exp(turns)
    fourier = pw.fourier_taper(A, coefficients=series, dimension=1)
    np.testing.assert_allclose(fourier(x), expected, atol=ROUNDING)


def test_a_cosine_on_a_pedestal_is_a_sum() -> None:
    x = points()
    field = 0.3 * pw.uniform() + 0.7 * pw.cosine_taper(A)
    np.testing.assert_allclose(field(x), 0.3 + 0.7 * np.cos(np.pi * x[:, 0] / A), atol=ROUNDING)


def test_a_steered_taper_is_a_product() -> None:
    x = points()
    s = np.array([0.0, 0.28, 0.96])
    field = pw.cosine_taper(A, B) * pw.steering(s, WAVELENGTH)
    expected = np.prod(np.cos(np.pi * x / [A, B]), axis=-1)
    expected = expected * np.exp(2j * np.pi / WAVELENGTH * (x @ s[:2]))
    np.testing.assert_allclose(field(x), expected, atol=ROUNDING)


@pytest.mark.parametrize(("m", "n"), [(1, 0), (0, 1), (2, 0), (1, 1), (3, 2), (0, 4), (5, 3)])
def test_a_mode_of_a_guide_is_the_product_of_its_half_periods(m: int, n: int) -> None:
    x = points()
    u, v = np.pi * (x / [A, B] + 0.5).T
    if m:
        y = pw.te_mode(A, B, m, n)
        np.testing.assert_allclose(y(x), np.sin(m * u) * np.cos(n * v), atol=ROUNDING)
    if n:
        across = pw.te_mode(A, B, m, n, component="x")
        np.testing.assert_allclose(across(x), np.cos(m * u) * np.sin(n * v), atol=ROUNDING)


def test_te10_is_the_cosine_taper_along_the_width() -> None:
    mode, taper = pw.te_mode(A, B), pw.cosine_taper(A)
    np.testing.assert_array_equal(mode.frequencies, taper.frequencies)
    np.testing.assert_array_equal(mode.amplitudes, taper.amplitudes)


@pytest.mark.parametrize(("m", "n"), [(1, 1), (2, 1), (3, 4)])
def test_the_field_of_a_mode_has_no_divergence_and_vanishes_along_the_walls(m: int, n: int) -> None:
    x = points()
    across = pw.te_mode(A, B, m, n, component="x") * (-n / B)
    up = pw.te_mode(A, B, m, n) * (m / A)

    def derivative(field: pw.Illumination, axis: int) -> np.ndarray:
        slopes = 2j * np.pi * field.frequencies[:, axis] * field.amplitudes
        return pw.Illumination(slopes, field.frequencies)(x)

    parts = derivative(across, 0), derivative(up, 1)
    scale = np.pi * m * n / (A * B)
    assert np.abs(parts[0]).max() > 0.5 * scale  # the two cancel; they do not vanish
    assert np.abs(parts[0] + parts[1]).max() < 10 * ROUNDING * scale
    walls = np.linspace(-0.5, 0.5, 21)
    left, floor = np.stack([0 * walls - A / 2, walls * B], -1), np.stack([walls * A, 0 * walls], -1)
    floor[:, 1] = -B / 2
    assert np.abs(up(left)).max() < ROUNDING * m / A
    assert np.abs(across(floor)).max() < ROUNDING * n / B


@pytest.mark.slow
@pytest.mark.parametrize(("sll", "nbar"), [(20, 3), (25, 5), (30, 4), (35, 6), (40, 7), (60, 13)])
def test_a_taylor_taper_is_the_window_of_the_same_name(sll: float, nbar: int) -> None:
    """scipy's window samples the same taper at the middles of equal intervals."""
    count = 101
    x = (np.arange(count) - (count - 1) / 2) * A / count
    expected = scipy.signal.windows.taylor(count, nbar=nbar, sll=sll)
    field = pw.taylor_taper(A, sll=sll, nbar=nbar, dimension=1)
    assert len(field) == 2 * nbar - 1
    np.testing.assert_allclose(field(x[:, None]), expected, atol=ROUNDING)
    separable = pw.taylor_taper(A, B, sll=sll, nbar=nbar)
    plane = np.stack(np.meshgrid(x, x * B / A, indexing="ij"), -1)
    np.testing.assert_allclose(separable(plane), np.outer(expected, expected), atol=ROUNDING)


# Stretching the zeros lowers the first sidelobe a little, by 0.63 dB in the worst case below.
TAYLOR_TOLERANCE = 0.7


@pytest.mark.parametrize(("sll", "nbar"), [(20, 3), (25, 5), (30, 4), (35, 6), (40, 7), (60, 13)])
def test_sidelobes_of_a_taylor_taper_are_as_low_as_asked_for(sll: float, nbar: int) -> None:
    slit = pw.Slits([-A / 2, A / 2])
    nu = np.linspace(0, 39.9987 / A, 8001)[:, None]  # off the zeros, which have no level
    pattern = far_field(slit, pw.taylor_taper(A, sll=sll, nbar=nbar, dimension=1), nu)
    levels = sidelobe_levels(pattern)
    assert -sll - TAYLOR_TOLERANCE < levels[0] <= -sll
    assert (np.diff(levels) < 0).all()
    # beyond n-bar they fall like those of a uniform line source, 1/|nu|
    far = levels[-10:] - 20 * np.log10(1 / np.linspace(30.5, 39.5, 10))
    assert np.ptp(far) < 0.5


@pytest.mark.parametrize(("sll", "nbar"), [(25, 5), (40, 7)])
def test_the_zeros_of_a_taylor_pattern_are_taylors(sll: float, nbar: int) -> None:
    slit = pw.Slits([-A / 2, A / 2])
    a = np.arccosh(10 ** (sll / 20)) / np.pi
    near = nbar * np.sqrt((a**2 + (np.arange(1, nbar) - 0.5) ** 2) / (a**2 + (nbar - 0.5) ** 2))
    zeros = np.concatenate([near, np.arange(nbar, 2 * nbar)]) / A
    field = pw.taylor_taper(A, sll=sll, nbar=nbar, dimension=1)
    at_zeros = far_field(slit, field, zeros[:, None])
    assert np.abs(at_zeros).max() < ROUNDING * A


def test_a_taylor_taper_with_no_zero_moved_is_uniform() -> None:
    assert pw.taylor_taper(A, nbar=1) == pw.uniform()


def test_a_fourier_taper_is_its_series() -> None:
    rng = np.random.default_rng(2)
    series = rng.normal(size=(5, 3)) + 1j * rng.normal(size=(5, 3))
    x = points()
    turns = x / [A, B]
    expected = sum(
        series[k + 2, j + 1] * np.exp(2j * np.pi * (k * turns[:, 0] + j * turns[:, 1]))
        for k in range(-2, 3)
        for j in range(-1, 2)
    )
    tolerance = ROUNDING * np.abs(series).sum()
    np.testing.assert_allclose(
        pw.fourier_taper(A, B, coefficients=series)(x), expected, atol=tolerance
    )
    cosine = pw.fourier_taper(A, coefficients=[0.25, 0.5, 0.25])
    np.testing.assert_allclose(cosine(x), np.cos(np.pi * turns[:, 0]) ** 2, atol=ROUNDING)


@pytest.mark.parametrize(
    ("make", "complaint"),
    [
        (lambda: pw.uniform(3), "dimension"),
        (lambda: pw.steering((0, 0, 1), 0), "wavelength"),
        (lambda: pw.cosine_taper(0), "width"),
        (lambda: pw.cosine_taper(None), "width to taper"),
        (lambda: pw.cosine_taper(A, -B), "height"),
        (lambda: pw.cosine_taper(A, power=0), "power"),
        (lambda: pw.cosine_taper(A, power=33), "power"),
        (lambda: pw.cosine_taper(A, power=1.5), "power"),
        (lambda: pw.cosine_taper(A, B, dimension=1), "no height"),
        (lambda: pw.te_mode(A, B, 0, 0), "m of at least 1"),
        (lambda: pw.te_mode(A, B, 0, 1), "ask for the other"),
        (lambda: pw.te_mode(A, B, 1, 0, component="x"), "n of at least 1"),
        (lambda: pw.te_mode(A, B, 1, 0, component="z"), "component"),
        (lambda: pw.te_mode(A, B, -1), "m as a whole number"),
        (lambda: pw.taylor_taper(A, sll=-30), "30 for sidelobes at -30 dB"),
        (lambda: pw.taylor_taper(A, sll=0), "sll"),
        (lambda: pw.taylor_taper(A, sll=float("nan")), "sll"),
        (lambda: pw.taylor_taper(A, nbar=0), "nbar"),
        (lambda: pw.taylor_taper(A, nbar=101), "nbar"),
    ],
)
def test_tapers_out_of_range_are_refused(make: Any, complaint: str) -> None:
    with pytest.raises(ArgumentError, match=complaint):
        make()


@pytest.mark.parametrize("coefficients", [[1, 2], [[1], [2], [3]], [0, 0, 0], ["a"], 1.0, [[1], 2]])
def test_series_that_are_none_are_refused(coefficients: Any) -> None:
    with pytest.raises(IlluminationError):
        pw.fourier_taper(A, coefficients=coefficients)


def grid(nx: int = 25, ny: int = 17, centre: Any = (0, 0)) -> np.ndarray:
    """Points up to the edges of A x B."""
    x, y = np.linspace(-A / 2, A / 2, nx), np.linspace(-B / 2, B / 2, ny)
    return np.stack(np.meshgrid(x, y, indexing="ij"), -1).reshape(-1, 2) + centre


def test_a_fit_finds_the_waves_that_made_the_samples() -> None:
    true = pw.taylor_taper(A, B, sll=25, nbar=3) * pw.steering((0.2, 0.1), WAVELENGTH)
    fit = pw.fit_illumination(grid(), true(grid()), true.frequencies)
    assert fit.rank == len(true)
    assert fit.residual < ROUNDING
    np.testing.assert_allclose(fit.illumination.amplitudes, true.amplitudes, atol=ROUNDING)


@pytest.mark.slow
@pytest.mark.parametrize("centre", [(0.0, 0.0), (40e-3, -70e-3)])
def test_a_smooth_field_is_fitted_up_to_the_edges(centre: tuple[float, float]) -> None:
    """A Gaussian with a quadratic phase: nothing periodic, known between the samples too."""

    def field(x: np.ndarray) -> np.ndarray:
        r = ((x - centre) ** 2).sum(-1) / A**2
        return np.exp((-3 + 1j * np.pi) * r)

    at = grid(centre=centre)
    fit = pw.fit_illumination(at, field(at), order=6)
    actual = np.linalg.norm(fit.illumination(at) - field(at)) / np.linalg.norm(field(at))
    assert fit.residual == pytest.approx(actual, rel=1e-3)
    assert fit.residual < 1e-5
    between = points() + centre
    assert np.abs(fit.illumination(between) - field(between)).max() < 1e-4
    assert fit.cancellation < 30


@pytest.mark.slow
def test_more_waves_fit_better_and_the_order_of_convergence_is_exponential() -> None:
    def field(x: np.ndarray) -> np.ndarray:
        return np.exp(2 * x[:, 0] / A) / (1 + x[:, 1] / A)

    at = grid(41, 31)
    residuals = [pw.fit_illumination(at, field(at), order=k).residual for k in range(7)]
    # at least a factor 2 for each order
    assert (np.diff(np.log2(residuals)) < -1).all(), residuals


def test_a_fit_of_noise_leaves_the_noise_that_its_waves_cannot_follow() -> None:
    rng = np.random.default_rng(9)
    at = grid(60, 50)
    noise = rng.normal(size=len(at)) + 1j * rng.normal(size=len(at))
    fit = pw.fit_illumination(at, noise, order=2)
    expected = np.sqrt(1 - fit.rank / len(at))
    assert fit.residual == pytest.approx(expected, abs=5e-3)


def test_many_samples_are_fitted_as_few_are() -> None:
    """More samples than one block of rows holds."""
    true = pw.cosine_taper(A, B, power=2)
    few, many = grid(21, 21), grid(150, 90)
    small, large = (pw.fit_illumination(at, true(at) + 0.1, order=2) for at in (few, many))
    np.testing.assert_allclose(
        small.illumination(points()), large.illumination(points()), atol=1e-9
    )
    assert large.residual < 1e-12


def test_the_residual_counts_every_sample() -> None:
    rng = np.random.default_rng(3)
    at = grid(150, 90)
    values = 1 + 0.1 * rng.normal(size=len(at))
    values[4095] += 40  # the last of the first block of rows
    fit = pw.fit_illumination(at, values, order=1)
    actual = np.linalg.norm(fit.illumination(at) - values) / np.linalg.norm(values)
    assert fit.residual == pytest.approx(actual, rel=1e-9)


def test_samples_on_a_line_and_of_slits_are_fitted() -> None:
    x = np.linspace(-A / 2, A / 2, 40)
    values = np.cos(np.pi * x / A)
    slits = pw.fit_illumination(x, values)
    line = pw.fit_illumination(np.stack([x, 0 * x], -1), values)
    assert slits.illumination.dimension == 1
    assert line.illumination.dimension == 2
    assert slits.residual == pytest.approx(line.residual, abs=1e-9)
    assert max(slits.residual, line.residual) < 1e-6


def test_a_fit_never_has_more_waves_than_samples() -> None:
    at = grid(3, 3)
    fit = pw.fit_illumination(at, np.arange(9) + 1.0, order=8)
    assert len(fit.illumination) <= 9
    one = pw.fit_illumination([[1e-3, 2e-3]], [3j])
    assert one.illumination == 3j * pw.uniform()
    assert one.residual == 0


def test_a_bad_fit_is_refused_if_asked_for() -> None:
    at = grid()
    steep = pw.steering((0.9, 0.0), WAVELENGTH)(at)
    fit = pw.fit_illumination(at, steep, order=1)
    assert fit.residual > 0.5
    with pytest.raises(IlluminationError, match="higher order"):
        pw.fit_illumination(at, steep, order=1, largest_residual=0.5)
    pw.fit_illumination(at, steep, order=8, largest_residual=0.01)


@pytest.mark.parametrize(
    ("arguments", "options", "error"),
    [
        (([[0, 0], [1, 1]], [1]), {}, ArgumentError),
        (([[0, 0, 0]], [1]), {}, ArgumentError),
        (([], []), {}, ArgumentError),
        (([[0], [1, 2]], [1, 2]), {}, ArgumentError),
        (([[0, np.inf]], [1]), {}, ArgumentError),
        (([[0, 0]], [np.nan]), {}, ArgumentError),
        (([[0, 0]], ["a"]), {}, ArgumentError),
        (([[0, 0], [1, 0]], [0, 0]), {}, IlluminationError),
        (([[0, 0]], [1], [1.0, 2.0, 3.0]), {}, IlluminationError),
        (([[0, 0]], [1], 5.0), {}, IlluminationError),
        (([[0, 0], [1, 0]], [1, 0]), {"cut_off": 1.0}, ArgumentError),
        (([[0, 0], [1, 0]], [1, 0]), {"cut_off": 0.0}, ArgumentError),
        (([[0, 0], [1, 0]], [1, 0]), {"order": -1}, ArgumentError),
        (([[0, 0], [1, 0]], [1, 0]), {"frequencies": np.zeros((0, 2))}, IlluminationError),
    ],
)
def test_samples_that_cannot_be_fitted_are_refused(
    arguments: Any, options: Any, error: type[Exception]
) -> None:
    with pytest.raises(error, match="expected"):
        pw.fit_illumination(*arguments, **options)


def test_fields_are_subtracted_and_divided_as_numbers_are() -> None:
    one, other = pw.uniform(), pw.cosine_taper(2e-3)
    x = np.array([(0.1e-3, 0.2e-3), (0.7e-3, -0.3e-3)])
    assert (one - other)(x) == pytest.approx(one(x) - other(x))
    assert (-other)(x) == pytest.approx(-other(x))
    assert (other / 2j)(x) == pytest.approx(other(x) / 2j)
    assert (other / np.float64(4)) == 0.25 * other
    with pytest.raises(IlluminationError, match="other than zero"):
        other / 0
    with pytest.raises(IlluminationError, match="other than zero"):
        one - one
    with pytest.raises(TypeError):
        one / other  # type: ignore[operator]
    with pytest.raises(TypeError):
        one - 1  # type: ignore[operator]


@pytest.mark.parametrize("amplitude", [1e-300, 1e-101, 1e101, 1e200, 1e308])
def test_amplitudes_whose_products_would_leave_the_floats_are_refused(amplitude: float) -> None:
    with pytest.raises(IlluminationError, match=r"from 1e-100 to 1e\+100"):
        pw.Illumination([amplitude], [(0, 0)])
    with pytest.raises(IlluminationError, match=r"from 1e-100 to 1e\+100"):
        amplitude * pw.uniform()
    square = pw.shapes.square(1.0)
    for within in (1e-100, 1e100):
        source = square.with_illumination(within * pw.uniform())
        assert pw.lag_marginal(source, (0, 0)).real == pytest.approx(within**2, abs=0.0)


def test_a_fit_in_place_of_its_illumination_is_refused_with_the_way_out() -> None:
    fit = pw.fit_illumination([[0.0, 0.0], [0.5, 0.5]], [1.0, 1.0], [[0.0, 0.0]])
    with pytest.raises(ArgumentError, match=r"got FittedIllumination; give its \.illumination"):
        pw.shapes.square(1).with_illumination(fit)  # type: ignore[arg-type]
    assert pw.shapes.square(1).with_illumination(fit.illumination).illumination == fit.illumination


# --- turns

ANGLE = 0.7
# Of W and of fields of a few waves: what rounding the vertices and the frequencies leaves.
TURNED = 1e-13


def _by(angle: float, at: np.ndarray) -> np.ndarray:
    c, s = np.cos(angle), np.sin(angle)
    return at @ np.array([[c, s], [-s, c]])


def test_a_field_turns_about_the_origin_and_back() -> None:
    field = pw.cosine_taper(A, B).moved((A / 3, -B)) * pw.Illumination([1j], [[70.0, -30.0]])
    turned = field.turned(ANGLE)
    assert np.abs(turned(_by(ANGLE, points())) - field(points())).max() < TURNED
    assert np.abs(turned.turned(-ANGLE)(points()) - field(points())).max() < TURNED


def test_an_aperture_turns_with_its_field() -> None:
    ell = pw.Aperture([[0, 0], [A, 0], [A, B / 3], [A / 3, B / 3], [A / 3, B], [0, B]])
    source = ell.with_illumination(pw.taylor_taper(2 * A, 2 * B, nbar=2))
    turned = source.turned(ANGLE)
    x = points() / 2 + source.centre
    nu = np.random.default_rng(1).uniform(-3 / B, 3 / B, x.shape)
    found = pw.wigner(turned, _by(ANGLE, x), _by(ANGLE, nu))
    assert np.abs(found - pw.wigner(source, x, nu)).max() < TURNED * ell.area
    assert turned.area == pytest.approx(ell.area, rel=1e-15)


def test_quarter_turns_are_exact() -> None:
    source = pw.shapes.rectangle(A, B).with_illumination(pw.cosine_taper(A, B))
    quarter = source.turned(np.pi / 2)
    assert quarter.bounds == (-B / 2, -A / 2, B / 2, A / 2)
    assert quarter.illumination == pw.cosine_taper(B, A)
    assert quarter.turned(np.pi / 2).turned(-np.pi) == source == source.turned(0.0)


def test_turns_that_cannot_be_are_refused() -> None:
    for angle in (np.nan, "30 deg", None, [1.0]):
        with pytest.raises(ArgumentError, match="angle in radians"):
            pw.shapes.square(A).turned(angle)  # type: ignore[arg-type]
    with pytest.raises(IlluminationError, match="slits"):
        pw.uniform(dimension=1).turned(ANGLE)
    sliver = pw.shapes.rectangle(1e-14, 1e-14).moved((1.0, 1.0))
    with pytest.raises(GeometryError, match="turned"):
        sliver.turned(ANGLE)


AHEAD = (0.0, 0.0, 3.0)
BY_VALUES, BY_SLOPES = 1e-5, 0.04
"""In dB: what fields that agree on the aperture to 1e-6 are apart by."""


def fits_of_one_field() -> list[pw.Aperture]:
    """On a square of one wavelength, with waves of periods of two and of three wavelengths."""
    x, y = np.meshgrid(np.linspace(-0.5, 0.5, 21), np.linspace(-0.5, 0.5, 21))
    values = np.cos(np.pi * x) * np.cos(np.pi * y) + 0.3
    places = np.stack([x.ravel(), y.ravel()], axis=-1)
    found = []
    for period, order in ((2.0, 1), (3.0, 4)):
        k = np.arange(-order, order + 1) / period
        waves = np.stack(np.meshgrid(k, k), axis=-1).reshape(-1, 2)
        fit = pw.fit_illumination(places, values.ravel(), waves, cut_off=1e-10)
        assert fit.residual < 2e-6
        found.append(pw.shapes.square(1.0).with_illumination(fit.illumination))
    return found


def test_two_fits_of_one_field_differ_where_slopes_count_and_that_is_told() -> None:
    def decibels(method: Any) -> Any:
        return [
            20
            * np.log10(np.abs(pw.amplitude(s, AHEAD, 1.0, method, tolerance=1e-6, engine="numpy")))
            for s in fits
        ]

    fits = fits_of_one_field()
    first, second = decibels("rayleigh-sommerfeld-1")
    assert abs(first - second) < BY_VALUES
    with pytest.warns(PolywignerWarning, match="do not fix"):
        first, second = decibels("rayleigh-sommerfeld-2")
    assert abs(first - second) > BY_SLOPES


def warnings_of(source: Any) -> list[str]:
    """By everything that takes an obliquity."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        for condition in ("kirchhoff", "rayleigh-sommerfeld-2"):
            pw.amplitude(source, AHEAD, 1.0, condition, engine="numpy")
            pw.amplitude(source, AHEAD, 1.0, "fraunhofer", obliquity=condition)
            pw.irradiance(source, AHEAD, 1.0, obliquity=condition, tolerance=0.1, engine="numpy")
            pw.radiation_pattern(source, 1.0, [0.0], [0.0], obliquity=condition)
    return [str(w.message) for w in caught]


def test_a_fit_with_evanescent_waves_warns_once_a_call_whatever_is_made_of_it() -> None:
    x = np.linspace(-0.5, 0.5, 9)
    places = np.stack(np.meshgrid(x, x), axis=-1).reshape(-1, 2)
    waves = [(0.0, 0.0), (1.2, 0.0), (-1.2, 0.0)]
    fit = pw.fit_illumination(places, np.cos(places[:, 0]), waves).illumination
    changed = 2 * (fit * pw.uniform() + pw.uniform()).moved([0.1, 0.0]).turned(0.5) / 3 - fit
    restored = pickle.loads(pickle.dumps(changed))
    assert restored == changed == pw.Illumination(changed.amplitudes, changed.frequencies)
    square = pw.shapes.square(1.0)
    for source in (
        square.with_illumination(restored),
        pw.phased_array(square.with_illumination(fit), [(-1.0, 0.0), (1.0, 0.0)]),
    ):
        found = warnings_of(source)
        assert len(found) == 8
        assert all("do not fix" in message for message in found)


def test_waves_that_are_given_or_travel_do_not_warn() -> None:
    square = pw.shapes.square(1.0)
    x = np.linspace(-0.5, 0.5, 9)
    places = np.stack(np.meshgrid(x, x), axis=-1).reshape(-1, 2)
    travelling = pw.fit_illumination(places, np.cos(places[:, 0]), [(0.0, 0.0), (0.6, 0.0)])
    for field in (
        travelling.illumination,
        pw.te_mode(1.0, 1.0),
        pw.te_mode(0.4, 0.4),  # below cut-off: evanescent, but given
        pw.Illumination([1.0], [(1.2, 0.0)]),
    ):
        assert not warnings_of(square.with_illumination(field))
