"""Fourier transforms of polyhedra as signed sums over tetrahedra.

The tetrahedra (origin, a, b, c) stand on the triangles of the fans of all faces. Each contributes
``det(a, b, c) exp[0, z_a, z_b, z_c]`` with z = -2 pi i nu.p. The sum has no division by nu and no
face normals, and concave faces need no triangulation (docs/theory.md, (F3)).
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from functools import lru_cache
from typing import Any

import numpy as np
import numpy.typing as npt

from polywigner.geometry import Polyhedron
from polywigner.geometry.rings import whole_numbers
from polywigner.kernels.functions.fourier import LinearFrame, fan_sum
from polywigner.kernels.functions.plane import enter_frequency
from polywigner.kernels.kernel import Kernel, leave_wave
from polywigner.kernels.outline.frame import (
    NEEDLE_ASPECT,
    Matrix,
    determinant,
    power_of_two,
    vertices_for,
)


@dataclass(frozen=True)
class SolidTables:
    """Tetrahedra of a body in its frame, as rows of ``edges``.

    Each row is ax, ay, az, bx, ..., cz, and det(a, b, c), which is six times the signed volume.
    """

    frame: LinearFrame
    edges: tuple[tuple[float, ...], ...]

    @property
    def terms(self) -> int:
        """Number of terms, for the choice of an engine: a tetrahedron counts as eight edges."""
        return 8 * len(self.edges)


@lru_cache(maxsize=64)
def solid_tables(body: Polyhedron, double: bool) -> SolidTables:
    """Return the tables of a polyhedron; the same for either precision."""
    centre, rows = _axes(body)
    inner = vertices_for(rows, centre, body.vertices)
    # fans divide opposite faces of thin bodies in the same way, so that rounding errors cancel
    fans = [(f[0], f[k], f[k + 1]) for f in body.faces for k in range(1, len(f) - 1)]
    corners = inner[np.array(fans, np.intp)]
    tetrahedra = np.column_stack([corners.reshape(-1, 9), _volumes(corners)]).tolist()
    measure = abs(float(determinant([[Fraction(m) for m in row] for row in rows])))
    frame = LinearFrame(centre, rows, measure)
    return SolidTables(frame, tuple(tuple(row) for row in tetrahedra if row[-1]))


def _axes(body: Polyhedron) -> tuple[tuple[float, float, float], Matrix]:
    """Return the centre of the body's box, and its axes times the power of two of its extents.

    Needles and plates have their principal axes and a scale for each axis. All other bodies have
    the user's axes and one scale. The centre is the centre of the box along the chosen axes: the
    centre of another box could lie many thicknesses away from a plate.
    """
    mean = body.vertices.mean(axis=0)
    # without full_matrices=False, NumPy makes a matrix of vertices times vertices.
    _, _, principal = np.linalg.svd(body.vertices - mean, full_matrices=False)
    # a right-handed system, so that volumes keep their sign
    principal = principal * np.sign(np.linalg.det(principal))
    axes = min(np.eye(3), principal, key=lambda rows: np.ptp(body.vertices @ rows.T, axis=0).prod())
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
    """Return det(a, b, c) of each row of corners (n, 3, 3), correctly rounded."""
    integers, exponent = whole_numbers(corners)
    exact: Any = determinant(list(np.moveaxis(integers, 0, 2)))
    scale = 1 << abs(3 * exponent)
    return np.asarray(exact / scale if exponent < 0 else exact * scale, dtype=np.float64)


BODY = Kernel("fourier of a body", 3, solid_tables, enter_frequency, fan_sum, leave_wave)
