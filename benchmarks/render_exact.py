"""How large is the error after a computing time, with signed Wigner samples and with exact light?

A white floor below a source at 94 GHz, `direct`, `multijitter` samples, viewed over 1.2 heights on
both sides in 256 x 256 pixels, box filter. For each method: CPU seconds of a render with a compiled
kernel, the better of two; and three errors in dB, each the mean over the image relative to the
peak. "all": against means of |U|^2 cos over pixels by Gauss points. "noise": difference of two
images, without the near-field error of rays. "light": against exact light at the same points of
each pixel; for exact light, against |U|^2 at the centres of pixels.

The last columns are ratios of CPU time to exact light at equal error, interpolated between two
numbers of samples. "as exact 4", "as exact 64": to the error "all" with these samples. "same
light": to the error of exact light with one sample.

    python benchmarks/render_exact.py [--size 256] [--only square]
"""

from __future__ import annotations

import argparse
import time
from typing import Any

import numpy as np
import numpy.typing as npt

import polywigner as pw
import polywigner.mitsuba as pwm  # before Mitsuba: selects the LLVM library

# isort: split
import mitsuba as mi

from polywigner.mitsuba.plugins.exact_field import ExactField
from polywigner.quantities import wavelength_of

WAVELENGTH = wavelength_of(94e9)
SPREAD = 1.2  # half width of the image over the height
MILLIMETRE = 1e-3
METHOD = "rayleigh-sommerfeld-1"
HEIGHTS = (0.05, 0.3)
EXACT = (1, 4, 64)
SIGNED = (64, 256)
_BLOCK = 1 << 16
# dB between the difference of two images and their deviations from the mean
_TWO = 5 * np.log10(2)


def sources() -> dict[str, pw.Aperture | pw.Array]:
    """Return sources of about 10 mm, and arrays of 8 x 8 and 12 x 16 small squares."""
    corners = [[-5, -5], [5, -5], [5, -1], [-1, -1], [-1, 5], [-5, 5]]
    element = pw.shapes.square(0.5 * WAVELENGTH)
    arrays = {
        f"{m} x {n} squares": pw.phased_array(
            element, pw.arrays.grid_positions(m, n, 0.6 * WAVELENGTH), np.ones(m * n)
        )
        for m, n in ((8, 8), (12, 16))
    }
    horn = pw.shapes.rectangle(12e-3, 8e-3)
    return {
        "square": pw.shapes.square(0.01),
        "L": pw.Aperture(MILLIMETRE * np.array(corners)),
        "two chevrons": pw.shapes.chevron_pair(0.01, 0.01, 0.004),
        "horn, TE10": horn.with_illumination(pw.cosine_taper(12e-3)),
        **arrays,
    }


def floor_scene(source: Any, height: float, size: int, way: str) -> Any:
    """Return the floor from above, in millimetres."""
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
            "source": pwm.aperture(
                source,
                WAVELENGTH,
                scene_unit=MILLIMETRE,
                estimator="exact" if way == "exact" else "wigner",
            ),
        }
    )


def rendered(scene: Any, spp: int, seed: int) -> npt.NDArray[np.float64]:
    """Return the irradiance of the floor, with rows towards -y and columns towards +x."""
    # The camera points along +z with +y up, so its columns run towards -x.
    return np.pi * pwm.render(scene, spp=spp, seed=seed)[:, ::-1, 0].astype(np.float64)


def truth(source: Any, height: float, size: int) -> npt.NDArray[np.float64]:
    """Return means over pixels of |U|^2 times the mean cosine over the source."""
    offsets, weights = np.polynomial.legendre.leggauss(2 if height < 0.1 else 3)
    pitch = 2 * SPREAD * height / size
    centres = (np.arange(size) + 0.5) * pitch - SPREAD * height
    x = (centres[:, None] + offsets * pitch / 2).ravel()
    y = -x.reshape(size, -1)[:, ::-1].ravel()
    points = np.stack(np.broadcast_arrays(x[None, :], y[:, None], height), axis=-1).reshape(-1, 3)
    values = np.concatenate(
        [
            pw.irradiance(source, points[k : k + _BLOCK], WAVELENGTH, method=METHOD)
            for k in range(0, len(points), _BLOCK)
        ]
    )
    values *= mean_cosine(source, points)
    count = len(offsets)
    grid = values.reshape(size, count, size, count)
    return np.einsum("iajb,a,b->ij", grid, weights / 2, weights / 2)


