"""Rendered images on disk."""

from __future__ import annotations

from pathlib import Path

import mitsuba as mi
import numpy as np
import numpy.typing as npt

__all__ = ["write_exr"]


def write_exr(path: Path, image: npt.ArrayLike) -> None:
    """Write an image as OpenEXR with 32-bit floats; negative values keep their sign.

    Parameters
    ----------
    path: any name, whatever its suffix; written in place.
    image: (height, width, channels), the channels being Y, YA, RGB, RGBA by their number, or
        numbered where there are more.
    """
    # Mitsuba's own default for an array of floats is to leave it linear, which radiance is.
    bitmap = mi.Bitmap(np.ascontiguousarray(image, dtype=np.float32))
    bitmap.write(str(path), mi.Bitmap.FileFormat.OpenEXR)
