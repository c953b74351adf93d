"""Data cubes of radars: samples of receivers by emitter, repetition and time in a scene.

Coherent paths (line of sight, specular reflections, bodies) contribute (RC1) with their complex
couplings over the band. Scattered fields contribute the same sum over a cloud of scatterers, with
the root of each scatterer's power and a random complex factor of variance 1 (speckle).
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
from polywigner.geometry.arguments import checked_choice, checked_count, checked_flag
from polywigner.mitsuba.plugins.placement import PlacedSource
from polywigner.mitsuba.plugins.registration import one_at_a_time
from polywigner.mitsuba.radar.clouds import end_responses
from polywigner.mitsuba.radar.scatterers import checked_velocity, scatterers
from polywigner.mitsuba.receive.channels import amplitudes_of, paths_between
from polywigner.mitsuba.receive.power_results import ReceiveOptions, described, noise_power_of
from polywigner.mitsuba.receive.received_power import matched
from polywigner.mitsuba.scenes.reflectors import Chain, Echo, Route, routes_in
from polywigner.mitsuba.scenes.rendering import hide_emitters, polarised_by_default
from polywigner.mitsuba.scenes.surfaces import receivers_of
from polywigner.quantities import SPEED_OF_LIGHT
from polywigner.radar import CUBE_DIMS, FMCW, parse_waveform, waveform_attrs
from polywigner.source import Array
from polywigner.transforms.xarray_arguments import labelled_array

if TYPE_CHECKING:
    import xarray

Floats = NDArray[np.float64]
Complexes = NDArray[np.complex128]
Velocities = dict[str, Floats]

# Relative error of sums over scatterers.
_OF_SUMS = 1e-7
# Growth of a delay during one series, times the bandwidth; the phase of the motion is then 2 rad.
_MOST_CYCLES = 1.25
_MOST_POINTS = 1_000_000
# Bytes of the largest signal that is computed at once.
_MOST_BYTES = 1 << 30
# Relative rounding error of frequencies.
_ROUNDING = 1e-9
# Distance from which rays leave a surface, relative to the distance of the emitter.
_CLOSE = 1e-3


@dataclass(frozen=True, eq=False)
class _Radar:
    """Ends of a radar, and the times of its repetitions."""

    waveform: FMCW
    emitters: list[PlacedSource]
    receivers: list[list[PlacedSource]]
    """For each receiver of the scene the receiver itself, or its elements."""
    noise_power: Floats
    """Noise power of a sample in W for each receiver of the scene; NaN without a temperature."""
    chirp_times: Floats
    """Starts (emitter, chirp + 1) of the repetitions in s."""
    frequency: float
    """Frequency of the scene in Hz."""

    @property
    def period(self) -> float:
        """Time in s between repetitions of one emitter."""
        return float(self.chirp_times[0, 1] - self.chirp_times[0, 0])


@dataclass(frozen=True, eq=False)
class _Cloud:
    """Scatterers of one receiver of the scene, which its elements share."""

    responses: Complexes
    """(element, scatterer), times the next in sqrt(W)."""
    sent: Complexes
    """(emitter, scatterer)."""
    delays: Floats
    """(emitter, scatterer) in s at the time 0."""
    rates: Floats
    """Growth of the delays in s/s."""
    excess: Floats
    """Excess delays (element, scatterer) in s."""


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
    """Compute the samples that the receivers of a radar record in a scene.

    The samples are the sum of the line-of-sight path (leakage), of specular paths by flat mirrors
    and of echoes of conducting bodies, with their complex couplings over the band; of scattered
    fields as speckle, with the exact response of each receiving element; and of thermal noise.
    Each path has its own delay at each sample, so that objects migrate through range bins. See
    (RC1) and docs/radar.md.

    Parameters
    ----------
    scene : mi.Scene
        Scene with ``wigner`` shapes and ``wigner_receiver`` sensors of one frequency within the
        waveform's band. Load it with :func:`load_scene`, which keeps the ids of shapes.
    waveform : polywigner.radar.FMCW or str
        Waveform, or a text as for :func:`polywigner.radar.parse_waveform`.
    velocities : mapping of str to array_like, shape (3,), optional
        Velocities in m/s of shapes, bodies, emitters and receivers by their ids. Default: zero.
    bodies : mapping, optional
        Conducting bodies by their names, as for :func:`channel`.
    reflections : int, default 2
        Maximum number of specular reflections per path, 0 to 3.
    elements : bool, default False
        Record each element of a receiver whose source is a :class:`polywigner.Array`, without the
        weights of the array; elements of the receiver "rx" are "rx[0]", "rx[1]", ...
    points : int, default 20000
        Largest number of scatterers of each receiver; 0 leaves out scattered fields.
    rays : int, optional
        Rays from each receiver, as for :func:`scatterers`; more show smaller objects.
    draws : int, default 1
        Number of draws of speckle and noise.
    seed : int, default 0
        Seed of the random numbers, zero or more.
    noise : bool, default True
        Add thermal noise k T B F to receivers with a temperature. B is the sampling rate.
    multiplexing : {"time", "none"}
        ``time``: the emitters take turns, repetition by repetition. ``none``: all repetitions of
        all emitters start together, and the receivers separate them perfectly.
    polarisation : str or array_like, optional
        Polarisation of ends without one, as for :func:`channel`.

    Returns
    -------
    xarray.Dataset
        ``signal`` (draw, receiver, emitter, chirp, sample), complex in sqrt(W): the mean of its
        squared modulus is the received power. ``noise_power`` (receiver) in W per sample,
        ``receiver_position`` and ``emitter_position`` in m in the frame of the first receiver,
        ``start_time`` (emitter) in s of the first repetition. Coordinates: names of receivers and
        emitters. Attributes: those of the waveform, ``period`` in s between repetitions of one
        emitter, ``seed``, ``scattered_points``, and ``notes`` on effects that are left out.

    Raises
    ------
    SceneError
        If the scene has no emitter or receiver, several frequencies, a frequency outside of the
        band, partially coherent sources, or scatterers of negative power.
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
        radar = _radar(scene, options, checked_flag(elements, "elements"), wave, is_in_turn)
    speeds = {name: checked_velocity(name, value) for name, value in (velocities or {}).items()}
    coherent, notes = _coherent(scene, radar, options, speeds)
    clouds: list[_Cloud | None] = [None] * len(radar.receivers)
    if size:
        with with_progress("scattered fields", range(len(clouds))) as numbers:
            for number in numbers:
                clouds[number] = _cloud(scene, radar, number, size, rays, speeds, options)

    def block(number: int, draw: int) -> Complexes:
        return _samples(
            radar, coherent[number], clouds[number], with_noise, (options.seed, number, draw)
        )[None]

    elements_of = [len(each) for each in radar.receivers]
    shape = (len(radar.emitters), wave.chirps, wave.samples)
    if count * sum(elements_of) * math.prod(shape) * 16 > _MOST_BYTES:
        signal = _lazy(block, elements_of, count, shape)
    else:
        signal = np.concatenate(
            [np.concatenate([block(k, d) for d in range(count)]) for k in range(len(elements_of))],
            axis=1,
        )
    total = sum(len(cloud.rates) for cloud in clouds if cloud is not None)
    about = {"seed": options.seed, "scattered_points": total, "notes": notes}
    return _dataset(signal, radar, about)


