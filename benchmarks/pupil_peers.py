"""How exact is the far field of a hexagonal pupil from rasters, and what does it cost?

    pip install prysm poppy hcipy
    python benchmarks/pupil_peers.py

|F| on 256 x 256 frequencies up to 32 cycles per diameter: the closed form, and the matrix Fourier
transforms of three packages for telescopes, each on its own raster of the hexagon (hcipy with and
without supersampled edges). Errors are the largest of |F|, relative to the area; times are CPU time
of raster and transform, the least of three. Packages that are not there are left out.
"""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable
from typing import Any

import numpy as np

import polywigner as pw

REACH, COUNT = 32.0, 256
WIDTH = 1.0625  # of the raster, in diameters
AXIS = (np.arange(COUNT) - COUNT // 2) * (2 * REACH / COUNT)
HEXAGON = pw.shapes.regular_polygon(6, 0.5)
PIXELS = (256, 1024, 2048)

Transform = Callable[[int], Any]


def with_prysm(pixels: int) -> Any:
    from prysm.coordinates import make_xy_grid
    from prysm.fttools import mdft
    from prysm.geometry import regular_polygon

    x, y = make_xy_grid(pixels, diameter=WIDTH)
    mask = regular_polygon(6, 0.5, x, y, rotation=30).astype(complex)
    step = AXIS[1] - AXIS[0]
    field = mdft.dft2(mask, Q=1 / (WIDTH * step), samples=COUNT)
    return field / np.abs(field).max() * mask.real.sum() * (WIDTH / pixels) ** 2


def with_poppy(pixels: int) -> Any:
    import astropy.units as u
    import poppy

    hexagon = poppy.NgonAperture(nsides=6, radius=0.5 * u.m)
    wave = poppy.Wavefront(npix=pixels, diam=WIDTH * u.m, wavelength=1e-6)
    mask = hexagon.get_transmission(wave).astype(complex)
    field = poppy.matrixDFT.matrix_dft(mask, 2 * REACH * WIDTH, COUNT, centering="FFTSTYLE")
    return field / np.abs(field).max() * mask.real.sum() * (WIDTH / pixels) ** 2


def with_hcipy(pixels: int, finer: int = 1) -> Any:
    import hcipy

    grid = hcipy.make_pupil_grid(pixels, WIDTH)
    hexagon = hcipy.make_regular_polygon_aperture(6, 1.0, angle=np.pi / 6)
    steps, lowest = [2 * np.pi * (AXIS[1] - AXIS[0])] * 2, [2 * np.pi * AXIS[0]] * 2
    wanted = hcipy.CartesianGrid(hcipy.RegularCoords(steps, [COUNT] * 2, lowest))
    mask = hcipy.evaluate_supersampled(hexagon, grid, finer)
    field = hcipy.MatrixFourierTransform(grid, wanted).forward(mask + 0j)
    return np.asarray(field).reshape(COUNT, COUNT)


PEERS: dict[str, Transform] = {
    "prysm": with_prysm,
    "poppy": with_poppy,
    "hcipy": with_hcipy,
    "hcipy, 8 x 8 subpixels": lambda pixels: with_hcipy(pixels, 8),
}


def timed(work: Callable[[], Any]) -> tuple[Any, float]:
    """What it returns, and the least CPU time of three, ms."""
    times = []
    for _ in range(3):
        start = time.process_time()
        result = work()
        times.append(time.process_time() - start)
    return result, min(times) * 1e3


def main() -> None:
    nu = np.stack(np.meshgrid(AXIS, AXIS), axis=-1)
    exact, ours = timed(lambda: np.abs(pw.fourier(HEXAGON, nu, engine="numpy")))
    print("| | pixels | ms | ratio | error/area |\n|---|--:|--:|--:|--:|")
    print(f"| polywigner, NumPy | none | {ours:.1f} | 1 | see docs/accuracy.md |")
    for name, transform in PEERS.items():
        for pixels in PIXELS:
            if "subpixels" in name and pixels > 1024:
                continue
            try:
                field, taken = timed(lambda run=transform, n=pixels: run(n))
            except ImportError as missing:
                print(f"| {name} | not installed: {missing.name} |")
                break
            error = np.abs(np.abs(field) - exact).max() / HEXAGON.area
            print(f"| {name} | {pixels} | {taken:.0f} | {taken / ours:.0f} | {error:.0e} |")


if __name__ == "__main__":
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        main()
