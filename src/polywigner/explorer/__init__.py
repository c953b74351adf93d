"""A local browser page to draw an aperture in, and to see its transforms and fields.

:mod:`~polywigner.explorer.state` and :mod:`~polywigner.explorer.views` need no page; ``plots``,
``page`` and ``server`` are the Bokeh figures, the Panel page and its server.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from polywigner import read_aperture
from polywigner.explorer.server import serve
from polywigner.explorer.state import UNITS, State, rings_of

__all__ = ["State", "serve", "start_state"]


def start_state(
    path: str | None, wave: str | None = None, unit: str = "mm", **reading: Any
) -> State:
    """Return the state that the page opens with: an aperture file, or a chevron.

    The page has the unit of the file, or mm. ``reading`` and errors are those of read_aperture.
    """
    unit_of_page = {"um": "µm"}.get(unit, unit)
    state = State(unit=unit_of_page if unit_of_page in UNITS else "mm", wave=wave or State.wave)
    if path is None:
        return state
    return replace(state, rings=rings_of(read_aperture(path, unit, **reading), state.per_metre))
