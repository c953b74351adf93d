"""Fields of the state on which each view depends, so that an edit recomputes these views alone."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields

from polywigner.explorer.state import State

__all__ = ["needed"]

_SOURCE = frozenset({"rings", "unit", "wave", "taper", "array", "window", "steering"})
_NEEDS: Mapping[str, frozenset[str]] = {
    "fourier": _SOURCE | {"reach", "part"},
    "wigner_nu": _SOURCE | {"x", "reach", "coherence"},
    "wigner_x": _SOURCE | {"nu", "coherence"},
    "otf": _SOURCE | {"defocus"},
    "far": _SOURCE | {"reach"},
    "near": _SOURCE | {"distance", "order"},
    "values": _SOURCE | {"x", "nu", "coherence"},
}
_PLAIN = State()
_NAMES = tuple(field.name for field in fields(State))


def needed(state: State, name: str) -> State:
    """The state with all that a view does not depend on as it is at the start."""
    others = {field: getattr(_PLAIN, field) for field in _NAMES if field not in _NEEDS[name]}
    return state.moved(**others)
