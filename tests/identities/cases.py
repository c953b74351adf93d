"""Sources to check: waves, pieces and images, places to look at, and sums over slices."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray

from polywigner import transforms
from polywigner.errors import ArgumentError
from polywigner.execution import Precision, checked_precision
from polywigner.geometry import Aperture, Slits, triangulate
from polywigner.geometry.arguments import checked_count, checked_generator, checked_number
from polywigner.illumination import Array as Elements
from polywigner.illumination import Illumination

Array = NDArray[Any]


def corners_of(source: Any) -> Array:
    """Vertices (n, 2) of an aperture, or ends (n, 1) of slits."""
    if isinstance(source, Slits):
        return source.intervals.reshape(-1, 1)
    if isinstance(source, Elements):
        return np.concatenate([corners_of(element) for element in source.elements_in_plane])
    return np.concatenate(source.rings)


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

    def drawn(self, rng: np.random.Generator, count: int, first: float, second: float) -> Array:
        """Sums (count, d) of multiples of two frequencies.

        W is large about means of two, and A about differences.
        """
        one, other = rng.integers(len(self.amplitudes), size=(2, count))
        return first * self.frequencies[one] + second * self.frequencies[other]

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


# Relative to the content: what the package promises. Shapely's clipping may move a corner by an
# ulp of the diameter, which is why the tolerance grows with perimeter * diameter for slivers.
TOLERANCE = {"double": 1e-12, "single": 5e-6}


@dataclass(frozen=True)
class Case:
    """A source, places to look at, and how to evaluate."""

    source: Any
    """An Aperture, Slits, or an Array of either."""
    x: Array
    xi: Array
    nu: Array
    upsilon: Array
    keywords: dict[str, Any]
    tolerance: float

    @property
    def is_array(self) -> bool:
        return isinstance(self.source, Elements)

    @property
    def elements(self) -> tuple[Any, ...]:
        return tuple(self.source.elements_in_plane)

    @property
    def weights(self) -> Array:
        return np.asarray(self.source.weights) if self.is_array else np.ones(1)

    @property
    def dimension(self) -> int:
        return int(self.x.shape[-1])

    @cached_property
    def waves(self) -> Waves:
        """The waves on a single source."""
        return waves_of(self.source)

    @cached_property
    def outline(self) -> Any:
        """A single source without its field."""
        return self.source.with_illumination(None)

    @property
    def content(self) -> float:
        return content_of(self.source)

    @cached_property
    def strengths(self) -> Array:
        """Bounds (n,) on the field of each element."""
        return np.abs(self.weights) * [waves_of(e).strength for e in self.elements]

    @cached_property
    def scale(self) -> float:
        """Bound on A and, times 2^d, on W; their rounding errors are proportional to it."""
        if not self.is_array:
            return float(self.strengths[0] ** 2) * self.content
        outlines = [element.with_illumination(None) for element in self.elements]
        return _energy(Elements(outlines, self.strengths))

    @cached_property
    def allowed(self) -> float:
        """Error allowed to A and, times 2^d, to W."""
        return self.tolerance * self.scale + (self._displaced if self.is_array else 0.0)

    @property
    def _displaced(self) -> float:
        """Error in W and A from rounding of the elements' places and of phases there."""
        farthest = max(float(np.abs(corners_of(element)).max()) for element in self.elements)
        ulp = float(np.spacing(4 * farthest))
        rims = sum(s * rim_of(e) for s, e in zip(self.strengths, self.elements, strict=True))
        frequency = max(float(np.abs(self.nu).max()), float(np.abs(self.upsilon).max()))
        by_rims = 4 * ulp * float(self.strengths.max()) * rims
        return by_rims + 8 * np.pi * ulp * frequency * self.scale

    @cached_property
    def energy(self) -> float:
        """int |u|^2, of a single source by pairs of waves."""
        if self.is_array:
            return _energy(self.source)
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

    @property
    def few(self) -> int:
        """At how many places to sum over pairs of elements, each pair a slice cut by itself."""
        return max(1, min(_PLACES, _MOST_ELEMENTS // len(self.elements)))

    @property
    def otherwise(self) -> dict[str, Any]:
        """Keywords for many sources at few places, for which compiling would be slower."""
        return {**self.keywords, "engine": "numpy"}

    def evaluate(self, transform: str, *points: Array) -> Any:
        return getattr(transforms, transform)(self.source, *points, **self.keywords)


def _energy(array: Elements) -> float:
    zero = np.zeros((1, array.dimension))
    return float(transforms.ambiguity(array, zero, zero, engine="numpy")[0].real)


def tolerance_of(given: Any, promised: dict[str, float], precision: Any, factor: float) -> float:
    """The tolerance given, or the promised one times a factor; ArgumentError for odd numbers."""
    kept = promised[checked_precision(precision) or "double"] * max(1.0, factor)
    tolerance = checked_number(kept if given is None else given, "tolerance", "a number up to 1")
    if not 0.0 <= tolerance <= 1.0:
        raise ArgumentError(f"expected tolerance as a number from 0 to 1, got {tolerance:g}")
    return tolerance


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
    unit = rng.random((points, len(corner)))
    away = _vectors(rng, unit.shape, 0.01 / source.diameter, 10**1.5 / source.diameter)
    return Case(
        source,
        x=corner + unit @ sides,
        xi=(2 * rng.permutation(unit) - 1) @ sides,
        nu=waves.drawn(rng, points, 0.5, 0.5) + away,
        upsilon=waves.drawn(rng, points, 1.0, -1.0) + away,
        keywords={"precision": precision, "engine": engine},
        tolerance=tolerance_of(tolerance, TOLERANCE, precision, thinness_of(source) / 10),
    )


def array_case_of(
    array: Any,
    points: int,
    seed: int,
    precision: Precision,
    engine: str,
    tolerance: float | None,
) -> Case:
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
    corners = np.concatenate([corners_of(element) for element in elements])
    largest = float(np.linalg.norm(np.ptp(corners, axis=0)))
    smallest = min(element.diameter for element in elements)
    away = _vectors(rng, ends[0].shape, 0.01 / largest, 10 / smallest)
    carriers = [_wave_of(elements, chosen, rng) for chosen in (one, other)]
    thinnest = max(map(thinness_of, elements))
    return Case(
        array,
        x=(ends[0] + ends[1]) / 2,
        xi=ends[0] - ends[1],
        nu=(carriers[0] + carriers[1]) / 2 + away,
        upsilon=carriers[0] - carriers[1] + away,
        keywords={"precision": precision, "engine": engine},
        tolerance=tolerance_of(tolerance, TOLERANCE, precision, thinnest / 10),
    )


def _vectors(rng: np.random.Generator, shape: Any, least: float, most: float) -> Array:
    """Vectors (n, d) in any direction, of all orders of size from ``least`` to ``most``."""
    direction = rng.normal(size=shape)
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    size = 10 ** rng.uniform(np.log10(least), np.log10(most), shape[0])
    return np.asarray(size[:, None] * direction)


def content_of(source: Any) -> float:
    """Length or area."""
    return source.length if isinstance(source, Slits) else float(source.area)


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


# Of sums over pairs of elements: places, and fewer of them for more elements in all.
_PLACES, _MOST_ELEMENTS = 12, 400


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


def _slices(sources: Sequence[Any], to_first: Any, to_second: Any) -> Any:
    """(j, k, intersection of one map of element j and another of k), where there is one."""
    if isinstance(sources[0], Slits):
        first = [to_first(source.intervals) for source in sources]
        second = [np.sort(to_second(source.intervals), axis=1) for source in sources]
        found = ((j, k, _overlaps(a, b)) for j, a in enumerate(first) for k, b in enumerate(second))
    else:
        outlines = np.array([source.polygons for source in sources])
        first, second = (shapely.transform(outlines, to) for to in (to_first, to_second))
        meeting = shapely.STRtree(second).query(first).T.tolist()
        found = ((j, k, _apertures(shapely.intersection(first[j], second[k]))) for j, k in meeting)
    return [(j, k, parts) for j, k, parts in found if parts]


def _apertures(region: Any) -> list[Any]:
    parts = shapely.get_parts(region)
    return [Aperture(p) for p in parts if p.geom_type == "Polygon" and p.area > 0]


def _overlaps(first: Array, second: Array) -> list[Any]:
    low = np.maximum(first[:, None, 0], second[:, 0]).ravel()
    high = np.minimum(first[:, None, 1], second[:, 1]).ravel()
    return [Slits([a, b]) for a, b in zip(low, high, strict=True) if a < b]


def wigner_by_pairs(case: Case, x: Array, nu: Array) -> Any:
    """The sum of w_j w_k* c_m c_n* exp(2 pi i (k_m - k_n).x) F(nu - (k_m + k_n)/2) of slices.

    Those at x (d,): 2(G_j - x) & 2(x - G_k).
    """
    return _summed(
        (parts, factor * _turn((one - other) @ x), nu - (one + other) / 2)
        for j, k, parts in _slices(case.elements, lambda p: 2 * (p - x), lambda p: 2 * (x - p))
        for factor, one, other in _waves_of_pair(case, j, k)
    ).real


def ambiguity_by_pairs(case: Case, upsilon: Array, xi: Array) -> complex:
    """The sum of w_j w_k* c_m c_n* exp(pi i (k_m + k_n).xi) F(upsilon - k_m + k_n) of slices.

    Those at xi (d,): (G_j - xi/2) & (G_k + xi/2).
    """
    return _summed(
        (parts, factor * _turn((one + other) @ xi / 2), upsilon - one + other)
        for j, k, parts in _slices(case.elements, lambda p: p - xi / 2, lambda p: p + xi / 2)
        for factor, one, other in _waves_of_pair(case, j, k)
    )


def _turn(turns: Any) -> complex:
    return complex(np.exp(2j * np.pi * turns))


def _waves_of_pair(case: Case, j: int, k: int) -> Iterator[tuple[complex, Array, Array]]:
    """(w_j w_k* c_m c_n*, k_m, k_n) for the waves of elements j and k."""
    one, other = waves_of(case.elements[j]), waves_of(case.elements[k])
    factor = complex(case.weights[j] * case.weights[k].conjugate())
    for c, kappa in zip(one.amplitudes.tolist(), one.frequencies, strict=True):
        for d, frequency in zip(other.amplitudes.tolist(), other.frequencies, strict=True):
            yield factor * c * d.conjugate(), kappa, frequency


def _summed(terms: Iterable[tuple[list[Any], complex, Array]]) -> complex:
    """The sum of factor times F(q) of parts, over (parts, factor, q)."""
    found: dict[bytes, tuple[Array, list[Any], list[complex]]] = {}
    for parts, factor, q in terms:
        if factor:
            _, pieces, factors = found.setdefault(q.tobytes(), (q, [], []))
            pieces += parts
            factors += [factor] * len(parts)
    return sum(
        (
            complex(transforms.fourier(Elements(pieces, factors), q, engine="numpy"))
            for q, pieces, factors in found.values()
        ),
        0j,
    )


def moved(source: Aperture | Slits, matrix: Array, shift: Array) -> Any:
    """The image under x -> matrix x + shift, its field carried along."""
    image = (
        Slits(source.intervals * matrix[0, 0] + shift[0])
        if isinstance(source, Slits)
        else Aperture(shapely.transform(source.polygons, lambda x: x @ matrix.T + shift))
    )
    if source.illumination is None:
        return image
    return image.with_illumination(waves_of(source).mapped(matrix, shift))


def split_in_three(source: Aperture | Slits) -> tuple[list[Any], list[Any]]:
    """Three pieces that tile the source, and the three unions of two of them; with its field."""
    kind: Any
    kind, pieces = (Slits, _thirds(source)) if isinstance(source, Slits) else _triangles(source)

    def made(piece: Any) -> Any:
        return kind(piece).with_illumination(source.illumination)

    singles = [made(piece) for piece in pieces]
    return singles, [made([*pieces[k], *pieces[k - 1]]) for k in range(3)]


def _thirds(source: Slits) -> list[list[tuple[float, float]]]:
    """The first third of every slit, the second, and the last."""
    pieces: list[list[tuple[float, float]]] = [[], [], []]
    for begin, end in source.intervals.tolist():
        cuts = [begin, begin + (end - begin) / 3, begin + (end - begin) * 2 / 3, end]
        for k in range(3):
            pieces[k].append((cuts[k], cuts[k + 1]))
    return pieces


def _triangles(source: Aperture) -> tuple[Any, list[list[Array]]]:
    """Triangles in three groups from one side to the other."""
    vertices, indices = triangulate(source)
    triangles = vertices[indices]
    if len(triangles) < 3:
        centres = np.broadcast_to(triangles.mean(axis=1, keepdims=True), triangles.shape)
        ahead = np.roll(triangles, -1, axis=1)
        triangles = np.stack([triangles, ahead, centres], axis=2).reshape(-1, 3, 2)
    order = np.argsort(triangles.mean(axis=1) @ (1.0, 0.3))
    return Aperture, [list(triangles[part]) for part in np.array_split(order, 3)]
