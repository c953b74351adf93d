"""Films, samples and seeds of renders, OpenEXR files, and Mitsuba's log."""

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

from polywigner.errors import SceneError
from polywigner.execution import kernel_threads
from polywigner.geometry.arguments import checked_count
from polywigner.interruption import temporary_folder

# Messages of Mitsuba that are not shown to users.
_EXPECTED = ("Monochrome mode enabled",)
_DATE = len("2000-01-01 00:00:00 ")


@contextmanager
def collected_log() -> Iterator[list[str]]:
    """Collect Mitsuba's log messages in a list within a ``with`` block, instead of showing them.

    The list is filled at the end of the block.
    """
    messages: list[str] = []
    # Mitsuba's threads must not call Python code, so messages pass through a file.
    with temporary_folder() as folder:
        path = Path(folder) / "mitsuba.log"
        appender = mi.StreamAppender(str(path))
        try:
            with log_only_to(appender):
                yield messages
        finally:
            del appender  # The file is closed when the appender is deleted.
            lines = path.read_text(encoding="utf-8", errors="replace").splitlines()
            texts = (line[_DATE:].strip() for line in lines)
            messages += [t for t in texts if t and not any(known in t for known in _EXPECTED)]


@contextmanager
def log_only_to(*appenders: mi.Appender) -> Iterator[None]:
    """Send Mitsuba's log only to ``appenders`` within a ``with`` block."""
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
    """Ensure that Dr.Jit's thread pool has at least two threads within a ``with`` block.

    Mitsuba reads and writes OpenEXR files in this pool, and deadlocks if the calling thread is its
    only thread.
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
    """Return the average over the colour channels of an image, shape (height, width).

    The colours are the first three channels, or the first channel if there are fewer than three.
    """
    colours = 3 if image.shape[-1] >= 3 else 1
    return np.asarray(image[..., :colours].mean(axis=-1, dtype=np.float64))


def write_exr(path: Path, image: npt.ArrayLike) -> None:
    """Write an image to an OpenEXR file in single precision."""
    bitmap = mi.Bitmap(np.ascontiguousarray(image, dtype=np.float32))
    with kernel_threads(), threads_for_openexr():
        bitmap.write(str(path), mi.Bitmap.FileFormat.OpenEXR)


# Largest number of samples per film pixel. Mitsuba sums in float32, with an error of 0.4 % for 2^20
# samples.
_MOST_PER_PIXEL = 1 << 12


def fineness(camera: mi.Sensor, samples: int) -> int:
    """Return the factor by which each side of a film is refined for ``samples`` per pixel.

    The factor limits the number of samples per refined pixel. The factor is 1 for cameras, because
    only the films of receivers can be refined.
    """
    doublings = math.ceil(math.log2(samples / _MOST_PER_PIXEL) / 2)
    return 2 ** max(doublings, 0) if hasattr(camera, "fineness") else 1


@contextmanager
def changed(changes: Sequence[tuple[Any, str, Any]]) -> Iterator[None]:
    """Set attributes within a ``with`` block; each change is a tuple (object, name, value)."""
    before = [getattr(target, name) for target, name, _ in changes]
    try:
        for target, name, value in changes:
            setattr(target, name, value)
        yield
    finally:
        for (target, name, _), value in zip(changes, before, strict=True):
            setattr(target, name, value)


def film_sizes(camera: mi.Sensor, factor: int = 1) -> list[list[int]]:
    """Return the size, crop size and crop offset of a film, multiplied by a factor."""
    film = camera.film()
    sizes = film.size(), film.crop_size(), film.crop_offset()
    return [[int(pair[0]) * factor, int(pair[1]) * factor] for pair in sizes]


@contextmanager
def refined(camera: mi.Sensor, factor: int) -> Iterator[None]:
    """Multiply the size and the crop window of a film by a factor within a ``with`` block."""
    finer_pixels = [(camera, "fineness", factor)] if factor > 1 else []
    with changed(finer_pixels), _film_of_size(camera, *film_sizes(camera, factor)):
        yield


def coarse(image: npt.NDArray[Any], factor: int) -> npt.NDArray[np.float64]:
    """Average the pixels of a refined film to the original resolution."""
    rows, columns, channels = image.shape
    shape = (rows // factor, factor, columns // factor, factor, channels)
    return np.asarray(image.reshape(shape).mean(axis=(1, 3)))


@contextmanager
def cropped(camera: mi.Sensor, top: int, rows: int, columns: int | None = None) -> Iterator[None]:
    """Crop a film within a ``with`` block to ``rows`` rows from row ``top`` of its crop window.

    ``columns`` is the number of columns from the left, by default all columns.
    """
    film = camera.film()
    (width, _), (x, y) = film.crop_size(), film.crop_offset()
    window = [width if columns is None else columns, rows]
    with _film_of_size(camera, film.size(), window, [x, y + top]):
        yield


@contextmanager
def _film_of_size(camera: mi.Sensor, *sizes: Any) -> Iterator[None]:
    """Set the size, crop size and crop offset of a film within a ``with`` block."""
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


# Number of samples per launch; Mitsuba stores about 100 bytes per sample.
WAVEFRONT = 2**24

# Largest number of strips, and smallest number of rows per strip, in scalar variants. These
# variants use strips only to report progress.
_SCALAR_STRIPS = 20
_SCALAR_ROWS = 32

CAMERAS = ("PerspectiveCamera", "ThinLensCamera", "OrthographicCamera")
"""Sensors whose films can be cropped."""


@dataclass(frozen=True)
class Tiling:
    """Division of a film into strips of rows, and of samples into passes.

    The division is independent of the processes that render the strips, so images are reproducible.
    """

    width: int
    height: int
    rows: int
    """Number of rows per strip; the last strip may be shorter."""
    samples: int
    """Number of samples per pixel."""
    passes: int
    """Number of passes per strip."""

    @property
    def strips(self) -> int:
        """Number of strips."""
        return math.ceil(self.height / self.rows)

    @property
    def steps(self) -> int:
        """Total number of passes."""
        return self.strips * self.passes


def tiling_of(camera: mi.Sensor, samples: int) -> Tiling:
    """Return the division of a film with ``samples`` per pixel into strips and passes."""
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


_LARGEST_SPP = 2**30


def check_spp(spp: int) -> int:
    """Return ``spp``; raise ArgumentError unless it is an integer from 1 to 2^30."""
    return checked_count(spp, "spp", 1, _LARGEST_SPP)


def check_seed(seed: int) -> int:
    """Return ``seed``; raise ArgumentError unless it is an integer from 0 to 2^63 - 1."""
    return checked_count(seed, "seed", 0, 2**63 - 1)


def seed_of(seed: int, *part: int) -> int:
    """Return a 32-bit seed for the part of a render that the numbers ``part`` identify."""
    return int(np.random.SeedSequence(seed, spawn_key=part).generate_state(1)[0])


def accepted_samples(sampler: mi.Sampler, count: int) -> int:
    """Return ``count`` rounded up to a number of samples that the sampler accepts."""
    probe = sampler.fork()
    with log_only_to():
        probe.set_sample_count(count)
    return int(probe.sample_count())


def checked_finite(values: npt.NDArray[Any], name: str) -> npt.NDArray[np.float64]:
    """Return the results of a render; raise SceneError unless all results are finite."""
    bad = int(np.count_nonzero(~np.isfinite(values)))
    if bad:
        raise SceneError(
            f"{bad} of {values.size} {name} are NaN or infinite; check the frequency, the powers "
            "and the radiances of the scene, and their units"
        )
    return values


@contextmanager
def rendering_errors(integrator: str) -> Iterator[None]:
    """Convert errors of Mitsuba and Dr.Jit in a ``with`` block to a SceneError."""
    try:
        yield
    except (RuntimeError, AssertionError) as error:
        cause = error.__cause__ or error
        raise SceneError(f"the integrator {integrator} cannot render the scene: {cause}") from error


# Mitsuba's value of ``max_depth`` for paths of any length.
_ENDLESS = 2**32 - 1


def depths_of(integrator: mi.Integrator) -> dict[str, int]:
    """Return a dictionary of an integrator's ``max_depth`` (-1 for no limit) and ``rr_depth``.

    The integrator ``direct`` has no ``rr_depth``.
    """
    if integrator.class_name() == "DirectIntegrator":
        return {"max_depth": 2}
    depths: dict[str, int] = {"max_depth": -1, "rr_depth": 0}
    # C++ integrators expose these values only as text.
    values = re.findall(r"(max_depth|rr_depth) = (-?\d+)", str(integrator))
    depths.update((name, int(value)) for name, value in values)
    depths.update((name, int(getattr(integrator, name, value))) for name, value in depths.items())
    if depths["max_depth"] == _ENDLESS:
        depths["max_depth"] = -1
    return depths
