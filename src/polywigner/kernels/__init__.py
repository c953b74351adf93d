"""Closed forms on polygons, written once as straight-line code over an operations namespace.

===================  =============================================================================
module               what is in it
===================  =============================================================================
``frame``            the normalised coordinates in which all thresholds are absolute
``lattice``          exact arithmetic on vertices rounded to a grid
``supporting_lines`` lines of edges and pieces, in clusters of direction
``tables``           edges and convex pieces of a polygon as constants of a kernel
``trigonometry``     sine and cosine of turns by polynomial; the mean of a plane wave on a segment
``phases``           phases in turns from error-free products; growth for complex frequencies
``complex_pairs``    complex arithmetic for complex frequencies
``interpolation``    band-limited functions from a few samples around a place
``stokes``           the plane-wave integral over one triangle, stable for all arguments
``clipping``         the parts of edges inside a mirrored or shifted copy; coincident edges
``outer_bounds``     what lies too far off to have a slice
``wigner``           Wigner function and lag-slice area
``moments``          moments of lag slices, W's derivatives; ``polynomials`` along edges
``segment_moments``  powers times a wave, over a segment
``slice_parts``      parts of edges that bound slices, listed once for each position or lag
``run_sums``         sums along an outline, for whole edges of many slices
``shared_slices``    W and A as sums over these parts, for many frequencies
``fourier``          Fourier transform
``ambiguity``        ambiguity function and position-slice area
``waves``            sums of plane waves on a source, and what pairs of them contribute
``membership``       the field of a source at points
``simplices``        Fourier transform of slits and of what is thin, as tiles with exact phases
``slits``            sums over slices of intervals
``solids``           sums over tetrahedra
``grids``            Fourier transform on grids of frequencies
``families``         edges with equal vectors, for grids
``cells``            the parts of edges inside the other copy, from lists for the offset's cell
``cell_lists``       what is left to do in each cell: whole edges, and edges to cut
``cell_tree``        the division of the plane of offsets into cells
``cell_finder``      which pairs of an edge and a side can meet in a cell
``cell_edges``       the edges of a source as arrays
``cell_chains``      sides that an edge meets, as the bounds of convex sets
``cell_tables``      runs of edges and cuts of parts as tables
``rectangles``       which outlines are rectangles
``separable``        fields f(x) g(y) on a rectangle
``line_fields``      a few waves on one interval, and their transforms
``products``         the transforms of rectangles with such fields, as kernels
``elements``         one aperture's functions in its frame, by the kernel that suits its field
``array_factor``     sums over the sites of an array, for its Fourier transform
``repeated``         what kernels of one element many times share
``array_frames``     the frame of an array on a lattice; which sites count at a place
``lattice_arrays``   arrays on a lattice: the element near x or xi, times array factors
``factors``          array factors in phase space: the pairs of sites of one midpoint
``site_weights``     weights at the sites of a lattice, and sums over pairs
``weight_tables``    array factors of any weights, from a table periodic in the frequency
``scattered_arrays`` arrays off any lattice: pairs near a sample
``scattered_sites``  their elements and pairs, in cells
``pair_lists``       pairs of elements, sorted into cells
``distant_parts``    sources of small parts far from each other, each in its own coordinates
``distant_sums``     their W and A, pair by pair; ``distant_waves`` phases between parts
``boundary``         exact fields at points as integrals along edges; ``fresnel`` parabolic ones
``edge_waves``       what a wave at an edge adds to them; ``nodes`` rules to sum it up
``kernel``           what a transform is to an engine: enter the frame, sum, leave it
``line``             the transforms of slits
``plane``            the transforms of apertures, in their plane and in any pose
``space``            the transforms of polyhedra
``catalogue``        which kernel computes which transform of which source
===================  =============================================================================

This room knows no file, no plot, no engine and no Mitsuba.
"""

from __future__ import annotations

from typing import Any

from polywigner.kernels.catalogue import kernel_for
from polywigner.kernels.grids import GridTables, fourier_on_grid
from polywigner.kernels.kernel import Kernel, parts_of
from polywigner.kernels.plane import (
    AMBIGUITY,
    FOURIER,
    WIGNER,
    new_outline_of,
    new_tables_of,
    tables_of,
)
from polywigner.kernels.separable import is_separable
from polywigner.kernels.shared_slices import PartSum, SharedSlice, shared_slice
from polywigner.kernels.tables import Tables

__all__ = [
    "AMBIGUITY",
    "FOURIER",
    "WIGNER",
    "GridTables",
    "Kernel",
    "PartSum",
    "SharedSlice",
    "Tables",
    "fourier_on_grid",
    "is_separable",
    "kernel_for",
    "new_outline_of",
    "new_tables_of",
    "parts_of",
    "shared_slice",
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
