"""How much slower is the default engine than the best engine for a call?

A matrix of sources, functions, numbers of samples and layouts. Each call runs in a separate
process, forked after the import of polywigner: the first call, with Dr.Jit's import, tables and
compilation (no compiled kernels are on disk), and the best of the next calls (three seconds of
them), in processor seconds of all threads, which do not depend on the load of the machine. Regret
is the time of ``engine="auto"`` over the shortest time of all engines; calls below 20 ms do not
count. The thresholds of :mod:`polywigner.execution.choice` follow from the output.

    python benchmarks/default_regret.py [--quick] [--only SOURCE ...]
                            [--functions wigner ...] [--sizes 1 100 ...] [--layouts points ...]
"""

from __future__ import annotations

import argparse
import itertools
import os
import pickle
import select
import shutil
import signal
import tempfile
import time
import traceback
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

import polywigner as pw

LAYOUTS = ("points", "one place", "outer", "grid")
FUNCTIONS = ("wigner", "ambiguity", "fourier")
ENGINES = ("auto", "numpy", "llvm")
SIZES = (1, 100, 1_000, 10_000, 100_000, 1_000_000)
QUICK_SIZES = (100, 10_000)
COUNTED = 20e-3
"""Seconds below which nobody notices a regret."""
PATIENCE = 12.0
"""Seconds after which a case is stopped, and counts as so long."""
CYCLES = 10.0
"""|nu| times the diameter, at most."""


def coastline(count: int, seed: int = 1) -> pw.Aperture:
    """Return an outline about 2 cm wide without symmetry."""
    rng = np.random.default_rng(seed)
    angle = 2 * np.pi * (np.arange(count) + 0.3 * rng.random(count)) / count
    walk = 0.25 * np.cumsum(rng.normal(size=count)) / np.sqrt(count)
    radius = np.maximum(1.0 + walk - np.linspace(0, walk[-1] - walk[0], count), 0.2)
    radius = radius + 9.0 / count * rng.normal(size=count).clip(-1, 1)
    return pw.Aperture(1e-2 * np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=-1))


def _scattered(count: int) -> pw.Array:
    places = np.random.default_rng(3).uniform(-0.05, 0.05, (count, 2))
    return pw.phased_array(pw.shapes.square(4e-3), places)


def _lattice(count: int, weights: Any = None) -> pw.Array:
    steps = 10e-3 * (np.arange(count) - (count - 1) / 2)
    places = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
    return pw.phased_array(pw.shapes.square(8e-3), places, weights)


SOURCES: dict[str, Callable[[], Any]] = {
    "square": lambda: pw.shapes.square(10e-3),
    "chevron": lambda: pw.shapes.chevron(20e-3, 12e-3, 4e-3),
    "two chevrons": lambda: pw.shapes.chevron_pair(20e-3, 12e-3, 4e-3),
    "18 hexagons": lambda: pw.shapes.hexagonal_segments(3e-3),
    "64-gon": lambda: pw.shapes.regular_polygon(64, 10e-3),
    "coastline of 300": lambda: coastline(300),
    "1000-gon": lambda: pw.shapes.regular_polygon(1000, 10e-3),
    "tapered square": lambda: pw.shapes.square(10e-3).with_illumination(
        pw.cosine_taper(10e-3, 10e-3)
    ),
    "tapered chevron": lambda: pw.shapes.chevron(20e-3, 12e-3, 4e-3).with_illumination(
        pw.cosine_taper(20e-3, 12e-3)
    ),
    "8 x 8 lattice": lambda: _lattice(8),
    "32 x 32 lattice": lambda: _lattice(32),
    "60 scattered": lambda: _scattered(60),
    "5 slits": lambda: pw.Slits(np.cumsum(np.linspace(1e-3, 3e-3, 10)).reshape(5, 2)),
    "pyramid": lambda: pw.Polyhedron(
        1e-2 * np.array([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0.5, 0.5, 1.0)]),
        [(3, 2, 1, 0), (0, 1, 4), (1, 2, 4), (2, 3, 4), (3, 0, 4)],
    ),
}


@dataclass(frozen=True)
class Case:
    """A call to measure."""

    source: str
    function: str
    layout: str
    samples: int

    def __str__(self) -> str:
        return f"{self.source} | {self.function} | {self.layout} | {self.samples}"


def cases(chosen: argparse.Namespace) -> Iterator[Case]:
    """Yield all valid combinations."""
    sizes = chosen.sizes or (QUICK_SIZES if chosen.quick else SIZES)
    combinations = itertools.product(chosen.only, chosen.functions, chosen.layouts, sizes)
    for name, function, layout, samples in combinations:
        if name == "pyramid" and function != "fourier":
            continue
        if function == "fourier" and layout in ("one place", "outer"):
            continue  # F has one argument
        if name == "5 slits" and layout == "grid":
            continue
        if samples == 1 and layout != "points":
            continue
        yield Case(name, function, layout, samples)


