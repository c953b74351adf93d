"""Tools without physics: sines in turns, error-free sums and products, complex pairs, Gauss rules.

=======================  =======================================================================
module                   what is in it
=======================  =======================================================================
``exact``                exact arithmetic on vertices rounded to a grid
``trigonometry``         sine and cosine of turns by polynomial; a wave's mean on a segment
``phases``               phases in turns from error-free products; growth for complex frequencies
``complex_pairs``        complex arithmetic for complex frequencies
``divided_differences``  a wave's means over segments, triangles and tetrahedra
``segment_moments``      powers times a wave, over a segment
``polynomials``          polynomials along a segment
``interpolation``        band-limited functions from a few samples around a place
``nodes``                Gauss rules
``peaks``                peaks of band-limited functions between samples
=======================  =======================================================================
"""
