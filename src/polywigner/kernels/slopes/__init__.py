"""Derivatives in closed form: in arguments, vertices, weights and amplitudes.

======================  ===========================================================================
module                  what is in it
======================  ===========================================================================
``slopes``              what derivatives of an edge sum are made of
``slopes_of_outlines``  of F; ``slopes_of_slices`` of W and A, ``slopes_of_slits`` in one dimension
``slope_kernels``       which kernel has which derivatives
======================  ===========================================================================
"""
