"""How does the time of a render with diffracted shadows grow?

Run ``python benchmarks/diffraction_cost.py``; takes some minutes. A square at 94 GHz illuminates a
floor at 0.3 m, with square plates or a ball halfway and one sample per pixel. Two examples follow.
Processor seconds of the first and the second render of each scene, and of the second render without
diffraction. ``--check`` adds the second render from all points of the source, and the largest
difference of both images, over the free and over the diffracted peak.

A second table contains processor seconds of the second call of ``pw.amplitude`` behind the balls,
with the accuracy of ``pw.irradiance``. ``--check`` adds 32² points, by nodes and from all points of
the source, and the largest difference over the largest free |U|.
"""

from __future__ import annotations

import logging
import re
import resource
import sys
import time
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np

import polywigner as pw
from polywigner.propagation import edge_sums, source_nodes

mi.set_variant("llvm_ad_mono")
import polywigner.mitsuba as pm  # noqa: E402

WAVELENGTH = 299_792_458.0 / 94e9
BLACK = {"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": 0.0}}
EXAMPLES = Path(__file__).parents[1] / "examples"
PIXELS = 128
FACES = 80, 1280, 9_000, 20_000
ROWS: list[tuple[str, Any]] = [
    *((f"{n} plates, {side:g} mm", (n, side)) for n in (1, 4, 16, 64, 256) for side in (0.5, 10)),
    *((f"ball of {n} faces, 10 mm", n) for n in FACES),
    ("patch_above_floor, 240²", ("patch_above_floor", 240, 240)),
    ("street_77ghz, 192 x 144", ("street_77ghz", 192, 144)),
]


def floor(side: float, bodies: dict[str, Any], diffraction: bool) -> Any:
    transform = mi.ScalarTransform4f
    look = transform().look_at(origin=[0, 0, 0.29], target=[0, 0, 0.3], up=[0, 1, 0])
    film = {"type": "hdrfilm", "width": PIXELS, "height": PIXELS, "rfilter": {"type": "box"}}
    below = transform().translate([0, 0, 0.3]).rotate([1, 0, 0], 180)
    source = pw.shapes.square(side * 1e-3)
    lamp = pm.aperture(source, WAVELENGTH, estimator="exact", diffraction=diffraction)
    return mi.load_dict(
        {
            "type": "scene",
            "source": lamp,
            "floor": {"type": "rectangle", "to_world": below},
            "camera": {
                "type": "orthographic",
                "to_world": look.scale([0.1, 0.1, 1]),
                "film": film,
            },
            **bodies,
        }
    )


def plates(count: int) -> dict[str, Any]:
    across = round(count**0.5)
    step = 0.16 / across
    made = {}
    for k in range(count):
        x, y = (step * (i + 0.5) - 0.08 for i in divmod(k, across))
        pose = mi.ScalarTransform4f().translate([x, y, 0.15]).scale(0.25 * step)
        made[f"plate{k}"] = {"type": "rectangle", "to_world": pose, "bsdf": BLACK}
    return made


def ball(faces: int) -> pw.Polyhedron:
    """Return a ball of rings of triangles, 60 mm wide."""
    n = round((faces / 2) ** 0.5)
    polar, azimuth = np.linspace(0, np.pi, n + 1)[:, None], np.arange(n) * 2 * np.pi / n
    parts = (
        np.sin(polar) * np.cos(azimuth),
        np.sin(polar) * np.sin(azimuth),
        np.cos(polar) + 0 * azimuth,
    )
    points = np.stack(parts, axis=-1)
    lower, upper = np.arange(n * n).reshape(n, n), np.arange(n * n).reshape(n, n) + n
    corners = (
        [lower, upper, np.roll(upper, -1, axis=1)],
        [lower, np.roll(upper, -1, axis=1), np.roll(lower, -1, axis=1)],
    )
    triangles = np.concatenate([np.stack(some, axis=-1).reshape(-1, 3) for some in corners])
    points, number = np.unique(points.reshape(-1, 3).round(12), axis=0, return_inverse=True)
    triangles = number.ravel()[triangles]
    first, second, third = triangles.T
    triangles = triangles[(first != second) & (second != third) & (third != first)]
    return pw.Polyhedron(0.03 * points + [0.01, 0.0, 0.15], triangles)


def as_mesh(body: pw.Polyhedron) -> dict[str, Any]:
    mesh = mi.Mesh("ball", len(body.vertices), len(body.triangles))
    params = mi.traverse(mesh)
    params["vertex_positions"] = body.vertices.ravel()
    params["faces"] = body.triangles.ravel()
    params.update()
    return {"ball": mesh}


