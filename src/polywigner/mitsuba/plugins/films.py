"""Films and their strips, samples and seeds of renders, image files, and Mitsuba's log."""

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

# Start of a message of Mitsuba that is not shown: a colour film in a variant with a single channel
# is intended.
_EXPECTED = ("Monochrome mode enabled",)
_DATE = len("2000-01-01 00:00:00 ")


@contextmanager
def to_list() -> Iterator[list[str]]:
    """Collect Mitsuba's log messages in a list during the block."""
    messages: list[str] = []
    # The messages are written to a file, because Mitsuba's threads must not call Python code. An
    # appender to a file also omits progress bars.
    with temporary_folder() as folder:
        path = Path(folder) / "mitsuba.log"
        appender = mi.StreamAppender(str(path))
        try:
            with silent(appender):
                yield messages
        finally:
            del appender  # Deleting the appender closes the file.
            lines = path.read_text(encoding="utf-8", errors="replace").splitlines()
            texts = (line[_DATE:].strip() for line in lines)
            messages += [t for t in texts if t and not any(known in t for known in _EXPECTED)]


@contextmanager
def silent(*appenders: mi.Appender) -> Iterator[None]:
    """Log only to these appenders during the block; without appenders, log nothing."""
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
    """Ensure that Dr.Jit's thread pool has a second thread during the block.

    Mitsuba's OpenEXR, which also reads textures, leaves all work to the pool. It would never return
    if the calling thread were the only thread.
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
    """Return the only channel of an image, or the mean of its colours, shape (height, width)."""
    colours = 3 if image.shape[-1] >= 3 else 1
    return np.asarray(image[..., :colours].mean(axis=-1, dtype=np.float64))


def write_exr(path: Path, image: npt.ArrayLike) -> None:
    """Write an image as OpenEXR with 32-bit floats; negative values keep their sign."""
    # For float arrays, Mitsuba applies no gamma correction.
    bitmap = mi.Bitmap(np.ascontiguousarray(image, dtype=np.float32))
    with kernel_threads(), threads_for_openexr():
        bitmap.write(str(path), mi.Bitmap.FileFormat.OpenEXR)


# Largest number of samples per film pixel. Mitsuba adds samples in float32: the error of the mean
# was 0.4 % for 2^20 equal samples, and 6 % for 2^24.
_IN_PIXEL = 1 << 12


def fineness(camera: mi.Sensor, samples: int) -> int:
    """Return the number of film pixels along each side of a receiver's pixel; 1 for cameras."""
    doublings = math.ceil(math.log2(samples / _IN_PIXEL) / 2)
    return 2 ** max(doublings, 0) if hasattr(camera, "fineness") else 1


@contextmanager
def changed(changes: Sequence[tuple[Any, str, Any]]) -> Iterator[None]:
    """Set attributes (object, name, value) during the block."""
    before = [getattr(target, name) for target, name, _ in changes]
    try:
        for target, name, value in changes:
            setattr(target, name, value)
        yield
    finally:
        for (target, name, _), value in zip(changes, before, strict=True):
            setattr(target, name, value)


def film_sizes(camera: mi.Sensor, factor: int = 1) -> list[list[int]]:
    """Return the size, the crop size and the crop offset of a film, multiplied by a factor."""
    film = camera.film()
    sizes = film.size(), film.crop_size(), film.crop_offset()
    return [[int(pair[0]) * factor, int(pair[1]) * factor] for pair in sizes]


@contextmanager
def refined(camera: mi.Sensor, factor: int) -> Iterator[None]:
    """Multiply the numbers of rows and columns of a film during the block."""
    finer_pixels = [(camera, "fineness", factor)] if factor > 1 else []
    with changed(finer_pixels), _film_of_size(camera, *film_sizes(camera, factor)):
        yield


