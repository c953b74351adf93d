"""Figures of fields: compar, error, volrender, volrender_fdtd."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import polywigner as pw
from paper.figures.sources import (
    RAYS,
    WAVELENGTH,
    Made,
    Quality,
    chevrons,
    compared,
    geojson,
    limits_known,
    number_panels,
    number_samples,
    square,
)
from polywigner.figures import draw_lines, draw_planes, draw_volume, style
from polywigner.figures.levels import COMPARED_DB, summary


def draw_compar(quality: Quality) -> Made:
    """Draw the irradiance (a) on boresight and (b) in the plane y = 0, which contains the axis."""
    axis = _boresight(number_samples(quality, 501, 1486))
    cut = _plane((number_samples(quality, 91, 301), number_samples(quality, 76, 251)))
    result = "10 mm × 10 mm, 94 GHz"
    figures = {
        "a": draw_lines(axis, title=f"(a) boresight, {result}"),
        "b": draw_planes(cut, title=f"(b) plane through the axis and along two sides, {result}"),
    }
    for letter, figure in figures.items():
        number_panels(figure, letter)
    values = {"boresight_z": (axis["z"].values, "m")}
    values |= {f"plane_{name}": (cut[name].values, "m") for name in "xz"}
    for place, fields, dims in (("boresight", axis, "boresight_z"), ("plane", cut, "plane_x, _z")):
        for method in fields.data_vars:
            key = f"{place}_{str(method).replace(' ', '_').replace('-', '_')}"
            values[key] = fields[method].values, f"W/m^2 for |u|^2 = 1 W/m^2, over {dims}"
    return Made(figures, values)


def _boresight(samples: int) -> Any:
    """Return the field from half a wavelength to fifty wavelengths."""
    ends = [(0, 0, 0.5 * WAVELENGTH), (0, 0, 50 * WAVELENGTH)]
    place = partial(pw.line, square(), ends, samples, WAVELENGTH)
    return compared(place, tuple(RAYS), "fraunhofer")


def _plane(shape: tuple[int, int]) -> Any:
    where = ((-60e-3, 0.0, 2e-3), (60e-3, 0.0, 102e-3))
    place = partial(pw.plane, square(), where, shape, WAVELENGTH)
    return compared(place, ("paper", "matched"), "fraunhofer")


LARGEST_ANGLE = np.radians(60.0)

_METHODS: dict[str, dict[str, Any]] = {
    **{f"Wigner, {name}": {"method": "wigner", **how} for name, how in RAYS.items()},
    "Fresnel": {"method": "fresnel"},
    "Fraunhofer": {"method": "fraunhofer", "obliquity": "kirchhoff"},
}
_STYLES = (
    (style.RED, "-"),
    (style.BLUE, "--"),
    (style.GREEN, ":"),
    (style.VIOLET, (0, (5, 1, 1, 1))),
)


@style.typeset
def draw_error(quality: Quality) -> Made:
    """Draw differences from Kirchhoff's exact field in dB, from one wavelength to a hundred."""
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
    figure = style.new_figure(8.4, 4.0, spacing=0.04)
    panels = figure.subplots(1, 2, sharey=True)
    _draw(panels[0], near, np.abs(errors), "distance on boresight / λ", "on boresight")
    degrees = f"{np.degrees(LARGEST_ANGLE):.0f}°"
    _draw(panels[1], radii, rms, "radius / λ", f"rms over a cut, −{degrees} to {degrees}")
    panels[0].set_ylabel("difference from Kirchhoff (dB)")
    panels[1].text(
        0.98, 0.93, f"where above {style.number_text(COMPARED_DB)} dB of the peak",
        transform=panels[1].transAxes, ha="right", fontsize=7.5,
    )  # fmt: skip
    figure.legend(
        *panels[0].get_legend_handles_labels(),
        loc="outside lower center", ncols=5, frameon=False, fontsize=8,
    )  # fmt: skip
    style.letter_panels(panels)
    methods = ", ".join(on_axis)
    return Made(
        {"": figure},
        {
            "distance": (near, "wavelengths"),
            "boresight_error": (
                errors,
                f"dB, signed; by {methods}, over distance; nan where below zero",
            ),
            "radius": (radii, "wavelengths"),
            "arc_rms": (rms, f"dB; by {methods}, over radius"),
        },
    )


def _by_method(points: NDArray[np.float64]) -> dict[str, NDArray[np.float64]]:
    with limits_known():
        result = {
            name: pw.irradiance(square(), points, WAVELENGTH, **how)
            for name, how in _METHODS.items()
        }
        result["Kirchhoff"] = pw.irradiance(square(), points, WAVELENGTH, method="kirchhoff")
    return result


