"""Exact fields at points, as integrals along the edges of apertures.

``integrals`` contains fields and integrals along panels, ``steepest_descent`` fields from the ends
of edges, and ``edge_waves`` the contributions at an edge: of plane waves, and of a point source
behind an opening.
"""
