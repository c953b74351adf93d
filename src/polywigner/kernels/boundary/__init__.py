"""Exact fields at points, as integrals along the edges of apertures.

``integrals`` contains fields and integrals along panels. ``steepest_descent`` contains fields from
the ends of edges. ``edge_waves`` contains the contributions of an edge to a plane wave, and to the
wave of a point source behind an opening.
"""
