"""How fast are large tables written, within what memory, and do killed runs end bit-identical?

Run ``python benchmarks/large_tables.py`` (two minutes); ``--gib 16 --volume 512`` asks for a table
of 16 GiB and a volume of 512^3 points. Each question is answered in processes of its own, whose
peak memory the system tells:

- rate: a table in memory against ``pw.wigner`` at the same points, given one by one.
- large: a table of so many GiB, written to disk; some values are compared with ``pw.wigner``, and
  then it is deleted.
- volume: the irradiance of a square in a volume, exact (Rayleigh-Sommerfeld I), written to disk.
- killed: a table whose run is killed (SIGKILL) at ten random moments and taken up each time.
- cluster: the same on two processes of dask.distributed, of which one is killed at the half.

The last two compare the hashes of all chunks with those of an unbroken run. Prints a Markdown table
and writes ``benchmarks/results/large_tables.json``.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import platform
import resource
import shutil
import signal
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np

import polywigner as pw

RESULTS = Path(__file__).parent / "results" / "large_tables.json"
CHEVRON = pw.shapes.chevron(20e-3, 12e-3, 4e-3)
# Of float32 sums (docs/accuracy).
TOLERANCE = 5e-6 * CHEVRON.area
KILLS = 10
# The table that is killed: 1 GiB in 256 chunks.
SIDE, CHUNKS = 128, {"x": 32, "y": 32, "nu_x": 32, "nu_y": 32}


def axes(side: int) -> tuple[np.ndarray, ...]:
    """Positions over the chevron, and frequencies of the 94 GHz band."""
    x, nu = np.linspace(-1.0, 1.0, side), np.linspace(-314.0, 314.0, side)
    return 10e-3 * x, 6e-3 + 6e-3 * x, nu, nu


def write(out: Path, side: int, **options: Any) -> Any:
    return pw.wigner_table(CHEVRON, *axes(side), out, engine="llvm", **options)


# --- in processes of their own


def measured(part: str, *arguments: str) -> dict[str, Any]:
    """What a part of this file prints, in a process of its own."""
    command = [sys.executable, __file__, "--part", part, *arguments]
    return dict(json.loads(subprocess.run(command, check=True, stdout=subprocess.PIPE).stdout))


def peak_gib() -> float:
    """The most memory that this process has held."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 / 2**30


def rate() -> dict[str, float]:
    """Millions of samples per second, of the table and of points one by one, in turns."""
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
    """Seconds and peak memory of writing a table of side^4 samples, and its largest error."""
    out = folder / "large.zarr"
    start, busy = time.perf_counter(), time.process_time()
    table = write(out, side)
    wall, cpu = time.perf_counter() - start, time.process_time() - busy
    index = np.random.default_rng(0).integers(0, side, (4, 20))
    found = [float(table["W"][tuple(i)]) for i in index.T.tolist()]
    x, y, nu_x, nu_y = (axis[i] for axis, i in zip(axes(side), index, strict=True))
    exact = pw.wigner(CHEVRON, np.stack([x, y], axis=-1), np.stack([nu_x, nu_y], axis=-1))
    return {
        "GiB": side**4 * 4 / 2**30,
        "seconds": wall,
        "CPU seconds": cpu,
        "M samples/s": side**4 / wall / 1e6,
        "peak memory, GiB": peak_gib(),
        "largest error/area": float(np.abs(found - exact).max() / CHEVRON.area),
    }