def coarse(image: npt.NDArray[Any], factor: int) -> npt.NDArray[np.float64]:
    """Return the image of the original film from the image of a refined film."""
    rows, columns, channels = image.shape
    shape = (rows // factor, factor, columns // factor, factor, channels)
    return np.asarray(image.reshape(shape).mean(axis=(1, 3)))


@contextmanager
def cropped(camera: mi.Sensor, top: int, rows: int, columns: int | None = None) -> Iterator[None]:
    """Use a narrower crop window during the block."""
    film = camera.film()
    (width, _), (x, y) = film.crop_size(), film.crop_offset()
    window = [width if columns is None else columns, rows]
    with _film_of_size(camera, film.size(), window, [x, y + top]):
        yield


@contextmanager
def _film_of_size(camera: mi.Sensor, *sizes: Any) -> Iterator[None]:
    """Set the size of a film, and the size and offset of its crop window, during the block."""
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


# Number of samples that compiled variants process at once. Mitsuba stores about 100 bytes per
# sample.
WAVEFRONT = 2**24

# Largest number of strips, and smallest number of rows of a strip, in scalar variants. Scalar
# variants store no samples, so strips only serve to report progress. Their threads render squares
# of 32 x 32 pixels.
_SCALAR_STRIPS = 20
_SCALAR_ROWS = 32

CAMERAS = ("PerspectiveCamera", "ThinLensCamera", "OrthographicCamera")
"""Sensors whose film can be rendered in parts."""


@dataclass(frozen=True)
class Tiling:
    """Tiling of a film into strips of complete rows, and of their samples into passes.

    The tiling depends only on the scene, the variant and the number of samples. Therefore the image
    does not depend on which processes render its strips.
    """

    width: int
    height: int
    rows: int
    """Number of rows of a strip; the last strip may have fewer."""
    samples: int
    """Number of samples of a pixel."""
    passes: int
    """Number of passes of each strip."""

    @property
    def strips(self) -> int:
        return math.ceil(self.height / self.rows)

    @property
    def steps(self) -> int:
        """Total number of passes of all strips, which are the steps of a progress bar."""
        return self.strips * self.passes


def tiling_of(camera: mi.Sensor, samples: int) -> Tiling:
    """Return the tiling of a sensor's film, from the top of its crop window."""
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


# Largest number of samples per pixel. Noise falls only with the square root of this number.
_LARGEST_SPP = 2**30


def check_spp(spp: int) -> int:
    """Return the samples per pixel; raise ArgumentError unless an integer from 1 to 2^30."""
    return checked_count(spp, "spp", 1, _LARGEST_SPP)


def check_seed(seed: int) -> int:
    """Return the seed; raise ArgumentError unless an integer of zero or more."""
    if isinstance(seed, bool) or not isinstance(seed, int | np.integer) or seed < 0:
        raise ArgumentError(f"expected seed as an integer of zero or more, got {seed!r}")
    return int(seed)


def seed_of(seed: int, *part: int) -> int:
    """Return a 32-bit seed for a part of a render; the seed of the render may have any size."""
    return int(np.random.SeedSequence(seed, spawn_key=part).generate_state(1)[0])


def accepted_samples(sampler: mi.Sampler, count: int) -> int:
    """Return the number of samples per pixel to which a sampler rounds ``count`` up.

    Samplers log a warning in each render with a number that they round.
    """
    probe = sampler.fork()
    with silent():
        probe.set_sample_count(count)
    return int(probe.sample_count())


@contextmanager
def rendering_errors(integrator: str) -> Iterator[None]:
    """Convert errors of a render to a SceneError that contains the cause reported by Dr.Jit."""
    try:
        yield
    except (RuntimeError, AssertionError) as error:
        cause = error.__cause__ or error
        raise SceneError(f"the integrator {integrator} cannot render the scene: {cause}") from error


# Number by which Mitsuba represents a ``max_depth`` of -1 (paths of any length).
_ENDLESS = 2**32 - 1


def depths_of(integrator: mi.Integrator) -> dict[str, int]:
    """Return ``max_depth`` (-1 if unlimited) and ``rr_depth`` of an integrator."""
    depths: dict[str, int] = {"max_depth": -1, "rr_depth": 0}
    # Integrators written in C++ report these values only as text.
    values = re.findall(r"(max_depth|rr_depth) = (-?\d+)", str(integrator))
    depths.update((name, int(value)) for name, value in values)
    depths.update((name, int(getattr(integrator, name, value))) for name, value in depths.items())
    if depths["max_depth"] == _ENDLESS:
        depths["max_depth"] = -1
    return depths
