"""Question: what do exact fields on a plane cost, against a package that convolves rasters?

Run ``python benchmarks/near_field_peer.py``; the peer is diffractio (``pip install diffractio``),
whose Rayleigh-Sommerfeld fields are products of FFTs. A plane of 256 x 256 points, wide enough to
see the source at 45 degrees from its edge, at 5, 20 and 100 wavelengths of 94 GHz from the 10 mm
square, and from two chevrons of 20 mm. Both have to be right within 0.1 dB wherever the field is
above -40 dB of its peak on the plane. The peer gets the coarsest raster of a list that is, with
pixels weighted by how much of them is open and aligned with the square, and the faster of its two
ways: one window over source and plane, or tiles as large as the source. Each run is a process of
its own: the best wall time of three, the CPU time of it, and by how much the peak of memory rose.
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import resource
import subprocess
import sys
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import shapely

import polywigner as pw

__all__ = ["HEIGHTS", "SOURCES"]

WAVELENGTH = 299792458 / 94e9
HEIGHTS = (5, 20, 100)
POINTS = 256
DECIBEL, FLOOR = 0.1, -40.0
# Of the incident amplitude: 0.1 dB are a hundredth of the field at the floor; less far away.
TOLERANCE = 1e-4
# Pixels for a side of 10 mm; 3.1 wavelengths.
RASTERS = (24, 32, 48, 64, 96)
# Of one window; padded to twice its width, 0.8 GB for each array of complex numbers.
MOST_PIXELS = 3500


def _chevrons() -> pw.Aperture:
    one = pw.shapes.chevron(20e-3, 12e-3, 4e-3)
    return pw.Aperture([*one.moved((0, 9e-3)).rings, *one.moved((0, -9e-3)).rings])


SOURCES = {"square": pw.shapes.square(10e-3), "chevrons": _chevrons()}


def _half_width(height: float) -> float:
    return (height + 5.0) * WAVELENGTH


def _points(height: float) -> np.ndarray:
    x = np.linspace(-1, 1, POINTS) * _half_width(height)
    return np.stack(np.meshgrid(x, x, [height * WAVELENGTH]), axis=-1).reshape(-1, 3)


def ours(source: str, height: float, options: dict[str, Any]) -> Callable[[], Any]:
    """What computes the plane."""
    points = _points(height)
    return lambda: pw.amplitude(SOURCES[source], points, WAVELENGTH, tolerance=TOLERANCE, **options)


class Raster:
    """The peer's field: a window of pixels around the source, and its plane as tiles."""

    def __init__(self, source: str, height: float, pixels: int, tiled: bool) -> None:
        from diffractio.scalar_fields_XY import Scalar_field_XY

        self.height, pitch = height * WAVELENGTH, 10e-3 / pixels
        aperture = SOURCES[source]
        reach = max(abs(v) for v in aperture.bounds)
        half = reach if tiled else _half_width(height)
        count = 2 * int(np.ceil(half / pitch - 1e-9))
        self.x = (np.arange(count) - (count - 1) / 2) * pitch
        self.tiles = int(np.ceil(2 * _half_width(height) / (self.x[-1] - self.x[0])))
        self.tiles = self.tiles if tiled else 1
        self.field = Scalar_field_XY(x=self.x, y=self.x, wavelength=WAVELENGTH)
        self.field.u = _coverage(aperture, self.x, pitch)

    def __call__(self) -> Any:
        return self.field.RS(self.height, amplification=(self.tiles, self.tiles), matrix=True)

    def coordinates(self) -> np.ndarray:
        """Of the pixels of the plane, along either axis."""
        width = self.x[-1] - self.x[0]
        starts = (np.arange(self.tiles) - self.tiles / 2) * width
        return (starts[:, None] + (self.x - self.x[0])).ravel()


def _coverage(aperture: pw.Aperture, x: np.ndarray, pitch: float) -> np.ndarray:
    low, high = x - pitch / 2, x + pitch / 2
    share = np.zeros((len(x), len(x)), complex)
    near = np.flatnonzero(np.abs(x) < max(abs(v) for v in aperture.bounds) + pitch)
    i, j = np.meshgrid(near, near, indexing="ij")
    boxes = shapely.box(low[j], low[i], high[j], high[i])
    shapely.prepare(aperture.polygons)
    share[i, j] = shapely.area(shapely.intersection(boxes, aperture.polygons)) / pitch**2
    return share


