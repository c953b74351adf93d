"""Figures of transforms, fields, radiation patterns, lenses and scenes.

The functions draw with matplotlib and open no window; the caller saves the figures.
"""

from __future__ import annotations

from polywigner.figures.far_field_plots import draw_pattern, draw_rcs, draw_tolerance
from polywigner.figures.field_plots import draw_hemispheres, draw_lines, draw_planes
from polywigner.figures.lens_plots import draw_image, draw_mtf, draw_psf
from polywigner.figures.levels import image_peak, level_db
from polywigner.figures.scene_plots import (
    DirectArrival,
    draw_arrivals,
    draw_channel,
    draw_polarisation,
    draw_radar_map,
    draw_range_profile,
    draw_scene,
    draw_stokes,
)
from polywigner.figures.transform_plots import (
    LARGEST_SAMPLES,
    TransformSlices,
    draw_projections,
    draw_transforms,
    outline_of,
    samples_needed,
    transform_slices,
)
from polywigner.figures.volumes import draw_volume

__all__ = [
    "LARGEST_SAMPLES",
    "DirectArrival",
    "TransformSlices",
    "draw_arrivals",
    "draw_channel",
    "draw_hemispheres",
    "draw_image",
    "draw_lines",
    "draw_mtf",
    "draw_pattern",
    "draw_planes",
    "draw_polarisation",
    "draw_projections",
    "draw_psf",
    "draw_radar_map",
    "draw_range_profile",
    "draw_rcs",
    "draw_scene",
    "draw_stokes",
    "draw_tolerance",
    "draw_transforms",
    "draw_volume",
    "image_peak",
    "level_db",
    "outline_of",
    "samples_needed",
    "transform_slices",
]
