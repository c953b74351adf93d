"""Exact fields behind apertures, as integrals along their edges.

``integrals`` integrates along short pieces of edges, called panels. ``steepest_descent`` integrates
from the ends of edges. ``edge_waves`` contains the integrands, and the waves of a point source
behind an opening.
"""
