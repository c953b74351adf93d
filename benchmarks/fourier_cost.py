"""What do values of F and the first call cost, for different numbers of vertices?

Run ``python benchmarks/fourier_cost.py``. Time of F at scattered frequencies, for polygons of 3 to
1024 vertices, and time and memory of the first call of a process, without compiled kernels on disk.
(``make bench`` compares grids with finufft and others.)

All contenders take turns in one process, and the median of the rounds counts: CPU seconds with one
thread, and wall-clock time with all cores. Prints Markdown, and writes
``benchmarks/results/fourier_cost.json``.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

import polywigner as pw
from polywigner.llvm import prepare

RESULTS = Path(__file__).parent / "results" / "fourier_cost.json"
ROUNDS = 5
VERTICES = [3, 4, 6, 8, 12, 16, 32, 64, 128, 256, 512, 1024]
FIRST_CALLS = [3, 12, 16, 128, 1024]
EDGE_SAMPLES = {"numpy": 1 << 18, "llvm": 1 << 23}  # samples times vertices per measurement
MOST_SAMPLES = {"numpy": 1 << 13, "llvm": 1 << 18}
THREADS = "POLYWIGNER_BENCHMARK_THREADS"

Action = Callable[[], Any]


def threads() -> int:
    """Return the number of threads that this process may use."""
    return int(os.environ.get(THREADS, 0)) or cores()


def cores() -> int:
    """Return the number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def in_turns(actions: dict[str, Action], rounds: int) -> dict[str, list[float]]:
    """Return sorted times of every action, after one call of each."""
    clock = time.process_time if threads() == 1 else time.perf_counter
    times: dict[str, list[float]] = {name: [] for name in actions}
    for action in actions.values():
        action()
    for _ in range(rounds):
        for name, action in actions.items():
            start = clock()
            action()
            times[name].append(clock() - start)
    return {name: sorted(result) for name, result in times.items()}


