"""A phased array sweeps its beam across the street, as an animation.

    python examples/beam_sweep/beam_sweep.py --out beam_sweep.gif

Each frame is the scene of phased_array_77ghz with another steering, in dB below a common peak.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import polywigner.mitsuba  # before Dr.Jit: selects the LLVM library

# isort: split
import matplotlib as mpl
import mitsuba as mi
import numpy as np

from polywigner.figures import image_peak, level_db

SCENE = Path(__file__).resolve().parents[1] / "phased_array_77ghz" / "scene.xml"
FIRST, LAST = -45.0, 45.0
"""Degrees to the right of the array's normal."""
FLOOR_DB = -25.0
LEVELS, GREYS = 48, 12
"""Colours of the picture and of the text: one palette for all frames."""


def frame(azimuth: float, size: tuple[int, int], spp: int) -> np.ndarray:
    """Return the radiance (height, width) with the beam `azimuth` degrees to the right."""
    scene = polywigner.mitsuba.load_scene(SCENE, steering=f"{azimuth:.3f} deg, 180 deg")
    parameters = mi.traverse(scene.sensors()[0])
    parameters["film.size"] = size
    parameters.update()
    return polywigner.mitsuba.render(scene, spp=spp)[..., 0].astype(float)


def picture(radiance: np.ndarray, peak: float, azimuth: float) -> np.ndarray:
    """Return a frame with its colour bar as RGB."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    height, width = radiance.shape
    figure = Figure(figsize=(5.2, 4.2 * height / width + 0.35), dpi=width / 4.2)
    canvas = FigureCanvasAgg(figure)
    axes = figure.add_axes((0, 0, 4.2 / 5.2, 1 - 0.35 / figure.get_figheight()))
    shown = axes.imshow(
        level_db(radiance, peak, FLOOR_DB), cmap="inferno", vmin=FLOOR_DB, vmax=0, aspect="auto"
    )
    axes.set_axis_off()
    axes.set_title(f"77 GHz, 12 x 16 elements, beam at {azimuth:+.0f} deg", fontsize=9)
    scale = figure.add_axes((4.28 / 5.2, 0.06, 0.12 / 5.2, 0.8))
    bar = figure.colorbar(shown, cax=scale)
    bar.set_label(f"radiance, dB below the peak of all frames; floor {FLOOR_DB:g} dB", fontsize=7)
    bar.ax.tick_params(labelsize=7)
    canvas.draw()
    return np.asarray(canvas.buffer_rgba())[..., :3].copy()


def reduced(image: np.ndarray) -> Any:
    """Return an RGB image in the colours that all frames share."""
    from PIL import Image

    colours = mpl.colormaps["inferno"](np.linspace(0, 1, LEVELS))[:, :3]
    greys = np.repeat(np.linspace(0, 1, GREYS)[:, None], 3, axis=1)
    palette = Image.new("P", (1, 1))
    table = (255 * np.concatenate([colours, greys])).round().astype(int)
    palette.putpalette(table.ravel().tolist())
    return Image.fromarray(image).quantize(palette=palette, dither=Image.Dither.NONE)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", default="beam_sweep.gif", help="animated GIF")
    parser.add_argument("--frames", type=int, default=13, help="from left to right")
    parser.add_argument("--spp", type=int, default=64)
    parser.add_argument("--width", type=int, default=320)
    options = parser.parse_args()
    mi.set_variant(polywigner.mitsuba.choose_variant())
    angles = np.linspace(FIRST, LAST, options.frames).tolist()
    size = (options.width, options.width * 3 // 4)
    frames = []
    for angle in angles:
        frames.append(frame(angle, size, options.spp))
        print(f"{angle:+6.1f} deg", flush=True)
    peak = max(image_peak(radiance) or 0.0 for radiance in frames)
    images = [
        reduced(picture(radiance, peak, angle))
        for radiance, angle in zip(frames, angles, strict=True)
    ]
    images[0].save(
        options.out, save_all=True, append_images=images[1:], duration=250, loop=0, optimize=False
    )
    print(options.out)


if __name__ == "__main__":
    main()
