"""Question: how does the time of a render whose shadows diffract grow?

Run ``python benchmarks/diffraction_cost.py``; takes some minutes. A square at 94 GHz lights a floor
0.3 m below, with boxes halfway; one sample a pixel. Each row changes one thing: pixels, the side of
the square, or the number of boxes. Processor seconds of the second render of each scene, and of the
same scene without diffraction; edges that all points of the source see, together; and nanoseconds
for each combination of a sample and such an edge.
"""

from __future__ import annotations

import logging
import re
import resource
import time
from typing import Any

import mitsuba as mi

import polywigner as pw

mi.set_variant("llvm_ad_mono")
import polywigner.mitsuba as pm  # noqa: E402

WAVELENGTH = 299_792_458.0 / 94e9
# Faces times points above which all points share the silhouette of their centre.
SHARED = 32_768
BLACK = {"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": 0.0}}


def scene(pixels: int, side: float, boxes: int, diffraction: bool) -> Any:
    transform = mi.ScalarTransform4f
    across = max(1, round(boxes**0.5))
    step = 0.16 / across
    made: dict[str, Any] = {
        "type": "scene",
        "source": pm.aperture(
            pw.shapes.square(side), WAVELENGTH, estimator="exact", diffraction=diffraction
        ),
        "floor": {
            "type": "rectangle",
            "to_world": transform().translate([0, 0, 0.3]).rotate([1, 0, 0], 180),
        },
        "camera": {
            "type": "orthographic",
            "to_world": transform()
            .look_at(origin=[0, 0, 0.29], target=[0, 0, 0.3], up=[0, 1, 0])
            .scale([0.1, 0.1, 1]),
            "film": {"type": "hdrfilm", "width": pixels, "height": pixels},
        },
    }
    for k in range(boxes):
        x, y = (step * (i + 0.5) - 0.08 for i in divmod(k, across))
        pose = transform().translate([x, y, 0.15]).scale(0.25 * step)
        made[f"box{k}"] = {"type": "cube", "to_world": pose, "bsdf": BLACK}
    return mi.load_dict(made)


class Counts(logging.Handler):
    """Edges and points that the package's log tells of."""

    def emit(self, record: logging.LogRecord) -> None:
        result = re.search(r"(\d+) faces, (\d+) edges of (\d+) points", record.getMessage())
        if result:
            self.faces, self.edges, self.points = map(int, result.groups())


def seconds(made: Any) -> tuple[float, float]:
    """Processor seconds of the first and of the second render."""
    taken = []
    for seed in range(2):
        start = time.process_time()
        mi.Bitmap(pm.render(made, "direct", spp=1, seed=seed))
        taken.append(time.process_time() - start)
    return taken[0], taken[1]


def main() -> None:
    counts = Counts()
    logging.getLogger("polywigner.mitsuba").addHandler(counts)
    logging.getLogger("polywigner.mitsuba").setLevel(logging.INFO)
    print("| pixels | side | boxes | faces | points | edges | first | next | without | ns each |")
    print("|--:|--:|--:|--:|--:|--:|--:|--:|--:|--:|")
    usual = (256, 10e-3, 1)
    rows = [usual, (128, *usual[1:]), (512, *usual[1:])]
    rows += [(256, side, 1) for side in (2.5e-3, 5e-3, 20e-3)]
    rows += [(256, 10e-3, boxes) for boxes in (4, 16, 64)]
    rows += [(64, 2.5e-3, boxes) for boxes in (64, 256, 1024)]
    for pixels, side, boxes in rows:
        first, following = seconds(scene(pixels, side, boxes, True))
        _, without = seconds(scene(pixels, side, boxes, False))
        shared = counts.faces * counts.points > SHARED
        edges = counts.edges * (counts.points if shared else 1)
        each = following / (pixels**2 * edges) * 1e9
        print(
            f"| {pixels}² | {side * 1e3:g} mm | {boxes} | {counts.faces} | {counts.points} | "
            f"{edges} | {first:.2f} s | {following:.2f} s | {without:.3f} s | {each:.1f} |",
            flush=True,
        )
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print(f"\nPeak memory of the process: {peak:.0f} MiB.")


if __name__ == "__main__":
    main()
