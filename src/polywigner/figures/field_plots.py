"""Fields along lines, on planes and on hemispheres, by several methods side by side."""

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
from polywigner.geometry.arguments import checked_choice, checked_flag
from polywigner.geometry.display import length_unit
from polywigner.geometry.silhouettes import bodies_if_any, obstacle_of

if TYPE_CHECKING:
    from matplotlib.figure import Figure, SubFigure


Floats = NDArray[np.float64]
Axis = tuple[str, Floats]
"""The label of an axis, and places along it in the unit that the label names."""

_COLOURS = (
    *(style.RED, style.BLUE, style.ORANGE, style.GREEN, style.VIOLET),
    *("#8c510a", "#e377c2", "#666666"),
)
_DASHES = ("-", "--", "-.", (0, (1, 1.2)), (0, (5, 1, 1, 1, 1, 1)))

_DECADES = 20.0
"""Ratio of the ends of an axis of lengths from which it is logarithmic."""

_LINEAR_DB = 0.01
"""Difference up to which the axis is linear, logarithmic beyond: differences of good methods fall
by three decades along a line."""
# Width of a panel without its colour bar: of several maps, of one alone, of a disc.
_INCHES, _ALONE, _DISC = 3.0, 4.8, 3.3
_MOST_DB = 3.0
"""Largest difference with a colour of its own."""


# Fraction of the power below the default floor of a plane.
_FAINT = 0.01


@dataclass(frozen=True, eq=False)
class Comparison:
    """One quantity by several methods at the same places, like a power: fields are squared.

    ``powers`` and ``labels`` are by the name of the variable, over ``dims``, the axes of more than
    one sample. 0 dB is ``zero``, the peak of the method ``against``. ``fields`` are the values as
    they were given, complex if ``is_field``.
    """

    fields: dict[str, NDArray[Any]]
    powers: dict[str, Floats]
    labels: dict[str, str]
    dims: tuple[str, ...]
    against: str
    zero: float
    quantity: str
    unit: str
    is_field: bool

    @staticmethod
    def of(found: Any, against: str | None) -> Comparison:
        """Read the variables of a dataset; 0 dB is the peak of ``against``, by default the last."""
        arrays = {
            str(name): array.squeeze()
            for name, array in checked_dataset(found, "found").data_vars.items()
        }
        if not arrays:
            raise ArgumentError("expected a field to draw, got a dataset without variables")
        first = next(iter(arrays.values()))
        quantity, unit = quantity_of(first), printed_unit(first)
        for name, array in arrays.items():
            if array.dims != first.dims or quantity_of(array) != quantity:
                raise ArgumentError(
                    f"expected fields of one quantity over the same axes, got {name!r}, another; "
                    "draw them one by one"
                )
        if against is not None:
            checked_choice(against, "against", list(arrays))
        against = list(arrays)[-1] if against is None else against
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
        """The power of 0 dB with its unit."""
        return style.quantity_text(self.zero, self.unit)

    def level_text(self, floor_db: float) -> str:
        """Label of a bar of levels."""
        return f"{self.quantity}, dB relative to {self.zero_text}\n{style.floor_text(floor_db)}"

    def default_floor_db(self) -> float:
        """Return the level in dB below which 1 % of the power lies, from -40 to -10.

        It is a multiple of 5 dB. Fresnel fringes then fill the colour scale, and so do sidelobes.
        """
        power = np.sort(np.maximum(self.powers[self.against], 0.0), axis=None)
        below = np.cumsum(power)
        level = power[int(np.searchsorted(below, _FAINT * below[-1]))]
        return float(np.clip(5.0 * math.floor(2.0 * math.log10(level / self.zero)), -40.0, -10.0))


