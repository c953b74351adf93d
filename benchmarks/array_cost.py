"""What does a sample of W cost on an array of N elements, against one element, and how accurate is
it?

Rows: N = 1 to 1024 square patches, on a lattice with equal weights, with a separable taper and a
steering phase, or with any weights; and at random positions with the same density. Times are ratios
to one patch measured in turn, for arrays of the engine; errors are relative to the sum over all
pairs, in units of the energy. The array factor is compared with phased-array-modeling. Times are
CPU seconds.

    python benchmarks/array_cost.py [--samples 262144] [--threads 1]
"""

from __future__ import annotations

import argparse
import math
import statistics
import time
from collections.abc import Callable
from importlib import metadata
from typing import Any

import numpy as np

import polywigner as pw

PITCH = 1.4  # for patches of side 1
SIDES = (1, 2, 4, 8, 16, 32)
CHECKED = 24  # number of points with an error
REPEATS = 5


def arrays(side: int) -> dict[str, Any]:
    """Return arrays of side^2 patches by kind."""
    patch, rng = pw.shapes.square(1.0), np.random.default_rng(side)
    count = side * side
    if side == 1:
        return {"one patch": patch}
    places = pw.arrays.grid_positions(side, side, PITCH)
    taper = np.hanning(side + 2)[1:-1]
    steer = np.exp(2j * np.pi * 0.17 * np.arange(side))
    any_weights = rng.normal(size=count) + 1j * rng.normal(size=count)
    half = side * PITCH / 2
    return {
        "equal weights": pw.phased_array(patch, places),
        "taper and steering": pw.phased_array(
            patch, places, np.outer(taper * steer, taper).ravel()
        ),
        "any weights": pw.phased_array(patch, places, any_weights),
        "scattered": pw.phased_array(patch, rng.uniform(-half, half, (count, 2)), any_weights),
    }


