"""How much error is left after how much time, by signed Wigner samples and by exact light?

A white floor below a source at 94 GHz, `direct`, `multijitter` samples, seen over 1.2 heights to
either side in 256 x 256 pixels, box filter. Of each way: CPU seconds of a render whose kernel is
compiled, the best of three, and the mean of |picture - truth| over the peak of the truth in dB.
The truth is |U|^2, the mean over Gauss points in each pixel. So samples of Wigner rays also show
what rays miss near the source: in the last column is their error against their own mean, from a
render of many samples, which is noise alone.

    python benchmarks/render_exact.py [--size 256] [--only square]
"""

from __future__ import annotations

import argparse
import time
from typing import Any

import numpy as np
import numpy.typing as npt

import polywigner as pw
import polywigner.mitsuba as pwm  # before Mitsuba: it chooses the LLVM library

# isort: split
import mitsuba as mi

from polywigner.quantities import wavelength_of

WAVELENGTH = wavelength_of(94e9)
SPREAD = 1.2  # half of the picture's width over the height
MILLIMETRE = 1e-3
METHOD = "rayleigh-sommerfeld-1"
HEIGHTS = (0.05, 0.3)
WAYS = (("wigner", 64), ("wigner", 1024), ("exact", 64), ("exact", 4))
CONVERGED = 1 << 11
_BLOCK = 1 << 16


def sources() -> dict[str, pw.Aperture | pw.Array]:
    """The sources, each of some 10 mm, and an array of 8 x 8 small squares."""
    corners = [[-5, -5], [5, -5], [5, -1], [-1, -1], [-1, 5], [-5, 5]]
    sites = 0.6 * WAVELENGTH * (np.argwhere(np.ones((8, 8))) - 3.5)
    horn = pw.shapes.rectangle(12e-3, 8e-3)
    return {
        "square": pw.shapes.square(0.01),
        "L": pw.Aperture(MILLIMETRE * np.array(corners)),
        "two chevrons": pw.shapes.chevron_pair(0.01, 0.01, 0.004),
        "horn, TE10": horn.with_illumination(pw.cosine_taper(12e-3)),
        "8 x 8 squares": pw.phased_array(pw.shapes.square(0.5 * WAVELENGTH), sites, np.ones(64)),
    }


def floor_scene(source: Any, height: float, size: int, estimator: str) -> Any:
    """The floor from its upper side, in millimetres."""
    transform = mi.ScalarTransform4f
    z = height / MILLIMETRE
    half = SPREAD * z
    look = transform().look_at([0, 0, 0.5 * z], [0, 0, z], [0, 1, 0])
    film = {"type": "hdrfilm", "width": size, "height": size, "rfilter": {"type": "box"}}
    floor = transform().translate([0, 0, z]).rotate([1, 0, 0], 180).scale(2 * half)
    white = {"type": "spectrum", "value": 1.0}
    return mi.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "direct"},
            "sensor": {
                "type": "orthographic",
                "near_clip": 1e-3 * z,
                "to_world": look.scale([half, half, 1]),
                "film": film,
                "sampler": {"type": "multijitter"},
            },
            "floor": {
                "type": "rectangle",
                "to_world": floor,
                "bsdf": {"type": "diffuse", "reflectance": white},
            },
            "source": pwm.aperture(source, WAVELENGTH, scene_unit=MILLIMETRE, estimator=estimator),
        }
    )


def rendered(scene: Any, spp: int, seed: int) -> npt.NDArray[np.float64]:
    """Irradiance of the floor: rows towards -y, columns towards +x."""
    # the camera looks along +z with +y up: its columns run towards -x
    return np.pi * pwm.render(scene, spp=spp, seed=seed)[:, ::-1, 0].astype(np.float64)


def truth(source: Any, height: float, size: int) -> npt.NDArray[np.float64]:
    """Means of |U|^2 over pixels."""
    offsets, weights = np.polynomial.legendre.leggauss(2 if height < 0.1 else 3)
    pitch = 2 * SPREAD * height / size
    centres = (np.arange(size) + 0.5) * pitch - SPREAD * height
    x = (centres[:, None] + offsets * pitch / 2).ravel()
    y = -x.reshape(size, -1)[:, ::-1].ravel()
    points = np.stack(np.broadcast_arrays(x[None, :], y[:, None], height), axis=-1).reshape(-1, 3)
    values = np.concatenate(
        [
            pw.irradiance(
                source, points[k : k + _BLOCK], WAVELENGTH, method=METHOD, precision="single"
            )
            for k in range(0, len(points), _BLOCK)
        ]
    )
    count = len(offsets)
    grid = values.reshape(size, count, size, count)
    return np.einsum("iajb,a,b->ij", grid, weights / 2, weights / 2)


def decibels(found: Any, expected: Any) -> float:
    """Mean error over the peak."""
    return float(10 * np.log10(np.abs(found - expected).mean() / expected.max()))


def measure(name: str, source: Any, height: float, size: int) -> None:
    """Print the rows of one source and height."""
    expected = truth(source, height, size)
    noisy = floor_scene(source, height, size, "wigner")
    rays = np.mean([rendered(noisy, CONVERGED // 8, 100 + k) for k in range(8)], axis=0)
    for estimator, spp in WAYS:
        scene = floor_scene(source, height, size, estimator)
        rendered(scene, spp, 0)  # compiles
        times = []
        for seed in (1, 2, 3):
            start = time.process_time()
            image = rendered(scene, spp, seed)
            times.append(time.process_time() - start)
        own = f"{decibels(image, rays):.1f}" if estimator == "wigner" else ""
        print(
            f"| {name} | {1e3 * height:.0f} mm | {estimator} {spp} | {min(times):.2f} s | "
            f"{decibels(image, expected):.1f} | {own} |",
            flush=True,
        )


def main() -> None:
    """Print a Markdown table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--size", type=int, default=256)
    parser.add_argument("--only")
    options = parser.parse_args()
    mi.set_variant(pwm.choose_variant())
    mi.set_log_level(mi.LogLevel.Error)
    print("| source | height | samples | CPU | error, dB | noise, dB |\n|" + "---|" * 6)
    for name, source in sources().items():
        if options.only in (None, name):
            for height in HEIGHTS:
                measure(name, source, height, options.size)


if __name__ == "__main__":
    main()
