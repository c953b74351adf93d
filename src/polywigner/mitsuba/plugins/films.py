"""Films: images on disk and without noise in logs, and pictures cut into parts."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import numpy.typing as npt

from polywigner.errors import ArgumentError, SceneError
from polywigner.execution import kernel_threads
from polywigner.geometry.arguments import checked_count
from polywigner.interruption import temporary_folder

# A colour film in a variant of one channel: as intended, and so no news to anybody.
_EXPECTED = ("Monochrome mode enabled",)
_DATE = len("2000-01-01 00:00:00 ")


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
            with silent(appender):
                yield messages
        finally:
            del appender  # closes the file
            lines = path.read_text(encoding="utf-8", errors="replace").splitlines()
            texts = (line[_DATE:].strip() for line in lines)
            messages += [t for t in texts if t and not any(known in t for known in _EXPECTED)]


@contextmanager
def silent(*appenders: mi.Appender) -> Iterator[None]:
    """Within, nothing is logged but to these, and no progress bar drawn."""
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
    """Within, Dr.Jit's pool has a thread beside the caller's, without which OpenEXR waits for ever.

    Mitsuba's OpenEXR, which reads textures too, hands work to the pool and does none itself.
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
    """(height, width) from a film of one channel, or of colours (their mean) and others."""
    colours = 3 if image.shape[-1] >= 3 else 1
    return np.asarray(image[..., :colours].mean(axis=-1, dtype=np.float64))


def write_exr(path: Path, image: npt.ArrayLike) -> None:
    """Write an image as OpenEXR with 32-bit floats; negative values keep their sign."""
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


# Mitsuba adds the samples of a pixel in float32: 2^20 equal ones were 0.4 % off, 2^24 6 %.
_IN_PIXEL = 1 << 12


def fineness(camera: Any, samples: int) -> int:
    """Return the number of pixels along each side into which a receiver's pixel is divided.

    Pixels of cameras stay, since their samples are stratified in each pixel.
    """
    doublings = math.ceil(math.log2(samples / _IN_PIXEL) / 2)
    return 2 ** max(doublings, 0) if hasattr(camera, "fineness") else 1


@contextmanager
def changed(changes: Sequence[tuple[Any, str, Any]]) -> Iterator[None]:
    """Within, attributes of objects have other values."""
    before = [getattr(thing, name) for thing, name, _ in changes]
    try:
        for thing, name, value in changes:
            setattr(thing, name, value)
        yield
    finally:
        for (thing, name, _), value in zip(changes, before, strict=True):
            setattr(thing, name, value)


def film_sizes(camera: Any, factor: int = 1) -> list[list[int]]:
    """Return size, crop size and crop offset of a film of so many times the pixels."""
    film = camera.film()
    sizes = film.size(), film.crop_size(), film.crop_offset()
    return [[int(pair[0]) * factor, int(pair[1]) * factor] for pair in sizes]


@contextmanager
def refined(camera: Any, factor: int) -> Iterator[None]:
    """A film of so many times the pixels along each side, which the receiver takes for the same."""
    finer_pixels = [(camera, "fineness", factor)] if factor > 1 else []
    with changed(finer_pixels), _film_of_size(camera, *film_sizes(camera, factor)):
        yield


