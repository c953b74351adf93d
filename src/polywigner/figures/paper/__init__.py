"""The figures of the paper, regenerated from the public functions: ``polywigner figures``.

One module for each figure, of the figure's name, with ``make(quality) -> Made``. ``sources`` has
the apertures and the wavelength that they share, ``made`` what all of them return. docs/figures.md
says what each shows and how that compares with the paper's caption.
"""

from __future__ import annotations

import importlib
from typing import NamedTuple

from polywigner.errors import ArgumentError
from polywigner.figures.paper.sources import QUALITIES, Made, Quality
from polywigner.propagation.stores_files import required

__all__ = ["FIGURES", "QUALITIES", "Made", "Quality", "Subject", "check_figures", "make_figure"]


class Subject(NamedTuple):
    """What a figure shows, the letters of its pictures if it has several, and whether it takes the
    labelled arrays that the extra ``volume`` brings."""

    text: str
    parts: tuple[str, ...] = ("",)
    labelled: bool = False


FIGURES = {
    "render": Subject("a scene with a coherent transmitter"),
    "amp_spec": Subject("real part of the Fourier transform of two chevrons"),
    "indmk": Subject("two elements and their automean"),
    "marginals": Subject("position and lag marginals of two triangles"),
    "xforms": Subject("construction of the slices of the autocorrelation"),
    "projs": Subject("projections of R, W and A", ("a", "b", "c")),
    "volrender": Subject("isosurfaces of the field of two chevrons", labelled=True),
    "volrender_fdtd": Subject(
        "isosurfaces of the field of a square by FDTD and by rays", ("a", "b"), labelled=True
    ),
    "compar": Subject("Wigner rays beside Kirchhoff and Fraunhofer diffraction", ("a", "b"), True),
    "error": Subject("error of each method against distance"),
    "emitters": Subject("one scene by a Wigner, an FFT, a uniform and a cosine source"),
    "sampling": Subject("samples that a grid needs, and how exact they make it"),
    "appendix": Subject("patterns of nine apertures"),
}
"""By name, in the order of the paper."""


def check_figures(names: list[str], quality: str) -> list[str]:
    """The names without repetitions, all of them if there is none.

    Raises
    ------
    ArgumentError : no such figure, or no such quality; MissingExtraError : a library that one of
    the figures needs is missing.
    """
    for name in names:
        if name not in FIGURES:
            known = ", ".join(FIGURES)
            raise ArgumentError(f"expected names of figures among {known}, got {name!r}")
    if quality not in QUALITIES:
        raise ArgumentError(f"expected quality to be draft or print, got {quality!r}")
    chosen = list(dict.fromkeys(names)) or list(FIGURES)
    if any(FIGURES[name].labelled for name in chosen):
        required("xarray")
    return chosen


def make_figure(name: str, quality: Quality = "draft") -> Made:
    """One figure of the paper with the numbers behind it.

    Parameters
    ----------
    name : a key of ``FIGURES``.
    quality : "draft" takes seconds; "print" has more samples.

    Raises
    ------
    ArgumentError : no such figure or quality; MissingExtraError without a library it needs.
    """
    check_figures([name], quality)
    made: Made = importlib.import_module(f"{__name__}.{name}").make(quality)
    return made
