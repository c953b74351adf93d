"""Radar cross sections of conducting bodies.

==================  =================================================================
module              content
==================  =================================================================
``cross_sections``  radar cross sections by physical optics, and patterns over angles
``facet_beams``     fields of illuminated surfaces after one to three reflections
``facets``          bodies and plates as triangles, and their visible parts
``near_fields``     cross sections from the fields of antennas near a body
==================  =================================================================
"""

from polywigner.scattering.cross_sections import rcs, rcs_pattern

__all__ = ["rcs", "rcs_pattern"]
