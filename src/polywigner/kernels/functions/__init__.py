"""Formulas of W, A and F: sums over edges, slits and tetrahedra.

===================  ==========================================================================
module               content
===================  ==========================================================================
``edge_terms``       the plane-wave integral over an edge; the terms of W and A for a part of it
``slices``           W and A, sums of these terms over the parts of edges that bound slices
``gauss_schell``     Gaussian waves over polygons and intervals, edge by edge
``partly_coherent``  W of partly coherent light, as kernels
``fourier``          Fourier transforms of polygons, also on grids, and of polyhedra
``intervals``        the transforms of slits, and a few waves on one of them
``separable``        fields f(x) g(y) on a rectangle, and their transforms as kernels
``plane``            the field and the transforms of apertures, in their plane and in any pose
===================  ==========================================================================
"""