def arguments(case: Case, source: Any) -> tuple[Any, ...]:
    rng = np.random.default_rng(case.samples)
    size = float(np.max(np.ptp(_extent(source), axis=0)))
    dimension = {pw.Slits: 1, pw.Polyhedron: 3}.get(type(source), 2)
    low = np.min(_extent(source), axis=0)

    def places(shape: tuple[int, ...]) -> Any:
        return low + np.ptp(_extent(source), axis=0) * rng.uniform(0.1, 0.9, (*shape, dimension))

    def lags(shape: tuple[int, ...]) -> Any:
        return size * rng.uniform(-0.7, 0.7, (*shape, dimension))

    def frequencies(shape: tuple[int, ...]) -> Any:
        return CYCLES / size * rng.uniform(-1, 1, (*shape, dimension))

    n = case.samples
    side = max(1, round(n**0.5))
    if case.layout == "grid":
        axis = np.linspace(-CYCLES, CYCLES, side) / size
        nu: Any = np.stack(np.meshgrid(*[axis] * 2), axis=-1)
        if dimension == 3:
            nu = np.concatenate([nu, np.full((*nu.shape[:2], 1), 0.3 / size)], axis=-1)
    elif case.layout == "outer":
        nu = frequencies((side,))
    else:
        nu = frequencies((n,))
    if case.function == "fourier":
        return (nu,)
    shape = {"points": (n,), "outer": (side, 1)}.get(case.layout, ())
    return (places(shape), nu) if case.function == "wigner" else (nu, lags(shape))


def _extent(source: Any) -> Any:
    if isinstance(source, pw.Slits):
        return source.intervals.reshape(-1, 1)
    if isinstance(source, pw.Polyhedron):
        return source.vertices
    elements = source.elements if isinstance(source, pw.Array) else [source]
    return np.concatenate([np.reshape(element.bounds, (2, 2)) for element in elements])


@dataclass(frozen=True)
class Timed:
    """Seconds of the first call in a separate process, and of the best of the next calls."""

    first: float
    next: float


def timed(case: Case, engine: str) -> Timed:
    """Measure a case with one engine."""
    reader, writer = os.pipe()
    home = tempfile.mkdtemp()
    child = os.fork()
    if child == 0:
        os.close(reader)
        os.environ["HOME"] = home  # Dr.Jit stores compiled kernels there
        try:
            source = SOURCES[case.source]()
            given = arguments(case, source)
            function = getattr(pw, case.function)
            times = []
            while len(times) < 2 or (len(times) < 60 and sum(times) < 3.0):
                start = time.process_time()
                function(source, *given, engine=engine)
                times.append(time.process_time() - start)
            result = Timed(times[0], min(times[1:]))
            os.write(writer, pickle.dumps(result))
        except Exception:
            traceback.print_exc()
        finally:
            os._exit(0)
    os.close(writer)
    ready, _, _ = select.select([reader], [], [], PATIENCE)
    answer = os.read(reader, 1 << 12) if ready else b""
    os.close(reader)
    if not answer:
        os.kill(child, signal.SIGKILL)
    os.waitpid(child, 0)
    shutil.rmtree(home, ignore_errors=True)
    return pickle.loads(answer) if answer else Timed(PATIENCE, PATIENCE)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--only", nargs="+", default=list(SOURCES), choices=list(SOURCES))
    parser.add_argument("--functions", nargs="+", default=FUNCTIONS, choices=FUNCTIONS)
    parser.add_argument("--layouts", nargs="+", default=LAYOUTS, choices=LAYOUTS)
    parser.add_argument("--sizes", nargs="+", type=int)
    chosen = parser.parse_args()
    square, origin = SOURCES["square"](), np.zeros(2)
    for function in FUNCTIONS:
        given = (origin,) if function == "fourier" else (origin, origin)
        getattr(pw, function)(square, *given, engine="numpy")
    print("load average", *(f"{value:.1f}" for value in os.getloadavg()))
    print("source | function | layout | samples | first: auto, numpy, llvm | next | regrets")
    worst = [0.0, 0.0]
    for case in cases(chosen):
        result = timed(case, "auto")
        times = {"auto": (result.first, result.next)}
        if max(times["auto"]) <= COUNTED:
            print(f"{case} | {result.first:.2g} | {result.next:.2g} | not counted", flush=True)
            continue
        for engine in ENGINES[1:]:
            result = timed(case, engine)
            times[engine] = (result.first, result.next)
        regrets = []
        for k in (0, 1):
            best = min(seconds[k] for seconds in times.values())
            counts = times["auto"][k] > COUNTED
            regrets.append(times["auto"][k] / best if counts else 1.0)
            worst[k] = max(worst[k], regrets[k])
        shown = " | ".join(
            ", ".join(f"{times[engine][k]:.2g}" for engine in ENGINES) for k in (0, 1)
        )
        flag = "  <--" if max(regrets) > 1.5 else ""
        print(f"{case} | {shown} | {regrets[0]:.1f}, {regrets[1]:.1f}{flag}", flush=True)
    print(f"worst regret: first call {worst[0]:.2f}, next calls {worst[1]:.2f}")


if __name__ == "__main__":
    main()
