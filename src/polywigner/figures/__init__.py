"""Pictures: level maps in dB, rendered scenes, and the transforms of an aperture.

``levels`` turns signed radiance into dB above a stated floor, ``style`` holds what all pictures
share, ``scene`` draws a rendered picture, ``slices`` computes what ``transforms`` draws as the
figure of ``polywigner transform``, ``projections`` draws what ``polywigner.projections`` returns.
Fields in front of a source: ``lines``, ``planes`` and ``hemispheres`` draw several methods side by
side, ``volumes`` isosurfaces, ``patterns`` far fields as data sheets show them. ``arrivals``: where
a receiver's power comes from. ``paper`` has the
figures of the paper, ``drawing`` what they share with the others.
Nothing here opens a window: figures are drawn into memory and saved by the caller.
"""

from __future__ import annotations

from polywigner.figures.arrivals import DirectArrival, draw_arrivals
from polywigner.figures.cross_sections import draw_rcs
from polywigner.figures.hemispheres import draw_hemispheres
from polywigner.figures.levels import level_db, picture_peak
from polywigner.figures.lines import draw_lines
from polywigner.figures.patterns import draw_pattern
from polywigner.figures.planes import draw_planes
from polywigner.figures.projections import draw_projections
from polywigner.figures.scene import draw_scene
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
]