def polygon(kind: str, n: int) -> pw.Aperture:
    if kind == "regular":
        return pw.shapes.regular_polygon(n, 1.0)
    if kind == "star":
        return pw.shapes.star(n // 2, 1.0, 0.5)
    rng = np.random.default_rng(n)
    angle = 2 * np.pi * (np.arange(n) + 0.9 * rng.random(n)) / n
    return pw.Aperture(
        rng.uniform(0.3, 1, n)[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
    )


def scattered(source: pw.Aperture, count: int) -> np.ndarray:
    """Return frequencies up to ten over the diameter."""
    return np.random.default_rng(0).uniform(-10, 10, (count, 2)) / source.diameter


def vertex_costs() -> dict[str, dict[str, float]]:
    """Return nanoseconds per value, {contender: {n: median}}, measured in turn."""
    actions: dict[str, Action] = {}
    samples = {}
    engines = ["numpy", "llvm"] if prepare().usable else ["numpy"]
    for engine in engines:
        for precision, kind in (
            ("double", "regular"), ("double", "star"), ("double", "random"), ("single", "regular"),
        ):  # fmt: skip
            for n in VERTICES:
                if kind != "regular" and n < 8:
                    continue  # a star of three points is a triangle
                count = min(MOST_SAMPLES[engine], EDGE_SAMPLES[engine] // n)
                name = f"{engine}, {precision}, {kind}|{n}"
                source = polygon(kind, n)
                actions[name] = evaluation(source, count, precision, engine)
                samples[name] = count
    times = in_turns(actions, ROUNDS)
    table: dict[str, dict[str, float]] = {}
    for name, result in times.items():
        contender, n = name.split("|")
        value = statistics.median(result) / samples[name] * 1e9
        table.setdefault(contender, {})[n] = value
    return table


def evaluation(source: pw.Aperture, count: int, precision: Any, engine: Any) -> Action:
    """Return a call of F at scattered frequencies."""
    nu = scattered(source, count)
    return lambda: pw.fourier(source, nu, precision=precision, engine=engine)


def first_calls() -> dict[str, list[float]]:
    """Return {n: [CPU seconds of the first call, of a later call, MiB added]} for 2^16 values."""
    results = {}
    for n in FIRST_CALLS if prepare().usable else []:
        with tempfile.TemporaryDirectory() as home:  # Dr.Jit stores compiled kernels there
            command = [sys.executable, __file__, "--first-call", str(n)]
            done = subprocess.run(
                command,
                env={**os.environ, "HOME": home},
                capture_output=True,
                text=True,
                check=True,
            )
            results[str(n)] = json.loads(done.stdout)
    return results


def first_call(n: int) -> list[float]:
    """Measure :func:`first_calls` after another polygon has loaded the library."""
    source = polygon("random", n) if n > 4 else polygon("regular", n)
    pw.fourier(pw.shapes.square(3.0), np.zeros((1, 2)), engine="llvm")
    action = evaluation(source, 1 << 16, "double", "llvm")
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    times = []
    for _ in range(4):
        start = time.process_time()
        action()
        times.append(time.process_time() - start)
    added = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before
    return [times[0], min(times[1:]), added / 1024]


def vertex_table(costs: dict[str, dict[str, float]], first: dict[str, list[float]]) -> str:
    """Return Markdown of nanoseconds per edge and value, and ratios to the triangle."""
    columns = [name for name in costs if name.endswith("regular")]
    lines = ["| vertices | " + " | ".join(f"{c.removesuffix(', regular')}" for c in columns) + " |"]
    lines.append("|---" * (len(columns) + 1) + "|")
    for n in map(str, VERTICES):
        cells = [
            f"{costs[c][n] / costs[c]['3']:.3g} ({costs[c][n] / int(n):.3g} ns)" for c in columns
        ]
        lines.append(f"| {n} | " + " | ".join(cells) + " |")
    lines.append("\nStars and random polygons against regular ones of as many vertices:\n")
    for contender, column in costs.items():
        if contender not in columns:
            regular = costs[contender.rsplit(",", 1)[0] + ", regular"]
            ratios = [value / regular[n] for n, value in column.items()]
            lines.append(f"- {contender}: {min(ratios):.2f} to {max(ratios):.2f}")
    if first:
        lines += [
            "\n| vertices | first call, CPU s | next calls, CPU s | memory added, MiB |",
            "|---" * 4 + "|",
        ]
        lines += [f"| {n} | {a:.3f} | {b:.3f} | {m:.0f} |" for n, (a, b, m) in first.items()]
    return "\n".join(lines)


def measured_here() -> dict[str, Any]:
    """Return the measurements that depend on the number of threads, in this process."""
    if prepare().usable:
        import drjit as dr

        dr.set_thread_count(threads())
    return {"vertices": vertex_costs()}


def measured(count: int) -> dict[str, Any]:
    """Return these measurements from a process with a number of threads."""
    names = [THREADS, "OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"]
    environment = {**os.environ, **dict.fromkeys(names, str(count))}
    command = [sys.executable, __file__, "--here"]
    done = subprocess.run(command, env=environment, stdout=subprocess.PIPE, text=True, check=True)
    result: dict[str, Any] = json.loads(done.stdout)
    return result


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--here", action="store_true", help=argparse.SUPPRESS)
    parser.add_argument("--first-call", type=int, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.first_call:
        print(json.dumps(first_call(options.first_call)))
        return
    if options.here:
        print(json.dumps(measured_here()))
        return
    report: dict[str, Any] = {name: version(name) for name in ("polywigner", "numpy", "drjit")}
    report |= {"python": platform.python_version(), "machine": platform.machine()}
    report["first calls"] = first_calls()
    counts = sorted({1, cores()})
    for count in counts:
        result = report[f"{count} threads"] = measured(count)
        first = report["first calls"] if count == counts[-1] else {}
        print(f"## Threads: {count}\n\n{vertex_table(result['vertices'], first)}\n")
    RESULTS.parent.mkdir(exist_ok=True)
    RESULTS.write_text(json.dumps(report, indent=1))


if __name__ == "__main__":
    main()
