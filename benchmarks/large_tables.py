"""How fast are large tables and volumes written, and with how much memory?

Run ``python benchmarks/large_tables.py`` (two minutes); ``--gib 16 --volume 512`` writes a table of
16 GiB and a volume of 512^3 points. Each part runs in a separate process, whose peak memory the
system reports:

- rate: a table in memory against ``pw.wigner`` at a list of the same points.
- large: a table of a size in GiB, written to disk; some values are compared with ``pw.wigner``.
- volume: the irradiance of a square in a volume, exact (Rayleigh-Sommerfeld I), written to disk.

Prints a Markdown table and writes ``benchmarks/results/large_tables.json``.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import resource
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

import polywigner as pw

RESULTS = Path(__file__).parent / "results" / "large_tables.json"
CHEVRON = pw.shapes.chevron(20e-3, 12e-3, 4e-3)
# Rounding of float32 sums (docs/accuracy).
TOLERANCE = 5e-6 * CHEVRON.area


def axes(side: int) -> tuple[np.ndarray, ...]:
    """Return positions over the chevron, and frequencies of the 94 GHz band."""
    x, nu = np.linspace(-1.0, 1.0, side), np.linspace(-314.0, 314.0, side)
    return 10e-3 * x, 6e-3 + 6e-3 * x, nu, nu


def write(out: Path, side: int) -> Any:
    return pw.wigner_table(CHEVRON, *axes(side), out, engine="llvm")


def measured(part: str, *arguments: str) -> dict[str, Any]:
    """Return the output of a part of this file in a separate process."""
    command = [sys.executable, __file__, "--part", part, *arguments]
    return dict(json.loads(subprocess.run(command, check=True, stdout=subprocess.PIPE).stdout))


def peak_gib() -> float:
    """Return the peak memory of this process in GiB."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 / 2**30


def rate() -> dict[str, float]:
    """Return millions of samples per second of the table and of listed points, in turns."""
    side = 64
    x, y, nu_x, nu_y = axes(side)
    grid = np.meshgrid(x, y, nu_x, nu_y, indexing="ij")
    position, frequency = np.stack(grid[:2], axis=-1), np.stack(grid[2:], axis=-1)

    def table() -> Any:
        return pw.wigner_table(CHEVRON, x, y, nu_x, nu_y, engine="llvm")["W"].values

    def points() -> Any:
        return pw.wigner(CHEVRON, position, frequency, precision="single", engine="llvm")

    assert np.abs(table() - points()).max() < TOLERANCE
    wall: dict[str, list[float]] = {"table": [], "points": []}
    cpu: dict[str, list[float]] = {"table": [], "points": []}
    for _ in range(7):
        for action in (table, points):
            start, busy = time.perf_counter(), time.process_time()
            action()
            wall[action.__name__].append(time.perf_counter() - start)
            cpu[action.__name__].append(time.process_time() - busy)
    count = side**4 / 1e6
    return {
        **{f"{name}, M samples/s": count / statistics.median(t) for name, t in wall.items()},
        **{f"{name}, M samples/CPU s": count / statistics.median(t) for name, t in cpu.items()},
    }


def large(folder: Path, side: int) -> dict[str, float]:
    """Return seconds and peak memory of a table of side^4 samples, and its largest error."""
    out = folder / "large.zarr"
    start, busy = time.perf_counter(), time.process_time()
    table = write(out, side)
    wall, cpu = time.perf_counter() - start, time.process_time() - busy
    index = np.random.default_rng(0).integers(0, side, (4, 20))
    result = [float(table["W"][tuple(i)]) for i in index.T.tolist()]
    x, y, nu_x, nu_y = (axis[i] for axis, i in zip(axes(side), index, strict=True))
    exact = pw.wigner(CHEVRON, np.stack([x, y], axis=-1), np.stack([nu_x, nu_y], axis=-1))
    return {
        "GiB": side**4 * 4 / 2**30,
        "seconds": wall,
        "CPU seconds": cpu,
        "M samples/s": side**4 / wall / 1e6,
        "peak memory, GiB": peak_gib(),
        "largest error/area": float(np.abs(result - exact).max() / CHEVRON.area),
    }


def volume(folder: Path, side: int) -> dict[str, float]:
    """Return seconds and peak memory of a volume of side^3 points, and its largest error."""
    square, wavelength = pw.shapes.square(10e-3), 3.189e-3
    box = ((-0.05, -0.05, 0.01), (0.05, 0.05, 0.11))
    start, busy = time.perf_counter(), time.process_time()
    result = pw.volume(
        square,
        box,
        (side, side, side),
        wavelength,
        method="rayleigh-sommerfeld-1",
        tolerance=1e-4,
        precision="single",
        engine="llvm",
        out=folder / "volume.zarr",
    )
    wall, cpu = time.perf_counter() - start, time.process_time() - busy
    index = np.random.default_rng(0).integers(0, side, (20, 3)).tolist()
    (name,) = result.data_vars
    values = [float(result[name][tuple(i)]) for i in index]
    points = [[float(result[d][k]) for d, k in zip("xyz", i, strict=True)] for i in index]
    exact = np.abs(pw.amplitude(square, points, wavelength)) ** 2
    return {
        "GiB": side**3 * 4 / 2**30,
        "seconds": wall,
        "CPU seconds": cpu,
        "peak memory, GiB": peak_gib(),
        "largest error": float(np.abs(values - exact).max()),
    }


PARTS = {"rate": lambda *_: rate(), "large": large, "volume": volume}


def lines(results: dict[str, dict[str, Any]]) -> Iterator[str]:
    yield "| | | |"
    yield "|---|---|---|"
    for part, values in results.items():
        for name, value in values.items():
            shown = f"{value:.3g}" if isinstance(value, float) else value
            yield f"| {part} | {name} | {shown} |"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--gib", type=float, default=1.0, help="size of the large table")
    parser.add_argument("--volume", type=int, default=128, help="points along a volume's side")
    parser.add_argument("--folder", type=Path, help="where to write (default: a temporary folder)")
    parser.add_argument("--part", choices=PARTS, help=argparse.SUPPRESS)
    parser.add_argument("rest", nargs="*", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.part:
        folder, side = (*options.rest, ".", "0")[:2]
        print(json.dumps(PARTS[options.part](Path(folder), int(side))))
        return
    folder = Path(tempfile.mkdtemp(dir=options.folder))
    results: dict[str, dict[str, Any]] = {}
    try:
        results["rate"] = measured("rate")
        side = round((options.gib * 2**30 / 4) ** 0.25)
        results["large"] = measured("large", str(folder), str(side))
        shutil.rmtree(folder / "large.zarr")
        results["volume"] = measured("volume", str(folder), str(options.volume))
    finally:
        shutil.rmtree(folder)
    print("\n".join(lines(results)))
    RESULTS.parent.mkdir(exist_ok=True)
    about = {"machine": platform.machine(), "cores": os.cpu_count(), "results": results}
    RESULTS.write_text(json.dumps(about, indent=2) + "\n")


if __name__ == "__main__":
    main()
