"""Reception: links between two sources.

===================  ==========================================================================
module               what is in it
===================  ==========================================================================
``couplings``        the coupling of a transmitter and a receiver in any pose, by fields or W
``cell_pairs``       sources in boxes, and sums over pairs of these by an interpolated kernel
``link_sums``        which pairs, and of which order, for a tolerance
``norms``            the power of a source, and the shares of its parts in it
===================  ==========================================================================
"""

from polywigner.reception.couplings import coupling

__all__ = ["coupling"]
