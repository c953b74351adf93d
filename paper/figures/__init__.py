"""The figures of the paper, computed with the public functions: ``make paper-figures``.

A figure is a function ``draw_NAME(quality) -> Made`` in ``transforms``, ``fields``, ``scenes`` or
``sampling``; ``sources`` contains their apertures and wavelength. docs/figures.md compares the
figures with the captions of the paper.
"""

from __future__ import annotations

import importlib
from typing import NamedTuple

from paper.figures.sources import QUALITIES, Made, Quality

__all__ = ["FIGURES", "QUALITIES", "Made", "Quality", "Subject", "make_figure"]


class Subject(NamedTuple):
    """Module of a figure, its caption, and the letters of its panels."""

    module: str
    text: str
    parts: tuple[str, ...] = ("",)


FIGURES = {
    "render": Subject("scenes", "a scene with a coherent transmitter"),
    "amp_spec": Subject("transforms", "real part of the Fourier transform of two chevrons"),
    "indmk": Subject("transforms", "two elements and their automean"),
    "marginals": Subject("transforms", "position and lag marginals of two triangles"),
    "xforms": Subject("transforms", "construction of the slices of the autocorrelation"),
    "projs": Subject("transforms", "projections of R, W and A", ("a", "b", "c")),
    "volrender": Subject("fields", "isosurfaces of the field of two chevrons"),
    "volrender_fdtd": Subject(
        "fields", "isosurfaces of the field of a square by FDTD and by rays", ("a", "b")
    ),
    "compar": Subject(
        "fields", "Wigner rays beside Kirchhoff and Fraunhofer diffraction", ("a", "b")
    ),
    "error": Subject("fields", "error of each method against distance"),
    "emitters": Subject("scenes", "one scene by a Wigner, an FFT, a uniform and a cosine source"),
    "sampling": Subject("sampling", "samples that a grid needs, and how exact they make it"),
    "appendix": Subject("transforms", "patterns of nine apertures"),
}
"""By name, in the order of the paper."""


def make_figure(name: str, quality: Quality = "draft") -> Made:
    """Return a figure of the paper with its values."""
    module = importlib.import_module(f"{__name__}.{FIGURES[name].module}")
    made: Made = getattr(module, f"draw_{name}")(quality)
    return made
