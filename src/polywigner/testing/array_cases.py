"""An array with places that its pairs of elements see, for the assertion about arrays."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polywigner import transforms
from polywigner.errors import ArgumentError
from polywigner.illumination import Array as Elements
from polywigner.testing.cases import TOLERANCE, Precision, box_of, rim_of, thinness_of
from polywigner.testing.simplices import corners_of
from polywigner.testing.waves import waves_of

__all__ = ["ArrayCase", "array_case_of"]

Values = NDArray[Any]

_PLACES = 12  # of sums over pairs of elements, each pair a slice cut by itself
_LEAST_PLACES, _MOST_ELEMENTS = 1, 400  # fewer places than that for more elements


@dataclass(frozen=True)
class ArrayCase:
    """An array, places to look at, and how to evaluate."""

    array: Elements
    x: Values
    xi: Values
    nu: Values
    upsilon: Values
    keywords: dict[str, Any]
    tolerance: float

    @property
    def elements(self) -> tuple[Any, ...]:
        return self.array.elements_in_plane

    @property
    def weights(self) -> Values:
        return self.array.weights

    @property
    def dimension(self) -> int:
        return int(self.x.shape[-1])

    @cached_property
    def strengths(self) -> Values:
        """Bounds (n,) on the field of each element."""
        return np.abs(self.weights) * [waves_of(e).strength for e in self.elements]

    @cached_property
    def scale(self) -> float:
        """int |u|^2 if all were in phase: what rounding errors of A, and of W / 2^d, follow."""
        outlines = [element.with_illumination(None) for element in self.elements]
        return _energy(Elements(outlines, self.strengths))

    @cached_property
    def energy(self) -> float:
        return _energy(self.array)

    @cached_property
    def allowed(self) -> float:
        """Error allowed to A and, times 2^d, to W."""
        return self.tolerance * self.scale + self._moved

    @property
    def _moved(self) -> float:
        """Error in W and A from rounding of the elements' places and of phases there."""
        farthest = max(float(np.abs(corners_of(element)).max()) for element in self.elements)
        ulp = float(np.spacing(4 * farthest))
        rims = sum(s * rim_of(e) for s, e in zip(self.strengths, self.elements, strict=True))
        frequency = max(float(np.abs(self.nu).max()), float(np.abs(self.upsilon).max()))
        by_rims = 4 * ulp * float(self.strengths.max()) * rims
        return by_rims + 8 * np.pi * ulp * frequency * self.scale

    @property
    def few(self) -> int:
        """At how many places to sum over pairs of elements."""
        return max(_LEAST_PLACES, min(_PLACES, _MOST_ELEMENTS // len(self.array)))

    @property
    def otherwise(self) -> dict[str, Any]:
        """Keywords for many sources at few places, for which compiling would be slower."""
        return {**self.keywords, "engine": "numpy"}

    def evaluate(self, transform: str, *places: Values) -> Any:
        return getattr(transforms, transform)(self.array, *places, **self.keywords)


def _energy(array: Elements) -> float:
    zero = np.zeros((1, len(box_of(array.elements_in_plane[0])[0])))
    return float(transforms.ambiguity(array, zero, zero, engine="numpy")[0].real)


def array_case_of(
    array: Any,
    points: int,
    seed: int,
    precision: Precision,
    engine: str,
    tolerance: float | None,
) -> ArrayCase:
    """Places seen by pairs of elements: the mean of a point of one and a point of another."""
    if not isinstance(array, Elements):
        raise ArgumentError(
            f"expected an Array, got {type(array).__name__}; use assert_wigner_identities for one "
            "aperture or slits"
        )
    elements = array.elements_in_plane
    rng = np.random.default_rng(seed)
    one, other = rng.integers(len(elements), size=(2, points))
    ends = [_drawn_in(elements, chosen, rng) for chosen in (one, other)]
    dimension = ends[0].shape[1]
    corners = np.concatenate([corners_of(element) for element in elements])
    largest = float(np.linalg.norm(np.ptp(corners, axis=0)))
    smallest = min(element.diameter for element in elements)
    direction = rng.normal(size=(points, dimension))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    size = 10 ** rng.uniform(-2 - np.log10(largest), 1 - np.log10(smallest), points)
    carriers = [_wave_of(elements, chosen, rng) for chosen in (one, other)]
    if tolerance is None:
        thinnest = max(map(thinness_of, elements))
        tolerance = TOLERANCE[precision or "double"] * max(1.0, thinnest / 10)
    return ArrayCase(
        array,
        x=(ends[0] + ends[1]) / 2,
        xi=ends[0] - ends[1],
        nu=(carriers[0] + carriers[1]) / 2 + size[:, None] * direction,
        upsilon=carriers[0] - carriers[1] + size[:, None] * direction,
        keywords={"precision": precision, "engine": engine},
        tolerance=tolerance,
    )


def _drawn_in(elements: Any, chosen: Values, rng: np.random.Generator) -> Values:
    """A random point (n, d) in the box of each chosen element."""
    boxes = {k: box_of(elements[k]) for k in set(chosen.tolist())}
    unit = rng.random((len(chosen), len(boxes[int(chosen[0])][0])))
    return np.stack(
        [boxes[k][0] + u @ boxes[k][1] for k, u in zip(chosen.tolist(), unit, strict=True)]
    )


def _wave_of(elements: Any, chosen: Values, rng: np.random.Generator) -> Values:
    """The frequency (n, d) of one of the waves of each chosen element."""
    return np.stack([rng.choice(waves_of(elements[k]).frequencies) for k in chosen.tolist()])
