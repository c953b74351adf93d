"""Planned in the paper's comments: the error of each method against distance."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

import polywigner as pw
from polywigner.figures.levels import COMPARED_DB, summary
from polywigner.figures.paper.sources import (
    RAYS,
    WAVELENGTH,
    Made,
    Quality,
    limits_known,
    number_samples,
    square,
)
from polywigner.figures.style import TYPOGRAPHY, letter_panels, new_figure, number_text

__all__ = ["LARGEST_ANGLE", "make"]

LARGEST_ANGLE = np.radians(60.0)

_METHODS: dict[str, dict[str, Any]] = {
    **{f"Wigner, {name}": {"method": "wigner", **how} for name, how in RAYS.items()},
    "Fresnel": {"method": "fresnel"},
    "Fraunhofer": {"method": "fraunhofer", "obliquity": "kirchhoff"},
}
_STYLES = (
    ("#d7301f", "-"),
    ("#2166ac", "--"),
    ("#e69f00", "-."),
    ("#1b9e77", ":"),
    ("#7b3294", (0, (5, 1, 1, 1))),
)


def make(quality: Quality) -> Made:
    """Differences from Kirchhoff's exact field, in dB, from one wavelength to a hundred."""
    import matplotlib as mpl

    near = np.geomspace(1, 100, number_samples(quality, 61, 401))
    radii = np.geomspace(1, 100, number_samples(quality, 13, 41))
    angles = np.linspace(-LARGEST_ANGLE, LARGEST_ANGLE, number_samples(quality, 61, 241))
    boresight = near[:, None] * np.array([0, 0, WAVELENGTH])
    directions = np.stack([np.sin(angles), 0 * angles, np.cos(angles)], axis=-1)
    arcs = WAVELENGTH * radii[:, None, None] * directions
    on_axis, over_arcs = (_by_method(points) for points in (boresight, arcs))
    exact = {"axis": on_axis.pop("Kirchhoff"), "arcs": over_arcs.pop("Kirchhoff")}
    errors = np.array([_decibels(v, exact["axis"]) for v in on_axis.values()])
    rms = np.array(
        [
            [summary(one, true).rms for one, true in zip(v, exact["arcs"], strict=True)]
            for v in over_arcs.values()
        ]
    )
    with mpl.rc_context(TYPOGRAPHY):
        figure = new_figure(8.4, 4.0, spacing=0.04)
        panels = figure.subplots(1, 2, sharey=True)
        _draw(panels[0], near, np.abs(errors), "distance on boresight / λ", "on boresight")
        degrees = f"{np.degrees(LARGEST_ANGLE):.0f}°"
        _draw(panels[1], radii, rms, "radius / λ", f"rms over a cut, −{degrees} to {degrees}")
        panels[0].set_ylabel("difference from Kirchhoff (dB)")
        panels[1].text(
            0.98, 0.93, f"where above {number_text(COMPARED_DB)} dB of the peak",
            transform=panels[1].transAxes, ha="right", fontsize=7.5,
        )  # fmt: skip
        figure.legend(
            *panels[0].get_legend_handles_labels(),
            loc="outside lower center", ncols=5, frameon=False, fontsize=8,
        )  # fmt: skip
        letter_panels(panels)
    methods = ", ".join(on_axis)
    return Made(
        {"": figure},
        {"distance": near, "boresight_error": errors, "radius": radii, "arc_rms": rms},
        {
            "distance": "wavelengths",
            "boresight_error": f"dB, signed; by {methods}, over distance; nan where below zero",
            "radius": "wavelengths",
            "arc_rms": f"dB; by {methods}, over radius",
        },
    )


def _by_method(points: NDArray[np.float64]) -> dict[str, NDArray[np.float64]]:
    with limits_known():
        found = {
            name: pw.irradiance(square(), points, WAVELENGTH, **how)
            for name, how in _METHODS.items()
        }
        found["Kirchhoff"] = pw.irradiance(square(), points, WAVELENGTH, method="kirchhoff")
    return found


def _decibels(values: NDArray[np.float64], reference: NDArray[np.float64]) -> NDArray[np.float64]:
    """Everywhere, unlike difference_db: boresight has no nulls far away, and falls by 40 dB."""
    found = np.full(values.shape, np.nan)
    known = values > 0
    found[known] = 10 * np.log10(values[known] / reference[known])
    return found


def _draw(axes: Any, places: Any, errors: Any, label: str, title: str) -> None:
    for name, error, (colour, dash) in zip(_METHODS, errors, _STYLES, strict=True):
        axes.loglog(places, error, color=colour, ls=dash, lw=1.3, label=name)
    axes.set_ylim(1e-4, 30)
    axes.margins(x=0)
    axes.set_xlabel(label)
    axes.set_title(title)
    axes.grid(alpha=0.3, lw=0.5)