def _decibels(values: NDArray[np.float64], reference: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return levels at all points; boresight has no nulls far away, and decreases by 40 dB."""
    result = np.full(values.shape, np.nan)
    known = values > 0
    result[known] = 10 * np.log10(values[known] / reference[known])
    return result


def _draw(axes: Any, places: Any, errors: Any, label: str, title: str) -> None:
    for name, error, (colour, dash) in zip(_METHODS, errors, _STYLES, strict=True):
        axes.loglog(places, error, color=colour, ls=dash, lw=1.3, label=name)
    axes.set_ylim(1e-4, 30)
    axes.margins(x=0)
    axes.set(xlabel=label, title=title)
    axes.grid(alpha=0.3, lw=0.5)


_BOX = ((-36e-3, -36e-3, 2e-3), (36e-3, 36e-3, 120e-3))
_SHAPES = {"draft": (41, 41, 51), "print": (97, 97, 119)}
_METHOD = "rayleigh-sommerfeld-1"
_TOLERANCE = 1e-3  # 0.004 dB


def draw_volrender(quality: Quality) -> Made:
    """Draw the exact field from 2 mm to 120 mm (38 wavelengths), because rays are slow here."""
    source = chevrons()
    result = pw.volume(
        source,
        _BOX,
        _SHAPES[quality],
        WAVELENGTH,
        method=_METHOD,
        tolerance=_TOLERANCE,
        progress=False,
    )
    figure = draw_volume(result, source, title="two chevrons, 94 GHz")
    about = f"W/m^2 for |u|^2 = 1 W/m^2, over x, y, z; {_METHOD}"
    values = {name: (result[name].values, "m") for name in "xyz"}
    values |= {"irradiance": (result[_METHOD].values, about), "aperture": geojson(source.polygons)}
    return Made({"": figure}, values)


_NEAREST = 2.0  # in wavelengths; rays are inaccurate at shorter distances
_FILE = Path(__file__).with_name("volrender_fdtd.npz")


def draw_volrender_fdtd(quality: Quality) -> Made:
    """Draw the field from 2 to 6 wavelengths behind a black screen and Kirchhoff's rays."""
    import xarray as xr

    with np.load(_FILE) as file:
        quarter, step = file["irradiance"].astype(np.float64), float(file["spacing"]) * WAVELENGTH
    heights = step * np.arange(quarter.shape[2])
    chosen = heights > (_NEAREST - 1e-9) * WAVELENGTH
    aside, z = step * np.arange(len(quarter)), heights[chosen]
    box = ((0.0, 0.0, z[0]), (aside[-1], aside[-1], z[-1]))
    with limits_known():
        rays = pw.volume(
            square(), box, (len(aside), len(aside), len(z)), WAVELENGTH, method="wigner",
            obliquity="kirchhoff", tolerance=1e-2, progress=False,
        )["wigner"]  # fmt: skip
    x = np.concatenate([-aside[:0:-1], aside])
    axes = {"x": x, "y": x, "z": z}
    values = {
        "fdtd": _whole(quarter[..., chosen]),
        "rays": _whole(rays.transpose("x", "y", "z").values),
    }
    titles = {"fdtd": "finite differences in time", "rays": "Wigner rays"}
    figures = {}
    for letter, (name, field) in zip("ab", values.items(), strict=True):
        labelled = {name: (tuple("xyz"), field, {"units": "W m-2"})}
        result = xr.Dataset(labelled, {k: (k, v, {"units": "m"}) for k, v in axes.items()})
        title = f"10 mm square, 94 GHz: {titles[name]}"
        figures[letter] = draw_volume(result, square(), title=title, reference=values["fdtd"].max())
    about = {
        "fdtd": "finite differences, black screen, 12 cells a wavelength",
        "rays": "Wigner rays, Kirchhoff's obliquity",
    }
    unit = "W/m^2 for |u|^2 = 1 W/m^2, over x, y, z; "
    behind = {name: (field, unit + about[name]) for name, field in values.items()}
    return Made(figures, {name: (places, "m") for name, places in axes.items()} | behind)


def _whole(quarter: NDArray[Any]) -> NDArray[np.float64]:
    """Extend a field that is even in x and in y from x, y >= 0 to all quadrants."""
    half = np.concatenate([quarter[:0:-1], quarter])
    return np.concatenate([half[:, :0:-1], half], axis=1)
