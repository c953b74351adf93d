"""Links between a transmitting and a receiving source.

=================== ==========================================================================
module content ===================
========================================================================== ``couplings`` coupling of
a transmitter and a receiver in any pose, and the powers of sources that normalise it ``cell_pairs``
integral of the coupling to a given tolerance, as a sum over pairs of cells of both sources
=================== ==========================================================================
"""

from polywigner.reception.couplings import coupling

__all__ = ["coupling"]
