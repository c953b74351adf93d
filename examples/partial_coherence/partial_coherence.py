"""Fringes behind two slits decrease with the coherence width.

python partial_coherence.py [FOLDER]

Two slits of 2 mm, 12 mm apart, at 94 GHz, and a floor at 0.3 m. Writes partial_coherence.png:
irradiance on the floor for several coherence widths by exact fields, the same rendered with a
random tilt for each sample, and the visibility over the degree of coherence. Prints the
visibility.
"""

from __future__ import annotations

import argparse
import math
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("agg")
import matplotlib.pyplot as plt
import numpy as np

import polywigner as pw

WAVELENGTH = 299_792_458 / 94e9
APART, HEIGHT, HALF = 12e-3, 0.3, 0.1
SLITS = pw.shapes.double_slit(2e-3, 4e-3, (-APART / 2, APART / 2))
WIDTHS = (math.inf, 16e-3, 8e-3, 4e-3)
COLOURS = ("#1b4965", "#5fa8d3", "#ca6702", "#9b2226")
PIXELS = 240


def exact(source: Any, **how: Any) -> tuple[Any, Any]:
    """Return positions along the floor in m, and the irradiance by exact fields."""
    x = np.linspace(-HALF, HALF, 201)
    points = np.stack([x, 0 * x, np.full_like(x, HEIGHT)], axis=-1)
    return x, pw.irradiance(source, points, WAVELENGTH, "auto", **how)


def rendered(source: Any) -> Any:
    """Return the rendered irradiance on the floor (rows, columns)."""
    import mitsuba as mi

    from polywigner.mitsuba import aperture, choose_variant, render

    if mi.variant() is None:
        mi.set_variant(choose_variant())
    mi.set_log_level(mi.LogLevel.Error)
    t = mi.ScalarTransform4f
    down = t().translate([0, 0, HEIGHT]) @ t().rotate([1, 0, 0], 180)
    film = {"type": "hdrfilm", "width": PIXELS, "height": PIXELS // 6,
            "rfilter": {"type": "box"}, "pixel_format": "luminance"}  # fmt: skip
    scene = mi.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "direct"},
            "light": aperture(source, WAVELENGTH, down, visible=False),
            "floor": {"type": "rectangle", "bsdf": {"type": "diffuse", "reflectance": 1.0}},
            "camera": {
                "type": "orthographic",
                "to_world": t().look_at([0, 0, 0.2], [0, 0, 0], [0, 1, 0]) @ t().scale(HALF),
                "film": film,
                "sampler": {"type": "multijitter"},
            },
        }
    )
    return np.pi * np.array(render(scene, spp=1024))[..., 0]


def visibility(width: float) -> float:
    """Return the visibility of the fringes of two narrow slits in the far field on the axis."""
    narrow = pw.shapes.double_slit(1e-6, 1e-6, (-APART / 2, APART / 2))
    light = narrow.partially_coherent(width)
    short = 1e-3 * APART  # far from grazing
    sine = np.array([0.0, short / (2 * APART)])
    direction = np.stack([sine, 0 * sine, np.sqrt(1 - sine**2)], axis=-1)
    bright, dark = pw.radiant_intensity(light, direction, short) / direction[:, 2]
    return float((bright - dark) / (bright + dark))


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("out", nargs="?", type=Path, default=Path(), help="folder of the figure")
    out = parser.parse_args().out
    out.mkdir(parents=True, exist_ok=True)
    figure = plt.figure(figsize=(9.5, 6.4), layout="constrained")
    grid = figure.add_gridspec(len(WIDTHS), 2, width_ratios=[1.15, 1])
    lines, curve = figure.add_subplot(grid[:2, 0]), figure.add_subplot(grid[2:, 0])
    pictures = [figure.add_subplot(grid[row, 1]) for row in range(len(WIDTHS))]
    top = 0.0
    for width, colour, axes in zip(WIDTHS, COLOURS, pictures, strict=True):
        source = SLITS.partially_coherent(width) if width < math.inf else SLITS
        x, values = exact(source)
        top = top or values.max()
        name = "coherent" if width == math.inf else f"coherent over {1e3 * width:g} mm"
        lines.plot(1e3 * x, values / top, color=colour, label=name)
        box = 1e3 * HALF
        axes.imshow(
            rendered(source) / top, vmin=0, vmax=1, cmap="inferno", aspect="auto",
            extent=(-box, box, -box / 6, box / 6),
        )  # fmt: skip
        axes.set_title(f"rendered, {name}", fontsize=9)
        axes.set_ylabel("y (mm)", fontsize=8)
        axes.tick_params(labelsize=8)
    pictures[-1].set_xlabel("x on the floor (mm)")
    lines.set(xlabel="x on the floor (mm)", ylabel="irradiance over its peak", ylim=(0, 1.3))
    lines.legend(fontsize=8, ncol=2, loc="upper center")
    ratio = np.linspace(0.2, 3.0, 15)
    result = [visibility(APART / r) for r in ratio]
    fine = np.linspace(0.0, 3.0, 200)
    curve.plot(fine, np.exp(-(fine**2) / 2), color=COLOURS[0], label="degree of coherence")
    curve.plot(ratio, result, "o", color=COLOURS[2], label="visibility of two narrow slits")
    curve.set(xlabel="distance of the slits / width of coherence", ylim=(0, 1.02))
    curve.legend(fontsize=8)
    error = np.abs(np.array(result) - np.exp(-(ratio**2) / 2)).max()
    print(f"visibility and degree of coherence differ by at most {error:.1e}")
    figure.savefig(out / "partial_coherence.png", dpi=130)


if __name__ == "__main__":
    main()
