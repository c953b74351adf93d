"""Range-angle and range-rate maps of a 77 GHz radar in a street.

    python examples/radar_77ghz/radar.py --out radar_77ghz.png

One call computes the samples that the 12 columns of the receiving array record in 64 chirps. Posts
appear within one bin of their positions, and the car at its speed.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import polywigner.mitsuba  # before Dr.Jit: selects the LLVM library

# isort: split
import mitsuba as mi
import numpy as np
import xarray
from matplotlib.figure import Figure

import polywigner as pw
from polywigner.figures import draw_radar_map

HERE = Path(__file__).resolve().parent
WAVEFORM = "76.85 GHz + 300 MHz, 128 samples at 5 MHz, 64 chirps every 60 us"
POSTS = {
    "post 1": (9.0, 2.0),
    "post 2": (16.0, -3.5),
    "post 3": (24.0, 3.0),
    "post 4": (33.0, -3.0),
}
RADIUS = 0.1
CAR = (18.0, -8.0)
"""Range of the car's front in m, and its range rate in m/s."""
DRAWS = 16
FLOOR_DB = -50.0


def data_cube(points: int = 20_000, draws: int = DRAWS) -> xarray.Dataset:
    """Return the samples of all columns; many rays are needed for the distant posts."""
    scene = polywigner.mitsuba.load_scene(HERE / "radar.xml")
    return polywigner.mitsuba.radar_cube(
        scene, WAVEFORM, velocities={"car": (CAR[1], 0.0, 0.0)}, elements=True, points=points,
        rays=20 * points, draws=draws,
    )  # fmt: skip


def position_of(post: str) -> tuple[float, float]:
    """Return the range in m of a post's surface and its direction cosine along the array."""
    x, y = POSTS[post]
    distance = float(np.hypot(x, y))
    return distance - RADIUS, y / distance


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("radar_77ghz.png"))
    parser.add_argument("--points", type=int, default=20_000, help="scatterers")
    options = parser.parse_args()
    mi.set_variant(polywigner.mitsuba.choose_variant())
    cube = data_cube(options.points)
    by_angle = pw.radar.range_angle(cube)
    by_rate = pw.radar.range_doppler(cube)

    figure = Figure(figsize=(10, 4.2), layout="constrained", dpi=100)
    left, right = figure.subplots(1, 2)
    title = f"Range and angle, mean of {DRAWS} draws of speckle"
    draw_radar_map(by_angle, floor_db=FLOOR_DB, title=title, ax=left)
    draw_radar_map(
        by_rate.isel(draw=[0]), floor_db=FLOOR_DB, title="Range and rate, one draw", ax=right
    )
    for post in POSTS:
        distance, cosine = position_of(post)
        near = by_angle.mean("draw").sel(
            range=slice(distance - 1, distance + 1),
            direction_cosine=slice(cosine - 0.05, cosine + 0.05),
        )
        peak = near.isel(near.argmax(...))
        print(
            f"{post}: {distance:.2f} m, cosine {cosine:+.3f}; "
            f"peak {float(peak['range']):.2f} m, {float(peak['direction_cosine']):+.3f}"
        )
        left.plot(distance, cosine, "o", mfc="none", mec="white", ms=11)
    right.plot(*CAR, "o", mfc="none", mec="white", ms=11)
    for axes in (left, right):
        axes.set_xlim(0, 45)
    left.set_ylim(-0.8, 0.8)
    figure.savefig(options.out)
    print(options.out)


if __name__ == "__main__":
    main()