def _lazy(
    block: Callable[[int, int], Complexes], elements: list[int], draws: int, shape: tuple[int, ...]
) -> Any:
    """Return the signal as a dask array with a chunk for each draw and receiver of the scene."""
    array = require("dask.array", "datasets", "cubes of more than 1 GiB are computed with")
    delayed = require("dask", "datasets").delayed(block, pure=False)
    rows = [
        array.concatenate(
            [array.from_delayed(delayed(k, d), (1, n, *shape), complex) for d in range(draws)]
        )
        for k, n in enumerate(elements)
    ]
    return array.concatenate(rows, axis=1)


def _radar(
    scene: Any, options: ReceiveOptions, by_element: bool, wave: FMCW, is_in_turn: bool
) -> _Radar:
    parties = matched(scene, list(range(len(receivers_of(scene)))), options)
    if not parties.emitters:
        raise SceneError("the scene has no wigner emitter; add one")
    for end in (*parties.emitters, *parties.receivers):
        frequency = SPEED_OF_LIGHT / end.wavelength
        first, last = wave.start * (1 - _ROUNDING), (wave.start + wave.bandwidth) * (1 + _ROUNDING)
        if not first <= frequency <= last:
            raise SceneError(
                f"expected the frequency of {end.name!r} within the waveform's band, {first:.6g} "
                f"to {last:.6g} Hz, got {frequency:.6g} Hz"
            )
    receivers, powers = [], []
    for receiver, noise in zip(parties.receivers, parties.noises, strict=True):
        parts = [receiver]
        if by_element and isinstance(receiver.source, Array):
            parts = [
                replace(receiver, source=element, name=f"{receiver.name}[{k}]")
                for k, element in enumerate(receiver.source.elements_in_plane)
            ]
        receivers.append(parts)
        power = noise_power_of(wave.sample_rate, noise["temperature"], noise["noise_figure"])
        powers.append(math.nan if power is None else power)
    turns = len(parties.emitters) if is_in_turn else 1
    starts = np.arange(len(parties.emitters)) * (wave.interval if is_in_turn else 0.0)
    times = np.add.outer(starts, turns * wave.interval * np.arange(wave.chirps + 1))
    frequency = SPEED_OF_LIGHT / parties.emitters[0].wavelength
    return _Radar(wave, parties.emitters, receivers, np.array(powers), times, frequency)


