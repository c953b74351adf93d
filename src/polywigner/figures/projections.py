"""Projections of the phase-space functions, on grids whose neighbours share an axis."""

from __future__ import annotations

from itertools import product
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from polywigner.errors import ArgumentError
from polywigner.figures import style
from polywigner.figures.levels import check_floor, checked_dataset, level_db
from polywigner.geometry.arguments import checked_choice
from polywigner.geometry.display import LengthUnit, length_unit

if TYPE_CHECKING:
    import xarray
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure, SubFigure


Layout = Literal["paper", "all"]

_COORDINATES = {
    "autocorrelation": ("x", "y", "xi_x", "xi_y"),
    "wigner": ("x", "y", "nu_x", "nu_y"),
    "ambiguity": ("upsilon_x", "upsilon_y", "xi_x", "xi_y"),
}
# Known names of some of the tiles.
_KNOWN = {
    ("autocorrelation", "x", "y"): "R_x",
    ("autocorrelation", "xi_x", "xi_y"): r"R_\xi",
    ("wigner", "x", "y"): "|u|^2",
    ("wigner", "nu_x", "nu_y"): "|F|^2",
    ("ambiguity", "upsilon_x", "upsilon_y"): r"F(\upsilon/2)\,F^*(-\upsilon/2)",
    ("ambiguity", "xi_x", "xi_y"): r"u(\xi/2)\,u^*(-\xi/2)",
}
_LETTERS = {"autocorrelation": "R", "wigner": "W", "ambiguity": "A"}

# Parts of the peak that rounding leaves where a tile is never negative.
_NEGATIVE = 1e-9

_INCHES = 3.3  # a panel with its colour bar


@style.typeset
def draw_projections(
    found: xarray.Dataset,
    layout: Layout = "paper",
    floor_db: float = -40.0,
    title: str = "",
    *,
    figure: Figure | SubFigure | None = None,
) -> Any:
    """The tiles of :func:`polywigner.projections`, each with its axes, unit and colour bar.

    Of the ambiguity function the real parts. Tiles that change sign are linear within 1 % of
    their peak and logarithmic beyond; power spectra are in dB; all others are linear.

    Parameters
    ----------
    found : from :func:`polywigner.projections`, with all its tiles.
    layout : "paper", two rows of two: both diagonal tiles keep one kind of coordinate, the others a
        position with the frequency (or lag) along it. "all": all six pairs, in a triangle. Tiles in
        a column share the axis below it, those in a row the axis to the left. Slits have one tile.
    floor_db : lowest level of power spectra, dB relative to their largest value.
    title : above the panels.
    figure : matplotlib Figure or SubFigure to draw on, which is returned; None: a new figure.

    Raises
    ------
    ArgumentError for another layout, tiles that are missing, fewer than two samples on an axis, and
    a ``figure`` of another type.
    """
    check_floor(floor_db)
    cells = _cells(found, layout)
    axes_of_tiles = {d for _, *pair in cells.values() for d in pair}
    if min(found.sizes[name] for name in axes_of_tiles) < 2:
        raise ArgumentError("expected at least two samples along each axis to draw, got one")
    lengths = [d for d in axes_of_tiles if not style.is_spectral(d)]
    unit = length_unit(max(float(np.ptp(found[d].values)) for d in lengths))
    rows, columns = (max(cell[k] for cell in cells) + 1 for k in (0, 1))
    size = _INCHES * columns + 0.5, _INCHES * rows * 0.92 + 0.4
    figure = style.figure_on(figure, *size, spacing=0.03)
    panels = figure.subplots(rows, columns, squeeze=False, sharex="col", sharey="row")
    for place, axes in np.ndenumerate(panels):
        if place not in cells:
            axes.set_axis_off()
            continue
        _draw(axes, found, cells[place], unit, floor_db)
        axes.tick_params(labelbottom=True)
        axes.set_xlabel(style.axis_label(cells[place][1], unit))
        if place[1] == 0:
            axes.set_ylabel(style.axis_label(cells[place][2], unit))
    style.write_title(figure, title)
    return figure


