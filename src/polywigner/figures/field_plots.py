"""Figures of fields along lines, on planes and on hemispheres, by one or several methods."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import cycle
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from polywigner.errors import ArgumentError
from polywigner.figures import style
from polywigner.figures.levels import (
    COMPARED_DB,
    check_floor,
    checked_dataset,
    difference_db,
    even_axis,
    label_of,
    level_db,
    peak_of,
    printed_unit,
    quantity_of,
)
from polywigner.geometry.arguments import checked_choice
from polywigner.geometry.silhouettes import bodies_if_any, obstacle_of
from polywigner.numerics import Floats
from polywigner.quantities import length_unit

if TYPE_CHECKING:
    from matplotlib.figure import Figure, SubFigure


Axis = tuple[str, Floats]  # label, and positions in the unit of the label

_COLOURS = (
    *(style.RED, style.BLUE, style.ORANGE, style.GREEN, style.VIOLET),
    *("#8c510a", "#e377c2", "#666666"),
)
_DASHES = ("-", "--", "-.", (0, (1, 1.2)), (0, (5, 1, 1, 1, 1, 1)))

_DECADES = 20.0  # ratio of largest to smallest position above which an axis is logarithmic
# Limit of the linear part of the difference axis [dB]; differences span several decades.
_LINEAR_DB = 0.01
# Widths of a map in a row, of a single map and of a disc [inches].
_INCHES, _ALONE, _DISC = 3.0, 4.8, 3.3
_MOST_DB = 3.0  # largest limit of the colour scale of differences [dB]
_FAINT = 0.01  # fraction of the power in a plane that lies below the default floor


@dataclass(frozen=True, eq=False)
class Comparison:
    """Values of a quantity from several methods at the same points."""

    fields: dict[str, NDArray[Any]]  # values by variable name
    powers: dict[str, Floats]  # real values, or squared moduli of complex values
    labels: dict[str, str]
    dims: tuple[str, ...]  # axes with more than one sample
    against: str  # name of the reference variable
    zero: float  # power at 0 dB, the peak of the reference
    quantity: str
    unit: str
    is_field: bool  # whether ``fields`` are complex

    @staticmethod
    def of(dataset: Any, against: str | None) -> Comparison:
        """Read the variables of an xarray.Dataset; the default reference is the last variable."""
        arrays = {
            str(name): array.squeeze() for name, array in checked_dataset(dataset).data_vars.items()
        }
        first = next(iter(arrays.values()))
        quantity, unit = quantity_of(first), printed_unit(first)
        for name, array in arrays.items():
            if array.dims != first.dims or quantity_of(array) != quantity:
                raise ArgumentError(
                    f"the variable {name!r} differs from the other fields in quantity or axes; "
                    "draw it in a separate figure"
                )
        names = list(arrays)
        against = names[-1] if against is None else checked_choice(against, "against", names)
        fields = {name: np.asarray(array.values) for name, array in arrays.items()}
        is_field = np.iscomplexobj(fields[against])
        if is_field:
            quantity = f"|{quantity}|²"
            unit = {"√W/m": "W/m²", "": ""}.get(unit, f"({unit})²")
        powers = {name: np.abs(v) ** 2 if is_field else v for name, v in fields.items()}
        labels = {name: label_of(array, name) for name, array in arrays.items()}
        zero = peak_of(powers[against], quantity)
        dims = tuple(str(d) for d in first.dims)
        return Comparison(fields, powers, labels, dims, against, zero, quantity, unit, is_field)

    @property
    def zero_text(self) -> str:
        """Text of the power at 0 dB with its unit, such as "1.23 W/m²"."""
        return style.quantity_text(self.zero, self.unit)

    def level_text(self, floor_db: float) -> str:
        """Return the label of a colour bar for levels above a floor."""
        return f"{self.quantity}, dB relative to {self.zero_text}\n{style.floor_text(floor_db)}"

    def default_floor_db(self) -> float:
        """Return the multiple of 5 dB, from -40 to -10 dB, below which 1 % of the power lies."""
        power = np.sort(np.maximum(self.powers[self.against], 0.0), axis=None)
        below = np.cumsum(power)
        level = power[int(np.searchsorted(below, _FAINT * below[-1]))]
        return float(np.clip(5.0 * math.floor(2.0 * math.log10(level / self.zero)), -40.0, -10.0))


@style.typeset
def draw_lines(
    dataset: Any,
    *,
    against: str | None = None,
    floor_db: float = -40.0,
    title: str = "",
    figure: Figure | SubFigure | None = None,
) -> Figure:
    """Draw fields along a line for each method, and differences from a reference method.

    The horizontal axis is x, y or z if the line is parallel to that axis, otherwise the dimension
    of the dataset. Differences are drawn at points where the reference is above -30 dB.

    Parameters
    ----------
    dataset : xarray.Dataset or dict of xarray.Dataset
        A variable for each method along one axis, such as a result of :func:`polywigner.line`, or a
        cut of :func:`polywigner.hemisphere`. Squared moduli of complex values are drawn. A dict
        maps the title of each column of panels to its dataset.
    against : str, default the last variable
        Reference variable, whose peak is 0 dB.
    floor_db : float, default -40
        Lowest level in dB. Curves have gaps at values of zero or less.
    title : str, optional
        Title of the figure.
    figure : matplotlib.figure.Figure or SubFigure, default a new figure
        Figure to draw on.

    Returns
    -------
    matplotlib.figure.Figure
        The figure.

    Raises
    ------
    ArgumentError
        If the quantity or method is missing, the values have more than one axis, or ``figure`` has
        another type.
    """
    check_floor(floor_db)
    columns = dict(dataset) if isinstance(dataset, dict) and dataset else {"": dataset}
    fields = [Comparison.of(dataset, against) for dataset in columns.values()]
    is_compared, side_by_side = len(fields[0].powers) > 1, len(fields) > 1
    width, height = 1.0 + 3.0 * len(fields) if side_by_side else 6.4, 5.6 if is_compared else 3.7
    height += 0.3 * side_by_side
    figure = style.figure_on(figure, width, height, title, spacing=0.03)
    ratios = (3, 2) if is_compared else (1,)
    panels = figure.subplots(
        len(ratios), len(fields), sharex="col", sharey="row", squeeze=False, height_ratios=ratios
    )
    for column, (name, dataset), part in zip(panels.T, columns.items(), fields, strict=True):
        _draw_levels_and_differences(column, part, _line_axis(dataset, part.dims))
        text = f"0 dB: {part.zero_text}"
        if name:
            text = f"{name}; {text}"
        elif is_compared:
            text += f", the peak of {part.labels[part.against]}"
        column[0].set_title(text, loc="left", fontsize=8)
    bottom, top = panels[0, 0].get_ylim()
    # Curves may extend above the peak of the reference by a quarter of the dB range.
    panels[0, 0].set_ylim(max(bottom, floor_db), min(top, -floor_db / 4))
    panels[0, 0].set_ylabel(f"{fields[0].quantity} (dB)")
    legend: dict[str, Any] = {"frameon": False, "fontsize": 7.5, "handlelength": 2.6}
    if is_compared:
        _format_difference_axes(panels[1], fields[0])
    if is_compared and side_by_side:
        handles, labels = panels[0, 0].get_legend_handles_labels()
        position: Any = "outside lower center"
        figure.legend(handles, labels, loc=position, ncols=len(handles), **legend)
    elif is_compared:
        panels[0, 0].legend(**legend)
    return figure


def _draw_levels_and_differences(
    column: Any, fields: Comparison, axis: tuple[Floats, str, bool]
) -> None:
    """Draw levels along a line in the upper panel, and differences in the lower panel."""
    positions, label, is_logarithmic = axis
    styles = _styles(list(fields.powers), fields.against)
    for method, values in fields.powers.items():
        levels = 10 * np.log10(np.where(values > 0, values / fields.zero, np.nan))
        column[0].plot(positions, levels, label=fields.labels[method], **styles[method])
        if method != fields.against:
            difference = difference_db(values, fields.powers[fields.against])
            column[1].plot(positions, difference, **styles[method])
    for axes in column:
        style.format_line_axes(axes, xmargin=0)
    column[-1].set_xlabel(label)
    if is_logarithmic:
        from matplotlib.ticker import LogFormatter, LogLocator

        column[-1].set_xscale("log")  # The panels share this axis.
        ticks = column[-1].xaxis
        ticks.set_major_locator(LogLocator(subs=(1, 2, 5)))
        ticks.set_major_formatter(LogFormatter(labelOnlyBase=False, minor_thresholds=(9, 9)))
        ticks.set_minor_formatter(lambda *_: "")


def _line_axis(dataset: Any, dims: tuple[str, ...]) -> tuple[Floats, str, bool]:
    """Return positions in the unit of the label, the label, and whether the axis is logarithmic."""
    if len(dims) != 1:
        raise ArgumentError(
            f"expected fields along a single axis, got fields over {', '.join(dims)}"
        )
    along = dims[0]
    # On a line parallel to x, y or z, that coordinate replaces the distance along the line.
    if dataset[along].attrs.get("units") == "m":
        changing = [k for k in "xyz" if k in dataset.coords and np.ptp(dataset[k].values) > 0]
        along = changing[0] if len(changing) == 1 else along
    values = np.asarray(dataset[along].squeeze().values, dtype=np.float64)
    kind = dataset[along].attrs.get("units", "")
    name = str(dataset[along].attrs.get("long_name", f"${along}$" if len(along) == 1 else along))
    if kind == "rad":
        return np.degrees(values), f"{name} (degrees)", False
    if kind != "m":
        return values, f"{name} ({kind})" if kind else name, False
    unit = length_unit(float(np.abs(values).max()))
    logarithmic = bool(values.min() > 0 and values.max() > _DECADES * values.min())
    return values / unit.metres, f"{name} ({unit.name})", logarithmic


def _styles(methods: list[str], against: str) -> dict[str, dict[str, Any]]:
    """Return the line style of each method; the reference is a broad grey line."""
    if len(methods) == 1:
        return {against: {"color": _COLOURS[1], "lw": 1.2}}
    others = (method for method in methods if method != against)
    styles: dict[str, dict[str, Any]] = {
        method: {"color": colour, "lw": 1.2, "ls": dash}
        for method, colour, dash in zip(others, cycle(_COLOURS), cycle(_DASHES), strict=False)
    }
    broad = {"color": "0.72", "lw": 4.0, "zorder": 1.5, "solid_capstyle": "butt"}
    return styles | {against: broad}


def _format_difference_axes(panels: Any, fields: Comparison) -> None:
    """Set the scale, limits, ticks and labels of the panels with differences."""
    lines = [line.get_ydata() for axes in panels for line in axes.lines]
    largest = max(float(np.nanmax(np.abs(values), initial=0.0)) for values in lines)
    bound = min(max(largest * 1.3, 3 * _LINEAR_DB), 30.0)
    decades = [10.0**k for k in range(-2, 2) if 10.0**k <= bound]
    panels[0].set_ylabel("difference (dB)")
    floor = style.number_text(COMPARED_DB)
    text = f"minus {fields.labels[fields.against]}, above {floor} dB of its peak"
    panels[0].set_title(text, loc="left", fontsize=8)
    for axes in panels:
        axes.set_yscale("symlog", linthresh=_LINEAR_DB, linscale=0.6)
        axes.set_ylim(-bound, bound)
        style.set_ticks(axes.yaxis, [-d for d in decades[::-1]] + [0.0, *decades])
        axes.axhline(0, color="0.5", lw=0.6)


@style.typeset
def draw_planes(
    dataset: Any,
    *,
    against: str | None = None,
    floor_db: float | None = None,
    obstacles: Any = (),
    title: str = "",
    figure: Figure | SubFigure | None = None,
) -> Figure:
    """Draw maps of a field on a plane, with phases or differences between methods below.

    The second row shows the phases of complex fields, or the differences between methods. Phases
    are more transparent at lower levels. Differences are drawn at points where the reference is
    above -30 dB.

    Parameters
    ----------
    dataset : xarray.Dataset
        A variable for each method over two evenly spaced axes in metres, such as a result of
        :func:`polywigner.plane`. The second axis is vertical, unless it is z. Squared moduli of
        complex values are drawn.
    against : str, default the last variable
        Reference variable, whose peak is 0 dB.
    floor_db : float, optional
        Lowest level in dB. Lower and negative values are drawn at the floor. The default is the
        multiple of 5 dB, from -40 to -10 dB, below which 1 % of the power lies.
    obstacles : sequence of bodies and plates, default none
        Obstacles as in :func:`polywigner.plane`, whose intersections with the plane are drawn.
    title : str, optional
        Title of the figure.
    figure : matplotlib.figure.Figure or SubFigure, default a new figure
        Figure to draw on.

    Returns
    -------
    matplotlib.figure.Figure
        The figure.

    Raises
    ------
    ArgumentError
        If the quantity or method is missing, an axis is not evenly spaced, or ``figure`` has
        another type.
    """
    fields = Comparison.of(dataset, against)
    floor_db = fields.default_floor_db() if floor_db is None else check_floor(floor_db)
    across, up = _plane_axes(dataset, fields.dims)
    cuts = _obstacle_sections(dataset, fields.dims, obstacles)
    extents = [np.ptp(axis) + axis[1] - axis[0] for _, axis in (across, up)]
    rows = 2 if fields.is_field or len(fields.powers) > 1 else 1
    ratio = float(np.clip(extents[1] / extents[0], 0.4, 2.0))
    columns = len(fields.powers)
    inches = _INCHES if rows * columns > 1 else _ALONE
    size = (inches * columns + 1.4, (inches * ratio + 0.45) * rows + 0.3)
    figure = style.figure_on(figure, *size, title, is_compressed=True)
    panels = figure.subplots(rows, columns, squeeze=False, sharex=True, sharey=True)
    for axes, (method, power) in zip(panels[0], fields.powers.items(), strict=True):
        levels = _as_image(level_db(power, fields.zero, floor_db), fields)
        shown = style.draw_levels(axes, levels, across[1], up[1], low=floor_db)
        axes.set_title(fields.labels[method])
    style.colour_bar(panels[0], shown, fields.level_text(floor_db))
    if fields.is_field:
        _draw_phases(panels[1], fields, floor_db, across[1], up[1])
    elif rows == 2:
        _draw_differences(panels[1], fields, across[1], up[1])
    for axes in panels.flat:
        for lines in cuts:
            style.draw_outlines(axes, lines, "kw")
        axes.set(xlabel=across[0], ylabel=up[0])
        axes.label_outer()
    return figure


def _plane_axes(dataset: Any, dims: tuple[str, ...]) -> tuple[Axis, Axis]:
    """Return the label and positions of the horizontal and the vertical axis; z is horizontal."""
    if len(dims) != 2:
        raise ArgumentError(f"expected fields over two axes, got fields over {', '.join(dims)}")
    values = {d: even_axis(d, np.asarray(dataset[d].values, dtype=np.float64)) for d in dims}
    unit = length_unit(max(float(np.ptp(v)) for v in values.values()))
    first, second = ((style.axis_label(d, unit), v / unit.metres) for d, v in values.items())
    return (second, first) if dims[1] == "z" else (first, second)


def _obstacle_sections(dataset: Any, dims: tuple[str, ...], obstacles: Any) -> list[Floats]:
    """Return, for each obstacle, the segments (n, 2, 2) along which it cuts the plane.

    The last axis is (horizontal, vertical), in the unit of the axis labels.
    """
    bodies = bodies_if_any(obstacles)
    if not bodies:
        return []
    values = [np.asarray(dataset[d].values, dtype=np.float64) for d in dims]

    def point(*indices: int) -> Floats:
        """Return the coordinates x, y and z of a sample."""
        sample = dataset.isel(dict(zip(dims, indices, strict=True)))
        return np.array([float(sample[c]) for c in "xyz"])

    corner = point(0, 0)
    along = np.array([point(-1, 0) - corner, point(0, -1) - corner])
    along /= np.array([np.ptp(v) for v in values])[:, None]
    origin = corner - values[0][0] * along[0] - values[1][0] * along[1]
    metres = length_unit(max(float(np.ptp(v)) for v in values)).metres
    lines = [obstacle_of(body).cut(origin, along) / metres for body in bodies]
    return [line[..., ::-1] if dims[1] == "z" else line for line in lines]


def _as_image(values: NDArray[Any], fields: Comparison) -> NDArray[Any]:
    """Return values with the axes (vertical, horizontal)."""
    return values if fields.dims[1] == "z" else values.T


def _draw_phases(
    panels: Any, fields: Comparison, floor_db: float, across: Floats, up: Floats
) -> None:
    """Draw the phases of complex fields, more transparent at lower levels."""
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize

    for axes, (method, field) in zip(panels, fields.fields.items(), strict=True):
        # Phases are noise close to nulls, so the opacity decreases with the level.
        strength = 1 - level_db(fields.powers[method], fields.zero, floor_db) / floor_db
        phases = _as_image(np.degrees(np.angle(field)), fields)
        shown: Any = style.draw_map(
            axes, phases, across, up, cmap=style.PHASE_MAP, vmin=-180, vmax=180
        )
        shown.set_alpha(_as_image(np.clip(3 * strength, 0, 1), fields))
    # The colour bar uses an opaque map, because a colour bar of translucent images is translucent.
    opaque = ScalarMappable(Normalize(-180, 180), style.PHASE_MAP)
    style.colour_bar(panels, opaque, "phase (degrees)").set_ticks([-180, -90, 0, 90, 180])


def _draw_differences(panels: Any, fields: Comparison, across: Floats, up: Floats) -> None:
    """Draw the level differences from the reference in dB; the panel of the reference is empty."""
    reference = fields.powers[fields.against]
    differences = [difference_db(power, reference) for power in fields.powers.values()]
    largest = max(float(np.nanmax(np.abs(values), initial=0.0)) for values in differences)
    bound = min(largest, _MOST_DB) or 1.0
    for axes, method, difference in zip(panels, fields.powers, differences, strict=True):
        if method == fields.against:
            axes.set_visible(False)
            continue
        shown = style.draw_signed(axes, _as_image(difference, fields), across, up, bound=bound)
        axes.set_facecolor("0.85")
        axes.set_title(f"minus {fields.labels[fields.against]}", fontsize=8)
    text = f"difference (dB)\ngrey: below {style.number_text(COMPARED_DB)} dB"
    style.colour_bar(panels, shown, text, "both" if largest > bound else "neither")


@style.typeset
def draw_hemispheres(
    dataset: Any,
    *,
    against: str | None = None,
    floor_db: float = -40.0,
    title: str = "",
    figure: Figure | SubFigure | None = None,
) -> Figure:
    """Draw the level of a field on a hemisphere over the direction cosines s_x and s_y.

    Parameters
    ----------
    dataset : xarray.Dataset
        A variable for each method over ``theta`` (angle from the z axis) and ``phi`` (azimuth from
        the x axis) in radians, such as a result of :func:`polywigner.hemisphere`. Squared moduli of
        complex values are drawn.
    against : str, default the last variable
        Variable whose peak is 0 dB.
    floor_db : float, default -40
        Lowest level in dB. Lower values are drawn at the floor.
    title : str, optional
        Title of the figure.
    figure : matplotlib.figure.Figure or SubFigure, default a new figure
        Figure to draw on.

    Returns
    -------
    matplotlib.figure.Figure
        The figure.

    Raises
    ------
    ArgumentError
        If the quantity or method is missing, the dataset has other axes, or ``figure`` has another
        type.
    """
    check_floor(floor_db)
    if "directivity" in checked_dataset(dataset):
        raise ArgumentError(
            "expected fields on a hemisphere, got a radiation pattern with a directivity in dBi; "
            "use draw_pattern"
        )
    fields = Comparison.of(dataset, against)
    if sorted(fields.dims) != ["phi", "theta"]:
        raise ArgumentError(
            f"expected fields over theta and phi, got fields over {', '.join(fields.dims)}"
        )
    theta, phi = (np.asarray(dataset[d].values, dtype=np.float64) for d in ("theta", "phi"))
    size = _DISC * len(fields.powers) + 1.2, _DISC + 0.6
    figure = style.figure_on(figure, *size, title, is_compressed=True)
    panels = figure.subplots(1, len(fields.powers), squeeze=False, sharey=True)[0]
    for axes, (method, power) in zip(panels, fields.powers.items(), strict=True):
        levels = level_db(power if fields.dims[0] == "theta" else power.T, fields.zero, floor_db)
        shown = style.draw_disc(axes, theta, phi, levels, floor_db, 0.0)
        axes.set(xlabel="$s_x$", title=fields.labels[method])
    panels[0].set_ylabel("$s_y$")
    style.colour_bar(panels, shown, fields.level_text(floor_db))
    return figure
