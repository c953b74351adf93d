"""Real numbers out of whatever a caller gives."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["real_numbers"]


def real_numbers(values: Any) -> NDArray[np.float64]:
    """A float64 copy.

    Raises ValueError for what NumPy would convert, but not without loss or guessing: complex
    numbers, texts, and arrays with masked elements; and for what it does not convert.
    """
    if np.ma.is_masked(values):
        raise ValueError("masked elements; leave them out")
    try:
        raw = np.asarray(values)
        if raw.dtype.kind not in "iufO":
            raise TypeError
        return np.array(raw, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        raise ValueError(type(values).__name__) from None
