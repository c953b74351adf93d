"""Complex amplitudes and delays of paths between emitters and receivers.

The amplitude of a path is the product of three factors:

- the coupling b of the emitter's image with the receiver, (RX1) of docs/links.md
- the polarisation factor e_r . E of the reflected unit field E and the receiver's polarisation
  vector e_r
- the amplitude transmission of obstacles, which is an average over rays, or with diffraction, the
  ratio b/b_0 of the couplings with and without obstacles
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from itertools import product
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.polynomial import chebyshev
from numpy.typing import ArrayLike

from polywigner.errors import ArgumentError, SceneError
from polywigner.execution.progress import with_progress
from polywigner.geometry.arguments import checked_row
from polywigner.mitsuba.plugins.mixtures import norm_of
from polywigner.mitsuba.plugins.placement import (
    FacingParts,
    PlacedSource,
    check_obliquity,
    check_unit,
    facing_parts,
    placed_emitters,
    placed_receiver,
)
from polywigner.mitsuba.plugins.polariser import DEFAULT_POLARISATION, polarisation_summary
from polywigner.mitsuba.plugins.registration import one_at_a_time, scene_errors
from polywigner.mitsuba.receive.power_results import ReceiveOptions, described
from polywigner.mitsuba.receive.specular_paths import (
    CentralPath,
    Mesh,
    diffracted_ratio,
    obstacles_of,
    open_path,
    passing_rays,
)
from polywigner.mitsuba.scenes.reflectors import (
    ECHO_ERROR,
    Body,
    Chain,
    Echo,
    Route,
    names_of,
    paths_by,
    routes_in,
)
from polywigner.mitsuba.scenes.rendering import hide_emitters, polarised_by_default
from polywigner.mitsuba.scenes.surfaces import receivers_of
from polywigner.numerics import Complex, Floats
from polywigner.quantities import SPEED_OF_LIGHT, parse_frequency
from polywigner.reception import coupling
from polywigner.scattering.near_fields import echo
from polywigner.source.polarisation import checked_polarisation, components

if TYPE_CHECKING:
    import xarray

_MOST_FREQUENCIES = 1 << 16
# Numbers of Chebyshev nodes that are tried in turn; each set of nodes contains the previous set.
_NODE_COUNTS = (5, 9, 17, 33, 65)
# Polarisation match below which a note recommends specifying polarisations.
_GOOD_MATCH = 0.99


@one_at_a_time
def channel(
    scene: Any,
    frequencies: ArrayLike | None = None,
    reflections: int = 2,
    *,
    polarisation: Any = None,
    bodies: Mapping[str, Any] | None = None,
    tolerance: float = 1e-6,
    progress: Callable[[int, int], None] | None = None,
) -> xarray.Dataset:
    """Return the complex channel between all emitters and receivers of a scene.

    The channel coefficient h is the sum of the amplitudes of the line of sight and of all specular
    paths via flat mirrors, with exact near fields (docs/channel.md). \\|h\\|^2 is the ratio of
    received to transmitted power. The parameter ``normalise`` of the plugins defines both powers.
    By default, both powers are radiated powers, so Friis' formula with directivities holds in the
    far field. Waves have the phase exp(i k r - i omega t). Scattered light is not included.

    Parameters
    ----------
    scene : mi.Scene
        Scene with ``wigner`` shapes and ``wigner_receiver`` sensors.
    frequencies : array_like, shape (n,), or float, optional
        Frequencies in Hz, or strings with a unit. Default: the frequencies of the emitters.
        Apertures, fields, weights and refractive indices are independent of the frequency.
    reflections : int, default 2
        Maximum number of specular reflections per path, 0 to 3.
    polarisation : str or array_like, optional
        Polarisation of emitters and receivers whose polarisation is not specified in the scene. It
        is "x", "y", "45 deg", "right", ... or a Jones vector in the x and y axes of the emitter or
        receiver. Default: "y". In unpolarised variants, the line-of-sight path then has no
        polarisation loss (docs/polarisation.md).
    bodies : mapping, optional
        Perfect conductors by name, whose echoes are additional paths (docs/channel.md). Each value
        is a body as in :func:`polywigner.rcs`, with positions in m in the frame of the scene. For
        two or three reflections between its faces, the value is a pair of the body and the number
        of reflections, such as ``{"corner": (plates, 3)}``. Do not add the bodies to the scene.
    tolerance : float, default 1e-6
        Tolerance of couplings, as in :func:`polywigner.coupling`.
    progress : callable, optional
        Function that is called after each pair of an emitter and a receiver, with the number of
        finished pairs and the total number of pairs.

    Returns
    -------
    xarray.Dataset
        ``h`` is the complex channel coefficient, with the dimensions (frequency, receiver,
        emitter). ``amplitude`` is the complex amplitude of each path, with the dimensions
        (frequency, receiver, emitter, path). ``delay``, with the dimensions (receiver, emitter,
        path), is the delay in s from the centre of the emitter to the centre of the receiver.
        ``mirrors`` contains the names of the shapes and bodies of each path in the order of
        reflection, joined by ", ". If a path does not exist for an emitter and a receiver, its
        amplitude is zero and its delay is NaN. The attribute ``polarisation`` describes the
        polarisations of emitters and receivers, and ``notes`` lists effects that are not included.

    Raises
    ------
    SceneError
        If the scene has no emitter or no receiver, if these differ in scene unit or obliquity, or
        if there are partially coherent sources, a mirror whose reflection has no defined phase, or
        too many paths.
    ArgumentError, QuantityError
        If another argument is out of range.
    """
    requested = None if frequencies is None else checked_frequencies(frequencies)
    waves: dict[str, Any] = {"polarisation": polarisation, "bodies": bodies}
    options = ReceiveOptions(reflections=reflections, tolerance=tolerance, coherent=True, **waves)
    with polarised_by_default(scene, options.polarisation):
        sensors = [sensor for _, sensor in receivers_of(scene)]
        receivers = [placed_receiver(scene, s, n) for n, s in enumerate(sensors)]
        emitters = placed_emitters(scene)
    if not emitters:
        raise SceneError('the scene has no wigner emitter; add a <shape type="wigner">')
    if requested is None:
        requested = np.unique([SPEED_OF_LIGHT / emitter.wavelength for emitter in emitters])
    unit = receivers[0].scene_unit
    routes, notes = routes_in(scene, unit, options.reflections, options.bodies)
    pairs = list(product(receivers, emitters))
    links = []
    with hide_emitters(scene), with_progress("links", pairs, progress) as pairs_in_turn:
        for receiver, emitter in pairs_in_turn:
            paths, h, of_link = paths_between(scene, emitter, receiver, routes, options, requested)
            links.append((paths, h))
            notes = of_link + notes
    summary = polarisation_summary([*emitters, *receivers], True, options.polarisation)
    return _dataset(requested, receivers, emitters, routes, links, notes, summary)


def checked_frequencies(frequencies: Any) -> Floats:
    """Convert one or several numbers in Hz or strings to an array (n,) of frequencies in Hz.

    Raises ArgumentError or QuantityError for other values.
    """
    values = [frequencies] if isinstance(frequencies, str) else frequencies
    if isinstance(values, list | tuple):
        values = [parse_frequency(value) if isinstance(value, str) else value for value in values]
    expected = f"expected frequencies to be 1 to {_MOST_FREQUENCIES} numbers above 0 in Hz"
    row = checked_row(values, expected)
    if row.size > _MOST_FREQUENCIES or not (np.isfinite(row) & (row > 0.0)).all():
        raise ArgumentError(f"{expected}, got {frequencies!r:.100}")
    return row


@dataclass(frozen=True, eq=False)
class CoherentPath:
    """Path from an emitter to a receiver, with the factors of its amplitude."""

    route: Route
    distance: float
    """Length of the path between the centres of the emitter and the receiver in m."""
    transmission: float
    """Amplitude transmission of obstacles, averaged over rays."""
    links: tuple[tuple[complex, FacingParts], ...]
    """Polarisation factor ``e_r . E`` and parts that face each other, for each polarised pair."""
    ends: Ends
    edges: Callable[[float], complex] | None = None
    """Ratio b/b_0 as a function of the wavelength in m, or None without diffraction."""
    echo: Callable[[float], complex] | None = None
    """Coupling of an echo as a function of the wavelength in m, or None without a body."""

    def transmission_at(self, wavelength: float) -> complex:
        """Return the amplitude transmission at a wavelength in m, with diffraction."""
        return self.transmission * (1.0 if self.edges is None else self.edges(wavelength))


@dataclass(frozen=True, eq=False)
class NormalisedSource:
    """Emitter or receiver with normalised power, divided into parts of different polarisation."""

    source: PlacedSource
    parts: tuple[tuple[PlacedSource, Complex], ...]
    """Parts with a single polarisation, and their Jones vectors."""
    is_polarised: bool = True
    """Whether the scene or the caller specifies a polarisation."""

    def root_of_fraction(self, part: PlacedSource, is_complete: bool, wavelength: float) -> float:
        """Return the square root of a part's fraction of the power of the source.

        ``is_complete`` is true if ``part`` is an item of ``parts``, and false if it is a piece of
        an item.
        """
        if is_complete and len(self.parts) == 1 and self.source.normalise == "radiated":
            return 1.0
        norm = partial(norm_of, wavelength=wavelength, obliquity=self.source.obliquity)
        norms = [norm(p.source, normalise=self.source.normalise) for p, _ in self.parts]
        return math.sqrt(norm(part.source) / math.fsum(norms))


Ends = tuple[NormalisedSource, NormalisedSource]


def _normalised(placed: PlacedSource, polarisation: Any) -> NormalisedSource:
    """Return an emitter or receiver with its polarised parts, for paths that interfere.

    The Jones vector ``polarisation`` applies if the scene specifies no polarisation. Raises
    SceneError for partially coherent, broadband and unpolarised sources.
    """
    if not placed.mixture.is_plain:
        raise SceneError(
            "interfering paths require coherent light of a single wavelength, got "
            f"{placed.mixture} at {placed.name!r}; omit its coherence width and bandwidth"
        )
    jones = placed.polarisation
    if jones is None and placed.states_polarisation:
        raise SceneError(
            f"interfering paths require polarised emitters and receivers, but {placed.name!r} is "
            "unpolarised; specify its polarisation, or add powers with received_power(scene)"
        )
    jones = polarisation if jones is None else jones
    is_polarised = jones is not None
    jones = checked_polarisation(jones if is_polarised else DEFAULT_POLARISATION, placed.source)
    parts = [(replace(placed, source=s), p) for s, p in components(placed.source, jones)]
    return NormalisedSource(placed, tuple(parts), is_polarised)


def paths_between(
    scene: Any,
    emitter: PlacedSource,
    receiver: PlacedSource,
    routes: Sequence[Route],
    options: ReceiveOptions,
    frequencies: Floats,
) -> tuple[list[CoherentPath], Complex, list[str]]:
    """Return the paths between an emitter and a receiver, and notes on excluded effects.

    The second of the three results contains the complex amplitudes (n, paths) at n frequencies in
    Hz, including the phases of propagation. The sources of ``scene`` must be hidden.
    """
    link = f"from {emitter.name!r} to {receiver.name!r}"
    check_unit(emitter, receiver)
    check_obliquity(f"the link {link}", emitter.obliquity, receiver.obliquity)
    jones = options.polarisation
    ends = _normalised(emitter, jones), _normalised(receiver, jones)
    # The shortest wavelength determines the resolution of curved obstacles.
    meshes = obstacles_of(scene, emitter, receiver, SPEED_OF_LIGHT / float(frequencies.max()))
    leg_to = cache(partial(_path_to_body, scene, receiver))

    def find(route: Route) -> tuple[CoherentPath, list[str]] | str:
        """Return the path along a route and its notes, or the reason why no power arrives."""
        if isinstance(route, Echo):
            return _echo_path(ends, route, leg_to)
        return _specular_path(scene, ends, route, meshes)

    paths, notes = paths_by(routes, link, find)
    if len(paths) > 1 and paths[0].route == () and not ends[0].is_polarised:
        line = CentralPath(np.array([emitter.centre, receiver.centre]), [np.eye(3)])
        emitted, received = (end.parts[0][1] for end in ends)
        match = abs(_polarisation_factor(emitted, received, ends, (), line)) ** 2
        if match < _GOOD_MATCH:
            notes.append(
                f"{link}: only {match:.1%} of the power matches if both ends are polarised along "
                "their y axes; the line-of-sight path is computed as matched, other paths as "
                "polarised along y; specify a polarisation"
            )
    return paths, _amplitudes_of(paths, frequencies, options.tolerance), notes


def _specular_path(
    scene: Any, ends: Ends, chain: Chain, meshes: list[Mesh] | None
) -> tuple[CoherentPath, list[str]] | str:
    """Return a path via mirrors and its notes, or the reason why no power arrives.

    ``chain`` is empty for the line of sight. ``meshes`` is None if diffraction is not included.
    """
    result = open_path(scene, ends[0].source, ends[1].source, chain, meshes, coherent=True)
    if isinstance(result, str):
        return result
    facing, taking, rays = result.facing, result.parts.receiver, result.rays
    leg = CentralPath.between(facing, taking, chain, rays)
    # An emitter and a receiver without specified polarisations match along the line of sight, so
    # the coupling is scalar.
    is_scalar = not chain and not (ends[0].is_polarised or ends[1].is_polarised)
    links = []
    for (emitted, p), (received, q) in product(*(end.parts for end in ends)):
        parts_facing = facing_parts(emitted.image(chain), received)
        if parts_facing is not None:
            factor = leg.transmission if is_scalar else _polarisation_factor(p, q, ends, chain, leg)
            links.append((factor, parts_facing))
    edges = (
        None if meshes is None else cache(partial(diffracted_ratio, meshes, facing, taking, chain))
    )
    path = CoherentPath(chain, leg.length, rays.amplitude, tuple(links), ends, edges)
    return path, result.notes


def _polarisation_factor(
    emitted: Complex, received: Complex, ends: Ends, chain: Chain, legs: CentralPath
) -> complex:
    """Return the polarisation factor e_r.E of a path for two Jones vectors, without conjugation.

    ``legs`` is the path between the ends, via the mirrors of ``chain``.
    """
    out, back = (end.source.pose[:3, :3] for end in ends)
    last = CentralPath(legs.points[:-3:-1], [np.eye(3)])
    return complex(legs.arriving(emitted, out, chain) @ last.arriving(received, back))


def _path_to_body(
    scene: Any, like: PlacedSource, body: Body, end: PlacedSource, chain: Chain
) -> tuple[CentralPath, float] | None:
    """Return the path from an emitter or receiver to a body, and its amplitude transmission.

    ``like`` is a receiver whose scene unit and medium apply to the rays. The result is None if part
    of the body is not in front of the emitter or receiver. The transmission of a blocked path is 0.
    """
    image = end.image(chain)
    if not body.is_in_front(image):
        return None
    target = body.target_facing(image, like)
    rays = passing_rays(scene, end, target, chain, coherent=True)
    if not rays.amplitude:
        return CentralPath(np.empty((0, 3)), rays.panes), 0.0
    return CentralPath.between(end, target, chain, rays), rays.amplitude


def _echo_path(
    ends: Ends, route: Echo, leg_to: Callable[..., tuple[CentralPath, float] | None]
) -> tuple[CoherentPath, list[str]] | str:
    """Return the path via a body and its notes, or the reason why no power arrives.

    ``leg_to`` is `_path_to_body` with fixed scene and receiver. By reciprocity, both legs lead to
    the body.
    """
    chains = route.before, route.after[::-1]
    legs, transmission = [], 1.0
    for end, chain in zip(ends, chains, strict=True):
        result = leg_to(route.body, end.source, chain)
        if result is None:
            return (
                "the echo is not computed: part of the body lies in the plane of one end or "
                "behind it"
            )
        legs.append(result[0])
        transmission *= result[1]
    if transmission == 0.0:
        return "the echo is zero: obstacles block it (ray test, without diffraction)"
    notes = route.body.accuracy_notes(ends[1].source.wavelength, [leg.points for leg in legs])
    if transmission < 1:
        notes.append(
            f"{transmission:.1%} of the amplitude of the echo passes the obstacles (ray test, "
            "without diffraction)"
        )
    distance = math.fsum(leg.length for leg in legs)
    echo = cache(partial(_echo_coupling, ends, route.body, chains, legs))
    return CoherentPath(route, distance, transmission, (), ends, echo=echo), notes


def _echo_coupling(
    ends: Ends, body: Body, chains: tuple[Chain, Chain], legs: list[CentralPath], wavelength: float
) -> complex:
    """Return the coupling of two ends via a conducting body at a wavelength in m.

    ``chains`` and ``legs`` lead from each end to the body. The coupling includes polarisations but
    not obstacles.
    """
    sides = []
    for end, chain, leg in zip(ends, chains, legs, strict=True):
        side = []
        for part, jones in end.parts:
            field = leg.arriving(jones, end.source.pose[:3, :3], chain)
            strength = float(np.linalg.norm(field)) * end.root_of_fraction(part, True, wavelength)
            side.append((body.antenna(part.image(chain), wavelength), field, strength))
        sides.append(side)
    total = 0j
    for (emitted, p, first), (received, q, second) in product(*sides):
        with scene_errors(f"cannot compute the echo of {body.name!r}: "):
            b = echo(body.facets, emitted, received, (q, p), ECHO_ERROR, body.bounces)
        total += first * second * b
    return total


def _amplitudes_of(paths: Sequence[CoherentPath], frequencies: Floats, tolerance: float) -> Complex:
    """Return the complex amplitudes (n, paths) at frequencies in Hz."""
    if not paths:
        return np.zeros((len(frequencies), 0), np.complex128)
    delays = np.array([path.distance for path in paths]) / SPEED_OF_LIGHT
    envelopes = np.empty((len(frequencies), len(paths)), np.complex128)
    for is_echo, allowed in ((False, tolerance), (True, max(tolerance, 3 * ECHO_ERROR))):
        indices = [k for k, path in enumerate(paths) if (path.echo is not None) == is_echo]
        if indices:
            find = partial(_envelopes, [paths[k] for k in indices], delays[indices], allowed)
            envelopes[:, indices] = _in_band(find, frequencies, allowed)
    return np.asarray(envelopes * np.exp(2j * math.pi * frequencies[:, None] * delays))


def _in_band(compute: Callable[[float], Complex], frequencies: Floats, tolerance: float) -> Complex:
    """Evaluate a smooth function at n frequencies, by Chebyshev interpolation if that saves calls.

    ``compute`` returns an array of k complex values for a frequency, and the result has the shape
    (n, k). The number of nodes is doubled until the error of each of the k values at the new nodes
    is below ``tolerance`` times the largest modulus of this value.
    """
    low, high = float(frequencies.min()), float(frequencies.max())
    steps = _NODE_COUNTS[-1] - 1
    nodes_in_band = (low + high) / 2 - (high - low) / 2 * np.cos(
        np.pi * np.arange(steps + 1) / steps
    )
    known: dict[int, Complex] = {}
    nodes, values = np.empty(0), np.empty((0, 0), np.complex128)
    for count in _NODE_COUNTS:
        if count >= len(np.unique(frequencies)):
            break
        numbers = range(0, steps + 1, steps // (count - 1))
        known |= {k: compute(float(nodes_in_band[k])) for k in numbers if k not in known}
        predicted = _interpolated(nodes, values, nodes_in_band[numbers]) if len(nodes) else None
        nodes, values = nodes_in_band[numbers], np.array([known[k] for k in numbers])
        if predicted is not None:
            errors = np.abs(predicted - values).max(axis=0)
            if (errors <= tolerance * np.abs(values).max(axis=0)).all():
                return _interpolated(nodes, values, frequencies)
    return np.array([compute(float(frequency)) for frequency in frequencies])


def _interpolated(nodes: Floats, values: Complex, frequencies: Floats) -> Complex:
    """Interpolate values (nodes, k) at Chebyshev nodes to n frequencies by a polynomial.

    The result has the shape (n, k).
    """
    low, high = nodes[[0, -1]]
    scaled = [(2 * x - low - high) / (high - low) for x in (nodes, frequencies)]
    coefficients = chebyshev.chebfit(scaled[0], values, len(nodes) - 1)
    return np.asarray(chebyshev.chebval(scaled[1], coefficients).T, np.complex128)


def _envelopes(
    paths: Sequence[CoherentPath], delays: Floats, tolerance: float, frequency: float
) -> Complex:
    """Return the amplitudes of paths at a frequency f in Hz, divided by exp(2 pi i f delay)."""
    wavelength = SPEED_OF_LIGHT / frequency
    links = [parts for path in paths for _, parts in path.links]
    couplings = iter(_couplings(links, wavelength, tolerance))
    values = np.zeros(len(paths), np.complex128)
    for k, path in enumerate(paths):
        for factor, parts in path.links:
            roots = (
                end.root_of_fraction(part, parts.fraction == 1, wavelength)
                for end, part in zip(path.ends, (parts.emitter, parts.receiver), strict=True)
            )
            values[k] += factor * next(couplings) * math.prod(roots)
        if path.echo is not None:
            values[k] = path.echo(wavelength)
        values[k] *= path.transmission_at(wavelength)
    return values * np.exp(-2j * math.pi * frequency * delays)


def _couplings(links: list[FacingParts], wavelength: float, tolerance: float) -> Complex:
    """Return the coupling b of each link; links with equal sources are computed together."""
    groups: dict[tuple[Any, ...], list[int]] = {}
    for k, parts in enumerate(links):
        key = parts.emitter.source, parts.receiver.source, parts.emitter.obliquity
        groups.setdefault(key, []).append(k)
    values = np.zeros(len(links), np.complex128)
    for (emitted, received, obliquity), numbers in groups.items():
        ends = [(links[k].emitter, links[k].receiver) for k in numbers]
        poses = np.array([emitter.pose_of(receiver) for emitter, receiver in ends])
        first, last = (end.name for end in ends[0])
        with scene_errors(f"the link from emitter {first!r} to receiver {last!r}: "):
            values[numbers] = coupling(emitted, received, poses, wavelength, obliquity, tolerance)
    return values


def _dataset(
    frequencies: Floats,
    receivers: list[PlacedSource],
    emitters: list[PlacedSource],
    routes: Sequence[Route],
    links: list[tuple[list[CoherentPath], Complex]],
    notes: list[str],
    polarisation: str,
) -> xarray.Dataset:
    """Return the channel as a dataset.

    ``links`` contains the paths and amplitudes of each pair of a receiver and an emitter, sorted by
    receiver.
    """
    present = {path.route for paths, _ in links for path in paths}

    number = {route: k for k, route in enumerate(r for r in routes if r in present)}
    shape = len(receivers), len(emitters), len(number)
    delays = np.full((len(links), len(number)), np.nan)
    values = np.zeros((len(frequencies), len(links), len(number)), np.complex128)
    for pair, (paths, of_link) in enumerate(links):
        for path, value in zip(paths, of_link.T, strict=True):
            delays[pair, number[path.route]] = path.distance / SPEED_OF_LIGHT
            values[:, pair, number[path.route]] = value
    names = np.array([", ".join(names_of(route)) for route in number], dtype=np.str_)
    amplitudes = values.reshape(len(frequencies), *shape)
    dims = "receiver", "emitter", "path"
    wave = "exp(i k r - i omega t); |.|^2 is received over transmitted power"
    return described(
        {
            "h": (amplitudes.sum(axis=-1), ("frequency", *dims[:2]), "1", f"channel, {wave}"),
            "amplitude": (amplitudes, ("frequency", *dims), "1", f"amplitude of a path, {wave}"),
            "delay": (delays.reshape(shape), dims, "s", "delay between the centres of both ends"),
            "mirrors": (
                names,
                ("path",),
                "",
                "mirrors in the order of reflection; empty: line of sight",
            ),
        },
        {
            "frequency": ("frequency", frequencies, {"units": "Hz"}),
            "receiver": ("receiver", [placed.name for placed in receivers]),
            "emitter": ("emitter", [placed.name for placed in emitters]),
        },
        {"polarisation": polarisation, "notes": list(dict.fromkeys(notes))},
    )
