"""Fields and lobes of tapers, steering and fitted fields."""

import numpy as np
import pytest

import polywigner as pw
from polywigner.errors import ArgumentError, IlluminationError

# Rounding error of sums of up to 33 waves, relative to a field of modulus 1.
ROUNDING = 1e-14

A, B = 10e-3, 6e-3  # lengths along x and y
WAVELENGTH = 3.189e-3


def points(dimension=2, count=200):
    """Return positions in the rectangle A x B, or in the interval A, including its edges."""
    inside = np.random.default_rng(5).uniform(-0.5, 0.5, (count, dimension))
    edges = np.array([[-0.5, 0.5], [0.5, 0.0], [0.5, -0.5], [0.0, 0.0]])[:, :dimension]
    return np.concatenate([inside, edges]) * [A, B][:dimension]


def far_field(aperture, field, nu):
    return pw.fourier(aperture.with_illumination(field), nu)


def sidelobe_levels(pattern):
    """Return the levels in dB of all later maxima, relative to the first sample."""
    level = 20 * np.log10(np.abs(pattern) / abs(pattern[0]))
    inner = level[1:-1]
    return inner[(inner > level[:-2]) & (inner > level[2:])]


@pytest.mark.parametrize("degrees", [0.0, -37.0, 89.0])
def test_a_steered_square_radiates_most_towards_the_direction(degrees):
    sine, cosine = np.sin(np.radians(degrees)), np.cos(np.radians(degrees))
    s = np.array([0.6 * sine, -0.8 * sine, cosine])
    square = pw.shapes.square(A)
    field = pw.steering(s, WAVELENGTH)
    x = points()
    expected = np.exp(2j * np.pi / WAVELENGTH * (x @ s[:2]))
    np.testing.assert_allclose(field(x), expected, atol=ROUNDING)
    assert field == pw.steering(tuple(s[:2]), WAVELENGTH)
    peak = s[:2] / WAVELENGTH
    around = peak + np.random.default_rng(0).normal(size=(500, 2)) / A
    strength = np.abs(far_field(square, field, around))
    assert np.abs(far_field(square, field, peak)) == pytest.approx(square.area, rel=ROUNDING)
    assert (strength < square.area).all()


@pytest.mark.parametrize("power", [1, 2, 32])
def test_a_cosine_taper_is_a_power_of_cosines(power):
    x = points()
    field = pw.cosine_taper(A, B, power)
    expected = np.prod(np.cos(np.pi * x / [A, B]), axis=-1) ** power
    np.testing.assert_allclose(field(x), expected, atol=ROUNDING)
    assert len(field) == (power + 1) ** 2


def test_a_taper_may_run_along_one_axis_only():
    x = points()
    along_x, along_y = pw.cosine_taper(A, power=2), pw.cosine_taper(None, B, power=2)
    np.testing.assert_allclose(along_x(x), np.cos(np.pi * x[:, 0] / A) ** 2, atol=ROUNDING)
    np.testing.assert_allclose(along_y(x), np.cos(np.pi * x[:, 1] / B) ** 2, atol=ROUNDING)
    assert along_x * along_y == pw.cosine_taper(A, B, power=2)


def test_slits_have_tapers_of_their_width():
    x = points(1)
    assert (pw.uniform(1)(x) == 1).all() and len(pw.uniform(1)) == 1
    steered = np.exp(-0.5j * np.pi / WAVELENGTH * x[:, 0])
    np.testing.assert_allclose(pw.steering([-0.25], WAVELENGTH)(x), steered, atol=ROUNDING)
    field = pw.cosine_taper(A, power=3, dimension=1)
    np.testing.assert_allclose(field(x), np.cos(np.pi * x[:, 0] / A) ** 3, atol=ROUNDING)
    taylor = pw.taylor_taper(A, dimension=1)
    np.testing.assert_allclose(
        taylor(x), pw.taylor_taper(A)(np.pad(x, ((0, 0), (0, 1)))), atol=ROUNDING
    )


@pytest.mark.parametrize(("m", "n"), [(1, 0), (0, 4), (2, 0), (3, 2)])
def test_a_mode_of_a_guide_is_the_product_of_its_half_periods(m, n):
    x = points()
    u, v = np.pi * (x / [A, B] + 0.5).T
    if m:
        y = pw.te_mode(A, B, m, n)
        np.testing.assert_allclose(y(x), np.sin(m * u) * np.cos(n * v), atol=ROUNDING)
    if n:
        across = pw.te_mode(A, B, m, n, component="x")
        np.testing.assert_allclose(across(x), np.cos(m * u) * np.sin(n * v), atol=ROUNDING)


# Tolerance of the first sidelobe [dB]. Stretching the zeros lowers this sidelobe by up to 0.63 dB.
TAYLOR_TOLERANCE = 0.7


@pytest.mark.parametrize(("sll", "nbar"), [(20, 3), (30, 4), (60, 13)])
def test_sidelobes_of_a_taylor_taper_are_as_low_as_asked_for(sll, nbar):
    slit = pw.Slits([-A / 2, A / 2])
    nu = np.linspace(0, 39.9987 / A, 8001)[:, None]  # not at zeros, whose level is minus infinity
    pattern = far_field(slit, pw.taylor_taper(A, sll=sll, nbar=nbar, dimension=1), nu)
    levels = sidelobe_levels(pattern)
    assert -sll - TAYLOR_TOLERANCE < levels[0] <= -sll
    assert (np.diff(levels) < 0).all()
    # Beyond n-bar, sidelobes decrease like those of a uniform line source, as 1/|nu|.
    far = levels[-10:] - 20 * np.log10(1 / np.linspace(30.5, 39.5, 10))
    assert np.ptp(far) < 0.5


