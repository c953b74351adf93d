"""Figures of transforms: amp_spec, appendix, indmk, marginals, projs, xforms."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

import polywigner as pw
from paper.figures.sources import (
    WAVELENGTH,
    Made,
    Quality,
    catalogue,
    chevrons,
    geojson,
    number_panels,
    number_samples,
    triangle,
    triangles,
)
from polywigner.figures import style
from polywigner.figures.levels import level_db
from polywigner.figures.transform_plots import draw_projections
from polywigner.quantities import length_unit
from polywigner.transforms.projection import PhaseSpaceFunction

_FLOOR_DB = -40.0


def signed_db(values: NDArray[np.float64], peak: float, floor_db: float) -> NDArray[np.float64]:
    """Return decades above a floor with the sign of the values: 0 at the floor, +-1 at the peak."""
    levels = level_db(np.square(values), peak**2, floor_db)
    signed: NDArray[np.float64] = np.sign(values) * (1 - levels / floor_db)
    return signed


@style.typeset
def draw_amp_spec(quality: Quality) -> Made:
    """Draw F(nu) for |nu_x|, |nu_y| <= 1/wavelength on a symmetric scale in dB."""
    source = chevrons()
    frequency = np.linspace(-1, 1, number_samples(quality, 257, 1025)) / WAVELENGTH
    nu = np.stack(np.meshgrid(frequency, frequency), axis=-1)
    transform = pw.fourier(source, nu)
    unit = length_unit(WAVELENGTH)
    places = frequency * unit.metres
    figure = style.new_figure(5.8, 4.4)
    axes = figure.add_subplot()
    levels = signed_db(transform.real, source.area, _FLOOR_DB)
    shown = style.draw_signed(axes, levels, places, places, bound=1.0)
    area = source.area / unit.metres**2
    # Levels of positive values increase above zero, and levels of negative values decrease below
    # zero.
    marked = np.array([0, -10, -20, -30])
    ticks = 1 - marked / _FLOOR_DB
    bar = style.colour_bar(
        axes, shown, f"Re F > 0 (red), Re F < 0 (blue)\ndB relative to F(0) = {area:.3g} mm²"
    )
    names = [style.number_text(level) for level in marked]
    bar.set_ticks([*-ticks, 0.0, *ticks])
    bar.set_ticklabels([*names, f"≤ {style.number_text(_FLOOR_DB)}", *names])
    style.mark_evanescent(axes, WAVELENGTH, unit, "0.35")
    style.label_axes(axes, "nu", unit)
    axes.set_title(f"Re F(ν) of two chevrons; dotted: |ν| = 1/λ, λ = {WAVELENGTH * 1e3:.3g} mm")
    inset = axes.inset_axes((0.01, 0.01, 0.19, 0.12))
    style.draw_polygons(inset, source.polygons, unit, facecolor="0.2", edgecolor="none")
    inset.set_aspect("equal")
    inset.margins(0.1)
    inset.autoscale_view()
    inset.set(xticks=[], yticks=[])
    return Made(
        {"": figure},
        {
            "frequency": (frequency, "1/m, along both axes"),
            "fourier": (transform, "m^2; fourier[j, i] at nu = (frequency[i], frequency[j])"),
            "aperture": geojson(source.polygons),
        },
    )


@style.typeset
def draw_appendix(quality: Quality) -> Made:
    """Draw |F|^2 relative to its peak for |nu_x|, |nu_y| <= 1/wavelength, with the outlines."""
    along = np.linspace(-1, 1, number_samples(quality, 401, 1601)) / WAVELENGTH
    across = np.linspace(-1, 1, number_samples(quality, 161, 641)) / WAVELENGTH
    grid = np.stack(np.meshgrid(across, across), axis=-1)
    values = {
        "nu": (along, "1/m, of slits"),
        "nu_x": (across, "1/m, along both axes of all others"),
    }
    figure = style.new_figure(8.4, 8.6, is_compressed=True)
    panels = figure.subplots(3, 3).ravel()
    for axes, (name, source) in zip(panels, catalogue().items(), strict=True):
        slits = isinstance(source, pw.Slits)
        field = pw.fourier(source, along[:, None] if slits else grid)
        peak = source.length if isinstance(source, pw.Slits) else source.area
        levels = level_db(np.abs(field) ** 2, peak**2, _FLOOR_DB)
        if slits:
            _draw_line(axes, along, levels)
        else:
            shown = _draw_map(axes, across, levels)
        _draw_outline(axes, source)
        axes.set_title(name)
        key = name.replace(",", "").replace("-", "_").replace(" ", "_")
        values[key] = field, "m, at nu" if slits else "m^2; [j, i] at (nu_x[i], nu_x[j])"
    bar = figure.colorbar(shown, ax=panels, location="bottom", shrink=0.5, aspect=40, pad=0.02)
    bar.set_label(f"|F(ν)|², dB relative to |F(0)|², {style.floor_text(_FLOOR_DB)}")
    style.letter_panels(panels)
    return Made({"": figure}, values)


_INVERSE_UNIT = length_unit(WAVELENGTH)


def _draw_line(axes: Any, nu: NDArray[np.float64], levels: NDArray[np.float64]) -> None:
    axes.plot(nu * _INVERSE_UNIT.metres, levels, color=style.INK, lw=1.0)
    axes.set_ylim(_FLOOR_DB, 1.5)
    axes.set_box_aspect(1)
    axes.margins(x=0)
    axes.grid(alpha=0.3, lw=0.5)
    axes.set_xlabel(rf"$\nu$ (1/{_INVERSE_UNIT.name})")
    axes.set_ylabel("|F|² (dB)", labelpad=0)


def _draw_map(axes: Any, nu: NDArray[np.float64], levels: NDArray[np.float64]) -> Any:
    places = nu * _INVERSE_UNIT.metres
    shown = style.draw_levels(axes, levels, places, places, low=_FLOOR_DB)
    style.label_axes(axes, "nu", _INVERSE_UNIT)
    axes.yaxis.labelpad = 0
    return shown


def _draw_outline(axes: Any, source: pw.Slits | pw.Aperture) -> None:
    """Draw a source in the upper right corner, at a common scale of 20 mm."""
    inset = axes.inset_axes((0.72, 0.72, 0.27, 0.27))
    half = 10e-3 / _INVERSE_UNIT.metres
    if isinstance(source, pw.Slits):
        for start, end in source.intervals / _INVERSE_UNIT.metres:
            inset.plot([start, end], [0, 0], color=style.INK, lw=3, solid_capstyle="butt")
        inset.patch.set_visible(False)
    else:
        style.draw_polygons(
            inset, source.polygons, _INVERSE_UNIT, facecolor="white", edgecolor="none"
        )
        inset.set_facecolor((0, 0, 0, 0.6))  # lobes can be as bright as the outline
    inset.set(xlim=(-half, half), ylim=(-half, half), aspect="equal", xticks=[], yticks=[])
    inset.spines[:].set_visible(False)


_ELEMENTS, _SUPPORT, _HULL = "#c8372d", "#9dbfe0", "0.45"  # red and blue, as in the paper


@style.typeset
def draw_indmk(quality: Quality) -> Made:
    """Draw elements (red), automean (red and blue) and its convex hull, with their areas."""
    source = triangles()
    support = pw.automean(source)
    hull = source.polygons.convex_hull
    unit = length_unit(source.diameter)
    mm2 = unit.metres**2
    figure = style.new_figure(6.2, 3.3)  # width of the legend
    axes = figure.add_subplot()
    parts = (
        (hull, "none", _HULL, f"convex hull, {hull.area / mm2:.0f} mm²"),
        (
            support.polygons,
            _SUPPORT,
            "none",
            f"automean (blue and red), {support.area / mm2:.0f} mm²",
        ),
        (source.polygons, _ELEMENTS, "none", f"elements, {source.area / mm2:.0f} mm²"),
    )
    for shape, face, edge, label in parts:
        dashed = "--" if face == "none" else "-"
        style.draw_polygons(
            axes, shape, unit, facecolor=face, edgecolor=edge, ls=dashed, lw=0.9, label=label
        )
    style.length_axes(axes, "x", unit)
    figure.legend(loc="outside lower center", ncols=3, frameon=False, fontsize=8)
    shapes = {"elements": source.polygons, "automean": support.polygons, "hull": hull}
    areas = np.array([shape.area for shape in shapes.values()])
    values = {name: geojson(shape) for name, shape in shapes.items()}
    return Made({"": figure}, values | {"areas": (areas, "m^2, of elements, automean and hull")})


_MARGIN = 0.5e-3  # keeps outlines off the frame


@style.typeset
def draw_marginals(quality: Quality) -> Made:
    """Draw R_x(x) with the automean's outline, and R_xi(xi)."""
    source = triangles()
    count = number_samples(quality, 241, 721)
    support = pw.automean(source)
    xmin, ymin, xmax, ymax = source.bounds
    x = np.linspace(xmin - _MARGIN, xmax + _MARGIN, count)
    y = np.linspace(ymin - _MARGIN, ymax + _MARGIN, count // 2 + 1)
    xi_x = np.linspace(xmin - xmax, xmax - xmin, count)
    xi_y = np.linspace(ymin - ymax, ymax - ymin, count // 2 + 1)
    of_position = pw.position_marginal(source, np.stack(np.meshgrid(x, y), axis=-1))
    of_lag = pw.lag_marginal(source, np.stack(np.meshgrid(xi_x, xi_y), axis=-1))
    unit = length_unit(source.diameter)
    figure = style.new_figure(5.6, 4.2, is_compressed=True)
    panels = figure.subplots(2, 1)
    _draw_marginal(panels[0], x, y, of_position, "x", unit)
    panels[0].set_title(r"$R_x$, area of the lag slice at $x$")
    _draw_marginal(panels[1], xi_x, xi_y, of_lag, "xi", unit)
    panels[1].set_title(r"$R_\xi$, area of the position slice at $\xi$")
    for shape, ink in ((support.polygons, "0.75"), (source.polygons, "#5ec8ff")):
        style.draw_polygons(panels[0], shape, unit, facecolor="none", edgecolor=ink, lw=0.8)
    style.letter_panels(panels)
    return Made(
        {"": figure},
        {
            "x": (x, "m"),
            "y": (y, "m"),
            "position_marginal": (of_position, "m^2, [j, i] at (x[i], y[j])"),
            "xi_x": (xi_x, "m"),
            "xi_y": (xi_y, "m"),
            "lag_marginal": (of_lag, "m^2, [j, i] at (xi_x[i], xi_y[j])"),
            "aperture": geojson(source.polygons),
        },
    )


def _draw_marginal(axes: Any, across: Any, up: Any, values: Any, symbol: str, unit: Any) -> None:
    places = across / unit.metres, up / unit.metres
    areas = values / unit.metres**2
    shown = style.draw_levels(axes, areas, *places, low=0.0, high=None, shading="nearest")
    style.colour_bar(axes, shown, f"{unit.name}²")
    style.length_axes(axes, symbol, unit)
    axes.set_aspect("equal", adjustable="box")
    axes.margins(0)


KINDS: dict[str, PhaseSpaceFunction] = {"a": "autocorrelation", "b": "wigner", "c": "ambiguity"}


def draw_projs(quality: Quality) -> Made:
    """Draw the four tiles of each grid of the paper for two chevrons."""
    figures = {}
    values = {}
    for letter, kind in KINDS.items():
        result = pw.projections(chevrons(), kind, samples=number_samples(quality, 97, 513))
        title = f"({letter}) projected {_called(kind)}, two chevrons"
        figures[letter] = draw_projections(result, title=title)
        number_panels(figures[letter], letter)
        for name in (*result.coords, *result.data_vars):
            key = str(name) if name in result.coords else f"{kind}_{name}"
            units = result[name].attrs["units"]
            dims = ", ".join(map(str, result[name].dims))
            about = units if name in result.coords else f"{units}, over {dims}"
            values[key] = np.asarray(result[name].values), about
    return Made(figures, values)


def _called(kind: PhaseSpaceFunction) -> str:
    return {"wigner": "Wigner function"}.get(kind, f"{kind} function")


POSITION = (1.2e-3, -0.6e-3)
LAG = (4e-3, 2.5e-3)

_ELEMENT, _FIRST, _SECOND, _SLICE = "0.82", style.INK, "#8a5a00", style.ACCENT


@style.typeset
def draw_xforms(quality: Quality) -> Made:
    """Draw (a) 2(G - x) & 2(x - G) over lags, and (b) (G - xi/2) & (G + xi/2) over positions."""
    from shapely.affinity import affine_transform, translate

    source = triangle()
    outline = source.polygons
    (x, y), (across, up) = POSITION, LAG
    shapes = {
        "element": outline,
        "doubled": affine_transform(outline, (2, 0, 0, 2, -2 * x, -2 * y)),
        "mirrored": affine_transform(outline, (-2, 0, 0, -2, 2 * x, 2 * y)),
        "lag_slice": pw.lag_slice(source, POSITION),
        "behind": translate(outline, -across / 2, -up / 2),
        "ahead": translate(outline, across / 2, up / 2),
        "position_slice": pw.position_slice(source, LAG),
    }
    figure = style.new_figure(8.2, 4.2, spacing=0.04)
    left, right = figure.subplots(1, 2)
    _draw_overlap(left, shapes, ("doubled", "2(Γ − x)"), ("mirrored", "2(x − Γ)"), "lag_slice")
    _draw_overlap(right, shapes, ("behind", "Γ − ξ/2"), ("ahead", "Γ + ξ/2"), "position_slice")
    left.plot(x * 1e3, y * 1e3, "o", color="black", ms=4, label="x", zorder=5)
    arrow = {"arrowstyle": "-|>", "color": "black", "shrinkA": 0, "shrinkB": 0}
    tip = np.array(LAG) * 1e3
    right.annotate("", tip, (0, 0), arrowprops=arrow, zorder=5)
    right.annotate("ξ", tip, xytext=(4, 2), textcoords="offset points")
    right.plot(*np.outer(tip, (-0.5, 0.5)), "o", color="black", ms=4, label="±ξ/2", zorder=5)
    left.set_title(f"lag slice at x = {_pair(POSITION)} mm")
    right.set_title(f"position slice at ξ = {_pair(LAG)} mm")
    unit = length_unit(source.diameter)
    style.length_axes(left, "xi", unit)
    style.length_axes(right, "x", unit)
    for axes in (left, right):
        axes.legend(
            loc="upper center", bbox_to_anchor=(0.5, -0.14), ncols=3, frameon=False, fontsize=8
        )
    style.letter_panels((left, right))
    values = {name: geojson(shape) for name, shape in shapes.items()}
    points = {"x": (np.array(POSITION), "m"), "xi": (np.array(LAG), "m")}
    return Made({"": figure}, values | points)


def _pair(metres: tuple[float, float]) -> str:
    return "({}, {})".format(*(style.number_text(value * 1e3) for value in metres))


def _draw_overlap(
    axes: Any, shapes: Any, first: tuple[str, str], second: tuple[str, str], slice_name: str
) -> None:
    unit = length_unit(1e-2)
    style.draw_polygons(
        axes, shapes["element"], unit, facecolor=_ELEMENT, edgecolor="none", label="element Γ"
    )
    style.draw_polygons(
        axes,
        shapes[slice_name],
        unit,
        facecolor=_SLICE,
        edgecolor="none",
        alpha=0.45,
        label="slice Γ′",
    )
    for (name, label), ink, dash in ((first, _FIRST, "-"), (second, _SECOND, "--")):
        style.draw_polygons(
            axes, shapes[name], unit, facecolor="none", edgecolor=ink, ls=dash, lw=1.2, label=label
        )
    axes.axhline(0, color="0.6", lw=0.5, zorder=0)
    axes.axvline(0, color="0.6", lw=0.5, zorder=0)
