"""Exact fields at points as integrals along edges.

===============  ===========================================================================
module           what is in it
===============  ===========================================================================
``integrals``    exact fields at points as integrals along edges
``spherical``    a point source behind an opening, as an integral along its edges
``edge_waves``   contributions of a wave at an edge
``edge_strips``  derivatives: what strips along edges radiate
===============  ===========================================================================
"""
