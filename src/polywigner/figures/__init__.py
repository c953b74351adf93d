"""Pictures: level maps in dB, rendered scenes, and the transforms of an aperture.

``style`` has the maps of levels and of signed values under all pictures, their axes and bars;
``levels`` turns signed radiance into dB above a stated floor; ``fields`` reads labelled arrays.
``lines``, ``planes`` and ``volumes`` draw fields in front of a source, ``patterns`` far fields and
cross sections as data sheets show them, ``scenes`` rendered pictures and where a receiver's power
comes from, ``transforms`` the figure of ``polywigner transform``, ``projections`` projections of
phase space, ``lens`` spots and transfer functions. ``paper`` has the figures of the paper.
Nothing here opens a window: figures are drawn into memory and saved by the caller.
"""

from __future__ import annotations

from polywigner.figures.lens import draw_mtf, draw_psf
from polywigner.figures.levels import level_db, picture_peak
from polywigner.figures.lines import draw_lines
from polywigner.figures.patterns import draw_pattern, draw_rcs, draw_tolerance
from polywigner.figures.planes import draw_hemispheres, draw_planes
from polywigner.figures.projections import draw_projections
from polywigner.figures.scenes import (
    DirectArrival,
    draw_arrivals,
    draw_channel,
    draw_polarisation,
    draw_range_profile,
    draw_scene,
    draw_stokes,
    write_range_animation,
)
from polywigner.figures.transforms import (
    LARGEST_SAMPLES,
    SystemSlices,
    TransformSlices,
    draw_transforms,
    outline_of,
    samples_needed,
    system_slices,
    transform_slices,
)
from polywigner.figures.volumes import draw_volume

__all__ = [
    "LARGEST_SAMPLES",
    "DirectArrival",
    "SystemSlices",
    "TransformSlices",
    "draw_arrivals",
    "draw_channel",
    "draw_hemispheres",
    "draw_lines",
    "draw_mtf",
    "draw_pattern",
    "draw_planes",
    "draw_polarisation",
    "draw_projections",
    "draw_psf",
    "draw_range_profile",
    "draw_rcs",
    "draw_scene",
    "draw_stokes",
    "draw_tolerance",
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
