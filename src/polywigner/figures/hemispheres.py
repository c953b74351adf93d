"""Fields on a hemisphere around a source, seen from its axis: circles of directions."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from polywigner.errors import ArgumentError
from polywigner.figures.fields import (
    chosen_method,
    dims_of,
    fields_of,
    first_of,
    label_of,
    peak_of,
    printed_unit,
    quantity_of,
    squared_unit,
)
from polywigner.figures.levels import check_floor, level_db
from polywigner.figures.style import (
    LEVEL_MAP,
    TYPOGRAPHY,
    figure_on,
    number_text,
    quantity_text,
    row_bar,
    write_title,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure, SubFigure

__all__ = ["draw_disc", "draw_hemispheres"]

_INCHES = 3.3
_RINGS = (30, 60)  # degrees from the axis


def draw_hemispheres(
    found: Any,
    *,
    against: str | None = None,
    floor_db: float = -40.0,
    title: str = "",
    figure: Figure | SubFigure | None = None,
) -> Any:
    """Levels over all directions of a half space, in the plane of the direction cosines s_x, s_y.

    Parameters
    ----------
    found : xarray.Dataset with a variable for each method, as from :func:`polywigner.hemisphere`,
        over ``theta`` (from the axis) and ``phi`` (around it, from x) in radians. Complex values
        are squared.
    against : the variable whose peak is 0 dB; None: the last one.
    floor_db : lowest level, dB; all that is less has its colour.
    title : above the panels.
    figure : matplotlib Figure or SubFigure to draw on; None: a new figure.

    Returns
    -------
    The figure or subfigure.

    Raises
    ------
    ArgumentError : no such quantity or method; other axes; what is no figure.
    """
    import matplotlib as mpl

    check_floor(floor_db)
    if "directivity" in found:
        raise ArgumentError(
            "expected fields on a hemisphere, got a radiation pattern, whose directivity is in dBi "
            "already; use draw_pattern"
        )
    fields = fields_of(found)
    against = chosen_method(fields, against)
    dims = dims_of(found)
    if sorted(dims) != ["phi", "theta"]:
        raise ArgumentError(f"expected fields over theta and phi, got them over {', '.join(dims)}")
    first = first_of(found)
    name, unit = quantity_of(first), printed_unit(first)
    theta, phi = (np.asarray(found[d].values, dtype=np.float64) for d in ("theta", "phi"))
    is_field = np.iscomplexobj(fields[against])
    powers = {
        m: (np.abs(v) ** 2 if is_field else v).transpose([dims.index("theta"), dims.index("phi")])
        for m, v in fields.items()
    }
    zero = peak_of(powers[against], name)
    with mpl.rc_context(TYPOGRAPHY):
        size = _INCHES * len(powers) + 1.2, _INCHES + 0.6
        figure = figure_on(figure, *size, is_compressed=True)
        panels = figure.subplots(1, len(powers), squeeze=False, sharey=True)[0]
        for axes, (method, power) in zip(panels, powers.items(), strict=True):
            levels = level_db(power, zero, floor_db)
            shown = draw_disc(axes, theta, phi, levels, floor_db, 0.0)
            axes.set_xlabel("$s_x$")
            axes.set_title(label_of(found[method], method))
        panels[0].set_ylabel("$s_y$")
        unit = squared_unit(first) if is_field else unit
        what = f"|{name}|²" if is_field else name
        text = (
            f"{what}, dB relative to {quantity_text(zero, unit)}\nfloor {number_text(floor_db)} dB"
        )
        row_bar(panels, shown, text)
        write_title(figure, title)
    return figure


def draw_disc(
    axes: Axes,
    theta: NDArray[np.float64],
    phi: NDArray[np.float64],
    levels: NDArray[np.float64],
    low: float,
    high: float,
) -> Any:
    """Levels (n, m) over theta and phi, in the plane of the direction cosines, with its circles."""
    from matplotlib.patches import Circle

    phi, levels = _once_around(phi, levels)
    sine = np.sin(theta)[:, None]
    shown = axes.pcolormesh(
        sine * np.cos(phi),
        sine * np.sin(phi),
        levels,
        shading="gouraud",
        cmap=LEVEL_MAP,
        vmin=low,
        vmax=high,
        rasterized=True,
    )
    for degrees in (*_RINGS, 90):
        radius = np.sin(np.radians(degrees))
        how: dict[str, Any] = {"edgecolor": "0.4" if degrees == 90 else "white", "fill": False}
        axes.add_patch(Circle((0, 0), radius, lw=0.6, ls="-" if degrees == 90 else ":", **how))
        if degrees != 90:
            place = radius * np.cos(np.pi / 4), radius * np.sin(np.pi / 4)
            axes.text(*place, f"{degrees}°", color="white", fontsize=7, ha="left", va="bottom")
    axes.set_aspect("equal")
    axes.set_xlim(-1.02, 1.02)
    axes.set_ylim(-1.02, 1.02)
    return shown


def _once_around(
    phi: NDArray[np.float64], levels: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """With the first meridian again at the end, where the circle is left open by one step."""
    step = phi[1] - phi[0] if len(phi) > 1 else 0.0
    if abs(phi[-1] + step - phi[0] - 2 * np.pi) > 1e-6 * max(step, 1e-6):
        return phi, levels
    return np.append(phi, phi[0] + 2 * np.pi), np.concatenate([levels, levels[:, :1]], axis=1)
