"""What a source receives: links between two sources.

===================  ==========================================================================
module               what is in it
===================  ==========================================================================
``couplings``        the coupling of a transmitter and a receiver in any pose
``poses``            poses, checked: rigid, and both sources in front of each other
``cells``            a source in boxes that are cut as needed, with nodes in them
``link_kernels``     the kernel between two points, and its derivatives
``cell_pairs``       sums over pairs of boxes, the kernel interpolated between them
``link_sums``        which pairs, and of which order, for a tolerance
``norms``            the power of a source, and its derivatives in weights
``overlaps``         the same as overlaps of Wigner functions
===================  ==========================================================================
"""

from polywigner.reception.couplings import coupling

__all__ = ["coupling"]
