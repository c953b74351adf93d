"""Fig. volrender_fdtd: the square's near field by finite differences in time, and by Wigner rays.

The paper plans this panel and does not show it. The finite differences are kept as a file, made by
``python benchmarks/fdtd_screens.py --store FILE``: they take minutes.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import polywigner as pw
from polywigner.figures.paper.sources import WAVELENGTH, Made, Quality, limits_known, square
from polywigner.figures.volumes import draw_volume

__all__ = ["make"]

_NEAREST = 2.0  # wavelengths: nearer, rays are no picture of the field
_FILE = Path(__file__).with_suffix(".npz")


def make(quality: Quality) -> Made:
    """From 2 to 6 wavelengths behind a black screen, which Kirchhoff's rays are matched to."""
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
        found = xr.Dataset(labelled, {k: (k, v, {"units": "m"}) for k, v in axes.items()})
        title = f"10 mm square, 94 GHz: {titles[name]}"
        figures[letter] = draw_volume(found, square(), title=title, reference=values["fdtd"].max())
    about = "W/m^2 for |u|^2 = 1 W/m^2, over x, y, z; "
    return Made(
        figures,
        {**axes, **values},
        {
            **dict.fromkeys("xyz", "m"),
            "fdtd": about + "finite differences, black screen, 12 cells a wavelength",
            "rays": about + "Wigner rays, Kirchhoff's obliquity",
        },
    )


def _whole(quarter: NDArray[Any]) -> NDArray[np.float64]:
    """A field that is even in x and in y, of that at x, y >= 0."""
    half = np.concatenate([quarter[:0:-1], quarter])
    return np.concatenate([half[:, :0:-1], half], axis=1)
