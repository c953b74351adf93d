"""Exact fields at points as integrals along edges.

===============  ===========================================================================
module           what is in it
===============  ===========================================================================
``integrals``    exact fields at points as integrals along edges; ``fresnel`` parabolic ones
``edge_waves``   what a wave at an edge adds to them; ``nodes`` rules to sum it up
``edge_strips``  derivatives: what strips along edges radiate
``distances``    distances and phases as sums of two floats
===============  ===========================================================================
"""
