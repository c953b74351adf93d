"""Memory that Dr.Jit takes over as it is."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

__all__ = ["aligned"]


def aligned(size: int, dtype: Any) -> npt.NDArray[Any]:
    """An uninitialised array that starts on a 64-byte boundary.

    Dr.Jit uses NumPy's memory in place and compiles a kernel anew for each alignment that it
    happens to have; here it is always the same.
    """
    kind = np.dtype(dtype)
    memory = np.empty(size * kind.itemsize + 64, np.uint8)
    start = -memory.ctypes.data % 64
    return memory[start : start + size * kind.itemsize].view(kind)
