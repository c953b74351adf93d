"""The browser page: draw an aperture, and see its transforms, fields and patterns.

Three layers, each knowing only those above it:

- :mod:`~polywigner.explorer.state`, what is shown, as one frozen value, and as the text of a
  link; ``outlines`` makes new states of old;
- :mod:`~polywigner.explorer.views`, from a state to arrays with units; ``snippets`` and
  ``exports`` write down the same as Python code and files;
- ``page``, ``visits`` and ``server``: widgets, figures and sessions, which alone import Bokeh.
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
    chosen: dict[str, Any] = {} if wave is None else {"wave": wave}
    same = {"um": "µm"}.get(unit, unit)
    if same in UNITS:
        chosen["unit"] = same
    state = State(**chosen)
    if path is None:
        return state
    import polywigner as pw
    from polywigner.explorer.outlines import rings_of_aperture

    aperture = pw.read_aperture(path, unit=unit, layer=layer, union=union)
    return state.moved(rings=rings_of_aperture(aperture, state.per_metre))
