"""The formulas: W, A, F, areas and moments as sums over edges, slits and bodies.

===================  ==========================================================================
module               what is in it
===================  ==========================================================================
``edge_terms``       the plane-wave integral over an edge; the terms of W and A for a part of it
``slices``           W, A and the areas of slices, from all edges or from listed parts
``part_kernels``     W and its moments as sums over listed parts
``gauss_schell``     Gaussian waves over polygons and intervals, edge by edge
``partly_coherent``  W of partly coherent light, as kernels
``moments``          moments of lag slices, W's derivatives
``fourier``          Fourier transform, at points and on grids of frequencies
``membership``       the field of a source at points
``simplices``        Fourier transform of slits and of what is thin, as tiles with exact phases
``slits``            the transforms of slits, and a few waves on one of them
``separable``        fields f(x) g(y) on a rectangle, and their transforms as kernels
``plane``            the transforms of apertures, in their plane and in any pose
``solids``           the transforms of polyhedra, sums over tetrahedra
===================  ==========================================================================
"""
