"""Power at the receivers of a scene, from exact direct light and sampled scattered light."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import product
from typing import Any, NamedTuple

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from polywigner.errors import ArgumentError, SceneError
from polywigner.execution.progress import slow_bar
from polywigner.mitsuba.plugins.diffraction import scene_known
from polywigner.mitsuba.plugins.films import log_only_to, mean_of_colours, seed_of
from polywigner.mitsuba.plugins.placement import (
    PlacedSource,
    check_match,
    placed_emitters,
    placed_receiver,
)
from polywigner.mitsuba.plugins.polariser import polarisation_summary
from polywigner.mitsuba.plugins.receiver import film_of, receiver_class
from polywigner.mitsuba.plugins.registration import one_at_a_time
from polywigner.mitsuba.plugins.source_parameters import RECEIVER
from polywigner.mitsuba.radar.range_film import is_transient
from polywigner.mitsuba.receive.channels import paths_between
from polywigner.mitsuba.receive.direct_light import DirectLight, delta_direct_light, direct_light
from polywigner.mitsuba.receive.power_results import (
    OTHER_LIGHTS,
    Contribution,
    DirectPath,
    ReceivedPower,
    ReceiveOptions,
)
from polywigner.mitsuba.receive.ray_transmission import point_batches
from polywigner.mitsuba.receive.scattered import (
    BATCHES,
    Scattering,
    aimed,
    batch_spp,
    by_source,
    lights_of,
    standard_error,
)
from polywigner.mitsuba.scenes.reflectors import Echo, Route, names_of, routes_in
from polywigner.mitsuba.scenes.rendering import (
    default_integrator,
    exposed,
    hide_emitters,
    polarised_by_default,
)
from polywigner.mitsuba.scenes.surfaces import (
    number_of,
    receivers_of,
    sorted_shapes,
)
from polywigner.numerics import Floats
from polywigner.quantities import SPEED_OF_LIGHT

_NO_RADIANCE = ("AOVIntegrator", "DepthIntegrator", "MomentIntegrator", "ParticleTracerIntegrator")

Progress = Callable[[int, int], None]
Sampled = Callable[[list[Scattering]], Floats]
"""Function that renders all batches of scattered light.

