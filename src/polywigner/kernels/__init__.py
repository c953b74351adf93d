"""Closed forms on polygons, written once as straight-line code over an operations namespace.

===================  ==========================================================================
module               what is in it
===================  ==========================================================================
``frame``            the normalised coordinates in which all thresholds are absolute
``lattice``          exact arithmetic on vertices rounded to a grid
``tables``           edges, lines and convex pieces of a polygon as constants of a kernel
``trigonometry``     sine and cosine of turns by polynomial; the mean of a plane wave on a segment
``stokes``           the plane-wave integral over one triangle, stable for all arguments
``clipping``         the parts of edges inside a mirrored or shifted copy; coincident edges
``wigner``           Wigner function and lag-slice area
``fourier``          Fourier transform
``ambiguity``        ambiguity function and position-slice area
``phases``           phases in turns from error-free products; growth for complex frequencies
``complex_pairs``    complex arithmetic for complex frequencies
``simplices``        Fourier transform of slits and of what is thin, as tiles with exact phases
``slits``            sums over slices of intervals; ``solids`` over tetrahedra
``membership``       the field of a source at points
``grids``            Fourier transform on grids of frequencies; ``families`` of equal edges
``kernel``           what a transform is to an engine: enter the frame, sum, leave it
``line``             the transforms of slits, ``plane`` of apertures, ``space`` of polyhedra
``catalogue``        which kernel computes which transform of which source
===================  ==========================================================================

This room knows no file, no plot, no engine and no Mitsuba.
"""

from __future__ import annotations

from typing import Any

from polywigner.kernels.catalogue import kernel_for
from polywigner.kernels.grids import GridTables, fourier_on_grid
from polywigner.kernels.kernel import Kernel, parts_of
from polywigner.kernels.plane import AMBIGUITY, WIGNER, tables_of
from polywigner.kernels.separable import is_separable
from polywigner.kernels.tables import Tables

__all__ = [
    "AMBIGUITY",
    "WIGNER",
    "GridTables",
    "Kernel",
    "Tables",
    "fourier_on_grid",
    "is_separable",
    "kernel_for",
    "parts_of",
    "tables_of",
    "wigner",
]


def wigner(ops: Any, tables: Tables, x: Any, y: Any, nu_x: Any, nu_y: Any) -> Any:
    """W(x, nu) of the aperture behind ``tables``, traced or computed with ``ops``.

    x, y in the aperture's unit (metres), nu in its inverse; the result in its square. For code
    that is itself traced, such as a light source in a renderer; ``ops`` from
    :func:`polywigner.engines.ops_for` and ``tables`` from :func:`tables_of` with
    ``double=ops.double``.
    """
    return WIGNER(ops, tables, x, y, nu_x, nu_y)[0]
