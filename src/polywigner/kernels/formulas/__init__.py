"""Sums over the boundaries of slices: one cut for all outlines (docs/theory/edges.md, (K2)).

==============  ==================================================================
module          what is in it
==============  ==================================================================
``slice_sum``   the cut, by winding numbers and crossings
``integrands``  what is summed: W, A, areas
``slices``      W, A and the marginals as kernels
==============  ==================================================================
"""
