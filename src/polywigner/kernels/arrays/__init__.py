"""Array kernels: sums over copies of one element, or over pairs of copies.

==================  ==========================================================================
module              content
==================  ==========================================================================
``array_factors``   sums over the sites of an array, and over pairs of sites of a lattice
``repeated``        tables and functions of one element, shared by the other modules
``lattice_arrays``  arrays on a lattice: the element near x or xi, times array factors
``element_pairs``   W, A and R of equal elements at any positions: sums over pairs, by cells
==================  ==========================================================================
"""
