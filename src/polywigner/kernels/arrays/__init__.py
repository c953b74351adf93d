"""Arrays and sources of distant parts: sums over the copies or pairs that matter at a place.

====================  =======================================================================
module                what is in it
====================  =======================================================================
``array_factor``      sums over the sites of an array, for its Fourier transform
``repeated``          what kernels of one element many times share
``lattice_arrays``    arrays on a lattice: the element near x or xi, times array factors
``factors``           array factors in phase space: the pairs of sites of one midpoint
``site_weights``      weights at the sites of a lattice, and sums over pairs
``weight_tables``     array factors of any weights, from a table periodic in the frequency
``scattered_arrays``  arrays off any lattice: pairs near a sample
``pair_lists``        pairs of elements, sorted into cells
``distant_parts``     sources of small parts far from each other, each in its own coordinates
``distant_sums``      their W and A, pair by pair
====================  =======================================================================
"""
