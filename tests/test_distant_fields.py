"""Phases of fields at 1e4 to 1e12 wavelengths against fields with 40 digits."""

from functools import cache
from typing import Any

import numpy as np
import pytest

import polywigner as pw
from oracles.distant import distant_fields
from oracles.references import numpy_and_few
from polywigner.propagation.boundary import radiator_of
from polywigner.scattering.near_fields import field_gradient

WAVELENGTH = 299792458 / 94e9
ASKED = 1e-12
"""Tolerance of the sum along edges, of what the field would be with all of the source in phase."""
DOUBLE = 2e-12
"""Of the field: that sum, of fields that are at least half as large as that. One rounding of kR at
1e4 wavelengths makes 1e-12 as well, and at 1e8 1e-8."""
ROUNDING = 3e-15
"""Of the field: roundings of the phase's 40 digits to float64, and of the result."""
SLOPES = 1e-8
"""Of k |U|: some ten times the default tolerance. One rounding of kR at 1e12 wavelengths: 1e-4."""

UNIFORM = pw.shapes.rectangle(1.1 * WAVELENGTH, 0.9 * WAVELENGTH).moved([2e-3, -3e-3])
STEERED = UNIFORM.with_illumination(pw.steering((0.3, 0.1), WAVELENGTH))
TAPERED = pw.shapes.rectangle(1.3 * WAVELENGTH, 0.7 * WAVELENGTH).with_illumination(
    pw.cosine_taper(1.3 * WAVELENGTH)
)
ARRAY = pw.phased_array(STEERED, [(-4e-3, 1e-3), (4e-3, 1e-3)], [1.0, 0.6 - 0.3j])
SOURCES: dict[str, Any] = {
    "uniform": UNIFORM, "steered": STEERED, "tapered": TAPERED, "array": ARRAY
}  # fmt: skip
BEAM = np.array([0.3, 0.1, np.sqrt(0.9)])
AXIS = np.array([0.2, 0.1, 1.0])
DISTANCES = (1.2345e4, 1.037e8, 1.0071e12)


def point_of(name, distance):
    """Return a point near the axis of the beam."""
    return (BEAM if name in ("steered", "array") else AXIS) * (distance * WAVELENGTH)


@cache
def expected(name, distance):
    return distant_fields(SOURCES[name], point_of(name, distance), WAVELENGTH)


def settings(method, **others):
    """Return arguments of `amplitude` for a method of the oracle."""
    name, _, obliquity = method.partition(" ")
    return {"method": name, **({"obliquity": obliquity} if obliquity else others)}


some_compiled = pytest.mark.parametrize(
    ("name", "engine"), numpy_and_few(SOURCES, ["array"], slow=["tapered"])
)


@some_compiled
@pytest.mark.parametrize("distance", DISTANCES)
def test_phases_are_right_at_any_distance(name, distance, engine):
    for method, value in expected(name, distance).items():
        how = settings(method, tolerance=ASKED)
        got, error = pw.amplitude_with_error(
            SOURCES[name], point_of(name, distance), WAVELENGTH, engine=engine, **how,
        )  # fmt: skip
        assert abs(got - value) <= DOUBLE * abs(value)
        assert abs(got - value) <= error + ROUNDING * abs(value)


@pytest.mark.parametrize("method", ["rayleigh-sommerfeld-1", "kirchhoff"])
def test_gradients_have_the_phase_of_the_field(method):
    """In the far field, dU/dr = (ik - 1/r) U."""
    place = point_of("steered", DISTANCES[2])
    value = expected("steered", DISTANCES[2])[method]
    result = field_gradient(radiator_of(STEERED), place[None], WAVELENGTH, method, 1e-9)[0]
    wave = 2j * np.pi / WAVELENGTH * value * place / np.linalg.norm(place)
    assert np.abs(result - wave).max() <= SLOPES * 2 * np.pi / WAVELENGTH * abs(value)
