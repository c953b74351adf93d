"""Paths that interfere: complex amplitudes of direct ways and ways by flat mirrors.

The amplitude of a way is the coupling b of the emitter's image with the receiver (docs/links.md,
(RX1)), times three factors: e_r . E, the field that mirrors leave of a unit vector E at the emitter
as the receiver's own unit vector takes it, along the middle of the way; the mean over rays of the
root of the power that obstacles, masks and fog let through; or, with diffraction, b/b_0 over the
edges of obstacles.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from itertools import product
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.polynomial import chebyshev
from numpy.typing import ArrayLike, NDArray

from polywigner.errors import ArgumentError, PolywignerError, SceneError
from polywigner.execution.progress import told
from polywigner.geometry.arguments import checked_callable, checked_count, checked_row
from polywigner.mitsuba.plugins.emissions import norm_of
from polywigner.mitsuba.plugins.placement import (
    PlacedSource,
    check_unit,
    placed_emitter,
    placed_receiver,
)
from polywigner.mitsuba.plugins.polariser import DEFAULT_POLARISATION, polarisation_summary
from polywigner.mitsuba.plugins.receiver import receivers_of
from polywigner.mitsuba.plugins.registration import one_at_a_time
from polywigner.mitsuba.receive.direct_light import (
    BEHIND,
    BLOCKED,
    UNSEEN,
    DirectLight,
    FacingParts,
    check_obliquity,
    facing_parts,
    mirrors_in,
    narrow,
    ways_of,
)
from polywigner.mitsuba.receive.passing import (
    RAYS,
    Mesh,
    corners,
    diffracted_ratio,
    meeting_rays,
    passing_rays,
)
from polywigner.mitsuba.receive.received import MOST_REFLECTIONS, DirectPath, described
from polywigner.mitsuba.receive.scattered import polarised_by_default, unseen, wigner_emitters
from polywigner.mitsuba.scenes.reflectors import (
    OF_ECHO,
    Body,
    Echo,
    Mirror,
    checked_bodies,
    echoes_of,
    reflected,
    surface_of,
)
from polywigner.mitsuba.scenes.surfaces import meshes_in
from polywigner.quantities import SPEED_OF_LIGHT, parse_frequency, wavelength_of
from polywigner.reception import coupling
from polywigner.reception.couplings import checked_tolerance
from polywigner.scattering.near_fields import echo
from polywigner.source.polarisation import checked_polarisation, components, ludwig_axes

if TYPE_CHECKING:
    import xarray

Floats = NDArray[np.float64]
Complexes = NDArray[np.complex128]
Chain = tuple[Mirror, ...]
Way = Chain | Echo

# Chebyshev's nodes of a band, rule after rule, each with the nodes of the one before; beyond the
# last each frequency is computed by itself.
_RULES = (5, 9, 17, 33, 65)
_MOST_FREQUENCIES = 1 << 16
# Match of both default polarisations, in power, below which a note reports it.
_MATCHED = 0.99


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
    """Complex amplitudes h between all emitters and receivers of a scene, with phase and delay.

    The sum of the direct way and of ways by flat mirrors, near fields exact by the poses of images
    (docs/channel.md). \\|h\\|^2 is received over transmitted power, both as ``normalise`` of the
    plugins counts them: by default radiated powers, so that far away Friis' formula holds with
    directivities. Waves go as exp(i k r - i omega t). Scattered light is left out.

    Parameters
    ----------
    scene : a ``mi.Scene`` with ``wigner`` shapes and ``wigner_receiver`` sensors.
    frequencies : (n,) in Hz, or a number; None: those of the emitters. Sources keep their
        apertures, fields and weights, and mirrors their refractive indices.
    reflections : most flat mirrors on a way, 0 to 3.
    polarisation : of ends for which the scene specifies none: "x", "y", "45 deg", "right", ... or
        a Jones vector in the x and y of each end. Default: "y"; in unpolarised variants the
        line-of-sight path then counts as matched (docs/polarised.md).
    bodies : perfect conductors of :func:`polywigner.rcs` by their names, in the scene's frame, in
        m, each alone or as a pair (body, reflections on it, 1 to 3): ``{"corner": (plates, 3)}``.
        Their echoes are ways like those by mirrors (docs/channel.md); leave them out of the scene
        itself.
    tolerance : of couplings, as in :func:`polywigner.coupling`.
    progress : called after each pair of ends with the number of those done, and of all.

    Returns
    -------
    xarray.Dataset
        ``h`` (frequency, receiver, emitter) complex; for each ``way`` its ``amplitude`` (frequency,
        receiver, emitter, way) complex, zero where it brings nothing, ``delay`` (receiver, emitter,
        way) in s between the middles of both ends, not a number there, and ``mirrors`` (way): names
        of shapes and bodies in the light's order, joined by ", ". ``attrs["polarisation"]``:
        polarisations of the ends; ``attrs["notes"]``: effects left out.

    Raises
    ------
    SceneError : no emitter or receiver, several scene units or obliquities, a mixture of light, a
        mirror whose reflection has no phase, links or chains of mirrors that are too much work.
        ArgumentError, QuantityError : other arguments out of range.
    """
    asked = None if frequencies is None else checked_frequencies(frequencies)
    count = checked_count(reflections, "reflections", 0, MOST_REFLECTIONS)
    allowed = checked_tolerance(tolerance)
    jones = None if polarisation is None else checked_polarisation(polarisation)
    conductors = checked_bodies(bodies)
    with polarised_by_default(scene, jones):
        receivers = [
            placed_receiver(s, n).touching(scene) for n, (_, s) in enumerate(receivers_of(scene))
        ]
        emitters = [
            placed_emitter(e, n).touching(scene) for n, e in enumerate(wigner_emitters(scene))
        ]
    if not emitters:
        raise SceneError("expected a scene with a wigner emitter, got one without; add one")
    if asked is None:
        asked = np.unique([SPEED_OF_LIGHT / emitter.wavelength for emitter in emitters])
    mirrors, notes = mirrors_in(scene, receivers[0].scene_unit, count)
    ways: list[Way] = [*ways_of(mirrors, count), *echoes_of(conductors, mirrors, count)]
    pairs = list(product(receivers, emitters))
    found = []
    with unseen(scene), told("links", pairs) as each:
        for number, (receiver, emitter) in enumerate(each, 1):
            shortest = SPEED_OF_LIGHT / asked.max()
            paths, own = paths_between(scene, emitter, receiver, ways, jones, shortest)
            found.append((paths, amplitudes_of(paths, asked, allowed)))
            notes = own + notes
            if progress is not None:
                checked_callable(progress, "progress")(number, len(pairs))
    summary = polarisation_summary([*emitters, *receivers], True, jones)
    return _dataset(asked, receivers, emitters, ways, found, notes, summary)


def checked_frequencies(frequencies: Any) -> Floats:
    """Frequencies (n,) in Hz from numbers or texts; ArgumentError or QuantityError for others."""
    given = [frequencies] if isinstance(frequencies, str) else frequencies
    if isinstance(given, list | tuple):
        given = [parse_frequency(each) if isinstance(each, str) else each for each in given]
    expected = f"expected frequencies as 1 to {_MOST_FREQUENCIES} numbers above 0 in Hz"
    found = checked_row(given, expected)
    if found.size > _MOST_FREQUENCIES or not (np.isfinite(found) & (found > 0.0)).all():
        raise ArgumentError(f"{expected}, got {frequencies!r:.100}")
    for value in found:
        wavelength_of(float(value))
    return found


def names_of(way: Way) -> tuple[str, ...]:
    """Names of mirrors and bodies in the order of light."""
    return way.names if isinstance(way, Echo) else tuple(mirror.name for mirror in way)


@dataclass(frozen=True, eq=False)
class CoherentPath:
    """A way between two ends with all of its amplitude but the couplings."""

    way: Way
    distance: float
    """m, between the middles of both ends along the way."""
    passing: float
    """Mean over rays of the root of the power that passes."""
    links: tuple[tuple[complex, FacingParts], ...]
    """Image and receiver, with e_r . E, of each pair of polarised components of both ends."""
    ends: tuple[Counted, Counted]
    edges: Callable[[float], complex] | None = None
    """b/b_0 over the edges of obstacles at a wavelength in m; None: by rays alone."""
    echo: Callable[[float], complex] | None = None
    """b by a body at a wavelength in m, in place of links."""


@dataclass(frozen=True, eq=False)
class Counted:
    """A placed source, whose power links count, as the parts that its polarisations make."""

    whole: PlacedSource
    parts: tuple[tuple[PlacedSource, Complexes], ...]
    is_polarised: bool = True
    """False: neither scene nor caller specifies a polarisation, in an unpolarised variant."""

    def root(self, part: PlacedSource, is_whole: bool, wavelength: float) -> float:
        """Root of the power that a part radiates over the power that counts."""
        if is_whole and len(self.parts) == 1 and self.whole.normalise == "radiated":
            return 1.0
        count = partial(norm_of, wavelength=wavelength, obliquity=self.whole.obliquity)
        all_of_it = math.fsum(
            count(own.source, normalise=self.whole.normalise) for own, _ in self.parts
        )
        return math.sqrt(count(part.source) / all_of_it)


def _counted(placed: PlacedSource, polarisation: Any) -> Counted:
    if not placed.mixture.is_plain:
        raise SceneError(
            f"expected coherent light of one wavelength at {placed.name!r} where ways interfere, "
            f"got {placed.mixture}; leave coherence and bandwidth of light out"
        )
    own = placed.polarisation
    if own is None and placed.states_polarisation:
        raise SceneError(
            f"paths interfere in one polarisation, but {placed.name!r} is unpolarised; give it a "
            "polarisation, or add powers with received_power(scene)"
        )
    own = own if own is not None else polarisation
    jones = checked_polarisation(DEFAULT_POLARISATION if own is None else own, placed.source)
    parts = [(replace(placed, source=s), p) for s, p in components(placed.source, jones)]
    return Counted(placed, tuple(parts), own is not None)


def paths_between(
    scene: Any,
    emitter: PlacedSource,
    receiver: PlacedSource,
    ways: Sequence[Way],
    polarisation: Any,
    shortest: float,
) -> tuple[list[CoherentPath], list[str]]:
    """Ways that bring something, in a scene whose sources are unseen; and notes on the rest."""
    link = f"from {emitter.name!r} to {receiver.name!r}"
    check_unit(emitter, receiver)
    check_obliquity(f"the link {link}", emitter.obliquity, receiver.obliquity)
    ends = _counted(emitter, polarisation), _counted(receiver, polarisation)
    meshes = None
    if emitter.diffraction or receiver.diffraction:
        unit = receiver.scene_unit
        meshes = [(p * unit, f) for p, f in meshes_in(scene, shortest / unit)]
    paths, notes = [], []
    leg_to = cache(partial(_leg_to, scene, receiver))  # those of one side serve several ways
    for way in ways:
        if isinstance(way, Echo):
            found, reasons = _echo_path(ends, way, leg_to)
        else:
            found, reasons = _path(scene, ends, way, meshes)
        if found is not None:
            paths.append(found)
        # most chains of mirrors lead nowhere
        if reasons and (found is not None or len(names_of(way)) == isinstance(way, Echo)):
            by = link + "".join(f" by {name!r}" for name in names_of(way))
            notes.append(f"{by}: {' and '.join(reasons)}")
    if len(paths) > 1 and paths[0].way == () and not ends[0].is_polarised:
        line = _Legs(np.array([emitter.middle, receiver.middle]), [np.eye(3)])
        match = abs(_turned(ends[0].parts[0][1], ends[1].parts[0][1], ends, (), line)) ** 2
        if match < _MATCHED:
            notes.append(
                f"{link}: the y axes of both ends match by {match:.1%} in power; the line-of-sight "
                "path counts as matched, other paths as polarised along y; specify polarisation"
            )
    return paths, notes


def _path(
    scene: Any, ends: tuple[Counted, Counted], chain: Chain, meshes: list[Mesh] | None
) -> tuple[CoherentPath | None, list[str]]:
    emitter, receiver = (end.whole for end in ends)
    parts = facing_parts(emitter.image(chain), receiver)
    if parts is None:
        return None, [UNSEEN]
    facing, taking = parts.emitter.image(chain[::-1]), parts.receiver
    send = passing_rays if meshes is None else meeting_rays
    rays = send(scene, facing, taking, chain, coherent=True)
    # rays that a corner of mirrors splits among orders of its mirrors add up to all of them
    passing = float(np.sqrt(rays.shares[:, 0, 0]).sum() / RAYS)
    if passing == 0.0:
        return None, [BLOCKED]
    leg = _Legs(_middle_way(facing, taking, chain, rays.points), rays.panes)
    # without polarisations the line-of-sight path is the scalar link of `coupling`
    is_scalar = not chain and not (ends[0].is_polarised or ends[1].is_polarised)
    links = []
    for (sent, p), (taken, q) in product(*(end.parts for end in ends)):
        both = facing_parts(sent.image(chain), taken)
        if both is not None:
            factor = leg.transmission if is_scalar else _turned(p, q, ends, chain, leg)
            links.append((factor, both))
    edges = None if meshes is None else cache(partial(_edges, meshes, facing, taking, chain))
    notes = [BEHIND] if parts.share < 1 else []
    if passing < 1 and not chain and meshes is None:
        notes.append(
            f"{passing:.1%} of the line-of-sight amplitude passes obstacles (ray test, without "
            "diffraction)"
        )
    notes += narrow(chain, parts.emitter, taking)
    return CoherentPath(chain, leg.length, passing, tuple(links), ends, edges), notes


def _middle_way(
    facing: PlacedSource, taking: PlacedSource, chain: Chain, rays: list[Floats]
) -> Floats:
    """Places (n, 3) from the emitter's middle to the receiver's; else the places of a ray."""
    start, end = facing.middle, taking.middle
    found = corners(start[None], end[None], chain)
    if found is None:
        return np.array([place[0] for place in reversed(rays)])
    return np.array([start, *(place[0] for place in reversed(found)), end])


class _Legs(NamedTuple):
    """The central path between two ends."""

    points: Floats
    """(n, 3) in m, in the order of light."""
    panes: list[Floats]
    """Matrix (3, 3) of each leg, by which its thin panes change the field."""

    @property
    def length(self) -> float:
        """m."""
        return float(np.linalg.norm(np.diff(self.points, axis=0), axis=1).sum())

    @property
    def transmission(self) -> float:
        """Amplitude transmission of the thin panes of the first leg for unpolarised light."""
        along = self.points[1] - self.points[0]
        along /= np.linalg.norm(along)
        across = self.panes[0] @ (np.eye(3) - np.outer(along, along))
        return float(np.linalg.norm(across) / math.sqrt(2.0))


def _turned(
    sent: Complexes, taken: Complexes, ends: tuple[Counted, Counted], chain: Chain, legs: _Legs
) -> complex:
    """e_r . E: Jones vectors of both ends by the mirrors of a way, no conjugate."""
    out, back = (end.whole.pose[:3, :3] for end in ends)
    last = _Legs(legs.points[:-3:-1], [np.eye(3)])
    return complex(_arriving(sent, out, chain, legs) @ _arriving(taken, back, (), last))


def _arriving(jones: Complexes, axes: Floats, chain: Chain, legs: _Legs) -> Complexes:
    """E (3,) at the end of a way of the unit vector that a source with a Jones vector sends."""
    steps = np.diff(legs.points, axis=0)
    steps /= np.linalg.norm(steps, axis=1)[:, None]
    field = legs.panes[0] @ (axes @ (jones @ np.array(ludwig_axes(*(steps[0] @ axes)))))
    for mirror, step, panes in zip(chain, steps, legs.panes[1:], strict=False):
        surface = surface_of(mirror, bool(step @ mirror.normal < 0))
        field = panes @ reflected(field, step, mirror.normal, surface)
    return np.asarray(field)


def _edges(
    meshes: list[Mesh], facing: PlacedSource, taking: PlacedSource, chain: Chain, wavelength: float
) -> complex:
    sent, taken = (replace(end, wavelength=wavelength) for end in (facing, taking))
    return diffracted_ratio(meshes, sent, taken, chain)


# ---- bodies -------------------------------------------------------------------------------------


def _leg_to(
    scene: Any, like: PlacedSource, body: Body, end: PlacedSource, chain: Chain
) -> tuple[_Legs, float]:
    """The path from an end to a body's middle by mirrors; mean root of the power."""
    image = end.image(chain)
    if not body.is_in_front(image):
        return _Legs(np.empty((0, 3)), []), math.nan
    place = body.standing_in(image, like)
    rays = passing_rays(scene, end, place, chain, coherent=True)
    passing = float(np.sqrt(rays.shares[:, 0, 0]).sum() / RAYS)
    way = _middle_way(end, place, chain, rays.points) if passing else np.empty((0, 3))
    return _Legs(way, rays.panes), passing


