"""Echo of a corner reflector above a road over distance.

python corner_above_road.py [FOLDER]

A trihedral with legs of 100 mm faces a 77 GHz radar that drives away, 0.6 m above concrete. The
echo has four interfering paths: direct or reflected at the road, in both directions. Writes
corner_above_road.png, which also shows a point target of the same cross section, for which all four
paths count alike. Takes a minute.
"""

from __future__ import annotations

import argparse
import math
from pathlib import Path

import matplotlib as mpl

mpl.use("agg")
import matplotlib.pyplot as plt
import numpy as np

import polywigner as pw
import polywigner.mitsuba as pm
from polywigner.geometry import PlacedAperture

import mitsuba as mi  # isort: skip (after the package, which selects the LLVM library)

WAVELENGTH = 299_792_458 / 77e9
LEG = 0.1
MESH = Path(__file__).parent.parent / "corner_reflector" / "trihedral.obj"
HEIGHT, OF_CORNER = 0.6, 0.5
PATCH = pw.shapes.square(2e-3)
# dry concrete at 77 GHz, ITU-R P.2040
PERMITTIVITY = 5.24 + 0.2j
DISTANCES = np.geomspace(20.0, 400.0, 161)


def reflector() -> list[PlacedAperture]:
    """Return the plates, with their axis along -x and their corner at the height of the radar."""
    turn = np.eye(4)
    axis, across = np.ones(3) / math.sqrt(3), np.array([1.0, -1.0, 0.0]) / math.sqrt(2)
    turn[:3, :3] = np.stack([-axis, across, np.cross(-axis, across)])
    turn[2, 3] = OF_CORNER
    return [part.aperture.placed(turn @ part.pose) for part in pw.read_sheets(MESH, unit="mm")]


def looking_ahead(x: float) -> np.ndarray:
    """Return the pose of the radar, along +x with its y axis upwards."""
    pose = np.eye(4)
    pose[:3, :3] = np.column_stack([(0, 1, 0), (0, 0, 1), (1, 0, 0)])
    pose[:3, 3] = x, 0.0, HEIGHT
    return pose


def echoes(distance: float, body: list[PlacedAperture]) -> tuple[float, float]:
    """Return the received over the transmitted power, by all paths and by the direct path."""
    index = complex(np.sqrt(PERMITTIVITY))
    road = {"type": "conductor", "eta": index.real, "k": index.imag}
    pose = looking_ahead(-distance)
    scene = mi.load_dict(
        {
            "type": "scene",
            "tx": pm.aperture(PATCH, wavelength=WAVELENGTH, to_world=pose),
            "rx": pm.receiver(PATCH, wavelength=WAVELENGTH, to_world=pose),
            "road": {
                "type": "rectangle",
                "to_world": mi.ScalarTransform4f().scale([200.0, 10.0, 1.0]),
                "bsdf": {"type": "twosided", "bsdf": road},
            },
        }
    )
    result = pm.channel(scene, bodies={"corner": (body, 3)})
    straight = complex(result["amplitude"].values[0, 0, 0, result["mirrors"].values == "corner"][0])
    return abs(complex(result["h"].values[0, 0, 0])) ** 2, abs(straight) ** 2


def of_point(distances: np.ndarray, sigma: float) -> np.ndarray:
    """Return the power ratio by the radar equation with four paths, for E upwards."""
    pattern = pw.radiation_pattern(PATCH, WAVELENGTH, [0.0, 0.1], [0.0])
    gain = 10 ** (pattern.attrs["peak_directivity"] / 10)
    # All paths by three reflections have the length of the path by the apex.
    straight = np.hypot(distances, HEIGHT - OF_CORNER)
    by_road = np.hypot(distances, HEIGHT + OF_CORNER)
    sine = (HEIGHT + OF_CORNER) / by_road
    root = np.sqrt(PERMITTIVITY - 1 + sine**2)
    reflection = (PERMITTIVITY * sine - root) / (PERMITTIVITY * sine + root)
    both = 1 + reflection * np.exp(2j * math.pi * (by_road - straight) / WAVELENGTH)
    free = gain**2 * WAVELENGTH**2 * sigma / ((4 * math.pi) ** 3 * straight**4)
    return free * np.abs(both) ** 4


def main(folder: Path) -> None:
    mi.set_variant(pm.choose_variant())
    body = reflector()
    sigma = float(pw.rcs(body, (-1.0, 0.0, 0.0), WAVELENGTH, bounces=3))
    result = np.array([echoes(float(distance), body) for distance in DISTANCES])
    fine = np.geomspace(DISTANCES[0], DISTANCES[-1], 4001)
    rays = of_point(fine, sigma)
    off = 10 * np.log10(result[:, 0] / of_point(DISTANCES, sigma))[DISTANCES >= 200]
    print(f"cross section {10 * math.log10(sigma):.2f} dBsm; from 200 m on the echo is that of a "
          f"point, rms {np.sqrt(np.mean(off**2)):.2f} dB")  # fmt: skip
    figure, axes = plt.subplots(figsize=(7.2, 4.0), layout="constrained")
    axes.plot(
        fine, 10 * np.log10(rays), color="0.6", lw=0.8, label="point of the same cross section"
    )
    axes.plot(
        DISTANCES, 10 * np.log10(result[:, 1]), "k:", lw=1.2, label="trihedral, straight alone"
    )
    axes.plot(DISTANCES, 10 * np.log10(result[:, 0]), ".", color="#c23b22", ms=4, label="trihedral")
    axes.set_xscale("log")
    axes.set_xlim(fine[0], fine[-1])
    ticks = [20, 50, 100, 200, 400]
    axes.set_xticks(ticks, [str(tick) for tick in ticks])
    axes.minorticks_off()
    axes.set_ylim(-200, -90)
    axes.set_xlabel("distance (m)")
    axes.set_ylabel("received over transmitted power (dB)")
    axes.set_title(
        "trihedral of 100 mm at 0.5 m, 77 GHz radar at 0.6 m, concrete road", fontsize=10
    )
    axes.grid(alpha=0.3, lw=0.5)
    axes.legend(frameon=False, loc="lower left")
    folder.mkdir(parents=True, exist_ok=True)
    figure.savefig(folder / "corner_above_road.png", dpi=150)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="A corner reflector above a road.")
    parser.add_argument("folder", nargs="?", type=Path, default=Path())
    main(parser.parse_args().folder)