def _samples(
    radar: _Radar,
    links: list[list[_Link]],
    cloud: _Cloud | None,
    with_noise: bool,
    seed: tuple[int, int, int],
) -> Complexes:
    """Return samples (element, emitter, chirp, sample) of one receiver in one draw."""
    wave, random = radar.waveform, np.random.default_rng(seed)
    spectra = np.zeros((len(links), len(radar.emitters), wave.chirps, wave.samples), np.complex128)
    for k, of_element in enumerate(links):
        for j, link in enumerate(of_element):
            waits = np.add.outer(radar.chirp_times[j, :-1], wave.times)
            for amplitude, rate in zip(link.amplitudes, link.rates, strict=True):
                spectra[k, j] += amplitude * np.exp(2j * np.pi * rate * wave.frequencies * waits)
    if cloud is not None:
        speckle = _normal(random, cloud.rates.shape)
        for j in range(len(radar.emitters)):
            spectra[:, j] += _scattered(radar, cloud, speckle, j)
    samples = wave.from_spectrum(spectra)
    power = radar.noise_power[seed[1]]
    if with_noise and math.isfinite(power):
        samples = samples + math.sqrt(power) * _normal(random, samples.shape)
    return samples


# ---- coherent paths ------------------------------------------------------------------------------


class _Link(NamedTuple):
    """Coherent paths between an emitter and a receiver or element."""

    amplitudes: Complexes
    """(path, sample) in sqrt(W)."""
    rates: Floats
    """Growth (path,) of the delays in s/s."""


def _coherent(
    scene: Any, radar: _Radar, options: ReceiveOptions, speeds: Velocities
) -> tuple[list[list[list[_Link]]], list[str]]:
    """Return the links of each receiver of the scene, element and emitter, and notes."""
    wave = radar.waveform
    chains, echoes, notes = routes_in(
        scene, radar.emitters[0].scene_unit, options.reflections, options.bodies
    )
    routes: list[Route] = [*chains, *echoes]
    shortest = SPEED_OF_LIGHT / float(wave.frequencies.max())

    def link(emitter: PlacedSource, receiver: PlacedSource) -> _Link:
        paths, of_link = paths_between(
            scene, emitter, receiver, routes, options.polarisation, shortest
        )
        if any(receiver is parts[0] for parts in radar.receivers):  # not of each element
            notes.extend(of_link)
        h = amplitudes_of(paths, wave.frequencies, options.tolerance)
        rates = [_rate_of(path.route, emitter, receiver, speeds) for path in paths]
        return _Link(math.sqrt(emitter.power) * h.T, np.array(rates) / SPEED_OF_LIGHT)

    with hide_emitters(scene), with_progress("links", radar.receivers) as receivers:
        links = [[[link(e, r) for e in radar.emitters] for r in parts] for parts in receivers]
    return links, list(dict.fromkeys(notes))


def _rate_of(
    route: Route, emitter: PlacedSource, receiver: PlacedSource, speeds: Velocities
) -> float:
    """Return the growth of a path's length in m/s."""
    still = np.zeros(3)
    sent, taken = (speeds.get(_owner(end.name), still) for end in (emitter, receiver))
    if not isinstance(route, Echo):
        image, velocity = _moving_image(emitter, sent, route, speeds)
        return _closing(image, velocity, receiver.centre, taken)
    centre = route.body.facets.centre
    motion = speeds.get(route.body.name, still)
    legs = ((emitter, sent, route.before), (receiver, taken, route.after[::-1]))
    return sum(
        _closing(*_moving_image(end, speed, chain, speeds), centre, motion)
        for end, speed, chain in legs
    )


