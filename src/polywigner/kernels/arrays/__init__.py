"""Coherent sources of many elements: sums over the copies or pairs that matter at a place.

==================  =========================================================================
module              what is in it
==================  =========================================================================
``array_factor``    sums over the sites of an array, for its Fourier transform
``repeated``        what kernels of one element many times share
``lattice_arrays``  arrays on a lattice: the element near x or xi, times array factors
``factors``         array factors in phase space: the pairs of sites of one midpoint
``element_pairs``   pairs of equal elements at any positions, by cells
``pair_sums``       W, A and R of such pairs
==================  =========================================================================
"""
