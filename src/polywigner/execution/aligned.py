"""Numbers of NumPy as arrays of Dr.Jit."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

__all__ = ["aligned", "array_of"]


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
