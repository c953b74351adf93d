"""Sources to check, their waves and simplices, places to look at, and laws at single places."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal

import numpy as np
import shapely
from numpy.typing import NDArray

from polywigner import transforms
from polywigner.errors import ArgumentError
from polywigner.execution import checked_precision
from polywigner.geometry import Aperture, Polyhedron, Slits
from polywigner.geometry.arguments import (
    checked_count,
    checked_generator,
    checked_number,
)
from polywigner.illumination import Array as Elements
from polywigner.illumination import Illumination

Array = NDArray[Any]


@dataclass(frozen=True)
class Waves:
    """u = sum of amplitude exp(2 pi i frequency.x)."""

    amplitudes: Array
    """(m,) complex."""
    frequencies: Array
    """(m, d)."""

    @property
    def uniform(self) -> bool:
        """Whether the field is 1."""
        return bool(np.all(self.amplitudes == 1)) and not self.frequencies.any()

    @property
    def strength(self) -> float:
        """Bound on |u|."""
        return float(np.abs(self.amplitudes).sum())

    @property
    def carrier(self) -> Array:
        """The mean frequency (d,), by power."""
        return np.asarray(np.abs(self.amplitudes) ** 2 @ self.frequencies) / float(
            (np.abs(self.amplitudes) ** 2).sum()
        )

    @property
    def spread(self) -> float:
        """Largest distance of a frequency from the carrier, in 1/m."""
        return float(np.linalg.norm(self.frequencies - self.carrier, axis=1).max())

    def pairs(self) -> Iterator[tuple[complex, Array, Array]]:
        """(c_m c_n*, mean of both frequencies, difference of both) of all ordered pairs."""
        for c, kappa in zip(self.amplitudes.tolist(), self.frequencies, strict=True):
            for d, other in zip(self.amplitudes.tolist(), self.frequencies, strict=True):
                yield c * d.conjugate(), (kappa + other) / 2, kappa - other

    def middles(self, rng: np.random.Generator, count: int) -> Array:
        """(count, d) means of two frequencies, about which W is large."""
        return self._drawn(rng, count, 0.5, 0.5)

    def distances(self, rng: np.random.Generator, count: int) -> Array:
        """(count, d) differences of two frequencies, about which A is large."""
        return self._drawn(rng, count, 1.0, -1.0)

    def _drawn(self, rng: np.random.Generator, count: int, first: float, second: float) -> Array:
        if len(self.amplitudes) == 1:  # no draws: the places of uniform sources depend on them
            return np.broadcast_to((first + second) * self.frequencies, (count, self._dimension))
        one, other = rng.integers(len(self.amplitudes), size=(2, count))
        return first * self.frequencies[one] + second * self.frequencies[other]

    @property
    def _dimension(self) -> int:
        return int(self.frequencies.shape[1])

    def mapped(self, matrix: Array, shift: Array) -> Illumination:
        """Carried along by x -> matrix x + shift."""
        kappa = self.frequencies @ np.linalg.inv(matrix)
        return Illumination(self.amplitudes * np.exp(-2j * np.pi * (kappa @ shift)), kappa)

    def conjugate(self) -> Illumination:
        return Illumination(self.amplitudes.conj(), -self.frequencies)


def waves_of(source: Aperture | Slits) -> Waves:
    """The waves on a source."""
    field = source.illumination
    if field is None:
        return Waves(np.ones(1, complex), np.zeros((1, 1 if isinstance(source, Slits) else 2)))
    return Waves(field.amplitudes, field.frequencies)


def corners_of(source: Any) -> Array:
    """Vertices (n, d) in the space of nu, as floats."""
    if isinstance(source, Slits):
        return source.intervals.reshape(-1, 1)
    if isinstance(source, Polyhedron):
        return source.vertices
    if isinstance(source, Aperture):
        return np.concatenate(source.rings)
    flat = np.concatenate(source.aperture.rings)
    return flat @ source.pose[:3, :2].T + source.pose[:3, 3]


Precision = Literal["double", "single"] | None

# Relative to the content: what the package promises. Shapely's clipping may move a corner by an
# ulp of the diameter, which is why the tolerance grows with perimeter * diameter for slivers.
TOLERANCE = {"double": 1e-12, "single": 5e-6}


@dataclass(frozen=True)
class Case:
    """A source, places to look at, and how to evaluate."""

    source: Aperture | Slits
    x: Array
    xi: Array
    nu: Array
    upsilon: Array
    keywords: dict[str, Any]
    tolerance: float
    waves: Waves

    @property
    def elements(self) -> tuple[Any, ...]:
        return (self.source,)

    @property
    def weights(self) -> Array:
        return np.ones(1)

    @property
    def dimension(self) -> int:
        return self.x.shape[-1]

    @property
    def content(self) -> float:
        return content_of(self.source)

    @cached_property
    def outline(self) -> Aperture | Slits:
        """The source without its field."""
        return self.source.with_illumination(None)

    @property
    def scale(self) -> float:
        """Bound on A and, times 2^d, on W; their rounding errors are proportional to it."""
        return self.waves.strength**2 * self.content

    @property
    def allowed(self) -> float:
        """Error allowed to A and, times 2^d, to W."""
        return self.tolerance * self.scale

    @cached_property
    def energy(self) -> float:
        """int |u|^2, by pairs of waves."""
        return float(self.intensity_spectrum(np.zeros((1, self.dimension)))[0].real)

    def intensity_spectrum(self, upsilon: Array) -> Any:
        """The Fourier transform of |u|^2 at upsilon (n, d), by pairs of waves."""
        total: Any = 0.0
        for factor, _, apart in self.waves.pairs():
            values = transforms.fourier(self.outline, upsilon - apart, **self.keywords)
            total = total + factor * values
        return total

    @property
    def rounding(self) -> float:
        """Change of the content if coordinates are rounded once more."""
        largest = float(np.abs(self.source.bounds).max())
        return rim_of(self.source) * float(np.spacing(largest))

    @property
    def turned(self) -> float:
        """Error in W and A from rounding of the waves' phases, here and in the values compared."""
        farthest = float(np.abs(corners_of(self.source)).max() + self.source.diameter)
        turns = farthest * float(np.abs(self.waves.frequencies).max())
        return 8 * np.pi * float(np.spacing(turns)) * self.scale if turns else 0.0

    def evaluate(self, transform: str, *points: Array) -> Any:
        return getattr(transforms, transform)(self.source, *points, **self.keywords)


