"""Fig. compar: Wigner rays beside Kirchhoff and Fraunhofer diffraction, of a square at 94 GHz."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

import polywigner as pw
from polywigner.figures.lines import draw_lines
from polywigner.figures.paper.sources import (
    RAYS,
    WAVELENGTH,
    Made,
    Quality,
    compared,
    number_samples,
    square,
)
from polywigner.figures.planes import draw_planes
from polywigner.figures.style import number_panels

__all__ = ["make"]


def make(quality: Quality) -> Made:
    """(a) Irradiance on boresight; (b) in the plane y = 0, which contains the axis."""
    axis = _boresight(number_samples(quality, 501, 1486))
    cut = _plane((number_samples(quality, 91, 301), number_samples(quality, 76, 251)))
    found = "10 mm × 10 mm, 94 GHz"
    figures = {
        "a": draw_lines(axis, title=f"(a) boresight, {found}"),
        "b": draw_planes(cut, title=f"(b) plane through the axis and along two sides, {found}"),
    }
    for letter, figure in figures.items():
        number_panels(figure, letter)
    values: dict[str, NDArray[Any]] = {"boresight_z": axis["z"].values}
    about = {"boresight_z": "m"}
    for name in ("x", "z"):
        values[f"plane_{name}"], about[f"plane_{name}"] = cut[name].values, "m"
    for place, fields, dims in (("boresight", axis, "boresight_z"), ("plane", cut, "plane_x, _z")):
        for method in fields.data_vars:
            key = f"{place}_{str(method).replace(' ', '_').replace('-', '_')}"
            values[key] = np.asarray(fields[method].values)
            about[key] = f"W/m^2 for |u|^2 = 1 W/m^2, over {dims}"
    return Made(figures, values, about)


def _boresight(samples: int) -> Any:
    """From half a wavelength to fifty."""
    ends = [(0, 0, 0.5 * WAVELENGTH), (0, 0, 50 * WAVELENGTH)]
    place = partial(pw.line, square(), ends, samples, WAVELENGTH)
    return compared(place, tuple(RAYS), "fraunhofer")


def _plane(shape: tuple[int, int]) -> Any:
    where = ((-60e-3, 0.0, 2e-3), (60e-3, 0.0, 102e-3))
    place = partial(pw.plane, square(), where, shape, WAVELENGTH)
    return compared(place, ("paper", "matched"), "fraunhofer")
