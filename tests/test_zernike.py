"""Zernike polynomials and aberrations: closed forms, orthogonality and fits."""

import numpy as np
import pytest
from scipy.special import jacobi

import polywigner as pw
from oracles.quadrature import triangle_nodes, triangles_of
from polywigner.errors import ArgumentError
from polywigner.transforms import aberrations

RNG = np.random.default_rng(5)
X, Y = RNG.uniform(-0.7, 0.7, (2, 40))
NOLL = [aberrations.noll(j) for j in range(1, 232)]  # up to the order 20
ROUNDING = 1e-13
SEVEN = pw.shapes.hexagonal_segments(1.32, 7e-3, rings=1, centre=True)


def test_values_are_jacobi_polynomials_times_waves_of_the_angle():
    r, angle = np.hypot(X, Y), np.arctan2(Y, X)
    for (n, m), value in zip(NOLL, aberrations.zernike_values(NOLL, X, Y), strict=True):
        degree = (n - abs(m)) // 2
        radial = (-1) ** degree * r ** abs(m) * jacobi(degree, abs(m), 0)(1 - 2 * r**2)
        wave = np.cos(m * angle) if m >= 0 else np.sin(-m * angle)
        assert value == pytest.approx(radial * wave, abs=ROUNDING)


def test_derivatives_are_the_limits_of_differences():
    step = 1e-3  # step of an eighth-order formula
    weights = ((1, 4 / 5), (2, -1 / 5), (3, 4 / 105), (4, -1 / 280))
    orders = NOLL[:66]
    exact = aberrations.zernike_gradients(orders, X, Y)
    for axis, (u, v) in enumerate([(step, 0.0), (0.0, step)]):
        difference = sum(
            w * (aberrations.zernike_values(orders, X + k * u, Y + k * v)
                 - aberrations.zernike_values(orders, X - k * u, Y - k * v))
            for k, w in weights
        )  # fmt: skip
        assert difference / step == pytest.approx(exact[:, axis], abs=1e-10)


def test_indices_are_those_of_the_tables():
    """The tables are Noll 1976, table I; ANSI Z80.28; and Wyant and Creath 1992, table III."""
    names = {
        "noll": {4: (2, 0), 5: (2, -2), 6: (2, 2), 7: (3, -1), 8: (3, 1), 11: (4, 0)},
        "osa": {3: (2, -2), 4: (2, 0), 5: (2, 2), 7: (3, -1), 8: (3, 1), 12: (4, 0)},
        "fringe": {4: (2, 0), 5: (2, 2), 6: (2, -2), 7: (3, 1), 9: (4, 0), 16: (6, 0)},
    }
    for indexing, known in names.items():
        order = aberrations.INDEXINGS[indexing][0]
        assert {j: order(j) for j in known} == known


def test_polynomials_of_noll_and_osa_have_unit_rms_on_the_disc():
    r, of_r = np.polynomial.legendre.leggauss(20)
    angle = np.arange(64) * (2 * np.pi / 64)
    radius = (r + 1) / 2
    x, y = radius[:, None] * np.cos(angle), radius[:, None] * np.sin(angle)
    weights = np.repeat(of_r * radius / 64, 64)
    for indexing, first in (("noll", 1), ("osa", 0)):
        terms = range(first, first + 45)
        modes = pw.zernike(dict.fromkeys(terms, 1.0), 1.0, indexing).modes(x.ravel(), y.ravel())
        assert (modes * weights) @ modes.T == pytest.approx(np.eye(45), abs=ROUNDING)


def test_fringe_polynomials_are_one_at_the_rim():
    for index in (1, 4, 9, 16, 25):
        assert pw.zernike({index: 2.0}, 3.0, "fringe")(3.0, 0.0) == pytest.approx(2.0)


@pytest.mark.parametrize("pupil", [SEVEN, pw.shapes.ring(2.0, 0.6, 40)], ids=["segments", "ring"])
def test_polynomials_on_a_pupil_are_orthonormal(pupil):
    """The test uses an independent quadrature that is exact for the products."""
    modes = pw.zernike(dict.fromkeys(range(1, 37), 1.0), 2.0, orthogonal_on=pupil)
    nodes, weights = triangle_nodes(triangles_of(pupil.polygons), 16)
    table = modes.modes(*nodes.T)
    gram = (table * weights) @ table.T / pupil.area
    assert gram == pytest.approx(np.eye(36), abs=ROUNDING)


