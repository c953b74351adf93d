"""Which kernels have derivatives in closed form."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from polywigner.kernels import plane
from polywigner.kernels.complex_pairs import Pair
from polywigner.kernels.kernel import Kernel
from polywigner.kernels.slopes import Slopes
from polywigner.kernels.slopes_of_outlines import fourier_slopes
from polywigner.kernels.slopes_of_slices import ambiguity_slopes, wigner_slopes

__all__ = ["SlopeKernel", "slope_kernel_of"]


@dataclass(frozen=True)
class SlopeKernel:
    """Derivatives of the sum over edges of a kernel."""

    slopes: Callable[..., Slopes]
    """(ops, tables, wanted, sink, *arguments in the frame)."""
    arguments: int
    """How many of the arguments in the frame it takes, the last ones."""
    order: tuple[int | None, int | None]
    """Where frequency and place begin among these."""
    is_wave: bool = True
    """Whether sums are (cosine, sine) of V = cosine - i sine; else the real part."""

    def parts(self, value: Pair) -> tuple[Any, ...]:
        """The kernel's sums of V."""
        return (value.real, -value.imag) if self.is_wave else (value.real,)

    def cotangent(self, out: Sequence[Any]) -> Pair:
        """g so that the sums times their gradients are Re g Re V + Im g Im V."""
        return Pair(out[0], -out[1]) if self.is_wave else Pair(out[0], 0.0)


_WIGNER = SlopeKernel(wigner_slopes, 4, (2, 0), is_wave=False)
_AMBIGUITY = SlopeKernel(ambiguity_slopes, 4, (0, 2))
_FOURIER = SlopeKernel(fourier_slopes, 2, (0, None))
_KERNELS = [
    (plane.WIGNER, _WIGNER),
    (plane.AMBIGUITY, _AMBIGUITY),
    (plane.FOURIER, _FOURIER),
    (plane.FOURIER_PLACED, _FOURIER),
]


def slope_kernel_of(kernel: Kernel) -> SlopeKernel | None:
    """The derivatives of a kernel, or None if they are Dr.Jit's to find."""
    return next((slopes for known, slopes in _KERNELS if known is kernel), None)
