"""Fractional Fourier transforms of a hexagon.

Run ``python fractional_fourier.py [FOLDER]``, which writes ``fractional_fourier.png`` in some
seconds. Top: W over position and direction; each step rotates phase space by 22.5 degrees. Bottom:
the irradiance in the plane behind each step, from the aperture to the square of its Fourier
transform.
"""

from __future__ import annotations

import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import polywigner as pw
from polywigner.figures import level_db

WAVELENGTH = 0.5e-6
HEXAGON = pw.shapes.disc(1e-3, n=6)
SCALE = 1.0  # focal length of the complete transformer in m
ORDERS = (0.0, 0.25, 0.5, 0.75, 1.0)
REACH, SAMPLES = 1.4e-3, 121  # in m; divided by the scale, in radians


def main(folder: Path) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    axis = np.linspace(-REACH, REACH, SAMPLES)
    plane = np.stack(np.meshgrid(axis, axis), axis=-1)
    x, nu = (np.stack([part, 0 * part], axis=-1) for part in np.meshgrid(axis, axis / WAVELENGTH))
    figure, panels = plt.subplots(2, len(ORDERS), figsize=(12.5, 4.7), layout="constrained")
    extent = [1e3 * side for side in (-REACH, REACH, -REACH, REACH)]
    for order, (above, below) in zip(ORDERS, panels.T, strict=True):
        system = pw.FirstOrder.fractional(order, SCALE)
        w = pw.wigner(HEXAGON, x, nu / SCALE, through=system, wavelength=WAVELENGTH)
        light = pw.irradiance(HEXAGON, plane, WAVELENGTH, through=system)
        largest = 4 * HEXAGON.area  # largest |W|
        shown = above.imshow(
            np.sign(w) * np.sqrt(abs(w) / largest), "RdBu_r", vmin=-1, vmax=1,
            origin="lower", extent=extent,
        )  # fmt: skip
        above.set(title=f"order {order:g}", xlabel="x (mm)")
        level = level_db(light, float(light.max()), -30)
        glow = below.imshow(level, "inferno", vmin=-30, vmax=0, origin="lower", extent=extent)
        below.set(xlabel="x (mm)")
    panels[0, 0].set_ylabel("direction (mrad)")
    panels[1, 0].set_ylabel("y (mm)")
    figure.colorbar(shown, ax=panels[0], label="sign(W) root |W|,\nover its bound")
    figure.colorbar(glow, ax=panels[1], label="|U|², dB of\nthe peak")
    figure.savefig(folder / "fractional_fourier.png", dpi=100)


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path())