def mean_cosine(source: Any, points: Any) -> Any:
    """Return the cosine at points of the floor, to second order in the size of the source."""
    side = (np.arange(60) + 0.5) / 60
    low, high = np.reshape(source.bounds, (2, 2))
    x = low + (high - low) * np.stack(np.meshgrid(side, side), axis=-1).reshape(-1, 2)
    share = np.abs(pw.autocorrelation(source, x, (0.0, 0.0)))
    middle, spread = np.average(x, axis=0, weights=share), np.cov(x.T, aweights=share)
    r, z = points[:, :2] - middle, points[:, 2]
    squared = (r * r).sum(axis=-1) + z * z
    along = np.einsum("ni,ij,nj->n", r, spread, r)
    return z / np.sqrt(squared) * (1 + (3 * along / squared - np.trace(spread)) / (2 * squared))


def decibels(result: Any, expected: Any, peak: float | None = None) -> float:
    """Return the mean error relative to the peak."""
    highest = expected.max() if peak is None else peak
    return float(10 * np.log10(np.abs(result - expected).mean() / highest))


def timed(scene: Any, spp: int) -> tuple[float, list[npt.NDArray[np.float64]]]:
    """Return CPU seconds, the better of two runs, and the images of two seeds."""
    rendered(scene, 1, 0)  # compiles
    times, images = [], []
    for seed in (1, 2):
        start = time.process_time()
        images.append(rendered(scene, spp, seed))
        times.append(time.process_time() - start)
    return min(times), images


def error_of_light(source: Any, height: float, size: int) -> float:
    """Return the error in dB of exact irradiance at the centres of pixels."""
    pitch = 2 * SPREAD * height / size
    axis = (np.arange(size) + 0.5) * pitch - SPREAD * height
    points = np.stack(np.broadcast_arrays(axis[None, :], axis[:, None], height), axis=-1)
    points = points.reshape(-1, 3).astype(np.float32)
    field = ExactField(mi, source, WAVELENGTH, METHOD)
    result = np.array(field.intensity(mi.Point3f(*points.T), 1.0), dtype=float)
    truth = pw.irradiance(source, points, WAVELENGTH, method=METHOD)
    return decibels(result, truth)


def measure(name: str, source: Any, height: float, size: int) -> None:
    """Print the rows of a source and height."""
    expected = truth(source, height, size)
    peak = expected.max()
    exact_scene = floor_scene(source, height, size, "exact")
    exact = {spp: timed(exact_scene, spp) for spp in EXACT}

    def row(way: str, spp: int, run: Any, light: float, *times: float) -> None:
        seconds, images = run
        whole = np.mean([decibels(image, expected) for image in images])
        noise = decibels(*images, peak=peak) - _TWO
        cells = [f"{t:.2g}" for t in times] or [""] * 3
        print(
            f"| {name} | {1e3 * height:.0f} mm | {way} {spp} | {seconds:.2f} s | {whole:.1f} | "
            f"{noise:.1f} | {light:.1f} | {' | '.join(cells)} |",
            flush=True,
        )

    own = error_of_light(source, height, size)
    goals = [(spp, decibels(exact[spp][1][0], expected)) for spp in (4, 64)] + [(1, own)]
    few, many = (timed(floor_scene(source, height, size, "wigner"), spp) for spp in SIGNED)
    light = decibels(few[1][0], exact[SIGNED[0]][1][0], peak=peak)
    noises = [decibels(*run[1], peak=peak) - _TWO for run in (few, many)]
    slope = np.log(many[0] / few[0]) / (noises[1] - noises[0])
    times = [many[0] * np.exp(slope * (goal - noises[1])) / exact[spp][0] for spp, goal in goals]
    row("wigner", SIGNED[0], few, light)
    # With many samples, their positions do not matter.
    row("wigner", SIGNED[1], many, decibels(many[1][0], expected), *times)
    for spp in EXACT:
        row("exact", spp, exact[spp], own)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--size", type=int, default=256)
    parser.add_argument("--only")
    options = parser.parse_args()
    mi.set_variant(pwm.choose_variant())
    mi.set_log_level(mi.LogLevel.Error)
    heads = "source | height | samples | CPU | all, dB | noise | light"
    print(f"| {heads} | as exact 4 | as exact 64 | same light |\n|" + "---|" * 10)
    for name, source in sources().items():
        if options.only in (None, name):
            for height in HEIGHTS:
                measure(name, source, height, options.size)


if __name__ == "__main__":
    main()
