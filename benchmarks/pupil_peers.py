"""How accurate is the far field of a hexagonal pupil from rasters, and what does it cost?

    pip install prysm poppy hcipy
    python benchmarks/pupil_peers.py

|F| on 256 x 256 frequencies up to 32 cycles per diameter, of a flat wave and of a wave with 0.2
waves rms of coma and 0.1 of astigmatism: the closed form or the rule on triangles, and the matrix
Fourier transforms of three packages for telescopes, each with its raster of the hexagon (hcipy with
and without supersampled edges). Errors are the largest of |F| relative to the area; times are the
least CPU time of three runs, including the raster. Missing packages are omitted. The last lines
contain time and nodes of our rule for larger aberrations.
"""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable
from typing import Any

import numpy as np

import polywigner as pw
from polywigner.transforms.aberrated_pupils import AberratedPupil

REACH, COUNT = 32.0, 256
WIDTH = 1.0625  # of the raster in diameters
AXIS = (np.arange(COUNT) - COUNT // 2) * (2 * REACH / COUNT)
HEXAGON = pw.shapes.regular_polygon(6, 0.5)
PIXELS = (256, 1024, 2048)

Wave = Callable[[Any, Any], Any]
"""exp(2 pi i W/lambda) at x, y in diameters."""
Transform = Callable[[int, Wave], Any]

COMA = pw.zernike({8: 0.2, 6: 0.1}, 0.5)  # at a wavelength of 1
FOCUS_AND_COMA = pw.zernike({4: 5.0 / (2 * np.sqrt(3)), 8: 0.5}, 0.5)  # five waves at the edge


def flat(x: Any, y: Any) -> Any:
    return 1.0 + 0.0j


def aberrated(x: Any, y: Any) -> Any:
    return np.exp(2j * np.pi * COMA(x, y))


def with_prysm(pixels: int, wave: Wave) -> Any:
    from prysm.coordinates import make_xy_grid
    from prysm.fttools import mdft
    from prysm.geometry import regular_polygon

    x, y = make_xy_grid(pixels, diameter=WIDTH)
    mask = regular_polygon(6, 0.5, x, y, rotation=30)
    step = AXIS[1] - AXIS[0]
    field = mdft.dft2(mask * wave(x, y), Q=1 / (WIDTH * step), samples=COUNT)
    return field * (WIDTH / pixels) ** 2 / (WIDTH / pixels * step)


def with_poppy(pixels: int, wave: Wave) -> Any:
    import astropy.units as u
    import poppy

    hexagon = poppy.NgonAperture(nsides=6, radius=0.5 * u.m)
    light = poppy.Wavefront(npix=pixels, diam=WIDTH * u.m, wavelength=1e-6)
    y, x = light.coordinates()
    # The transform has the opposite sign, so the pupil, which is symmetric, is rotated by 180
    # degrees.
    mask = hexagon.get_transmission(light) * wave(-x, -y)
    field = poppy.matrixDFT.matrix_dft(mask, 2 * REACH * WIDTH, COUNT, centering="FFTSTYLE")
    return field * (WIDTH / pixels) ** 2 / (WIDTH / pixels * (AXIS[1] - AXIS[0]))


def with_hcipy(pixels: int, wave: Wave, finer: int = 1) -> Any:
    import hcipy

    grid = hcipy.make_pupil_grid(pixels, WIDTH)
    hexagon = hcipy.make_regular_polygon_aperture(6, 1.0, angle=np.pi / 6)
    steps, lowest = [2 * np.pi * (AXIS[1] - AXIS[0])] * 2, [2 * np.pi * AXIS[0]] * 2
    wanted = hcipy.CartesianGrid(hcipy.RegularCoords(steps, [COUNT] * 2, lowest))
    mask = hcipy.evaluate_supersampled(hexagon, grid, finer) * wave(grid.x, grid.y)
    field = hcipy.MatrixFourierTransform(grid, wanted).forward(mask + 0j)
    return np.asarray(field).reshape(COUNT, COUNT)


PEERS: dict[str, Transform] = {
    "prysm": with_prysm,
    "poppy": with_poppy,
    "hcipy": with_hcipy,
    "hcipy, 8 x 8 subpixels": lambda pixels, wave: with_hcipy(pixels, wave, 8),
}


def timed(work: Callable[[], Any]) -> tuple[Any, float]:
    """Return a result, and the least CPU time of three runs in ms."""
    times = []
    for _ in range(3):
        start = time.process_time()
        result = work()
        times.append(time.process_time() - start)
    return result, min(times) * 1e3


def spectrum(aberration: pw.Aberration, tolerance: float) -> Any:
    """Return |F| of the hexagon, from the spot of a lens of 1 m at a wavelength of 1 m."""
    nu = np.stack(np.meshgrid(AXIS, AXIS), axis=-1)
    spot = pw.psf(HEXAGON, nu, 1.0, 1.0, aberration=aberration, tolerance=tolerance)
    return np.sqrt(spot * HEXAGON.area)


def compared(title: str, ours: Callable[[], Any], exact: Any, wave: Wave) -> None:
    """Print the table of a wave."""
    result, cost = timed(ours)
    error = np.abs(result - exact).max() / HEXAGON.area
    print(f"\n{title}\n\n| | pixels | ms | ratio | error/area |\n|---|--:|--:|--:|--:|")
    print(f"| polywigner, NumPy | none | {cost:.1f} | 1 | {error:.0e} |")
    for name, transform in PEERS.items():
        for pixels in PIXELS:
            if "subpixels" in name and pixels > 1024:
                continue
            try:
                field, taken = timed(lambda run=transform, n=pixels: run(n, wave))
            except ImportError as missing:
                print(f"| {name} | not installed: {missing.name} |")
                break
            error = np.abs(np.abs(field) - exact).max() / HEXAGON.area
            print(f"| {name} | {pixels} | {taken:.0f} | {taken / cost:.1f} | {error:.0e} |")


def nodes_of(aberration: pw.Aberration) -> int:
    """Return the number of nodes of the larger rule for the spectrum."""
    pupil = AberratedPupil.of(HEXAGON, aberration, 1.0, 0.0)
    band = np.full(2, AXIS[0]), np.full(2, AXIS[-1])
    return sum(weights.size for _, weights in pupil.rules(0, band, 4, 1e-10))


def main() -> None:
    nu = np.stack(np.meshgrid(AXIS, AXIS), axis=-1)
    flat_one = np.abs(pw.fourier(HEXAGON, nu, engine="numpy"))
    compared(
        "flat wave; our own error: docs/accuracy.md",
        lambda: np.abs(pw.fourier(HEXAGON, nu, engine="numpy")), flat_one, flat,
    )  # fmt: skip
    exact = spectrum(COMA, 1e-13)
    compared("coma and astigmatism", lambda: spectrum(COMA, 1e-10), exact, aberrated)
    for title, path in (("coma and astigmatism", COMA), ("five waves of defocus, 0.5 of coma",
                                                         FOCUS_AND_COMA)):  # fmt: skip
        _, cost = timed(lambda path=path: spectrum(path, 1e-10))
        print(f"\n{title}: {nodes_of(path)} nodes, {cost:.0f} ms for {COUNT} x {COUNT} values")


if __name__ == "__main__":
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        main()
