"""The Fourier transform of polyhedra as kernels."""

from __future__ import annotations

from typing import Any

from polywigner.kernels.functions.plane import enter_complex_frequency, enter_frequency
from polywigner.kernels.functions.solids import (
    solid_tables,
    solid_transform,
    solid_transform_complex,
)
from polywigner.kernels.kernel import Kernel, Values, leave_complex, leave_wave
from polywigner.numerics.complex_pairs import Pair

__all__ = ["FOURIER", "FOURIER_COMPLEX"]


def _real_sum(ops: Any, tables: Any, turns: Any, *nu: Any) -> Values:
    return solid_transform(ops, tables, *nu)


def _complex_sum(ops: Any, tables: Any, turns: Any, growth: Any, *nu: Any) -> Values:
    x, y, z = (Pair(real, imag) for real, imag in zip(nu[:3], nu[3:], strict=True))
    total = solid_transform_complex(ops, tables, (x, y, z))
    return total.real, total.imag


FOURIER = Kernel("fourier of a body", 3, solid_tables, enter_frequency, _real_sum, leave_wave)
FOURIER_COMPLEX = Kernel(
    "fourier of a body, complex nu",
    3,
    solid_tables,
    enter_complex_frequency,
    _complex_sum,
    leave_complex,
)
