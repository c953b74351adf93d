"""Pictures: level maps in dB, rendered scenes, and the transforms of an aperture.

``levels`` turns signed radiance into dB above a stated floor, ``style`` holds what all pictures
share, ``scene`` draws a rendered picture or its frames by range, ``slices`` computes what
``transforms`` draws as the figure of ``polywigner transform``, ``projections`` draws projections
of phase space. Fields in front of a source: ``lines`` and ``planes`` draw several methods side by
side, ``volumes`` isosurfaces, ``patterns`` far fields as data sheets show them. ``ranges``: where
a receiver's power comes from, and how far. ``paper`` has the figures of the paper.
Nothing here opens a window: figures are drawn into memory and saved by the caller.
"""

from __future__ import annotations

from polywigner.figures.cross_sections import draw_rcs
from polywigner.figures.levels import level_db, picture_peak
from polywigner.figures.lines import draw_lines
from polywigner.figures.patterns import draw_hemispheres, draw_pattern
from polywigner.figures.planes import draw_planes
from polywigner.figures.projections import draw_projections
from polywigner.figures.ranges import DirectArrival, draw_arrivals, draw_range_profile
from polywigner.figures.scene import draw_scene, write_range_animation
from polywigner.figures.slices import (
    LARGEST_SAMPLES,
    TransformSlices,
    outline_of,
    samples_needed,
    transform_slices,
)
from polywigner.figures.systems import SystemSlices, system_slices
from polywigner.figures.transforms import draw_transforms
from polywigner.figures.volumes import draw_volume

__all__ = [
    "LARGEST_SAMPLES",
    "DirectArrival",
    "SystemSlices",
    "TransformSlices",
    "draw_arrivals",
    "draw_hemispheres",
    "draw_lines",
    "draw_pattern",
    "draw_planes",
    "draw_projections",
    "draw_range_profile",
    "draw_rcs",
    "draw_scene",
    "draw_transforms",
    "draw_volume",
    "level_db",
    "outline_of",
    "picture_peak",
    "samples_needed",
    "system_slices",
    "transform_slices",
    "write_range_animation",
]
