"""What do exact fields cost at optical wavelengths, and how accurate are they?

Run ``python benchmarks/exact_fields.py``; takes five minutes and 6 GB. A wave along z at 550 nm is
incident on a star of 1 mm. Each method computes a plane of 2 mm: polywigner at 400 x 400 points, an
FFT (angular spectrum) on a raster of 4 or 16 mm, whichever has the smaller error. Pixels at the
edges are weighted by their open fraction.

Prints a Markdown table: processor seconds, for polywigner of the second of two calls (the first
compiles), for the FFT without the raster; and the largest error at 20 points, relative to the
incident amplitude, against integrals along the edges with 25 digits
(``tests/oracles/edge_integrals.py``).
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import numpy as np
import shapely

import polywigner as pw

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from oracles import edge_integrals

WAVELENGTH, RADIUS = 550e-9, 0.5e-3
STAR = pw.shapes.star(5, RADIUS, 0.4 * RADIUS)
ZONES = (5, 200)
HALF, WINDOWS = 2 * RADIUS, (8 * RADIUS, 32 * RADIUS)
POINTS, PIXELS, CHECKED = 400, (2048, 8192), 20
METHOD_OF_FFT = "rayleigh-sommerfeld-1"
ROWS = 256  # number of raster rows per block

Array = np.ndarray


def seconds(call: Callable[[], Array]) -> tuple[Array, float]:
    """Return the result of a call, and its processor seconds."""
    start = time.process_time()
    field = call()
    return field, time.process_time() - start


def plane_of(x: Array, z: float) -> Array:
    """Return points (n, n, 3) with y along the first axis."""
    return np.stack(np.meshgrid(x, x, [z]), axis=-1)[:, :, 0]


def centres(count: int, window: float) -> Array:
    """Return the centres of the pixels of a raster along one side."""
    return (np.arange(count) - (count - 1) / 2) * (window / count)


def raster(count: int, window: float) -> Array:
    """Return the open fraction of each pixel."""
    x, pitch = centres(count, window), window / count
    open_ = np.zeros((count, count), np.complex128)
    shapely.prepare(STAR.polygons)
    near = np.flatnonzero(np.abs(x) < RADIUS + pitch)
    for rows in np.array_split(near, max(1, len(near) // ROWS)):
        inside = shapely.contains_xy(STAR.polygons, x[None, near], x[rows, None])
        open_[np.ix_(rows, near)] = inside
    along = shapely.get_coordinates(shapely.segmentize(STAR.polygons, pitch / 8))
    crossed = np.unique(np.round((along - x[0]) / pitch).astype(np.intp), axis=0)
    left, low = (x[crossed] - pitch / 2).T
    boxes = shapely.box(left, low, left + pitch, low + pitch)
    shared = shapely.area(shapely.intersection(boxes, STAR.polygons)) / pitch**2
    open_[crossed[:, 1], crossed[:, 0]] = shared
    return open_


def angular_spectrum(open_: Array, window: float, z: float) -> Array:
    """Return the field on the raster at a distance, in the memory of two rasters."""
    count = len(open_)
    waves = np.fft.fftfreq(count, window / count) * WAVELENGTH
    spectrum = np.fft.fft2(open_)
    for low in range(0, count, ROWS):
        rows = slice(low, low + ROWS)
        cosine = np.sqrt(1 - waves[rows, None] ** 2 - waves**2 + 0j)
        spectrum[rows] *= np.exp(2j * np.pi * z / WAVELENGTH * cosine)
    return np.fft.ifft2(spectrum)


def miss(field: Array, x: Array, z: float, method: str) -> float:
    """Return the largest error at some points of a plane around the star."""
    rng = np.random.default_rng(7)
    inner = np.flatnonzero(np.abs(x) <= HALF)
    errors = []
    for i, j in inner[rng.integers(len(inner), size=(CHECKED, 2))]:
        point = (x[j], x[i], z)
        if method == "fresnel":
            exact = edge_integrals.parabolic_field(STAR.rings, point, WAVELENGTH)
        else:
            fields = edge_integrals.fields(STAR.rings, point, WAVELENGTH, (0.0, 0.0))
            exact = fields[edge_integrals.METHODS.index(method)]
        errors.append(abs(field[i, j] - exact))
    return max(errors)


def rows() -> Iterator[tuple[str, ...]]:
    distances = [RADIUS**2 / (zones * WAVELENGTH) for zones in ZONES]
    x = np.linspace(-HALF, HALF, POINTS)
    for method in ("rayleigh-sommerfeld-1", "kirchhoff", "fresnel"):
        numbers = []
        for z in distances:
            plane = plane_of(x, z)
            pw.amplitude(STAR, plane, WAVELENGTH, method)
            field, used = seconds(partial(pw.amplitude, STAR, plane, WAVELENGTH, method))
            numbers += [f"{used:.2f}", f"{miss(field, x, z, method):.0e}"]
        yield f"`{method}`", f"{POINTS}²", *numbers
    for count in PIXELS:
        best = [(np.inf, 0.0)] * len(distances)
        for window in WINDOWS:
            open_, centre = raster(count, window), centres(count, window)
            for k, z in enumerate(distances):
                call = partial(angular_spectrum, open_, window, z)
                field, used = seconds(call)
                best[k] = min(best[k], (miss(field, centre, z, METHOD_OF_FFT), used))
        numbers = [text for error, used in best for text in (f"{used:.2f}", f"{error:.0e}")]
        yield "FFT, angular spectrum", f"{count}²", *numbers


def main() -> None:
    columns = ["method", "points"]
    for zones in ZONES:
        columns += [f"{zones} Fresnel zones: s", "error"]
    print("|", " | ".join(columns), "|")
    print("|---|" + "--:|" * (len(columns) - 1))
    for row in rows():
        print("|", " | ".join(row), "|", flush=True)


if __name__ == "__main__":
    main()
