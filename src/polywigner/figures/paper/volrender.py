"""Fig. volrender: the field in front of two chevrons as isosurfaces with their projections."""

from __future__ import annotations

import numpy as np

import polywigner as pw
from polywigner.figures.paper.sources import WAVELENGTH, Made, Quality, chevrons, geojson
from polywigner.figures.volumes import draw_volume

__all__ = ["make"]

_BOX = ((-36e-3, -36e-3, 2e-3), (36e-3, 36e-3, 120e-3))
_SHAPES = {"draft": (41, 41, 51), "print": (97, 97, 119)}
_METHOD = "rayleigh-sommerfeld-1"
_TOLERANCE = 1e-3  # 0.004 dB: far less than a surface's thickness on the page


def make(quality: Quality) -> Made:
    """From 2 mm to 120 mm (38 wavelengths), exactly: rays take tens of times as long here."""
    source = chevrons()
    found = pw.volume(
        source,
        _BOX,
        _SHAPES[quality],
        WAVELENGTH,
        method=_METHOD,
        tolerance=_TOLERANCE,
        precision="single",
        progress=False,
    )
    figure = draw_volume(found, source, title="two chevrons, 94 GHz")
    return Made(
        {"": figure},
        {
            **{name: np.asarray(found[name].values) for name in "xyz"},
            "irradiance": np.asarray(found[_METHOD].values),
            "aperture": geojson(source.polygons),
        },
        {
            **dict.fromkeys("xyz", "m"),
            "irradiance": f"W/m^2 for |u|^2 = 1 W/m^2, over x, y, z; {_METHOD}",
            "aperture": "GeoJSON, m",
        },
    )
