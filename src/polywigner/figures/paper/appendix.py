"""The patterns listed in the paper's appendix: power spectra of nine apertures."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

import polywigner as pw
from polywigner.figures.levels import level_db
from polywigner.figures.paper.sources import WAVELENGTH, Made, Quality, catalogue, number_samples
from polywigner.figures.style import (
    LEVEL_MAP,
    TYPOGRAPHY,
    draw_polygons,
    length_unit,
    letter_panels,
    new_figure,
    number_text,
)

__all__ = ["make"]

_FLOOR_DB = -40.0


def make(quality: Quality) -> Made:
    """|F|^2 relative to its peak for all |nu_x|, |nu_y| <= 1/wavelength, with the outlines."""
    import matplotlib as mpl

    along = np.linspace(-1, 1, number_samples(quality, 401, 1601)) / WAVELENGTH
    across = np.linspace(-1, 1, number_samples(quality, 161, 641)) / WAVELENGTH
    grid = np.stack(np.meshgrid(across, across), axis=-1)
    values: dict[str, NDArray[Any]] = {"nu": along, "nu_x": across}
    about = {"nu": "1/m, of slits", "nu_x": "1/m, along both axes of all others"}
    with mpl.rc_context(TYPOGRAPHY):
        figure = new_figure(8.4, 8.6, spacing=0.03)
        figure.set_layout_engine("compressed")
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
            values[key] = field
            about[key] = "m, at nu" if slits else "m^2; [j, i] at (nu_x[i], nu_x[j])"
        bar = figure.colorbar(shown, ax=panels, location="bottom", shrink=0.5, aspect=40, pad=0.02)
        bar.set_label(f"|F(ν)|², dB relative to |F(0)|², floor {number_text(_FLOOR_DB)} dB")
        letter_panels(panels)
    return Made({"": figure}, values, about)


_UNIT = length_unit(WAVELENGTH)


def _draw_line(axes: Any, nu: NDArray[np.float64], levels: NDArray[np.float64]) -> None:
    axes.plot(nu * _UNIT.metres, levels, color="#1f3b57", lw=1.0)
    axes.set_ylim(_FLOOR_DB, 1.5)
    axes.set_box_aspect(1)
    axes.margins(x=0)
    axes.grid(alpha=0.3, lw=0.5)
    axes.set_xlabel(rf"$\nu$ (1/{_UNIT.name})")
    axes.set_ylabel("|F|² (dB)", labelpad=0)


def _draw_map(axes: Any, nu: NDArray[np.float64], levels: NDArray[np.float64]) -> Any:
    edge = nu[-1] * _UNIT.metres * (1 + 1 / (len(nu) - 1))
    shown = axes.imshow(
        levels,
        origin="lower",
        extent=(-edge, edge, -edge, edge),
        cmap=LEVEL_MAP,
        vmin=_FLOOR_DB,
        vmax=0.0,
        interpolation="nearest",
    )
    axes.set_xlabel(rf"$\nu_x$ (1/{_UNIT.name})")
    axes.set_ylabel(rf"$\nu_y$ (1/{_UNIT.name})", labelpad=0)
    return shown


def _draw_outline(axes: Any, source: pw.Slits | pw.Aperture) -> None:
    """Draws a source in the upper right corner, all figures to one scale: 20 mm wide."""
    inset = axes.inset_axes((0.72, 0.72, 0.27, 0.27))
    half = 10e-3 / _UNIT.metres
    if isinstance(source, pw.Slits):
        for start, end in source.intervals / _UNIT.metres:
            inset.plot([start, end], [0, 0], color="#1f3b57", lw=3, solid_capstyle="butt")
        inset.patch.set_visible(False)
    else:
        draw_polygons(inset, source.polygons, _UNIT, facecolor="white", edgecolor="none")
        inset.set_facecolor((0, 0, 0, 0.6))  # lobes may be as bright as the outline
    inset.set(xlim=(-half, half), ylim=(-half, half), aspect="equal", xticks=[], yticks=[])
    inset.spines[:].set_visible(False)