@style.typeset
def draw_lines(
    found: Any,
    *,
    along: str | None = None,
    against: str | None = None,
    floor_db: float = -40.0,
    linear: bool = False,
    compared_db: float = COMPARED_DB,
    title: str = "",
    figure: Figure | SubFigure | None = None,
) -> Any:
    """Levels along a line by each method, and below them the differences from one of the methods.

    Parameters
    ----------
    found : xarray.Dataset with a variable for each method, as from :func:`polywigner.line` and, for
        a cut, :func:`polywigner.hemisphere`; complex values are squared. Or several, by the titles
        of the columns in which they are drawn beside each other, all of the same methods.
    along : the coordinate on the horizontal axis, in metres or radians; None: x, y or z if the
        line is parallel to it, else that of the dataset.
    against : the variable that the others are compared with; None: the last one.
    floor_db : lowest level shown, dB below the peak of that method. Curves have gaps where values
        are not above zero.
    linear : show values relative to that peak on a linear scale instead of levels in dB.
    compared_db : lowest level of that method at which differences are shown.
    title : above the panels.
    figure : matplotlib Figure or SubFigure to draw on, which is returned; None: a new figure.

    Raises
    ------
    ArgumentError : no such quantity, method or coordinate; values over more than one axis; a
        ``figure`` of another type.
    """
    check_floor(floor_db)
    checked_flag(linear, "linear")
    columns = dict(found) if isinstance(found, dict) and found else {"": found}
    fields = [Comparison.of(one, against) for one in columns.values()]
    is_compared, side_by_side = len(fields[0].powers) > 1, len(fields) > 1
    width, height = 1.0 + 3.0 * len(fields) if side_by_side else 6.4, 5.6 if is_compared else 3.7
    figure = style.figure_on(figure, width, height + 0.3 * side_by_side, spacing=0.03)
    ratios = (3, 2) if is_compared else (1,)
    panels = figure.subplots(
        len(ratios), len(fields), sharex="col", sharey="row", squeeze=False, height_ratios=ratios
    )
    for column, one, each, name in zip(panels.T, columns.values(), fields, columns, strict=True):
        _draw_column(column, each, _axis(one, each.dims, along), linear, compared_db)
        text = f"{'1' if linear else '0 dB'}: {each.zero_text}"
        if name:
            text = f"{name}; {text}"
        elif is_compared:
            text += f", the peak of {each.labels[each.against]}"
        column[0].set_title(text, loc="left", fontsize=8)
    if not linear:
        panels[0, 0].set_ylim(*_range(fields, floor_db))
    panels[0, 0].set_ylabel(f"{fields[0].quantity} ({'relative' if linear else 'dB'})")
    legend: dict[str, Any] = {"frameon": False, "fontsize": 7.5, "handlelength": 2.6}
    if is_compared:
        _difference_axis(panels[1], fields[0], compared_db)
    if is_compared and side_by_side:
        handles = panels[0, 0].get_legend_handles_labels()
        figure.legend(*handles, loc="outside lower center", ncols=len(handles[0]), **legend)
    elif is_compared:
        panels[0, 0].legend(**legend)
    style.write_title(figure, title)
    return figure


def _draw_column(
    column: Any, fields: Comparison, axis: tuple[Floats, str, bool], linear: bool,
    compared_db: float,
) -> None:  # fmt: skip
    """Draw levels, and below them the differences of several fields from the reference."""
    positions, label, is_logarithmic = axis
    styles = _styles(list(fields.powers), fields.against)
    for method, values in fields.powers.items():
        levels = values / fields.zero
        if not linear:
            levels = 10 * np.log10(np.where(values > 0, levels, np.nan))
        column[0].plot(positions, levels, label=fields.labels[method], **styles[method])
        if method != fields.against:
            difference = difference_db(values, fields.powers[fields.against], compared_db)
            column[1].plot(positions, difference, **styles[method])
    for axes in column:
        style.finish_lines(axes, xmargin=0)
    column[-1].set_xlabel(label)
    if is_logarithmic:
        from matplotlib.ticker import LogFormatter, LogLocator

        column[-1].set_xscale("log")  # of both panels, which share the axis
        ticks = column[-1].xaxis
        ticks.set_major_locator(LogLocator(subs=(1, 2, 5)))
        ticks.set_major_formatter(LogFormatter(labelOnlyBase=False, minor_thresholds=(9, 9)))
        ticks.set_minor_formatter(lambda *_: "")


