"""The assertion for arrays accepts what is right and notices what is wrong."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import polywigner as pw
from polywigner import transforms
from polywigner.errors import ArgumentError, GeometryError
from polywigner.testing import assert_array_identities

RNG = np.random.default_rng(5)
SQUARE = pw.shapes.square(1.0)
CHEVRON = pw.shapes.chevron(1.0, 0.8, 0.3)
SLIT = pw.Slits([0.0, 1.0])
PLACES = pw.arrays.grid_positions(3, 3, 1.2)


def _weights(count: int) -> Any:
    return RNG.normal(size=count) + 1j * RNG.normal(size=count)


ARRAYS = {
    "one": pw.Array([CHEVRON], [2j]),
    "dark": pw.Array([SQUARE, SQUARE], [1, -1]),
    "mixed and overlapping": pw.Array(
        [SQUARE, CHEVRON.moved((0.3, 0.2)), pw.shapes.regular_polygon(5, 0.7)], [1, 1j, -0.4]
    ),
    "lattice with a taper and a beam": pw.phased_array(
        SQUARE, PLACES, np.kron([0.5, 1, 0.5], [1, 1j, -1])
    ),
    "lattice with any weights": pw.phased_array(SQUARE, PLACES, _weights(9)),
    "lattice far away": pw.phased_array(SQUARE, PLACES + 1000.0, _weights(9)),
    "scattered": pw.phased_array(CHEVRON, RNG.uniform(-2, 2, (7, 2)), _weights(7)),
    "waves on elements": pw.phased_array(
        SQUARE.with_illumination(pw.Illumination([1, 0.5j], [(0, 0), (1.3, 0.4)])),
        PLACES[:4],
        _weights(4),
    ),
    "slits of two widths": pw.Array([SLIT, pw.Slits([0.5, 2.2])], [1, 2j]),
    "slits on a lattice": pw.phased_array(SLIT, np.arange(6) * 1.3, _weights(6)),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", ARRAYS)
def test_arrays_obey_all_identities(name: str) -> None:
    assert_array_identities(ARRAYS[name], engine="numpy", points=40)


@pytest.mark.slow
@pytest.mark.llvm
def test_arrays_obey_all_identities_when_compiled() -> None:
    for name in ("lattice with a taper and a beam", "slits on a lattice"):
        assert_array_identities(ARRAYS[name], engine="llvm", points=40)


@pytest.mark.slow
def test_arrays_obey_all_identities_in_single_precision() -> None:
    for name in ("mixed and overlapping", "lattice with any weights", "slits on a lattice"):
        assert_array_identities(ARRAYS[name], engine="numpy", precision="single", points=40)


def _without_weights(right: Any, array: Any, *places: Any, **keywords: Any) -> Any:
    return right(pw.Array(array.elements_in_plane, np.abs(array.weights)), *places, **keywords)


def _conjugate_weights(right: Any, array: Any, *places: Any, **keywords: Any) -> Any:
    return right(pw.Array(array.elements_in_plane, array.weights.conj()), *places, **keywords)


def _no_cross_terms(right: Any, array: Any, *places: Any, **keywords: Any) -> Any:
    """The elements as if they were incoherent."""
    pairs = zip(array.elements_in_plane, np.abs(array.weights) ** 2, strict=True)
    return sum(factor * right(element, *places, **keywords) for element, factor in pairs)


def _one_element_nudged(right: Any, array: Any, *places: Any, **keywords: Any) -> Any:
    first, *others = array.elements_in_plane
    nudge = np.full(1 if isinstance(first, pw.Slits) else 2, 1e-8)
    return right(pw.Array([first.moved(nudge), *others], array.weights), *places, **keywords)


def _slightly_more(right: Any, *arguments: Any, **keywords: Any) -> Any:
    return right(*arguments, **keywords) * (1 + 1e-9)


WRONG = [
    _without_weights, _conjugate_weights, _no_cross_terms, _one_element_nudged, _slightly_more
]  # fmt: skip


@pytest.mark.parametrize("transform", ["fourier", "wigner", "ambiguity", "lag_marginal"])
@pytest.mark.parametrize("wrong", WRONG)
@pytest.mark.parametrize("name", ["mixed and overlapping", "slits on a lattice"])
def test_a_wrong_transform_of_an_array_is_noticed(
    name: str, wrong: Callable[..., Any], transform: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    if transform == "fourier" and wrong is _no_cross_terms:
        pytest.skip("F has no cross terms")
    right = getattr(transforms, transform)

    def broken(source: Any, *places: Any, **keywords: Any) -> Any:
        if isinstance(source, pw.Array) and source == ARRAYS[name]:
            return wrong(right, source, *places, **keywords)
        return right(source, *places, **keywords)

    broken.__name__ = transform
    monkeypatch.setattr(transforms, transform, broken)
    with pytest.raises(AssertionError, match=r"expected .*, got .* at "):
        assert_array_identities(ARRAYS[name], engine="numpy", points=40)


def test_what_is_no_array_in_the_plane_is_refused() -> None:
    with pytest.raises(ArgumentError, match="expected an Array, got Aperture"):
        assert_array_identities(SQUARE)  # type: ignore[arg-type]
    tilted = SQUARE.placed(np.eye(4)[[1, 2, 0, 3]])
    with pytest.raises(GeometryError):
        assert_array_identities(pw.Array([SQUARE, tilted]))
