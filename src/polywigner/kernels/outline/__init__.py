"""A source in its frame: edges, waves, and lines and convex pieces for compiled code.

==============  ==================================================================
module          what is in it
==============  ==================================================================
``frame``       the normalised coordinates in which all thresholds are absolute
``tables``      edges of all elements, with their weights and fields
``constants``   edges, lines and convex pieces on a grid, as constants of compiled code
``wave_pairs``  sums of plane waves on a source, and what pairs of them contribute
==============  ==================================================================
"""
