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
``fourier``          Fourier transform, ambiguity function and position-slice area
``phases``           the phase of an off-centre shape
``complex_pairs``    complex arithmetic for complex frequencies
``catalogue``        the transforms as kernels: enter the frame, sum over edges, leave it
===================  ==========================================================================

This room knows no file, no plot, no engine and no Mitsuba.
"""

from __future__ import annotations

from typing import Any

from polywigner.kernels.catalogue import (
    AMBIGUITY,
    FOURIER,
    FOURIER_COMPLEX,
    LAG_MARGINAL,
    POSITION_MARGINAL,
    WIGNER,
    Kernel,
    parts_of,
    tables_of,
)
from polywigner.kernels.tables import Tables

__all__ = [
    "AMBIGUITY",
    "FOURIER",
    "FOURIER_COMPLEX",
    "LAG_MARGINAL",
    "POSITION_MARGINAL",
    "WIGNER",
    "Kernel",
    "Tables",
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
