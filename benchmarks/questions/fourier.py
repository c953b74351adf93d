"""What does the Fourier transform on a grid cost, and how accurate is it?

finufft transforms Gauss points on quadrilaterals that tile the aperture, with the smallest number
of points, and then the loosest tolerance, for an error below 1e-12 of the area.
"""

from __future__ import annotations

from importlib.util import find_spec
from typing import Any

import numpy as np

import polywigner as pw
from benchmarks.lines import Line, absent, as_times, line_of
from benchmarks.peers import fourier as peers
from benchmarks.timing import Action, Effort, cores, in_turns

__all__ = ["CASES", "QUESTION", "THREADS", "axis_of", "grid_of", "measure"]

QUESTION = "Fourier transform on a grid of 256 x 256"
PUPILS = {
    "square": lambda: pw.shapes.square(1.0),
    "18 hexagons": lambda: pw.shapes.hexagonal_segments(1.0, gap=0.02),
}
RANGES = (8, 32, 64)  # largest |nu_x| D
CASES = [f"{pupil}, nu D = {largest}" for pupil in PUPILS for largest in RANGES]
THREADS = (1,)
SIDE, SIDE_QUICK = 256, 64
COXETER, FINUFFT, PLANNED = "coxeter", "finufft", "finufft, points set"
EDGE_SUM, SINGLE = "edge sum in NumPy", "our float32"


def axis_of(source: pw.Aperture, largest: float, side: int) -> np.ndarray:
    """Return evenly spaced frequencies with an exact spacing, as in finufft."""
    step = 2 * largest / source.diameter / side
    return step * np.arange(-side // 2, side // 2)


def grid_of(axis: np.ndarray) -> np.ndarray:
    return np.stack(np.meshgrid(axis, axis, indexing="ij"), axis=-1)


def measure(case: str, threads: int | None, effort: Effort) -> list[Line]:
    """Measure all contenders on one grid, from and to NumPy, in double precision."""
    pupil, largest = case.split(", nu D = ")
    source, count = PUPILS[pupil](), threads or cores()
    side = SIDE_QUICK if effort.quick else SIDE
    axis = axis_of(source, float(largest), side)
    nu = grid_of(axis)
    # Listed points use another formula, which is checked with 40 digits below.
    reference = pw.fourier(source, nu.reshape(-1, 2), engine="numpy").reshape(nu.shape[:-1])
    doubt = reference_error(source, nu, reference, effort.checked)
    actions: dict[str, Action] = {
        "ours": lambda: pw.fourier(source, nu),
        SINGLE: lambda: pw.fourier(source, nu, precision="single"),
        EDGE_SUM: lambda: peers.by_edge_sum(source, nu),
    }
    missing, notes = {}, {}
    if find_spec("finufft"):
        order, eps = peers.tuned(source, axis, reference, count)
        plan, strengths = peers.finufft_plan(source, axis, order, eps, count)
        actions[FINUFFT] = lambda: peers.by_finufft(source, axis, order, eps, count)
        actions[PLANNED] = lambda: plan.execute(strengths)
        notes[FINUFFT] = f"{len(strengths)} points, tolerance {eps:g}"
    else:
        missing[FINUFFT] = "not installed (pip install finufft)"
    if find_spec("coxeter"):
        actions[COXETER] = lambda: peers.by_coxeter(source, nu)
    else:
        missing[COXETER] = "not installed (pip install coxeter)"
    times = in_turns(actions, effort.rounds, count)

    def entry(name: str) -> tuple[Any, list[float], float]:
        error = float(np.abs(actions[name]() - reference).max() / source.area)
        return as_times(times[name], 1e3, max(error, doubt)), times[name], 1.0

    ours = entry("ours")
    labels = {"question": "fourier", "case": case, "precision": "double", "threads": count}
    labels |= {"unit": "ms", "error_unit": "of the area"}
    result = [name for name in actions if name != "ours"]
    lines = [line_of(labels, name, ours, entry(name), note=notes.get(name, "")) for name in result]
    return lines + [absent(labels, name, why, ours[0]) for name, why in missing.items()]


def reference_error(
    source: pw.Aperture, nu: np.ndarray, reference: np.ndarray, count: int
) -> float:
    """Return the error of the reference against 40 digits, or 0 without mpmath."""
    if not find_spec("mpmath"):
        return 0.0
    rng, side = np.random.default_rng(0), len(reference)
    some = [tuple(p) for p in rng.integers(0, side, (count, 2))] + [(side // 2 + 1, side // 2)]
    errors = [abs(reference[p] - peers.exact_value(source, nu[p])) for p in some]
    return float(max(errors) / source.area)
