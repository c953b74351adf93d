"""Images of a mask under condensers of three sizes, in closed form.

python koehler_illumination.py [FOLDER]

An L of lines of 1 um with a period of 12 um, imaged by a lens of numerical aperture 0.25 at 550 nm:
with a point source, and with discs of 0.6 and of 2 pupils. Writes koehler_illumination.png. Takes
half a minute.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import matplotlib as mpl

mpl.use("agg")
import matplotlib.pyplot as plt
import numpy as np

import polywigner as pw

WAVELENGTH, FOCAL_LENGTH, RADIUS = 550e-9, 10e-3, 2.5e-3
PERIOD = (12e-6, 12e-6)
# two lines of 1 um around a corner, 1 um apart
CORNERS = (
    [(-3, -3), (3, -3), (3, -2), (-2, -2), (-2, 3), (-3, 3)],
    [(-1, -1), (3, -1), (3, 0), (0, 0), (0, 3), (-1, 3)],
)
MASK = pw.Array([pw.Aperture(np.array(ring) * 1e-6) for ring in CORNERS])


def main(folder: Path) -> None:
    pupil = pw.shapes.disc(RADIUS, 48)
    x = np.linspace(-5e-6, 5e-6, 161)
    points = np.stack(np.meshgrid(x, x), axis=-1)
    figure, axes = plt.subplots(1, 4, figsize=(10.8, 3.1), layout="constrained")
    sizes = (1e-4, 0.6, 2.0)
    for axis, size in zip(axes, sizes, strict=False):
        condenser = pw.shapes.disc(size * RADIUS, 48)
        image = pw.partially_coherent_image(
            MASK, PERIOD, pupil, condenser, points, WAVELENGTH, FOCAL_LENGTH
        )
        image = image / image.max()
        shown = axis.imshow(
            image, extent=(-5, 5, -5, 5), origin="lower", cmap="magma", vmin=0, vmax=1
        )
        for ring in CORNERS:
            axis.plot(*np.array([*ring, ring[0]]).T, color="w", lw=0.6, ls=":")
        axis.set_title("a point" if size < 0.01 else f"condenser of {size:g} pupils", fontsize=10)
        axis.set_xlabel("x (µm)")
        lines, between = image[112, 40], image[112, 56]  # at y = 2 um
        contrast = (lines - between) / (lines + between)
        print(f"{axis.get_title():24} contrast of the lines {contrast:.3f}")
    axes[0].set_ylabel("y (µm)")
    figure.colorbar(shown, ax=axes[:3], label="irradiance over its largest", shrink=0.9)
    frequency = np.linspace(0, 1000, 201)
    lags = np.column_stack([frequency * 1e3 * WAVELENGTH * FOCAL_LENGTH, 0 * frequency])
    still = np.zeros(2)
    for size in sizes:
        condenser = pw.shapes.disc(size * RADIUS, 48)
        linear = pw.transmission_cross_coefficient(pupil, condenser, lags, still)
        name = "a point" if size < 0.01 else f"{size:g}"
        axes[3].plot(frequency, np.abs(linear) / abs(linear[0]), label=name)
    axes[3].set_ylim(0, 1.05)
    axes[3].set_xlim(0, 1000)
    axes[3].set_xlabel("frequency (cycles/mm)")
    axes[3].set_title("weak contrasts: T(ξ, 0)/T(0, 0)", fontsize=10)
    axes[3].legend(title="condenser", frameon=False, fontsize=9)
    folder.mkdir(parents=True, exist_ok=True)
    figure.savefig(folder / "koehler_illumination.png", dpi=150)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="Images of a mask under three condensers.")
    parser.add_argument("folder", nargs="?", default=Path(), type=Path)
    main(parser.parse_args().folder)
