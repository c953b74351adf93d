"""Numerical functions without physics.

=======================  =======================================================================
module                   content
=======================  =======================================================================
``grid_arithmetic``      exact arithmetic on vertices rounded to a grid
``phases``               sine and cosine of cycles; phases from error-free products; growth
``complex_pairs``        complex arithmetic on pairs of real arrays
``divided_differences``  means of a wave over segments, triangles and tetrahedra
``band_limited``         interpolation in a band of frequencies; peaks between samples
``nodes``                Gauss rules: for integrands along edges, and for means over mixtures
``chirps``               integrals of quadratic phases, by Fresnel integrals
``jets``                 numbers with their derivatives
=======================  =======================================================================
"""
