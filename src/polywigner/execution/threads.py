"""How many threads the compiled kernels of this process run on."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager

from polywigner.toolchain import llvm

__all__ = ["kernel_threads"]

# There is one pool in a process; two blocks at a time would only wait for each other.
_POOL = threading.Lock()


@contextmanager
def kernel_threads(count: int | None = None) -> Iterator[None]:
    """Within, Dr.Jit's pool of threads is the caller's alone, among all that ask here for it.

    ``count``: its threads meanwhile, the caller's included; None: as many as before. Nothing but
    the waiting happens where Dr.Jit cannot be used.
    """
    with _POOL:
        if count is None or not llvm.prepare().usable:
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
