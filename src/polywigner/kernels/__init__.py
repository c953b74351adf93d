"""Closed-form transforms and fields, written once for NumPy and Dr.Jit arrays.

==================  ===========================================================================
module              content
==================  ===========================================================================
``outline``         edges, weights and fields of a source in normalised coordinates
``wave_pairs``      plane waves on a source, and the pairs of waves for W and A
``cut``             parts of edges inside a shifted or mirrored copy of the source
``functions``       W, A and F
``boundary``        exact fields along edges
``gradients``       closed-form derivatives of F, W and A
``kernel``          the three steps of a transform; the second step sums over edges
``array_factors``   array factors of arrays and lattices
``lattice_arrays``  W and A of arrays on a lattice, from the element and array factors
``element_pairs``   W, A and R of equal elements at any positions, from pairs of elements
``catalogue``       the kernel of each transform and kind of source
==================  ===========================================================================

This subpackage does not read files, draw figures, choose engines or import Mitsuba.
"""

from __future__ import annotations

from polywigner.kernels.catalogue import MOST_WIDTHS, kernel_for, partly_coherent_kernel
from polywigner.kernels.functions.fourier import GridTables, fourier_on_grid, outline_tables
from polywigner.kernels.functions.plane import (
    AMBIGUITY,
    FOURIER,
    WIGNER,
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
    "Tables",
    "fourier_on_grid",
    "is_separable",
    "kernel_for",
    "new_tables_of",
    "outline_tables",
    "partly_coherent_kernel",
    "tables_of",
]
