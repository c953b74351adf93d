"""Formulas of the Wigner, ambiguity and Fourier functions W, A and F.

===================  ==========================================================================
module               content
===================  ==========================================================================
``edge_terms``       the plane-wave integral over an edge; terms of W and A for a part of an edge
``slices``           W and A, sums of these terms over the parts of edges that bound slices
``gauss_schell``     integrals of Gaussian waves over polygons and intervals
``partly_coherent``  kernels of W in partially coherent light
``fourier``          Fourier transforms of polygons, also on grids, and of polyhedra
``intervals``        transforms of slits, and of a sum of plane waves on an interval
``separable``        kernels for fields f(x) g(y) on a rectangle
``plane``            kernels for apertures, in their plane and in any pose
===================  ==========================================================================
"""
