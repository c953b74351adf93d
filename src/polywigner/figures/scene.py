"""The dB picture of a rendered scene."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from polywigner.errors import ArgumentError
from polywigner.figures.levels import PEAK_RULE, check_floor, level_db, picture_peak
from polywigner.figures.style import (
    LEVEL_MAP,
    TYPOGRAPHY,
    checked_axes,
    colour_bar,
    new_figure,
    number_text,
    quantity_text,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes


def draw_scene(
    radiance: ArrayLike,
    reference: float | None,
    floor_db: float,
    unit: str = "W/(m² sr)",
    title: str = "",
    *,
    ax: Axes | None = None,
) -> Any:
    """A rendered picture in dB relative to ``reference``, with a colour bar that says so.

    Parameters
    ----------
    radiance : (height, width), signed, in ``unit``.
    reference : the 0 dB radiance, normally :func:`polywigner.figures.picture_peak`; None draws
        an empty picture (nothing lit).
    floor_db : lowest level, dB; everything at or below it, negative radiance included, gets its
        colour.
    unit : unit of ``radiance``, for the label.
    title : above the picture.
    ax : matplotlib axes to draw on, whose figure gets the colour bar; None: a new figure.

    Returns
    -------
    The axes that were given, or the new figure.

    Raises
    ------
    ArgumentError : what are no axes.
    """
    import matplotlib as mpl

    picture = np.asarray(radiance, dtype=np.float64)
    height, width = picture.shape
    levels = level_db(picture, reference, floor_db)
    with mpl.rc_context(TYPOGRAPHY):
        if ax is None:
            figure = new_figure(*_size(width, height))
            axes = figure.add_subplot()
        else:
            axes = checked_axes(ax)
        shown = axes.imshow(levels, cmap=LEVEL_MAP, vmin=floor_db, vmax=0.0)
        axes.set_xticks([])
        axes.set_yticks([])
        extend = "max" if np.any(levels > 0) else "neither"
        axes.set_title(title, fontsize=8)
        colour_bar(axes, shown, _label(reference, floor_db, unit), extend)
    return figure if ax is None else axes


def _size(width: int, height: int) -> tuple[float, float]:
    """Inches: the longer side of the picture is 5, with room for a colour bar and its label."""
    scale = 5.0 / max(width, height)
    return width * scale + 1.2, max(height * scale, 3.4)


def _label(reference: float | None, floor_db: float, unit: str) -> str:
    floor = f"floor {number_text(floor_db)} dB"
    if reference is None:
        return f"radiance; nothing positive to compare with\n{floor}"
    return (
        f"radiance, dB relative to {quantity_text(reference, unit)}\n"
        f"(peak: {PEAK_RULE}); {floor}:\n"
        "all below it, negative radiance included"
    )


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
    """Write an animated GIF of frames by range, in dB below the peak of all frames.

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
