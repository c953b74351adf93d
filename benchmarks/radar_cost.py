"""How do the time and the memory of a radar's data cube grow, and what does a sum cost?

Run ``python benchmarks/radar_cost.py``; takes some minutes. The scene is the street of
examples/radar_77ghz with four posts and a moving car. Each row changes scatterers, chirps, elements
of the receiver, or draws of speckle. The columns are the processor seconds of ``radar_cube``, the
size of the signal, and the peak memory of Python. The last lines compare the sum over scatterers
with a plain sum in NumPy.
"""

from __future__ import annotations

import time
import tracemalloc
from dataclasses import replace
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np

import polywigner as pw
import polywigner.mitsuba as pm

EXAMPLE = Path(__file__).resolve().parents[1] / "examples" / "radar_77ghz"
WAVEFORM = pw.radar.FMCW(76.85e9, 300e6, 128, 5e6, chirps=64, interval=60e-6)
VELOCITY = (-8.0, 0.0, 0.0)
LIGHT = pw.SPEED_OF_LIGHT


def scene(elements: int) -> Any:
    """Return the street with a receiver of this number of columns."""
    column = pw.read_aperture(EXAMPLE / "patch_row.wkt", unit="mm")
    wavelength = LIGHT / 77e9
    row = pw.phased_array(column, pw.arrays.grid_positions(elements, 1, wavelength / 2))
    made = pm.load_scene(EXAMPLE / "radar.xml")
    street = {shape.id(): shape for shape in made.shapes()}
    look = mi.ScalarTransform4f().look_at([0, 0, 0.7], [10, 0, 0.7], [0, 0, 1])
    receiver = pm.receiver(row, wavelength, to_world=look, temperature=290.0, noise_figure=12.0)
    integrator = {"type": "path", "max_depth": 2}
    scene = {"type": "scene", "integrator": integrator, "rx": receiver, **street}
    return mi.load_dict(scene, optimize=False)


def cost(made: Any, waveform: pw.radar.FMCW, points: int, draws: int) -> tuple[float, float, float]:
    """Return processor seconds, GiB of the signal, and peak GiB."""
    arguments: dict[str, Any] = {"velocities": {"car": VELOCITY}, "elements": True, "rays": 400_000}
    pm.radar_cube(made, waveform, points=points, draws=1, **arguments)  # compiles
    start = time.process_time()
    cube = pm.radar_cube(made, waveform, points=points, draws=draws, **arguments)
    seconds = time.process_time() - start
    tracemalloc.start()
    pm.radar_cube(made, waveform, points=points, draws=draws, **arguments)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    return seconds, cube["signal"].nbytes / 2**30, peak / 2**30


def plain_sum(made: Any, points: int, chirps: int) -> float:
    """Return processor seconds of a plain sum in NumPy for some chirps and one draw."""
    cloud = pm.scatterers(made, points, rays=400_000, velocities={"car": VELOCITY})
    receiver = pw.read_aperture(EXAMPLE / "patch_row.wkt", unit="mm")
    positions = pw.arrays.grid_positions(12, 1, LIGHT / 77e9 / 2)
    responses = pm.element_responses(cloud, pw.phased_array(receiver, positions))
    random = np.random.default_rng(0).standard_normal((2, cloud.sizes["scatterer"]))
    amplitudes = np.sqrt(cloud["intensity"].values) * (random[0] + 1j * random[1])
    delays, rates = cloud["path_length"].values / LIGHT, cloud["path_rate"].values / LIGHT
    start = time.process_time()
    for chirp in range(chirps):
        times = chirp * WAVEFORM.interval + WAVEFORM.times
        phases = WAVEFORM.frequencies[:, None] * (delays + np.multiply.outer(times, rates))
        waves = np.exp(2j * np.pi * (phases - np.round(phases)))
        np.einsum("kp,np->kn", responses * amplitudes, waves, optimize=True)
    return time.process_time() - start


def main() -> None:
    mi.set_variant(pm.choose_variant())
    print("| scatterers | chirps | elements | draws | time | signal | largest memory |")
    print("|--:|--:|--:|--:|--:|--:|--:|")
    usual = (20_000, 64, 12, 1)
    rows = [usual, *((n, 64, 12, 1) for n in (5_000, 80_000))]
    rows += [(20_000, n, 12, 1) for n in (16, 256)]
    rows += [(20_000, 64, n, 1) for n in (3, 48)]
    rows += [(20_000, 64, 12, 16)]
    scenes = {n: scene(n) for n in (3, 12, 48)}
    for points, chirps, elements, draws in rows:
        waveform = replace(WAVEFORM, chirps=chirps)
        seconds, signal, peak = cost(scenes[elements], waveform, points, draws)
        print(
            f"| {points} | {chirps} | {elements} | {draws} | {seconds:.2f} s | {signal:.3f} GiB | "
            f"{peak:.2f} GiB |",
            flush=True,
        )
    seconds = {draws: cost(scenes[12], WAVEFORM, 20_000, draws)[0] for draws in (1, 9)}
    each = (seconds[9] - seconds[1]) / 8
    plain = plain_sum(scenes[12], 20_000, 8) * WAVEFORM.chirps / 8
    print(f"\nOne more draw: {each:.2f} s; a plain sum over scatterers in NumPy: {plain:.2f} s.")


if __name__ == "__main__":
    main()