def _echo_path(
    ends: tuple[Counted, Counted], way: Echo, leg_to: Callable[..., tuple[_Legs, float]]
) -> tuple[CoherentPath | None, list[str]]:
    """A way by a body. Both ends send towards it, by reciprocity."""
    chains = way.before, way.after[::-1]
    found = [leg_to(way.body, end.whole, chain) for end, chain in zip(ends, chains, strict=True)]
    legs, passing = [leg for leg, _ in found], math.prod(share for _, share in found)
    if math.isnan(passing):
        return None, ["no echo: part of the body lies in the plane of one end or behind it"]
    if passing == 0.0:
        return None, ["obstacles block the echo (ray test, without diffraction)"]
    notes = way.body.doubts(ends[1].whole.wavelength, [leg.points for leg in legs])
    if passing < 1:
        notes.append(
            f"{passing:.1%} of the echo's amplitude passes obstacles (ray test, without "
            "diffraction)"
        )
    distance = math.fsum(leg.length for leg in legs)
    echo = cache(partial(_echo, ends, way, chains, legs))
    return CoherentPath(way, distance, passing, (), ends, echo=echo), notes


def _echo(
    ends: tuple[Counted, Counted], way: Echo, chains: tuple[Chain, Chain], legs: list[_Legs],
    wavelength: float,
) -> complex:  # fmt: skip
    """b by a body, of all polarised components of both ends."""
    sides = []
    for end, chain, leg in zip(ends, chains, legs, strict=True):
        side = []
        for part, jones in end.parts:
            field = _arriving(jones, end.whole.pose[:3, :3], chain, leg)
            strength = float(np.linalg.norm(field)) * end.root(part, True, wavelength)
            side.append((way.body.antenna(part.image(chain), wavelength), field, strength))
        sides.append(side)
    total = 0j
    for (sent, p, one), (taken, q, other) in product(*sides):
        facets, bounces = way.body.facets, way.body.bounces
        try:
            total += one * other * echo(facets, sent, taken, (q, p), OF_ECHO, bounces)
        except PolywignerError as error:
            raise SceneError(f"the echo of {way.body.name!r}: {error}") from None
    return total


