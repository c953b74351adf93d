"""The browser page: draw an aperture, and see its transforms, fields and patterns.

Three layers, each knowing only those above it:

- :mod:`~polywigner.explorer.state`, what is shown, as one frozen value, and as the text of a
  link; ``editing`` makes new states of old;
- :mod:`~polywigner.explorer.views`, from a state to arrays with units; ``snippets`` and
  ``exports`` write down the same as Python code and files;
- ``page`` and ``server``: widgets, figures and sessions, the only modules that import Bokeh.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from polywigner.explorer.server import check_installed, serve
from polywigner.explorer.state import UNITS, State

__all__ = ["State", "check_installed", "serve", "start_state"]


def start_state(
    path: str | None,
    unit: str = "mm",
    wave: str | None = None,
    layer: Sequence[str] | None = None,
    union: bool = False,
) -> State:
    """The state that the page opens with: of an aperture file, or the first shape of the catalogue.

    ``layer`` and ``union`` are those of :func:`polywigner.read_aperture`. Lengths are shown in the
    unit, where the page has it, otherwise in mm.

    Raises
    ------
    PolywignerError for a file that cannot be read, or has more vertices than the page edits.
    """
    from polywigner.explorer.sources import state_of_file

    chosen: dict[str, Any] = {} if wave is None else {"wave": wave}
    same = {"um": "µm"}.get(unit, unit)
    if same in UNITS:
        chosen["unit"] = same
    state = State(**chosen)
    return state if path is None else state_of_file(path, unit, state, layer, union)
