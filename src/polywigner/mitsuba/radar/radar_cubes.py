"""Radar data cubes, which contain samples by receiver, emitter, repetition and time.

The signal, (RC1) of docs/radar.md, is the sum over coherent paths and over a cloud of scatterers
with random complex amplitudes (speckle).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, NamedTuple

import mitsuba as mi
import numpy as np
from numpy.typing import ArrayLike, NDArray

from polywigner.errors import SceneError, require
from polywigner.execution.progress import with_progress
from polywigner.geometry.arguments import check_most, checked_choice, checked_count, checked_flag
from polywigner.mitsuba.plugins.placement import PlacedSource
from polywigner.mitsuba.plugins.registration import one_at_a_time
from polywigner.mitsuba.radar.clouds import end_responses
from polywigner.mitsuba.radar.scatterers import checked_velocities, scatterers
from polywigner.mitsuba.receive.channels import paths_between
from polywigner.mitsuba.receive.power_results import ReceiveOptions, described, noise_power_of
from polywigner.mitsuba.receive.received_power import matched_ends
from polywigner.mitsuba.scenes.reflectors import Echo, Route, routes_in
from polywigner.mitsuba.scenes.rendering import hide_emitters, polarised_by_default
from polywigner.mitsuba.scenes.surfaces import receivers_of
from polywigner.numerics import Complex, Floats
from polywigner.quantities import SPEED_OF_LIGHT
from polywigner.radar import CUBE_DIMS, FMCW, parse_waveform, waveform_attrs
from polywigner.source import Array

if TYPE_CHECKING:
    import xarray

Velocities = dict[str, Floats]

# Relative tolerance of non-uniform FFTs over scatterers.
_SUMS_ERROR = 1e-7
# Largest change in the product of delay and bandwidth within a block of repetitions. This limit
# keeps the phase in the series expansion below 2 rad.
_MOST_CYCLES = 1.25
# Largest motion of a scatterer within a repetition [range bins]. This limit keeps the relative
# error below 5e-5.
_MOST_WITHIN = 4.0
_MOST_POINTS = 1_000_000
# Largest size of a signal in memory [bytes]. Larger signals are dask arrays.
_MOST_BYTES = 1 << 30
# Relative tolerance for frequencies at the limits of the band.
_ROUNDING = 1e-9
# Gaps between the ends of a shadow ray and surfaces, relative to the distance of the emitter.
_RAY_OFFSET = 1e-3


@dataclass(frozen=True, eq=False)
class _Radar:
    """Emitters and receivers of a radar, with the times of repetitions."""

    waveform: FMCW
    emitters: list[PlacedSource]
    receivers: list[list[PlacedSource]]
    """The receiver itself or its elements, for each receiver of the scene."""
    noise_power: Floats
    """Noise power per sample of each receiver in W; NaN if the temperature is not specified."""
    chirp_times: Floats
    """Start times of repetitions in s, shape (emitter, chirp + 1)."""
    frequency: float
    """Frequency of the scene in Hz."""

    @property
    def period(self) -> float:
        """Repetition interval of an emitter in s."""
        return float(self.chirp_times[0, 1] - self.chirp_times[0, 0])


@dataclass(frozen=True, eq=False)
class _Cloud:
    responses: Complex
    """Responses of the elements in m, shape (element, scatterer)."""
    emitted: Complex
    """Square roots of scattered radiant intensities, shape (emitter, scatterer)."""
    delays: Floats
    """Delays at time zero in s, shape (emitter, scatterer)."""
    rates: Floats
    """Rates of change of the delays in s/s, shape (scatterer,)."""
    excess: Floats
    """Delays relative to the mean over elements in s, shape (element, scatterer)."""


@one_at_a_time
def radar_cube(
    scene: Any,
    waveform: FMCW | str,
    *,
    velocities: Mapping[str, ArrayLike] | None = None,
    bodies: Mapping[str, Any] | None = None,
    reflections: int = 2,
    elements: bool = False,
    points: int = 20_000,
    rays: int | None = None,
    draws: int = 1,
    seed: int = 0,
    noise: bool = True,
    multiplexing: str = "time",
    polarisation: Any = None,
) -> xarray.Dataset:
    """Return the samples that the receivers of a radar record in a scene.

    The signal is the sum of coherent paths, scattered fields and thermal noise, (RC1) of
    docs/radar.md. Coherent paths are the line of sight (leakage), specular paths via flat mirrors,
    and echoes from conducting bodies, with their complex couplings at all frequencies of the band.
    Scattered fields have random amplitudes (speckle), and are weighted by the exact response of
    each receiving element. The delay of each path changes from sample to sample, so moving objects
    migrate through range bins.

    Parameters
    ----------
    scene : mi.Scene
        Scene with ``wigner`` shapes and ``wigner_receiver`` sensors. All of them must have the same
        frequency, which must lie in the band of the waveform. Load the scene with
        :func:`load_scene`, which keeps the ids of shapes.
    waveform : polywigner.radar.FMCW or str
        Waveform, or a string as in :func:`polywigner.radar.parse_waveform`.
    velocities : mapping of str to array_like, shape (3,), optional
        Velocities in m/s of shapes, bodies, emitters and receivers by id. Default: zero.
    bodies : mapping, optional
        Conducting bodies by name, as in :func:`channel`.
    reflections : int, default 2
        Maximum number of specular reflections per path, 0 to 3.
    elements : bool, default False
        Whether to record each element of an array separately. This applies to receivers whose
        source is a :class:`polywigner.Array`. The weights of the array are then ignored. The
        elements of the receiver "rx" are named "rx[0]", "rx[1]", ...
    points : int, default 20000
        Largest number of scatterers for each receiver; 0 omits scattered fields.
    rays : int, optional
        Number of rays from each receiver, as in :func:`scatterers`. With more rays, smaller objects
        appear in the data.
    draws : int, default 1
        Number of draws of speckle and noise.
    seed : int, default 0
        Seed of the random numbers, zero or more.
    noise : bool, default True
        Whether to add thermal noise to the samples of receivers with a temperature. The noise power
        is k T B F, where B is the sampling rate, T the temperature and F the noise figure.
    multiplexing : {"time", "none"}
        ``time``: the emitters transmit one after the other, repetition by repetition. ``none``: all
        emitters start their repetitions together, and receivers separate them perfectly.
    polarisation : str or array_like, optional
        Polarisation of emitters and receivers whose polarisation is not specified in the scene, as
        in :func:`channel`.

    Returns
    -------
    xarray.Dataset
        ``signal`` contains the complex samples in sqrt(W), as a dask array above 1 GiB, with the
        dimensions (draw, receiver, emitter, chirp, sample). The mean of its squared modulus is the
        received power. ``noise_power`` is the noise power per sample of each receiver in W.
        ``receiver_position`` and ``emitter_position`` are in m, in the frame of the first receiver.
        ``start_time`` is the time of the first repetition of each emitter in s. The coordinates are
        the names of receivers and emitters. The attributes are the parameters of the waveform, the
        ``period`` in s from one repetition of an emitter to the next, ``seed``,
        ``scattered_points``, and ``notes`` about effects that are not included.

    Raises
    ------
    SceneError
        If the scene has no emitter or no receiver, if their frequencies differ or are outside the
        band of the waveform, or if there are partially coherent sources or scatterers with negative
        power.
    ArgumentError, QuantityError
        If another argument is out of range, or an id is unknown.
    """
    wave = parse_waveform(waveform)
    size = checked_count(points, "points", 0, _MOST_POINTS)
    count = checked_count(draws, "draws", 1, _MOST_POINTS)
    is_in_turn = checked_choice(multiplexing, "multiplexing", ("time", "none")) == "time"
    with_noise = checked_flag(noise, "noise")
    options = ReceiveOptions(
        seed=seed, reflections=reflections, coherent=True, polarisation=polarisation, bodies=bodies
    )
    with polarised_by_default(scene, options.polarisation):
        radar = _radar_of(scene, options, checked_flag(elements, "elements"), wave, is_in_turn)
    speeds = checked_velocities({} if velocities is None else velocities)
    coherent, notes = _coherent_links(scene, radar, options, speeds)
    clouds: list[_Cloud | None] = [None] * len(radar.receivers)
    if size:
        with with_progress("scattered fields", range(len(clouds))) as numbers:
            clouds = [_cloud_of(scene, radar, k, size, rays, speeds, options) for k in numbers]

    def block(number: int, draw: int) -> Complex:
        """Return the samples (1, element, emitter, chirp, sample) of a receiver in a draw."""
        return _samples(
            radar, coherent[number], clouds[number], with_noise, (options.seed, number, draw)
        )[None]

    elements_of = [len(elements) for elements in radar.receivers]
    shape = (len(radar.emitters), wave.chirps, wave.samples)
    if count * sum(elements_of) * math.prod(shape) * 16 > _MOST_BYTES:
        signal = _lazy_signal(block, elements_of, count, shape)
    else:
        signal = np.concatenate(
            [np.concatenate([block(k, d) for d in range(count)]) for k in range(len(elements_of))],
            axis=1,
        )
    total = sum(len(cloud.rates) for cloud in clouds if cloud is not None)
    about = {"seed": options.seed, "scattered_points": total, "notes": notes}
    return _dataset(signal, radar, about)


def _lazy_signal(
    block: Callable[[int, int], Complex], elements: list[int], draws: int, shape: tuple[int, ...]
) -> Any:
    """Return the signal as a dask array with one chunk for each draw and receiver.

    ``block(receiver, draw)`` computes a chunk, and ``elements`` contains the number of elements of
    each receiver.
    """
    array = require("dask.array", "datasets", "cubes of more than 1 GiB are computed with")
    delayed = require("dask", "datasets").delayed(block, pure=False)
    rows = [
        array.concatenate(
            [array.from_delayed(delayed(k, d), (1, n, *shape), complex) for d in range(draws)]
        )
        for k, n in enumerate(elements)
    ]
    return array.concatenate(rows, axis=1)


def _radar_of(
    scene: Any, options: ReceiveOptions, by_element: bool, wave: FMCW, is_in_turn: bool
) -> _Radar:
    """Return the emitters, the receivers or their elements, and the start times of chirps.

    ``is_in_turn`` selects time multiplexing. Raises SceneError if a frequency is outside the band
    of the waveform.
    """
    emitters, receivers = matched_ends(scene, list(range(len(receivers_of(scene)))), options)
    if not emitters:
        raise SceneError('the scene has no wigner emitter; add a <shape type="wigner">')
    for end in (*emitters, *receivers):
        frequency = SPEED_OF_LIGHT / end.wavelength
        first, last = wave.start * (1 - _ROUNDING), (wave.start + wave.bandwidth) * (1 + _ROUNDING)
        if not first <= frequency <= last:
            raise SceneError(
                f"the frequency of {end.name!r} must be in the band of the waveform, {first:.6g} "
                f"to {last:.6g} Hz, got {frequency:.6g} Hz"
            )
    elements, powers = [], []
    for receiver in receivers:
        parts, noise = [receiver], receiver.noise
        if by_element and isinstance(receiver.source, Array):
            parts = [
                replace(receiver, source=element, name=f"{receiver.name}[{k}]")
                for k, element in enumerate(receiver.source.elements_in_plane)
            ]
        elements.append(parts)
        power = noise_power_of(wave.sample_rate, noise["temperature"], noise["noise_figure"])
        powers.append(math.nan if power is None else power)
    cycles = len(emitters) if is_in_turn else 1
    starts = np.arange(len(emitters)) * (wave.interval if is_in_turn else 0.0)
    times = np.add.outer(starts, cycles * wave.interval * np.arange(wave.chirps + 1))
    frequency = SPEED_OF_LIGHT / emitters[0].wavelength
    return _Radar(wave, emitters, elements, np.array(powers), times, frequency)


def _samples(
    radar: _Radar,
    links: list[list[_Link]],
    cloud: _Cloud | None,
    with_noise: bool,
    seed: tuple[int, int, int],
) -> Complex:
    """Return the samples (element, emitter, chirp, sample) of one receiver in one draw.

    ``links`` are nested by element and emitter. ``seed`` contains the seed of the cube, the index
    of the receiver and the number of the draw.
    """
    wave, random = radar.waveform, np.random.default_rng(seed)
    spectra = np.zeros((len(links), len(radar.emitters), wave.chirps, wave.samples), np.complex128)
    for k, of_element in enumerate(links):
        for j, link in enumerate(of_element):
            waits = np.add.outer(radar.chirp_times[j, :-1], wave.times)
            for amplitude, rate in zip(link.amplitudes, link.rates, strict=True):
                spectra[k, j] += amplitude * np.exp(2j * np.pi * rate * wave.frequencies * waits)
    if cloud is not None:
        speckle = _complex_normal(random, cloud.rates.shape)
        for j in range(len(radar.emitters)):
            spectra[:, j] += _scattered_signal(radar, cloud, speckle, j)
    samples = wave.from_spectrum(spectra)
    power = radar.noise_power[seed[1]]
    if with_noise and math.isfinite(power):
        samples = samples + math.sqrt(power) * _complex_normal(random, samples.shape)
    return samples


class _Link(NamedTuple):
    amplitudes: Complex
    """Amplitudes in sqrt(W), shape (path, sample)."""
    rates: Floats
    """Rates of change of the delays in s/s, shape (path,)."""


def _coherent_links(
    scene: Any, radar: _Radar, options: ReceiveOptions, speeds: Velocities
) -> tuple[list[list[list[_Link]]], list[str]]:
    """Return the amplitudes of all coherent paths, and notes on excluded effects.

    The links are nested lists by receiver, element and emitter.
    """
    wave = radar.waveform
    unit = radar.emitters[0].scene_unit
    routes, notes = routes_in(scene, unit, options.reflections, options.bodies)

    def link(emitter: PlacedSource, receiver: PlacedSource) -> _Link:
        """Return the coherent paths from an emitter to an element."""
        paths, h, of_link = paths_between(
            scene, emitter, receiver, routes, options, wave.frequencies
        )
        # All elements of a receiver have the same notes, so only the notes of the first element are
        # collected.
        if any(receiver is parts[0] for parts in radar.receivers):
            notes.extend(of_link)
        rates = [_path_rate(path.route, emitter, receiver, speeds) for path in paths]
        return _Link(math.sqrt(emitter.power) * h.T, np.array(rates) / SPEED_OF_LIGHT)

    with hide_emitters(scene), with_progress("links", radar.receivers) as receivers:
        links = [[[link(e, r) for e in radar.emitters] for r in parts] for parts in receivers]
    return links, list(dict.fromkeys(notes))


def _path_rate(
    route: Route, emitter: PlacedSource, receiver: PlacedSource, speeds: Velocities
) -> float:
    """Return the rate in m/s at which the length of a path increases."""
    still = np.zeros(3)
    if isinstance(route, Echo):
        body, point = route.body.name, route.body.facets.centre
        legs = [(emitter, route.before), (receiver, route.after[::-1])]
    else:
        body, point, legs = _receiver_id(receiver.name), receiver.centre, [(emitter, route)]
    rate = 0.0
    for end, chain in legs:
        # Velocity of the mirror image of an antenna. The velocity of the body or the receiver at
        # the other end of the path is subtracted below.
        velocity = speeds.get(_receiver_id(end.name), still)
        for mirror in chain:
            moved = velocity - speeds.get(mirror.name, still)
            velocity = velocity - 2 * (moved @ mirror.normal) * mirror.normal
        velocity = velocity - speeds.get(body, still)
        offset = end.image(chain).centre - point
        rate += float(offset @ velocity / np.linalg.norm(offset))
    return rate


def _receiver_id(name: str) -> str:
    """Return the id of the receiver to which an element such as "rx[3]" belongs."""
    return name.partition("[")[0] if name.endswith("]") else name


def _cloud_of(
    scene: Any,
    radar: _Radar,
    number: int,
    size: int,
    rays: int | None,
    speeds: Velocities,
    options: ReceiveOptions,
) -> _Cloud | None:
    """Return the scatterers of a receiver with responses and delays, or None without scatterers.

    ``number`` is the index of the receiver in ``radar``.
    """
    receivers = radar.receivers[number]
    others = {_receiver_id(ends[0].name) for ends in radar.receivers if ends is not receivers}
    outside = others | {body.name for body in options.bodies}
    moving = {name: speed for name, speed in speeds.items() if name not in outside}
    cloud = scatterers(
        scene, size, seed=options.seed, velocities=moving, receiver=number, rays=rays
    )
    if not cloud.sizes["scatterer"]:
        return None
    responses, excess = _responses(cloud, receivers)
    emitted, lengths = _emitted_amplitudes(scene, cloud, radar.emitters)
    near = np.isfinite(lengths).all(axis=0)
    rates, wave = cloud["path_rate"].values[near] / SPEED_OF_LIGHT, radar.waveform
    within = np.abs(rates).max(initial=0.0) * wave.bandwidth * wave.samples * wave.time_step
    things = "range bins of motion within a repetition"
    check_most(within, _MOST_WITHIN, things, "use slower objects or a shorter waveform")
    return _Cloud(
        responses[:, near], emitted[:, near], lengths[:, near] / SPEED_OF_LIGHT, rates,
        excess[:, near] / SPEED_OF_LIGHT,
    )  # fmt: skip


def _responses(cloud: xarray.Dataset, receivers: list[PlacedSource]) -> tuple[Complex, Floats]:
    """Return the responses of a receiver's elements to scatterers, and relative path lengths.

    Responses and path lengths are in m, with the shape (element, scatterer). Path lengths are
    relative to their mean over the elements.
    """
    power, intensity = cloud["power"].values, cloud["intensity"].values
    if min(power.min(), intensity.min()) < 0:
        raise SceneError(
            'scatterers with negative power have no amplitude; use the estimator "exact" for the '
            "receiver and for the emitters"
        )
    if len(receivers) == 1:
        ratio = np.divide(power, intensity, out=np.zeros_like(power), where=intensity > 0)
        return np.sqrt(ratio)[None].astype(np.complex128), np.zeros((1, len(power)))
    position = cloud["position"].values
    lengths = np.array([np.linalg.norm(position - end.centre, axis=1) for end in receivers])
    return end_responses(cloud, receivers), lengths - lengths.mean(axis=0)


def _emitted_amplitudes(
    scene: Any, cloud: xarray.Dataset, emitters: list[PlacedSource]
) -> tuple[Complex, Floats]:
    """Return complex amplitudes in sqrt(W/sr) and path lengths in m, shape (emitter, scatterer).

    The squared modulus of an amplitude is the radiant intensity of a scatterer due to an emitter.

    If a path has a single reflection, the intensity I of its scatterer is divided among the
    emitters: emitter j contributes I E_j / sum_i E_i, where E_j is the irradiance from emitter j.
    The sum over scatterers is unbiased, and the signals of the emitters are coherent.
    """
    intensity, paths = cloud["intensity"].values, cloud["path_length"].values
    names = cloud["emitter"].values
    from_emitter = np.array([names == emitter.name for emitter in emitters])
    amplitudes = np.sqrt(np.where(from_emitter, intensity, 0.0)).astype(np.complex128)
    lengths = np.tile(paths, (len(emitters), 1))
    if len(emitters) == 1:
        return amplitudes, lengths
    shared = (cloud["bounces"].values == 1) & from_emitter.any(axis=0)
    position, normal = cloud["position"].values[shared], cloud["normal"].values[shared]
    legs, fields = [], []
    for emitter in emitters:
        offset = emitter.centre - position
        distance = np.linalg.norm(offset, axis=1)
        incidence = np.maximum(np.sum(offset * normal, axis=1) / distance, 0.0)
        visible = _visible(scene, emitter, position, offset)
        field = end_responses(cloud.isel(scatterer=shared), [emitter])[0]
        fields.append(field * np.sqrt(emitter.power * incidence * visible))
        legs.append(distance)
    leg, field = np.array(legs), np.array(fields)
    total = np.square(np.abs(field)).sum(axis=0)
    scale = np.sqrt(np.divide(intensity[shared], total, out=np.zeros_like(total), where=total > 0))
    amplitudes[:, shared] = field * scale
    sampled = np.einsum("jn,jn->n", from_emitter[:, shared], leg)
    lengths[:, shared] += leg - sampled
    return amplitudes, lengths


def _visible(scene: Any, emitter: PlacedSource, position: Floats, offset: Floats) -> NDArray[Any]:
    """Return whether rays from scatterers to an emitter meet no surface, shape (n,).

    ``offset`` are the vectors in m from ``position`` to the emitter.
    """
    unit = emitter.scene_unit
    steps = (offset * (1 - 2 * _RAY_OFFSET) / unit).astype(np.float32)
    start = ((position + _RAY_OFFSET * offset) / unit).astype(np.float32)
    ray = mi.Ray3f(mi.Point3f(start.T), mi.Vector3f(steps.T))
    ray.maxt = 1.0
    return ~np.atleast_1d(np.array(scene.ray_test(ray)))


def _scattered_signal(radar: _Radar, cloud: _Cloud, speckle: Complex, emitter: int) -> Complex:
    """Return the signal (RC1) of a receiver from its scatterers.

    The shape is (element, chirp, sample), with a single chirp for scatterers at rest. ``speckle``
    has the shape (scatterer,).
    """
    signals = cloud.responses * (speckle * cloud.emitted[emitter])
    starts = radar.chirp_times[emitter, :-1]
    is_moving = cloud.rates != 0
    still = _signal_of_repetitions(radar, cloud, signals, emitter, ~is_moving, starts[:1])
    if not is_moving.any():
        return still
    migration = np.abs(cloud.rates).max() * radar.waveform.bandwidth * np.ptp(starts)
    blocks = min(len(starts), math.ceil(migration / _MOST_CYCLES))
    moving = [
        _signal_of_repetitions(radar, cloud, signals, emitter, is_moving, block)
        for block in np.array_split(starts, max(blocks, 1))
    ]
    return still + np.concatenate(moving, axis=1)


def _signal_of_repetitions(
    radar: _Radar,
    cloud: _Cloud,
    signals: Complex,
    emitter: int,
    chosen: NDArray[np.bool_],
    starts: Floats,
) -> Complex:
    """Return the signal (RC1) of the ``chosen`` scatterers, shape (element, repetition, sample).

    ``signals`` has the shape (element, scatterer), and ``starts`` are the start times of successive
    repetitions in s. The repetition m and the sample n are counted from the centre of the frame. A
    non-uniform FFT sums waves with phases linear in m and n, and a power series expands two small
    phases:

    - motion through range bins, r n df (m T + n dt), with the rate r of the delay, the frequency
      step df, the repetition time T and the time step dt
    - the relative delay d of an element, (f_n - f_0) d, with the frequency f_n of sample n and the
      frequency f_0 of the scene
    """
    wave = radar.waveform
    rates, delays = cloud.rates[chosen], cloud.delays[emitter, chosen]
    m = np.arange(len(starts)) - len(starts) // 2
    n = np.arange(wave.samples) - wave.samples // 2
    step, wait = wave.bandwidth / wave.samples, wave.time_step
    centre = wave.start - n[0] * step
    time = starts[len(starts) // 2] - n[0] * wait
    constant = (centre - radar.frequency) * delays + centre * rates * time
    slopes = [step * (delays + rates * time) + centre * wait * rates]
    shape = [wave.samples]
    if len(starts) > 1:
        slopes.insert(0, centre * radar.period * rates)
        shape.insert(0, len(starts))
    waves = signals[:, chosen] * np.exp(2j * np.pi * constant)
    motion = np.asarray(step * n * (radar.period * m[:, None] + wait * n), np.float64)
    offsets = wave.frequencies - radar.frequency
    result = np.zeros((len(waves), *motion.shape), np.complex128)
    plan = _nonuniform_fft(slopes, shape, len(waves))
    for terms, factor in _series(cloud.excess[:, chosen], offsets, _SUMS_ERROR):
        tolerance = _SUMS_ERROR / np.abs(terms).max(initial=1e-300) / np.abs(factor).max()
        for growths, by_sample in _series(rates, motion, tolerance):
            sums = plan.execute(np.ascontiguousarray(waves * terms * growths))
            result += sums.reshape(result.shape) * (factor * by_sample)
    return result


def _nonuniform_fft(slopes: list[Floats], shape: list[int], count: int) -> Any:
    """Return a plan whose method ``execute`` sums waves with amplitudes (count, points).

    The sums have the shape ``(count, *shape)``. The phase of a wave is ``2 pi (slopes . numbers)``,
    where the numbers along an axis start at ``-(size // 2)``.
    """
    finufft = require("finufft", "radar", "scattered fields are summed with")
    plan = finufft.Plan(1, tuple(shape), count, _SUMS_ERROR, 1, nthreads=1)
    plan.setpts(*(2 * np.pi * (slope - np.round(slope)) for slope in slopes))
    return plan


def _series(amounts: Floats, along: Floats, tolerance: float) -> Iterator[tuple[Complex, Floats]]:
    """Yield the power-series terms of ``exp(2 pi i amounts along)`` as pairs of factors.

    The factors have the shapes of ``amounts`` and ``along``; each term is their outer product.
    """
    scale = float(np.abs(along).max()) or 1.0
    phases = 2j * np.pi * amounts * scale
    largest = float(np.abs(phases).max(initial=0.0))
    terms, factor = np.ones_like(phases), np.ones_like(along)
    size, power = 1.0, 0
    while size > tolerance:
        yield terms, factor
        power += 1
        terms, factor = terms * phases, factor * (along / scale / power)
        size *= largest / power


def _complex_normal(random: np.random.Generator, shape: tuple[int, ...]) -> Complex:
    """Return circular Gaussian random numbers of variance 1."""
    pairs = random.standard_normal((*shape, 2)) * math.sqrt(0.5)
    return np.asarray(pairs.view(np.complex128)[..., 0])


def _dataset(signal: Any, radar: _Radar, about: dict[str, Any]) -> xarray.Dataset:
    """Return the radar cube as a dataset, with the names and positions of both ends."""
    ends = {"receiver": [end for elements in radar.receivers for end in elements]}
    ends["emitter"] = radar.emitters
    noise = np.repeat(radar.noise_power, [len(elements) for elements in radar.receivers])
    values: dict[str, Any] = {
        "noise_power": (noise, ("receiver",), "W", "noise power of a sample"),
        "start_time": (radar.chirp_times[:, 0], ("emitter",), "s", "start of the first repetition"),
    }
    frame = radar.receivers[0][0].pose
    for name, all_ends in ends.items():
        centres = np.array([(end.centre - frame[:3, 3]) @ frame[:3, :3] for end in all_ends])
        meaning = f"position of the {name} in the frame of the first receiver"
        values[f"{name}_position"] = (centres, (name, "axis"), "m", meaning)
    coords: dict[str, Any] = {name: [end.name for end in each] for name, each in ends.items()}
    coords["axis"] = ["x", "y", "z"]
    attrs = {**waveform_attrs(radar.waveform), "period": radar.period, **about}
    about_signal = {"units": "sqrt(W)", "long_name": "samples; |.|^2 is power"}
    dataset = described(values, coords, attrs)
    return dataset.assign(signal=(CUBE_DIMS, signal, about_signal))
