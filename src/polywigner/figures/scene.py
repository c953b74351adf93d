"""The dB picture of a rendered scene."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from polywigner.figures.levels import PEAK_RULE, level_db
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

__all__ = ["draw_scene"]


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
