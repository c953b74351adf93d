"""The Fourier transform of lit surfaces with their normals, N(nu) = sum_j n_j F_j(nu)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from polywigner import execution
from polywigner.execution.progress import told
from polywigner.numerics.divided_differences import simplex_plane_wave
from polywigner.numerics.phases import rotated

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]

Signs = Callable[[slice, slice], NDArray[np.int8]]

_OPS = execution.NumpyOperations(double=True)
_TITLE = "radar cross sections"
# Triangles times directions at a time: their arrays, some twenty, stay in the cache.
_BLOCK = 1 << 14


@dataclass(frozen=True)
class Pieces:
    """Triangles (n,), as (n, 3) each."""

    corner: Floats
    first: Floats
    """From the corner to the next one."""
    second: Floats
    """From the corner to the last one."""
    vector: Floats
    """The normal on the lit side, times twice the area."""

    def taken(self, rows: NDArray[np.intp] | slice) -> Pieces:
        return Pieces(self.corner[rows], self.first[rows], self.second[rows], self.vector[rows])

    def __len__(self) -> int:
        return len(self.corner)


def surface_sums(pieces: Pieces, nu: Floats, signs: Signs | None = None) -> Complex:
    """N(nu) (m, 3) at (m, 3), of triangles (n,) that count with a sign each, 0 where they are dark.

    ``signs``: the signs (i, j) of some nu and some triangles; None: all 1.
    """
    result = np.zeros((len(nu), 3), np.complex128)
    columns = max(1, min(len(pieces), _BLOCK))
    rows = _BLOCK // columns
    of_directions = [slice(k, k + rows) for k in range(0, len(nu), rows)]
    of_triangles = [slice(k, k + columns) for k in range(0, len(pieces), columns)]
    with told(_TITLE, list(product(of_directions, of_triangles))) as blocks:
        for some, part in blocks:
            own = pieces.taken(part)
            shape = len(nu[some]), len(own)
            sides = np.ones(shape, np.int8) if signs is None else signs(some, part)
            lit = np.nonzero(sides)
            turns = [(nu[some] @ v.T)[lit] for v in (own.corner, own.first, own.second)]
            values = np.zeros(shape, np.complex128)
            values[lit] = transforms(*turns) * sides[lit]
            result[some] += values @ own.vector
    return result


def transforms(
    corner: Floats, first: Floats, second: Floats, twice: Floats | None = None
) -> Complex:
    """F over twice the area of triangles, from nu.p of corner and both vectors. Source: (F5)."""
    extra = () if twice is None else (twice,)
    real, imag = rotated(_OPS, corner, *simplex_plane_wave(_OPS, first, second, *extra))
    return np.asarray(real + 1j * imag)