def case_of(
    source: Any,
    points: int,
    seed: int,
    precision: Precision,
    engine: str,
    tolerance: float | None,
) -> Case:
    """Random places in and around a source; ArgumentError for sources without phase space."""
    if not isinstance(source, Aperture | Slits):
        raise ArgumentError(
            f"expected an Aperture or Slits, got {type(source).__name__}; check an array with "
            "assert_array_identities, and the .aperture of a placed one by itself"
        )
    waves = waves_of(source)
    rng, points = checked_generator(seed), checked_count(points, "points", 1)
    corner, sides = box_of(source)
    dimension = len(corner)
    unit = rng.random((points, dimension))
    direction = rng.normal(size=(points, dimension))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    size = 10 ** rng.uniform(-2, 1.5, points) / source.diameter
    kept = TOLERANCE[checked_precision(precision) or "double"]
    if tolerance is None:
        tolerance = kept * max(1.0, thinness_of(source) / 10)
    tolerance = checked_number(tolerance, "tolerance", "a number up to 1")
    if not 0.0 <= tolerance <= 1.0:
        raise ArgumentError(f"expected tolerance as a number from 0 to 1, got {tolerance:g}")
    return Case(
        source,
        x=corner + unit @ sides,
        xi=(2 * rng.permutation(unit) - 1) @ sides,
        nu=waves.middles(rng, points) + size[:, None] * direction,
        upsilon=waves.distances(rng, points) + size[:, None] * direction,
        keywords={"precision": precision, "engine": engine},
        tolerance=tolerance,
        waves=waves,
    )


def content_of(source: Aperture | Slits) -> float:
    """Area, or length."""
    return source.length if isinstance(source, Slits) else source.area


def rim_of(source: Aperture | Slits) -> float:
    """Length of the boundary, or number of ends."""
    if isinstance(source, Slits):
        return 2.0 * len(source.intervals)
    return float(source.polygons.length)


def thinness_of(source: Aperture | Slits) -> float:
    """Boundary times diameter over content: how many ulps of it an ulp of the diameter is."""
    return rim_of(source) * source.diameter / content_of(source)


def box_of(source: Aperture | Slits) -> tuple[Array, Array]:
    """Corner and sides (rows) of the smallest box, turned so that needles fill it too."""
    if isinstance(source, Slits):
        return np.array(source.bounds[:1]), np.array([[source.diameter]])
    ring = shapely.get_coordinates(shapely.oriented_envelope(source.polygons))
    return ring[0], np.stack([ring[1] - ring[0], ring[3] - ring[0]])


def require(law: str, got: Any, expected: Any, allowed: Any, places: dict[str, Any]) -> None:
    """Compare arrays (n,); report the largest difference in units of the allowed one."""
    error = np.abs(np.atleast_1d(np.asarray(got) - np.asarray(expected)))
    error = np.where(np.isnan(error), np.inf, error)
    limit = np.broadcast_to(allowed, error.shape)
    worst = int(np.argmax(error / np.maximum(limit, np.finfo(float).tiny)))
    if error[worst] <= limit[worst]:
        return
    where = ", ".join(f"{name} = {_row(value, worst)}" for name, value in places.items())
    pair = [np.broadcast_to(side, error.shape)[worst] for side in (got, expected)]
    raise AssertionError(
        f"{law}: expected {pair[1]:.17g}, got {pair[0]:.17g} at {where} "
        f"(difference {error[worst]:.3g}, allowed {limit[worst]:.3g})"
    )


