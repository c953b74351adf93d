"""A plate moves through a link at 94 GHz, as an animation.

    python examples/plate_in_a_link/plate_in_a_link.py --out plate_in_a_link.gif

Left: the irradiance between transmitter and receiver. Right: the received power, with diffraction
and by rays.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import polywigner.mitsuba as pm  # before Dr.Jit: selects the LLVM library

# isort: split
import matplotlib.pyplot as plt
import mitsuba as mi
import numpy as np
from matplotlib.animation import FuncAnimation, PillowWriter

import polywigner as pw

WAVELENGTH = 299_792_458 / 94e9
ANTENNA = pw.shapes.square(10e-3)
DISTANCE, PLATE_AT = 0.6, 0.3
WIDTH, HEIGHT = 0.06, 0.2
REACH = 0.09
"""Of the plate's middle to both sides, in m."""
FLOOR_DB = -40.0


def received(x: float, diffraction: bool) -> float:
    """Return the power in W of 1 W transmitted, with the plate's centre at x."""
    transform = mi.ScalarTransform4f
    receiver = transform().translate([0, 0, DISTANCE]).rotate([1, 0, 0], 180)
    plate = transform().translate([x, 0, PLATE_AT]).scale([WIDTH / 2, HEIGHT / 2, 1])
    scene = mi.load_dict(
        {
            "type": "scene",
            "sent": pm.aperture(
                ANTENNA,
                WAVELENGTH,
                power=1.0,
                estimator="exact",
                diffraction=diffraction,
                visible=False,
            ),
            "received": pm.receiver(
                ANTENNA, WAVELENGTH, to_world=receiver, diffraction=diffraction
            ),
            "plate": {
                "type": "rectangle",
                "to_world": plate,
                "bsdf": {"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": 0.0}},
            },
        }
    )
    return pm.received_power(scene, spp=16).direct


def field(x: float, points: np.ndarray) -> Any:
    """Return the irradiance at points with the plate's centre at x."""
    pose = np.eye(4)
    pose[:3, 3] = x, 0.0, PLATE_AT
    plate = pw.shapes.rectangle(WIDTH, HEIGHT).placed(pose)
    return pw.irradiance(ANTENNA, points, WAVELENGTH, "auto", obstacles=plate)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", default="plate_in_a_link.gif")
    parser.add_argument("--frames", type=int, default=31)
    parser.add_argument("--samples", type=int, nargs=2, default=(81, 121))
    given = parser.parse_args()
    mi.set_variant(pm.choose_variant())
    places = np.linspace(-REACH, REACH, given.frames)
    steps = np.linspace(-REACH, REACH, 2 * given.frames - 1)
    both = [np.array([received(x, diffracts) for x in steps]) for diffracts in (True, False)]
    free = received(1.0, False)
    x = np.linspace(-REACH, REACH, given.samples[0])
    z = np.linspace(0.01, DISTANCE, given.samples[1])
    points = np.stack(np.broadcast_arrays(x[:, None], 0.0, z), axis=-1)
    peak = 1 / (WAVELENGTH * DISTANCE) ** 2 * ANTENNA.area**2  # far field on the axis

    figure, (left, right) = plt.subplots(1, 2, figsize=(8.4, 3.6), layout="constrained")
    picture = left.imshow(
        np.zeros(given.samples),
        "inferno",
        origin="lower",
        extent=(z[0], z[-1], 1e3 * x[0], 1e3 * x[-1]),
        aspect="auto",
        vmin=FLOOR_DB,
        vmax=20,
    )
    figure.colorbar(picture, label="irradiance (dB, 0: free at receiver)")
    (body,) = left.plot([], [], color="white", linewidth=3)
    left.set(xlabel="z (m)", ylabel="x (mm)", title="10 mm squares at 94 GHz")
    with np.errstate(divide="ignore"):
        levels = [10 * np.log10(power / free) for power in both]
    right.plot(1e3 * steps, levels[0], label="with diffraction")
    right.plot(1e3 * steps, np.maximum(levels[1], FLOOR_DB), ":", label="by rays")
    right.axvspan(-500 * WIDTH, 500 * WIDTH, color="0.9", label="plate covers the axis")
    (dot,) = right.plot([], [], "o", color="C3")
    right.set(
        xlabel="middle of the plate at x (mm)",
        ylabel="received power (dB of the free link)",
        ylim=(FLOOR_DB, 5),
        title=f"link of {DISTANCE:g} m, floor {FLOOR_DB:g} dB",
    )
    right.legend(fontsize=8, loc="lower left")

    def draw(number: int) -> tuple[Any, ...]:
        place = places[number]
        values = field(place, points) / peak
        picture.set_data(10 * np.log10(np.maximum(values, 1e-9)))
        body.set_data(2 * [PLATE_AT], 1e3 * (place + np.array([-WIDTH / 2, WIDTH / 2])))
        dot.set_data([1e3 * place], [levels[0][2 * number]])
        return picture, body, dot

    shown = FuncAnimation(figure, draw, frames=given.frames)
    shown.save(Path(given.out), writer=PillowWriter(fps=6), dpi=66)
    print(given.out)


if __name__ == "__main__":
    main()