def _axis(found: Any, dims: tuple[str, ...], along: str | None) -> tuple[Floats, str, bool]:
    """Places as they are printed, the label of their axis, and whether it is logarithmic."""
    if len(dims) != 1:
        raise ArgumentError(f"expected fields along one axis, got them over {', '.join(dims)}")
    if along is None:
        along = dims[0]
        if found[along].attrs.get("units") == "m":  # a line may be parallel to x, y or z
            changing = [k for k in "xyz" if k in found.coords and np.ptp(found[k].values) > 0]
            along = changing[0] if len(changing) == 1 else along
    checked_choice(along, "along", [str(name) for name in found.coords])
    places = np.asarray(found[along].squeeze().values, dtype=np.float64)
    kind = found[along].attrs.get("units", "")
    called = str(found[along].attrs.get("long_name", f"${along}$" if len(along) == 1 else along))
    if kind == "rad":
        return np.degrees(places), f"{called} (degrees)", False
    if kind != "m":
        return places, f"{called} ({kind})" if kind else called, False
    unit = length_unit(float(np.abs(places).max()))
    logarithmic = bool(places.min() > 0 and places.max() > _DECADES * places.min())
    return places / unit.metres, f"{called} ({unit.name})", logarithmic


def _styles(methods: list[str], against: str) -> dict[str, dict[str, Any]]:
    """Line styles: the reference is a broad grey band, on which other lines are still seen."""
    if len(methods) == 1:
        return {against: {"color": _COLOURS[1], "lw": 1.2}}
    others = (method for method in methods if method != against)
    styles: dict[str, dict[str, Any]] = {
        method: {"color": colour, "lw": 1.2, "ls": dash}
        for method, colour, dash in zip(others, cycle(_COLOURS), cycle(_DASHES), strict=False)
    }
    broad = {"color": "0.72", "lw": 4.0, "zorder": 1.5, "solid_capstyle": "butt"}
    return styles | {against: broad}


def _range(columns: list[Comparison], floor_db: float) -> tuple[float, float]:
    """From the floor, or just below all curves, to above them. They may pass the peak of the
    reference (0 dB), but not by so much that nothing else is seen."""
    levels = np.concatenate(
        [v[v > 0] / fields.zero for fields in columns for v in fields.powers.values()]
    )
    low, high = 10 * np.log10([levels.min(), levels.max()])
    top, bottom = min(high, -floor_db / 4), max(low, floor_db)
    margin = 0.04 * (top - bottom) + 0.1
    return float(bottom if low < floor_db else bottom - margin), float(top + margin)


def _difference_axis(panels: Any, fields: Comparison, compared_db: float) -> None:
    lines = [line.get_ydata() for axes in panels for line in axes.lines]
    largest = max(float(np.nanmax(np.abs(values), initial=0.0)) for values in lines)
    bound = min(max(largest * 1.3, 3 * _LINEAR_DB), 30.0)
    decades = [10.0**k for k in range(-2, 2) if 10.0**k <= bound]
    panels[0].set_ylabel("difference (dB)")
    floor = style.number_text(compared_db)
    text = f"minus {fields.labels[fields.against]}, where above {floor} dB of its peak"
    panels[0].set_title(text, loc="left", fontsize=8)
    for axes in panels:
        axes.set_yscale("symlog", linthresh=_LINEAR_DB, linscale=0.6)
        axes.set_ylim(-bound, bound)
        style.set_ticks(axes.yaxis, [-d for d in decades[::-1]] + [0.0, *decades])
        axes.axhline(0, color="0.5", lw=0.6)


