"""The figures of ``polywigner transform``, ``psf`` and ``mtf``, and the values behind them."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import cycle, product
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

import polywigner as pw
from polywigner.errors import ArgumentError
from polywigner.figures import style
from polywigner.figures.levels import check_floor, checked_dataset, level_db
from polywigner.geometry.arguments import (
    checked_count,
    checked_flag,
    checked_vectors,
    checked_wavelength,
)
from polywigner.geometry.display import LengthUnit, length_unit
from polywigner.source.support import mutual_support
from polywigner.transforms.wavefronts import flat_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure, SubFigure


LARGEST_SAMPLES = 4096
"""Along each axis: an array of as many complex squares holds 256 MiB."""

_LOBES = 8.0
"""Half width of the frequency axes without a wavelength, in 1/diameter: five lobes of a square."""


@dataclass(frozen=True)
class TransformSlices:
    """Values of the transforms of one source; lengths in metres.

    ``fourier`` (n, n) complex, ``wigner`` (n, n) real and ``ambiguity`` (n, n) complex, all in
    m^2, with the second frequency component along the first axis: ``fourier[j, i]`` belongs to
    (frequency[i], frequency[j]). ``frequency`` (n,) in 1/m is the axis of nu and of upsilon.
    """

    source: pw.Aperture | pw.Array | pw.Wavefront
    aperture: pw.Aperture
    """Outline of the source; for an array, the outline of all elements."""
    support: pw.Aperture
    """The automean, or a region around it: where W may differ from zero."""
    x: tuple[float, float]
    xi: tuple[float, float]
    wavelength: float | None
    frequency: NDArray[np.float64]
    fourier: NDArray[np.complex128]
    wigner: NDArray[np.float64]
    ambiguity: NDArray[np.complex128]


def transform_slices(
    source: pw.Aperture | pw.Array | pw.Wavefront,
    x: ArrayLike | None = None,
    xi: ArrayLike | None = None,
    wavelength: float | None = None,
    samples: int = 257,
    zoomed: bool = False,
) -> TransformSlices:
    """F(nu), W(x, nu) at one position and A(upsilon, xi) at one lag, on a square of frequencies.

    Parameters
    ----------
    source : an aperture with its field, or an array of apertures in the plane z = 0; or one with a
        curved wave; metres.
    x : (2,) m, inside the automean; None: the centre of the bounds if it is inside, else a point
        inside.
    xi : (2,) m, a lag at which the aperture overlaps itself; None: a quarter of the width, or of
        the height, or a sixteenth, whichever first leaves a quarter of the area.
    wavelength : m; the axes reach to |nu| = 1/wavelength. None: to 8/diameter.
    samples : points along each axis, from 2 to 4096; an odd number has nu = 0 among them.
    zoomed : whether axes reach to 8/diameter with a wavelength as well.

    Raises
    ------
    ArgumentError : anything but such a source; W vanishes at this x, or A at this xi, for every
    frequency; too few or too many samples.
    GeometryError : elements of an array that do not lie in the plane z = 0.
    """
    checked_count(samples, "samples", 2, LARGEST_SAMPLES)
    aperture, support = outline_of(source), mutual_support(flat_of(source))
    position = default_position(support, aperture.centre) if x is None else _point(x)
    lag = _default_lag(aperture) if xi is None else _point(xi)
    _check_supports(aperture, support, position, lag)
    half = _half_width(aperture, None if checked_flag(zoomed, "zoomed") else wavelength)
    frequency = np.linspace(-half, half, samples)
    grid = np.stack(np.meshgrid(frequency, frequency), axis=-1)
    in_plane: Any = source  # whose Fourier transform takes two components of nu
    if isinstance(source, pw.Array) and source.dimension == 3:
        in_plane = pw.Array(source.elements_in_plane, source.weights)
    fourier, wigner = pw.fourier(in_plane, grid), pw.wigner(source, position, grid)
    values = frequency, fourier, wigner, pw.ambiguity(source, grid, lag)
    return TransformSlices(source, aperture, support, position, lag, wavelength, *values)


def outline_of(source: pw.Aperture | pw.Array | pw.Wavefront) -> pw.Aperture:
    """The aperture itself, or the union of an array's elements; ArgumentError for others.

    Of a source with a curved wave that of its flat source.
    """
    source = flat_of(source)
    if isinstance(source, pw.Aperture):
        return source
    if not isinstance(source, pw.Array) or source.dimension == 1:
        got = "slits" if isinstance(source, pw.Array) else type(source).__name__
        raise ArgumentError(f"expected an aperture, or an array of apertures, got {got}")
    return source.support


def samples_needed(aperture: pw.Aperture, wavelength: float | None) -> int:
    """Samples along each axis that show all of |F|^2, W and A between them.

    Parameters
    ----------
    aperture : the outline of the source.
    wavelength : as for :func:`transform_slices`.
    """
    aperture = outline_of(aperture)
    found = pw.suggest_sampling(aperture, reach=_half_width(aperture, wavelength))
    return max(axis.count for axis in found.axes)


def _half_width(aperture: pw.Aperture, wavelength: float | None) -> float:
    return _LOBES / aperture.diameter if wavelength is None else 1 / checked_wavelength(wavelength)


def _point(value: ArrayLike) -> tuple[float, float]:
    x, y = checked_vectors(value, "expected two coordinates", (2,)).ravel()
    return float(x), float(y)


def default_position(support: pw.Aperture, middle: NDArray[np.float64]) -> tuple[float, float]:
    import shapely

    centre = shapely.Point(middle)
    # A representative point keeps its distance from the boundary, where W vanishes.
    region = support.polygons
    inside = centre if region.contains(centre) else region.representative_point()
    return inside.x, inside.y


def _default_lag(aperture: pw.Aperture) -> tuple[float, float]:
    """A lag that keeps a good part of the overlap, so that A differs from F and is not small."""
    xmin, ymin, xmax, ymax = aperture.bounds
    width, height = xmax - xmin, ymax - ymin
    for lag in ((width / 4, 0.0), (0.0, height / 4), (width / 16, 0.0), (0.0, height / 16)):
        if pw.position_slice(aperture, lag).area > aperture.area / 4:
            return lag
    return 0.0, 0.0


def _check_supports(
    aperture: pw.Aperture, support: pw.Aperture, x: tuple[float, float], xi: tuple[float, float]
) -> None:
    if not pw.lag_slice(aperture, x).area > 0:
        bounds = ", ".join(f"{b:.4g}" for b in support.bounds)
        raise ArgumentError(
            f"expected a position x inside the automean (bounds {bounds} m), where W is not zero, "
            f"got ({x[0]:.4g}, {x[1]:.4g}) m; give another, with its unit"
        )
    if not pw.position_slice(aperture, xi).area > 0:
        raise ArgumentError(
            "expected a lag xi at which the aperture overlaps its shifted copy, got "
            f"({xi[0]:.4g}, {xi[1]:.4g}) m, where A is zero; give another, with its unit"
        )


# Half range of frequencies, in lobes 1/width of the source.
_SYSTEM_LOBES = 4.0
# The spot is where the irradiance exceeds this fraction of its peak on so many coarse samples.
_SPOT, _COARSE = 0.01, 65
# Ratio of its sides from which a spot is a line.
_LINE = 4.0


@dataclass(frozen=True)
class SystemSlices:
    """W and the light of a source before and behind a system, in SI units.

    ``before`` (n, n) is W at ((x[i], y), (nu[j], 0)), in m^2; ``behind`` (n, n) that at
    ((x_out[i], y_out), (nu_out[j], nu_y)), where the ray through the centre, (y_out, nu_y), leaves
    the system. ``light`` (n, n) is |U|^2 at (across[i], up[j]) behind it.
    """

    source: pw.Aperture | pw.Array
    aperture: pw.Aperture
    system: pw.FirstOrder
    wavelength: float
    x: NDArray[np.float64]
    nu: NDArray[np.float64]
    before: NDArray[np.float64]
    x_out: NDArray[np.float64]
    nu_out: NDArray[np.float64]
    behind: NDArray[np.float64]
    across: NDArray[np.float64]
    up: NDArray[np.float64]
    light: NDArray[np.float64]


def system_slices(
    source: pw.Aperture | pw.Array, system: pw.FirstOrder, wavelength: float, samples: int = 257
) -> SystemSlices:
    """W of a source over x and nu_x before and behind a system, and the irradiance behind it.

    Parameters
    ----------
    source : an aperture with its field, or an array of apertures in the plane z = 0; metres.
    system : the optical system between the source and the plane behind.
    wavelength : m.
    samples : points along each axis, from 2 to 4096.

    Raises
    ------
    ArgumentError : anything but such arguments; too few or too many samples.
    """
    checked_count(samples, "samples", 2, LARGEST_SAMPLES)
    wavelength = checked_wavelength(wavelength)
    if not isinstance(system, pw.FirstOrder):
        raise ArgumentError(f"expected a FirstOrder system, got {type(system).__name__}")
    aperture, support = outline_of(source), mutual_support(flat_of(source))
    middle = np.array(default_position(support, aperture.centre))
    xmin, ymin, xmax, ymax = support.bounds
    width = np.array([xmax - xmin, ymax - ymin])
    sides = np.array([xmin, xmax]) + np.array([-0.1, 0.1]) * width[0]
    x = _axis(sides, samples)
    nu = np.linspace(-_SYSTEM_LOBES / width[0], _SYSTEM_LOBES / width[0], samples)
    grid = np.meshgrid(x, nu)
    before = pw.wigner(source, _pairs(grid[0], middle[1]), _pairs(grid[1], 0.0))
    # the corners of that section, as rays
    ends = np.array(list(product(sides, nu[[0, -1]])))
    corners = system.rays(_pairs(ends[:, 0], middle[1]), wavelength * _pairs(ends[:, 1], 0.0))
    y_out, s_out = system.rays(middle, np.zeros(2))
    x_out = _axis(corners[0][:, 0], samples)
    nu_out = _axis(corners[1][:, 0] / wavelength, samples)
    grid = np.meshgrid(x_out, nu_out)
    rays = _pairs(grid[0], y_out[1]), _pairs(grid[1], s_out[1] / wavelength)
    behind = pw.wigner(source, *rays, through=system, wavelength=wavelength)
    slope = wavelength * _SYSTEM_LOBES / width
    starts = np.array(list(product(sides, (ymin, ymax), (-1, 1), (-1, 1))))
    bright = system.rays(starts[:, :2], starts[:, 2:] * slope)[0]

    def light_at(x: Any, y: Any, tolerance: float) -> Any:
        points = np.stack(np.meshgrid(x, y), axis=-1)
        return pw.irradiance(source, points, wavelength, through=system, tolerance=tolerance)

    across, up = (_axis(values, _COARSE) for values in bright.T)
    spot = _spot(across, up, light_at(across, up, 0.1 * _SPOT))
    across, up = (_axis(ends, samples) for ends in spot)
    light = light_at(across, up, 1e-6)
    return SystemSlices(
        source, aperture, system, wavelength, x, nu, before, x_out, nu_out, behind, across, up,
        light,
    )  # fmt: skip


def _spot(
    across: NDArray[np.float64], up: NDArray[np.float64], light: NDArray[np.float64]
) -> list[NDArray[np.float64]]:
    """Return the ends of both axes of the part in which light (up, across) is bright."""
    bright = light >= _SPOT * light.max()
    ends = []
    for places, rows in ((across, bright.any(axis=0)), (up, bright.any(axis=1))):
        at = np.flatnonzero(rows)
        first, last = max(at[0] - 2, 0), min(at[-1] + 2, len(places) - 1)
        ends.append(places[[first, last]])
    return ends


def _pairs(first: Any, second: float) -> NDArray[np.float64]:
    return np.stack([first, np.full_like(first, second)], axis=-1)


def _axis(values: NDArray[np.float64], samples: int) -> NDArray[np.float64]:
    return np.linspace(values.min(), values.max(), samples)


@style.typeset
def draw_transforms(
    slices: TransformSlices | SystemSlices,
    floor_db: float,
    title: str = "",
    *,
    figure: Figure | SubFigure | None = None,
) -> Any:
    """Six panels: the aperture with its automean, |F|^2, Re F, the lag slice, W and Re A.

    Through a system four: the aperture, W over x and direction, and the light and W behind.

    Parameters
    ----------
    slices : from :func:`polywigner.figures.transform_slices`, or through a system from
        :func:`polywigner.figures.system_slices`.
    floor_db : lowest level of |F|^2, dB relative to |F(0)|^2, the largest value that the
        transform of a uniform aperture has; of other sources, and of the light behind a system, to
        the largest value shown.
    title : above the panels, before the wavelength.
    figure : matplotlib Figure or SubFigure to draw on, which is returned; None: a new figure.

    Raises
    ------
    ArgumentError : a floor that is not below zero; a ``figure`` of another type.
    """
    check_floor(floor_db)
    if not isinstance(slices, (SystemSlices, TransformSlices)):
        raise ArgumentError(
            f"expected slices as transform_slices returns them, got {type(slices).__name__}"
        )
    if isinstance(slices, SystemSlices):
        figure = style.figure_on(figure, 9.4, 7.2, spacing=0.04)
        _draw_system_panels(figure.subplots(2, 2), slices, floor_db)
        style.write_title(figure, _heading(title, slices.wavelength, ""))
        return figure
    unit = length_unit(slices.aperture.diameter)
    figure = style.figure_on(figure, 11.6, 6.9, spacing=0.04)
    panels = figure.subplots(2, 3).ravel()
    _draw_supports(panels[0], slices, unit)
    _draw_power(panels[1], slices, unit, floor_db)
    _draw_real(panels[2], slices, slices.fourier.real, unit, "Re F(ν)", "nu")
    _draw_lag_slice(panels[3], slices, unit)
    _draw_real(panels[4], slices, slices.wigner, unit, "W(x, ν)", "nu")
    _draw_real(panels[5], slices, slices.ambiguity.real, unit, "Re A(υ, ξ)", "upsilon")
    style.letter_panels(panels)
    zoomed = slices.frequency[-1] * (slices.wavelength or 0.0) < 0.5
    note = "" if zoomed else ", dotted circle: |ν| = 1/λ"
    style.write_title(figure, _heading(title, slices.wavelength, note))
    return figure


def _draw_system_panels(axes: Any, slices: SystemSlices, floor_db: float) -> None:
    """The aperture, W before, the light behind, and W behind, on (2, 2) axes."""
    unit = length_unit(slices.aperture.diameter)
    aperture, before, light, behind = axes.ravel()
    style.draw_polygons(
        aperture, slices.aperture.polygons, unit, facecolor=style.INK, edgecolor="none"
    )
    aperture.set_title("aperture")
    style.length_axes(aperture, "x", unit)
    _draw_section(before, slices, slices.x, slices.nu, slices.before, "W(x, ν) before")
    widths = [float(np.ptp(points)) for points in (slices.across, slices.up)]
    # a line focus fills its panel only with a scale of its own along each axis
    is_line = max(widths) > _LINE * min(widths)
    units = [length_unit(width if is_line else max(widths)) for width in widths]
    peak = float(slices.light.max())
    points = slices.across / units[0].metres, slices.up / units[1].metres
    style.draw_levels(
        light, level_db(slices.light, peak, floor_db), *points, low=floor_db, interpolation=None,
        label=f"dB relative to {peak:.3g}, {style.floor_text(floor_db)}",
        aspect="auto" if is_line else "equal",
    )  # fmt: skip
    x, y = (style.axis_label(name, unit) for name, unit in zip("xy", units, strict=True))
    light.set(title="|U|² behind", xlabel=x, ylabel=y)
    _draw_section(behind, slices, slices.x_out, slices.nu_out, slices.behind, "W(x, ν) behind")
    style.letter_panels(axes.ravel())


def _draw_section(
    axes: Axes, slices: SystemSlices, x: Any, nu: Any, values: Any, title: str
) -> None:
    """W over x and the direction lambda nu, in units of the largest before the system."""
    unit = length_unit(float(np.ptp(x)))
    peak = float(np.abs(slices.before).max())
    directions = nu * slices.wavelength * 1e3
    style.draw_signed(
        axes, values / peak, x / unit.metres, directions, label="W / peak before", aspect="auto"
    )
    axes.set(title=title, xlabel=f"$x$ ({unit.name})", ylabel=r"$\lambda\nu_x$ (mrad)")


def _draw_supports(axes: Axes, slices: TransformSlices, unit: LengthUnit) -> None:
    array = isinstance(flat_of(slices.source), pw.Array)
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
    axes.legend(
        loc="upper center", bbox_to_anchor=(0.5, -0.16), ncols=columns, frameon=False,
        fontsize=7.5, handlelength=1.2, handletextpad=0.5, columnspacing=1.0,
    )  # fmt: skip


def _draw_power(axes: Axes, slices: TransformSlices, unit: LengthUnit, floor_db: float) -> None:
    power = np.abs(slices.fourier) ** 2
    uniform = isinstance(slices.source, pw.Aperture) and slices.source.illumination is None
    reference = slices.aperture.area**2 if uniform else float(power.max())
    places = slices.frequency * unit.metres
    levels = level_db(power, reference, floor_db)
    zero = "|F(0)|²" if uniform else "the peak shown"
    label = f"dB relative to {zero}, {style.floor_text(floor_db)}"
    style.draw_levels(axes, levels, places, places, low=floor_db, label=label)
    axes.set_title("|F(ν)|²")
    _frequency_axes(axes, "nu", unit, slices.wavelength, "white")


def _draw_real(
    axes: Axes, slices: TransformSlices, values: Any, unit: LengthUnit, name: str, symbol: str
) -> None:
    peak = float(np.max(np.abs(values)))
    places = slices.frequency * unit.metres
    label = f"{name} / ({peak / unit.metres**2:.4g} {unit.name}²)"
    style.draw_signed(axes, values / peak, places, places, label=label)
    axes.set_title(name)
    _frequency_axes(axes, symbol, unit, slices.wavelength, "0.35")


def _frequency_axes(
    axes: Axes, symbol: str, unit: LengthUnit, wavelength: float | None, ink: str
) -> None:
    # beyond the axes it would be drawn as millions of dots
    if wavelength is not None and unit.metres / wavelength < 2 * max(axes.get_xlim()):
        style.mark_evanescent(axes, wavelength, unit, ink)
    style.label_axes(axes, symbol, unit)


def _point_text(point: tuple[float, float], unit: LengthUnit) -> str:
    first, second = (f"{value / unit.metres:.4g}" for value in point)
    return f"({first}, {second}) {unit.name}"


def _heading(title: str, wavelength: float | None, note: str) -> str:
    if wavelength is None:
        return title
    unit = length_unit(wavelength)
    marked = f"λ = {wavelength / unit.metres:.4g} {unit.name}{note}"
    return f"{title}; {marked}" if title else marked


# ---- lenses -------------------------------------------------------------------------------------

_DASHES = ("-", "--", "-.", ":")
# Curves that are no further apart are one line.
_ALIKE = 2e-3


@style.typeset
def draw_psf(found: Any, floor_db: float = -40.0, title: str = "", *, figure: Any = None) -> Any:
    """Draw point spread functions, a panel for each defocus.

    Parameters
    ----------
    found : xarray.Dataset with ``psf`` (defocus, y, x) in 1/m^2, x and y in m.
    floor_db : lowest level, dB below the largest value of all panels.
    title : above the panels.
    figure : matplotlib Figure or SubFigure to draw on, which is returned; None: a new figure.

    Raises
    ------
    ArgumentError : a floor that is not below zero, a ``figure`` of another type, and no dataset.
    """
    check_floor(floor_db)
    spots = _checked_lens(found, "psf", ("defocus", "y", "x"))
    unit = length_unit(float(np.ptp(found["x"].values)))
    peak = float(spots.max())
    count = spots.sizes["defocus"]
    figure = style.figure_on(figure, 2.4 + 2.6 * count, 3.5)
    panels = figure.subplots(1, count, sharey=True, squeeze=False)[0]
    across, up = (found[name].values / unit.metres for name in ("x", "y"))
    for axes, spot in zip(panels, spots, strict=True):
        levels = level_db(spot.values, peak, floor_db)
        shown = style.draw_levels(axes, levels, across, up, low=floor_db)
        axes.set_title(_of_focus(spot))
        style.length_axes(axes, "x", unit)
        axes.set_adjustable("box")
        axes.label_outer()
    style.colour_bar(panels, shown, f"dB relative to {peak:.3g} /m², {style.floor_text(floor_db)}")
    style.write_title(figure, title)
    return figure


@style.typeset
def draw_mtf(found: Any, title: str = "", *, figure: Any = None) -> Any:
    """Draw modulation transfer functions along x and y, a style of lines for each defocus.

    Parameters
    ----------
    found : xarray.Dataset with ``mtf`` (defocus, direction, frequency), frequency in cycles/mm.
    title : above the panel.
    figure : matplotlib Figure or SubFigure to draw on, which is returned; None: a new figure.

    Raises
    ------
    ArgumentError : a ``figure`` of another type, and no dataset.
    """
    curves = _checked_lens(found, "mtf", ("defocus", "direction", "frequency"))
    figure = style.figure_on(figure, 6.4, 3.8)
    axes = figure.subplots()
    frequency = found["frequency"].values
    for part, dashes in zip(curves, cycle(_DASHES), strict=False):
        lines = dict(zip(("along x", "along y"), part.values, strict=True))
        if np.ptp(part.values, axis=0).max() <= _ALIKE:
            lines = {"along x and y": part.values[0]}
        state = f", {_of_focus(part)}" if len(curves) > 1 or float(part["defocus"]) else ""
        for (name, line), colour in zip(lines.items(), (style.RED, style.BLUE), strict=False):
            axes.plot(frequency, line, color=colour, ls=dashes, label=name + state)
    style.finish_lines(
        axes, legend=9, xlim=(0.0, frequency.max()), ylim=(0.0, 1.05),
        xlabel="frequency (cycles/mm)", ylabel="modulation transfer function",
    )  # fmt: skip
    style.write_title(figure, title)
    return figure


def _of_focus(part: Any) -> str:
    waves = float(part["defocus"])
    return f"{waves:g} waves of defocus" if waves else "in focus"


def _checked_lens(found: Any, name: str, dims: tuple[str, ...]) -> Any:
    values = checked_dataset(found, "found").get(name)
    if values is None or values.dims != dims or not all(dim in found.coords for dim in dims):
        raise ArgumentError(
            f"expected found with {name} over {', '.join(dims)}, got a dataset without; give one "
            f"that polywigner {name} writes"
        )
    return values
