"""Chunks of samples, aligned memory for Dr.Jit, and the thread pool of Dr.Jit."""

from __future__ import annotations

import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np
import numpy.typing as npt

from polywigner import llvm
from polywigner.execution.operations import Drjit
from polywigner.execution.progress import slow_bar


def aligned(size: int, dtype: Any) -> npt.NDArray[Any]:
    """Return an uninitialised array, shape (size,), that starts at a multiple of 64 bytes.

    Dr.Jit uses the memory of NumPy arrays, and compiles a kernel for each alignment.
    """
    kind = np.dtype(dtype)
    memory = np.empty(size * kind.itemsize + 64, np.uint8)
    start = -memory.ctypes.data % 64
    return memory[start : start + size * kind.itemsize].view(kind)


def array_of(kind: Any, values: npt.ArrayLike) -> Drjit:
    """Return a flat copy of numbers as a Dr.Jit array of the type ``kind``, in aligned memory."""
    import drjit

    numbers = np.asarray(values)
    if drjit.flag(drjit.JitFlag.FreezingScope):
        # Dr.Jit aborts the process if the memory of a NumPy array is freed during a recording. A
        # list is passed instead, because lists do not share memory with Dr.Jit.
        return kind(numbers.ravel().tolist())
    letter = "f" if drjit.is_float_v(kind) else "u" if drjit.is_unsigned_v(kind) else "i"
    memory = aligned(numbers.size, f"{letter}{drjit.itemsize_v(kind)}")
    memory.reshape(numbers.shape)[...] = numbers
    return kind(memory)


MOST_THREADS = 1024
"""Largest number of threads that callers may request."""

# A process has one Dr.Jit thread pool. Two simultaneous users would block each other forever.
_POOL = threading.Lock()


@contextmanager
def kernel_threads(count: int | None = None) -> Iterator[None]:
    """Reserve Dr.Jit's thread pool within the block.

    ``count`` is the number of threads within the block, including the calling thread. If ``count``
    is None, the number does not change. Other callers wait until the block ends. A nested block in
    the same thread would wait forever.
    """
    with _POOL:
        # Scalar variants of Mitsuba use Dr.Jit's thread pool even without an LLVM library.
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
"""Function that waits for the results of a chunk and returns them."""
Launched = Iterator[tuple[Sequence[Array], Any, Fetch]]
"""Iterator over chunks in progress: result arrays, index of the chunk in these arrays, and function
that waits for the chunk."""


def store(launched: Launched, samples: int) -> None:
    """Write the results of each chunk while the next chunk is being computed.

    The results are written to the arrays in ``launched``. ``samples`` is the total number of
    samples, for the progress bar.
    """
    last: Any = None
    with slow_bar("samples", samples) as advance:
        for chunk in launched:
            if last is not None:
                advance(_write(*last))
            last = chunk
        if last is not None:
            _write(*last)


def _write(results: Sequence[Array], where: Any, fetch: Fetch) -> int:
    """Wait for a chunk, write it to ``results[where]``, and return its number of samples."""
    parts = fetch()
    for result, values in zip(results, parts, strict=False):
        result[where] = values
    return int(np.size(parts[0]))


def ready(values: tuple[Array, ...]) -> Fetch:
    """Return a function that returns the results of a finished chunk."""
    return lambda: values


def parts_of_results(
    components: Sequence[Array], results: Sequence[Array], size: int
) -> Iterator[tuple[list[Array], list[Array]]]:
    """Yield the float64 arguments of each chunk of samples, and views of its results.

    All arrays are flat, with up to ``size`` samples. Arguments may be overwritten when the next
    chunk is requested. The components must broadcast to the shape of the results.
    """
    flat, shape = [result.reshape(-1) for result in results], results[0].shape
    full = [c if c.shape == shape else np.broadcast_to(c, shape) for c in components]
    if 0 < full[0].size <= size:
        yield [c.astype(np.float64, copy=False).reshape(-1) for c in full], flat
        return
    start = 0
    with np.nditer(
        full,
        flags=["external_loop", "buffered", "zerosize_ok"],
        op_flags=[["readonly"]] * len(full),
        op_dtypes=[np.dtype(np.float64)] * len(full),
        order="C",
        buffersize=size,
    ) as iterator:
        for chunk in iterator:
            # With one operand, nditer yields an array instead of a tuple of arrays.
            arguments: list[Any] = list(chunk) if len(full) > 1 else [chunk]
            end = start + arguments[0].size
            if end > start:
                yield arguments, [result[start:end] for result in flat]
            start = end
