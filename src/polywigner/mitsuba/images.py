"""Rendered images on disk."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import numpy.typing as npt

from polywigner.errors import ArgumentError
from polywigner.execution import kernel_threads
from polywigner.interruption import temporary_folder

# A colour film in a variant of one channel: as intended, and so no news to anybody.
_EXPECTED = ("Monochrome mode enabled",)
_DATE = len("2000-01-01 00:00:00 ")


@contextmanager
def silent() -> Iterator[None]:
    """Nothing is logged within, and no progress bar drawn."""
    with _appending():
        yield


@contextmanager
def to_list() -> Iterator[list[str]]:
    """Collect Mitsuba's messages of the block in a list."""
    messages: list[str] = []
    # Through a file, which needs no Python: messages come from Mitsuba's threads. An appender
    # with a file also leaves out the progress bars.
    with temporary_folder() as folder:
        path = Path(folder) / "mitsuba.log"
        appender = mi.StreamAppender(str(path))
        try:
            with _appending(appender):
                yield messages
        finally:
            del appender  # closes the file
            lines = path.read_text(encoding="utf-8", errors="replace").splitlines()
            texts = (line[_DATE:].strip() for line in lines)
            messages += [t for t in texts if t and not any(known in t for known in _EXPECTED)]


@contextmanager
def _appending(*appenders: mi.Appender) -> Iterator[None]:
    logger = mi.logger()
    before = [logger.appender(index) for index in range(logger.appender_count())]
    logger.clear_appenders()
    for appender in appenders:
        logger.add_appender(appender)
    try:
        yield
    finally:
        logger.clear_appenders()
        for appender in before:
            logger.add_appender(appender)


@contextmanager
def threads_for_openexr() -> Iterator[None]:
    """Within, Dr.Jit's pool has a thread beside the caller's.

    Mitsuba's OpenEXR, which reads textures too, hands work to the pool and waits without doing any:
    on one processor, or with ``drjit.set_thread_count(1)``, it would wait for ever.
    """
    before = dr.thread_count()
    if before < 2:
        dr.set_thread_count(2)
    try:
        yield
    finally:
        if before < 2:
            dr.set_thread_count(before)


def mean_of_colours(image: npt.NDArray[Any]) -> npt.NDArray[np.float64]:
    """(height, width) from a film of one channel, or of colours (their mean) and others.

    Scalar variants have three colours for one channel.
    """
    colours = 3 if image.shape[-1] >= 3 else 1
    return np.asarray(image[..., :colours].mean(axis=-1, dtype=np.float64))


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
    with kernel_threads(), threads_for_openexr():
        bitmap.write(stream, mi.Bitmap.FileFormat.OpenEXR)
    try:
        path.write_bytes(stream.raw_buffer())
    except OSError as error:
        raise ArgumentError(
            f"expected to write {path}, got: {error.strerror}; choose another place"
        ) from error