def _owner(name: str) -> str:
    """Return the id of the receiver to which an element such as "rx[3]" belongs."""
    return name.partition("[")[0] if name.endswith("]") else name


def _moving_image(
    end: PlacedSource, velocity: Floats, chain: Chain, speeds: Velocities
) -> tuple[Floats, Floats]:
    """Return the centre of the image of an end in mirrors, and its velocity in m/s."""
    for mirror in chain:
        moved = speeds.get(mirror.name, np.zeros(3))
        velocity = velocity - 2 * ((velocity - moved) @ mirror.normal) * mirror.normal
    return end.image(chain).centre, velocity


def _closing(one: Floats, its_velocity: Floats, other: Floats, velocity: Floats) -> float:
    """Return the growth in m/s of the distance between two moving points."""
    away = one - other
    return float(away @ (its_velocity - velocity) / np.linalg.norm(away))


# ---- scattered fields ----------------------------------------------------------------------------


def _cloud(
    scene: Any,
    radar: _Radar,
    number: int,
    size: int,
    rays: int | None,
    speeds: Velocities,
    options: ReceiveOptions,
) -> _Cloud | None:
    """Return the scatterers that one receiver of the scene sees; None if there are none."""
    receivers = radar.receivers[number]
    others = {_owner(each[0].name) for each in radar.receivers if each is not receivers}
    outside = others | {body.name for body in options.bodies}
    moving = {name: speed for name, speed in speeds.items() if name not in outside}
    cloud = scatterers(
        scene, size, seed=options.seed, velocities=moving, receiver=number, rays=rays
    )
    if not cloud.sizes["scatterer"]:
        return None
    responses, excess = _receiving(cloud, receivers)
    sent, lengths = _sending(scene, cloud, radar.emitters)
    near = np.isfinite(lengths).all(axis=0)
    return _Cloud(
        responses[:, near], sent[:, near], lengths[:, near] / SPEED_OF_LIGHT,
        cloud["path_rate"].values[near] / SPEED_OF_LIGHT, excess[:, near] / SPEED_OF_LIGHT,
    )  # fmt: skip


def _receiving(cloud: xarray.Dataset, receivers: list[PlacedSource]) -> tuple[Complexes, Floats]:
    """Return roots of power over intensity, and excess lengths in m, (receiver, scatterer).

    Without elements the first is the root of the cloud's power over intensity.
    """
    power, intensity = cloud["power"].values, cloud["intensity"].values
    if min(power.min(), intensity.min()) < 0:
        raise SceneError(
            "scatterers with negative power have no amplitude; set the estimator of the receiver "
            'and of the emitters to "exact"'
        )
    if len(receivers) == 1:
        ratio = np.divide(power, intensity, out=np.zeros_like(power), where=intensity > 0)
        return np.sqrt(ratio)[None].astype(np.complex128), np.zeros((1, len(power)))
    position = cloud["position"].values
    lengths = np.array([np.linalg.norm(position - each.centre, axis=1) for each in receivers])
    return end_responses(cloud, receivers), lengths - lengths.mean(axis=0)


