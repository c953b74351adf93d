"""Computations for the page: coarse first where exact takes long, and visitors in turn."""

from __future__ import annotations

import logging
import threading
import warnings
from collections import OrderedDict
from collections.abc import Callable, Hashable, Iterator
from dataclasses import dataclass
from typing import Any

from polywigner.errors import PolywignerError
from polywigner.explorer import views
from polywigner.explorer.outlines import source_of
from polywigner.explorer.state import State

_EDGES_AT_ONCE = 40
"""Up to so many edges the pictures of transforms are exact at once: 0.1 s in all."""
_EDGES_OF_FINE_RAYS = 12
_COARSE = 64

Steps = Callable[[], Iterator[None]]


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


def queue(state: State, names: tuple[str, ...]) -> list[tuple[str, int]]:
    """Views in the order in which they are computed, with their samples along an axis (or 0)."""
    edges, partly = views.edges_of(state), state.coherence > 0
    counts = {n: stages(n, edges, partly) if n in views.PICTURES else (0,) for n in names}
    todo = [(k, name, count) for name in names for k, count in enumerate(counts[name])]
    return [(name, count) for _, name, count in sorted(todo, key=lambda entry: entry[0])]


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
    for name, samples in queue(state, names):
        try:
            for value in _steps(state, name, samples):
                yield None if value is None else Result(name, value)
        except PolywignerError as error:
            yield Result(name, error=str(error))
        except MemoryError:
            yield Result(name, error="expected a source that fits into memory; make it smaller")


def _steps(state: State, name: str, samples: int) -> Iterator[Any]:
    if name == "near":
        yield from views.near_field_in_steps(state, samples)
        return
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        if name in views.PICTURES:
            value: Any = views.PICTURES[name](state, samples)
        else:
            value = views.far_field(state) if name == "far" else views.values_at(state)
    yield value


class Scheduler:
    """One worker for all visitors: the newest request of each wins, older ones are dropped.

    Work is a function that gives an iterator; between two steps other visitors have their turn,
    and work that has been replaced meanwhile goes no further. Dr.Jit's kernels use all cores by
    themselves, so that a second worker would only make both wait.
    """

    def __init__(self) -> None:
        self._waiting: OrderedDict[Hashable, Steps | Iterator[None]] = OrderedDict()
        self._changed = threading.Condition()
        self._stopped = False
        self._thread = threading.Thread(target=self._run, name="explorer", daemon=True)
        self._thread.start()

    def submit(self, visitor: Hashable, work: Steps) -> None:
        """Do this for a visitor, in place of whatever was to be done for it."""
        with self._changed:
            self._waiting[visitor] = work  # keeps the visitor's place in the queue
            self._changed.notify()

    def forget(self, visitor: Hashable) -> None:
        """Drop the work for a visitor who has left."""
        with self._changed:
            self._waiting.pop(visitor, None)

    def stop(self, patience: float = 1.0) -> bool:
        """Begin nothing else; whether the step at work was done within this many seconds."""
        with self._changed:
            self._stopped = True
            self._changed.notify()
        self._thread.join(timeout=patience)
        return not self._thread.is_alive()

    def _run(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._waiting or self._stopped)
                if self._stopped:
                    return
                visitor, work = next(iter(self._waiting.items()))
            steps = work() if callable(work) else work
            try:
                next(steps)
                finished = False
            except StopIteration:
                finished = True
            except Exception:  # one visitor's fault must not end the others' service
                logging.getLogger("polywigner.explorer").exception("a request failed")
                finished = True
            with self._changed:
                if self._waiting.get(visitor) is work:  # not replaced, not forgotten
                    del self._waiting[visitor]
                    if not finished:
                        self._waiting[visitor] = steps  # at the end: the others' turn