@style.typeset
def draw_planes(
    found: Any,
    *,
    against: str | None = None,
    floor_db: float | None = None,
    linear: bool = False,
    compared_db: float = COMPARED_DB,
    obstacles: Any = (),
    title: str = "",
    figure: Figure | SubFigure | None = None,
) -> Any:
    """Draw maps of a field on a plane; below them its phases, or differences between methods.

    Parameters
    ----------
    found : xarray.Dataset with a variable for each method, as from :func:`polywigner.plane`, over
        two evenly spaced axes in metres. The second axis is drawn upwards, unless it is z. The
        second row shows the phases of complex values, paler where the field is weaker.
    against : variable whose peak is 0 dB, with which the others are compared; None: the last.
    floor_db : lowest level in dB below that peak. Lower and negative values get its colour.
        None: the multiple of 5 dB below which 1 % of the power lies, from -40 to -10 dB.
    linear : show values relative to the peak on a linear scale instead of levels in dB.
    compared_db : lowest level of that method at which differences are shown.
    obstacles : bodies and plates, as :func:`polywigner.plane` takes them. Their intersections with
        the plane are drawn.
    title : title above the panels.
    figure : matplotlib Figure or SubFigure to draw on, which is returned; None: a new figure.

    Returns
    -------
    The figure.

    Raises
    ------
    ArgumentError : the quantity or method is missing, the axes are not even, or ``figure`` is not
        a figure.
    """
    fields = Comparison.of(found, against)
    floor_db = fields.default_floor_db() if floor_db is None else check_floor(floor_db)
    checked_flag(linear, "linear")
    across, up = _axes(found, fields.dims)
    cuts = _cuts(found, fields.dims, obstacles)
    extents = [np.ptp(places) + places[1] - places[0] for _, places in (across, up)]
    rows = 2 if fields.is_field or len(fields.powers) > 1 else 1
    ratio = float(np.clip(extents[1] / extents[0], 0.4, 2.0))
    columns = len(fields.powers)
    inches = _INCHES if rows * columns > 1 else _ALONE
    size = (inches * columns + 1.4, (inches * ratio + 0.45) * rows + 0.3)
    figure = style.figure_on(figure, *size, is_compressed=True)
    panels = figure.subplots(rows, columns, squeeze=False, sharex=True, sharey=True)
    low, high = (0.0, 1.0) if linear else (floor_db, 0.0)
    for axes, (method, power) in zip(panels[0], fields.powers.items(), strict=True):
        values = power / fields.zero if linear else level_db(power, fields.zero, floor_db)
        shown = style.draw_levels(
            axes, _upright(values, fields), across[1], up[1], low=low, high=high
        )
        axes.set_title(fields.labels[method])
    relative = f"{fields.quantity} relative to {fields.zero_text}"
    style.colour_bar(panels[0], shown, relative if linear else fields.level_text(floor_db))
    if fields.is_field:
        _draw_phases(panels[1], fields, floor_db, across[1], up[1])
    elif rows == 2:
        _draw_differences(panels[1], fields, compared_db, across[1], up[1])
    for axes in panels.flat:
        for lines in cuts:
            style.draw_cut(axes, lines, "kw")
    for axes in panels.flat:
        axes.set(xlabel=across[0], ylabel=up[0])
        axes.label_outer()
    style.write_title(figure, title)
    return figure


def _axes(found: Any, dims: tuple[str, ...]) -> tuple[Axis, Axis]:
    """The axes across and up; z, along which beams go, is never the one upwards."""
    if len(dims) != 2:
        raise ArgumentError(f"expected fields over two axes, got them over {', '.join(dims)}")
    places = {d: even_axis(d, np.asarray(found[d].values, dtype=np.float64)) for d in dims}
    unit = length_unit(max(float(np.ptp(p)) for p in places.values()))
    first, second = ((style.axis_label(d, unit), p / unit.metres) for d, p in places.items())
    return (second, first) if dims[1] == "z" else (first, second)


def _cuts(found: Any, dims: tuple[str, ...], obstacles: Any) -> list[Floats]:
    """Lines (k, 2, 2) in which the plane of a field cuts obstacles, in the units of its axes."""
    bodies = bodies_if_any(obstacles)
    if not bodies:
        return []
    places = [np.asarray(found[d].values, dtype=np.float64) for d in dims]

    def point(*numbers: int) -> Floats:
        at = dict(zip(dims, numbers, strict=True))
        own = (found[c].isel({d: n for d, n in at.items() if d in found[c].dims}) for c in "xyz")
        return np.array([float(c) for c in own])

    corner = point(0, 0)
    along = np.array([point(-1, 0) - corner, point(0, -1) - corner])
    along /= np.array([np.ptp(p) for p in places])[:, None]
    origin = corner - places[0][0] * along[0] - places[1][0] * along[1]
    metres = length_unit(max(float(np.ptp(p)) for p in places)).metres
    lines = [obstacle_of(body).cut(origin, along) / metres for body in bodies]
    return [line[..., ::-1] if dims[1] == "z" else line for line in lines]


