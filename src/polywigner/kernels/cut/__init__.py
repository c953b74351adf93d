"""The parts of the edges of one copy of an outline that lie inside the other copy.

================  ==========================================================================
module            what is in it
================  ==========================================================================
``clipping``      compiled code for few edges: the parts inside a mirrored or shifted copy
``pair_grid``     which edges of two copies can meet, by cells of the offset between them; the parts
                  of edges inside the other copy on NumPy
``cell_lists``    builds the lists of these cells
``winding``       the same parts in compiled code, by winding numbers, from these lists
================  ==========================================================================
"""