def coarse(image: npt.NDArray[Any], factor: int) -> npt.NDArray[np.float64]:
    """The image of the film as it was: means over pixels."""
    rows, columns, channels = image.shape
    shape = (rows // factor, factor, columns // factor, factor, channels)
    return np.asarray(image.reshape(shape).mean(axis=(1, 3)))


@contextmanager
def cropped(camera: Any, top: int, rows: int, columns: int | None = None) -> Iterator[None]:
    """A narrower crop window, put back afterwards."""
    film = camera.film()
    (width, _), (x, y) = film.crop_size(), film.crop_offset()
    window = [width if columns is None else columns, rows]
    with _film_of_size(camera, film.size(), window, [x, y + top]):
        yield


@contextmanager
def _film_of_size(camera: Any, *sizes: Any) -> Iterator[None]:
    """Within, the size of the film, and size and offset of its crop window, are these."""
    before, after = film_sizes(camera), [[int(n) for n in pair] for pair in sizes]
    if before == after:
        yield
        return
    names = ("film.size", "film.crop_size", "film.crop_offset")
    try:
        mi.traverse(camera).update(dict(zip(names, after, strict=True)))
        yield
    finally:
        mi.traverse(camera).update(dict(zip(names, before, strict=True)))


# Samples in flight at once in the compiled variants: Mitsuba keeps some 100 bytes of each.
WAVEFRONT = 2**24

# The scalar variants keep nothing; they are cut only so that progress can be told. Their threads
# share out squares of 32 pixels.
_SCALAR_STRIPS = 20
_SCALAR_ROWS = 32

CAMERAS = ("PerspectiveCamera", "ThinLensCamera", "OrthographicCamera")
"""Sensors whose film can be rendered in parts."""


@dataclass(frozen=True)
class Tiling:
    """Tiling of a film into strips of whole rows, and of their samples into passes.

    It depends on scene, variant and samples alone, so that a picture is the same whoever renders
    its parts.
    """

    width: int
    height: int
    rows: int
    """Rows of a strip; the last one may have fewer."""
    samples: int
    """Samples of a pixel."""
    passes: int
    """Passes of each strip."""

    @property
    def strips(self) -> int:
        return math.ceil(self.height / self.rows)

    @property
    def steps(self) -> int:
        """Number of passes of all strips together, in which progress is told."""
        return self.strips * self.passes


def tiling_of(camera: Any, samples: int) -> Tiling:
    """The parts of a sensor's film, from the top of its crop window."""
    width, height = camera.film().crop_size()
    is_compiled = dr.is_jit_v(mi.Float)
    if camera.class_name() not in CAMERAS:
        count = 1
    elif is_compiled:
        count = math.ceil(height / max(1, WAVEFRONT // (samples * width)))
    else:
        count = max(1, min(_SCALAR_STRIPS, height // _SCALAR_ROWS))
    rows = math.ceil(height / count)
    longest = max(1, WAVEFRONT // (width * rows)) if is_compiled else samples
    return Tiling(width, height, rows, samples, math.ceil(samples / longest))


# Noise falls with the root of the number: nobody waits for more.
_LARGEST_SPP = 2**30


def check_spp(spp: int) -> int:
    """The samples per pixel; ArgumentError unless a whole number from 1 to 2^30."""
    return checked_count(spp, "spp", 1, _LARGEST_SPP)


def check_seed(seed: int) -> int:
    """The seed; ArgumentError unless a whole number of zero or more."""
    if isinstance(seed, bool) or not isinstance(seed, int | np.integer) or seed < 0:
        raise ArgumentError(f"expected a seed as a whole number of zero or more, got {seed!r}")
    return int(seed)


def seed_of(seed: int, *part: int) -> int:
    """Seed of 32 bits for a part of a render with a seed of any size."""
    return int(np.random.SeedSequence(seed, spawn_key=part).generate_state(1)[0])


def accepted_samples(sampler: Any, count: int) -> int:
    """Return the number of samples per pixel that a sampler takes where ``count`` are requested.

    Samplers round up, and would log a warning in each render of a number that they round.
    """
    probe = sampler.fork()
    with silent():
        probe.set_sample_count(count)
    return int(probe.sample_count())


@contextmanager
def rendering_errors(integrator: str) -> Iterator[None]:
    """Turn errors of a render into a SceneError; Dr.Jit says why in the cause."""
    try:
        yield
    except (RuntimeError, AssertionError) as error:
        cause = error.__cause__ or error
        raise SceneError(f"expected a scene that {integrator} can render: {cause}") from error


# What Mitsuba makes of -1, paths without end.
_ENDLESS = 2**32 - 1


def depths_of(integrator: Any) -> dict[str, int]:
    """``max_depth``, -1 for paths without end, and ``rr_depth`` of an integrator."""
    # Mitsuba's own tell them in their text alone
    told = re.findall(r"(max_depth|rr_depth) = (-?\d+)", str(integrator))
    found: dict[str, int] = {"max_depth": -1, "rr_depth": 0}
    found.update((name, int(value)) for name, value in told)
    found.update((name, int(getattr(integrator, name, value))) for name, value in found.items())
    if found["max_depth"] == _ENDLESS:
        found["max_depth"] = -1
    return found
