"""One worker for all visitors: the newest request of each wins, older ones are dropped.

Dr.Jit's kernels use all cores by themselves, so that a second worker would only make both wait.
"""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable, Hashable, Iterator

from polywigner.explorer.logs import log_fault

Steps = Callable[[], Iterator[None]]


class Scheduler:
    """Runs work in steps, visitor after visitor in turn.

    Work is a function that gives an iterator; between two steps other visitors have their turn,
    and work that has been replaced meanwhile goes no further.
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
            self._waiting.clear()
            self._changed.notify()
        self._thread.join(timeout=patience)
        return not self._thread.is_alive()

    def _run(self) -> None:
        while True:
            with self._changed:
                while not self._waiting and not self._stopped:
                    self._changed.wait()
                if self._stopped:
                    return
                visitor, work = next(iter(self._waiting.items()))
            steps = work() if callable(work) else work
            finished = self._step(steps)
            with self._changed:
                if self._waiting.get(visitor) is work:  # not replaced, not forgotten
                    del self._waiting[visitor]
                    if not finished:
                        self._waiting[visitor] = steps  # at the end: the others' turn

    @staticmethod
    def _step(steps: Iterator[None]) -> bool:
        try:
            next(steps)
        except StopIteration:
            return True
        except Exception:  # one visitor's fault must not end the others' service
            log_fault("a request failed")
            return True
        return False
