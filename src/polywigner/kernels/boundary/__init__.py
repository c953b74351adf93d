"""Exact fields behind apertures, as integrals along their edges.

``integrals`` computes fields as integrals along short pieces of edges, called panels.
``steepest_descent`` computes fields from the ends of edges. ``edge_waves`` contains the
contributions of an edge to the field of a plane wave, and to the field of a point source behind an
opening.
"""