It returns powers in W, shape (receivers, batches, lights, ...).
"""


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
    """Return the power at a receiver of a scene in W, with its standard error.

    The power is the sum of direct and scattered light (docs/received_power.md). Direct light
    reaches the receiver along the line of sight and via flat mirrors. Direct light is computed
    exactly as the :func:`polywigner.coupling` of the receiver with the emitter or its mirror
    images, and multiplied by the fraction of rays that pass obstacles. Light scattered by surfaces
    and fog is sampled by the ``wigner_receiver`` sensor. Powers are added without interference,
    unless ``coherent`` is true.

    Parameters
    ----------
    scene : mi.Scene
        Scene with a ``wigner_receiver`` sensor and lights.
    spp : int, optional
        Number of samples of scattered light for each emitter. The number is rounded up to a
        multiple of 16, because the samples are divided into 16 batches. Default: the value of the
        sensor.
    seed : int, default 0
        Seed of the random numbers, zero or more. Direct light does not depend on the seed.
    receiver : int or str, optional
        Id of the receiver, or its index in the sorted list of receiver ids. Required if the scene
        has several receivers.
    integrator : str or mi.Integrator, optional
        Integrator of scattered light, as in :func:`polywigner.mitsuba.render`.
    reflections : int, default 2
        Maximum number of specular reflections per path, 0 to 3.
    tolerance : float, default 1e-6
        Tolerance of couplings, as in :func:`polywigner.coupling`.
    bandwidth, temperature, noise_figure : float or str, optional
        Bandwidth B in Hz, temperature T in K and noise figure F in dB of the noise power k T B F,
        or strings such as "1 GHz". These arguments replace the parameters of the receiver. Without
        a noise figure, F is 1. The bandwidth also determines which emitters are received.
    coherent : bool, default False
        Whether the direct paths of an emitter interfere, so that their amplitudes are added as in
        :func:`polywigner.mitsuba.channel`. Scattered light and light of different emitters do not
        interfere.
    polarisation : str or array_like, optional
        Polarisation of emitters and receivers whose polarisation is not specified in the scene, as
        in :func:`polywigner.mitsuba.channel`. Requires ``coherent``. Default: "y". In polarised
        variants it also applies to scattered power.
    bodies : mapping, optional
        Perfect conductors by name, in addition to the shapes of the scene, as in
        :func:`polywigner.mitsuba.channel`. Requires ``coherent``.
    progress : callable, optional
        Function that is called after each render with the number of finished renders and the total
        number of renders.

    Returns
    -------
    ReceivedPower
        Received power. ``float()`` and the attribute ``power`` return it in W. Further attributes
        are ``standard_error``, ``dbm``, ``direct``, ``scattered``, ``contributions`` of each
        emitter, ``noise_power``, ``snr`` and ``notes``.

    Raises
    ------
    SceneError
        If the scene has no receiver or no light, if an emitter differs in wavelength, obliquity or
        scene unit, if there are too many paths, or as for :func:`polywigner.mitsuba.render`.
    ArgumentError
        If ``scene`` is not a scene, if there are several receivers and none is chosen, or if an
        argument is out of range.
    QuantityError
        If a string is not a quantity.
    """
    noise = bandwidth, temperature, noise_figure
    waves = coherent, polarisation, bodies
    options = ReceiveOptions(spp, seed, integrator, reflections, tolerance, *noise, *waves)
    number = index_of(receivers_of(scene), receiver)
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
    """Return the power at each receiver of a scene, sorted by id; see :func:`received_power`."""
    noise = bandwidth, temperature, noise_figure
    waves = coherent, polarisation, bodies
    options = ReceiveOptions(spp, seed, integrator, reflections, tolerance, *noise, *waves)
    numbers = list(range(len(receivers_of(scene))))
    return received(scene, numbers, options, partial(scattered_here, scene, progress)).powers


def index_of(receivers: list[tuple[int, Any]], receiver: int | str | None) -> int:
    """Return the index of ``receiver`` (an id, an index, or None for the only receiver)."""
    names = [sensor.id() for _, sensor in receivers]
    if receiver is None and len(receivers) == 1:
        return 0
    if isinstance(receiver, str) and names.count(receiver) == 1:
        return names.index(receiver)
    if type(receiver) is int and 0 <= receiver < len(receivers):  # True and False are errors.
        return receiver
    listed = ", ".join(f"{number} ({name!r})" for number, name in enumerate(names))
    raise ArgumentError(
        f"expected receiver to be one of {listed}, got {receiver!r}; specify one of them, or call "
        "received_powers for all receivers"
    )


class Received(NamedTuple):
    """Received powers, with the batches of scattered light."""

    powers: list[ReceivedPower]
    receivers: list[PlacedSource]
    batches: Floats
    """Scattered power in W, shape (receivers, batches, lights, bins or 1)."""


def received(
    scene: Any,
    numbers: list[int],
    options: ReceiveOptions,
    sample: Sampled,
    edges: Floats | None = None,
) -> Received:
    """Return the power at the receivers with the indices ``numbers`` in ``receivers_of(scene)``.

    ``sample`` renders the scattered light, and ``edges`` are the ranges in m that divide it into
    bins.
    """
    with polarised_by_default(scene, options.polarisation), hide_emitters(scene), aimed(scene):
        emitters, receivers = matched_ends(scene, numbers, options)
        sensors = [receivers_of(scene)[number][0] for number in numbers]
        ends = list(zip(sensors, receivers, strict=True))
        plans = [_scattering_settings(scene, k, options, end.scene_unit, edges) for k, end in ends]
        # Errors in direct light are raised before slow renders start.
        direct = [_direct_lights(scene, *end, emitters, options) for end in ends]
        batches = np.asarray(sample(plans), np.float64)
        batches = batches.reshape(*batches.shape[:3], -1)
        rows = zip(receivers, direct, plans, batches.sum(axis=-1), strict=True)
        powers = [_result(scene, emitters, options, *row) for row in rows]
    return Received(powers, receivers, batches)


def matched_ends(
    scene: Any, numbers: list[int], options: ReceiveOptions
) -> tuple[list[PlacedSource], list[PlacedSource]]:
    """Return the sources of a scene, and the receivers at ``numbers`` in ``receivers_of(scene)``.

    Raises SceneError if there is no emitter, or if frequencies or units of the scene differ.
    """
    if not scene.emitters():
        raise SceneError("the scene has no emitters; add an emitter")
    emitters, receivers = placed_emitters(scene), []
    for number in numbers:
        receiver = placed_receiver(scene, receivers_of(scene)[number][1], number)
        receivers.append(replace(receiver, noise=options.noise_of(receiver)))
    for receiver, emitter in product(receivers, emitters):
        check_match(emitter, receiver)
    return emitters, receivers


def _scattering_settings(
    scene: Any, sensor: int, options: ReceiveOptions, unit: float, edges: Floats | None
) -> Scattering:
    """Return the settings for sampling the light scattered to the sensor with the index ``sensor``.

    ``unit`` is the length of a scene unit in m, and ``edges`` are edges of range bins in m. Raises
    SceneError for integrators that compute no radiance.
    """
    exposure = exposed(scene, options.integrator, options.spp, 0, sensor, warn=False)
    name = exposure.integrator.class_name()
    if name in _NO_RADIANCE:
        raise SceneError(
            "scattered light requires an integrator that computes the radiance along rays from "
            f'the receiver, got {name}; use "path" or, with fog, "volpath"'
        )
    lengths = None if edges is None else tuple((2.0 * edges / unit).tolist())
    return Scattering(sensor, options.integrator, exposure.cut.samples, options.seed, lengths)


def scattered_here(
    scene: Any, progress: Progress | None, plans: Sequence[Scattering]
) -> NDArray[np.float64]:
    """Render all batches in this process, and report progress.

    Return powers in W, shape (receivers, batches, lights, ...).
    """
    total = len(plans) * BATCHES * len(lights_of(scene))
    with slow_bar("renders", total, progress) as advance:
        return np.array([[p.batch(scene, k, advance) for k in range(BATCHES)] for p in plans])


def _direct_lights(
    scene: Any,
    sensor: int,
    receiver: PlacedSource,
    emitters: list[PlacedSource],
    options: ReceiveOptions,
) -> list[DirectLight]:
    """Return the direct light of each emitter, followed by the direct light of all delta lights.

    The sources of the scene must be hidden.
    """
    routes, notes = routes_in(scene, receiver.scene_unit, options.reflections, options.bodies)
    chains = [route for route in routes if not isinstance(route, Echo)]
    links = [
        _interfering_light(scene, emitter, receiver, routes, options)
        if options.coherent
        else direct_light(scene, emitter, receiver, chains, options.tolerance)
        for emitter in emitters
    ]
    method = exposed(scene, options.integrator, 1, 0, sensor, warn=False).integrator
    others = DirectLight() if method.hide_emitters else delta_direct_light(scene, receiver, chains)
    return [*links, replace(others, notes=(*others.notes, *notes))]


def _interfering_light(
    scene: Any,
    emitter: PlacedSource,
    receiver: PlacedSource,
    routes: list[Route],
    options: ReceiveOptions,
) -> DirectLight:
    """Return the direct light of an emitter with interfering paths; sources must be hidden."""
    wavelength = emitter.wavelength
    frequency = np.array([SPEED_OF_LIGHT / wavelength])
    paths, (amplitudes,), notes = paths_between(
        scene, emitter, receiver, routes, options, frequency
    )
    direct = []
    for path, amplitude in zip(paths, amplitudes, strict=True):
        transmission = abs(path.transmission_at(wavelength))
        route = path.route
        origin = route.position if isinstance(route, Echo) else emitter.image(route).centre
        direct.append(
            DirectPath(
                names_of(route),
                emitter.power * abs(amplitude) ** 2,
                (abs(amplitude) / transmission) ** 2 if transmission else 0.0,
                transmission**2,
                receiver.cosines_to(origin),
                amplitude=complex(amplitude),
                length=path.distance,
            )
        )
    power = emitter.power * abs(amplitudes.sum()) ** 2
    return DirectLight(tuple(direct), tuple(notes), power)


def _result(
    scene: Any,
    emitters: list[PlacedSource],
    options: ReceiveOptions,
    receiver: PlacedSource,
    direct: list[DirectLight],
    plan: Scattering,
    scattered: Floats,
) -> ReceivedPower:
    """Return the received power of a receiver; ``scattered`` has the shape (batches, lights)."""
    of_sources, others = by_source(scene, scattered)
    rows = [*zip([emitter.name for emitter in emitters], of_sources, direct[:-1], strict=True)]
    if len(lights_of(scene)) > len(emitters):
        rows.append((OTHER_LIGHTS, others, direct[-1]))
    return ReceivedPower(
        receiver=receiver.name,
        wavelength=receiver.wavelength,
        contributions=tuple(
            Contribution(
                name, link.power, float(part.mean()), float(standard_error(part)), link.paths
            )
            for name, part, link in rows
        ),
        standard_error=float(standard_error(others + of_sources.sum(axis=0))),
        samples=BATCHES * batch_spp(plan.spp),
        seed=plan.seed,
        notes=tuple(dict.fromkeys(note for link in direct for note in link.notes)),
        polarisation=polarisation_summary(
            [*emitters, receiver], options.coherent, options.polarisation
        ),
        **receiver.noise,
    )


# Number of pixels per side of an arrival map, and number of samples per pixel. _FINE is for
# compiled variants, and _COARSE is for scalar variants.
_FINE, _COARSE = (64, 64), (24, 4)


def arrival_map(scene: Any, receiver: int, seed: int = 0) -> NDArray[np.float64]:
    """Return a map (n, n) of scattered and incoherent power in W by direction of arrival.

    Rows and columns are evenly spaced from -1 to 1 in the direction cosines along the receiver's y
    and x axes. The directions point away from the receiver. ``receiver`` is an index in
    ``receivers_of(scene)``.
    """
    _, original = receivers_of(scene)[receiver]
    size, spp = _FINE if dr.is_jit_v(mi.Float) else _COARSE
    props = mi.Properties(RECEIVER)
    props.set_id(original.id())
    props["film"] = mi.load_dict(film_of(size, size))
    sensor = receiver_class(mi.variant())(original.spec, props)
    sensor.scene = scene
    try:
        with scene_known(scene), hide_emitters(scene), log_only_to():
            integrator = scene.integrator()
            if integrator is None or is_transient(integrator):
                integrator = mi.load_dict({"type": default_integrator(scene)})
            how = {"integrator": integrator, "spp": spp, "seed": seed_of(seed)}
            image = np.array(mi.render(scene, sensor=sensor, **how), dtype=np.float64)
    finally:
        sensor.scene = None  # Frees the scene.
    return mean_of_colours(image)


# Largest number of labels in an arrival map, and fraction of the total power above which a shape is
# labelled.
_MOST_NAMED, _LEAST_NAMED = 5, 0.01


def shapes_in(
    scene: Any, receiver: int, image: NDArray[np.float64]
) -> dict[str, tuple[float, float]]:
    """Return the mean direction cosines (x, y) of the strongest shapes, with shape ids as keys.

    The strongest shapes are those from which most power arrives. At most 5 shapes are returned.
    ``image`` is the map (n, n) that `arrival_map` returns for the same ``receiver``.
    """
    placed = placed_receiver(scene, receivers_of(scene)[receiver][1], receiver)
    axis = (np.arange(len(image)) + 0.5) * 2 / len(image) - 1
    x, y = (part.ravel() for part in np.meshgrid(axis, axis))
    power = np.where(x * x + y * y < 1, image.ravel(), 0.0).clip(min=0)
    bright = np.flatnonzero(power)
    if not len(bright):  # Empty arrays crash Dr.Jit.
        return {}
    x, y, power = x[bright], y[bright], power[bright]
    directions = placed.pose[:3, :3] @ [x, y, np.sqrt(1 - x * x - y * y)]
    with hide_emitters(scene):
        numbers = _first_shapes(scene, placed.pose[:3, 3] / placed.scene_unit, directions)
    labels = []
    for shape in sorted_shapes(scene):
        parts = np.where(numbers == np.ravel(number_of("Shape", shape))[0], power, 0.0)
        arrived = parts.sum()
        if shape.id() and arrived > _LEAST_NAMED * power.sum():
            labels.append((arrived, shape.id(), (parts @ x / arrived, parts @ y / arrived)))
    return {name: at for _, name, at in sorted(labels, reverse=True)[:_MOST_NAMED]}


def _first_shapes(scene: Any, origin: Floats, directions: Floats) -> NDArray[np.uint32]:
    """Return the registry number of the first shape in each of n ``directions`` (3, n), or zero."""
    start, numbers = mi.Point3f(*origin.tolist()), []
    for (direction,) in point_batches(directions.T):
        hit = scene.ray_intersect_preliminary(mi.Ray3f(start, mi.Vector3f(direction)))
        is_met = dr.is_jit_v(mi.Float) or hit.is_valid()
        numbers.append(np.ravel(np.array(number_of("Shape", hit.shape if is_met else None))))
    return np.concatenate(numbers)