# ---- amplitudes at frequencies ------------------------------------------------------------------


def amplitudes_of(
    paths: Sequence[CoherentPath], frequencies: Floats, tolerance: float
) -> Complexes:
    """Amplitudes (n, paths) at frequencies (n,) in Hz."""
    if not paths:
        return np.zeros((len(frequencies), 0), np.complex128)
    turns = np.array([path.distance for path in paths]) / SPEED_OF_LIGHT
    slow = np.empty((len(frequencies), len(paths)), np.complex128)
    by_body = [path.echo is not None for path in paths]
    for is_echo, allowed in ((False, tolerance), (True, max(tolerance, 3 * OF_ECHO))):
        own = [k for k, is_one in enumerate(by_body) if is_one == is_echo]
        if own:
            find = partial(_slow, [paths[k] for k in own], turns[own], allowed)
            slow[:, own] = in_band(find, frequencies, allowed)
    result: Complexes = slow * np.exp(2j * math.pi * frequencies[:, None] * turns)
    return result


def _slow(
    paths: Sequence[CoherentPath], turns: Floats, tolerance: float, frequency: float
) -> Complexes:
    """Amplitudes (paths,) at a frequency, without the phase of their distances."""
    wavelength = SPEED_OF_LIGHT / frequency
    links = [parts for path in paths for _, parts in path.links]
    couplings = iter(_couplings(links, wavelength, tolerance))
    found = np.zeros(len(paths), np.complex128)
    for k, path in enumerate(paths):
        for turned, parts in path.links:
            counted = (
                end.root(part, parts.share == 1, wavelength)
                for end, part in zip(path.ends, (parts.emitter, parts.receiver), strict=True)
            )
            found[k] += turned * next(couplings) * math.prod(counted)
        if path.echo is not None:
            found[k] = path.echo(wavelength)
        found[k] *= path.passing * (1.0 if path.edges is None else path.edges(wavelength))
    return found * np.exp(-2j * math.pi * frequency * turns)


