"""Received power over range, with its errors and the noise."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from polywigner.errors import ArgumentError
from polywigner.figures.levels import check_floor
from polywigner.figures.style import TYPOGRAPHY, checked_axes, new_figure, number_text

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["draw_range_profile"]

Floats = NDArray[np.float64]

_MILLIWATT = 1e-3
# Room below the noise and above the peak, dB.
_ROOM = 5.0


def draw_range_profile(
    profile: Any,
    receiver: int = 0,
    *,
    floor_db: float = -60.0,
    title: str = "",
    ax: Axes | None = None,
) -> Any:
    """Scattered power of each bin in dBm over range in m, with the noise of the receiver.

    Parameters
    ----------
    profile : as :func:`polywigner.mitsuba.range_profile` returns.
    receiver : which one of several, from 0.
    floor_db : lowest level, dB below the largest bin, or 5 dB below the noise if that is lower;
        what is less, or not positive, has no line.
    title : above the picture.
    ax : matplotlib axes to draw on; None: a new figure.

    Returns
    -------
    The axes that were given, or the new figure.

    Raises
    ------
    ArgumentError : no profile, or not that receiver; what are no axes; a floor that is not below
        0 dB.
    """
    import matplotlib as mpl

    check_floor(floor_db)
    edges, power, error, noise = _checked(profile, receiver)
    peak = float(power.max())
    top = 10 * math.log10(peak / _MILLIWATT) if peak > 0 else 0.0
    low = top + floor_db
    noise_level = 10 * math.log10(noise / _MILLIWATT) if noise > 0 else None
    if noise_level is not None:
        low, top = min(low, noise_level - _ROOM), max(top, noise_level)
    with mpl.rc_context(TYPOGRAPHY):
        figure = new_figure(6.4, 3.6) if ax is None else None
        axes = figure.add_subplot() if figure is not None else checked_axes(ax)
        band = [_levels(power + sign * error, low) for sign in (-1, 1)]
        axes.stairs(band[1], edges, baseline=band[0], fill=True, color="C0", alpha=0.3, lw=0)
        axes.stairs(_levels(power, low), edges, baseline=None, color="C0", lw=1.0)
        if noise_level is not None:
            label = f"noise kTBF, {number_text(round(noise_level, 1))} dBm"
            axes.axhline(noise_level, color="C3", ls="--", lw=1.0, label=label)
            axes.legend(frameon=False, fontsize=7, loc="upper right")
        axes.set_xlim(edges[0], edges[-1])
        axes.set_ylim(low, top + _ROOM)
        width = np.diff(edges)
        bins = f"{number_text(float(f'{width.max():.4g}'))} m"
        if width.max() > width.min() * (1 + 1e-6):
            bins = f"up to {bins}"
        axes.set_xlabel("range, half the length of the path (m)")
        axes.set_ylabel(f"scattered power of a bin of {bins} (dBm)\n± its standard error")
        axes.grid(alpha=0.4, lw=0.5)
        axes.set_title(title, fontsize=8)
    return figure if figure is not None else axes


def _checked(profile: Any, receiver: int) -> tuple[Floats, Floats, Floats, float]:
    """Edges, powers, errors, and the noise or zero, of one receiver."""
    try:
        edges = np.asarray(profile["range_edge"].values)
        power, error, noise = (
            np.asarray(profile[name].values) for name in ("power", "standard_error", "noise_power")
        )
        if power.ndim == 1:
            power, error, noise = power[None], error[None], noise[None]
        own = power[receiver], error[receiver], float(np.nan_to_num(noise[receiver]))
    except (TypeError, KeyError, IndexError, AttributeError):
        raise ArgumentError(
            "expected a profile of polywigner.mitsuba.range_profile and the number of one of its "
            f"receivers, got {type(profile).__name__} and {receiver!r}"
        ) from None
    return edges, *own


def _levels(power: Floats, low: float) -> Floats:
    """dBm, not below ``low``."""
    floor = _MILLIWATT * 10 ** (low / 10)
    return np.asarray(10 * np.log10(np.maximum(power, floor) / _MILLIWATT))
