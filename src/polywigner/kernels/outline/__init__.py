"""A source as a kernel sees it: its frame, edges, supporting lines, pieces, and the waves on it.

==============  ==================================================================
module          what is in it
==============  ==================================================================
``frame``       the normalised coordinates in which all thresholds are absolute
``lines``       lines of edges and pieces, in clusters of direction
``tables``      edges and convex pieces of a polygon as constants of a kernel
``waves``       sums of plane waves on a source, and what pairs of them contribute
==============  ==================================================================
"""
