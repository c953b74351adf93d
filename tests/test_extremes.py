"""Near the largest float: places, frequencies, waves and distances that no kernel reaches."""

from typing import Any

import mpmath
import numpy as np
import pytest

import polywigner as pw
from oracles.references import ENGINES
from polywigner.errors import GeometryError

engines = pytest.mark.parametrize("engine", ENGINES)

PATCH = pw.shapes.square(1e-3)
PLACES = np.random.default_rng(0).uniform(-5e-3, 5e-3, (12, 2))
WEIGHTS = np.exp(1j * np.arange(12.0))
SOURCES = {
    "aperture": PATCH,
    "taper": PATCH.with_illumination(pw.te_mode(1e-3, 1e-3)),
    "lattice": pw.phased_array(PATCH, pw.arrays.grid_positions(3, 4, 2e-3), WEIGHTS),
    "scattered": pw.phased_array(PATCH, PLACES, WEIGHTS),
    "different": pw.Array([PATCH, pw.shapes.square(2e-3).moved((5e-3, 0))]),
    "slits": pw.Slits([[0, 1e-3], [2e-3, 3e-3]]),
}
sources = pytest.mark.parametrize("name", SOURCES)
# What is left of a transform at 1e100 cycles, relative to the content, is less than this.
NOTHING = 1e-90
# Of exponents of some thousands, rounded once, in the mantissa.
EXPONENT = 1e-11


def _constant(source, value):
    return np.full(1 if isinstance(source, pw.Slits) else 2, value)


@engines
@sources
@pytest.mark.parametrize("far", [1e100, 1e200, 1e300, 1e308, 1.7e308])
def test_nothing_is_lit_however_far_away(name, far, engine):
    source = SOURCES[name]
    there, nu = _constant(source, far), _constant(source, 10.0)
    how: dict[str, Any] = {"engine": engine}
    assert pw.wigner(source, there, nu, **how) == 0
    assert pw.ambiguity(source, nu, there, **how) == 0
    assert pw.position_marginal(source, -there, **how) == 0
    assert pw.lag_marginal(source, there, **how) == 0
    assert pw.autocorrelation(source, there, 0 * nu, **how) == 0
    some = np.stack([there, 0 * there, np.nan * there])
    found = pw.lag_marginal(source, some, **how)
    assert found[0] == 0
    assert found[1] == pytest.approx(pw.lag_marginal(source, 0 * there, **how))
    if name in ("aperture", "taper"):
        assert np.isnan(found[2])  # what is no number stays that


@engines
@sources
@pytest.mark.parametrize("largest", [1e200, 1e300, 1e308, 1.7e308])
def test_transforms_vanish_at_the_largest_frequencies(name, largest, engine):
    source = SOURCES[name]
    nu, x = _constant(source, largest), _constant(source, 1e-4)
    content = abs(pw.lag_marginal(source, 0 * x))
    for value in (
        pw.fourier(source, nu, engine=engine),
        pw.wigner(source, x, nu, engine=engine),
        pw.ambiguity(source, nu, x, engine=engine),
    ):
        assert abs(value) <= NOTHING * content


@sources
@pytest.mark.parametrize("growth", [5e5, 1e200, 1e300])
@pytest.mark.filterwarnings("error")
def test_waves_too_large_for_floats_are_infinite_and_never_nan(name, growth):
    source = SOURCES[name]
    for nu in (1j * growth, growth * (1 + 1j), -1j * growth):
        value = pw.fourier(source, _constant(source, nu), engine="numpy")
        assert not np.isnan(value)
        assert np.isinf(value) or nu == -1j * growth  # slits from 0 onwards decay
        if name in ("lattice", "scattered"):
            assert source.repeated is not None
            factor = pw.array_factor(
                source.repeated[1], source.weights, _constant(source, nu), engine="numpy"
            )
            assert np.isinf(factor)
            assert not np.isnan(factor)


