"""Received power and radiance by range, half the length of a path."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import partial
from itertools import product
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from polywigner.errors import ArgumentError
from polywigner.execution.progress import with_progress
from polywigner.geometry.arguments import real_array
from polywigner.mitsuba.plugins.films import seed_of
from polywigner.mitsuba.plugins.registration import one_at_a_time
from polywigner.mitsuba.radar.range_film import (
    check_bin_count,
    require_transients,
    sorted_by_range,
    transient_integrator,
)
from polywigner.mitsuba.receive.power_results import (
    DirectPath,
    ReceivedPower,
    ReceiveOptions,
    Variables,
    described,
)
from polywigner.mitsuba.receive.received_power import (
    Progress,
    Received,
    Sampled,
    index_of,
    received,
    scattered_here,
)
from polywigner.mitsuba.receive.scattered import by_source, standard_error
from polywigner.mitsuba.scenes.rendering import exposed
from polywigner.mitsuba.scenes.surfaces import is_receiver, receivers_of, wigner_emitters
from polywigner.numerics import Floats
from polywigner.quantities import SPEED_OF_LIGHT

if TYPE_CHECKING:
    import xarray


# Largest number of range bins; these bins take 0.1 GB per light and receiver.
_MOST_BINS = 2**20


@one_at_a_time
def range_profile(
    scene: Any,
    ranges: npt.ArrayLike,
    *,
    spp: int | None = None,
    seed: int = 0,
    receiver: int | str | None = None,
    integrator: Any = None,
    reflections: int = 2,
    tolerance: float = 1e-6,
    bandwidth: float | str | None = None,
    temperature: float | str | None = None,
    noise_figure: float | str | None = None,
    coherent: bool = False,
    polarisation: Any = None,
    bodies: Mapping[str, Any] | None = None,
    progress: Progress | None = None,
) -> xarray.Dataset:
    """Return the power at each receiver of a scene as a function of range, with standard errors.

    The range is half the length of a path from a source to a receiver, in m. Path lengths in glass
    are multiplied by the refractive index. The power is the sum of direct light and scattered
    light, as in :func:`polywigner.mitsuba.received_power`. The function requires mitransient, part
    of the extra ``radar``. See docs/range.md.

    Parameters
    ----------
    scene : mi.Scene
        Scene of a compiled variant with ``wigner_receiver`` sensors and lights.
    ranges : array_like, shape (n + 1,)
        Ascending edges of n range bins in m, at least zero. At most 2^20 bins are allowed.
    spp : int, optional
        Number of samples for each emitter. The number is rounded up to a multiple of 16, because
        the samples are divided into 16 batches. Default: the value of the sensor.
    seed : int, default 0
        Seed of the random numbers, zero or more.
    receiver : int or str, optional
        Id of the receiver, or its index in the sorted list of receiver ids. Default: all receivers.
    integrator : str or mi.Integrator, optional
        Integrator of mitransient: ``transient_path`` for surfaces, or ``transient_prbvolpath`` for
        surfaces and fog. Mitsuba's path, direct and prb are replaced by ``transient_path``, and its
        volpath, volpathmis and prbvolpath by ``transient_prbvolpath``, with the same depths.
        Default: the integrator of the scene, or the default of :func:`polywigner.mitsuba.render` if
        the scene has no integrator.
    reflections, tolerance
        Options of direct light, as in :func:`polywigner.mitsuba.received_power`.
    bandwidth, temperature, noise_figure
        As in :func:`polywigner.mitsuba.received_power`.
    coherent : bool, default False
        Whether the amplitudes of direct paths of an emitter add within each bin.
    polarisation, bodies
        With ``coherent``, as in :func:`polywigner.mitsuba.received_power`.
    progress : callable, optional
        Function that is called after each render with the number of finished renders and the total
        number of renders.

    Returns
    -------
    xarray.Dataset
        Dataset with the following variables. The result for a single receiver has no dimension
        ``receiver``.

        - ``power`` (receiver, range): power in each bin in W, the sum of ``direct_power`` and
          ``scattered_power``; ``standard_error`` (receiver, range): standard error of ``power`` in
          W
        - ``emitter_power`` (receiver, emitter, range): power from each emitter in W
        - ``before`` and ``after`` (receiver): power in W from ranges below and above all bins
        - ``direct``, ``scattered`` and ``scattered_error`` (receiver): direct power, scattered
          power and standard error of the scattered power in W, summed over all ranges
        - ``path_power`` and ``path_range`` (receiver, emitter, path): power in W and range in m of
          each path of direct light, or zero and NaN if an emitter does not have this path
        - ``mirrors`` (path): names of the mirrors and bodies on the path, joined by ", ", after the
          id of the light if it is not a coherent source
        - ``noise_power`` and ``resolution`` (receiver): noise power in W and range resolution c/(2
          bandwidth) in m, or NaN if the temperature or the bandwidth is unknown

        The coordinates are the centres ``range`` and the edges ``range_edge`` of the bins in m.

    Raises
    ------
    MissingExtraError
        If mitransient is not installed.
    EngineError
        If the variant is scalar.
    ArgumentError
        If the edges do not ascend, or if another argument is out of range.
    SceneError
        If the integrator does not measure path lengths, if a light is infinitely far away, if the
        receiver is in fog, or if fog is heterogeneous, because mitransient underestimates path
        lengths in heterogeneous fog. Also as in :func:`polywigner.mitsuba.received_power`.
    """
    edges = checked_ranges(ranges)
    require_transients()
    noise = bandwidth, temperature, noise_figure
    waves = coherent, polarisation, bodies
    options = ReceiveOptions(spp, seed, integrator, reflections, tolerance, *noise, *waves)
    receivers = receivers_of(scene)
    numbers = list(range(len(receivers))) if receiver is None else [index_of(receivers, receiver)]
    sample = partial(scattered_here, scene, progress)
    return received_by_range(scene, numbers, options, edges, sample)[1]


def received_by_range(
    scene: Any, numbers: list[int], options: ReceiveOptions, edges: Floats, sample: Sampled
) -> tuple[list[ReceivedPower], xarray.Dataset]:
    """Return the total power at each receiver, and the power as a function of range.

    ``numbers`` are indices in the list of `receivers_of`. ``edges`` are the edges of range bins in
    m. ``sample`` renders the scattered light.
    """
    result = received(scene, numbers, options, sample, edges)
    return result.powers, _profile_of(scene, result, edges)


def checked_ranges(ranges: npt.ArrayLike) -> Floats:
    """Convert bin edges in m; raise ArgumentError unless they are ascending and not negative."""
    expected = (
        f"expected ranges to be 2 to {_MOST_BINS + 1} edges of bins in m, such as "
        "np.linspace(0, 60, 513)"
    )
    edges = real_array(ranges, expected, (None,))
    if not 2 <= len(edges) <= _MOST_BINS + 1:
        raise ArgumentError(f"{expected}, got shape {edges.shape}")
    with np.errstate(over="ignore"):  # Path lengths are in single precision.
        single = edges.astype(np.float32)
    if not np.isfinite(single).all() or edges[0] < 0 or not np.all(np.diff(single) > 0):
        raise ArgumentError(
            "ranges must be finite bin edges, ascending from zero or above, also in single "
            f"precision, got {edges[0]:g} to {edges[-1]:g} m in {len(edges) - 1} steps"
        )
    return edges


def _profile_of(scene: Any, result: Received, edges: Floats) -> xarray.Dataset:
    """Return the received power by range as a dataset."""
    powers, placed, batches = result
    names = [part.name for part in powers[0].contributions]
    pairs = [by_source(scene, of_receiver) for of_receiver in batches]
    by_light = np.array([[*of_sources, others][: len(names)] for of_sources, others in pairs])
    lights = [[part.paths for part in power.contributions] for power in powers]
    direct = np.array([[_direct_power_by_range(paths, edges) for paths in row] for row in lights])
    values = _power_variables(by_light, direct) | _noise_variables(powers)
    labels, paths = _paths_of(lights)
    coords = {**range_axes(edges), "emitter": names}
    receivers = [receiver.name for receiver in placed]
    values |= paths
    if is_single := len(receivers) == 1:
        values = {name: (array[0], *rest) for name, (array, *rest) in values.items()}
    else:
        values = {n: (a, ("receiver", *dims), *rest) for n, (a, dims, *rest) in values.items()}
        coords["receiver"] = receivers
    meaning = "light, then mirrors in the order of reflection; no mirrors: line of sight"
    about = {
        "receiver": receivers[0] if is_single else "several",
        "wavelength": placed[0].wavelength,
        "polarisation": "; ".join(dict.fromkeys(power.polarisation for power in powers)),
        "samples": powers[0].samples,
        "seed": powers[0].seed,
    }
    return described(values | {"mirrors": (labels, ("path",), "", meaning)}, coords, about)


def _direct_power_by_range(paths: Sequence[DirectPath], edges: Floats) -> Floats:
    """Return the direct power in W as a function of range, shape (bins + 2,).

    ``edges`` are the edges of range bins in m. The first value belongs to ranges below all bins,
    the last value to ranges above all bins. The amplitudes of interfering paths are added within
    each bin.
    """
    result, waves = np.zeros(len(edges) + 1), np.zeros(len(edges) + 1, np.complex128)
    for path in paths:
        number = np.searchsorted(edges, path.length / 2, side="right")
        if path.amplitude is None:
            result[number] += path.power
        elif path.power > 0.0:
            waves[number] += path.amplitude / abs(path.amplitude) * math.sqrt(path.power)
    return np.asarray(result + np.abs(waves) ** 2)


def _power_variables(by_light: Floats, direct: Floats) -> Variables:
    """Return dataset variables that contain the power as a function of range.

    ``by_light`` is the scattered power (receivers, lights, batches, values), and ``direct`` is the
    direct power (receivers, lights, values), both in W. The first of the ``values`` belongs to
    ranges below all bins, the last to ranges above all bins.
    """
    batches = by_light.sum(axis=1)
    scattered, of_direct = batches.mean(axis=1), direct.sum(axis=1)
    total, of_light = of_direct + scattered, direct + by_light.mean(axis=2)
    by_range = {
        "power": (total, "power of a bin"),
        "standard_error": (standard_error(batches, axis=1), "standard error of the power"),
        "direct_power": (of_direct, "power of a bin, line of sight and via flat mirrors"),
        "scattered_power": (scattered, "scattered power of a bin"),
    }
    error = standard_error(batches.sum(axis=-1), axis=1)
    sums = {
        "before": (total[:, 0], "power from nearer than all bins"),
        "after": (total[:, -1], "power from farther than all bins"),
        "direct": (of_direct.sum(axis=1), "direct power from all ranges"),
        "scattered": (scattered.sum(axis=1), "scattered power from all ranges"),
        "scattered_error": (error, "standard error of the scattered power from all ranges"),
    }
    return {
        **{name: (a[:, 1:-1], ("range",), "W", text) for name, (a, text) in by_range.items()},
        "emitter_power": (of_light[..., 1:-1], ("emitter", "range"), "W", "power of one emitter"),
        **{name: (a, (), "W", text) for name, (a, text) in sums.items()},
    }


def _noise_variables(powers: list[ReceivedPower]) -> Variables:
    """Return the noise power and the range resolution of each receiver as dataset variables."""
    bands = [power.bandwidth for power in powers]
    noise = [power.noise_power for power in powers]
    resolution = [None if b is None else SPEED_OF_LIGHT / (2 * b) for b in bands]
    meaning = "range that the bandwidth resolves, c/(2 B)"
    return {
        "noise_power": (np.array(noise, float), (), "W", "noise k T B F"),
        "resolution": (np.array(resolution, float), (), "m", meaning),
    }


def _paths_of(links: list[list[tuple[DirectPath, ...]]]) -> tuple[npt.NDArray[np.str_], Variables]:
    """Return the labels of all direct paths, and their powers and ranges as variables.

    ``links[i][j]`` contains the direct paths from light j to receiver i.
    """
    labels: dict[str, int] = {}
    entries = []
    for (i, lights), j in product(enumerate(links), range(len(links[0]))):
        for path in lights[j]:
            label = ", ".join([path.light, *path.mirrors] if path.light else path.mirrors)
            entries.append(((i, j, labels.setdefault(label, len(labels))), path))
    shape = len(links), len(links[0]), len(labels)
    powers, ranges = np.zeros(shape), np.full(shape, np.nan)
    for index, path in entries:
        powers[index], ranges[index] = path.power, path.length / 2
    each = ("emitter", "path")
    return np.array(list(labels), np.str_), {
        "path_power": (powers, each, "W", "power of a path of direct light"),
        "path_range": (ranges, each, "m", "range of a path of direct light"),
    }


def range_axes(edges: Floats) -> dict[str, Any]:
    """Return the centres and the edges of range bins in m as coordinates of a dataset."""
    length = {"units": "m", "long_name": "range, half the length of the path"}
    return {
        "range": ("range", (edges[1:] + edges[:-1]) / 2, length),
        "range_edge": ("range_edge", edges, {**length, "long_name": "bin edges"}),
    }


# Number of renders per image; progress is reported after each render.
_PARTS = 4


@one_at_a_time
def range_frames(
    scene: Any,
    ranges: npt.ArrayLike,
    *,
    spp: int | None = None,
    seed: int = 0,
    sensor: int = 0,
    integrator: Any = None,
    progress: Progress | None = None,
) -> xarray.Dataset:
    """Render the radiance at a camera as a function of range, with one frame for each range bin.

    The range is half the length of a path from a point on a source to the camera, as in
    :func:`range_profile`. The path length includes the near-clip distance of the camera. Sources
    are visible, as in :func:`polywigner.mitsuba.render`. The film has a box filter. See
    docs/range.md.

    Parameters
    ----------
    scene : mi.Scene
        Scene of a compiled variant. The camera specifies the image size, the crop and the sampler.
    ranges : array_like, shape (n + 1,)
        Ascending edges of n bins in m, zero or more. In scenes without ``wigner`` shapes, a scene
        unit counts as a metre.
    spp : int, optional
        Samples per pixel. Default: the value of the sampler.
    seed : int, default 0
        Seed of the random numbers, zero or more.
    sensor : int, default 0
        Index of the scene's camera.
    integrator : str or mi.Integrator, optional
        As in :func:`range_profile`.
    progress : callable, optional
        Function that is called after each of 4 parts with the number of finished parts and the
        total number of parts.

    Returns
    -------
    xarray.Dataset
        ``radiance`` with the dimensions (range, row, column) in W m^-2 sr^-1. ``before`` and
        ``after``, with the dimensions (row, column), are the radiance from ranges below and above
        all bins. The sum over all ranges is the luminance of the image. The coordinates are
        ``range`` and ``range_edge`` in m.

    Raises
    ------
    ArgumentError
        If the sensor is a receiver, or if there are more than 2^28 values.
    MissingExtraError, EngineError, SceneError
        As in :func:`range_profile`.
    """
    edges = checked_ranges(ranges)
    require_transients()
    exposure = exposed(scene, integrator, spp, seed, sensor)
    camera, total = exposure.camera, exposure.cut.samples
    if is_receiver(camera):
        raise ArgumentError(
            f"expected a camera, but sensor {sensor} is a receiver; use range_profile for receivers"
        )
    method = transient_integrator(exposure.integrator, scene, camera)
    units = {emitter.spec.scene_unit for emitter in wigner_emitters(scene)} or {1.0}
    if len(units) > 1:
        raise ArgumentError(f"all sources must have the same scene_unit, got {sorted(units)} m")
    lengths = 2.0 * edges / units.pop()
    check_bin_count(camera.film().crop_size(), edges)
    parts = min(_PARTS, total)
    sums: Any = 0.0
    with with_progress("renders", range(parts), progress) as numbers:
        for part in numbers:
            samples = total // parts + (part < total % parts)
            seed_of_part = seed_of(exposure.seed, part)
            image = sorted_by_range(scene, camera, method, lengths, samples, seed_of_part)
            sums = sums + samples / total * image
    pixels, unit = ("row", "column"), "W m-2 sr-1"
    frames = np.moveaxis(sums[..., 1:-1], -1, 0)
    values = {
        "radiance": (frames, ("range", *pixels), unit, "radiance of a bin"),
        "before": (sums[..., 0], pixels, unit, "radiance from nearer than all bins"),
        "after": (sums[..., -1], pixels, unit, "radiance from farther than all bins"),
    }
    return described(values, range_axes(edges), {"samples": total, "seed": exposure.seed})