def _row(value: Any, number: int) -> Sequence[float]:
    """One place of several (n, d), or the only one (d,)."""
    array = np.asarray(value)
    row: list[float] = (array[number] if array.ndim > 1 else array).tolist()
    return row


_PLACES = 12  # of sums over pairs of elements, each pair a slice cut by itself
_LEAST_PLACES, _MOST_ELEMENTS = 1, 400  # fewer places than that for more elements


@dataclass(frozen=True)
class ArrayCase:
    """An array, places to look at, and how to evaluate."""

    array: Elements
    x: Array
    xi: Array
    nu: Array
    upsilon: Array
    keywords: dict[str, Any]
    tolerance: float

    @property
    def elements(self) -> tuple[Any, ...]:
        return self.array.elements_in_plane

    @property
    def weights(self) -> Array:
        return self.array.weights

    @property
    def dimension(self) -> int:
        return int(self.x.shape[-1])

    @cached_property
    def strengths(self) -> Array:
        """Bounds (n,) on the field of each element."""
        return np.abs(self.weights) * [waves_of(e).strength for e in self.elements]

    @cached_property
    def scale(self) -> float:
        """int |u|^2 if all were in phase: the scale of rounding errors of A and W / 2^d."""
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

    def evaluate(self, transform: str, *places: Array) -> Any:
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
    rng, points = checked_generator(seed), checked_count(points, "points", 1)
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
    kept = TOLERANCE[checked_precision(precision) or "double"]
    if tolerance is None:
        tolerance = kept * max(1.0, max(map(thinness_of, elements)) / 10)
    tolerance = checked_number(tolerance, "tolerance", "a number")
    return ArrayCase(
        array,
        x=(ends[0] + ends[1]) / 2,
        xi=ends[0] - ends[1],
        nu=(carriers[0] + carriers[1]) / 2 + size[:, None] * direction,
        upsilon=carriers[0] - carriers[1] + size[:, None] * direction,
        keywords={"precision": precision, "engine": engine},
        tolerance=tolerance,
    )


def _drawn_in(elements: Any, chosen: Array, rng: np.random.Generator) -> Array:
    """A random point (n, d) in the box of each chosen element."""
    boxes = {k: box_of(elements[k]) for k in set(chosen.tolist())}
    unit = rng.random((len(chosen), len(boxes[int(chosen[0])][0])))
    return np.stack(
        [boxes[k][0] + u @ boxes[k][1] for k, u in zip(chosen.tolist(), unit, strict=True)]
    )


def _wave_of(elements: Any, chosen: Array, rng: np.random.Generator) -> Array:
    """The frequency (n, d) of one of the waves of each chosen element."""
    return np.stack([rng.choice(waves_of(elements[k]).frequencies) for k in chosen.tolist()])


def wigner_is_real_and_bounded(case: Case | ArrayCase, allowed: float) -> Any:
    """Also returns W at the case's places."""
    value = case.evaluate("wigner", case.x, case.nu)
    if np.iscomplexobj(value):
        raise AssertionError(f"W is real: expected a real array, got {value.dtype}")
    bound = 2**case.dimension * case.energy
    law = f"|W| <= {2**case.dimension} times int |u|^2"
    here = {"x": case.x, "nu": case.nu}
    require(law, value, np.clip(value, -bound, bound), allowed, here)
    return value


def ambiguity_is_hermitian_and_bounded(case: Case | ArrayCase) -> None:
    here = {"upsilon": case.upsilon, "xi": case.xi}
    value = case.evaluate("ambiguity", case.upsilon, case.xi)
    mirrored = case.evaluate("ambiguity", -case.upsilon, -case.xi)
    require("A(-upsilon, -xi) = conj A(upsilon, xi)", mirrored, value.conj(), case.allowed, here)
    size = np.abs(value)
    require("|A| <= A(0, 0)", size, np.minimum(size, case.energy), case.allowed, here)


def values_at_zero(case: Case | ArrayCase, allowed: float) -> None:
    """Check that W, within ``allowed``, and A at zero frequency are the marginals."""
    zero = np.zeros(case.dimension)
    by_position = case.evaluate("position_marginal", case.x)
    at_zero = case.evaluate("wigner", case.x, zero)
    require("W(x, 0) = R_x(x)", at_zero, by_position, allowed, {"x": case.x})
    by_lag = case.evaluate("lag_marginal", case.xi)
    at_zero = case.evaluate("ambiguity", zero, case.xi)
    require("A(0, xi) = R_xi(xi)", at_zero, by_lag, case.allowed, {"xi": case.xi})
