"""How many threads the compiled kernels of this process run on."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from polywigner.engines import llvm

__all__ = ["kernel_threads"]


@contextmanager
def kernel_threads(count: int | None) -> Iterator[None]:
    """Within, Dr.Jit's pool has ``count`` threads, the caller's included; None: as many as before.

    There is one pool in a process: to be entered by one thread at a time. Nothing changes where
    Dr.Jit cannot be used.
    """
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
