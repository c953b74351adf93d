"""The parts of the edges of one copy of an outline that lie inside the other copy.

================  ==========================================================================
module            what is in it
================  ==========================================================================
``clipping``      the parts of edges inside a mirrored or shifted copy; coincident edges
``pair_grid``     which edges of two copies can meet, by cells of the offset between them
``winding``       the parts of edges inside the other copy by winding numbers, from these lists
``slice_sums``    sums over the cut edges by whichever clipper; the parts that bound slices, listed
================  ==========================================================================
"""
