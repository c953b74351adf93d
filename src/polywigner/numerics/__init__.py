"""Tools without physics: sines in turns, error-free sums and products, complex pairs, Gauss rules.

=================  =============================================================================
module             what is in it
=================  =============================================================================
``exact``          exact arithmetic on vertices rounded to a grid
``trigonometry``   sine and cosine of turns by polynomial; the mean of a plane wave on a segment
``phases``         phases in turns from error-free products; growth for complex frequencies
``complex_pairs``  complex arithmetic for complex frequencies
``interpolation``  band-limited functions from a few samples around a place
=================  =============================================================================
"""
