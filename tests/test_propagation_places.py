"""Points, wavelengths and names that propagation refuses, and in which words."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from polywigner.errors import ArgumentError
from polywigner.geometry.arguments import checked_wavelength
from polywigner.propagation.places import METHODS, checked_method, checked_points


def test_points_keep_their_shape_and_become_float64() -> None:
    points = checked_points(np.ones((4, 5, 3), np.float32))
    assert points.shape == (4, 5, 3) and points.dtype == np.float64
    assert checked_points([0, 1, 2]).tolist() == [0.0, 1.0, 2.0]


@pytest.mark.parametrize(
    ("points", "says"),
    [
        ([1.0, 2.0], "(..., 3)"),
        (1.0, "(..., 3)"),
        ([[0, 0, 1], [0, 0]], "(..., 3)"),
        ([0, 0, 1j], "real numbers"),
        ("here", "real numbers"),
        ([0, 0, np.nan], "finite"),
        ([0, np.inf, 1], "finite"),
        ([0, 0, 0], "z > 0"),
        ([[0, 0, 1], [3, 4, -1]], "[3.0, 4.0, -1.0]"),
    ],
)
def test_points_behind_the_source_or_no_points_at_all_are_refused(points: Any, says: str) -> None:
    with pytest.raises(ArgumentError) as caught:
        checked_points(points)
    assert says in str(caught.value)


@pytest.mark.parametrize("value", [0, -1e-3, np.nan, np.inf, "3 mm", None, True, 1e-200, 1e200])
def test_a_wavelength_is_a_length_above_zero(value: Any) -> None:
    with pytest.raises(ArgumentError, match="wavelength"):
        checked_wavelength(value)


def test_a_wavelength_with_a_unit_is_told_where_those_belong() -> None:
    with pytest.raises(ArgumentError, match="number in metres, got the text '94 GHz'"):
        checked_wavelength("94 GHz")


def test_a_wavelength_in_metres_passes() -> None:
    assert checked_wavelength(np.float32(0.5)) == 0.5


@pytest.mark.parametrize("name", ["Kirchhoff", "rs1", None, 1])
def test_an_unknown_method_is_refused_with_the_names_of_all_known_ones(name: Any) -> None:
    with pytest.raises(ArgumentError) as caught:
        checked_method(name)
    assert all(method in str(caught.value) for method in METHODS)


def test_a_room_may_allow_more_methods() -> None:
    assert checked_method("wigner", ("wigner", *METHODS)) == "wigner"
    assert checked_method("kirchhoff") == "kirchhoff"
