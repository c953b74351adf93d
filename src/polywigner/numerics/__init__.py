"""Tools without physics: sines in turns, error-free sums and products, complex pairs, Gauss rules.

=======================  =======================================================================
module                   what is in it
=======================  =======================================================================
``grid_arithmetic``      exact arithmetic on vertices rounded to a grid
``phases``               sine and cosine of turns; phases from error-free products; growth
``complex_pairs``        complex arithmetic for complex frequencies
``divided_differences``  a wave's means over segments, triangles and tetrahedra
``polynomials``          polynomials and powers times a wave along a segment; interpolation
``nodes``                Gauss rules: of integrands along edges, and of means over mixtures
``chirps``               integrals of quadratic phases, by Fresnel's integrals
``peaks``                peaks of band-limited functions between samples
=======================  =======================================================================
"""
