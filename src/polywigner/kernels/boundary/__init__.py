"""Exact fields at points as integrals along edges.

===============  ==============================================================================
module           what is in it
===============  ==============================================================================
``integrals``    exact fields at points as integrals along edges
``edge_waves``   contributions at an edge: of plane waves, and of a point source behind an opening
``edge_strips``  derivatives: what strips along edges radiate
===============  ==============================================================================
"""
