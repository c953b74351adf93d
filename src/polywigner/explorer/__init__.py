"""A local browser page to draw an aperture in, and to see its transforms and fields.

:mod:`~polywigner.explorer.state` and :mod:`~polywigner.explorer.views` need no page; ``plots``,
``page`` and ``server`` are the Bokeh figures, the Panel page and its server.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from polywigner.explorer.server import check_installed, serve
from polywigner.explorer.state import UNITS, State, rings_of

__all__ = ["State", "check_installed", "serve", "start_state"]


def start_state(
    path: str | None, unit: str = "mm", wave: str | None = None,
    layer: Sequence[str] | None = None, union: bool = False,
) -> State:  # fmt: skip
    """Return the state that the page opens with: an aperture file, or a chevron.

    Lengths are shown in the unit of the file, or in mm. Raises as `read_aperture`.
    """
    changes: dict[str, Any] = {} if wave is None else {"wave": wave}
    unit_of_page = {"um": "µm"}.get(unit, unit)
    state = State(unit=unit_of_page if unit_of_page in UNITS else "mm", **changes)  # type: ignore[arg-type]
    if path is None:
        return state
    import polywigner as pw

    aperture = pw.read_aperture(path, unit=unit, layer=layer, union=union)
    return replace(state, rings=rings_of(aperture, state.per_metre))
