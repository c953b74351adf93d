"""Fig. projs: projections of R, W and A in grids of tiles whose neighbours share an axis."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

import polywigner as pw
from polywigner.figures.paper.sources import Made, Quality, chevrons, number_samples
from polywigner.figures.projections import draw_projections
from polywigner.figures.style import number_panels
from polywigner.transforms.projection import PhaseSpaceFunction

__all__ = ["KINDS", "make"]

KINDS: dict[str, PhaseSpaceFunction] = {"a": "autocorrelation", "b": "wigner", "c": "ambiguity"}


def make(quality: Quality) -> Made:
    """The four tiles of each grid of the paper, for two chevrons; the numbers have all six."""
    figures = {}
    values: dict[str, NDArray[Any]] = {}
    about: dict[str, str] = {}
    for letter, kind in KINDS.items():
        found = pw.projections(chevrons(), kind, samples=number_samples(quality, 97, 513))
        title = f"({letter}) projected {_called(kind)}, two chevrons"
        figures[letter] = draw_projections(found, title=title)
        number_panels(figures[letter], letter)
        for name in (*found.coords, *found.data_vars):
            key = str(name) if name in found.coords else f"{kind}_{name}"
            values[key] = np.asarray(found[name].values)
            units = found[name].attrs["units"]
            dims = ", ".join(map(str, found[name].dims))
            about[key] = units if name in found.coords else f"{units}, over {dims}"
    return Made(figures, values, about)


def _called(kind: PhaseSpaceFunction) -> str:
    return {"wigner": "Wigner function"}.get(kind, f"{kind} function")
