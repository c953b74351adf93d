"""Planned in the paper's comments: the Wigner source beside an FFT, a uniform and a cosine one."""

from __future__ import annotations

import numpy as np

import polywigner as pw
from polywigner.figures.levels import level_db, picture_peak
from polywigner.figures.paper.room import (
    Film,
    cosine_source,
    fft_source,
    render_room,
    uniform_source,
    wigner_source,
)
from polywigner.figures.paper.sources import WAVELENGTH, Made, Quality, square
from polywigner.figures.style import (
    LEVEL_MAP,
    TYPOGRAPHY,
    letter_panels,
    new_figure,
    number_text,
    quantity_text,
)

__all__ = ["make"]

_FLOOR_DB = -40.0
_FILMS = {"draft": Film(270, 225, 36), "print": Film(480, 400, 784)}
_OTHERS = {"draft": 16, "print": 100}  # samples of sources that leave hardly any noise
_UNIT = "W/(m² sr)"


def make(quality: Quality) -> Made:
    """One scene with four sources of equal power; 0 dB is the peak of the Wigner source's."""
    import matplotlib as mpl

    power = pw.power(square(), WAVELENGTH)
    film = _FILMS[quality]
    quiet = film._replace(samples=_OTHERS[quality])
    projector, slide = fft_source(quality)
    pictures = {
        "wigner": render_room(wigner_source(), film),
        "fft": render_room(projector, quiet, slide),
        "uniform": render_room(uniform_source(power), quiet),
        "cosine": render_room(cosine_source(power), quiet),
    }
    titles = ("Wigner, coherent aperture", "far field by FFT, from a point",
              "uniform, from a point", "cosine, incoherent surface")  # fmt: skip
    zero = picture_peak(pictures["wigner"])
    with mpl.rc_context(TYPOGRAPHY):
        figure = new_figure(8.4, 6.6)
        figure.set_layout_engine("compressed")
        panels = figure.subplots(2, 2).ravel()
        for axes, picture, title in zip(panels, pictures.values(), titles, strict=True):
            levels = level_db(picture, zero, _FLOOR_DB)
            shown = axes.imshow(levels, cmap=LEVEL_MAP, vmin=_FLOOR_DB, vmax=0.0)
            axes.set(xticks=[], yticks=[])
            axes.set_title(title)
        bar = figure.colorbar(shown, ax=panels, shrink=0.7, pad=0.02, extend="max")
        against = "nothing lit" if zero is None else quantity_text(zero, _UNIT)
        bar.set_label(f"radiance, dB relative to {against}; floor {number_text(_FLOOR_DB)} dB")
        letter_panels(panels)
    about = "W m^-2 sr^-1; rows from the top; signed"
    return Made(
        {"": figure},
        {**pictures, "power": np.asarray(power)},
        {**dict.fromkeys(pictures, about), "power": "W, of each source"},
    )
