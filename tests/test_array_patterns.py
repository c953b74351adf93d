"""Array tolerances, virtual arrays and element patterns."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

import polywigner as pw
from polywigner.errors import ArgumentError, PolywignerError
from polywigner.figures import draw_tolerance

WAVELENGTH = 299792458 / 77e9
PATCH = pw.shapes.square(0.48 * WAVELENGTH)
PLACES = pw.arrays.grid_positions(8, 8, WAVELENGTH / 2)
WEIGHTS = pw.arrays.steering_weights(PLACES, (0.3, 0.1), WAVELENGTH)
ARRAY = pw.phased_array(PATCH, PLACES, WEIGHTS)
THETA, PHI = np.radians(np.arange(-80, 81, 4)), np.radians([0.0, 35.0, 90.0])
DARK = 1e-13  # rounding relative to the largest |E|^2


def _tolerance(source: Any = ARRAY, theta: Any = THETA, phi: Any = PHI, **how: Any) -> Any:
    return pw.array_tolerance(source, WAVELENGTH, theta, phi, **how)


def _linear(levels: Any) -> Any:
    return 10 ** (levels.values / 10)


ERRORS: list[dict[str, float]] = [
    {"phase": 0.4},
    {"amplitude": 2.0},
    {"dead": 0.15},
    {"position": 0.05 * WAVELENGTH},
    {"amplitude": 1.0, "phase": 0.2, "dead": 0.05, "position": 0.02 * WAVELENGTH},
]


@pytest.mark.parametrize("errors", ERRORS, ids=lambda e: "-".join(e))
def test_samples_of_errors_average_to_the_closed_form(errors: dict[str, float]) -> None:
    """The deviation of |E|^2 is at most its mean: 5/sqrt(n) is five deviations."""
    count = 400
    result = _tolerance(count=count, seed=7, **errors)
    ratio = _linear(result["mean"]) / _linear(result["expected"])
    assert np.abs(ratio - 1).max() < 5 / math.sqrt(count)
    assert ratio.mean() == pytest.approx(1, abs=0.03)


def test_the_mean_of_phase_errors_is_that_of_theory() -> None:
    """The mean of |E|^2 is e^(-s^2) |E_0|^2 + (1 - e^(-s^2)) sum |w_k E_k|^2."""
    errors = 0.3
    alone = pw.radiation_pattern(PATCH, WAVELENGTH, THETA, PHI)["field"].values
    whole = pw.radiation_pattern(ARRAY, WAVELENGTH, THETA, PHI)
    power = whole.attrs["radiated_power"]
    share = math.exp(-(errors**2))
    intensity = share * np.abs(whole["field"].values) ** 2
    intensity += (1 - share) * len(ARRAY) * np.abs(alone) ** 2
    result = _tolerance(phase=errors, count=2)
    expected = 4 * math.pi / power * intensity
    assert _linear(result["expected"]) == pytest.approx(expected, rel=1e-9)
    nominal = 10 ** (whole["directivity"].values / 10)
    assert _linear(result["nominal"]) == pytest.approx(nominal, rel=1e-9, abs=DARK * nominal.max())


def test_a_null_fills_with_speckle() -> None:
    """In a null, many small errors add up to a complex normal field."""
    places = pw.arrays.grid_positions(24, 24, WAVELENGTH / 2)
    array = pw.phased_array(PATCH, places)
    null = math.asin(2 / 24)
    result = _tolerance(array, null, [0.0, math.pi / 2], phase=0.6, amplitude=2.0, count=4000)
    mean = _linear(result["expected"])
    assert _linear(result["high"]) / mean == pytest.approx(math.log(20), rel=0.1)
    assert _linear(result["low"]) / mean == pytest.approx(-math.log(0.95), rel=0.2)


def test_equal_seeds_draw_equal_errors_of_any_array() -> None:
    listed = pw.Array(ARRAY.elements, ARRAY.weights)
    one, other = (_tolerance(a, count=5, seed=3, **ERRORS[4]) for a in (ARRAY, listed))
    for name in ("mean", "low", "high", "expected"):
        assert _linear(one[name]) == pytest.approx(_linear(other[name]), rel=1e-6)
    assert not np.allclose(_linear(_tolerance(count=5, seed=4, phase=0.1)["mean"]), one["mean"])


@pytest.mark.parametrize(
    ("how", "words"),
    [
        ({}, "above zero"),
        ({"phase": 20.0}, "rad"),
        ({"dead": 1.0}, "dead"),
        ({"phase": 0.1, "source": PATCH}, "Array"),
    ],
)
def test_errors_that_are_none_are_refused(how: dict[str, Any], words: str) -> None:
    with pytest.raises(ArgumentError, match=words):
        _tolerance(**how)


def test_the_band_of_a_tolerance_run_is_drawn_over_its_cuts() -> None:
    result = _tolerance(phi=[0.0, math.pi / 2], phase=0.2, count=50)
    figure = draw_tolerance(result, title="phases")
    assert len(figure.axes) == 2
    band = figure.axes[0].collections[0].get_paths()[0].vertices[:, 1]
    assert band.max() == pytest.approx(result["high"].sel(phi=0.0).values.max())
    for wrong in (3, _tolerance(theta=0.0, phase=0.2, count=2)):
        with pytest.raises(ArgumentError, match="expected"):
            draw_tolerance(wrong)


@pytest.mark.parametrize("dimension", [1, 2, 3])
def test_the_array_factor_of_a_virtual_array_is_the_product(dimension: int) -> None:
    random = np.random.default_rng(dimension)
    layouts = [random.normal(size=(n, dimension)) for n in (5, 9)]
    factors = [random.normal(size=n) + 1j * random.normal(size=n) for n in (5, 9)]
    nu = random.normal(size=(20, dimension))
    result = pw.array_factor(*pw.arrays.virtual_array(*layouts, *factors), nu)
    one, other = (pw.array_factor(p, w, nu) for p, w in zip(layouts, factors, strict=True))
    assert result == pytest.approx(one * other, abs=1e-10)


def test_a_radar_of_two_arrays_sees_the_pattern_of_their_virtual_array() -> None:
    """3 elements spaced by 4 wavelengths and 8 spaced by half a wavelength form 24 elements."""
    half = WAVELENGTH / 2
    sent = pw.arrays.grid_positions(3, 1, 8 * half)
    received = pw.arrays.grid_positions(8, 1, half)
    places, weights = pw.arrays.virtual_array(sent, received)
    np.testing.assert_allclose(places, pw.arrays.grid_positions(24, 1, half), atol=1e-12)
    assert weights == pytest.approx(np.ones(24))
    result = pw.two_way_pattern(
        pw.phased_array(PATCH, sent), pw.phased_array(PATCH, received), WAVELENGTH, THETA, PHI
    )
    alone, whole = (
        pw.radiation_pattern(source, WAVELENGTH, THETA, PHI)["field"].values
        for source in (PATCH, pw.phased_array(PATCH, places, weights))
    )
    assert result["field"].values == pytest.approx(alone * whole, abs=1e-12 * np.abs(whole).max())
    one_way = pw.radiation_pattern(pw.phased_array(PATCH, sent), WAVELENGTH, THETA, PHI)
    both = result["two_way"].values - result["receive"].values
    assert both == pytest.approx(one_way["directivity"].values, abs=1e-9)


@pytest.mark.parametrize(
    ("given", "words"),
    [
        (([0.0], [[0.0, 1.0]]), "components"),
        (([math.nan], [0.0]), "finite"),
        (([0.0], [0.0], [1, 2]), "weight"),
        ((np.arange(2000.0), np.arange(2000.0)), "elements"),
    ],
)
def test_virtual_arrays_of_other_than_two_layouts_are_refused(given: Any, words: str) -> None:
    with pytest.raises(PolywignerError, match=words):
        pw.arrays.virtual_array(*given)
