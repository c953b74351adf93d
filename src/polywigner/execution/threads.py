"""How many threads the compiled kernels of this process run on, and when threads give up."""

from __future__ import annotations

import sys
import threading
from collections.abc import Iterator
from concurrent.futures import CancelledError
from contextlib import contextmanager

from polywigner.toolchain import llvm

__all__ = ["MOST_THREADS", "check_not_stopped", "kernel_threads", "stop_this_thread_when"]

MOST_THREADS = 1024
"""That may be asked for: far more than cores, and fewer than systems refuse."""

# There is one pool in a process; two blocks at a time would only wait for each other.
_POOL = threading.Lock()

_own = threading.local()


def stop_this_thread_when(stop: threading.Event) -> None:
    """What this thread computes raises CancelledError, within a chunk, when the event is set."""
    _own.stop = stop


def check_not_stopped() -> None:
    """Raises CancelledError in a thread that is to stop; called between chunks."""
    stop = getattr(_own, "stop", None)
    if stop is not None and stop.is_set():
        raise CancelledError


@contextmanager
def kernel_threads(count: int | None = None) -> Iterator[None]:
    """Within, Dr.Jit's pool of threads is the caller's alone, among all that ask here for it.

    ``count``: its threads meanwhile, the caller's included; None: as many as before. Nothing but
    the waiting happens where Dr.Jit cannot be used.
    """
    with _POOL:
        # scalar variants of Mitsuba, which has loaded it then, run on that pool without LLVM too
        if count is None or not (llvm.prepare().usable or "drjit" in sys.modules):
            yield
            return
        import drjit

        before = drjit.thread_count()
        if before == count:
            yield
            return
        drjit.set_thread_count(count)
        try:
            yield
        finally:
            drjit.set_thread_count(before)
