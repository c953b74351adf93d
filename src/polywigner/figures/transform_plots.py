"""Figures of the transforms of a source, and of their projections on grids with shared axes."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

import polywigner as pw
from polywigner.errors import ArgumentError
from polywigner.figures import style
from polywigner.figures.levels import check_floor, checked_dataset, level_db
from polywigner.geometry.arguments import (
    checked_choice,
    checked_count,
    checked_flag,
    checked_type,
    checked_vectors,
    checked_wavelength,
)
from polywigner.quantities import LengthUnit, length_text, length_unit
from polywigner.source.array import mutual_support
from polywigner.transforms.projection import is_frequency
from polywigner.transforms.wavefronts import flat_source

if TYPE_CHECKING:
    import xarray
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure, SubFigure

LARGEST_SAMPLES = 4096
"""Largest number of samples along each axis. A complex array of this size takes 256 MiB."""

# Half width of the frequency axes [1/diameter] if the wavelength is unknown, wide enough for five
# lobes of a square.
_LOBES = 8.0

Point = tuple[float, float]


@dataclass(frozen=True)
class TransformSlices:
    """Values of a source's transforms over both components of the spatial frequency.

    The second frequency component varies along the first axis: ``fourier[j, i]`` is the value at
    (frequency[i], frequency[j]).
    """

    source: pw.Aperture | pw.Array | pw.Wavefront
    aperture: pw.Aperture
    """Outline of the source; for an array, the union of the elements."""
    support: pw.Aperture
    """Region outside which W is zero: the automean, or a region that contains it."""
    x: Point
    """Position of ``wigner`` in m."""
    xi: Point
    """Lag of ``ambiguity`` in m."""
    wavelength: float | None
    """Wavelength in m; None if unknown."""
    frequency: NDArray[np.float64]
    """Values (n,) of each component of nu and of upsilon in 1/m."""
    fourier: NDArray[np.complex128]
    """Fourier transform F in m^2, shape (n, n)."""
    wigner: NDArray[np.float64]
    """Wigner function W in m^2, shape (n, n)."""
    ambiguity: NDArray[np.complex128]
    """Ambiguity function A in m^2, shape (n, n)."""


def transform_slices(
    source: pw.Aperture | pw.Array | pw.Wavefront,
    x: ArrayLike | None = None,
    xi: ArrayLike | None = None,
    wavelength: float | None = None,
    samples: int = 257,
    zoomed: bool = False,
) -> TransformSlices:
    """Compute F(nu), W(x, nu) at a position and A(upsilon, xi) at a lag, on a frequency grid.

    Parameters
    ----------
    source : Aperture, Array or Wavefront
        Source in the plane z = 0.
    x : array_like, shape (2,), optional
        Position in m inside the automean. The default is the centre of the bounds if it is inside,
        otherwise another point inside.
    xi : array_like, shape (2,), optional
        Lag in m at which the aperture overlaps its shifted copy. The default is the first of 1/4 of
        the width, 1/4 of the height, 1/16 of the width and 1/16 of the height at which more than a
        quarter of the area overlaps.
    wavelength : float, optional
        Wavelength in m. The axes extend to |nu| = 1/wavelength; without a wavelength, they extend
        to 8/diameter.
    samples : int, default 257
        Number of samples along each axis, from 2 to 4096. Odd numbers include nu = 0.
    zoomed : bool, default False
        Whether the axes extend to 8/diameter even if a wavelength is specified.

    Returns
    -------
    TransformSlices
        Values and their axes.

    Raises
    ------
    ArgumentError
        If the source has another type, W is zero at x or A is zero at xi for all frequencies, or
        the number of samples is out of range.
    GeometryError
        If an element of an array does not lie in the plane z = 0.
    """
    checked_count(samples, "samples", 2, LARGEST_SAMPLES)
    aperture, support = outline_of(source), mutual_support(flat_source(source))
    position = _default_position(support, aperture.centre) if x is None else _checked_point(x)
    lag = _default_lag(aperture) if xi is None else _checked_point(xi)
    if not pw.lag_slice(aperture, position).area > 0:
        bounds = ", ".join(f"{b:.4g}" for b in support.bounds)
        raise ArgumentError(
            f"the position x must be inside the automean of the source (bounds {bounds} m), "
            f"because W is zero outside, got ({position[0]:.4g}, {position[1]:.4g}) m; check its "
            "unit"
        )
    if not pw.position_slice(aperture, lag).area > 0:
        raise ArgumentError(
            "the aperture must overlap its copy shifted by the lag xi, got "
            f"({lag[0]:.4g}, {lag[1]:.4g}) m, where A is zero; check its unit"
        )
    half = _half_width(aperture, None if checked_flag(zoomed, "zoomed") else wavelength)
    frequency = np.linspace(-half, half, samples)
    grid = np.stack(np.meshgrid(frequency, frequency), axis=-1)
    in_plane: Any = source  # Arrays in 3D do not accept nu with two components.
    if isinstance(source, pw.Array) and source.dimension == 3:
        in_plane = pw.Array(source.elements_in_plane, source.weights)
    fourier, wigner = pw.fourier(in_plane, grid), pw.wigner(source, position, grid)
    values = frequency, fourier, wigner, pw.ambiguity(source, grid, lag)
    return TransformSlices(source, aperture, support, position, lag, wavelength, *values)


def outline_of(source: pw.Aperture | pw.Array | pw.Wavefront) -> pw.Aperture:
    """Return the outline of an aperture, or the union of the elements of an array.

    Raises ArgumentError for other sources.
    """
    source = flat_source(source)
    if isinstance(source, pw.Aperture):
        return source
    if not isinstance(source, pw.Array) or source.dimension == 1:
        got = "slits" if isinstance(source, pw.Array) else type(source).__name__
        raise ArgumentError(f"expected an aperture, or an array of apertures, got {got}")
    return source.support


def samples_needed(aperture: pw.Aperture, wavelength: float | None) -> int:
    """Return the number of samples along each axis that resolve |F|^2, W and A.

    Parameters
    ----------
    aperture : Aperture
        Outline of the source.
    wavelength : float, optional
        Wavelength in m, as in :func:`transform_slices`.

    Returns
    -------
    int
        Number of samples.
    """
    aperture = outline_of(aperture)
    sampling = pw.suggest_sampling(aperture, reach=_half_width(aperture, wavelength))
    return max(axis.count for axis in sampling.axes)


def _half_width(aperture: pw.Aperture, wavelength: float | None) -> float:
    """Return the half width of the frequency axes in 1/m: 1/wavelength, or 8/diameter for None."""
    return _LOBES / aperture.diameter if wavelength is None else 1 / checked_wavelength(wavelength)


def _checked_point(value: ArrayLike) -> Point:
    """Return two coordinates as floats; raise ArgumentError for other values."""
    x, y = checked_vectors(value, "expected two coordinates", (2,)).ravel()
    return float(x), float(y)


def _default_position(support: pw.Aperture, centre: NDArray[np.float64]) -> Point:
    """Return the centre if it is inside a region, otherwise another point inside."""
    import shapely

    point, region = shapely.Point(centre), support.polygons
    inside = point if region.contains(point) else region.representative_point()
    return inside.x, inside.y


def _default_lag(aperture: pw.Aperture) -> Point:
    """Return a lag in m at which the aperture overlaps its shifted copy, by default (0, 0)."""
    xmin, ymin, xmax, ymax = aperture.bounds
    width, height = xmax - xmin, ymax - ymin
    for lag in ((width / 4, 0.0), (0.0, height / 4), (width / 16, 0.0), (0.0, height / 16)):
        if pw.position_slice(aperture, lag).area > aperture.area / 4:
            return lag
    return 0.0, 0.0


@style.typeset
def draw_transforms(
    slices: TransformSlices,
    floor_db: float,
    title: str = "",
    *,
    figure: Figure | SubFigure | None = None,
) -> Figure:
    """Draw the transforms of a source.

    The six panels are the aperture with its automean, |F|^2, Re F, the lag slice, W and Re A.

    Parameters
    ----------
    slices : TransformSlices
        Result of :func:`polywigner.figures.transform_slices`.
    floor_db : float
        Lowest level of |F|^2 in dB. 0 dB is |F(0)|^2 for a uniform aperture, and the largest value
        for other sources.
    title : str, optional
        Title of the figure, in addition to the wavelength.
    figure : matplotlib.figure.Figure or SubFigure, default a new figure
        Figure to draw on.

    Returns
    -------
    matplotlib.figure.Figure
        The figure.

    Raises
    ------
    ArgumentError
        If the floor is not below 0 dB, or ``figure`` has another type.
    """
    check_floor(floor_db)
    checked_type(slices, "slices to be the result of transform_slices", TransformSlices)
    unit = length_unit(slices.aperture.diameter)
    is_cropped = slices.frequency[-1] * (slices.wavelength or 0.0) < 0.5
    note = "" if is_cropped else ", dotted circle: |ν| = 1/λ"
    heading = _heading(title, slices.wavelength, note)
    figure = style.figure_on(figure, 11.6, 6.9, heading, spacing=0.04)
    panels = figure.subplots(2, 3).ravel()
    _draw_supports(panels[0], slices, unit)
    _draw_power(panels[1], slices, unit, floor_db)
    _draw_real(panels[2], slices, slices.fourier.real, unit, "Re F(ν)", "nu")
    _draw_lag_slice(panels[3], slices, unit)
    _draw_real(panels[4], slices, slices.wigner, unit, "W(x, ν)", "nu")
    _draw_real(panels[5], slices, slices.ambiguity.real, unit, "Re A(υ, ξ)", "upsilon")
    style.letter_panels(panels)
    return figure


def _draw_supports(axes: Axes, slices: TransformSlices, unit: LengthUnit) -> None:
    """Draw the aperture, the region outside which W is zero, and a position slice."""
    array = isinstance(flat_source(slices.source), pw.Array)
    support, aperture = ("W is 0 outside", "elements") if array else ("automean", "aperture")
    overlap = pw.position_slice(slices.aperture, slices.xi)
    for shape, face, edge, label in (
        (slices.support.polygons, style.TINT, "none", support),
        (slices.aperture.polygons, style.INK, "none", aperture),
        (overlap, "none", style.ACCENT, "position slice at ξ"),
    ):
        style.draw_polygons(axes, shape, unit, facecolor=face, edgecolor=edge, label=label)
    x = np.asarray(slices.x) / unit.metres
    axes.plot(*x, "+", color=style.ACCENT, markersize=8, markeredgewidth=1.4, label="x")
    _write_legend(axes, 4)
    axes.set_title(f"{aperture}; ξ = {_point_text(slices.xi, unit)}")
    style.length_axes(axes, "x", unit)


def _draw_lag_slice(axes: Axes, slices: TransformSlices, unit: LengthUnit) -> None:
    """Draw the lag slice at a position, and the two scaled apertures that overlap there."""
    from shapely.affinity import affine_transform

    x, y = slices.x
    for sign, dash, label in ((2, "-", "2(Γ − x)"), (-2, "--", "2(x − Γ)")):
        copy = affine_transform(slices.aperture.polygons, (sign, 0, 0, sign, -sign * x, -sign * y))
        style.draw_polygons(
            axes, copy, unit, facecolor="none", edgecolor=style.INK, linestyle=dash, label=label
        )
    lags = pw.lag_slice(slices.aperture, slices.x)
    style.draw_polygons(
        axes, lags, unit, facecolor=style.ACCENT, edgecolor="none", alpha=0.35, label="lag slice"
    )
    _write_legend(axes, 3)
    axes.set_title(f"lag slice at x = {_point_text(slices.x, unit)}")
    style.length_axes(axes, "xi", unit)


def _write_legend(axes: Axes, columns: int) -> None:
    """Write a legend below the axes."""
    axes.legend(
        loc="upper center", bbox_to_anchor=(0.5, -0.16), ncols=columns, frameon=False,
        fontsize=7.5, handlelength=1.2, handletextpad=0.5, columnspacing=1.0,
    )  # fmt: skip


def _draw_power(axes: Axes, slices: TransformSlices, unit: LengthUnit, floor_db: float) -> None:
    """Draw |F|^2 in dB over the spatial frequency."""
    power = np.abs(slices.fourier) ** 2
    uniform = isinstance(slices.source, pw.Aperture) and slices.source.illumination is None
    reference = slices.aperture.area**2 if uniform else float(power.max())
    nu = slices.frequency * unit.metres
    levels = level_db(power, reference, floor_db)
    zero = "|F(0)|²" if uniform else "the peak shown"
    label = f"dB relative to {zero}, {style.floor_text(floor_db)}"
    style.draw_levels(axes, levels, nu, nu, low=floor_db, label=label)
    axes.set_title("|F(ν)|²")
    _finish_frequency_axes(axes, "nu", unit, slices.wavelength, "white")


def _draw_real(
    axes: Axes, slices: TransformSlices, values: Any, unit: LengthUnit, name: str, symbol: str
) -> None:
    """Draw signed values over the spatial frequency, relative to their peak."""
    peak = float(np.max(np.abs(values)))
    frequency = slices.frequency * unit.metres
    label = f"{name} / ({peak / unit.metres**2:.4g} {unit.name}²)"
    style.draw_signed(axes, values / peak, frequency, frequency, label=label)
    axes.set_title(name)
    _finish_frequency_axes(axes, symbol, unit, slices.wavelength, "0.35")


def _finish_frequency_axes(
    axes: Axes, symbol: str, unit: LengthUnit, wavelength: float | None, ink: str
) -> None:
    """Label axes of spatial frequencies, and draw the circle |nu| = 1/wavelength."""
    # A dotted circle far outside the axes would consist of millions of dots.
    if wavelength is not None and unit.metres / wavelength < 2 * max(axes.get_xlim()):
        style.mark_evanescent(axes, wavelength, unit, ink)
    style.label_axes(axes, symbol, unit)


def _point_text(point: Point, unit: LengthUnit) -> str:
    """Return a point in m as text, such as "(1, 2) mm"."""
    first, second = (f"{value / unit.metres:.4g}" for value in point)
    return f"({first}, {second}) {unit.name}"


def _heading(title: str, wavelength: float | None, note: str) -> str:
    """Return a title with the wavelength and a note; without wavelength, the title alone."""
    if wavelength is None:
        return title
    text = f"λ = {length_text(wavelength)}{note}"
    return f"{title}; {text}" if title else text


Layout = Literal["paper", "all"]

_COORDINATES = {
    "autocorrelation": ("x", "y", "xi_x", "xi_y"),
    "wigner": ("x", "y", "nu_x", "nu_y"),
    "ambiguity": ("upsilon_x", "upsilon_y", "xi_x", "xi_y"),
}
# Formulas of some tiles without integrals, for the titles of the tiles.
_KNOWN = {
    ("autocorrelation", "x", "y"): "R_x",
    ("autocorrelation", "xi_x", "xi_y"): r"R_\xi",
    ("wigner", "x", "y"): "|u|^2",
    ("wigner", "nu_x", "nu_y"): "|F|^2",
    ("ambiguity", "upsilon_x", "upsilon_y"): r"F(\upsilon/2)\,F^*(-\upsilon/2)",
    ("ambiguity", "xi_x", "xi_y"): r"u(\xi/2)\,u^*(-\xi/2)",
}
_LETTERS = {"autocorrelation": "R", "wigner": "W", "ambiguity": "A"}

# Largest magnitude of negative values that count as rounding errors, as a fraction of the peak.
_NEGATIVE = 1e-9
_INCHES = 3.3  # width of a panel with its colour bar


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
    cells = _tiles_of_layout(dataset, layout)
    axes_of_tiles = {d for _, *pair in cells.values() for d in pair}
    if min(dataset.sizes[name] for name in axes_of_tiles) < 2:
        raise ArgumentError("a figure requires at least two samples along each axis, got one")
    lengths = [d for d in axes_of_tiles if not is_frequency(d)]
    unit = length_unit(max(float(np.ptp(dataset[d].values)) for d in lengths))
    rows, columns = (max(cell[k] for cell in cells) + 1 for k in (0, 1))
    size = _INCHES * columns + 0.5, _INCHES * rows * 0.92 + 0.4
    figure = style.figure_on(figure, *size, title, spacing=0.03)
    panels = figure.subplots(rows, columns, squeeze=False, sharex="col", sharey="row")
    for position, axes in np.ndenumerate(panels):
        if position not in cells:
            axes.set_axis_off()
            continue
        _draw_tile(axes, dataset, cells[position], unit, floor_db)
        axes.tick_params(labelbottom=True)
        axes.set_xlabel(style.axis_label(cells[position][1], unit))
        if position[1] == 0:
            axes.set_ylabel(style.axis_label(cells[position][2], unit))
    return figure


Cells = dict[tuple[int, ...], tuple[str, str, str]]
"""Name, horizontal coordinate and vertical coordinate of the tile at each (row, column)."""


def _tiles_of_layout(dataset: xarray.Dataset, layout: str) -> Cells:
    """Return the tiles of a layout; raise ArgumentError if a tile is missing."""
    names = list(checked_dataset(dataset).data_vars)
    if len(names) == 1 and not any("_" in d for d in dataset[names[0]].dims):
        # Slits have a single tile.
        return {(0, 0): (names[0], *dataset[names[0]].dims)}
    p, q, r, s = _COORDINATES[dataset.attrs["kind"]]
    if checked_choice(layout, "layout", get_args(Layout)) == "paper":
        pairs = {(j, i): ((p, s)[i], (q, r)[j]) for i, j in product(range(2), repeat=2)}
    else:
        pairs = {(j, i): ((p, q, r)[i], (q, r, s)[j]) for i in range(3) for j in range(i, 3)}
    named = {frozenset(dataset[name].dims): name for name in names}
    for across, up in pairs.values():
        if frozenset((across, up)) not in named:
            raise ArgumentError(
                f"the projections contain no tile over {across} and {up}; call "
                "polywigner.projections without the argument tiles"
            )
    return {cell: (named[frozenset(pair)], *pair) for cell, pair in pairs.items()}


def _draw_tile(
    axes: Axes, data: xarray.Dataset, cell: tuple[str, str, str], unit: LengthUnit, floor_db: float
) -> None:
    """Draw the values of a tile with its title and colour bar, but without axis labels.

    ``cell``: name, horizontal coordinate and vertical coordinate of the tile. Coordinates and
    values are converted to ``unit``. ``floor_db``, relative to the peak, applies only to tiles
    with a frequency axis and without negative values.
    """
    name, across, up = cell
    tile = data[name]
    values = np.real(np.asarray(tile.values))
    values = values.T if tile.dims == (across, up) else values
    peak = float(np.max(np.abs(values))) or 1.0
    power, exponent = {"1": (0, ""), "m": (1, ""), "m2": (2, "²"), "m4": (4, "⁴")}[
        tile.attrs["units"]
    ]
    scale, printed = float(unit.metres**power), unit.name + exponent if power else ""
    # For example, 2.56e+04 becomes 2.56·10⁴.
    digits, _, tens = f"{peak / scale:.3g}".partition("e")
    times = rf"$\,\cdot\,10^{{{int(tens)}}}$" if tens else ""
    size = f"{digits}{times} {printed}".rstrip()
    grid = [
        np.asarray(data[name].values) * unit.metres ** (1 if is_frequency(name) else -1)
        for name in (across, up)
    ]
    options: dict[str, Any] = {"shading": "nearest", "label": f"relative to {size}"}
    if values.min() < -_NEGATIVE * peak:
        style.draw_signed(axes, values / peak, *grid, **options)
    elif is_frequency(across) or is_frequency(up):
        options |= {"low": floor_db, "label": f"dB relative to {size}"}
        style.draw_levels(axes, level_db(values, peak, floor_db), *grid, **options)
    else:
        options |= {"low": 0.0, "high": None, "label": printed}
        style.draw_levels(axes, values / scale, *grid, **options)
    axes.set_title(_tile_title(data.attrs["kind"], tile.dims, np.iscomplexobj(tile.values)))


def _tile_title(kind: str, dims: tuple[str, ...], is_complex: bool) -> str:
    """Return the formula of a tile: an integral over the coordinates that the tile lacks."""
    letter = _LETTERS[kind]
    integrated = [name for name in _COORDINATES[kind] if name not in dims]
    real = r"\mathrm{Re}\," if is_complex else ""
    if len(integrated) != 2:
        return f"${real}{letter}$"
    measure = r"\,".join(rf"\mathrm{{d}}{style.latex(name)}" for name in integrated)
    known = _KNOWN.get((kind, dims[0], dims[1]))
    return rf"$\iint {real}{letter}\;{measure}{f' = {real}{known}' if known else ''}$"
