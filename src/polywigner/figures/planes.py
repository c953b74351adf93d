"""Fields on a plane: irradiances in dB and phases, by several methods side by side."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from polywigner.errors import ArgumentError
from polywigner.figures.fields import (
    chosen_method,
    dims_of,
    even_axis,
    fields_of,
    first_of,
    label_of,
    peak_of,
    printed_unit,
    quantity_of,
    squared_unit,
)
from polywigner.figures.levels import COMPARED_DB, check_floor, difference_db, level_db
from polywigner.figures.style import (
    LEVEL_MAP,
    SIGNED_MAP,
    TYPOGRAPHY,
    figure_on,
    number_text,
    quantity_text,
    row_bar,
    write_title,
)
from polywigner.geometry.display import length_unit

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure, SubFigure


Extent = tuple[float, float, float, float]

_PHASE_MAP = "twilight"  # cyclic: -180 and 180 degrees have one colour
_INCHES, _ALONE = 3.0, 4.8  # width of a panel without its colour bar: of several, of one
_MOST_DB = 3.0
"""Largest difference with a colour of its own."""


def draw_planes(
    found: Any,
    *,
    against: str | None = None,
    floor_db: float = -40.0,
    compared_db: float = COMPARED_DB,
    title: str = "",
    figure: Figure | SubFigure | None = None,
) -> Any:
    """Maps of a field on a plane in dB; below them its phases, or differences between methods.

    Parameters
    ----------
    found : xarray.Dataset with a variable for each method, as from :func:`polywigner.plane`, over
        two axes in metres, evenly spaced; the second is drawn upwards, except z. Complex values
        have their phases in the second row, paler where the field is weaker.
    against : the variable that 0 dB is taken from and the others are compared with; None: the last.
    floor_db : lowest level, dB below the peak of that method; all that is less, negative values
        included, has its colour.
    compared_db : lowest level of that method at which differences are shown.
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
    fields = fields_of(found)
    against = chosen_method(fields, against)
    first = first_of(found)
    name, unit = quantity_of(first), printed_unit(first)
    dims, fields = _turned(dims_of(found), fields)
    extent, labels, shape = _axes(found, dims)
    is_field = np.iscomplexobj(fields[against])
    powers = {m: np.abs(v) ** 2 if is_field else v for m, v in fields.items()}
    zero = peak_of(powers[against], name)
    unit = squared_unit(first) if is_field else unit
    rows = 2 if is_field or len(fields) > 1 else 1
    with mpl.rc_context(TYPOGRAPHY):
        ratio = float(np.clip(shape, 0.4, 2.0))
        columns = len(fields)
        inches = _INCHES if rows * columns > 1 else _ALONE
        size = (inches * columns + 1.4, (inches * ratio + 0.45) * rows + 0.3)
        figure = figure_on(figure, *size, is_compressed=True)
        panels = figure.subplots(rows, columns, squeeze=False, sharex=True, sharey=True)
        top = []
        for axes, (method, power) in zip(panels[0], powers.items(), strict=True):
            levels = level_db(power, zero, floor_db)
            top.append(_show(axes, levels, extent, cmap=LEVEL_MAP, vmin=floor_db, vmax=0.0))
            axes.set_title(label_of(found[method], method))
        what = f"|{name}|²" if is_field else name
        relative = f"dB relative to {quantity_text(zero, unit).rstrip()}"
        row_bar(panels[0], top[-1], f"{what}, {relative}\nfloor {number_text(floor_db)} dB")
        if is_field:
            _draw_phases(panels[1], fields, powers, zero, floor_db, extent)
        elif rows == 2:
            _draw_differences(
                panels[1], powers, (against, label_of(found[against], against)), compared_db, extent
            )
        for axes in panels[-1]:
            axes.set_xlabel(labels[0])
        for axes in panels[:, 0]:
            axes.set_ylabel(labels[1])
        write_title(figure, title)
    return figure


def _turned(
    dims: tuple[str, ...], fields: dict[str, NDArray[Any]]
) -> tuple[tuple[str, ...], dict[str, NDArray[Any]]]:
    """With z, along which beams go, as the first of two axes, the one across."""
    if len(dims) != 2 or dims[1] != "z":
        return dims, fields
    return dims[::-1], {name: values.T for name, values in fields.items()}


def _axes(found: Any, dims: tuple[str, ...]) -> tuple[Extent, tuple[str, ...], float]:
    """Extent for imshow in printed units, labels, and height over width."""
    if len(dims) != 2:
        raise ArgumentError(f"expected fields over two axes, got them over {', '.join(dims)}")
    places = [even_axis(d, np.asarray(found[d].values, dtype=np.float64)) for d in dims]
    unit = length_unit(max(float(np.ptp(p)) for p in places))
    edges: list[float] = []
    for p in places:
        half = (p[1] - p[0]) / 2  # pixel centres lie on the samples
        edges += [(p[0] - half) / unit.metres, (p[-1] + half) / unit.metres]
    labels = tuple(f"${d}$ ({unit.name})" for d in dims)
    return (
        (edges[0], edges[1], edges[2], edges[3]),
        labels,
        (edges[3] - edges[2]) / (edges[1] - edges[0]),
    )


def _show(axes: Axes, values: NDArray[Any], extent: Extent, **how: Any) -> Any:
    """Values (n1, n2), or (n1, n2, 4) in colours, with the first axis across."""
    return axes.imshow(
        np.swapaxes(values, 0, 1), origin="lower", extent=extent, interpolation="nearest", **how
    )


def _draw_phases(
    panels: Any,
    fields: dict[str, NDArray[Any]],
    powers: dict[str, NDArray[Any]],
    zero: float,
    floor_db: float,
    extent: Extent,
) -> None:
    for axes, (method, field) in zip(panels, fields.items(), strict=True):
        # Noise around nulls has a phase as well: it fades with the level.
        strength = 1 - level_db(powers[method], zero, floor_db) / floor_db
        how: dict[str, Any] = {"cmap": _PHASE_MAP, "vmin": -180, "vmax": 180}
        shown = _show(axes, np.degrees(np.angle(field)), extent, **how)
        shown.set_alpha(np.clip(3 * strength, 0, 1).T)
    bar = row_bar(panels, _phase_scale(), "phase (degrees)")
    bar.set_ticks([-180, -90, 0, 90, 180])


def _phase_scale() -> Any:
    """The mappable of a colour bar of phases: the pictures themselves are partly transparent."""
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize

    return ScalarMappable(Normalize(-180, 180), _PHASE_MAP)


def _draw_differences(
    panels: Any,
    powers: dict[str, NDArray[Any]],
    reference: tuple[str, str],
    compared_db: float,
    extent: Extent,
) -> None:
    against, called = reference
    differences = {
        m: difference_db(power, powers[against], compared_db)
        for m, power in powers.items()
        if m != against
    }
    largest = max(float(np.nanmax(np.abs(d), initial=0.0)) for d in differences.values())
    bound = min(largest, _MOST_DB) or 1.0
    shown = None
    for axes, method in zip(panels, powers, strict=True):
        if method == against:
            axes.set_visible(False)
            continue
        how: dict[str, Any] = {"cmap": SIGNED_MAP, "vmin": -bound, "vmax": bound}
        shown = _show(axes, differences[method], extent, **how)
        axes.set_facecolor("0.85")
        axes.set_title(f"minus {called}", fontsize=8)
    text = f"difference (dB)\ngrey: below {number_text(compared_db)} dB"
    row_bar(panels, shown, text, "both" if largest > bound else "neither")
