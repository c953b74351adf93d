"""The power that receivers get from a scene: exact links, and scattered light by samples."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from itertools import count
from typing import Any, NamedTuple

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from polywigner.errors import ArgumentError, SceneError
from polywigner.execution.progress import slow_bar
from polywigner.geometry.arguments import checked_callable
from polywigner.mitsuba.plugins.diffraction import scene_known
from polywigner.mitsuba.plugins.films import mean_of_colours, seed_of, silent
from polywigner.mitsuba.plugins.placement import (
    PlacedSource,
    check_match,
    placed_emitter,
    placed_receiver,
)
from polywigner.mitsuba.plugins.polariser import polarisation_summary
from polywigner.mitsuba.plugins.receiver import film_of, receiver_class
from polywigner.mitsuba.plugins.registration import one_at_a_time
from polywigner.mitsuba.plugins.source_parameters import RECEIVER
from polywigner.mitsuba.radar.range_film import is_transient
from polywigner.mitsuba.receive.channels import amplitudes_of, paths_between
from polywigner.mitsuba.receive.direct_light import DirectLight, direct_light, light_of_points
from polywigner.mitsuba.receive.ray_transmission import point_batches
from polywigner.mitsuba.receive.received import (
    OTHER_LIGHTS,
    Contribution,
    DirectPath,
    ReceivedPower,
    ReceiveOptions,
)
from polywigner.mitsuba.receive.scattered import (
    BATCHES,
    Scattering,
    aimed,
    batches_of,
    lights_of,
    shares_of,
    standard_error,
)
from polywigner.mitsuba.receive.scattering_steps import number_of
from polywigner.mitsuba.scenes.reflectors import Echo, Way, names_of, ways_in
from polywigner.mitsuba.scenes.rendering import (
    default_integrator,
    default_spp,
    exposed,
    polarised_by_default,
    unseen,
)
from polywigner.mitsuba.scenes.surfaces import receivers_of, sorted_shapes, wigner_emitters
from polywigner.quantities import SPEED_OF_LIGHT

_NO_RADIANCE = ("AOVIntegrator", "DepthIntegrator", "MomentIntegrator", "ParticleTracerIntegrator")

Progress = Callable[[int, int], None]
Floats = NDArray[np.float64]
Sampled = Callable[[list[Scattering]], Floats]
"""Power in W (receivers, batches, lights, ...) of the batches of each receiver."""


@one_at_a_time
def received_power(
    scene: Any,
    spp: int | None = None,
    seed: int = 0,
    *,
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
) -> ReceivedPower:
    """The power that a receiver of a scene gets, in W, with its standard error.

    The sum of direct light of each emitter, straight and by flat mirrors, exact by
    :func:`polywigner.coupling` in the poses of both or of images, times the share of rays that pass
    obstacles; and of what surfaces and fog scatter, by samples of the ``wigner_receiver`` sensor.
    Powers add without interference, unless ``coherent`` is true. docs/received_power.md.

    Parameters
    ----------
    scene : a ``mi.Scene`` with a ``wigner_receiver`` sensor and lights.
    spp : samples of the scattered part, in 16 batches, for each emitter; rounded up to a multiple
        of 16. Default: the sensor's own.
    seed : of the random numbers, zero or more. What is direct has none.
    receiver : id of the sensor, or its number among the sorted ids of receivers, from 0; None: the
        only one.
    integrator : of the scattered part, as in :func:`polywigner.mitsuba.render`.
    reflections : most flat mirrors on a direct way, 0 to 3.
    tolerance : of couplings, as in :func:`polywigner.coupling`.
    bandwidth, temperature, noise_figure : of the noise k T B F, in Hz, K and dB or as texts such
        as "1 GHz", in place of the receiver's own; without a noise figure, F is 1. The
        bandwidth also says which emitters the receiver takes.
    coherent : True: the direct ways of one emitter add as amplitudes, with fringes, as in
        :func:`polywigner.mitsuba.channel`; what is scattered, and several emitters, add as powers.
    polarisation : with ``coherent``: of ends for which the scene specifies none, default "y", as
        there; in polarised variants for scattered power as well.
    bodies : with ``coherent``: perfect conductors beside the scene by their names, as there.
    progress : called after each render with the number of those done, and of all.

    Returns
    -------
    ReceivedPower: ``float()`` or ``.power`` in W, ``.standard_error``, ``.dbm``, ``.direct``,
    ``.scattered``, ``.contributions`` of each emitter, ``.noise_power``, ``.snr``, ``.notes``.

    Raises
    ------
    SceneError : no receiver, no light; an emitter of another wavelength, obliquity or scene unit;
        links or chains of mirrors that are too much work; what :func:`polywigner.mitsuba.render`
        refuses. ArgumentError : no scene, several receivers and none named, other arguments out of
        range; QuantityError : a quantity that is none.
    """
    noise = bandwidth, temperature, noise_figure
    waves = coherent, polarisation, bodies
    options = ReceiveOptions(spp, seed, integrator, reflections, tolerance, *noise, *waves)
    number = chosen(receivers_of(scene), receiver)
    return received(scene, [number], options, partial(scattered_here, scene, progress)).powers[0]


@one_at_a_time
def received_powers(
    scene: Any,
    spp: int | None = None,
    seed: int = 0,
    *,
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
) -> list[ReceivedPower]:
    """Return the power of each receiver of a scene, sorted by id: :func:`received_power`."""
    noise = bandwidth, temperature, noise_figure
    waves = coherent, polarisation, bodies
    options = ReceiveOptions(spp, seed, integrator, reflections, tolerance, *noise, *waves)
    numbers = list(range(len(receivers_of(scene))))
    return received(scene, numbers, options, partial(scattered_here, scene, progress)).powers


def chosen(found: list[tuple[int, Any]], receiver: int | str | None) -> int:
    """The number of a receiver among receivers."""
    names = [sensor.id() for _, sensor in found]
    if receiver is None and len(found) == 1:
        return 0
    if isinstance(receiver, str) and names.count(receiver) == 1:
        return names.index(receiver)
    is_number = isinstance(receiver, int) and not isinstance(receiver, bool)
    if is_number and 0 <= receiver < len(found):  # type: ignore[operator]
        return int(receiver)  # type: ignore[arg-type]
    listed = ", ".join(f"{number} ({name!r})" for number, name in enumerate(names))
    raise ArgumentError(
        f"expected receiver as one of {listed}, got {receiver!r}; name one, or take all with "
        "received_powers"
    )


class Parties(NamedTuple):
    """Receivers of a scene and the coherent sources that they receive."""

    sensors: list[int]
    """Numbers of the receivers among the scene's sensors."""
    places: list[PlacedSource]
    noises: list[dict[str, Any]]
    """Bandwidth, temperature and noise figure of each receiver."""
    emitters: list[PlacedSource]


