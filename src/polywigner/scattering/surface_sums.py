"""The Fourier transform of lit surfaces with their normals, N(nu) = sum_j n_j F_j(nu)."""

from __future__ import annotations

from collections.abc import Callable, Iterator
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

    ``signs``: those (i, j) of some nu and some triangles; None: all 1.
    """
    result = np.zeros((len(nu), 3), np.complex128)
    with told(_TITLE, _blocks(len(nu), len(pieces))) as blocks:
        for some, part in blocks:
            lit = None if signs is None else signs(some, part)
            result[some] += _block(pieces.taken(part), lit, nu[some])
    return result


def surface_slopes(pieces: Pieces, nu: Floats, signs: Signs | None = None) -> Complex:
    """dN_i/dnu_a (m, 3, 3) at (m, 3), as :func:`surface_sums`: the first moments, (SC5)."""
    result = np.zeros((len(nu), 3, 3), np.complex128)
    with told(_TITLE, _blocks(len(nu), len(pieces))) as blocks:
        for some, part in blocks:
            own = pieces.taken(part)
            lit: NDArray[np.int8] | float = 1.0 if signs is None else signs(some, part)
            moments = _first_moments(own, nu[some])
            for axis, values in enumerate(moments):
                result[some, :, axis] += (values * lit) @ own.vector
    return result


def _blocks(directions: int, triangles: int) -> list[tuple[slice, slice]]:
    """Slices of directions and of triangles that are summed at a time."""
    columns = max(1, min(triangles, _BLOCK))
    rows = _BLOCK // columns
    of_directions = [slice(k, k + rows) for k in range(0, directions, rows)]
    of_triangles = [slice(k, k + columns) for k in range(0, triangles, columns)]
    return list(product(of_directions, of_triangles))


def _first_moments(pieces: Pieces, nu: Floats) -> Iterator[Complex]:
    """Derivatives in x, y and z of nu (m, n) of :func:`transforms`.

    That in the wave's exponent at a corner is the divided difference with this corner twice.
    """
    corner, first, second = (nu @ part.T for part in _vectors(pieces))
    whole = transforms(corner, first, second)
    at_first, at_second = (
        _complex(rotated(_OPS, corner, *simplex_plane_wave(_OPS, first, second, twice)))
        for twice in (first, second)
    )
    for axis in range(3):
        yield (
            -2j
            * np.pi
            * (
                whole * pieces.corner[:, axis]
                + at_first * pieces.first[:, axis]
                + at_second * pieces.second[:, axis]
            )
        )


def _block(pieces: Pieces, signs: NDArray[np.int8] | None, nu: Floats) -> Complex:
    if signs is None:
        values = transforms(*(nu @ part.T for part in _vectors(pieces)))
    elif len(nu) == 1:
        (rows,) = np.nonzero(signs[0])
        pieces = pieces.taken(rows)
        values = transforms(*(nu @ part.T for part in _vectors(pieces))) * signs[:, rows]
    else:
        lit = np.nonzero(signs)
        values = np.zeros(signs.shape, np.complex128)
        values[lit] = transforms(*((nu @ part.T)[lit] for part in _vectors(pieces)))
        values *= signs
    result: Complex = values @ pieces.vector
    return result


def _vectors(pieces: Pieces) -> tuple[Floats, Floats, Floats]:
    return pieces.corner, pieces.first, pieces.second


def transforms(corner: Floats, first: Floats, second: Floats) -> Complex:
    """F over twice the area of triangles, from nu.p of corner and both vectors. Source: (F5)."""
    return _complex(rotated(_OPS, corner, *simplex_plane_wave(_OPS, first, second)))


def _complex(parts: tuple[Floats, Floats]) -> Complex:
    return parts[0] + 1j * parts[1]
