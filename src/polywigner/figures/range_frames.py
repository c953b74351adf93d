"""An animated picture of what a camera sees by range."""

from __future__ import annotations

import os
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polywigner.errors import ArgumentError
from polywigner.figures.levels import check_floor, level_db, picture_peak
from polywigner.figures.scene import draw_scene
from polywigner.figures.style import LEVEL_MAP, number_text

__all__ = ["write_range_animation"]

# Colours of the picture and of text: one palette for all frames.
_LEVELS, _GREYS = 200, 50
# A GIF is in memory until its end: 1 GB, drawn in two minutes.
_MOST_FRAMES = 2**10


def write_range_animation(
    frames: Any,
    path: str | os.PathLike[str],
    *,
    floor_db: float = -40.0,
    title: str = "",
    milliseconds: int = 100,
) -> None:
    """Write an animated GIF of frames by range, all in dB below one peak, that of all frames.

    Parameters
    ----------
    frames : as :func:`polywigner.mitsuba.range_frames` returns, up to 1024.
    path : the file, whatever its suffix; one that is there is replaced.
    floor_db : lowest level, dB.
    title : above each frame, before its range.
    milliseconds : of each frame, 10 or more.

    Raises
    ------
    ArgumentError : no frames or too many, a floor that is not below 0 dB, a time out of range.
    """
    from PIL import Image

    check_floor(floor_db)
    edges, radiance = _checked(frames)
    if not 10 <= milliseconds <= 60_000:
        raise ArgumentError(f"expected milliseconds from 10 to 60000, got {milliseconds}")
    peaks = [picture_peak(frame) or 0.0 for frame in radiance]
    peak = max(peaks) or None
    figure = draw_scene(radiance[0], peak, floor_db, title="")
    axes = figure.axes[0]
    palette, images = _palette(), []
    for number, frame in enumerate(radiance):
        axes.images[0].set_data(level_db(frame, peak, floor_db))
        first, last = (number_text(float(f"{edges[number + k]:.4g}")) for k in (0, 1))
        lines = [title, f"range {first} to {last} m"]
        axes.set_title("\n".join(line for line in lines if line), fontsize=8)
        figure.canvas.draw()
        drawn = Image.fromarray(np.asarray(figure.canvas.buffer_rgba())[..., :3].copy())
        images.append(drawn.quantize(palette=palette, dither=Image.Dither.NONE))
    images[0].save(
        path,
        format="GIF",
        save_all=True,
        append_images=images[1:],
        duration=milliseconds,
        loop=0,
        optimize=False,
    )


def _checked(frames: Any) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Edges (n + 1,) and radiances (n, rows, columns)."""
    try:
        edges, radiance = (np.asarray(frames[name].values) for name in ("range_edge", "radiance"))
    except (TypeError, KeyError, AttributeError):
        raise ArgumentError(
            f"expected frames of polywigner.mitsuba.range_frames, got {type(frames).__name__}"
        ) from None
    if not 1 <= len(radiance) <= _MOST_FRAMES:
        raise ArgumentError(
            f"expected from 1 to {_MOST_FRAMES} frames, got {len(radiance)}; use fewer, wider bins"
        )
    return edges, radiance


def _palette() -> Any:
    import matplotlib as mpl
    from PIL import Image

    colours = mpl.colormaps[LEVEL_MAP](np.linspace(0, 1, _LEVELS))[:, :3]
    greys = np.repeat(np.linspace(0, 1, _GREYS)[:, None], 3, axis=1)
    palette = Image.new("P", (1, 1))
    table = (255 * np.concatenate([colours, greys])).round().astype(int)
    palette.putpalette(table.ravel().tolist())
    return palette
