"""Pictures: level maps in dB, rendered scenes, and the transforms of an aperture.

``levels`` turns signed radiance into dB above a stated floor, ``style`` holds what all pictures
share, ``scene`` draws a rendered picture, ``transforms`` the figure of ``polywigner transform``.
Nothing here opens a window: figures are drawn into memory and saved by the caller.
"""

from __future__ import annotations

from polywigner.figures.levels import level_db, picture_peak
from polywigner.figures.scene import draw_scene
from polywigner.figures.transforms import TransformSlices, draw_transforms, transform_slices

__all__ = [
    "TransformSlices",
    "draw_scene",
    "draw_transforms",
    "level_db",
    "picture_peak",
    "transform_slices",
]
