"""Exact fields at points as integrals along edges.

``integrals`` holds fields and their derivatives, ``edge_waves`` the contributions at an edge: of
plane waves, and of a point source behind an opening.
"""
