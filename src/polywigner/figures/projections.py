"""Figures of projections of the phase-space functions, on grids with shared axes."""

from __future__ import annotations

from itertools import product
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np

from polywigner.errors import ArgumentError
from polywigner.figures import style
from polywigner.figures.levels import check_floor, checked_dataset, level_db
from polywigner.geometry.arguments import checked_choice
from polywigner.quantities import LengthUnit, length_unit

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
# Closed forms of some tiles, for their titles.
_KNOWN = {
    ("autocorrelation", "x", "y"): "R_x",
    ("autocorrelation", "xi_x", "xi_y"): r"R_\xi",
    ("wigner", "x", "y"): "|u|^2",
    ("wigner", "nu_x", "nu_y"): "|F|^2",
    ("ambiguity", "upsilon_x", "upsilon_y"): r"F(\upsilon/2)\,F^*(-\upsilon/2)",
    ("ambiguity", "xi_x", "xi_y"): r"u(\xi/2)\,u^*(-\xi/2)",
}
_LETTERS = {"autocorrelation": "R", "wigner": "W", "ambiguity": "A"}

# Largest modulus of negative values that count as rounding errors, relative to the peak.
_NEGATIVE = 1e-9
# Width in inches of a panel with its colour bar.
_INCHES = 3.3


@style.typeset
def draw_projections(
    dataset: xarray.Dataset,
    layout: Layout = "paper",
    floor_db: float = -40.0,
    title: str = "",
    *,
    figure: Figure | SubFigure | None = None,
) -> Figure:
    """Draw the tiles of :func:`polywigner.projections` with axes, units and colour bars.

    The real parts of complex tiles are drawn. The scale of signed tiles is linear up to 1 % of the
    peak and logarithmic beyond; power spectra are in dB; the scale of other tiles is linear.

    Parameters
    ----------
    dataset : xarray.Dataset
        Result of :func:`polywigner.projections` with all tiles.
    layout : {"paper", "all"}
        "paper": two rows of two tiles. A tile on the diagonal has two coordinates of one kind; the
        other tiles have a position and its frequency (or lag). "all": a triangle of all six pairs
        of coordinates. Tiles in a column share the horizontal axis, and tiles in a row share the
        vertical axis. Slits have one tile.
    floor_db : float, default -40
        Lowest level of power spectra in dB relative to the peak.
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
        If the layout is unknown, tiles are missing, an axis has fewer than two samples, or
        ``figure`` has another type.
    """
    check_floor(floor_db)
    cells = _cells(dataset, layout)
    axes_of_tiles = {d for _, *pair in cells.values() for d in pair}
    if min(dataset.sizes[name] for name in axes_of_tiles) < 2:
        raise ArgumentError("expected at least two samples along each axis to draw, got one")
    lengths = [d for d in axes_of_tiles if not style.is_spectral(d)]
    unit = length_unit(max(float(np.ptp(dataset[d].values)) for d in lengths))
    rows, columns = (max(cell[k] for cell in cells) + 1 for k in (0, 1))
    size = _INCHES * columns + 0.5, _INCHES * rows * 0.92 + 0.4
    figure = style.figure_on(figure, *size, title, spacing=0.03)
    panels = figure.subplots(rows, columns, squeeze=False, sharex="col", sharey="row")
    for position, axes in np.ndenumerate(panels):
        if position not in cells:
            axes.set_axis_off()
            continue
        _draw(axes, dataset, cells[position], unit, floor_db)
        axes.tick_params(labelbottom=True)
        axes.set_xlabel(style.axis_label(cells[position][1], unit))
        if position[1] == 0:
            axes.set_ylabel(style.axis_label(cells[position][2], unit))
    return figure


Cells = dict[tuple[int, ...], tuple[str, str, str]]
"""Name, horizontal and vertical coordinate of the tile at each (row, column)."""


def _cells(dataset: xarray.Dataset, layout: str) -> Cells:
    names = list(checked_dataset(dataset, "dataset").data_vars)
    if len(names) == 1 and not any("_" in d for d in dataset[names[0]].dims):
        return {(0, 0): (names[0], *dataset[names[0]].dims)}  # a dataset of slits has a single tile
    p, q, r, s = _COORDINATES[dataset.attrs["kind"]]
    if checked_choice(layout, "layout", get_args(Layout)) == "paper":
        pairs = {(j, i): ((p, s)[i], (q, r)[j]) for i, j in product(range(2), repeat=2)}
    else:
        pairs = {(j, i): ((p, q, r)[i], (q, r, s)[j]) for i in range(3) for j in range(i, 3)}
    named = {frozenset(dataset[name].dims): name for name in names}
    for across, up in pairs.values():
        if frozenset((across, up)) not in named:
            raise ArgumentError(
                f"expected projections with all tiles, got no tile over {across} and {up}; call "
                "polywigner.projections without the argument tiles"
            )
    return {cell: (named[frozenset(pair)], *pair) for cell, pair in pairs.items()}


def _draw(
    axes: Axes, data: xarray.Dataset, cell: tuple[str, str, str], unit: LengthUnit, floor_db: float
) -> None:
    name, across, up = cell
    tile = data[name]
    values = np.real(np.asarray(tile.values))
    values = values.T if tile.dims == (across, up) else values
    peak = float(np.max(np.abs(values))) or 1.0
    power, exponent = {"1": (0, ""), "m": (1, ""), "m2": (2, "²"), "m4": (4, "⁴")}[
        tile.attrs["units"]
    ]
    scale, printed = float(unit.metres**power), unit.name + exponent if power else ""
    # the size is printed as, for example, 2.56·10⁴ mm⁴
    digits, _, tens = f"{peak / scale:.3g}".partition("e")
    times = rf"$\,\cdot\,10^{{{int(tens)}}}$" if tens else ""
    size = f"{digits}{times} {printed}".rstrip()
    grid = [
        np.asarray(data[name].values) * unit.metres ** (1 if style.is_spectral(name) else -1)
        for name in (across, up)
    ]
    options: dict[str, Any] = {"shading": "nearest", "label": f"relative to {size}"}
    if values.min() < -_NEGATIVE * peak:
        style.draw_signed(axes, values / peak, *grid, **options)
    elif style.is_spectral(across) or style.is_spectral(up):
        options |= {"low": floor_db, "label": f"dB relative to {size}"}
        style.draw_levels(axes, level_db(values, peak, floor_db), *grid, **options)
    else:
        options |= {"low": 0.0, "high": None, "label": printed}
        style.draw_levels(axes, values / scale, *grid, **options)
    axes.set_title(_integral(data.attrs["kind"], tile.dims, np.iscomplexobj(tile.values)))


def _integral(kind: str, dims: tuple[str, ...], is_complex: bool) -> str:
    """Return the quantity of a tile as a formula: a function with its variables of integration."""
    letter = _LETTERS[kind]
    integrated = [name for name in _COORDINATES[kind] if name not in dims]
    real = r"\mathrm{Re}\," if is_complex else ""
    if len(integrated) != 2:
        return f"${real}{letter}$"
    measure = r"\,".join(rf"\mathrm{{d}}{style.latex(name)}" for name in integrated)
    known = _KNOWN.get((kind, dims[0], dims[1]))
    return rf"$\iint {real}{letter}\;{measure}{f' = {real}{known}' if known else ''}$"
