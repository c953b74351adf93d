"""Closed forms on polygons, written once as straight-line code over an operations namespace.

=============  ================================================================
module         what is in it
=============  ================================================================
``outline``    the source in its frame: edges, waves; lines and pieces of compiled code
``cut``        what of an edge lies inside the other copy
``functions``  W, A, F and areas
``arrays``     sums over copies and pairs of elements
``boundary``   exact fields along edges
``slopes``     derivatives in closed form
``kernel``     what a transform is to an engine: enter the frame, sum, leave it
``catalogue``  which kernel computes which transform of which source
=============  ================================================================

This room knows no file, no plot, no engine and no Mitsuba.
"""

from __future__ import annotations

from polywigner.kernels.catalogue import MOST_WIDTHS, kernel_for, partly_coherent_kernel
from polywigner.kernels.functions.fourier import GridTables, OutlineSum, fourier_on_grid
from polywigner.kernels.functions.plane import (
    AMBIGUITY,
    FOURIER,
    WIGNER,
    new_outline_of,
    new_tables_of,
    tables_of,
)
from polywigner.kernels.functions.separable import is_separable
from polywigner.kernels.kernel import Kernel
from polywigner.kernels.outline.tables import Tables

__all__ = [
    "AMBIGUITY",
    "FOURIER",
    "MOST_WIDTHS",
    "WIGNER",
    "GridTables",
    "Kernel",
    "OutlineSum",
    "Tables",
    "fourier_on_grid",
    "is_separable",
    "kernel_for",
    "new_outline_of",
    "new_tables_of",
    "partly_coherent_kernel",
    "tables_of",
]
