"""Reception: links between two sources.

===================  ==========================================================================
module               content
===================  ==========================================================================
``couplings``        the coupling of a transmitter and a receiver in any pose, and the powers of
                     both by which it is divided
``cell_pairs``       sums over pairs of cells of both sources, with an interpolated kernel, to a
                     tolerance
===================  ==========================================================================
"""

from polywigner.reception.couplings import coupling

__all__ = ["coupling"]
