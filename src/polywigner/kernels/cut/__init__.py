"""The parts of the edges of one copy of an outline that lie inside the other copy.

================  ==========================================================================
module            what is in it
================  ==========================================================================
``clipping``      the parts of edges inside a mirrored or shifted copy; coincident edges
``outer_bounds``  what lies too far off to have a slice
``slice_sums``    sums over the cut edges, by whichever clipper
``slice_parts``   parts of edges that bound slices, listed once for each position or lag
``cells``         the parts of edges inside the other copy, from lists for the offset's cell
``cell_lists``    what is left to do in each cell: whole edges, and edges to cut
``cell_tree``     the division of the plane of offsets into cells
``cell_finder``   which pairs of an edge and a side can meet in a cell
``cell_edges``    the edges of a source as arrays
``cell_chains``   sides that an edge meets, as the bounds of convex sets
``cell_tables``   runs of edges and cuts of parts as tables
``cut_matrix``    all edges cut by all lines at once, on NumPy
================  ==========================================================================
"""