def grid(nx=25, ny=17, centre=(0, 0)):
    """Return points up to the edges of A x B."""
    x, y = np.linspace(-A / 2, A / 2, nx), np.linspace(-B / 2, B / 2, ny)
    return np.stack(np.meshgrid(x, y, indexing="ij"), -1).reshape(-1, 2) + centre


def test_a_fit_finds_the_waves_that_made_the_samples():
    true = pw.taylor_taper(A, B, sll=25, nbar=3) * pw.steering((0.2, 0.1), WAVELENGTH)
    fit = pw.fit_illumination(grid(), true(grid()), true.frequencies)
    assert fit.rank == len(true)
    assert fit.residual < ROUNDING
    np.testing.assert_allclose(fit.illumination.amplitudes, true.amplitudes, atol=ROUNDING)


def test_samples_on_a_line_and_of_slits_are_fitted():
    x = np.linspace(-A / 2, A / 2, 40)
    values = np.cos(np.pi * x / A)
    slits = pw.fit_illumination(x, values)
    line = pw.fit_illumination(np.stack([x, 0 * x], -1), values)
    assert slits.illumination.dimension == 1
    assert line.illumination.dimension == 2
    assert slits.residual == pytest.approx(line.residual, abs=1e-9)
    assert max(slits.residual, line.residual) < 1e-6


def test_a_fit_never_has_more_waves_than_samples():
    at = grid(3, 3)
    fit = pw.fit_illumination(at, np.arange(9) + 1.0, order=8)
    assert len(fit.illumination) <= 9
    one = pw.fit_illumination([[1e-3, 2e-3]], [3j])
    assert one.illumination == 3j * pw.uniform()
    assert one.residual == 0


def test_a_fit_of_higher_order_has_a_smaller_residual():
    at = grid()
    steep = pw.steering((0.9, 0.0), WAVELENGTH)(at)
    assert pw.fit_illumination(at, steep, order=1).residual > 0.5
    result = pw.fit_illumination(at, steep, order=8)
    assert result.residual < 0.01
    with pytest.raises(ArgumentError, match=r"got FittedIllumination; pass its \.illumination"):
        pw.shapes.square(1).with_illumination(result)


def test_fields_are_subtracted_and_divided_as_numbers_are():
    one, other = pw.uniform(), pw.cosine_taper(2e-3)
    x = np.array([(0.1e-3, 0.2e-3), (0.7e-3, -0.3e-3)])
    assert (one - other)(x) == pytest.approx(one(x) - other(x))
    assert (-other)(x) == pytest.approx(-other(x))
    assert (other / 2j)(x) == pytest.approx(other(x) / 2j)
    steered, shift = pw.steering((0.3, -0.2), WAVELENGTH), (0.3e-3, 0.5e-3)
    assert steered.moved(shift)(x + shift) == pytest.approx(steered(x))
    assert (other / np.float64(4)) == 0.25 * other
    with pytest.raises(IlluminationError, match="divided by zero"):
        other / 0
    with pytest.raises(IlluminationError, match="expected a nonzero field"):
        one - one
    with pytest.raises(TypeError):
        one / other
    with pytest.raises(TypeError):
        one - 1


ANGLE = 0.7
# Error due to the rounding of vertices and frequencies, for W and for fields of a few waves.
TURNED = 1e-13


def _by(angle, at):
    c, s = np.cos(angle), np.sin(angle)
    return at @ np.array([[c, s], [-s, c]])


def test_an_aperture_turns_with_its_field():
    ell = pw.Aperture([[0, 0], [A, 0], [A, B / 3], [A / 3, B / 3], [A / 3, B], [0, B]])
    source = ell.with_illumination(pw.taylor_taper(2 * A, 2 * B, nbar=2))
    turned = source.turned(ANGLE)
    x = points() / 2 + source.centre
    nu = np.random.default_rng(1).uniform(-3 / B, 3 / B, x.shape)
    result = pw.wigner(turned, _by(ANGLE, x), _by(ANGLE, nu))
    assert np.abs(result - pw.wigner(source, x, nu)).max() < TURNED * ell.area
    assert turned.area == pytest.approx(ell.area, rel=1e-15)


def test_quarter_turns_are_exact():
    source = pw.shapes.rectangle(A, B).with_illumination(pw.cosine_taper(A, B))
    quarter = source.turned(np.pi / 2)
    assert quarter.bounds == (-B / 2, -A / 2, B / 2, A / 2)
    assert quarter.illumination == pw.cosine_taper(B, A)
    assert quarter.turned(np.pi / 2).turned(-np.pi) == source == source.turned(0.0)


def test_turns_that_cannot_be_are_refused():
    for angle in (np.nan, "30 deg", None, [1.0]):
        with pytest.raises(ArgumentError, match="angle in radians"):
            pw.shapes.square(A).turned(angle)
    with pytest.raises(IlluminationError, match="slits"):
        pw.uniform(dimension=1).turned(ANGLE)
