"""Fields on planes and hemispheres: levels in dB and phases, by several methods side by side."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from polywigner.errors import ArgumentError
from polywigner.figures import style
from polywigner.figures.fields import Comparison, even_axis
from polywigner.figures.levels import (
    COMPARED_DB,
    check_floor,
    checked_dataset,
    difference_db,
    level_db,
)
from polywigner.geometry.arguments import checked_flag
from polywigner.geometry.display import length_unit
from polywigner.geometry.silhouettes import bodies_if_any, obstacle_of

if TYPE_CHECKING:
    from matplotlib.figure import Figure, SubFigure


Floats = NDArray[np.float64]
Axis = tuple[str, Floats]
"""The label of an axis, and places along it in the unit that the label names."""

# Width of a panel without its colour bar: of several maps, of one alone, of a disc.
_INCHES, _ALONE, _DISC = 3.0, 4.8, 3.3
_MOST_DB = 3.0
"""Largest difference with a colour of its own."""


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
    for axes, (method, power) in zip(panels[0], fields.powers.items(), strict=True):
        if linear:
            values, low, high = power / fields.zero, 0.0, 1.0
        else:
            values, low, high = level_db(power, fields.zero, floor_db), floor_db, 0.0
        values = _upright(values, fields)
        shown = style.draw_levels(axes, values, across[1], up[1], low=low, high=high)
        axes.set_title(fields.labels[method])
    label = fields.linear_text if linear else fields.level_text(floor_db)
    style.colour_bar(panels[0], shown, label)
    if fields.is_field:
        _draw_phases(panels[1], fields, floor_db, across[1], up[1])
    elif rows == 2:
        _draw_differences(panels[1], fields, compared_db, across[1], up[1])
    for axes in panels.flat:
        for lines in cuts:
            style.draw_cut(axes, lines, "kw")
    for axes in panels[-1]:
        axes.set_xlabel(across[0])
    for axes in panels[:, 0]:
        axes.set_ylabel(up[0])
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
    # The pictures themselves are partly transparent.
    bar = style.colour_bar(
        panels, ScalarMappable(Normalize(-180, 180), style.PHASE_MAP), "phase (degrees)"
    )
    bar.set_ticks([-180, -90, 0, 90, 180])


def _draw_differences(
    panels: Any, fields: Comparison, compared_db: float, across: Floats, up: Floats
) -> None:
    reference = fields.powers[fields.against]
    differences = {
        method: difference_db(power, reference, compared_db)
        for method, power in fields.powers.items()
        if method != fields.against
    }
    largest = max(float(np.nanmax(np.abs(d), initial=0.0)) for d in differences.values())
    bound = min(largest, _MOST_DB) or 1.0
    for axes, method in zip(panels, fields.powers, strict=True):
        if method == fields.against:
            axes.set_visible(False)
            continue
        difference = _upright(differences[method], fields)
        shown = style.draw_signed(axes, difference, across, up, bound=bound)
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
    ArgumentError : no such quantity or method; other axes; what is no figure.
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
