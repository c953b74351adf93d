"""Samples in chunks: memory that engines take as it is, results that come while others begin."""

from __future__ import annotations

import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np
import numpy.typing as npt

from polywigner.execution.progress import slow_bar
from polywigner.toolchain import llvm


def aligned(size: int, dtype: Any) -> npt.NDArray[Any]:
    """An uninitialised array that starts on a 64-byte boundary.

    Dr.Jit uses NumPy's memory in place and compiles a kernel anew for each alignment that it
    happens to have; here it is always the same.
    """
    kind = np.dtype(dtype)
    memory = np.empty(size * kind.itemsize + 64, np.uint8)
    start = -memory.ctypes.data % 64
    return memory[start : start + size * kind.itemsize].view(kind)


def array_of(kind: Any, values: npt.ArrayLike) -> Any:
    """A copy of numbers, one after the other, as a one-dimensional array of Dr.Jit's type ``kind``.

    Kernels do not depend on where it is in memory.
    """
    import drjit

    numbers = np.asarray(values)
    if drjit.flag(drjit.JitFlag.FreezingScope):
        # Dr.Jit ends the process when memory of NumPy's is freed while a function is recorded.
        return kind(numbers.ravel().tolist())
    letter = "f" if drjit.is_float_v(kind) else "u" if drjit.is_unsigned_v(kind) else "i"
    memory = aligned(numbers.size, f"{letter}{drjit.itemsize_v(kind)}")
    memory.reshape(numbers.shape)[...] = numbers
    return kind(memory)


MOST_THREADS = 1024
"""That may be asked for: far more than cores, and fewer than systems refuse."""

# There is one pool in a process; two blocks at a time would only wait for each other.
_POOL = threading.Lock()


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


Array = npt.NDArray[Any]
Fetch = Callable[[], tuple[Array, ...]]
"""Waits for the results of a chunk that has begun to be computed."""
Launched = Iterator[tuple[Sequence[Array], Any, Fetch]]
"""(results, where in them, how to fetch them); there the work has begun already."""


def store(launched: Launched, samples: int) -> None:
    """Fetch each chunk while the next one is computed."""
    last: Any = None
    with slow_bar("samples", samples) as advance:
        for chunk in launched:
            if last is not None:
                advance(_write(*last))
            last = chunk
        if last is not None:
            _write(*last)


def _write(results: Sequence[Array], where: Any, fetch: Fetch) -> int:
    """Write a chunk, and return the number of its samples."""
    found = fetch()
    for result, values in zip(results, found, strict=False):
        result[where] = values
    return int(np.size(found[0]))


def ready(values: tuple[Array, ...]) -> Fetch:
    """Results that have been computed."""
    return lambda: values


def parts_of_results(
    components: Sequence[Array], results: Sequence[Array], size: int
) -> Iterator[tuple[list[Array], list[Array]]]:
    """The components in float64, broadcast, chunk by chunk in C order; and parts of the results."""
    flat, shape = [result.reshape(-1) for result in results], results[0].shape
    whole = [c if c.shape == shape else np.broadcast_to(c, shape) for c in components]
    if 0 < whole[0].size <= size:
        yield [c.astype(np.float64, copy=False).reshape(-1) for c in whole], flat
        return
    start = 0
    with np.nditer(
        whole,
        flags=["external_loop", "buffered", "zerosize_ok"],
        op_flags=[["readonly"]] * len(whole),
        op_dtypes=[np.dtype(np.float64)] * len(whole),
        order="C",
        buffersize=size,
    ) as iterator:
        for chunk in iterator:
            # of one operand nditer gives the array itself
            arguments: list[Any] = list(chunk) if len(whole) > 1 else [chunk]
            end = start + arguments[0].size
            if end > start:
                yield arguments, [result[start:end] for result in flat]
            start = end
