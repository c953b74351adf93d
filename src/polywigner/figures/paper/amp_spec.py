"""Fig. amp_spec: the real part of the Fourier transform of two chevrons, out to 94 GHz."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

import polywigner as pw
from polywigner.figures.levels import level_db
from polywigner.figures.paper.sources import (
    WAVELENGTH,
    Made,
    Quality,
    chevrons,
    geojson,
    number_samples,
)
from polywigner.figures.style import (
    SIGNED_MAP,
    TYPOGRAPHY,
    colour_bar,
    draw_polygons,
    length_unit,
    new_figure,
    number_text,
)

__all__ = ["make", "signed_db"]

_FLOOR_DB = -40.0


def signed_db(values: NDArray[np.float64], peak: float, floor_db: float) -> NDArray[np.float64]:
    """Decades above a floor with the sign of the values: 0 at the floor, +-1 at the peak.

    Parameters
    ----------
    values : field-like, of any shape; 20 dB are a factor of ten.
    peak : the modulus that is 0 dB.
    floor_db : moduli at or below this level, dB, are 0.
    """
    levels = level_db(np.square(values), peak**2, floor_db)
    signed: NDArray[np.float64] = np.sign(values) * (1 - levels / floor_db)
    return signed


def make(quality: Quality) -> Made:
    """F(nu) on the square |nu_x|, |nu_y| <= 1/wavelength; drawn on a symmetric scale in dB."""
    import matplotlib as mpl

    source = chevrons()
    frequency = np.linspace(-1, 1, number_samples(quality, 257, 1025)) / WAVELENGTH
    nu = np.stack(np.meshgrid(frequency, frequency), axis=-1)
    transform = pw.fourier(source, nu)
    unit = length_unit(WAVELENGTH)
    edge = frequency[-1] * (1 + 1 / (len(frequency) - 1)) * unit.metres
    with mpl.rc_context(TYPOGRAPHY):
        figure = new_figure(5.8, 4.4)
        axes = figure.add_subplot()
        shown = axes.imshow(
            signed_db(transform.real, source.area, _FLOOR_DB),
            origin="lower",
            extent=(-edge, edge, -edge, edge),
            cmap=SIGNED_MAP,
            vmin=-1,
            vmax=1,
            interpolation="nearest",
        )
        area = source.area / unit.metres**2
        # Above zero levels rise to the peak; below it those of negative values fall away from it.
        levels = np.array([0, -10, -20, -30])
        places = 1 - levels / _FLOOR_DB
        bar = colour_bar(
            axes, shown, f"Re F > 0 (red), Re F < 0 (blue)\ndB relative to F(0) = {area:.3g} mm²"
        )
        names = [number_text(level) for level in levels]
        bar.set_ticks([*-places, 0.0, *places])
        bar.set_ticklabels([*names, f"≤ {number_text(_FLOOR_DB)}", *names])
        axes.add_patch(
            mpl.patches.Circle(
                (0, 0), unit.metres / WAVELENGTH, fill=False, edgecolor="0.35", lw=0.8, ls=":"
            )
        )
        axes.set_xlabel(rf"$\nu_x$ (1/{unit.name})")
        axes.set_ylabel(rf"$\nu_y$ (1/{unit.name})")
        axes.set_title(f"Re F(ν) of two chevrons; dotted: |ν| = 1/λ, λ = {WAVELENGTH * 1e3:.3g} mm")
        inset = axes.inset_axes((0.01, 0.01, 0.19, 0.12))
        draw_polygons(inset, source.polygons, unit, facecolor="0.2", edgecolor="none")
        inset.set_aspect("equal")
        inset.margins(0.1)
        inset.autoscale_view()
        inset.set(xticks=[], yticks=[])
    return Made(
        {"": figure},
        {"frequency": frequency, "fourier": transform, "aperture": geojson(source.polygons)},
        {
            "frequency": "1/m, along both axes",
            "fourier": "m^2; fourier[j, i] at nu = (frequency[i], frequency[j])",
            "aperture": "GeoJSON, m",
        },
    )
