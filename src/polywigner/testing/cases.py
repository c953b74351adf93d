"""Common parts of the assertions: a source with places to look at, and reports of differences."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal

import numpy as np
import shapely
from numpy.typing import NDArray

from polywigner import transforms
from polywigner.errors import ArgumentError
from polywigner.geometry import Aperture, Slits
from polywigner.testing.simplices import corners_of
from polywigner.testing.waves import Waves, waves_of

__all__ = [
    "TOLERANCE",
    "Case",
    "Precision",
    "box_of",
    "case_of",
    "content_of",
    "require",
    "rim_of",
    "thinness_of",
]

Array = NDArray[Any]
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
        """Bound on A and, times 2^d, on W; what their rounding errors are proportional to."""
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
    """Random places in and around a source; raises ArgumentError for what has no phase space."""
    if not isinstance(source, Aperture | Slits):
        raise ArgumentError(
            f"expected an Aperture or Slits, got {type(source).__name__}; check an array with "
            "assert_array_identities, and the .aperture of a placed one by itself"
        )
    waves = waves_of(source)
    rng = np.random.default_rng(seed)
    corner, sides = box_of(source)
    dimension = len(corner)
    unit = rng.random((points, dimension))
    direction = rng.normal(size=(points, dimension))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    size = 10 ** rng.uniform(-2, 1.5, points) / source.diameter
    if tolerance is None:
        tolerance = TOLERANCE[precision or "double"] * max(1.0, thinness_of(source) / 10)
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
    """Compare arrays (n,); say where they differ most, in units of what is allowed."""
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