def test_growth_of_elements_and_decay_between_them_cancel_as_they_do():
    """exp(2 pi Im(nu) 3 mm) of the patch, 1e-409 of the array, and a product that is a float."""
    side, shift, growth = 6.0, -4.0, 50.0
    patch = pw.shapes.square(side)
    source = pw.phased_array(patch, [(shift, shift), (shift - 1, shift)], [1, 1j])
    nu = np.array([0.3 + 1j * growth, 0.1 + 1j * growth])
    mpmath.mp.dps = 30
    one = [
        (mpmath.exp(-2j * mpmath.pi * n * -3) - mpmath.exp(-2j * mpmath.pi * n * 3))
        / (2j * mpmath.pi * n)
        for n in map(mpmath.mpc, nu)
    ]
    factor = sum(
        w * mpmath.exp(-2j * mpmath.pi * (mpmath.mpc(nu[0]) * x + mpmath.mpc(nu[1]) * y))
        for (x, y), w in zip(source.repeated[1], (1, 1j), strict=True)
    )
    expected = complex(one[0] * one[1] * factor)
    assert 0 < abs(expected) < 1e-250
    found = pw.fourier(source, nu, engine="numpy")
    assert found == pytest.approx(expected, rel=EXPONENT, abs=0.0)


def test_infinite_transforms_have_their_signs():
    """F of a square at i (g, g) is above zero; shifted, it turns by exp(-2 pi i Re(nu).shift)."""
    growth, quarter = 3e5, 0.25 / 1e-3
    assert pw.fourier(PATCH, [1j * growth, 1j * growth]) == complex(np.inf, 0)
    for turns in range(4):
        shift = 1e-3 * np.array([turns, 0.0]) + 0.5e-3  # a corner at the origin of the phase
        nu = np.array([quarter + 1j * growth, 1j * growth])
        lattice = pw.phased_array(PATCH.moved((-0.5e-3, -0.5e-3)), [shift - 0.5e-3, shift + 9e-3])
        angle = -2 * np.pi * (quarter * (turns + 9.5) * 1e-3)
        found = pw.fourier(lattice, nu, engine="numpy")
        # the corner's factor -1/(4 pi^2 nu_x nu_y) is 1/(4 pi^2 g^2) to 1e-3
        assert np.sign(found.real) == np.sign(np.cos(angle))
        assert np.sign(found.imag) == np.sign(np.sin(angle))


@pytest.mark.parametrize("ratio", [1e13, 1e20, 1e50])
def test_elements_too_far_apart_for_one_frame_are_refused_but_have_a_transform(ratio):
    wide = pw.phased_array(PATCH, [(0, 0), (1e-3 * ratio, 0)])
    apart = pw.phased_array(PATCH, PLACES * ratio)
    zero = np.zeros(2)
    for source in (wide, apart):
        assert pw.fourier(source, zero) == pytest.approx(len(source) * PATCH.area)
        for transform in (pw.wigner, pw.ambiguity, pw.autocorrelation):
            with pytest.raises(GeometryError, match="of their size of each other"):
                transform(source, zero, zero)
    with pytest.raises(GeometryError, match="floats still tell vertices apart"):
        PATCH.moved((1e-3 * max(ratio, 1e20), 0))


def test_scattered_elements_up_to_ten_million_sizes_apart_are_taken():
    far = pw.phased_array(PATCH, PLACES * 1e5, WEIGHTS)
    zero = np.zeros(2)
    assert pw.lag_marginal(far, zero) == pytest.approx(12 * PATCH.area)
    assert pw.wigner(far, PLACES[3] * 1e5, zero) == pytest.approx(4 * PATCH.area, rel=1e-6)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("engine", ENGINES)
def test_values_too_large_for_single_precision_are_infinite_without_a_warning(engine):
    field = 1e80 * pw.cosine_taper(1e-3, 1e-3)
    source = pw.phased_array(PATCH.with_illumination(field), [[0, 0], [2e-3, 0]])
    for tapered in (source, source.elements[0]):
        assert (
            pw.wigner(tapered, (0.0, 0.0), (0.0, 0.0), precision="single", engine=engine) == np.inf
        )
