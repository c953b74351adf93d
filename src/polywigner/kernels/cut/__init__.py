"""Cuts: the parts of the edges of one copy of an outline that lie inside a second copy.

================  ==========================================================================
module            content
================  ==========================================================================
``clipping``      few edges as constants of compiled code, clipped by convex pieces
``pair_grid``     the edges of two copies that can meet, by cells of the offset between them;
                  cuts of edges on NumPy
``cell_lists``    builds the lists of these cells
``winding``       cuts in compiled code, by winding numbers, with edges as data
================  ==========================================================================
"""
