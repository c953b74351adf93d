"""Reception: links between two sources.

===================  ==========================================================================
module               content
===================  ==========================================================================
``couplings``        the coupling of a transmitter and a receiver in any pose, by fields or W
``cell_pairs``       sums over pairs of cells of both sources by an interpolated kernel, to a
                     tolerance
``norms``            the power by which couplings are divided
===================  ==========================================================================
"""

from polywigner.reception.couplings import coupling

__all__ = ["coupling"]
