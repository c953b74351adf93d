"""Fig. render: a coherent patch in a scene with a floor, a wall and obstacles."""

from __future__ import annotations

from polywigner.figures.levels import picture_peak
from polywigner.figures.paper.room import Film, render_room, wigner_source
from polywigner.figures.paper.sources import Made, Quality
from polywigner.figures.scene import draw_scene

__all__ = ["make"]

_FLOOR_DB = -40.0
_FILMS = {"draft": Film(270, 225, 36), "print": Film(720, 600, 784)}


def make(quality: Quality) -> Made:
    """The 10 mm square at 94 GHz, looking down at a floor, as Mitsuba renders it."""
    radiance = render_room(wigner_source(), _FILMS[quality])
    figure = draw_scene(radiance, picture_peak(radiance), _FLOOR_DB)
    return Made(
        {"": figure},
        {"radiance": radiance},
        {"radiance": "W m^-2 sr^-1 for |u|^2 = 1 W/m^2; rows from the top; signed"},
    )