class Received(NamedTuple):
    """The power at receivers, and what it is made of."""

    powers: list[ReceivedPower]
    parties: Parties
    batches: Floats
    """W (receivers, batches, lights, values)."""


def received(
    scene: Any,
    numbers: list[int],
    options: ReceiveOptions,
    sample: Sampled,
    edges: Floats | None = None,
) -> Received:
    """The power at receivers by their numbers; see :func:`received_power`.

    ``edges``: of bins of range in m, by which the scattered light is sampled; None: all in one.
    """
    with polarised_by_default(scene, options.polarisation), unseen(scene), aimed(scene):
        parties = matched(scene, numbers, options)
        plans = [
            _scattering(scene, index, options, place.scene_unit, edges)
            for index, place in zip(parties.sensors, parties.places, strict=True)
        ]
        direct = [
            _direct(scene, *each, parties.emitters, options)
            for each in zip(parties.sensors, parties.places, strict=True)
        ]
        batches = np.asarray(sample(plans), np.float64)
        batches = batches.reshape(*batches.shape[:3], -1)
        each = zip(parties.places, parties.noises, direct, plans, batches.sum(axis=-1), strict=True)
        powers = [_result(scene, parties.emitters, options, *one) for one in each]
    return Received(powers, parties, batches)


def matched(scene: Any, numbers: list[int], options: ReceiveOptions) -> Parties:
    """Receivers by their numbers, and the sources; SceneError for pairs that do not match."""
    if not scene.emitters():
        raise SceneError("expected a scene with light, got one without emitters; add one")
    receivers = [receivers_of(scene)[number] for number in numbers]
    emitters = [placed_emitter(e, k).touching(scene) for k, e in enumerate(wigner_emitters(scene))]
    places = [
        placed_receiver(s, n).touching(scene) for n, (_, s) in zip(numbers, receivers, strict=True)
    ]
    noises = [options.noise_of(sensor.spec) for _, sensor in receivers]
    for place, noise in zip(places, noises, strict=True):
        for emitter in emitters:
            check_match(emitter, place, noise["bandwidth"])
    return Parties([index for index, _ in receivers], places, noises, emitters)


