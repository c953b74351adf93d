"""Links between a transmitting and a receiving source.

===============  ==================================================================
module           content
===============  ==================================================================
``couplings``    coupling of two sources in any pose, and powers that normalise it
``cell_pairs``   the integral of a coupling, as a sum over pairs of cells
===============  ==================================================================
"""

from polywigner.reception.couplings import coupling

__all__ = ["coupling"]
