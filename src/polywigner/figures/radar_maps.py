"""Figures of radar maps: power by range and rate, or by range and direction."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from polywigner.errors import ArgumentError
from polywigner.figures import style
from polywigner.figures.levels import check_floor

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_MILLIWATT = 1e-3
_LABELS = {
    "range": "range (m)",
    "range_rate": "range rate (m/s)",
    "direction_cosine": "direction cosine",
}


@style.typeset
def draw_radar_map(
    image: Any, *, floor_db: float = -60.0, title: str = "", ax: Axes | None = None
) -> Axes | Figure:
    """Draw a map of power in dBm over range and range rate, or range and direction cosine.

    Parameters
    ----------
    image : xarray.DataArray
        Result of :func:`polywigner.radar.range_doppler` or :func:`polywigner.radar.range_angle`.
        Power is averaged over draws, receivers and emitters.
    floor_db : float, default -60
        Lowest level in dB relative to the largest value.
    title : str, optional
        Title of the panel.
    ax : matplotlib.axes.Axes, optional
        Axes to draw on. Default: new axes.

    Returns
    -------
    matplotlib.axes.Axes or matplotlib.figure.Figure
        The axes, or the new figure if ``ax`` is None.

    Raises
    ------
    ArgumentError
        If ``image`` is not a radar map, or the floor is not below 0 dB.
    """
    floor = check_floor(floor_db)
    dims = tuple(getattr(image, "dims", ()))
    if dims[-1:] != ("range",) or dims[-2] not in _LABELS:
        raise ArgumentError(
            "expected a map of polywigner.radar.range_doppler or range_angle, got "
            f"{type(image).__name__}"
        )
    power = image.mean(dims[:-2]) if len(dims) > 2 else image
    levels = 10 * np.log10(np.maximum(power.values, np.finfo(float).tiny) / _MILLIWATT)
    peak = float(levels.max())
    axes, drawn = style.axes_on(ax, 6.4, 4.2)
    noise = float(np.mean(image.attrs["noise_floor"]))
    label = f"received power (dBm), {style.floor_text(floor)}"
    if noise > 0:
        label += f"; noise {style.number_text(round(10 * np.log10(noise / _MILLIWATT), 1))} dBm"
    style.draw_levels(
        axes, levels, power["range"].values, power[dims[-2]].values, low=peak + floor, high=peak,
        label=label, aspect="auto",
    )  # fmt: skip
    axes.set(xlabel=_LABELS["range"], ylabel=_LABELS[dims[-2]], title=title)
    return drawn