def _upright(values: NDArray[Any], fields: Comparison) -> NDArray[Any]:
    """Values with the axis upwards first."""
    return values if fields.dims[1] == "z" else values.T


def _draw_phases(
    panels: Any, fields: Comparison, floor_db: float, across: Floats, up: Floats
) -> None:
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize

    for axes, (method, field) in zip(panels, fields.fields.items(), strict=True):
        # Noise around nulls has a phase as well: it fades with the level.
        strength = 1 - level_db(fields.powers[method], fields.zero, floor_db) / floor_db
        phases = _upright(np.degrees(np.angle(field)), fields)
        shown = style.draw_map(axes, phases, across, up, cmap=style.PHASE_MAP, vmin=-180, vmax=180)
        shown.set_alpha(_upright(np.clip(3 * strength, 0, 1), fields))
    # a bar of the images would be transparent as well
    opaque = ScalarMappable(Normalize(-180, 180), style.PHASE_MAP)
    style.colour_bar(panels, opaque, "phase (degrees)").set_ticks([-180, -90, 0, 90, 180])


def _draw_differences(
    panels: Any, fields: Comparison, compared_db: float, across: Floats, up: Floats
) -> None:
    reference = fields.powers[fields.against]
    differences = [difference_db(power, reference, compared_db) for power in fields.powers.values()]
    largest = max(float(np.nanmax(np.abs(each), initial=0.0)) for each in differences)
    bound = min(largest, _MOST_DB) or 1.0
    for axes, method, difference in zip(panels, fields.powers, differences, strict=True):
        if method == fields.against:
            axes.set_visible(False)
            continue
        shown = style.draw_signed(axes, _upright(difference, fields), across, up, bound=bound)
        axes.set_facecolor("0.85")
        axes.set_title(f"minus {fields.labels[fields.against]}", fontsize=8)
    text = f"difference (dB)\ngrey: below {style.number_text(compared_db)} dB"
    style.colour_bar(panels, shown, text, "both" if largest > bound else "neither")


@style.typeset
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
    figure : matplotlib Figure or SubFigure to draw on, which is returned; None: a new figure.

    Raises
    ------
    ArgumentError : no such quantity or method; other axes; a ``figure`` of another type.
    """
    check_floor(floor_db)
    if "directivity" in checked_dataset(found, "found"):
        raise ArgumentError(
            "expected fields on a hemisphere, got a radiation pattern, whose directivity is in dBi "
            "already; use draw_pattern"
        )
    fields = Comparison.of(found, against)
    if sorted(fields.dims) != ["phi", "theta"]:
        raise ArgumentError(
            f"expected fields over theta and phi, got them over {', '.join(fields.dims)}"
        )
    theta, phi = (np.asarray(found[d].values, dtype=np.float64) for d in ("theta", "phi"))
    size = _DISC * len(fields.powers) + 1.2, _DISC + 0.6
    figure = style.figure_on(figure, *size, is_compressed=True)
    panels = figure.subplots(1, len(fields.powers), squeeze=False, sharey=True)[0]
    for axes, (method, power) in zip(panels, fields.powers.items(), strict=True):
        levels = level_db(power if fields.dims[0] == "theta" else power.T, fields.zero, floor_db)
        shown = style.draw_disc(axes, theta, phi, levels, floor_db, 0.0)
        axes.set(xlabel="$s_x$", title=fields.labels[method])
    panels[0].set_ylabel("$s_y$")
    style.colour_bar(panels, shown, fields.level_text(floor_db))
    style.write_title(figure, title)
    return figure