def scene(what: Any, diffraction: bool) -> Any:
    if isinstance(what, int):
        return floor(10, as_mesh(ball(what)), diffraction)
    if isinstance(what[0], int):
        return floor(what[1], plates(what[0]), diffraction)
    loaded = pm.load_scene(EXAMPLES / what[0] / "scene.xml", diffraction=diffraction)
    params = mi.traverse(loaded)
    (size,) = (key for key in params.keys() if key.endswith("film.size"))  # noqa: SIM118
    params[size] = what[1:]
    params.update()
    return loaded


class Counts(logging.Handler):
    """Numbers in the package's log."""

    numbers = "", "", "", ""

    def emit(self, record: logging.LogRecord) -> None:
        pattern = r"(\d+) faces, (\d+) edges, (\d+) nodes of (\d+) points"
        result = re.search(pattern, record.getMessage())
        self.numbers = result.groups() if result else self.numbers


def rendered(made: Any) -> tuple[list[float], Any]:
    """Return processor seconds of the first and of the second render, and the image."""
    taken = []
    for seed in range(2):
        start = time.process_time()
        image = np.array(pm.render(made, "direct", spp=1, seed=seed))
        taken.append(time.process_time() - start)
    return taken, image


def from_all_points(what: Any) -> tuple[float, Any]:
    usual, source_nodes._LIMITS = source_nodes._LIMITS, {}
    (_, seconds), image = rendered(scene(what, True))
    source_nodes._LIMITS = usual
    return seconds, image


def behind(faces: int, pixels: int) -> tuple[float, Any, float]:
    """Return processor seconds of the second call, the field, and the largest free field."""
    side, source = np.linspace(-0.1, 0.1, pixels), pw.shapes.square(10e-3)
    points = np.stack([*np.meshgrid(side, side), np.full((pixels, pixels), 0.3)], axis=-1)
    seconds = 0.0
    for _ in range(2):
        start = time.process_time()
        # as accurate as an irradiance by default
        field = pw.amplitude(source, points, WAVELENGTH, obstacles=ball(faces), tolerance=1e-4)
        seconds = time.process_time() - start
    return seconds, field, float(np.abs(pw.amplitude(source, points, WAVELENGTH)).max())


def print_fields(check: bool) -> None:
    columns = ["faces", f"{PIXELS}² points", *(["32² points", "all points", "of peak"] * check)]
    print("\n| " + " | ".join(columns) + " |\n" + "|--:" * len(columns) + "|")
    for faces in FACES:
        cells = [f"{faces}", f"{behind(faces, PIXELS)[0]:.2f} s"]
        if check:
            seconds, field, peak = behind(faces, 32)
            usual, edge_sums._LEAST_PAIRS = edge_sums._LEAST_PAIRS, 1 << 62
            all_seconds, expected, _ = behind(faces, 32)
            edge_sums._LEAST_PAIRS = usual
            off = np.abs(field - expected).max() / peak
            cells += [f"{seconds:.2f} s", f"{all_seconds:.2f} s", f"{off:.1e}"]
        print("| " + " | ".join(cells) + " |", flush=True)


def main() -> None:
    counts, check = Counts(), "--check" in sys.argv
    logging.getLogger("polywigner.mitsuba").addHandler(counts)
    logging.getLogger("polywigner.mitsuba").setLevel(logging.INFO)
    columns = ["scene", "faces", "edges", "nodes", "points", "first", "next", "without"]
    columns += ["all points", "of free peak", "of peak"] if check else []
    print("| " + " | ".join(columns) + " |\n|---|" + "--:|" * (len(columns) - 1))
    for name, what in ROWS:
        (first, following), image = rendered(scene(what, True))
        cells = [name, *counts.numbers, f"{first:.2f} s", f"{following:.3f} s"]
        (_, without), free = rendered(scene(what, False))
        cells.append(f"{without:.3f} s")
        if check:
            seconds, expected = from_all_points(what)
            off = np.abs(image - expected).max()
            cells += [f"{seconds:.2f} s", f"{off / free.max():.1e}", f"{off / expected.max():.1e}"]
        print("| " + " | ".join(cells) + " |", flush=True)
    print_fields(check)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print(f"\nPeak memory of the process: {peak:.0f} MiB.")


if __name__ == "__main__":
    main()
