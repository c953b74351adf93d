"""Rendered images on disk."""

from __future__ import annotations

from pathlib import Path

import mitsuba as mi
import numpy as np
import numpy.typing as npt

from polywigner.errors import ArgumentError

__all__ = ["write_exr"]


def write_exr(path: Path, image: npt.ArrayLike) -> None:
    """Write an image as OpenEXR with 32-bit floats; negative values keep their sign.

    Parameters
    ----------
    path: any name, whatever its suffix; written in place.
    image: (height, width, channels), the channels being Y, YA, RGB, RGBA by their number, or
        numbered where there are more.

    Raises
    ------
    ArgumentError for a path that cannot be written to, or a full disk.
    """
    # Mitsuba's own default for an array of floats is to leave it linear, which radiance is.
    bitmap = mi.Bitmap(np.ascontiguousarray(image, dtype=np.float32))
    # Through memory: writing to a file itself, Mitsuba does not notice that a disk is full.
    stream = mi.MemoryStream()
    bitmap.write(stream, mi.Bitmap.FileFormat.OpenEXR)
    try:
        path.write_bytes(stream.raw_buffer())
    except OSError as error:
        raise ArgumentError(
            f"expected to write {path}, got: {error.strerror}; choose another place"
        ) from error
