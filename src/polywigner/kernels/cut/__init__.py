"""Cuts: the parts of the edges of an outline that lie inside a copy of the outline.

================  ==========================================================================
module            content
================  ==========================================================================
``clipping``      cuts of a few edges whose coordinates are constants in compiled code
``pair_grid``     lists of pairs of edges that can cross, for each cell of the offset between
                  two copies of an outline; cuts of edges with NumPy
``cell_lists``    construction of these lists
``winding``       cuts in compiled code that reads the edges from memory
================  ==========================================================================
"""
