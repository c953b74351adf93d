"""The formulas: W, A, F, areas and moments as sums over edges, slits and bodies.

===================  ==========================================================================
module               what is in it
===================  ==========================================================================
``stokes``           the plane-wave integral over one edge, stable for all arguments
``wigner``           Wigner function and lag-slice area
``edge_terms``       the terms of W and A for a part of an edge: each formula once
``wave_sums``        sums of these terms over pairs of waves; ``part_kernels`` over listed parts
``gauss_schell``     Gaussian waves over polygons and intervals, edge by edge
``partly_coherent``  W of partly coherent light, as kernels
``moments``          moments of lag slices, W's derivatives
``shared_slices``    W and A from listed parts of slices, for many frequencies
``fourier``          Fourier transform
``ambiguity``        ambiguity function and position-slice area
``membership``       the field of a source at points
``simplices``        Fourier transform of slits and of what is thin, as tiles with exact phases
``slits``            sums over slices of intervals
``solids``           sums over tetrahedra
``grids``            Fourier transform on grids of frequencies
``separable``        fields f(x) g(y) on a rectangle
``line_fields``      a few waves on one interval, and their transforms
``products``         the transforms of rectangles with such fields, as kernels
``elements``         one aperture's functions in its frame, by the kernel that suits its field
``line``             the transforms of slits
``plane``            the transforms of apertures, in their plane and in any pose
``space``            the transforms of polyhedra
===================  ==========================================================================
"""
