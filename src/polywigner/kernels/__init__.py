"""Closed forms of transforms and fields, written once for the operations of NumPy and Dr.Jit.

==================  ===========================================================================
module              content
==================  ===========================================================================
``outline``         the source in its frame: edges, weights and fields
``wave_pairs``      sums of plane waves, and contributions of their pairs
``cut``             the parts of edges that lie inside the other copy
``functions``       W, A and F
``boundary``        exact fields along edges
``gradients``       derivatives in closed form
``kernel``          the steps of a transform: enter the frame, sum over edges, leave the frame
``array_factors``   sums over the sites of an array, and over pairs of sites of a lattice
``lattice_arrays``  arrays on a lattice: the element near x or xi, times array factors
``element_pairs``   W, A and R of equal elements at any positions: sums over pairs, by cells
``catalogue``       the kernel of each transform and kind of source
==================  ===========================================================================

This subpackage does not depend on files, plots, engines or Mitsuba.
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
from polywigner.kernels.outline import Tables

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