Cells = dict[tuple[int, int], tuple[str, str, str]]
"""(row, column) -> name of the tile there, and its coordinates to the right and upwards."""


def _cells(found: xarray.Dataset, layout: str) -> Cells:
    names = list(checked_dataset(found, "found").data_vars)
    if len(names) == 1 and not any("_" in d for d in found[names[0]].dims):
        return {(0, 0): (names[0], *found[names[0]].dims)}  # of slits
    p, q, r, s = _COORDINATES[found.attrs["kind"]]
    if checked_choice(layout, "layout", get_args(Layout)) == "paper":
        pairs = {(j, i): ((p, s)[i], (q, r)[j]) for i, j in product(range(2), repeat=2)}
    else:
        pairs = {(j, i): ((p, q, r)[i], (q, r, s)[j]) for i in range(3) for j in range(i, 3)}
    named = {frozenset(found[name].dims): name for name in names}
    for across, up in pairs.values():
        if frozenset((across, up)) not in named:
            raise ArgumentError(
                f"expected projections with all their tiles, got none of {across} and {up}; "
                "leave out tiles="
            )
    return {cell: (named[frozenset(pair)], *pair) for cell, pair in pairs.items()}


def _draw(
    axes: Axes, found: xarray.Dataset, cell: tuple[str, str, str], unit: LengthUnit, floor_db: float
) -> None:
    name, across, up = cell
    tile = found[name]
    values = np.real(np.asarray(tile.values))
    values = values.T if tile.dims == (across, up) else values
    peak = float(np.max(np.abs(values))) or 1.0
    size = _size(peak, tile.attrs["units"], unit)
    places = [_printed(found, name, unit) for name in (across, up)]
    how: dict[str, Any] = {"shading": "nearest", "label": f"relative to {size}"}
    if values.min() < -_NEGATIVE * peak:
        style.draw_signed(axes, values / peak, *places, **how)
    elif style.is_spectral(across) or style.is_spectral(up):
        how |= {"low": floor_db, "label": f"dB relative to {size}"}
        style.draw_levels(axes, level_db(values, peak, floor_db), *places, **how)
    else:
        how |= {"low": 0.0, "high": None, "label": _unit_text(tile.attrs["units"], unit)}
        style.draw_levels(axes, values / _measure(tile.attrs["units"], unit), *places, **how)
    axes.set_title(_integral(found.attrs["kind"], tile.dims, np.iscomplexobj(tile.values)))


def _printed(found: xarray.Dataset, name: str, unit: LengthUnit) -> NDArray[np.float64]:
    values = np.asarray(found[name].values)
    return values * unit.metres if style.is_spectral(name) else values / unit.metres


def _measure(units: str, unit: LengthUnit) -> float:
    """The unit to print, in metres to some power."""
    return float(unit.metres ** {"1": 0, "m": 1, "m2": 2, "m4": 4}[units])


def _unit_text(units: str, unit: LengthUnit) -> str:
    return "" if units == "1" else unit.name + {"m": "", "m2": "²", "m4": "⁴"}[units]


def _size(peak: float, units: str, unit: LengthUnit) -> str:
    """A peak with three digits: 2.56·10⁴ mm⁴."""
    digits, _, power = f"{peak / _measure(units, unit):.3g}".partition("e")
    times = rf"$\,\cdot\,10^{{{int(power)}}}$" if power else ""
    return f"{digits}{times} {_unit_text(units, unit)}".rstrip()


def _integral(kind: str, kept: tuple[str, ...], is_complex: bool) -> str:
    """The quantity shown, as a formula: the function and the coordinates it was integrated over."""
    letter = _LETTERS[kind]
    left_out = [n for n in _COORDINATES[kind] if n not in kept]
    real = r"\mathrm{Re}\," if is_complex else ""
    if len(left_out) != 2:
        return f"${real}{letter}$"
    measure = r"\,".join(rf"\mathrm{{d}}{style.latex(n)}" for n in left_out)
    known = _KNOWN.get((kind, kept[0], kept[1]))
    return rf"$\iint {real}{letter}\;{measure}{f' = {real}{known}' if known else ''}$"
