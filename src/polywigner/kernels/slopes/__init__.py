"""Derivatives in closed form: in arguments, vertices, weights and amplitudes.

======================  ===========================================================================
module                  what is in it
======================  ===========================================================================
``slopes``              what derivatives of an edge sum are made of; those of F and of slits
``slopes_of_slices``    of W and A, and which kernel has which derivatives
======================  ===========================================================================
"""
