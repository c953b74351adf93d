"""The figure of ``polywigner transform``: an aperture, its SFT, a Wigner and an ambiguity slice."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

import polywigner as pw
from polywigner.figures.levels import check_floor, level_db
from polywigner.figures.slices import TransformSlices
from polywigner.figures.style import (
    LEVEL_MAP,
    SIGNED_MAP,
    TYPOGRAPHY,
    LengthUnit,
    colour_bar,
    draw_polygons,
    figure_on,
    length_axes,
    letter_panels,
    number_text,
    signed_norm,
    signed_ticks,
    write_title,
)
from polywigner.figures.systems import SystemSlices, draw_system_panels
from polywigner.geometry.display import length_unit
from polywigner.transforms.wavefronts import flat_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure, SubFigure


_INK = "#1f3b57"
_TINT = "#c6d7e6"
_ACCENT = "#c1440e"


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
    figure : matplotlib Figure or SubFigure to draw on; None: a new figure.

    Returns
    -------
    The figure or subfigure.

    Raises
    ------
    ArgumentError : a floor that is not below zero; what is no figure.
    """
    import matplotlib as mpl

    check_floor(floor_db)
    if isinstance(slices, SystemSlices):
        with mpl.rc_context(TYPOGRAPHY):
            figure = figure_on(figure, 9.4, 7.2, spacing=0.04)
            draw_system_panels(figure.subplots(2, 2), slices, floor_db)
            write_title(figure, _heading(title, slices.wavelength, ""))
        return figure
    unit = length_unit(slices.aperture.diameter)
    with mpl.rc_context(TYPOGRAPHY):
        figure = figure_on(figure, 11.6, 6.9, spacing=0.04)
        panels = figure.subplots(2, 3).ravel()
        _draw_supports(panels[0], slices, unit)
        _draw_levels(panels[1], slices, unit, floor_db)
        _draw_signed(panels[2], slices, slices.fourier.real, unit, "Re F(ν)", r"\nu")
        _draw_lag_slice(panels[3], slices, unit)
        _draw_signed(panels[4], slices, slices.wigner, unit, "W(x, ν)", r"\nu")
        _draw_signed(panels[5], slices, slices.ambiguity.real, unit, "Re A(υ, ξ)", r"\upsilon")
        letter_panels(panels)
        write_title(figure, _heading(title, slices.wavelength))
    return figure


def _draw_supports(axes: Axes, slices: TransformSlices, unit: LengthUnit) -> None:
    support = slices.support.polygons
    array = isinstance(flat_of(slices.source), pw.Array)
    names = ("W is 0 outside", "elements") if array else ("automean", "aperture")
    overlap = pw.position_slice(slices.aperture, slices.xi)
    draw_polygons(axes, support, unit, facecolor=_TINT, edgecolor="none", label=names[0])
    draw_polygons(
        axes, slices.aperture.polygons, unit, facecolor=_INK, edgecolor="none", label=names[1]
    )
    draw_polygons(
        axes, overlap, unit, facecolor="none", edgecolor=_ACCENT, label="position slice at ξ"
    )
    x = np.asarray(slices.x) / unit.metres
    axes.plot(*x, "+", color=_ACCENT, markersize=8, markeredgewidth=1.4, label="x")
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.16), ncols=4, **_LEGEND)
    axes.set_title(f"{names[1]}; ξ = {_point_text(slices.xi, unit)}")
    length_axes(axes, "x", unit)


def _draw_lag_slice(axes: Axes, slices: TransformSlices, unit: LengthUnit) -> None:
    import shapely

    lags = pw.lag_slice(slices.aperture, slices.x)
    doubled = shapely.affinity.affine_transform(
        slices.aperture.polygons, (2, 0, 0, 2, -2 * slices.x[0], -2 * slices.x[1])
    )
    mirrored = shapely.affinity.scale(doubled, -1, -1, origin=(0, 0))
    draw_polygons(axes, doubled, unit, facecolor="none", edgecolor=_INK, label="2(Γ − x)")
    draw_polygons(
        axes, mirrored, unit, facecolor="none", edgecolor=_INK, linestyle="--", label="2(x − Γ)"
    )
    draw_polygons(
        axes, lags, unit, facecolor=_ACCENT, edgecolor="none", alpha=0.35, label="lag slice"
    )
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.16), ncols=3, **_LEGEND)
    axes.set_title(f"lag slice at x = {_point_text(slices.x, unit)}")
    length_axes(axes, r"\xi", unit)


def _draw_levels(axes: Axes, slices: TransformSlices, unit: LengthUnit, floor_db: float) -> None:
    power = np.abs(slices.fourier) ** 2
    uniform = isinstance(slices.source, pw.Aperture) and slices.source.illumination is None
    reference = slices.aperture.area**2 if uniform else float(power.max())
    levels = level_db(power, reference, floor_db)
    shown = _show(axes, slices, levels, unit, cmap=LEVEL_MAP, vmin=floor_db, vmax=0.0)
    zero = "|F(0)|²" if uniform else "the peak shown"
    colour_bar(axes, shown, f"dB relative to {zero}, floor {number_text(floor_db)} dB")
    axes.set_title("|F(ν)|²")
    _frequency_axes(axes, r"\nu", unit, slices.wavelength, "white")


def _draw_signed(
    axes: Axes,
    slices: TransformSlices,
    values: NDArray[np.float64],
    unit: LengthUnit,
    name: str,
    symbol: str,
) -> None:
    peak = float(np.max(np.abs(values)))
    shown = _show(axes, slices, values / peak, unit, cmap=SIGNED_MAP, norm=signed_norm())
    bar = colour_bar(axes, shown, f"{name} / ({peak / unit.metres**2:.4g} {unit.name}²)")
    signed_ticks(bar)
    axes.set_title(name)
    _frequency_axes(axes, symbol, unit, slices.wavelength, "0.35")


_LEGEND: dict[str, Any] = {
    "frameon": False,
    "fontsize": 7.5,
    "handlelength": 1.2,
    "handletextpad": 0.5,
    "columnspacing": 1.0,
}


def _show(
    axes: Axes, slices: TransformSlices, values: NDArray[Any], unit: LengthUnit, **how: Any
) -> Any:
    step = slices.frequency[1] - slices.frequency[0]
    # Pixel centres, not edges, lie on the sampled frequencies.
    edge = (slices.frequency[-1] + step / 2) * unit.metres
    extent = (-edge, edge, -edge, edge)
    return axes.imshow(values, origin="lower", extent=extent, interpolation="nearest", **how)


def _frequency_axes(
    axes: Axes, symbol: str, unit: LengthUnit, wavelength: float | None, ink: str
) -> None:
    if wavelength is not None:
        from matplotlib.patches import Circle

        # Inside propagates, outside is evanescent.
        radius = unit.metres / wavelength
        axes.add_patch(Circle((0, 0), radius, fill=False, edgecolor=ink, lw=0.8, ls=":"))
    axes.set_xlabel(f"${symbol}_x$ (1/{unit.name})")
    axes.set_ylabel(f"${symbol}_y$ (1/{unit.name})")


def _point_text(point: tuple[float, float], unit: LengthUnit) -> str:
    first, second = (f"{value / unit.metres:.4g}" for value in point)
    return f"({first}, {second}) {unit.name}"


def _heading(title: str, wavelength: float | None, note: str = ", dotted circle: |ν| = 1/λ") -> str:
    if wavelength is None:
        return title
    unit = length_unit(wavelength)
    marked = f"λ = {wavelength / unit.metres:.4g} {unit.name}{note}"
    return f"{title}; {marked}" if title else marked
