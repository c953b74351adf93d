"""Films rendered in parts, or in finer pixels, and put back as they were."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import mitsuba as mi
import numpy as np
import numpy.typing as npt

from polywigner.mitsuba.receiver import is_receiver

__all__ = ["coarse", "cropped", "film_of", "fineness", "refined"]

# Mitsuba adds the samples of a pixel in float32: 2^20 equal ones were 0.4 % off, 2^24 6 %.
_IN_PIXEL = 1 << 12


def fineness(camera: Any, samples: int) -> int:
    """Into how many pixels along each side those of a receiver are divided.

    Those of others are not: what is stratified in a pixel of a camera is best left so.
    """
    doublings = math.ceil(math.log2(samples / _IN_PIXEL) / 2)
    return 2 ** max(doublings, 0) if is_receiver(camera) else 1


@contextmanager
def refined(camera: Any, factor: int) -> Iterator[None]:
    """A film of so many times the pixels along each side, which the receiver takes for the same."""
    if factor == 1:
        yield
        return
    film = camera.film()
    before = [film.size(), film.crop_size(), film.crop_offset()]
    finer = [(int(pair[0]) * factor, int(pair[1]) * factor) for pair in before]
    camera.fineness = factor
    _set(camera, *finer)
    try:
        yield
    finally:
        camera.fineness = 1
        _set(camera, *before)


def film_of(width: int, height: int) -> dict[str, Any]:
    """The entry of a film that a receiver can have."""
    return {
        "type": "hdrfilm",
        "width": width,
        "height": height,
        "pixel_format": "luminance",
        "component_format": "float32",
        "rfilter": {"type": "box"},
    }


def coarse(image: npt.NDArray[Any], factor: int) -> npt.NDArray[Any]:
    """The image of the film as it was: means over pixels."""
    rows, columns, channels = image.shape
    shape = (rows // factor, factor, columns // factor, factor, channels)
    return np.asarray(image.reshape(shape).mean(axis=(1, 3)))


@contextmanager
def cropped(camera: Any, top: int, rows: int, columns: int | None = None) -> Iterator[None]:
    """A narrower crop window, put back afterwards."""
    film = camera.film()
    size, offset = film.crop_size(), film.crop_offset()
    wanted = (size[0] if columns is None else columns, rows)
    if wanted == (size[0], size[1]):
        yield
        return
    _set(camera, film.size(), wanted, (offset[0], offset[1] + top))
    try:
        yield
    finally:
        _set(camera, film.size(), size, offset)


def _set(camera: Any, size: Any, crop_size: Any, crop_offset: Any) -> None:
    parameters = mi.traverse(camera)
    parameters["film.size"] = size
    parameters["film.crop_size"] = crop_size
    parameters["film.crop_offset"] = crop_offset
    parameters.update()
