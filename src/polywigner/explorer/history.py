"""Undo and redo: states before and after the present one."""

from __future__ import annotations

from dataclasses import dataclass, field

from polywigner.explorer.state import State

__all__ = ["History"]

_LONGEST = 200


@dataclass(frozen=True)
class History:
    """Immutable; each step gives a new one. Only the last 200 states are kept."""

    present: State = field(default_factory=State)
    past: tuple[State, ...] = ()
    future: tuple[State, ...] = ()

    def then(self, state: State) -> History:
        """With a new present; what had been undone is forgotten. The same state is no step."""
        if state == self.present:
            return self
        return History(state, (*self.past, self.present)[-_LONGEST:])

    def instead(self, state: State) -> History:
        """With another present that is no step of its own, as in the middle of a drag."""
        return History(state, self.past, self.future)

    def undone(self) -> History:
        """One step back, where there is one."""
        if not self.past:
            return self
        return History(self.past[-1], self.past[:-1], (self.present, *self.future))

    def redone(self) -> History:
        """One step forward again, where there is one."""
        if not self.future:
            return self
        return History(self.future[0], (*self.past, self.present), self.future[1:])
