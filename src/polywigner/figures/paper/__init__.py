"""The figures of the paper, regenerated from the public functions: ``polywigner figures``.

A figure is a function ``draw_NAME(quality) -> Made`` in ``transforms``, ``fields``, ``scenes`` or
``sampling``; ``sources`` has the apertures and the wavelength that they share. docs/figures.md
says what each shows and how that compares with the paper's caption.
"""

from __future__ import annotations

import importlib
from typing import NamedTuple

from polywigner.errors import ArgumentError
from polywigner.figures.paper.sources import QUALITIES, Made, Quality

__all__ = ["FIGURES", "QUALITIES", "Made", "Quality", "Subject", "check_figures", "make_figure"]


class Subject(NamedTuple):
    """The module of a figure, its caption, and letters of its pictures if it has several."""

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


def check_figures(names: list[str], quality: str) -> list[str]:
    """The names without repetitions, all of them if there is none."""
    for name in names:
        if name not in FIGURES:
            known = ", ".join(FIGURES)
            raise ArgumentError(f"expected names of figures among {known}, got {name!r}")
    if quality not in QUALITIES:
        raise ArgumentError(f"expected quality to be draft or print, got {quality!r}")
    chosen = list(dict.fromkeys(names)) or list(FIGURES)
    return chosen


def make_figure(name: str, quality: Quality = "draft") -> Made:
    """One figure of the paper with the numbers behind it."""
    check_figures([name], quality)
    module = importlib.import_module(f"{__name__}.{FIGURES[name].module}")
    made: Made = getattr(module, f"draw_{name}")(quality)
    return made
