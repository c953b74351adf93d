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
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from polywigner.errors import ArgumentError, PolywignerError, SceneError
from polywigner.execution.progress import told
from polywigner.geometry.arguments import checked_callable, checked_row
from polywigner.mitsuba.plugins.placement import (
    FacingParts,
    PlacedSource,
    check_obliquity,
    check_unit,
    facing_parts,
    placed_emitter,
    placed_receiver,
)
from polywigner.mitsuba.plugins.polariser import DEFAULT_POLARISATION, polarisation_summary
from polywigner.mitsuba.plugins.registration import one_at_a_time
from polywigner.mitsuba.plugins.source_parameters import norm_of
from polywigner.mitsuba.receive.passing import (
    CentralPath,
    Mesh,
    diffracted_ratio,
    obstacles_of,
    open_path,
    passing_rays,
)
from polywigner.mitsuba.receive.received import ReceiveOptions, described
from polywigner.mitsuba.scenes.reflectors import (
    OF_ECHO,
    Body,
    Chain,
    Echo,
    Way,
    names_of,
    paths_by,
    ways_in,
)
from polywigner.mitsuba.scenes.rendering import polarised_by_default, unseen
from polywigner.mitsuba.scenes.surfaces import receivers_of, wigner_emitters
from polywigner.numerics.band_limited import in_band
from polywigner.quantities import SPEED_OF_LIGHT, parse_frequency, wavelength_of
from polywigner.reception import coupling
from polywigner.scattering.near_fields import echo
from polywigner.source.polarisation import checked_polarisation, components

if TYPE_CHECKING:
    import xarray

Floats = NDArray[np.float64]
Complexes = NDArray[np.complex128]
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
        line-of-sight path then counts as matched (docs/polarisation.md).
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
    waves: dict[str, Any] = {"polarisation": polarisation, "bodies": bodies}
    options = ReceiveOptions(reflections=reflections, tolerance=tolerance, coherent=True, **waves)
    jones, count = options.polarisation, options.reflections
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
    chains, echoes, notes = ways_in(scene, receivers[0].scene_unit, count, options.bodies)
    ways: list[Way] = [*chains, *echoes]
    pairs = list(product(receivers, emitters))
    found = []
    with unseen(scene), told("links", pairs) as each:
        for number, (receiver, emitter) in enumerate(each, 1):
            shortest = SPEED_OF_LIGHT / asked.max()
            paths, own = paths_between(scene, emitter, receiver, ways, jones, shortest)
            found.append((paths, amplitudes_of(paths, asked, options.tolerance)))
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
    ends: Ends
    edges: Callable[[float], complex] | None = None
    """b/b_0 over the edges of obstacles at a wavelength in m; None: by rays alone."""
    echo: Callable[[float], complex] | None = None
    """b by a body at a wavelength in m, in place of links."""


@dataclass(frozen=True, eq=False)
class NormalisedSource:
    """A placed source, whose power links count, as the parts that its polarisations make."""

    source: PlacedSource
    parts: tuple[tuple[PlacedSource, Complexes], ...]
    is_polarised: bool = True
    """False: neither scene nor caller specifies a polarisation, in an unpolarised variant."""

    def root(self, part: PlacedSource, is_all: bool, wavelength: float) -> float:
        """Root of the power that a part radiates over the power that counts."""
        if is_all and len(self.parts) == 1 and self.source.normalise == "radiated":
            return 1.0
        norm = partial(norm_of, wavelength=wavelength, obliquity=self.source.obliquity)
        norms = [norm(own.source, normalise=self.source.normalise) for own, _ in self.parts]
        return math.sqrt(norm(part.source) / math.fsum(norms))


Ends = tuple[NormalisedSource, NormalisedSource]


def _normalised(placed: PlacedSource, polarisation: Any) -> NormalisedSource:
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
    return NormalisedSource(placed, tuple(parts), own is not None)


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
    ends = _normalised(emitter, polarisation), _normalised(receiver, polarisation)
    meshes = obstacles_of(scene, emitter, receiver, shortest)
    leg_to = cache(partial(_leg_to, scene, receiver))  # those of one side serve several ways

    def find(way: Way) -> tuple[CoherentPath, list[str]] | str:
        if isinstance(way, Echo):
            return _echo_path(ends, way, leg_to)
        return _path(scene, ends, way, meshes)

    paths, notes = paths_by(ways, link, find)
    if len(paths) > 1 and paths[0].way == () and not ends[0].is_polarised:
        line = CentralPath(np.array([emitter.middle, receiver.middle]), [np.eye(3)])
        match = abs(_turned(ends[0].parts[0][1], ends[1].parts[0][1], ends, (), line)) ** 2
        if match < _MATCHED:
            notes.append(
                f"{link}: the y axes of both ends match by {match:.1%} in power; the line-of-sight "
                "path counts as matched, other paths as polarised along y; specify polarisation"
            )
    return paths, notes