def _scattering(
    scene: Any, sensor: int, options: ReceiveOptions, unit: float, edges: Floats | None
) -> Scattering:
    """Sampling of the light that is scattered to a sensor, by its number."""
    name = exposed(scene, options.integrator, 1, 0, sensor, warn=False).integrator.class_name()
    if name in _NO_RADIANCE:
        raise SceneError(
            f"expected an integrator that finds the radiance along rays from the receiver, got "
            f'{name}; use "path" or, with fog, "volpath"'
        )
    spp = default_spp(scene, sensor) if options.spp is None else options.spp
    lengths = None if edges is None else tuple((2.0 * edges / unit).tolist())
    return Scattering(sensor, options.integrator, spp, options.seed, lengths)


def scattered_here(
    scene: Any, progress: Progress | None, plans: Sequence[Scattering]
) -> NDArray[np.float64]:
    """Power in W (receivers, batches, lights, ...) of all batches, one after the other."""
    done, total = count(1), len(plans) * BATCHES * len(lights_of(scene))
    checked_callable(progress, "progress")
    with slow_bar("renders", total) as advance:

        def tell() -> None:
            if progress is None:
                advance()
            else:
                progress(next(done), total)

        return np.array([[p.batch(scene, k, tell) for k in range(BATCHES)] for p in plans])


def _direct(
    scene: Any,
    sensor: int,
    receiver: PlacedSource,
    emitters: list[PlacedSource],
    options: ReceiveOptions,
) -> tuple[list[DirectLight], list[str]]:
    """Direct light of each emitter, then of other lights, and notes. Sources are hidden."""
    chains, echoes, notes = ways_in(scene, receiver.scene_unit, options.reflections, options.bodies)
    links = []
    for emitter in emitters:
        ends = scene, emitter, receiver
        if options.coherent:
            ways: list[Way] = [*chains, *echoes]
            links.append(_coherent_light(*ends, ways, options.tolerance, options.polarisation))
        else:
            links.append(direct_light(*ends, chains, options.tolerance))
    method = exposed(scene, options.integrator, 1, 0, sensor, warn=False).integrator
    hides_lights = method.hide_emitters
    links.append(DirectLight() if hides_lights else light_of_points(scene, receiver, chains))
    return links, [note for link in links for note in link.notes] + notes


def _coherent_light(
    scene: Any,
    emitter: PlacedSource,
    receiver: PlacedSource,
    ways: list[Way],
    tolerance: float,
    polarisation: Any = None,
) -> DirectLight:
    """Direct light of an emitter whose ways interfere, in a scene whose sources are unseen."""
    wavelength = emitter.wavelength
    paths, notes = paths_between(scene, emitter, receiver, ways, polarisation, wavelength)
    frequency = np.array([SPEED_OF_LIGHT / wavelength])
    found = []
    for path, amplitude in zip(paths, amplitudes_of(paths, frequency, tolerance)[0], strict=True):
        passing = path.passing * (1.0 if path.edges is None else abs(path.edges(wavelength)))
        way = path.way
        place = way.place if isinstance(way, Echo) else emitter.image(way).middle
        found.append(
            DirectPath(
                names_of(path.way),
                emitter.power * abs(amplitude) ** 2,
                (abs(amplitude) / passing) ** 2 if passing else 0.0,
                passing**2,
                receiver.cosines_to(place),
                amplitude=complex(amplitude),
                length=path.distance,
            )
        )
    power = emitter.power * abs(sum(path.amplitude or 0.0 for path in found)) ** 2
    return DirectLight(tuple(found), tuple(notes), power)


