"""How many values of W does one core compute per second, against shapely and NumPy?

Run ``python benchmarks/wigner_samples_per_second.py``. The peer clips the lag slice with shapely
and sums its edges with NumPy, sample by sample, the way one would write it without this package;
a second peer does the same for whole arrays at once. Everything is measured in turns in this one
process, pinned to one core, in CPU seconds (a busy machine slows all alike), and the median of the
rounds is reported. Positions lie in the automean, where W is not zero. Prints a Markdown table and
writes ``benchmarks/results/wigner_samples_per_second.json``.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import statistics
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import shapely

import polywigner as pw
from polywigner.engines.llvm import prepare

RESULTS = Path(__file__).parent / "results" / "wigner_samples_per_second.json"
CHEVRON = np.array([[0, 0], [1, 0.5], [2, 0], [2, 0.6], [1, 1.1], [0, 0.6]])
SHAPES = {
    "square": [np.array([[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]])],
    "chevron": [CHEVRON],
    "two chevrons": [CHEVRON, CHEVRON + np.array([0, 1.7])],
}
TARGETS = {"square": 15_000, "chevron": 8_000, "two chevrons": 4_000}  # ratio in float32
CYCLES = 10.0  # |nu| times the diameter, at most
SAMPLES = {"engine": 1 << 22, "numpy": 1 << 18, "batch": 1 << 13, "loop": 1 << 10}


def points(source: pw.Aperture, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Positions in the automean and frequencies in a disc."""
    rng = np.random.default_rng(0)
    low, high = np.reshape(source.bounds, (2, 2))
    support = pw.automean(source).polygons
    shapely.prepare(support)
    x = low + (high - low) * rng.random((1 << 16, 2))
    x = x[shapely.contains_xy(support, *x.T)]  # drawn once, used as often as needed
    angle, radius = 2 * np.pi * rng.random(count), np.sqrt(rng.random(count))
    size = CYCLES / source.diameter * radius
    nu = size[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
    return np.resize(x, (count, 2)), nu


def edge_sum(rings: np.ndarray, which: np.ndarray, nu: np.ndarray, count: int) -> np.ndarray:
    """Stokes edge sum of oriented rings; ring k belongs to sample which[k]."""
    corner, ring = shapely.get_coordinates(rings, return_index=True)
    same = ring[1:] == ring[:-1]
    start, end, sample = corner[:-1][same], corner[1:][same], which[ring[:-1][same]]
    edge, middle, nu = end - start, (start + end) / 2, nu[sample]
    along = nu[:, 0] * edge[:, 1] - nu[:, 1] * edge[:, 0]
    across = (nu * edge).sum(axis=1)
    phase = 2 * np.pi * (nu * middle).sum(axis=1)
    term = along * np.sinc(across) * np.sin(phase) / (2 * np.pi * (nu**2).sum(axis=1))
    return np.bincount(sample, weights=term, minlength=count)


def by_shapely(polygons: Any, x: np.ndarray, nu: np.ndarray) -> np.ndarray:
    """W of all samples at once."""
    parts = shapely.get_parts(polygons)
    coordinates, index = shapely.get_coordinates(parts, return_index=True)
    sizes = np.bincount(index)
    forward = 2 * (coordinates - x[:, None])
    copies = []
    for points_of_copy in (forward, -forward):
        pieces = np.split(points_of_copy, np.cumsum(sizes)[:-1], axis=1)
        polygon = np.stack([shapely.polygons(p) for p in pieces], axis=1)
        copies.append(shapely.multipolygons(polygon) if len(sizes) > 1 else polygon[:, 0])
    pieces, which = shapely.get_parts(shapely.intersection(*copies), return_index=True)
    keep = shapely.get_type_id(pieces) == 3  # touching in a point or a line has no area
    pieces, which = shapely.orient_polygons(pieces[keep]), which[keep]
    rings, piece = shapely.get_rings(pieces, return_index=True)
    return edge_sum(rings, which[piece], nu, len(x))


def by_shapely_one_by_one(polygons: Any, x: np.ndarray, nu: np.ndarray) -> np.ndarray:
    """W sample by sample, as a renderer or an integrator asks for it."""
    return np.array([one_by_shapely(polygons, p, q) for p, q in zip(x, nu, strict=True)])


def one_by_shapely(polygons: Any, x: np.ndarray, nu: np.ndarray) -> float:
    """W of one sample."""
    forward = shapely.transform(polygons, lambda c: 2 * (c - x))
    mirrored = shapely.transform(polygons, lambda c: 2 * (x - c))
    total = 0.0
    for piece in shapely.get_parts(shapely.intersection(forward, mirrored)):
        if piece.geom_type != "Polygon":
            continue
        for ring in shapely.get_rings(shapely.orient_polygons(piece)):
            corner = shapely.get_coordinates(ring)
            edge, middle = np.diff(corner, axis=0), (corner[1:] + corner[:-1]) / 2
            along = nu[0] * edge[:, 1] - nu[1] * edge[:, 0]
            total += float((along * np.sinc(edge @ nu)) @ np.sin(2 * np.pi * middle @ nu))
    return total / (2 * np.pi * float(nu @ nu))


def seconds(action: Callable[[], Any]) -> float:
    """CPU time of one call."""
    start = time.process_time()
    action()
    return time.process_time() - start


def in_engine(source: pw.Aperture, precision: str, count: int) -> Callable[[], Any]:
    """W with the arrays staying in the engine."""
    import drjit as dr
    import drjit.llvm as backend

    vector = backend.Array2f if precision == "single" else backend.Array2f64
    x, nu = (vector(*p.T.copy()) for p in points(source, count))
    dr.eval(x, nu)
    dr.sync_thread()

    def action() -> None:
        dr.eval(pw.wigner(source, x, nu))
        dr.sync_thread()

    return action


def contenders(source: pw.Aperture) -> dict[str, tuple[Callable[[], Any], int]]:
    """Name -> (action, samples per call)."""
    polygons = shapely.orient_polygons(source.polygons)
    if len(polygons.geoms) == 1:
        polygons = polygons.geoms[0]
    found: dict[str, tuple[Callable[[], Any], int]] = {}
    x, nu = points(source, SAMPLES["loop"])
    found["shapely, sample by sample"] = lambda: by_shapely_one_by_one(polygons, x, nu), len(x)
    many_x, many_nu = points(source, SAMPLES["batch"])
    found["shapely, arrays"] = lambda: by_shapely(polygons, many_x, many_nu), len(many_x)
    arrays = points(source, SAMPLES["numpy"])
    for precision in ("single", "double"):

        def through(engine: str, precision: str = precision) -> Callable[[], Any]:
            return lambda: pw.wigner(source, *arrays, precision=precision, engine=engine)

        found[f"numpy, {precision}"] = through("numpy"), SAMPLES["numpy"]
        if prepare().usable:
            count = SAMPLES["engine"]
            found[f"llvm, {precision}"] = in_engine(source, precision, count), count
            found[f"llvm from and to NumPy, {precision}"] = through("llvm"), SAMPLES["numpy"]
    return found


def check(source: pw.Aperture) -> None:
    """The peers compute the same thing."""
    polygons, (x, nu) = source.polygons, points(source, 64)
    expected = pw.wigner(source, x, nu, engine="numpy")
    for peer in (by_shapely, by_shapely_one_by_one):
        assert np.abs(peer(polygons, x, nu) - expected).max() < 1e-10 * source.area


def first_call(rings: list[np.ndarray], precision: str) -> float:
    """Seconds for the first thousand values of an aperture never seen before."""
    fresh = 1 + 1e-3 * np.random.default_rng().random()  # no cache on disk knows it
    source = pw.Aperture([ring * fresh for ring in rings])
    x, nu = points(source, 1000)
    return seconds(lambda: pw.wigner(source, x, nu, precision=precision, engine="llvm"))


def measure(rings: list[np.ndarray], rounds: int) -> dict[str, float]:
    """Samples per second of every contender, in turns; and first-call latencies."""
    source = pw.Aperture(rings)
    check(source)
    actions = contenders(source)
    times: dict[str, list[float]] = {name: [] for name in actions}
    for action, _ in actions.values():
        action()
    for _ in range(rounds):
        for name, (action, _) in actions.items():
            times[name].append(seconds(action))
    rates = {name: count / statistics.median(times[name]) for name, (_, count) in actions.items()}
    if prepare().usable:
        for precision in ("single", "double"):
            rates[f"first call, seconds, {precision}"] = first_call(rings, precision)
    return rates


def one_core() -> None:
    """Pin this process, and Dr.Jit's pool, to one core."""
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})
    if prepare().usable:
        import drjit as dr

        dr.set_thread_count(1)


