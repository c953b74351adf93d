"""A source in its normalised frame: its edges and its waves.

==============  ==================================================================
module          content
==============  ==================================================================
``frame``       the normalised coordinates in which all thresholds are absolute
``tables``      edges of all elements, with their weights and fields
``wave_pairs``  sums of plane waves on a source, and contributions of their pairs
==============  ==================================================================
"""
