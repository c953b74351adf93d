"""Exact fields at points, as integrals along the edges of apertures.

``integrals`` computes fields as integrals along short pieces of edges, called panels.
``steepest_descent`` computes fields from the ends of edges. ``edge_waves`` contains the
contributions of an edge to the field of a plane wave, and to the field of a point source behind an
opening.
"""
