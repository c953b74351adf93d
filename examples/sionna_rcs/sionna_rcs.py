"""A metal body of polywigner as a sensing target in Sionna RT.

Sionna RT evaluates the cross section of a target's scattering points at the directions of every
path, direct or by walls. `pw.rcs` computes it, including shadows of the body on itself, without
tables.

    pip install polywigner sionna-rt
    python sionna_rcs.py [folder of the figure]

Tested with Sionna RT 2.2.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

import polywigner as pw
from polywigner import llvm

llvm.prepare()  # before Dr.Jit, which loads its LLVM library once; a bad library is fatal

try:
    import mitsuba as mi
    import sionna.rt as rt
    from sionna.rt import rcs as targets
except ModuleNotFoundError:
    sys.exit("this example needs Sionna RT 2.2: pip install sionna-rt")

WAVELENGTH = 299792458 / 28e9
RADAR = (-33.0, 0.0, 4.0)
PLACE = (-8.0, 0.0, 1.0)


def body() -> pw.Polyhedron:
    """Return a car of flat sheets, 4 m x 1.8 m x 1.4 m about the origin, pointing to +x."""
    profile = [(-2, -0.7), (2, -0.7), (2, 0.1), (0.9, 0.1), (0.4, 0.7), (-1.6, 0.7), (-2, 0.2)]
    count = len(profile)
    vertices = [(x, y, z) for y in (-0.9, 0.9) for x, z in profile]
    sides = [(k, (k + 1) % count, (k + 1) % count + count, k + count) for k in range(count)]
    ends = [tuple(range(count)), tuple(range(2 * count - 1, count - 1, -1))]
    return pw.Polyhedron(vertices, [*ends, *(side[::-1] for side in sides)])


def cross_section(metal: Any, wavelength: float) -> Callable[[Any, Any, int], Any]:
    """Return the RCS function of a scattering point in Sionna RT: (k_i, k_s, seed) to m^2.

    Both directions are directions of propagation in the frame of the target.
    """

    def sigma(k_i: Any, k_s: Any, seed: int) -> Any:
        return pw.rcs(metal, k_s, wavelength, -k_i)

    return sigma


def target(metal: Any, wavelength: float, size: tuple[float, float, float]) -> Any:
    """Return a target with one scattering point in its centre, which does not depolarise."""
    model = targets.ScatteringModel(
        [0, 0, 0], rcs=cross_section(metal, wavelength), cpm=targets.ConstantCPM()
    )
    length, width, height = size
    return targets.SensingTarget(
        "target", model, length=length, width=width, height=height, position=list(PLACE)
    )


def radar_scene(file: str | None = None) -> Any:
    """Return a scene with a transmitter and a receiver of 0 dBi at the same position."""
    scene = rt.load_scene(file)
    scene.frequency = 299792458 / WAVELENGTH
    one = {"num_rows": 1, "num_cols": 1, "polarization": "V", "pattern": "iso"}
    scene.tx_array = scene.rx_array = rt.PlanarArray(**one)
    scene.add(rt.Transmitter("transmitter", position=list(RADAR)))
    scene.add(rt.Receiver("receiver", position=list(RADAR)))
    return scene


def echoes(scene: Any, yaws: Any, max_depth: int) -> Any:
    """Return Sionna's power ratio (n,) for yaw angles of the target."""
    result = np.empty(len(yaws))
    solver = targets.RCSSolver()
    for k, yaw in enumerate(yaws):
        scene.get("target").orientation = mi.Point3f(float(yaw), 0, 0)
        paths = solver(scene, max_depth=max_depth, samples_per_sp=10**4)
        real, imaginary = (np.asarray(part.numpy()) for part in paths.a)
        result[k] = (real**2 + imaginary**2).sum()
    return result


def radar_equation(metal: Any, yaws: Any) -> Any:
    """Return the power ratio (n,) of the direct path, lambda^2 sigma/((4 pi)^3 R^4)."""
    way = np.subtract(RADAR, PLACE)
    distance = np.linalg.norm(way)
    x, y, z = way / distance
    cosine, sine = np.cos(yaws), np.sin(yaws)
    to_radar = np.stack([x * cosine + y * sine, y * cosine - x * sine, 0 * yaws + z], axis=1)
    sigma = pw.rcs(metal, to_radar, WAVELENGTH)
    return WAVELENGTH**2 * sigma / ((4 * math.pi) ** 3 * distance**4)


def draw(path: Path) -> None:
    """Draw the echo of a car that rotates in a street canyon."""
    import matplotlib.pyplot as plt

    metal = body()
    scene = radar_scene(rt.scene.simple_street_canyon)
    scene.add(target(metal, WAVELENGTH, (4.0, 1.8, 1.4)))
    yaws = np.radians(np.arange(0.0, 181.0, 3.0))
    figure, axis = plt.subplots(figsize=(8, 4), layout="constrained")
    fine = np.radians(np.arange(0.0, 180.01, 0.25))
    with np.errstate(divide="ignore"):
        axis.plot(np.degrees(fine), 10 * np.log10(radar_equation(metal, fine)), lw=0.7, c="0.6")
        for depth, style, label in ((1, "o", "straight"), (2, "x", "straight and by one wall")):
            levels = 10 * np.log10(echoes(scene, yaws, depth))
            axis.plot(np.degrees(yaws), levels, style, ms=4, label=f"Sionna RT, {label}")
    axis.set(xlabel="car turned by, in degrees", ylabel="received over sent, in dB")
    axis.set(ylim=(-190, -85))
    axis.legend(loc="upper left")
    figure.savefig(path, dpi=110)


if __name__ == "__main__":
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else Path()
    folder.mkdir(parents=True, exist_ok=True)
    draw(folder / "sionna_rcs.png")
    print(folder / "sionna_rcs.png")