def test_the_polynomials_on_an_annulus_are_mahajans():
    """V. N. Mahajan, J. Opt. Soc. Am. 71, 75 (1981): defocus (2 r^2 - 1 - e^2)/(1 - e^2) sqrt 3."""
    annulus = pw.shapes.ring(1.0, 0.5, 2048)
    defocus = pw.zernike({4: 1.0}, 1.0, orthogonal_on=annulus)
    r = np.array([0.5, 0.7, 1.0])
    expected = np.sqrt(3) * (2 * r**2 - 1 - 0.25) / (1 - 0.25)
    assert defocus(r, 0 * r) == pytest.approx(expected, abs=1e-5)


def test_a_fit_returns_the_coefficients_of_its_samples():
    x, y = RNG.uniform(-1e-2, 1e-2, (2, 300))
    known = {j: float(v) for j, v in enumerate(RNG.normal(size=15) * 1e-8, 1)}
    for pupil in (None, pw.shapes.regular_polygon(6, 1e-2)):
        wave = pw.zernike(known, 1e-2, orthogonal_on=pupil)
        fit = pw.fit_zernike(x, y, wave(x, y), 1e-2, 15, orthogonal_on=pupil)
        assert fit.coefficients == pytest.approx(known, abs=1e-20)
        assert fit.residual < 1e-21
        assert fit.aberration(1e-3, 2e-3) == pytest.approx(float(wave(1e-3, 2e-3)))


def test_aberrations_add_and_scale_and_have_slopes():
    power = pw.Aberration([[0.0, 1e-6], [2e-6, 0.0], [3e-6, 0.0]], radius=0.1)
    wave = pw.Aberration(lambda x, y: 1e-6 * np.sin(20 * x) * np.cos(10 * y), radius=0.1)
    total = 2.0 * power + wave * -0.5 + pw.zernike({8: 1e-7}, 0.1)
    x, y = RNG.uniform(-0.05, 0.05, (2, 9))
    expected = 2 * (1e-6 * y / 0.1 + 2e-6 * x / 0.1 + 3e-6 * (x / 0.1) ** 2)
    expected = expected - 0.5e-6 * np.sin(20 * x) * np.cos(10 * y)
    expected = expected + 1e-7 * np.sqrt(8) * (x / 0.1) * (3 * (x**2 + y**2) / 0.01 - 2)
    assert total(x, y) == pytest.approx(expected, abs=1e-20)
    step = 1e-6
    slope = (total(x + step, y) - total(x - step, y)) / (2 * step)
    assert total.slopes(x, y)[:, 0] == pytest.approx(slope, abs=1e-12)


@pytest.mark.parametrize(
    "call",
    [
        lambda: pw.zernike({0: 1e-9}, 1.0),
        lambda: pw.zernike({4: float("nan")}, 1.0),
        lambda: pw.zernike({}, 1.0),
        lambda: pw.zernike({4: 1e-9}, 0.0),
        lambda: pw.zernike({4: 1e-9}, 1.0, "zemax"),
        lambda: pw.fit_zernike([0.0, 1.0], [0.0, 1.0], [1.0, 1.0], 1.0, 5),
        lambda: pw.fit_zernike([0.0, 1.0], [0.0], [1.0, 1.0], 1.0, 1),
        lambda: pw.Aberration([1.0, 2.0]),
        lambda: pw.zernike({4: 1e-9}, 1.0).with_coefficients([1.0, 2.0]),
        lambda: pw.otf(pw.shapes.square(1e-3), (0.0, 0.0), aberration=pw.zernike({4: 0.0}, 1.0)),
        lambda: pw.strehl(pw.shapes.square(1e-3), 1e-6, aberration=1e-9),
    ],
)
def test_wrong_aberrations_are_refused(call):
    with pytest.raises(ArgumentError):
        call()