def _miss(raster: Raster, source: str) -> float:
    """The largest error in dB of some thousand pixels above the floor."""
    field, x = raster(), raster.coordinates()
    inside = np.flatnonzero(np.abs(x) <= raster.height + 5 * WAVELENGTH)
    rows = np.random.default_rng(0).choice(inside, 400)
    columns = np.random.default_rng(1).choice(inside, 400)
    rows = np.concatenate([rows, np.full(200, np.abs(x).argmin()), rows[:200]])
    columns = np.concatenate([columns, columns[:200], rows[:200]])
    points = np.column_stack([x[columns], x[rows], np.full(len(rows), raster.height)])
    exact = np.abs(pw.amplitude(SOURCES[source], points, WAVELENGTH))
    level = 20 * np.log10(exact / np.abs(field).max())
    found = np.abs(field[rows, columns])[level > FLOOR]
    return float(np.abs(20 * np.log10(found / exact[level > FLOOR])).max())


def _memory() -> float:
    """The peak so far, in MiB."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def _measured(run: Callable[[], Any]) -> dict[str, float]:
    before = _memory()
    times = []
    for _ in range(3):
        wall, cpu = time.perf_counter(), time.process_time()
        run()
        times.append((time.perf_counter() - wall, time.process_time() - cpu))
    wall, cpu = min(times)
    return {"first": times[0][0], "wall": wall, "cpu": cpu, "memory": _memory() - before}


def _child(task: dict[str, Any]) -> dict[str, float]:
    """What one process does."""
    if task["who"] == "ours":
        return _measured(ours(task["source"], task["height"], task["options"]))
    raster = Raster(task["source"], task["height"], task["pixels"], task["tiled"])
    if task["who"] == "miss":
        return {"miss": _miss(raster, task["source"])}
    return _measured(raster)


def _run(**task: Any) -> dict[str, float]:
    command = [sys.executable, __file__, "--task", json.dumps(task)]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    return dict(json.loads(done.stdout.splitlines()[-1]))


def _peer(source: str, height: float, tiled: bool) -> tuple[int, float, dict[str, float]] | None:
    """Pixels for 10 mm, error and cost of the coarsest raster that will do."""
    for pixels in RASTERS:
        if not tiled and 2 * _half_width(height) * pixels / 10e-3 > MOST_PIXELS:
            return None
        task = {"source": source, "height": height, "pixels": pixels, "tiled": tiled}
        miss = _run(who="miss", **task)["miss"]
        if miss <= DECIBEL:
            return pixels, miss, _run(who="peer", **task)
    return None


def _line(*cells: Any) -> None:
    print("|", " | ".join(str(cell) for cell in cells), "|", flush=True)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--task", help=argparse.SUPPRESS)
    parser.add_argument("--heights", type=float, nargs="+", default=HEIGHTS)
    arguments = parser.parse_args()
    if arguments.task:
        print(json.dumps(_child(json.loads(arguments.task))))
        return
    with_peer = importlib.util.find_spec("diffractio") is not None
    if not with_peer:
        print("The peer is not installed (pip install diffractio): polywigner alone.")
    _line("source", "z", "who", "pixels/10 mm", "dB", "first s", "s", "CPU s", "MiB")
    _line(*["---"] * 9)
    for source in SOURCES:
        for height in arguments.heights:
            for name, options in (
                ("polywigner", {}),
                ("polywigner, single", {"precision": "single"}),
                ("polywigner, NumPy", {"engine": "numpy"}),
            ):
                cost = _run(who="ours", source=source, height=height, options=options)
                _line(source, height, name, "-", "-", *_cells(cost))
            for tiled in (False, True) if with_peer else ():
                name = f"diffractio, {'tiles' if tiled else 'one window'}"
                found = _peer(source, height, tiled)
                if found is None:
                    _line(source, height, name, "none will do", *"-----")
                else:
                    pixels, miss, cost = found
                    _line(source, height, name, pixels, f"{miss:.3f}", *_cells(cost))


def _cells(cost: dict[str, float]) -> list[str]:
    return [*(f"{cost[k]:.3g}" for k in ("first", "wall", "cpu")), f"{cost['memory']:.0f}"]


if __name__ == "__main__":
    main()