def _sending(
    scene: Any, cloud: xarray.Dataset, emitters: list[PlacedSource]
) -> tuple[Complexes, Floats]:
    """Return roots of intensities and path lengths in m, (emitter, scatterer).

    Several emitters share the scatterers of single reflections, so that their signals are
    coherent: with the irradiances E_j of the emitters at a scatterer that was sampled for any of
    them, the intensity for emitter j is I E_j / sum_i E_i, whose sum over scatterers is unbiased.
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
        away = emitter.centre - position
        distance = np.linalg.norm(away, axis=1)
        incidence = np.maximum(np.sum(away * normal, axis=1) / distance, 0.0)
        visible = _in_view(scene, emitter, position, away)
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


def _in_view(scene: Any, emitter: PlacedSource, position: Floats, away: Floats) -> NDArray[Any]:
    """Return whether points (n, 3) in m see the centre of an emitter."""
    unit = emitter.scene_unit
    steps = (away * (1 - 2 * _CLOSE) / unit).astype(np.float32)
    start = ((position + _CLOSE * away) / unit).astype(np.float32)
    ray = mi.Ray3f(mi.Point3f(start.T), mi.Vector3f(steps.T))
    ray.maxt = 1.0
    return ~np.atleast_1d(np.array(scene.ray_test(ray)))


def _scattered(radar: _Radar, cloud: _Cloud, speckle: Complexes, emitter: int) -> Complexes:
    """Return the sum (RC1) over scatterers, (element, chirp, sample) or (element, 1, sample)."""
    signals = cloud.responses * (speckle * cloud.sent[emitter])
    starts = radar.chirp_times[emitter, :-1]
    is_moving = cloud.rates != 0
    still = _frame(radar, cloud, signals, emitter, ~is_moving, starts[:1])
    if not is_moving.any():
        return still
    migration = np.abs(cloud.rates).max() * radar.waveform.bandwidth * np.ptp(starts)
    blocks = min(len(starts), math.ceil(migration / _MOST_CYCLES))
    moving = [
        _frame(radar, cloud, signals, emitter, is_moving, block)
        for block in np.array_split(starts, max(blocks, 1))
    ]
    return still + np.concatenate(moving, axis=1)


def _frame(
    radar: _Radar,
    cloud: _Cloud,
    signals: Complexes,
    emitter: int,
    chosen: NDArray[np.bool_],
    starts: Floats,
) -> Complexes:
    """Return the sum (RC1) over some scatterers in successive repetitions.

    With the numbers m and n of repetition and sample counted from the middle of the frame, the
    phase of a scatterer of the delay D in the middle is a constant plus linear terms, which a
    non-uniform FFT sums, plus two small products, which :func:`_series` separates:

    - with its rate r, r n df (m T + n dt), the motion through range bins
    - with the excess delay d of an element, (f_n - f_0) d, because the response of the element has
      the phase at the frequency f_0 of the scene
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
    for terms, factor in _series(cloud.excess[:, chosen], offsets, _OF_SUMS):
        tolerance = _OF_SUMS / np.abs(terms).max(initial=1e-300) / np.abs(factor).max()
        for growths, by_sample in _series(rates, motion, tolerance):
            sums = _summed_waves(slopes, waves * terms * growths, shape)
            result += sums.reshape(result.shape) * (factor * by_sample)
    return result


def _summed_waves(slopes: list[Floats], terms: Complexes, shape: list[int]) -> Complexes:
    """Return sums (element, ...) over points of terms times exp(2 pi i (slopes . numbers)).

    The numbers count from ``-size // 2`` along each axis of ``shape``.
    """
    finufft = require("finufft", "radar", "scattered fields are summed with")
    transform = finufft.nufft1d1 if len(shape) == 1 else finufft.nufft2d1
    angles = [2 * np.pi * (slope - np.round(slope)) for slope in slopes]
    rows = np.ascontiguousarray(terms)
    return np.asarray(transform(*angles, rows, tuple(shape), isign=1, nthreads=1, eps=_OF_SUMS))


def _series(amounts: Floats, along: Floats, tolerance: float) -> Iterator[tuple[Complexes, Floats]]:
    """Yield arrays whose products sum to exp(2 pi i amounts along), a power series."""
    reach = float(np.abs(along).max()) or 1.0
    phases = 2j * np.pi * amounts * reach
    largest = float(np.abs(phases).max(initial=0.0))
    terms, factor = np.ones_like(phases), np.ones_like(along)
    size, power = 1.0, 0
    while size > tolerance:
        yield terms, factor
        power += 1
        terms, factor = terms * phases, factor * (along / reach / power)
        size *= largest / power


def _normal(random: np.random.Generator, shape: tuple[int, ...]) -> Complexes:
    """Return independent circular Gaussian numbers of variance 1."""
    pairs = random.standard_normal((*shape, 2)) * math.sqrt(0.5)
    return np.asarray(pairs.view(np.complex128)[..., 0])


def _dataset(signal: Any, radar: _Radar, about: dict[str, Any]) -> xarray.Dataset:
    ends = {"receiver": [end for each in radar.receivers for end in each]}
    ends["emitter"] = radar.emitters
    noise = np.repeat(radar.noise_power, [len(each) for each in radar.receivers])
    values: dict[str, tuple[Any, tuple[str, ...], str, str]] = {
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
    return dataset.assign(signal=labelled_array(signal, CUBE_DIMS, about_signal))
