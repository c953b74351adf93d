"""Abbe's and Porter's experiment: stops in the focal plane change an image.

Run ``python spatial_filter.py [FOLDER]``, which writes ``spatial_filter.png`` in some seconds. Two
lenses of equal focal length image a mesh of square openings, with a stop halfway. Top: the
irradiance in the plane of the stop, with the outline of the stop. Bottom: the image.
"""

from __future__ import annotations

import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from shapely.affinity import rotate

import polywigner as pw
from polywigner.figures import level_db

WAVELENGTH, FOCAL_LENGTH = 550e-9, 0.1
PITCH, OPENING, COUNT = 100e-6, 60e-6, 5  # of the mesh
SLIT = pw.shapes.rectangle(4e-3, 0.3e-3)
IRIS = pw.shapes.disc(2e-3, 32)
STOPS = {
    "an iris": IRIS,
    "a slit along x": SLIT,
    "a slit aslant": pw.Aperture(rotate(SLIT.polygons, 45)),
    "dark field": IRIS - pw.shapes.disc(0.25e-3, 32),
}


def plane(reach: float, samples: int) -> np.ndarray:
    axis = np.linspace(-reach, reach, samples)
    return np.stack(np.meshgrid(axis, axis), axis=-1)


def main(folder: Path) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    at = PITCH * (plane(0.5, COUNT) * (COUNT - 1)).reshape(-1, 2)
    mesh = pw.phased_array(pw.shapes.square(OPENING), at, np.ones(len(at)))
    half = pw.FirstOrder.fourier(FOCAL_LENGTH)
    figure, panels = plt.subplots(2, len(STOPS), figsize=(12, 5), layout="constrained")
    focal, image = 2.2e-3, 3e-4
    spectrum = pw.irradiance(mesh, plane(focal, 221), WAVELENGTH, through=half)
    for (name, stop), (above, below) in zip(STOPS.items(), panels.T, strict=True):
        level = level_db(spectrum, float(spectrum.max()), -40)
        extent = [1e3 * side for side in (-focal, focal, -focal, focal)]
        shown = above.imshow(level, "inferno", vmin=-40, vmax=0, origin="lower", extent=extent)
        for ring in stop.rings:
            above.plot(*(1e3 * np.vstack([ring, ring[:1]])).T, "c", lw=1)
        above.set(title=name, xlabel="x (mm)")
        light = pw.irradiance(mesh, plane(image, 181), WAVELENGTH, through=[half, stop, half])
        extent = [1e6 * side for side in (-image, image, -image, image)]
        glow = below.imshow(light, "gray", vmin=0, origin="lower", extent=extent)
        below.set(xlabel="x (µm)")
        bar = figure.colorbar(glow, ax=below)
    bar.set_label("|U|² over the source's")
    panels[0, 0].set_ylabel("y (mm)")
    panels[1, 0].set_ylabel("y (µm)")
    figure.colorbar(shown, ax=panels[0], label="|U|² at the stop,\ndB of the peak")
    figure.savefig(folder / "spatial_filter.png", dpi=100)


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path())
