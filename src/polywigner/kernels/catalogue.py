"""The transforms as kernels: how arguments enter the frame, the sum over edges, and the way out.

A kernel is evaluated in three steps so that an engine may do the first in float64 and the second
in float32, and may split the sum over edges when a polygon has too many to trace at once.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

from polywigner.geometry import Aperture
from polywigner.kernels import fourier, phases
from polywigner.kernels import wigner as wigner_sums
from polywigner.kernels.complex_pairs import Pair
from polywigner.kernels.frame import Frame
from polywigner.kernels.tables import Tables, build_tables

__all__ = [
    "AMBIGUITY",
    "FOURIER",
    "FOURIER_COMPLEX",
    "LAG_MARGINAL",
    "POSITION_MARGINAL",
    "WIGNER",
    "Kernel",
    "parts_of",
    "tables_of",
]

Values = tuple[Any, ...]


@dataclass(frozen=True)
class Kernel:
    """A transform; ``enter`` and ``leave`` are cheap, ``edge_sum`` is additive over edges."""

    name: str
    enter: Callable[..., Values]
    """(ops, frame, *arguments) -> arguments in the frame."""
    edge_sum: Callable[..., Values]
    """(ops, tables, *arguments in the frame) -> sums; may ignore trailing arguments."""
    leave: Callable[..., Values]
    """(ops, frame, arguments in the frame, sums) -> results, scaled to the user's units."""
    copies: int
    """How many copies of the edges are cut by the pieces: 0, 1 or 2."""
    clips_per_term: int
    """Code for a whole edge, or for what is left of one in a piece, in units of one cut's code."""

    def __call__(self, ops: Any, tables: Tables, *arguments: Any) -> Values:
        """The whole transform with one namespace of operations."""
        inner = self.enter(ops, tables.frame, *arguments)
        return self.leave(ops, tables.frame, inner, self.edge_sum(ops, tables, *inner))


@lru_cache(maxsize=256)
def tables_of(aperture: Aperture, double: bool) -> Tables:
    """The kernel tables of an aperture, for float64 or float32 kernels; built once."""
    return build_tables(aperture.rings, aperture.convex_cover, double=double)


def parts_of(kernel: Kernel, tables: Tables, size: int) -> list[Tables]:
    """Tables whose edge sums add up to that of ``tables``, each of about ``size`` clips or less.

    What a kernel does with an edge, or with the part of it in one piece, counts as
    ``kernel.clips_per_term`` clips.
    """
    per_edge = kernel.clips_per_term
    if kernel.copies:
        per_copy = sum(len(piece.sides) + kernel.clips_per_term for piece in tables.pieces)
        per_edge = kernel.copies * per_copy
    count = max(1, size // per_edge)
    edges = tables.edges
    return [replace(tables, edges=edges[k : k + count]) for k in range(0, len(edges), count)]


def _enter_wigner(ops: Any, frame: Frame, x: Any, y: Any, nu_x: Any, nu_y: Any) -> Values:
    return (*frame.position(ops, x, y), *frame.frequency(ops, nu_x, nu_y))


def _scaled(ops: Any, frame: Frame, inner: Values, sums: Values) -> Values:
    return (sums[0] * frame.content,)


def _enter_fourier(ops: Any, frame: Frame, nu_x: Any, nu_y: Any) -> Values:
    turns = phases.turns_to_centre(ops, frame, nu_x, nu_y)
    return (turns, *frame.frequency(ops, nu_x, nu_y))


def _turned(ops: Any, frame: Frame, inner: Values, sums: Values) -> Values:
    real, imag = phases.rotated(ops, inner[0], *sums)
    return real * frame.content, imag * frame.content


def _enter_fourier_complex(ops: Any, frame: Frame, *nu: Any) -> Values:
    real_x, imag_x, real_y, imag_y = nu
    turns = phases.turns_to_centre(ops, frame, real_x, real_y)
    growth = phases.growth(ops, frame, imag_x, imag_y)
    inner_real = frame.frequency(ops, real_x, real_y)
    inner_imag = frame.frequency(ops, imag_x, imag_y)
    return (turns, growth, *inner_real, *inner_imag)


def _fourier_complex(ops: Any, tables: Tables, turns: Any, growth: Any, *nu: Any) -> Values:
    real_x, real_y, imag_x, imag_y = nu
    total = fourier.fourier_complex(ops, tables, Pair(real_x, imag_x), Pair(real_y, imag_y))
    return total.real, -total.imag


def _leave_fourier_complex(ops: Any, frame: Frame, inner: Values, sums: Values) -> Values:
    real, imag = _turned(ops, frame, inner, sums)
    return real * inner[1], imag * inner[1]


def _enter_ambiguity(ops: Any, frame: Frame, *arguments: Any) -> Values:
    upsilon_x, upsilon_y, xi_x, xi_y = arguments
    return (*_enter_fourier(ops, frame, upsilon_x, upsilon_y), *frame.vector(ops, xi_x, xi_y))


WIGNER = Kernel(
    "wigner",
    _enter_wigner,
    lambda ops, tables, *inner: (wigner_sums.wigner(ops, tables, *inner),),
    _scaled,
    copies=1,
    clips_per_term=4,
)
POSITION_MARGINAL = Kernel(
    "position marginal",
    lambda ops, frame, x, y: frame.position(ops, x, y),
    lambda ops, tables, *inner: (wigner_sums.lag_slice_area(ops, tables, *inner),),
    _scaled,
    copies=1,
    clips_per_term=1,
)
FOURIER = Kernel(
    "fourier",
    _enter_fourier,
    lambda ops, tables, turns, *nu: fourier.fourier(ops, tables, *nu),
    _turned,
    copies=0,
    clips_per_term=1,
)
FOURIER_COMPLEX = Kernel(
    "fourier of complex frequencies",
    _enter_fourier_complex,
    _fourier_complex,
    _leave_fourier_complex,
    copies=0,
    clips_per_term=1,
)
AMBIGUITY = Kernel(
    "ambiguity",
    _enter_ambiguity,
    lambda ops, tables, turns, *inner: fourier.ambiguity(ops, tables, *inner),
    _turned,
    copies=2,
    clips_per_term=16,
)
LAG_MARGINAL = Kernel(
    "lag marginal",
    lambda ops, frame, xi_x, xi_y: frame.vector(ops, xi_x, xi_y),
    lambda ops, tables, *inner: (fourier.position_slice_area(ops, tables, *inner),),
    _scaled,
    copies=2,
    clips_per_term=1,
)