def _couplings(links: list[FacingParts], wavelength: float, tolerance: float) -> Complexes:
    """b (links,), all of one pair of sources in one call."""
    groups: dict[Any, list[int]] = {}
    for k, parts in enumerate(links):
        key = parts.emitter.source, parts.receiver.source, parts.emitter.obliquity
        groups.setdefault(key, []).append(k)
    found = np.zeros(len(links), np.complex128)
    for (sent, taken, obliquity), numbers in groups.items():
        ends = [(links[k].emitter, links[k].receiver) for k in numbers]
        poses = np.array([emitter.pose_of(receiver) for emitter, receiver in ends])
        try:
            found[numbers] = coupling(sent, taken, poses, wavelength, obliquity, tolerance)
        except PolywignerError as error:
            emitter, receiver = ends[0]
            link = f"the link from emitter {emitter.name!r} to receiver {receiver.name!r}"
            raise SceneError(f"{link}: {error}") from None
    return found


def in_band(
    compute: Callable[[float], Complexes], frequencies: Floats, tolerance: float
) -> Complexes:
    """Smooth values (n, k) at frequencies (n,), by a polynomial where that takes fewer of them."""
    low, high = float(frequencies.min()), float(frequencies.max())
    steps = _RULES[-1] - 1
    places = (low + high) / 2 - (high - low) / 2 * np.cos(np.pi * np.arange(steps + 1) / steps)
    known: dict[int, Complexes] = {}
    nodes, values = np.empty(0), np.empty((0, 0), np.complex128)
    for count in _RULES:
        if count >= len(frequencies):
            break
        own = range(0, steps + 1, steps // (count - 1))
        known |= {k: compute(float(places[k])) for k in own if k not in known}
        foretold = _interpolated(nodes, values, places[own]) if len(nodes) else None
        nodes, values = places[own], np.array([known[k] for k in own])
        if foretold is not None:
            errors = np.abs(foretold - values).max(axis=0)
            if (errors <= tolerance * np.abs(values).max(axis=0)).all():
                return _interpolated(nodes, values, frequencies)
    return np.array([compute(float(frequency)) for frequency in frequencies])


def _interpolated(nodes: Floats, values: Complexes, places: Floats) -> Complexes:
    """Values (n, k) at places (n,) of the polynomial through Chebyshev's nodes, ends included."""
    low, high = nodes[[0, -1]]
    if low == high:
        return np.repeat(values[:1], len(places), axis=0)
    own, wanted = ((2 * x - low - high) / (high - low) for x in (nodes, places))
    found = chebyshev.chebfit(own, values, len(nodes) - 1)
    return np.asarray(chebyshev.chebval(wanted, found).T, np.complex128)


# ---- results ------------------------------------------------------------------------------------


def coherent_light(
    scene: Any,
    emitter: PlacedSource,
    receiver: PlacedSource,
    ways: Sequence[Way],
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


def _dataset(
    frequencies: Floats,
    receivers: list[PlacedSource],
    emitters: list[PlacedSource],
    ways: Sequence[Way],
    found: list[tuple[list[CoherentPath], Complexes]],
    notes: list[str],
    polarisation: str,
) -> Any:
    there = {path.way for paths, _ in found for path in paths}
    kept = [way for way in ways if way in there]
    number = {way: k for k, way in enumerate(kept)}
    shape = len(receivers), len(emitters), len(kept)
    delays = np.full((len(found), len(kept)), np.nan)
    values = np.zeros((len(frequencies), len(found), len(kept)), np.complex128)
    for pair, (paths, own) in enumerate(found):
        for path, value in zip(paths, own.T, strict=True):
            delays[pair, number[path.way]] = path.distance / SPEED_OF_LIGHT
            values[:, pair, number[path.way]] = value
    names = np.array([", ".join(names_of(way)) for way in kept], dtype=np.str_)
    amplitudes = values.reshape(len(frequencies), *shape)
    dims = "receiver", "emitter", "way"
    wave = "exp(i k r - i omega t); |.|^2 is received over transmitted power"
    return described(
        {
            "h": (amplitudes.sum(axis=-1), ("frequency", *dims[:2]), "1", f"channel, {wave}"),
            "amplitude": (amplitudes, ("frequency", *dims), "1", f"amplitude of a way, {wave}"),
            "delay": (delays.reshape(shape), dims, "s", "delay between the middles of both ends"),
            "mirrors": (names, ("way",), "", "mirrors in the order of light; none: direct"),
        },
        {
            "frequency": ("frequency", frequencies, {"units": "Hz"}),
            "receiver": ("receiver", [placed.name for placed in receivers]),
            "emitter": ("emitter", [placed.name for placed in emitters]),
        },
        {"polarisation": polarisation, "notes": list(dict.fromkeys(notes))},
    )
