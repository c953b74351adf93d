"""Numbers that render kernels read from memory."""

from __future__ import annotations

from typing import Any

import drjit as dr

__all__ = ["opaque"]


def opaque(m: Any, value: float) -> Any:
    """A number of the variant ``m``: as a literal, each new value would compile a new kernel."""
    return dr.opaque(m.Float, value) if dr.is_jit_v(m.Float) else value
