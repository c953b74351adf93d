"""Computations for the page in their order: coarse first where exact takes long."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from polywigner.errors import PolywignerError
from polywigner.explorer import views
from polywigner.explorer.sources import source_of
from polywigner.explorer.state import State

_EDGES_AT_ONCE = 40
"""Up to so many edges the pictures of transforms are exact at once: 0.1 s in all."""
_EDGES_OF_FINE_RAYS = 12
_COARSE = 64
_NO_MEMORY = "expected a source that fits into memory; make it smaller"


@dataclass(frozen=True, eq=False)
class Result:
    """A view computed, or why not."""

    name: str
    value: Any = None
    error: str = ""

    def is_final(self, state: State) -> bool:
        """Whether nothing finer follows."""
        if not isinstance(self.value, views.Picture):
            return not self.error
        return self.value.samples == final_samples(state, self.name)


def stages(name: str, edges: int, partly: bool = False) -> tuple[int, ...]:
    """The samples along each axis that a picture of a source of so many edges is shown with.

    ``partly``: of one that is partly coherent.
    """
    if partly and name in ("wigner_nu", "wigner_x"):
        return (_COARSE // 2, 2 * _COARSE)
    if name == "near":
        return (16, 48, 128) if edges <= _EDGES_OF_FINE_RAYS else (16, 32)
    return (views.SAMPLES,) if edges <= _EDGES_AT_ONCE else (_COARSE, views.SAMPLES)


def final_samples(state: State, name: str) -> int:
    """The samples along each axis that a picture is shown with in the end."""
    return stages(name, views.edges_of(state), state.coherence > 0)[-1]


def queue(names: tuple[str, ...], edges: int, partly: bool = False) -> list[tuple[str, int]]:
    """Views in the order in which they are computed, with their samples along an axis (or 0)."""
    todo: list[tuple[int, str, int]] = []
    for name in names:
        if name in views.PICTURES:
            todo += [(k, name, n) for k, n in enumerate(stages(name, edges, partly))]
        else:
            todo.append((0, name, 0))
    return [(name, samples) for _, name, samples in sorted(todo, key=lambda entry: entry[0])]


def results(state: State, names: tuple[str, ...]) -> Iterator[Result | None]:
    """Views of a state, one after the other, first all coarse ones: ("source" for outlines).

    What cannot be computed says so in its result; after a source that is none nothing follows.
    None between parts of what takes long, where a newer request may come first.
    """
    try:
        source_of(state)
        yield Result("source", views.outlines(state))
    except PolywignerError as error:
        yield Result("source", error=str(error))
        return
    for name, samples in queue(names, views.edges_of(state), state.coherence > 0):
        if name == "near":
            yield from _near_results(state, samples)
        else:
            yield _result(state, name, samples)


def _near_results(state: State, samples: int) -> Iterator[Result | None]:
    try:
        for picture in views.near_field_in_steps(state, samples):
            yield None if picture is None else Result("near", picture)
    except PolywignerError as error:
        yield Result("near", error=str(error))
    except MemoryError:
        yield Result("near", error=_NO_MEMORY)


def _result(state: State, name: str, samples: int) -> Result:
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            if name in views.PICTURES:
                return Result(name, views.PICTURES[name](state, samples))
            compute = {"far": views.far_field, "values": views.values_at}[name]
            return Result(name, compute(state))
    except PolywignerError as error:
        return Result(name, error=str(error))
    except MemoryError:
        return Result(name, error=_NO_MEMORY)
