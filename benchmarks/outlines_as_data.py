"""How much time and memory does a call with a new outline cost?

Run ``python benchmarks/outlines_as_data.py``, with ``HOME`` set to an empty folder to include
compilation. Each call has another random outline of 3 to 12 vertices, on the default and on the
compiled engine; calls with a fixed outline are the reference. Arguments are NumPy arrays. Prints
two Markdown tables: milliseconds per call by number of samples, and kilobytes that a call adds to
the process over thousands of calls, with the files that Dr.Jit has written.
"""

from __future__ import annotations

import gc
import itertools
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

import polywigner as pw
from polywigner.errors import GeometryError

SAMPLES = (100, 1000, 10_000, 100_000)
ROUNDS, SECONDS = 5, 1.0
WARM_UP, CALLS = 500, 5000
MANY = 400  # more than the size of the cache
TRANSFORMS: dict[str, Callable[..., Any]] = {
    "W": pw.wigner,
    "A": lambda source, x, nu, **how: pw.ambiguity(source, nu, x, **how),
    "F": lambda source, x, nu, **how: pw.fourier(source, nu, **how),
}


def outlines(seed: int) -> Iterator[np.ndarray]:
    """Yield star-shaped rings with 3 to 12 vertices, about 1 cm in size."""
    rng = np.random.default_rng(seed)
    while True:
        count = rng.integers(3, 13)
        angle, radius = np.sort(rng.random(count)) * 2 * np.pi, 0.5 + 0.5 * rng.random(count)
        ring = 0.01 * radius[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
        try:
            pw.Aperture(ring)
        except GeometryError:  # three collinear vertices, or vertices on one side of the centre
            continue
        yield ring


def points(samples: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(0)
    return (rng.random((samples, 2)) - 0.5) * 0.01, (rng.random((samples, 2)) - 0.5) * 2000


def milliseconds(name: str, samples: int) -> list[float]:
    """Return times for new outlines, a fixed outline, and new outlines with NumPy."""
    arguments = points(samples)
    new = list(itertools.islice(outlines(samples), MANY))
    rings, kept = itertools.cycle(new), new[0]
    ways: list[tuple[bool, str]] = [(True, "llvm"), (False, "llvm"), (True, "numpy")]
    least = [np.inf] * len(ways)
    for _, (k, (changes, engine)) in itertools.product(range(ROUNDS), enumerate(ways)):
        calls, begin = 0, time.perf_counter()
        while calls < 3 or time.perf_counter() - begin < SECONDS / ROUNDS:
            source = pw.Aperture(next(rings) if changes else kept)
            TRANSFORMS[name](source, *arguments, engine=engine)
            calls += 1
        least[k] = min(least[k], (time.perf_counter() - begin) / calls)
    return [1e3 * value for value in least]


def kilobytes(name: str, engine: Any) -> tuple[float, float, int]:
    """Return the memory that a call adds, its milliseconds, and the number of new files."""
    arguments = points(1000)
    rings = iter(list(itertools.islice(outlines(7), WARM_UP + CALLS)))
    before = len(list(_cache().glob("*")))

    def run(calls: int) -> float:
        for ring in itertools.islice(rings, calls):
            TRANSFORMS[name](pw.Aperture(ring), *arguments, engine=engine)
        gc.collect()
        return _resident()

    first, begin = run(WARM_UP), time.perf_counter()
    last = run(CALLS)
    took = 1e3 * (time.perf_counter() - begin) / CALLS
    return (last - first) / CALLS, took, len(list(_cache().glob("*"))) - before


def _resident() -> float:
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * 4096 / 1024


def _cache() -> Path:
    return Path.home() / ".drjit"


def main() -> None:
    print("| | samples | new outlines, compiled (ms) | one outline | new ones, NumPy |")
    print("|---|---|---|---|---|")
    for name, samples in itertools.product(TRANSFORMS, SAMPLES):
        result = " | ".join(f"{value:.2f}" for value in milliseconds(name, samples))
        print(f"| {name} | {samples} | {result} |", flush=True)
    print(f"\n| {CALLS} calls, 1000 samples | KiB a call | ms a call | files |\n|---|---|---|---|")
    for name, engine in itertools.product(TRANSFORMS, ("llvm", "auto")):
        grown, took, files = kilobytes(name, engine)
        print(f'| {name}, engine="{engine}" | {grown:.1f} | {took:.1f} | {files} |', flush=True)


if __name__ == "__main__":
    sys.exit(main())
