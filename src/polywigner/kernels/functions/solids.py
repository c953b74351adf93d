"""Fourier transform of polyhedra: signed tetrahedra and third divided differences.

A body is the signed sum of the tetrahedra (origin, a, b, c) over the triangles of its faces' fans.
Each contributes ``det(a, b, c) exp[0, z_a, z_b, z_c]`` with z = -2 pi i nu.p: no division by nu, no
face normals, and non-convex faces need no triangulation (docs/theory.md, (F3)).
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from functools import lru_cache
from typing import Any

import numpy as np
import numpy.typing as npt

from polywigner.geometry import Polyhedron
from polywigner.geometry.exact import whole_numbers
from polywigner.kernels.functions.fourier import LinearFrame
from polywigner.kernels.functions.plane import fourier_kernels
from polywigner.kernels.outline.frame import (
    NEEDLE_ASPECT,
    Matrix,
    determinant,
    power_of_two,
    reach_of,
    vertices_for,
)

Point = tuple[float, float, float]


@dataclass(frozen=True)
class SolidTables:
    """The body in its frame; sums run over ``edges``.

    Each is a tetrahedron: ax, ay, az, bx, ..., cz, and det(a, b, c), six times its signed volume.
    """

    frame: LinearFrame
    edges: tuple[tuple[float, ...], ...]

    @property
    def terms(self) -> int:
        """Terms of the sum, as plans count them: a tetrahedron takes as long as eight edges."""
        return 8 * len(self.edges)


@lru_cache(maxsize=64)
def solid_tables(body: Polyhedron, double: bool) -> SolidTables:
    """The tables of a polyhedron; the same for either precision."""
    centre, rows = _axes(body)
    inner = vertices_for(rows, centre, body.vertices)
    corners = inner[body.triangles]
    tetrahedra = np.column_stack([corners.reshape(-1, 9), _volumes(corners)]).tolist()
    content = abs(float(determinant([[Fraction(m) for m in row] for row in rows])))
    frame = LinearFrame(centre, rows, content, reach_of(inner))
    return SolidTables(frame, tuple(tuple(row) for row in tetrahedra if row[-1]))


def _axes(body: Polyhedron) -> tuple[Point, Matrix]:
    """The centre of the body's box, and its axes as rows times the power of two of its extents.

    World axes and one scale for all, unless the body is a needle or a plate. The box is that along
    these axes: the centre of another one would lie far outside a plate, in units of its thickness.
    """
    middle = body.vertices.mean(axis=0)
    # Without full_matrices=False it makes a matrix of vertices times vertices.
    _, _, own = np.linalg.svd(body.vertices - middle, full_matrices=False)
    own = own * np.sign(np.linalg.det(own))  # right-handed, so that volumes keep their sign
    axes = min(np.eye(3), own, key=lambda rows: np.ptp(body.vertices @ rows.T, axis=0).prod())
    along = body.vertices @ axes.T
    low, extents = along.min(axis=0), np.ptp(along, axis=0)
    scales = [power_of_two(extent) for extent in extents.tolist()]
    if not extents.max() > NEEDLE_ASPECT * extents.min() > 0.0:
        axes = np.eye(3)
        low, extents = body.vertices.min(axis=0), np.ptp(body.vertices, axis=0)
        scales = [power_of_two(float(np.linalg.norm(extents)))] * 3
    x, y, z = (axes.T @ (low + extents / 2)).tolist()
    rows = (axes * np.array(scales)[:, None]).tolist()
    return (x, y, z), tuple(tuple(row) for row in rows)


def _volumes(corners: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """det(a, b, c) of each row of corners (n, 3, 3), correctly rounded."""
    whole, exponent = whole_numbers(corners)
    exact: Any = determinant(list(np.moveaxis(whole, 0, 2)))
    scale = 1 << abs(3 * exponent)
    return np.asarray(exact / scale if exponent < 0 else exact * scale, dtype=np.float64)


FOURIER, FOURIER_COMPLEX = fourier_kernels("fourier of a body", 3, solid_tables)
