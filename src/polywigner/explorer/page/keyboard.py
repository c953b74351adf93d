"""Keys that visitors press, as edits of the state."""

from __future__ import annotations

import math
import time
from typing import TYPE_CHECKING

from polywigner.explorer import editing
from polywigner.explorer.page.access import WITH_KEYS

if TYPE_CHECKING:
    from polywigner.explorer.page.session import Session

__all__ = ["Keyboard"]

_ARROWS = {"ArrowLeft": (-1, 0), "ArrowRight": (1, 0), "ArrowDown": (0, -1), "ArrowUp": (0, 1)}
_FASTER = 10  # steps, with Shift
_STEPS = 100  # across a figure, where no raster is set
_TOGETHER = 1.0  # seconds: moves of one vertex that follow so soon are one step of undo


def round_step(length: float) -> float:
    """The largest of 1, 2, 5, 10, 20, ... times a power of ten that is not above a length."""
    power = 10.0 ** math.floor(math.log10(length))
    return max((m * power for m in (1, 2, 5) if m * power <= length * (1 + 1e-9)), default=power)


def moved(point: tuple[float, float], key: str, step: float) -> tuple[float, float]:
    """A point after an arrow, without stray digits."""
    digits = max(0, 3 - math.floor(math.log10(step)))
    x, y = (c + step * d for c, d in zip(point, _ARROWS[key], strict=True))
    return round(x, digits) + 0.0, round(y, digits) + 0.0


class Keyboard:
    """The keys of the page of a visitor, and their handlers."""

    def __init__(self, session: Session) -> None:
        self.session = session
        self._last = (-1, 0.0)  # the vertex that was moved, and when

    def pressed(self, key: str, figure: str, shift: bool) -> None:
        """A key, in a figure that takes keys or anywhere ("")."""
        session = self.session
        if key == "undo":
            session.go(session.history.undone())
        elif key == "redo":
            session.go(session.history.redone())
        elif key in _ARROWS and figure in WITH_KEYS:
            self._arrow(key, figure, _FASTER if shift else 1)
        elif figure == "aperture" and not session.controls.draw.active:
            self._vertex(key)

    def _step(self, figure: str) -> float:
        window = self.session.figures.by_name(figure).x_range
        snap = self.session.state.snap
        if snap > 0 and figure in ("aperture", "wigner_x"):
            return snap
        return round_step(abs(window.end - window.start) / _STEPS)

    def _arrow(self, key: str, figure: str, times: int) -> None:
        session, step = self.session, times * self._step(figure)
        chosen = session.figures.aperture.chosen if figure == "aperture" else None
        if chosen is not None and not session.controls.draw.active:
            self._move(chosen, key, step)
            return
        name = "x" if figure in ("aperture", "wigner_x") else "nu"
        x, y = there = moved(getattr(session.state, name), key, step)
        session.edit(step=False, edges=False, **{name: there})
        unit = session.state.unit if name == "x" else f"1/{session.state.unit}"
        session.say(f"{'x' if name == 'x' else 'ν'} = ({x:g}, {y:g}) {unit}", hint=True)

    def _move(self, chosen: int, key: str, step: float) -> None:
        session, now = self.session, time.monotonic()
        vertex, last = self._last
        rings = editing.with_vertex_at(
            session.state.rings, chosen, moved(self._vertices()[chosen], key, step)
        )
        session.edit(step=vertex != chosen or now - last > _TOGETHER, rings=rings)
        self._last = (chosen, now)
        self.choose(chosen)

    def _vertex(self, key: str) -> None:
        session, count = self.session, len(self._vertices())
        chosen = session.figures.aperture.chosen
        if key in "nNpP" and count:
            by = 1 if key in "nN" else -1
            self.choose(((-1 if by > 0 else 0) if chosen is None else chosen) + by)
        elif key == "Escape":
            session.figures.aperture.choose(None)
            session.say("")
        elif key in ("Insert", "Delete") and chosen is not None:
            self._last = (-1, 0.0)
            if key == "Insert":
                session.edit(rings=editing.with_vertex_after(session.state.rings, chosen))
                self.choose(chosen + 1)
            elif not session.delete(chosen):
                self.choose(chosen)

    def _vertices(self) -> list[tuple[float, float]]:
        return [(x, y) for _, x, y in editing.rows_of_rings(self.session.state.rings)]

    def choose(self, vertex: int) -> None:
        """Select a vertex, counted around, and say where it is."""
        vertices = self._vertices()
        if not vertices:
            return
        vertex %= len(vertices)
        self.session.figures.aperture.choose(vertex)
        x, y = vertices[vertex]
        self.session.say(
            f"Vertex {vertex + 1} of {len(vertices)}: ({x:g}, {y:g}) {self.session.state.unit}",
            hint=True,
        )