def volume(folder: Path, side: int) -> dict[str, float]:
    """Seconds and peak memory of a volume of side^3 points, and its largest error."""
    square, wavelength = pw.shapes.square(10e-3), 3.189e-3
    box = ((-0.05, -0.05, 0.01), (0.05, 0.05, 0.11))
    start, busy = time.perf_counter(), time.process_time()
    found = pw.volume(
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
    (name,) = found.data_vars
    values = [float(found[name][tuple(i)]) for i in index]
    points = [[float(found[d][k]) for d, k in zip("xyz", i, strict=True)] for i in index]
    exact = np.abs(pw.amplitude(square, points, wavelength)) ** 2
    return {
        "GiB": side**3 * 4 / 2**30,
        "seconds": wall,
        "CPU seconds": cpu,
        "peak memory, GiB": peak_gib(),
        "largest error": float(np.abs(values - exact).max()),
    }


def once(folder: Path, side: int) -> dict[str, float]:
    """One run of the table that is killed."""
    start = time.perf_counter()
    write(folder / "killed.zarr", side, chunks=CHUNKS)
    return {"seconds": time.perf_counter() - start}


PARTS = {"rate": lambda *_: rate(), "large": large, "volume": volume, "once": once}


# --- of whole runs


def hashes(store: Path) -> dict[str, str]:
    """Of all files of a store but its metadata."""
    files = sorted(f for f in store.rglob("*") if f.is_file() and f.name != "zarr.json")

    def one(file: Path) -> str:
        return hashlib.sha256(file.read_bytes()).hexdigest()

    with ThreadPoolExecutor() as pool:
        return dict(
            zip((str(f.relative_to(store)) for f in files), pool.map(one, files), strict=True)
        )


def finished(store: Path) -> int:
    return sum(1 for file in store.rglob("W/c/*/*/*/*") if file.suffix != ".partial")


def killed(folder: Path, unbroken: dict[str, str]) -> dict[str, Any]:
    """SIGKILL some milliseconds after random chunks, the first perhaps before any."""
    store, rng = folder / "killed.zarr", np.random.default_rng()
    command = [sys.executable, __file__, "--part", "once", str(folder), str(SIDE)]
    seen = []
    for chunk in sorted(rng.integers(0, (SIDE // 32) ** 4 - 5, KILLS).tolist()):
        process = subprocess.Popen(command, stdout=subprocess.DEVNULL)
        while finished(store) < chunk:
            time.sleep(0.001)
        time.sleep(rng.uniform(0.0, 0.05))
        process.send_signal(signal.SIGKILL)
        process.wait()
        seen.append(finished(store))
    left = sum(1 for _ in store.rglob("*.partial"))
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    return {
        "chunks": sum(1 for name in unbroken if name.startswith("W/")),
        "there after each kill": seen,
        "half written after the last": left,
        "identical": hashes(store) == unbroken,
    }


def on_cluster(folder: Path, unbroken: dict[str, str]) -> dict[str, Any]:
    """Two processes; one is killed when half of the chunks are there."""
    from distributed import LocalCluster

    store, half = folder / "cluster.zarr", SIDE**4 // (2 * 32**4)
    seen: list[int] = []
    with LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster:
        victim = cluster.workers[0].pid

        def kill() -> None:
            while finished(store) < half:
                time.sleep(0.01)
            os.kill(victim, signal.SIGKILL)
            seen.append(finished(store))

        killer = threading.Thread(target=kill, daemon=True)
        killer.start()
        start = time.perf_counter()
        write(store, SIDE, chunks=CHUNKS, scheduler=cluster.scheduler_address)
        wall = time.perf_counter() - start
        killer.join(1.0)
    return {
        "seconds": wall,
        "there when one worker died": seen,
        "identical": hashes(store) == unbroken,
    }


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
        results["unbroken"] = measured("once", str(folder), str(SIDE))
        unbroken = hashes(folder / "killed.zarr")
        shutil.rmtree(folder / "killed.zarr")
        results["killed"] = killed(folder, unbroken)
        results["cluster"] = on_cluster(folder, unbroken)
    finally:
        shutil.rmtree(folder)
    print("\n".join(lines(results)))
    RESULTS.parent.mkdir(exist_ok=True)
    about = {"machine": platform.machine(), "cores": os.cpu_count(), "results": results}
    RESULTS.write_text(json.dumps(about, indent=2) + "\n")


if __name__ == "__main__":
    main()