def _path(
    scene: Any,
    ends: Ends,
    chain: Chain,
    meshes: list[Mesh] | None,
) -> tuple[CoherentPath, list[str]] | str:
    found = open_path(scene, ends[0].source, ends[1].source, chain, meshes, coherent=True)
    if isinstance(found, str):
        return found
    facing, taking, rays = found.facing, found.parts.receiver, found.rays
    leg = CentralPath.between(facing, taking, chain, rays)
    # without polarisations the line-of-sight path is the scalar link of `coupling`
    is_scalar = not chain and not (ends[0].is_polarised or ends[1].is_polarised)
    links = []
    for (sent, p), (taken, q) in product(*(end.parts for end in ends)):
        both = facing_parts(sent.image(chain), taken)
        if both is not None:
            factor = leg.transmission if is_scalar else _turned(p, q, ends, chain, leg)
            links.append((factor, both))
    edges = None if meshes is None else cache(partial(_edges, meshes, facing, taking, chain))
    path = CoherentPath(chain, leg.length, rays.amplitude, tuple(links), ends, edges)
    return path, found.notes


def _turned(
    sent: Complexes,
    taken: Complexes,
    ends: Ends,
    chain: Chain,
    legs: CentralPath,
) -> complex:
    """e_r . E: Jones vectors of both ends by the mirrors of a way, no conjugate."""
    out, back = (end.source.pose[:3, :3] for end in ends)
    last = CentralPath(legs.points[:-3:-1], [np.eye(3)])
    return complex(legs.arriving(sent, out, chain) @ last.arriving(taken, back))


def _edges(
    meshes: list[Mesh], facing: PlacedSource, taking: PlacedSource, chain: Chain, wavelength: float
) -> complex:
    sent, taken = (replace(end, wavelength=wavelength) for end in (facing, taking))
    return diffracted_ratio(meshes, sent, taken, chain)


# ---- bodies -------------------------------------------------------------------------------------


def _leg_to(
    scene: Any, like: PlacedSource, body: Body, end: PlacedSource, chain: Chain
) -> tuple[CentralPath, float] | None:
    """The path from an end to a body's middle by mirrors; mean root of the power.

    None: part of the body lies in the plane of the end or behind it.
    """
    image = end.image(chain)
    if not body.is_in_front(image):
        return None
    place = body.standing_in(image, like)
    rays = passing_rays(scene, end, place, chain, coherent=True)
    if not rays.amplitude:
        return CentralPath(np.empty((0, 3)), rays.panes), 0.0
    return CentralPath.between(end, place, chain, rays), rays.amplitude


def _echo_path(
    ends: Ends,
    way: Echo,
    leg_to: Callable[..., tuple[CentralPath, float] | None],
) -> tuple[CoherentPath, list[str]] | str:
    """A way by a body. Both ends send towards it, by reciprocity."""
    chains = way.before, way.after[::-1]
    found = [leg_to(way.body, end.source, chain) for end, chain in zip(ends, chains, strict=True)]
    sides = [each for each in found if each is not None]
    if len(sides) < len(ends):
        return "no echo: part of the body lies in the plane of one end or behind it"
    legs, passing = [leg for leg, _ in sides], math.prod(share for _, share in sides)
    if passing == 0.0:
        return "obstacles block the echo (ray test, without diffraction)"
    notes = way.body.doubts(ends[1].source.wavelength, [leg.points for leg in legs])
    if passing < 1:
        notes.append(
            f"{passing:.1%} of the echo's amplitude passes obstacles (ray test, without "
            "diffraction)"
        )
    distance = math.fsum(leg.length for leg in legs)
    echo = cache(partial(_echo, ends, way, chains, legs))
    return CoherentPath(way, distance, passing, (), ends, echo=echo), notes


def _echo(
    ends: Ends, way: Echo, chains: tuple[Chain, Chain], legs: list[CentralPath], wavelength: float
) -> complex:
    """b by a body, of all polarised components of both ends."""
    sides = []
    for end, chain, leg in zip(ends, chains, legs, strict=True):
        side = []
        for part, jones in end.parts:
            field = leg.arriving(jones, end.source.pose[:3, :3], chain)
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


# ---- results ------------------------------------------------------------------------------------


def _dataset(
    frequencies: Floats,
    receivers: list[PlacedSource],
    emitters: list[PlacedSource],
    ways: Sequence[Way],
    found: list[tuple[list[CoherentPath], Complexes]],
    notes: list[str],
    polarisation: str,
) -> xarray.Dataset:
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