def _result(
    scene: Any,
    emitters: list[PlacedSource],
    options: ReceiveOptions,
    receiver: PlacedSource,
    noise: dict[str, Any],
    direct: tuple[list[DirectLight], list[str]],
    plan: Scattering,
    found: Floats,
) -> ReceivedPower:
    links, notes = direct
    of_sources, others = shares_of(scene, found)
    parts = [
        _contribution(emitter.name, batches, link)
        for emitter, batches, link in zip(emitters, of_sources, links[:-1], strict=True)
    ]
    if len(lights_of(scene)) > len(emitters):
        parts.append(_contribution(OTHER_LIGHTS, others, links[-1]))
    ends = [*emitters, receiver]
    return ReceivedPower(
        receiver=receiver.name,
        wavelength=receiver.wavelength,
        contributions=tuple(parts),
        standard_error=float(standard_error(others + of_sources.sum(axis=0))),
        samples=BATCHES * batches_of(plan.spp),
        seed=plan.seed,
        notes=tuple(dict.fromkeys(notes)),
        polarisation=polarisation_summary(ends, options.coherent, options.polarisation),
        **noise,
    )


def _contribution(name: str, batches: Any, link: DirectLight) -> Contribution:
    return Contribution(
        name=name,
        direct=link.power,
        scattered=float(batches.mean()),
        standard_error=float(standard_error(batches)),
        paths=link.paths,
    )


# Pixels on a side, and samples of each: some seconds at most, in scalar variants too.
_FINE, _COARSE = (64, 64), (24, 4)


def arrival_map(scene: Any, receiver: int, seed: int = 0) -> NDArray[np.float64]:
    """W (n, n) that surfaces, fog and incoherent lights send from each direction."""
    _, own = receivers_of(scene)[receiver]
    size, spp = _FINE if dr.is_jit_v(mi.Float) else _COARSE
    props = mi.Properties(RECEIVER)
    props.set_id(own.id())
    props["film"] = mi.load_dict(film_of(size, size))
    sensor = receiver_class(mi.variant())(own.spec, props)
    sensor.scene = scene
    try:
        with scene_known(scene), unseen(scene), silent():
            integrator = scene.integrator()
            if integrator is None or is_transient(integrator):
                integrator = mi.load_dict({"type": default_integrator(scene)})
            own = seed_of(seed)
            found = mi.render(scene, sensor=sensor, integrator=integrator, spp=spp, seed=own)
            image = np.array(found, dtype=np.float64)
    finally:
        sensor.scene = None  # or it would keep the scene alive
    return mean_of_colours(image)


# Shapes named in a picture, and the least share of its power that each sends.
_MOST_NAMED, _LEAST_NAMED = 5, 0.01


def shapes_in(
    scene: Any, receiver: int, picture: NDArray[np.float64]
) -> dict[str, tuple[float, float]]:
    """Direction cosines of the middle of each shape that sends much of :func:`arrival_map`."""
    own = receivers_of(scene)[receiver][1]
    place = placed_receiver(own, receiver)
    axis = (np.arange(len(picture)) + 0.5) * 2 / len(picture) - 1
    x, y = (part.ravel() for part in np.meshgrid(axis, axis))
    power = np.where(x * x + y * y < 1, picture.ravel(), 0.0).clip(min=0)
    lit = np.flatnonzero(power)
    if not len(lit):  # Dr.Jit ends the process for arrays without elements
        return {}
    x, y, power = x[lit], y[lit], power[lit]
    ways = place.pose[:3, :3] @ [x, y, np.sqrt(1 - x * x - y * y)]
    with unseen(scene):
        numbers = _first_shapes(scene, place.pose[:3, 3] / place.scene_unit, ways)
    found = []
    for shape in sorted_shapes(scene):
        shares = np.where(numbers == np.ravel(number_of("Shape", shape))[0], power, 0.0)
        sent = shares.sum()
        if shape.id() and sent > _LEAST_NAMED * power.sum():
            found.append((sent, shape.id(), (shares @ x / sent, shares @ y / sent)))
    return {name: at for _, name, at in sorted(found, reverse=True)[:_MOST_NAMED]}


def _first_shapes(scene: Any, origin: Floats, ways: Floats) -> NDArray[np.uint32]:
    """Numbers (n,) of the shapes that rays of the directions (3, n) meet first."""
    start, numbers = mi.Point3f(*origin.tolist()), []
    for (way,) in point_batches(ways.T):
        hit = scene.ray_intersect_preliminary(mi.Ray3f(start, mi.Vector3f(way)))
        is_met = dr.is_jit_v(mi.Float) or hit.is_valid()
        numbers.append(np.ravel(np.array(number_of("Shape", hit.shape if is_met else None))))
    return np.concatenate(numbers)
