"""Have values or rates of public calls changed between two versions?

    python benchmarks/golden.py --write FILE            record values
    python benchmarks/golden.py --compare FILE          largest difference of each case
    python benchmarks/golden.py --rates OTHER/src       seconds per call, both versions in turn

Differences are relative to the largest recorded value of a case. Rates are processor seconds of the
second and later calls in processes that take turns, so they can be compared on a shared machine.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import subprocess
import sys
import time
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

import polywigner as pw

LAM = 3.19e-3
RNG = np.random.default_rng(7)
X2 = RNG.uniform(-4e-3, 4e-3, (48, 2))
NU2 = RNG.uniform(-300.0, 300.0, (48, 2))
XI2 = RNG.uniform(-6e-3, 6e-3, (48, 2))
MANY_X, MANY_NU = RNG.uniform(-4e-3, 4e-3, (20_000, 2)), RNG.uniform(-300, 300, (20_000, 2))
FAR = np.column_stack([RNG.uniform(-0.05, 0.05, (24, 2)), RNG.uniform(0.02, 0.4, 24)])
ANGLES = np.radians(np.arange(-80.0, 81.0, 10.0))


@cache
def sources() -> dict[str, Any]:
    """Return one source of each kind."""
    shapes, chevron = pw.shapes, pw.shapes.chevron(8e-3, 10e-3, 3e-3)
    square = shapes.square(10e-3)
    patch = shapes.rectangle(1.2e-3, 1.5e-3)
    lattice = pw.arrays.grid_positions(4, 3, 1.6e-3)
    return {
        "square": square,
        "chevron": chevron,
        "pair": shapes.chevron_pair(20e-3, 12e-3, 4e-3),
        "ring": shapes.ring(10e-3, 6e-3, n=24),
        "disc": shapes.disc(5e-3, 64),
        "steered": chevron.with_illumination(pw.steering((0.3, 0.2, math.sqrt(0.87)), LAM)),
        "cosine": square.with_illumination(pw.cosine_taper(10e-3, 10e-3)),
        "horn mouth": shapes.rectangle(12e-3, 9e-3).with_illumination(pw.te_mode(12e-3, 9e-3)),
        "lattice": pw.phased_array(patch, lattice),
        "curved": chevron.curved(0.06, LAM),
        "partially coherent": chevron.partially_coherent(4e-3),
    }


def _source(name: str) -> Any:
    return sources()[name]


def cases() -> dict[str, Callable[[], Any]]:
    """Return calls by name; each returns numbers."""
    result: dict[str, Callable[[], Any]] = {}
    for name in sources():
        result[f"wigner, {name}"] = lambda s=name: pw.wigner(_source(s), X2, NU2)
        result[f"ambiguity, {name}"] = lambda s=name: pw.ambiguity(_source(s), NU2, XI2)
        result[f"autocorrelation, {name}"] = lambda s=name: pw.autocorrelation(_source(s), X2, XI2)
        result[f"position marginal, {name}"] = lambda s=name: pw.position_marginal(_source(s), X2)
        if name != "partially coherent":
            result[f"fourier, {name}"] = lambda s=name: pw.fourier(_source(s), NU2)
    for name in ("square", "chevron", "disc", "lattice"):
        result[f"wigner of 20,000 points, {name}"] = lambda s=name: pw.wigner(
            _source(s), MANY_X, MANY_NU
        )
    for name in ("chevron", "cosine", "steered", "lattice"):
        for method in ("rayleigh-sommerfeld-1", "rayleigh-sommerfeld-2", "kirchhoff", "fresnel"):
            result[f"amplitude by {method}, {name}"] = lambda s=name, m=method: pw.amplitude(
                _source(s), FAR, LAM, method=m
            )
        result[f"amplitude, far, {name}"] = lambda s=name: pw.amplitude(
            _source(s), FAR, LAM, method="fraunhofer"
        )
        result[f"irradiance by rays, {name}"] = lambda s=name: pw.irradiance(
            _source(s), FAR[:6], LAM, tolerance=1e-3, method="wigner"
        )
        result[f"pattern, {name}"] = lambda s=name: pw.radiation_pattern(
            _source(s), LAM, ANGLES, [0.0, 0.7]
        )["directivity"]
        result[f"radiated power, {name}"] = lambda s=name: pw.radiated_power(_source(s), LAM)
    chevron, square, facing = _source("chevron"), _source("square"), np.diag([-1.0, 1, -1, 1])
    facing[:3, 3] = 0.01, 0.02, 0.5
    corners = np.array([[x, y, z] for x in (0, 0.05) for y in (0, 0.03) for z in (0, 0.02)])
    sides = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    body = pw.Polyhedron(corners, sides)
    lens = pw.FirstOrder.free_space(0.05) @ pw.FirstOrder.lens(0.05)
    result |= {
        "coupling": lambda: pw.coupling(chevron, square, facing, LAM),
        "coupling of a lattice": lambda: pw.coupling(_source("lattice"), square, facing, LAM),
        "radiance": lambda: pw.radiance(chevron, X2, [0.1, 0.2, math.sqrt(0.95)], LAM),
        "flux vector": lambda: pw.flux_vector(chevron, X2[:8], LAM),
        "otf": lambda: pw.otf(chevron, XI2, 0.4),
        "psf": lambda: pw.psf(chevron, X2 * 1e-2, 550e-9, 0.1, 0.3),
        "wigner through a lens": lambda: pw.wigner(chevron, X2, NU2, through=lens, wavelength=LAM),
        "field through a lens": lambda: pw.amplitude(chevron, X2, LAM, through=lens),
        "rcs of a plate": lambda: pw.rcs_pattern(square, LAM, ANGLES, [0.0, 0.3])["rcs"],
        "lag marginal": lambda: pw.lag_marginal(chevron, XI2),
        "slits": lambda: pw.wigner(
            pw.Slits([[-2e-3, -1e-3], [0.5e-3, 2e-3]]), X2[:, :1], NU2[:, :1]
        ),
        "behind a screen": lambda: pw.amplitude(
            pw.Screen(square, pw.PointSource((1e-3, 2e-3, -0.1))), FAR, LAM
        ),
        "shadow of a plate": lambda: pw.amplitude(
            pw.PointSource((0.0, 0.0, -0.1)), FAR, LAM, obstacles=square.placed(np.eye(4))
        ),
        "rcs of a box": lambda: pw.rcs_pattern(body, LAM, ANGLES, [0.0, 0.3])["rcs"],
        "fourier of a box": lambda: pw.fourier(body, np.column_stack([NU2, NU2[:, 0]])),
        "shadow of a box": lambda: pw.amplitude(
            pw.PointSource((0.0, 0.0, -0.1)), FAR, LAM, obstacles=body
        ),
        "rays": lambda: pw.sample_rays(chevron, LAM, 64)["weight"],
    }
    return result


def _numbers(value: Any) -> list[list[float]]:
    array = np.atleast_1d(np.asarray(value)).ravel()
    array = array[:: max(1, len(array) // 64)]
    return [array.real.astype(float).tolist(), array.imag.astype(float).tolist()]


def write(path: str) -> None:
    """Record the values of all cases in a JSON file."""
    result = {}
    for name, call in cases().items():
        try:
            result[name] = _numbers(call())
        except Exception as error:
            print(f"{name}: {type(error).__name__}: {error}")
    Path(path).write_text(json.dumps(result), encoding="utf-8")
    print(f"{len(result)} cases")


def compare(path: str) -> int:
    """Print the cases whose values differ, and return the number of those above 1e-9."""
    recorded = json.loads(Path(path).read_text(encoding="utf-8"))
    calls, bad = cases(), 0
    for name, values in recorded.items():
        if name not in calls:
            print(f"{name}: gone")
            continue
        old, new = (np.array(v[0]) + 1j * np.array(v[1]) for v in (values, _numbers(calls[name]())))
        scale = np.nanmax(np.abs(old)) or 1.0
        off = np.inf if old.shape != new.shape else float(np.nanmax(np.abs(new - old)) / scale)
        bad += off > 1e-9
        if off > 1e-13:
            print(f"{name}: {off:.1e}")
    print(f"{len(recorded)} cases, {bad} differ by more than 1e-9")
    return bad


def _seconds() -> None:
    """Print the processor seconds of each case, called again and again in this process."""
    result = {}
    for name, call in cases().items():
        call()
        spent: list[float] = []
        while len(spent) < 3 or (sum(spent) < 0.2 and len(spent) < 50):
            start = time.process_time()
            call()
            spent.append(time.process_time() - start)
        result[name] = min(spent)
    print(json.dumps(result))


def rates(other: str, rounds: int = 2) -> None:
    """Print the ratio of seconds of this version to those of another version, for each case."""
    own = str(Path(pw.__file__).parents[1])
    best: dict[str, dict[str, float]] = {own: {}, other: {}}
    for _ in range(rounds):
        for source in (other, own):
            environment = os.environ | {"PYTHONPATH": source}
            command = [sys.executable, __file__, "--seconds"]
            output = subprocess.run(
                command, env=environment, capture_output=True, text=True, check=True
            ).stdout
            for name, spent in json.loads(output).items():
                best[source][name] = min(spent, best[source].get(name, math.inf))
    ratios = {
        name: best[own][name] / best[other][name] for name in best[own] if name in best[other]
    }
    for name, ratio in sorted(ratios.items(), key=lambda item: item[1]):
        print(f"{ratio:6.2f}  {1e3 * best[own][name]:9.3f} ms  {name}")
    mean = math.exp(sum(map(math.log, ratios.values())) / len(ratios))
    print(f"geometric mean of {len(ratios)} ratios: {mean:.3f}; worst {max(ratios.values()):.2f}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--write", metavar="FILE")
    parser.add_argument("--compare", metavar="FILE")
    parser.add_argument("--rates", metavar="SRC")
    parser.add_argument("--seconds", action="store_true")
    chosen = parser.parse_args()
    if chosen.write:
        write(chosen.write)
    if chosen.compare:
        sys.exit(compare(chosen.compare) > 0)
    if chosen.rates:
        rates(chosen.rates)
    if chosen.seconds:
        _seconds()


if __name__ == "__main__":
    main()
