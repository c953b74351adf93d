"""Reception: links between two sources.

===================  ==========================================================================
module               what is in it
===================  ==========================================================================
``couplings``        the coupling of a transmitter and a receiver in any pose, by fields or W
``poses``            poses, checked: rigid, and both sources in front of each other
``cells``            a source in boxes that are cut as needed, with nodes in them
``cell_pairs``       sums over pairs of boxes, their kernel interpolated between them
``link_sums``        which pairs, and of which order, for a tolerance
``norms``            the power of a source, and its derivatives in weights
===================  ==========================================================================
"""

from polywigner.reception.couplings import coupling

__all__ = ["coupling"]
