"""Random sources made of small distant parts, and their W and A pair by pair in exact arithmetic.

Slices of pairs of parts are cut in rational numbers, and transformed at 50 digits, with all floats
taken as they are. ``python tests/oracles/distant_parts.py --sources 1000`` looks for the worst
error.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any

import mpmath
import numpy as np

import polywigner as pw

if __name__ == "__main__":
    sys.path.insert(0, str(Path(__file__).parents[1]))

from oracles import exact

__all__ = ["Case", "drawn", "errors", "reference"]

SIDE = 2.0  # of the box that the parts' centres lie in
SIZES = (1e-6, 0.1)  # of parts' radii, in the side
APART = 2.5  # least distance of centres, in radii
GRID = 2.0**-12  # of frequencies where waves are subtracted from them, so that this is exact
POINTS = 4  # of each kind of frequency
OUTER = 8  # outer products are computed of one source in so many
COLUMNS = 64  # frequencies for each place that are computed together where that is asked for


@dataclass(frozen=True)
class Case:
    """A source, its parts (rings, weight), its waves, and places with frequencies (n, 2)."""

    source: Any
    parts: Sequence[tuple[np.ndarray, complex]]
    waves: Sequence[tuple[complex, tuple[float, float]]]
    places: np.ndarray
    frequencies: np.ndarray
    transform: str

    @property
    def energy(self) -> float:
        """The integral of |u|^2, or of the sum of waves at its largest."""
        largest = sum(abs(amplitude) for amplitude, _ in self.waves)
        return sum(abs(w * largest) ** 2 * exact.area([ring]) for ring, w in self.parts)

    def values(self, layout: str, **how: Any) -> np.ndarray:
        """What polywigner finds: at points, or for each place with many frequencies."""
        x, nu = self.places, self.frequencies
        if layout == "points":
            return self._evaluate(x, nu, **how)
        some = np.concatenate([nu, np.zeros((max(0, COLUMNS - len(nu)), 2))])
        found = self._evaluate(x[:, None], some[None], **how)
        return np.asarray(found[np.arange(len(x)), np.arange(len(x))])

    def _evaluate(self, x: np.ndarray, nu: np.ndarray, **how: Any) -> np.ndarray:
        if self.transform == "wigner":
            return np.asarray(pw.wigner(self.source, x, nu, **how))
        return np.asarray(pw.ambiguity(self.source, nu, x, **how))


def _outline(rng: np.random.Generator, turned: bool) -> np.ndarray:
    """A polygon of radius 1 or less about the origin: regular, an L, or any triangle."""
    kind = rng.integers(4)
    if kind == 0:
        angles = np.sort(rng.uniform(0, 2 * np.pi, 3)) + 0.1 * np.arange(3)
        points = np.column_stack([np.cos(angles), np.sin(angles)])
    elif kind == 1:
        points = np.array([[-1, -1], [1, -1], [1, -0.3], [-0.2, -0.3], [-0.2, 1], [-1, 1]]) / 1.5
    else:
        count = 4 if kind == 2 else int(rng.integers(3, 9))
        angles = np.pi / 4 + 2 * np.pi * np.arange(count) / count
        points = np.column_stack([np.cos(angles), np.sin(angles)])
    c, s = np.cos(a := rng.uniform(0, 2 * np.pi) if turned else 0.0), np.sin(a)
    return np.asarray(points @ np.array([[c, s], [-s, c]]))


def _centres(rng: np.random.Generator, count: int, apart: float) -> np.ndarray:
    found: list[np.ndarray] = []
    while len(found) < count:
        point = rng.uniform(-SIDE / 2, SIDE / 2, 2)
        if all(np.hypot(*(point - other)) > apart for other in found):
            found.append(point)
    return np.array(found)


def drawn(seed: int, most_parts: int = 50) -> Iterator[Case]:
    """One random source, and places and frequencies for its W and its A."""
    rng = np.random.default_rng(seed)
    count = int(np.exp(rng.uniform(np.log(2), np.log(most_parts + 1))))
    radius = SIDE * float(np.exp(rng.uniform(*np.log(SIZES))))
    count = min(count, int((SIDE / (APART * radius)) ** 2 / 2))
    same, turned = rng.random() < 0.25, rng.random() < 0.75
    one = _outline(rng, turned)
    centres = _centres(rng, count, APART * radius)
    rings = [
        centre + radius * rng.uniform(0.5, 1.0) * (one if same else _outline(rng, turned))
        for centre in centres
    ]
    weights, waves = [1.0 + 0j] * count, [(1.0 + 0j, (0.0, 0.0))]
    kind = rng.integers(4)
    source: Any = pw.Aperture(rings)
    if kind in (1, 2):
        weights = [complex(*rng.normal(size=2)) if kind == 2 else 1.0 + 0j for _ in rings]
        source = pw.Array([pw.Aperture(ring) for ring in rings], weights)
    elif kind == 3:
        size = int(rng.integers(1, 4))
        kappa = np.round(rng.normal(size=(size, 2)) * 3 / SIDE / GRID) * GRID
        amplitudes = rng.normal(size=size) + 1j * rng.normal(size=size)
        waves = list(zip(amplitudes.tolist(), map(tuple, kappa.tolist()), strict=True))
        source = source.with_illumination(pw.Illumination(amplitudes, kappa))
    # triangles may come out clockwise: apertures turn them round, and so must the oracle
    parts = list(zip(exact.oriented((ring, ()) for ring in rings), weights, strict=True))
    nu = _frequencies(rng, radius, kind == 3)
    first, second = (centres[rng.integers(count, size=len(nu))] for _ in range(2))
    near = radius * rng.uniform(-1, 1, (len(nu), 2)) * rng.choice([0.0, 0.3, 1.0], (len(nu), 1))
    yield Case(source, parts, waves, (first + second) / 2 + near / 2, nu, "wigner")
    yield Case(source, parts, waves, first - second + near, nu, "ambiguity")


def _frequencies(rng: np.random.Generator, radius: float, on_grid: bool) -> np.ndarray:
    """0, tiny, 1 to 1e3 in units of the box, 1 to 30 in those of a part."""
    sizes = [
        np.zeros(POINTS // 2),
        1e-6 * rng.random(POINTS),
        10 ** rng.uniform(0, 3, POINTS) / SIDE,
        30 ** rng.uniform(0, 1, POINTS) / radius,
    ]
    angle = rng.uniform(0, 2 * np.pi, sum(map(len, sizes)))
    nu = np.concatenate(sizes)[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
    return np.round(nu / GRID) * GRID if on_grid else nu


def reference(case: Case) -> np.ndarray:
    """The values of a case, (n,) complex."""
    found = [_value(case, x, nu) for x, nu in zip(case.places, case.frequencies, strict=True)]
    return np.array(found)


def _value(case: Case, x: np.ndarray, nu: np.ndarray) -> complex:
    total = 0j
    cut = exact.lag_region if case.transform == "wigner" else exact.position_region
    boxes = np.array([[*ring.min(axis=0), *ring.max(axis=0)] for ring, _ in case.parts])
    for k, m in _meeting(boxes, x, case.transform):
        (one, first), (other, second) = case.parts[k], case.parts[m]
        region = cut([one], x, [other])
        if region.trapezoids:
            total += first * second.conjugate() * _of_waves(case, region, x, nu)
    return total


def _meeting(boxes: np.ndarray, x: np.ndarray, transform: str) -> Iterator[tuple[int, int]]:
    """Pairs whose boxes may meet."""
    low, high = boxes[:, None, :2], boxes[:, None, 2:]
    if transform == "wigner":  # p + p' = 2x
        meet = (low + boxes[:, :2] <= 2 * x + 1e-9) & (2 * x - 1e-9 <= high + boxes[:, 2:])
    else:  # p - p' = xi
        meet = (low - boxes[:, 2:] <= x + 1e-9) & (x - 1e-9 <= high - boxes[:, :2])
    for k, m in np.argwhere(meet.all(axis=-1)):
        yield int(k), int(m)


def _of_waves(case: Case, region: Any, x: np.ndarray, nu: np.ndarray) -> complex:
    total = 0j
    for a, one in case.waves:
        for b, other in case.waves:
            mean = np.add(one, other) / 2
            apart = np.subtract(one, other)
            shift, rate = (mean, apart) if case.transform == "wigner" else (apart, mean)
            value = (
                complex(exact.transform(region, nu - shift))
                if any(nu - shift)
                else complex(float(region.area))
            )
            total += a * b.conjugate() * _wave(rate, x) * value
    return total


def _wave(rate: np.ndarray, x: np.ndarray) -> complex:
    """exp(2 pi i rate.x)."""
    turns = sum(Fraction(f) * Fraction(p) for f, p in zip(rate.tolist(), x.tolist(), strict=True))
    return complex(mpmath.expjpi(2 * float(turns - round(turns))))


def errors(case: Case, values: np.ndarray, exactly: np.ndarray) -> np.ndarray:
    """|error| over the energy."""
    wanted = exactly.real if case.transform == "wigner" else exactly
    return np.asarray(np.abs(values - wanted) / case.energy)


def _search(sources: int, start: int, engines: Sequence[str], most_parts: int) -> None:
    worst: dict[tuple[str, ...], tuple[float, int]] = {}
    for seed in range(start, start + sources):
        for case in drawn(seed, most_parts):
            exactly = reference(case)
            for engine in engines:
                for precision in ("double", "single"):
                    for layout in ("points", "outer"):
                        if layout == "outer" and seed % OUTER:
                            continue  # takes long: NumPy computes more of them, LLVM compiles
                        found = case.values(layout, engine=engine, precision=precision)
                        key = (case.transform, engine, precision, layout)
                        largest = float(errors(case, found, exactly).max())
                        worst[key] = max(worst.get(key, (0.0, 0)), (largest, seed))
        if not (seed + 1 - start) % min(50, sources):
            _print(worst, seed + 1 - start, start, most_parts)


def _print(worst: Any, sources: int, start: int, most_parts: int) -> None:
    print(f"{sources} sources of 2 to {most_parts} parts from seed {start}: |error|/energy, seed")
    for key, (largest, seed) in sorted(worst.items()):
        print(f"{' '.join(key):40} {largest:.2e} {seed}", flush=True)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--sources", type=int, default=1000)
    parser.add_argument("--start", type=int, default=0)
    parser.add_argument("--most-parts", type=int, default=50)
    parser.add_argument("--engines", nargs="+", default=["numpy", "llvm"])
    given = parser.parse_args()
    _search(given.sources, given.start, given.engines, given.most_parts)
