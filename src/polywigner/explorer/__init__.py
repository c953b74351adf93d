"""A local browser page to draw an aperture in, and to see its transforms and fields.

- :mod:`~polywigner.explorer.state`: outline, illumination and chosen point as one frozen value;
- :mod:`~polywigner.explorer.views`: the eight views as arrays, code and files;
- ``plots``, ``page`` and ``server``: Bokeh figures, the Panel page and its server.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from polywigner.explorer.server import check_installed, serve
from polywigner.explorer.state import UNITS, State, rings_of

__all__ = ["State", "check_installed", "serve", "start_state"]


def start_state(
    path: str | None,
    unit: str = "mm",
    wave: str | None = None,
    layer: Sequence[str] | None = None,
    union: bool = False,
) -> State:
    """Return the state that the page opens with: an aperture file, or a chevron.

    ``layer`` and ``union`` are those of :func:`polywigner.read_aperture`. The page uses the unit
    if it has it, otherwise mm.

    Raises PolywignerError for a file that cannot be read or has too many vertices.
    """
    changes: dict[str, Any] = {} if wave is None else {"wave": wave}
    unit_of_page = {"um": "µm"}.get(unit, unit)
    if unit_of_page in UNITS:
        changes["unit"] = unit_of_page
    state = State(**changes)
    if path is None:
        return state
    import polywigner as pw

    aperture = pw.read_aperture(path, unit=unit, layer=layer, union=union)
    return replace(state, rings=rings_of(aperture, state.per_metre))