def points(side: int, count: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(count)
    half = side * PITCH / 2
    return rng.uniform(-half, half, (count, 2)), rng.uniform(-2, 2, (count, 2))


def pair_sum(array: Any, x: np.ndarray, nu: np.ndarray) -> np.ndarray:
    """Return W as the sum over all pairs, each W of the patch at the midpoint."""
    element, places = array.repeated
    first, second = np.triu_indices(len(places))
    mean, apart = (places[first] + places[second]) / 2, places[first] - places[second]
    mutual = array.weights[first] * array.weights[second].conj()
    mutual = mutual * np.where(first == second, 1.0, 2.0)
    values = []
    for at, frequency in zip(x, nu, strict=True):
        near = np.flatnonzero((np.abs(at - mean) < 0.5).all(axis=1))
        phase = np.exp(-2j * np.pi * (apart[near] @ frequency))
        own = pw.wigner(element, at - mean[near], frequency) if len(near) else np.zeros(0)
        values.append(((mutual[near] * phase).real * own).sum())
    return np.array(values)


def error(array: Any, precision: str) -> float:
    """Return the largest error relative to the energy of the field."""
    if isinstance(array, pw.Aperture):
        return 0.0
    x, nu = points(math.isqrt(len(array)), CHECKED)
    energy = float((np.abs(array.weights) ** 2).sum())
    result = pw.wigner(array, x, nu, engine="auto", precision=precision)
    return float(np.abs(result - pair_sum(array, x, nu)).max()) / energy


def timed(call: Callable[[], None]) -> float:
    start = time.process_time()
    call()
    return time.process_time() - start


def engine_arrays(double: bool, side: int, samples: int) -> tuple[Any, Any]:
    import drjit
    import drjit.llvm as backend

    kind = backend.Array2f64 if double else backend.Array2f
    made = tuple(
        kind(*(np.ascontiguousarray(c) for c in values.T)) for values in points(side, samples)
    )
    drjit.eval(made)
    return made


def costs(double: bool, samples: int) -> list[tuple[str, int, float, float, float]]:
    """Return (kind, N, seconds of the first call, ns per sample, ratio to one patch)."""
    import drjit

    def call(source: Any, where: tuple[Any, Any]) -> Callable[[], None]:
        def run() -> None:
            drjit.eval(pw.wigner(source, *where))
            drjit.sync_thread()

        return run

    patch = call(pw.shapes.square(1.0), engine_arrays(double, 1, samples))
    patch()
    rows = []
    for side in SIDES:
        for kind, array in arrays(side).items():
            run = call(array, engine_arrays(double, side, samples))
            first = timed(run)
            pairs = [(timed(patch), timed(run)) for _ in range(REPEATS)]
            own = min(t for _, t in pairs) / samples * 1e9
            ratio = statistics.median(t / one for one, t in pairs)
            rows.append((kind, side * side, first, own, ratio))
    return rows


def tapered() -> dict[str, Any]:
    """Return rectangles with fields by name."""
    sides = (1.0, 0.8)
    taylor = pw.taylor_taper(*sides, 30, 4)
    fields = {
        "cosine": pw.cosine_taper(*sides),
        "taylor": taylor,
        "taylor, steered": taylor * pw.Illumination([1.0], [[3.25, 0.5]]),
    }
    uniform = pw.shapes.rectangle(*sides)
    return {name: uniform.with_illumination(field) for name, field in fields.items()}


def product_costs(double: bool, samples: int) -> None:
    """Print W and A of tapered rectangles against a uniform rectangle, measured in turn."""
    import drjit

    from polywigner.execution import ops_for
    from polywigner.kernels import tables_of
    from polywigner.kernels.functions import plane

    where = engine_arrays(double, 1, samples)
    few = engine_arrays(double, 1, max(1, samples >> 4))
    ops = ops_for(type(where[0].x))

    def run(call: Callable[[Any, Any], Any], at: tuple[Any, Any]) -> Callable[[], None]:
        def both() -> None:
            drjit.eval(call(*at))
            drjit.sync_thread()

        both()
        return both

    def ns(call: Callable[[], None], at: tuple[Any, Any]) -> float:
        return min(timed(call) for _ in range(REPEATS)) / len(at[0].x) * 1e9

    uniform = pw.shapes.rectangle(1.0, 0.8)
    print(
        "| function | field | waves | ns a sample | against uniform | by pairs, against uniform |"
    )
    print("|---|---|---|---|---|---|")
    for name, function in (("wigner", pw.wigner), ("ambiguity", pw.ambiguity)):
        kernel = {"wigner": plane.WIGNER, "ambiguity": plane.AMBIGUITY}[name]
        base = run(lambda x, nu, f=function: f(uniform, x, nu), where)
        for field, source in tapered().items():
            own = ns(run(lambda x, nu, f=function, s=source: f(s, x, nu), where), where)
            tables = tables_of(source, double)
            pairs = run(lambda x, nu, k=kernel, t=tables: k(ops, t, *x, *nu), few)
            plain = ns(base, where)
            by_pairs = ns(pairs, few)
            print(
                f"| {name} | {field} | {len(source.illumination)} | {own:.1f} | "
                f"{own / plain:.1f} | {by_pairs / plain:.0f} |"
            )


def peer_factor(samples: int) -> None:
    """Print the array factor in random directions, compared with phased-array-modeling."""
    try:
        import phased_array
    except ImportError:
        print("\nphased-array-modeling is not installed: no comparison of array factors")
        return
    print(
        f"\n## Array factor, {samples} directions, phased-array-modeling "
        f"{metadata.version('phased-array-modeling')}\n"
    )
    print("| N | polywigner ms | peer ms | peer/polywigner | largest difference / N |")
    print("|---|---|---|---|---|")
    rng = np.random.default_rng(0)
    theta, phi = np.arccos(rng.random(samples)), 2 * np.pi * rng.random(samples)
    nu = np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi)], axis=-1)
    for side in (4, 8, 16, 32):
        places = pw.arrays.grid_positions(side, side, 0.5)
        x, y = (np.ascontiguousarray(c) for c in places.T)
        weights = np.exp(-2j * np.pi * (places @ [0.3, 0.1]))
        results: dict[str, Any] = {}

        def ours(places: Any = places, weights: Any = weights, results: Any = results) -> None:
            results["ours"] = pw.array_factor(places, weights, nu)

        def theirs(x: Any = x, y: Any = y, weights: Any = weights, results: Any = results) -> None:
            results["peer"] = phased_array.array_factor_vectorized(
                theta, phi, x, y, weights, 2 * np.pi
            )

        ours()
        theirs()
        pairs = [(timed(ours), timed(theirs)) for _ in range(REPEATS)]
        own, peer = (min(column) * 1e3 for column in zip(*pairs, strict=True))
        ratio = statistics.median(t / o for o, t in pairs)
        # The peer's factor has exp(+i k.r), so the direction is opposite.
        gap = np.abs(pw.array_factor(places, weights, -nu) - results["peer"]).max() / side**2
        print(f"| {side**2} | {own:.2f} | {peer:.1f} | {ratio:.0f} | {gap:.1e} |")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--samples", type=int, default=1 << 18)
    parser.add_argument("--threads", type=int, default=1)
    options = parser.parse_args()
    from polywigner import llvm

    llvm.require()
    import drjit

    drjit.set_thread_count(options.threads)
    for double in (False, True):
        precision = "double" if double else "single"
        print(f"\n## W of N patches, {precision} precision, {options.threads} thread(s)\n")
        print("| kind | N | first call s | ns a sample | against one patch | error / energy |")
        print("|---|---|---|---|---|---|")
        rows = costs(double, options.samples)
        for (kind, count, first, own, ratio), array in zip(
            rows, (a for side in SIDES for a in arrays(side).values()), strict=True
        ):
            wrong = error(array, precision)
            print(f"| {kind} | {count} | {first:.2f} | {own:.1f} | {ratio:.1f} | {wrong:.0e} |")
        print(f"\n## Fields on one rectangle, {precision} precision\n")
        product_costs(double, options.samples)
    peer_factor(1 << 14)


if __name__ == "__main__":
    main()
