"""Which kernels have derivatives in closed form."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from polywigner.kernels.functions import plane
from polywigner.kernels.kernel import Kernel
from polywigner.kernels.slopes.slopes import Slopes
from polywigner.kernels.slopes.slopes_of_outlines import fourier_slopes
from polywigner.kernels.slopes.slopes_of_slices import ambiguity_slopes, wigner_slopes
from polywigner.numerics.complex_pairs import Pair

__all__ = ["SlopeKernel", "slope_kernel_of"]


@dataclass(frozen=True)
class SlopeKernel:
    """Derivatives of the sum over edges of a kernel."""

    slopes: Callable[..., Slopes]
    """(ops, tables, accumulator, *arguments in the frame)."""
    arguments: int
    """How many of the arguments in the frame it takes, the last ones."""
    frequency_leads: bool = True
    """Whether a frequency is the first argument, before a place if there is any."""
    has_place: bool = True
    is_wave: bool = True
    """Whether sums are (cosine, sine) of V = cosine - i sine; else the real part."""

    def parts(self, value: Pair) -> tuple[Any, ...]:
        """The kernel's sums of V."""
        return (value.real, -value.imag) if self.is_wave else (value.real,)

    def cotangent(self, out: Sequence[Any]) -> Pair:
        """g so that the sums times their gradients are Re g Re V + Im g Im V."""
        return Pair(out[0], -out[1]) if self.is_wave else Pair(out[0], 0.0)

    def entered(self, ops: Any, frame: Any, change: Sequence[Any]) -> tuple[Any, ...]:
        """Changes of the arguments in the frame: of the frequency, then of the place."""
        if not self.has_place:
            return tuple(frame.frequency(ops, *change))
        first, second = change[:2], change[2:]
        frequency, place = (first, second) if self.frequency_leads else (second, first)
        return (*frame.frequency(ops, *frequency), *frame.vector(ops, *place))

    def left(
        self, ops: Any, frame: Any, frequency: Sequence[Any], place: Sequence[Any]
    ) -> tuple[Any, ...]:
        """The gradient in the arguments, from those in frequency and place of the frame.

        ``ops``: of plain floats.
        """
        of_frequency = _transposed(ops, frame.frequency, len(frame.rows[0]), frequency)
        if not self.has_place:
            return of_frequency
        of_place = _transposed(ops, frame.vector, 2, place)
        return (*of_frequency, *of_place) if self.frequency_leads else (*of_place, *of_frequency)


def _transposed(
    ops: Any, linear: Callable[..., Sequence[float]], dimension: int, gradient: Sequence[Any]
) -> tuple[Any, ...]:
    """The transpose of a linear map, with its columns in plain floats, of a gradient."""
    result = []
    for k in range(dimension):
        unit = (0.0,) * k + (1.0,) + (0.0,) * (dimension - 1 - k)
        column = linear(ops, *unit)
        terms = [g * c for g, c in zip(gradient, column, strict=True) if c]
        result.append(sum(terms[1:], terms[0]) if terms else 0.0)
    return tuple(result)


_WIGNER = SlopeKernel(wigner_slopes, 4, frequency_leads=False, is_wave=False)
_AMBIGUITY = SlopeKernel(ambiguity_slopes, 4)
_FOURIER = SlopeKernel(fourier_slopes, 2, has_place=False)
_KNOWN = {
    plane.WIGNER: _WIGNER,
    plane.AMBIGUITY: _AMBIGUITY,
    plane.FOURIER: _FOURIER,
    plane.FOURIER_PLACED: _FOURIER,
}


def slope_kernel_of(kernel: Kernel) -> SlopeKernel | None:
    """The derivatives of a kernel, or None if they are Dr.Jit's to find."""
    return _KNOWN.get(kernel)
