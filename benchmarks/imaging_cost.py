"""What do transmission cross coefficients cost compared with Abbe's sum by FFTs?

Run ``python benchmarks/imaging_cost.py``; takes a minute. Two lines in an L, with a period of 6 um,
under a condenser of 0.6 pupils at 550 nm, NA 0.25. Abbe's sum: the mask as pixels (open fractions),
a lattice of points on the condenser, and a transform of the image for each point. Errors are the
largest on 32 x 32 points against the closed form, relative to the maximum. Processor seconds of one
thread, of the second of two runs.
"""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
import shapely
from numpy.typing import NDArray

import polywigner as pw

WAVELENGTH, DISTANCE, PERIOD = 550e-9, 10e-3, 6e-6
POINTS, ORDERS = 32, 64
PUPIL, CONDENSER = pw.shapes.disc(2.5e-3, 48), pw.shapes.disc(1.5e-3, 48)
ARMS = (-1e-6, -1e-6, -0.5e-6, 1e-6), (-1e-6, -1e-6, 1e-6, -0.5e-6)
MASK = shapely.union_all([shapely.box(*arm) for arm in ARMS])
Values = NDArray[np.float64]


def seconds(make: Callable[[], Values]) -> tuple[Values, float]:
    """Return a result, and the processor seconds of its second computation."""
    make()
    start = time.process_time()
    result = make()
    return result, time.process_time() - start


def closed() -> Values:
    """Return the image by transmission cross coefficients on POINTS x POINTS points of a period."""
    along = PERIOD * (np.arange(POINTS) / POINTS - 0.5)
    points = np.stack(np.meshgrid(along, along), axis=-1)
    return np.asarray(
        pw.partially_coherent_image(
            pw.Aperture([MASK]), (PERIOD, PERIOD), PUPIL, CONDENSER, points,
            wavelength=WAVELENGTH, distance=DISTANCE,
        )
    )  # fmt: skip


def abbe(pixels: int, places: int) -> Values:
    """Return Abbe's sum over a lattice of points on the condenser's bounds, by FFTs of ORDERS^2."""
    edges = PERIOD * (np.arange(pixels + 1) / pixels - 0.5) - PERIOD / (2 * pixels)
    low, high = edges[:-1], edges[1:]
    cells = shapely.box(*np.meshgrid(low, low), *np.meshgrid(high, high))
    share = shapely.area(shapely.intersection(cells, MASK)) / (PERIOD / pixels) ** 2
    kept = np.fft.fftfreq(ORDERS, 1 / ORDERS).astype(int)  # all orders in the pupil
    orders = np.fft.fft2(np.fft.ifftshift(share))[np.ix_(kept, kept)] / pixels**2
    lags = WAVELENGTH * DISTANCE / PERIOD * np.stack(np.meshgrid(kept, kept), axis=-1)
    reach = 1.5e-3 * ((2 * np.arange(places) + 1) / places - 1)
    lattice = np.stack(np.meshgrid(reach, reach), axis=-1).reshape(-1, 2)
    lit = lattice[shapely.contains_xy(CONDENSER.polygons, lattice)]
    shapely.prepare(PUPIL.polygons)
    total = np.zeros((ORDERS, ORDERS))
    for place in lit:
        x, y = np.moveaxis(lags + place, -1, 0)
        passing = shapely.contains_xy(PUPIL.polygons, x, y)
        total += np.abs(np.fft.ifft2(orders * passing)) ** 2
    step = ORDERS // POINTS
    return ORDERS**4 * np.fft.fftshift(total)[::step, ::step] / len(lit)


def main() -> None:
    truth, taken = seconds(closed)
    print("| way | places on the condenser | pixels of the mask | error | seconds |")
    print("|---|--:|--:|--:|--:|")
    print(f"| closed form | | | | {taken:.2f} |")
    for pixels, places in ((64, 20), (64, 40), (128, 40), (256, 80), (512, 160)):
        result, taken = seconds(lambda p=pixels, n=places: abbe(p, n))
        error = np.abs(result - truth).max() / truth.max()
        print(f"| Abbe's sum | {places}² | {pixels}² | {error:.1e} | {taken:.2f} |", flush=True)


if __name__ == "__main__":
    main()