def processor() -> str:
    """The processor's name."""
    info = Path("/proc/cpuinfo")
    lines = info.read_text().splitlines() if info.exists() else []
    names = [line.split(":")[1].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor()


def table(results: dict[str, dict[str, float]]) -> str:
    """Markdown: million samples per second, and ratios to the first peer."""
    lines = ["| shape | contender | M samples/s | ratio | target |", "|---|---|---|---|---|"]
    for shape, rates in results.items():
        peer = rates["shapely, sample by sample"]
        for name, rate in rates.items():
            if name.startswith("first call"):
                lines.append(f"| {shape} | {name} | {rate:.3f} s | | |")
                continue
            target = f"{TARGETS[shape]:,}" if name == "llvm, single" else ""
            lines.append(f"| {shape} | {name} | {rate / 1e6:.4g} | {rate / peer:,.0f} | {target} |")
    return "\n".join(lines)


def main() -> None:
    """Measure, print, write."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=7, help="rounds, of which the median counts")
    rounds = parser.parse_args().rounds
    one_core()
    results = {name: measure(rings, rounds) for name, rings in SHAPES.items()}
    report = {"processor": processor(), "python": platform.python_version(), "rates": results}
    report |= {"numpy": np.__version__, "shapely": shapely.__version__, "rounds": rounds}
    RESULTS.parent.mkdir(exist_ok=True)
    RESULTS.write_text(json.dumps(report, indent=1))
    print(f"One core of {report['processor']}\n\n{table(results)}")


if __name__ == "__main__":
    main()
