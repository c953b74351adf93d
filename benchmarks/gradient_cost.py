"""How many times slower than W is its gradient in reverse mode?

Run ``python benchmarks/gradient_cost.py``. W at random positions in the automean and random
frequencies, and its gradient in positions and frequencies, in vertices, and in all of them, in
turns in one process, in CPU seconds; the median of the ratios of the rounds. The outline is data,
as in an optimisation. Prints a Markdown table and writes
``benchmarks/results/gradient_cost.json``.
"""

from __future__ import annotations

import json
import platform
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

import polywigner as pw
from polywigner.llvm import prepare

RESULTS = Path(__file__).parent / "results" / "gradient_cost.json"
SHAPES = {"square": pw.shapes.square(1.0), "chevron": pw.shapes.chevron(2.0, 1.1, 0.6)}
SAMPLES, ROUNDS, CYCLES = 1 << 22, 7, 10.0
WANTED = {"points": (True, False), "vertices": (False, True), "all": (True, True)}


def _seconds(task: Callable[[], None]) -> float:
    start = time.process_time()
    task()
    return time.process_time() - start


def _tasks(source: pw.Aperture, double: bool) -> list[Callable[[], None]]:
    """Return calls of the value, and of the gradients of ``WANTED``."""
    import drjit as dr
    import drjit.llvm.ad as backend

    kind = backend.Array2f64 if double else backend.Array2f
    rng = np.random.default_rng(0)
    low, high = np.reshape(source.bounds, (2, 2))
    reach = CYCLES / source.diameter / np.sqrt(2)
    x = kind(rng.uniform(low, high, (SAMPLES, 2)).T.copy())
    nu = kind(rng.uniform(-reach, reach, (SAMPLES, 2)).T.copy())
    dr.eval(x, nu)  # unpack once for all tasks
    corners = np.concatenate(source.rings).T.tolist()

    def value() -> None:
        dr.eval(pw.wigner(pw.differentiable(source, vertices=kind(*corners)), x, nu))
        dr.sync_thread()

    def gradient(points: bool, outline: bool) -> Callable[[], None]:
        def task() -> None:
            arrays = [kind(x), kind(nu), kind(*corners)]
            for array, wanted in zip(arrays, (points, points, outline), strict=True):
                if wanted:
                    dr.enable_grad(array)
            traced = pw.differentiable(source, vertices=arrays[2])
            dr.backward(pw.wigner(traced, *arrays[:2]))
            dr.eval([dr.grad(array) for array in arrays if dr.grad_enabled(array)])
            dr.sync_thread()

        return task

    return [value, *(gradient(*wanted) for wanted in WANTED.values())]


def measured(name: str, double: bool) -> dict[str, Any]:
    """Return a row of the table."""
    tasks = _tasks(SHAPES[name], double)
    for task in tasks:
        task()
    rounds = np.array([[_seconds(task) for task in tasks] for _ in range(ROUNDS)])
    ratios = np.median(rounds[:, 1:] / rounds[:, :1], axis=0)
    return {
        "shape": name,
        "precision": "double" if double else "single",
        "million samples per CPU second": float(SAMPLES / np.median(rounds[:, 0]) / 1e6),
        **dict(zip(WANTED, map(float, ratios), strict=True)),
    }


def main() -> None:
    prepare()
    rows = [measured(name, double) for name in SHAPES for double in (False, True)]
    print("| shape | precision | W, M/s | points | vertices | all |")
    print("|---|---|---|---|---|---|")
    for row in rows:
        figures = " | ".join(f"{row[key]:.1f}" for key in WANTED)
        rate = row["million samples per CPU second"]
        print(f"| {row['shape']} | {row['precision']} | {rate:.0f} | {figures} |")
    RESULTS.parent.mkdir(exist_ok=True)
    RESULTS.write_text(json.dumps({"machine": platform.machine(), "rows": rows}, indent=1) + "\n")


if __name__ == "__main__":
    main()
